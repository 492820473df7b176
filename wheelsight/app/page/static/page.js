"use strict";
// The live page: shows what the robot's program sends, and sends what people ask. It asks nothing of any other place.

const ALIVE_MS = 500;
const RETRY_MS = 1000;
const STOP_TRIES = 3;
const DRAG_PX = 16;
const STEP_M = 0.25;
const TURN_RAD = Math.PI / 12;
const HINT_MS = 9000;
// As live_page/pictures.py draws the plan.
const SIGNS = [["#ffffff", "free"], ["#282828", "in the way"], ["#c9cfd6", "not seen yet"], ["#009e73", "robot"],
  ["#56b4e9", "where it may be (2σ)"], ["#0072b2", "driven", "line"], ["#d55e00", "planned", "line"], ["#aa3377", "goal, place"]];
const COSTMAP_SIGNS = [["#d55e00", "forbidden"], ["#e69f00", "avoided"]];
const COLOURS = { way: "#0072b2", path: "#d55e00", robot: "#009e73", front: "#004d38", goal: "#aa3377", ellipse: "#56b4e9" };
const STATES = { idle: "stands", planning: "plans", driving: "drives", recovering: "gets itself out", arrived: "has arrived",
  failed: "stands, and did not arrive" };
const PHASES = { opening: "opens the map", saving: "saves the map", closing: "closes the map", choose: "choose a map",
  ended: "nothing is driven any more" };

const at = (id) => document.getElementById(id);
const canvas = at("plan");
const pen = canvas.getContext("2d");
const pictures = {};
let socket = null, me = null, oldS = 1, heardMs = -Infinity, last = null, zoom = 1;
let wantsHeading = false, marked = null, dragged = null, cross = null, showsCostmap = false, shown = "", refusedMs = 0, hintMs = null;

function address(path) {
  return path + location.search;
}

// ---- the connection

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(`${scheme}//${location.host}${address("/live")}`);
  socket.onmessage = (event) => hear(JSON.parse(event.data));
  socket.onopen = () => { if (showsCostmap) send({ type: "costmap", shown: true }); };
  socket.onclose = (event) => {
    me = null;
    if (event.code !== 1006 && event.reason) refuse(event.reason);
    setTimeout(connect, RETRY_MS);
  };
}

function send(message) {
  const isOpen = socket !== null && socket.readyState === WebSocket.OPEN;
  if (isOpen) socket.send(JSON.stringify(message));
  return isOpen;
}

function stop() {
  // Both ways: whichever works first.
  send({ type: "stop" });
  at("stop").classList.add("pressed");
  setTimeout(() => at("stop").classList.remove("pressed"), 300);
  postStop(STOP_TRIES);
}

function postStop(tries) {
  fetch(address("/stop"), { method: "POST", keepalive: true }).then(
    (answer) => { if (!answer.ok) refuse("STOP was not taken: use the stop button on the robot"); },
    () => {
      // Cut off, as where strangers crowd the door.
      if (tries > 1) postStop(tries - 1);
      else refuse("STOP did not get through: use the stop button on the robot");
    });
}

function hear(message) {
  if (message.welcome) { me = message.welcome.you; oldS = message.welcome.old_s; return; }
  if (message.refused) { refuse(message.refused); return; }
  last = message;
  heardMs = performance.now();
  for (const [name, picture] of Object.entries(message.robot.pictures || {})) fetchPicture(name, picture);
  show();
}

function fetchPicture(name, told) {
  const held = pictures[name] || (pictures[name] = { number: 0, isComing: false, image: null, place: null });
  if (held.number === told.number || held.isComing) return;
  held.isComing = true;
  const image = new Image();
  const kind = name === "camera" ? "jpg" : "png";
  image.onload = () => {
    Object.assign(held, { number: told.number, isComing: false, image, place: told.place });
    if (name === "camera") { at("camera").src = image.src; at("camera").hidden = false; at("no-camera").hidden = true; }
    draw();
  };
  image.onerror = () => { held.isComing = false; };
  const sign = location.search ? "&" : "?";
  image.src = `${address(`/${name}.${kind}`)}${sign}n=${told.number}`;
}

// ---- words and buttons

function refuse(text) {
  at("refused").textContent = text;
  at("refused").hidden = false;
  at("hint").hidden = true;
  refusedMs = performance.now();
}

function lostWords() {
  if (performance.now() - heardMs > 1000 * oldS) return heardMs > 0 ? "connection lost" : "connecting";
  const isOpening = ["opening", "saving", "closing"].includes(last.robot.phase);
  return last.age_s > oldS && !isOpening && last.robot.phase !== "ended" ? "the robot's program does not answer" : "";
}

