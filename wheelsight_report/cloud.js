// The map as points: turned, moved and zoomed by pointer, touch, wheel and keys. As cloud_view.py draws it at first.
const CLOUD_FOCAL = 1 / Math.tan((20 * Math.PI) / 180);
const CLOUD_POINTS = `
attribute vec3 at, colour, normal;
uniform vec3 right, up, back, centre;
uniform float distance, aspect, focal, size, least, nearest, farthest;
varying vec3 tint;
void main() {
  vec3 p = at - centre;
  float depth = distance - dot(p, back);
  bool hidden = dot(normal, centre + distance * back - at) <= 0.0;
  gl_Position = hidden ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(focal / aspect * dot(p, right), focal * dot(p, up),
    (depth * (farthest + nearest) - 2.0 * farthest * nearest) / (farthest - nearest), depth);
  gl_PointSize = clamp(size / max(depth, 1e-6), least, 64.0);
  tint = colour;
}`;
const CLOUD_LINES = `
attribute vec3 at;
uniform vec3 right, up, back, centre;
uniform vec2 shift;
uniform float distance, aspect, focal, nearest, farthest, lift;
void main() {
  vec3 p = at - centre;
  float depth = distance - dot(p, back), before = max(depth - lift, nearest);
  gl_Position = vec4(focal / aspect * dot(p, right) + shift.x * depth, focal * dot(p, up) + shift.y * depth,
    depth * ((farthest + nearest) - 2.0 * farthest * nearest / before) / (farthest - nearest), depth);
}`;
const cloudProgram = (gl, vertex, fragment) => {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, `precision mediump float;${fragment}`]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
};
// Lines of 3-vectors, then planes of differences: x, y, z in 16 bits, colours and normals in 8.
const readCloud = (bytes, told) => {
  const n = told.points, ends = 2 * (told.path + told.loops);
  const lines = new Float32Array(bytes.buffer, 0, 3 * ends);
  const level = new Uint16Array(bytes.buffer, 12 * ends, 3 * n);
  const plain = new Uint8Array(bytes.buffer, 12 * ends + 6 * n, 6 * n);
  const at = new Float32Array(3 * n), colour = new Uint8Array(3 * n), normal = new Int8Array(3 * n);
  for (let k = 0; k < 3; k++) {
    for (let i = 0, x = 0, c = 0, d = 0; i < n; i++) {
      at[3 * i + k] = told.low[k] + told.step * (x = (x + level[k * n + i]) & 65535);
      colour[3 * i + k] = c += plain[k * n + i];
      normal[3 * i + k] = d += plain[(3 + k) * n + i];
    }
  }
  return { at, colour, normal, lines };
};
const showCloud = async (place) => {
  const told = JSON.parse(place.dataset.cloud), canvas = place.querySelector("canvas");
  const gl = canvas.getContext("webgl", { alpha: false, antialias: true, preserveDrawingBuffer: true });
  if (!gl || typeof DecompressionStream === "undefined") return;
  const data = readCloud(await unpack(place.nextElementSibling.textContent), told);
  const points = cloudProgram(gl, CLOUD_POINTS, "varying vec3 tint; void main() { gl_FragColor = vec4(tint, 1.0); }");
  const strokes = cloudProgram(gl, CLOUD_LINES, "uniform vec4 ink; void main() { gl_FragColor = ink; }");
  const buffer = (values) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return made;
  };
  const held = { at: buffer(data.at), colour: buffer(data.colour), normal: buffer(data.normal), lines: buffer(data.lines) };
  const home = { yaw: told.yaw, pitch: told.pitch, distance: told.distance, centre: told.centre };
  let view = { ...home }, due = false;
  const axes = () => {
    const s = Math.sin(view.yaw), c = Math.cos(view.yaw), t = Math.sin(view.pitch), h = Math.cos(view.pitch);
    return { right: [c, s, 0], up: [-t * s, t * c, h], back: [h * s, -h * c, t] };
  };
  const bind = (program, name, from, kind, normalised) => {
    const where = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, from);
    gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(where, 3, kind, normalised, 0, 0);
    return where;
  };
  const begin = (program) => {
    const set = (name, value) => gl.uniform1f(gl.getUniformLocation(program, name), value);
    gl.useProgram(program);
    for (const [name, axis] of Object.entries({ ...axes(), centre: view.centre })) {
      gl.uniform3fv(gl.getUniformLocation(program, name), axis);
    }
    set("distance", view.distance);
    set("aspect", canvas.width / canvas.height);
    set("focal", CLOUD_FOCAL);
    set("nearest", Math.max(0.01 * view.distance, 0.01));
    set("farthest", view.distance + 20 * home.distance);
    return set;
  };
  const stroke = (first, count, colour, alpha) => {
    gl.uniform4f(gl.getUniformLocation(strokes, "ink"), ...colour, alpha);
    for (let i = 0; i < 9; i++) { // WebGL's lines are one pixel wide
      gl.uniform2f(gl.getUniformLocation(strokes, "shift"), ((i % 3) - 1) * 2 / canvas.width, (Math.floor(i / 3) - 1) * 2 / canvas.height);
      gl.drawArrays(gl.LINES, first, count);
    }
  };
  const draw = () => {
    due = false;
    const sharp = Math.min(devicePixelRatio || 1, 2);
    [canvas.width, canvas.height] = [Math.max(1, Math.round(sharp * canvas.clientWidth)), Math.max(1, Math.round(sharp * canvas.clientHeight))];
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const set = begin(points);
    set("size", 1.5 * told.edge * CLOUD_FOCAL * canvas.height / 2);
    set("least", 2 * sharp);
    const used = [bind(points, "at", held.at, gl.FLOAT, false), bind(points, "colour", held.colour, gl.UNSIGNED_BYTE, true), bind(points, "normal", held.normal, gl.BYTE, true)];
    gl.drawArrays(gl.POINTS, 0, told.points);
    used.forEach((where) => gl.disableVertexAttribArray(where));
    begin(strokes)("lift", Math.max(2 * told.edge, 0.02)); // a path on the floor is not below it
    bind(strokes, "at", held.lines, gl.FLOAT, false);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    for (const [isHidden, alpha] of [[true, 0.08], [false, 1]]) { // what lies behind a wall shows faintly
      if (isHidden) gl.disable(gl.DEPTH_TEST); else gl.enable(gl.DEPTH_TEST);
      stroke(2 * told.path, 2 * told.loops, [0, 0.62, 0.451], alpha);
      stroke(0, 2 * told.path, [0.835, 0.369, 0], alpha);
    }
    gl.disable(gl.BLEND);
    place.dataset.drawn = told.points;
  };
  const change = (next) => {
    view = { ...view, ...next };
    view.pitch = Math.min(Math.max(view.pitch, -Math.PI / 2), Math.PI / 2);
    view.distance = Math.min(Math.max(view.distance, home.distance / 200), home.distance * 8);
    if (!due) requestAnimationFrame(draw);
    due = true;
  };
  const turn = (dx, dy) => change({ yaw: view.yaw - 0.008 * dx, pitch: view.pitch + 0.008 * dy });
  const zoom = (factor) => change({ distance: view.distance * factor });
  const move = (dx, dy) => {
    const m = 2 * view.distance / CLOUD_FOCAL / canvas.clientHeight, { right, up } = axes();
    change({ centre: view.centre.map((value, k) => value - m * (dx * right[k] - dy * up[k])) });
  };
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, wide: Math.hypot(a.x - b.x, a.y - b.y) || 1 };
  };
  canvas.addEventListener("pointerdown", (e) => {
    fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    canvas.setPointerCapture(e.pointerId);
  });
  canvas.addEventListener("pointermove", (e) => {
    const last = fingers.get(e.pointerId);
    if (!last) return;
    const before = fingers.size === 2 ? spread() : null;
    fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    if (before) {
      const after = spread();
      zoom(before.wide / after.wide);
      move(after.x - before.x, after.y - before.y);
    } else (e.shiftKey || e.buttons & 6 ? move : turn)(e.clientX - last.x, e.clientY - last.y);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => {
    if (document.activeElement !== canvas) return; // the page scrolls
    e.preventDefault();
    zoom(Math.exp(0.001 * Math.max(-300, Math.min(300, e.deltaY))));
  }, { passive: false });
  const keys = { ArrowLeft: [-24, 0], ArrowRight: [24, 0], ArrowUp: [0, -24], ArrowDown: [0, 24] };
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.altKey || e.metaKey) return;
    if (keys[e.key]) (e.shiftKey ? move : turn)(...keys[e.key]);
    else if (e.key === "+" || e.key === "=") zoom(0.85);
    else if (e.key === "-") zoom(1 / 0.85);
    else if (e.key === "Home") change(home);
    else return;
    e.preventDefault();
  });
  const buttons = document.createElement("div");
  for (const [name, act] of [["Aslant", () => change(home)], ["From above", () => change({ ...home, yaw: 0, pitch: Math.PI / 2 })], ["Nearer", () => zoom(0.75)], ["Farther", () => zoom(1 / 0.75)]]) {
    const button = document.createElement("button");
    button.textContent = name;
    button.addEventListener("click", act);
    buttons.append(button);
  }
  place.append(buttons);
  place.classList.add("live");
  canvas.addEventListener("webglcontextlost", () => place.classList.remove("live"));
  new ResizeObserver(() => change({})).observe(canvas);
  draw();
};
for (const place of document.querySelectorAll(".cloud")) showCloud(place);