function show() {
  const lost = lostWords();
  at("plan-box").classList.toggle("old", lost !== "");
  at("lost").hidden = lost === "";
  if (at("lost").textContent !== lost) at("lost").textContent = lost;
  if (performance.now() - refusedMs > 6000) at("refused").hidden = true;
  if (hintMs !== null && performance.now() - hintMs > HINT_MS) at("hint").hidden = true;
  if (last === null) return;
  const robot = last.robot, drives = me !== null && last.driver === me;
  const isFree = lost === "" && (last.driver === null || drives);
  at("state").textContent = lost || stateWords(robot);
  put("why", lost ? "" : whyWords(robot));
  at("map-name").textContent = robot.map;
  at("who").textContent = (last.driver === null ? "nobody drives" : drives ? "you drive" : "somebody else drives")
    + (last.viewers > 1 ? `, ${last.viewers} watch` : "");
  at("take").textContent = drives ? "Give up control" : "Take control";
  at("take").disabled = lost !== "";
  showFacts(robot);
  showLists(robot, isFree);
  at("clear").hidden = !robot.stays || !isFree;
  at("wheels").hidden = !robot.wheels_off || !isFree;
  for (const id of ["explore", "save"]) at(id).disabled = !isFree || !robot.is_new;
  at("name-form").querySelector("button").disabled = !isFree || robot.phase !== "driving";
  draw();
}

function stateWords(robot) {
  if (robot.phase !== "driving") return PHASES[robot.phase] || robot.phase;
  if (robot.stopped) return `stopped: ${robot.stopped}`;
  return robot.doing && (robot.state === "recovering" || robot.doing.startsWith("steers")) ? robot.doing : STATES[robot.state] || robot.state;
}

function put(id, text) {
  // Only what is new: screen readers read it out.
  if (at(id).textContent !== text) at(id).textContent = text;
}

function whyWords(robot) {
  // Why it stands or is slow: what holds it now, else how its last task ended.
  if (robot.problem) return `STOP failed: ${robot.problem}`;
  if (robot.phase !== "driving") return "";
  if (robot.held) return `collision monitor ${robot.held}`;
  const last = robot.said[robot.said.length - 1];
  if (["driving", "planning"].includes(robot.state)) return robot.pace || "";
  return last ? last.text : "";
}

function showFacts(robot) {
  const isDriving = robot.phase === "driving";
  at("speed").textContent = isDriving ? `${Math.abs(robot.speed_m_s).toFixed(2)} m/s` : "–";
  at("to-go").textContent = isDriving && robot.to_go_m !== null ? `${robot.to_go_m.toFixed(1)} m` : "–";
  at("status").textContent = isDriving ? robot.status : "–";
  at("time-box").hidden = robot.share > 0.9;
  at("time").textContent = `at ${Math.round(100 * robot.share)} % of real time: this computer is slow`;
  at("monitor").textContent = robot.problem ? `STOP failed: ${robot.problem}` : isDriving ? robot.monitor : "–";
}

function showLists(robot, isFree) {
  const places = robot.places || [], maps = robot.maps.filter((name) => name !== robot.map || robot.phase === "choose");
  const now = JSON.stringify([places.map((one) => one.name), maps, robot.said, isFree, robot.phase]);
  if (now === shown) return;
  shown = now;
  at("said-title").hidden = robot.said.length === 0;
  at("said").replaceChildren(...robot.said.slice(-4).reverse().map((one) => {
    const line = document.createElement("li");
    line.textContent = one.text;
    line.classList.toggle("problem", one.is_problem);
    return line;
  }));
  const known = places.map((one) => button(one.name, isFree, () => send({ type: "go", name: one.name })));
  keepFocus(at("places"), known.length ? known : [faint("No place has a name yet.")]);
  keepFocus(at("maps"), maps.map((name) => {
    const text = name === "a new map" ? "Start a new map" : `Start with the map ${name}`;
    return button(text, isFree, () => ask(`${text}? The robot stands, and the floor around it is free.`, { type: "start", map: name }));
  }));
}

function keepFocus(box, children) {
  const focused = box.contains(document.activeElement) ? document.activeElement.textContent : null;
  box.replaceChildren(...children);
  if (focused !== null) children.find((one) => one.textContent === focused)?.focus();
}

function button(text, isFree, act) {
  const made = document.createElement("button");
  Object.assign(made, { type: "button", textContent: text, disabled: !isFree, onclick: act });
  return made;
}

function faint(text) {
  const made = document.createElement("p");
  made.className = "faint";
  made.textContent = text;
  return made;
}

function ask(text, message) {
  at("ask-text").textContent = text;
  at("ask-yes").onclick = () => { at("ask").close(); send(message); };
  // Not as a modal one, which would take STOP away.
  at("ask").show();
  at("ask-no").focus();
}

// ---- the plan

function view() {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const plan = pictures.plan && pictures.plan.place;
  const [x, y, w, h] = plan || [-4, -4, 8, 8];
  const scale = zoom * Math.min(width / w, height / h);
  const pose = last && last.robot.pose;
  const middle = zoom > 1 && pose ? [pose[0], pose[1]] : [x + w / 2, y + h / 2];
  return {
    scale,
    toPixel: ([px, py]) => [width / 2 + (px - middle[0]) * scale, height / 2 - (py - middle[1]) * scale],
    toMap: ([u, v]) => [middle[0] + (u - width / 2) / scale, middle[1] - (v - height / 2) / scale],
  };
}

function draw() {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const seen = view();
  drawPicture(pictures.plan, seen);
  if (showsCostmap) drawPicture(pictures.costmap, seen);
  drawTask(seen);
  if (pictures.plan && pictures.plan.place) drawScale(seen.scale, height);
}

function drawTask(seen) {
  if (last === null || last.robot.phase !== "driving") return;
  const robot = last.robot;
  drawLine(robot.way, seen, COLOURS.way, 2.5);
  drawLine(robot.path, seen, COLOURS.path, 4);
  for (const place of robot.places) drawName(place, seen);
  if (robot.goal) drawGoal(robot.goal, seen, COLOURS.goal);
  if (robot.pose) drawRobot(robot, seen);
  for (const mark of [marked, dragged && dragged.goal, cross]) if (mark) drawGoal(mark, seen, "#0057c2");
}

function drawScale(scale, height) {
  // The longest of these lengths that is at most 110 pixels long.
  const length = [10, 5, 2, 1, 0.5, 0.2, 0.1].find((metres) => metres * scale <= 110) || 0.1;
  const [x, y, w] = [12, height - 12, length * scale];
  pen.fillStyle = "rgb(255 255 255 / 85%)";
  pen.fillRect(x - 6, y - 26, Math.max(w, 44) + 12, 32);
  Object.assign(pen, { strokeStyle: "#1a1a1a", lineWidth: 2.5, lineJoin: "miter", lineCap: "butt" });
  pen.beginPath();
  pen.moveTo(x, y - 7); pen.lineTo(x, y); pen.lineTo(x + w, y); pen.lineTo(x + w, y - 7);
  pen.stroke();
  Object.assign(pen, { font: "600 14px system-ui, sans-serif", fillStyle: "#1a1a1a" });
  pen.fillText(`${length} m`, x, y - 10);
}

function showLegend() {
  at("legend").replaceChildren(...[...SIGNS, ...(showsCostmap ? COSTMAP_SIGNS : [])].map(([colour, text, kind]) => {
    const line = document.createElement("li"), swatch = document.createElement("i");
    swatch.style.background = colour;
    swatch.className = kind || "";
    line.append(swatch, text);
    return line;
  }));
}

function drawPicture(picture, seen) {
  if (!picture || !picture.image || !picture.place) return;
  const [x, y, w, h] = picture.place, [u, v] = seen.toPixel([x, y + h]);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(picture.image, u, v, w * seen.scale, h * seen.scale);
}

function drawLine(points, seen, colour, width) {
  if (points.length < 2) return;
  pen.beginPath();
  for (const point of points) pen.lineTo(...seen.toPixel(point));
  Object.assign(pen, { strokeStyle: colour, lineWidth: width, lineJoin: "round", lineCap: "round" });
  pen.stroke();
}

function drawName(place, seen) {
  const [u, v] = seen.toPixel(place.pose);
  pen.beginPath();
  pen.arc(u, v, 6, 0, 7);
  pen.fillStyle = COLOURS.goal;
  pen.fill();
  Object.assign(pen, { font: "600 15px system-ui, sans-serif", lineWidth: 4, strokeStyle: "#ffffff" });
  pen.strokeText(place.name, u + 10, v + 5);
  pen.fillText(place.name, u + 10, v + 5);
}

function drawGoal([x, y, yaw], seen, colour) {
  const [u, v] = seen.toPixel([x, y]);
  Object.assign(pen, { strokeStyle: colour, lineWidth: 3.5 });
  pen.beginPath();
  pen.arc(u, v, 10, 0, 7);
  pen.moveTo(u - 16, v); pen.lineTo(u + 16, v);
  pen.moveTo(u, v - 16); pen.lineTo(u, v + 16);
  pen.stroke();
  if (yaw === null || yaw === undefined) return;
  pen.beginPath();
  pen.moveTo(u, v);
  pen.lineTo(u + 44 * Math.cos(yaw), v - 44 * Math.sin(yaw));
  pen.lineWidth = 6;
  pen.stroke();
}

function drawRobot(robot, seen) {
  const [x, y, yaw] = robot.pose, c = Math.cos(yaw), s = Math.sin(yaw), [u, v] = seen.toPixel([x, y]);
  const place = ([a, b]) => seen.toPixel([x + c * a - s * b, y + s * a + c * b]);
  pen.beginPath();
  for (const corner of robot.footprint) pen.lineTo(...place(corner));
  pen.closePath();
  Object.assign(pen, { fillStyle: COLOURS.robot, strokeStyle: COLOURS.front, lineWidth: 2 });
  pen.globalAlpha = 0.8;
  pen.fill();
  pen.globalAlpha = 1;
  pen.stroke();
  const front = Math.max(...robot.footprint.map(([a]) => a));
  pen.beginPath();
  for (const corner of [[front, 0], [0.45 * front, 0.2], [0.45 * front, -0.2]]) pen.lineTo(...place(corner));
  pen.fillStyle = "#ffffff";
  pen.fill();
  if (!robot.ellipse) return;
  const [long, short, turn] = robot.ellipse;
  pen.beginPath();
  pen.ellipse(u, v, Math.max(long * seen.scale, 3), Math.max(short * seen.scale, 3), -turn, 0, 7);
  Object.assign(pen, { fillStyle: COLOURS.ellipse, strokeStyle: "#00446e", lineWidth: 1.5 });
  pen.globalAlpha = 0.55;
  pen.fill();
  pen.globalAlpha = 1;
  pen.stroke();
}

// ---- goals, by pointer and by keys

function pixelOf(event) {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

function drive([x, y, yaw]) {
  marked = cross = null;
  const heading = yaw === undefined || yaw === null ? null : Math.atan2(Math.sin(yaw), Math.cos(yaw));
  if (lostWords() !== "" || !send({ type: "goal", x_m: x, y_m: y, yaw_rad: heading })) refuse("no connection: nothing was asked");
  else hint(heading === null);
  draw();
}

function hint(isAnyHeading) {
  // Once, after the first place that was asked for: what was understood, and how to ask for more.
  if (hintMs !== null) { at("hint").hidden = true; return; }
  hintMs = performance.now();
  at("hint").textContent = isAnyHeading
    ? "It goes there. Drag from a place to say where it looks at the end." : "It goes there, and looks at the end as you dragged.";
  at("hint").hidden = false;
}

function towards([x, y], [a, b]) {
  return [x, y, Math.atan2(b - y, a - x)];
}

canvas.addEventListener("pointerdown", (event) => {
  if (!event.isPrimary || event.button !== 0) return;
  canvas.setPointerCapture(event.pointerId);
  const pixel = pixelOf(event);
  dragged = { pixel, goal: view().toMap(pixel), seen: view() };
});
canvas.addEventListener("pointermove", (event) => {
  if (dragged === null) return;
  const pixel = pixelOf(event), isDrag = Math.hypot(pixel[0] - dragged.pixel[0], pixel[1] - dragged.pixel[1]) > DRAG_PX;
  const begin = dragged.goal.slice(0, 2);
  dragged.goal = isDrag ? towards(begin, dragged.seen.toMap(pixel)) : begin;
  draw();
});
canvas.addEventListener("pointercancel", () => { dragged = null; });
canvas.addEventListener("pointerup", () => {
  if (dragged === null) return;
  const goal = dragged.goal;
  dragged = null;
  if (goal.length === 3 || !wantsHeading) drive(goal);
  else if (marked !== null) drive(towards(marked, goal));
  else { marked = goal; draw(); }
});
canvas.addEventListener("keydown", (event) => {
  const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const way = ways[event.key], turn = { q: 1, e: -1 }[event.key.toLowerCase()];
  if (way || turn) {
    const pose = (last && last.robot.pose) || [0, 0, 0];
    cross = cross || [pose[0], pose[1], null];
    if (way) { cross[0] += STEP_M * way[0]; cross[1] += STEP_M * way[1]; }
    if (turn) cross[2] = (cross[2] === null ? pose[2] : cross[2]) + TURN_RAD * turn;
    draw();
  } else if (event.key === "Enter" && cross !== null) drive(cross);
  else return;
  event.preventDefault();
});

// ---- stick: held, its position is sent ten times a second; the robot takes one that is older than 0.25 s as released

const STICK_MS = 100, STICK_PX = 64, KEY_SHARE = 0.5;
const stick = { forward: 0, left: 0, isHeld: false, keys: new Set() };

function moveStick(forward, left) {
  const size = Math.max(1, Math.hypot(forward, left));
  [stick.forward, stick.left] = [forward / size, left / size];
  at("knob").style.transform = `translate(${-STICK_PX * stick.left}px, ${-STICK_PX * stick.forward}px)`;
}
function sendStick() {
  if (lostWords() === "") send({ type: "stick", forward: stick.forward, left: stick.left });
}
function releaseStick() {
  const wasHeld = stick.isHeld;
  stick.isHeld = false;
  stick.keys.clear();
  moveStick(0, 0);
  if (wasHeld) sendStick();
}
function holdStick(forward, left) {
  moveStick(forward, left);
  if (!stick.isHeld) { stick.isHeld = true; sendStick(); }
}
function dragStick(event) {
  const box = at("stick").getBoundingClientRect();
  const [x, y] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
  holdStick(-y / STICK_PX, -x / STICK_PX);
}
at("stick").addEventListener("pointerdown", (event) => {
  if (!event.isPrimary || event.button !== 0) return;
  at("stick").setPointerCapture(event.pointerId);
  dragStick(event);
});
at("stick").addEventListener("pointermove", (event) => { if (at("stick").hasPointerCapture(event.pointerId)) dragStick(event); });
for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) at("stick").addEventListener(end, releaseStick);
document.addEventListener("visibilitychange", () => { if (document.hidden) releaseStick(); });
function followKeys() {
  const has = (key) => (stick.keys.has(key) ? KEY_SHARE : 0);
  if (stick.keys.size === 0) releaseStick();
  else holdStick(has("ArrowUp") - has("ArrowDown"), has("ArrowLeft") - has("ArrowRight"));
}
at("stick").addEventListener("keydown", (event) => {
  if (!event.key.startsWith("Arrow")) return;
  event.preventDefault();
  stick.keys.add(event.key);
  followKeys();
});
at("stick").addEventListener("keyup", (event) => { if (stick.keys.delete(event.key)) followKeys(); });
setInterval(() => { if (stick.isHeld) sendStick(); }, STICK_MS);

// ---- buttons

function toggle(id, act) {
  at(id).onclick = () => {
    const isOn = at(id).getAttribute("aria-pressed") !== "true";
    at(id).setAttribute("aria-pressed", String(isOn));
    act(isOn);
    draw();
  };
}

at("stop").onclick = stop;
// In the capturing phase: no dialog and no field keeps Escape from stopping.
document.addEventListener("keydown", (event) => { if (event.key === "Escape") stop(); }, true);
at("take").onclick = () => send({ type: last && last.driver === me ? "leave" : "take" });
at("explore").onclick = () => ask("Look at all rooms? The robot drives by itself until it has seen all it can reach.", { type: "explore" });
at("clear").onclick = () => {
  const [x, y] = (last && last.robot.stays) || [];
  if (x !== undefined) ask(`Is nothing at (${x}, ${y}) m? The camera sees no depth behind what stood there.`, { type: "clear", x_m: x, y_m: y });
};
at("wheels").onclick = () => ask("Are the wheels in order? They did not follow their commands. The robot drives again once it gets a task.", { type: "wheels" });
at("save").onclick = () => send({ type: "save" });
at("ask-no").onclick = () => at("ask").close();
at("nearer").onclick = () => { zoom = Math.min(8, zoom * 1.6); draw(); };
at("farther").onclick = () => { zoom = Math.max(1, zoom / 1.6); draw(); };
at("name-form").onsubmit = (event) => {
  event.preventDefault();
  const name = at("name").value.trim();
  if (name && send({ type: "name", name })) at("name").value = "";
};
toggle("heading", (isOn) => { wantsHeading = isOn; marked = null; });
toggle("costmap", (isOn) => { showsCostmap = isOn; showLegend(); send({ type: "costmap", shown: isOn }); });
window.addEventListener("resize", draw);
showLegend();
setInterval(() => send({ type: "alive" }), ALIVE_MS);
setInterval(show, 250);
connect();
