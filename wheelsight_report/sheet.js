"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const at = (id) => document.getElementById(id);
  const count = data.pictures.length;
  const start = Number(data.borders[0]);
  const whole = Math.max(Number(data.borders[count]) - start, 1e-6);

  // What is undone and redone: the areas' names, and an area's index (-1: none) for each thumbnail.
  let names = [...data.names];
  let labels = [...data.labels];
  let past = [];
  let future = [];
  let isSaved = true;
  // Selected are all from `anchor` to `cursor`; after an area was given, Shift begins behind what it was given to.
  let anchor = 0;
  let cursor = 0;
  let isGiven = false;

  const colourOf = (area) => (area < 0 ? "" : data.colours[area % data.colours.length]);
  const isFine = data.seconds.some((s, i) => i && s - data.seconds[i - 1] < 0.9);
  const clock = (s) => {
    const tenths = Math.round(s * 10);
    const rest = isFine ? ((tenths % 600) / 10).toFixed(1) : String(Math.floor((tenths % 600) / 10));
    return `${Math.floor(tenths / 600)}:${rest.padStart(isFine ? 4 : 2, "0")}`;
  };
  const chosen = () => [Math.min(anchor, cursor), Math.max(anchor, cursor)];
  const clamp = (i) => Math.min(Math.max(i, 0), count - 1);
  const make = (tag, kind, text) => {
    const made = document.createElement(tag);
    if (kind) made.className = kind;
    if (text !== undefined) made.textContent = text;
    return made;
  };
  const paint = (element, area) => {
    element.classList.toggle("none", area < 0);
    if (area < 0) element.style.removeProperty("--colour");
    else element.style.setProperty("--colour", colourOf(area));
  };
  const runs = () => {
    const found = [];
    labels.forEach((area, i) => {
      if (i && labels[i - 1] === area) found[found.length - 1].end = i + 1;
      else found.push({ area, begin: i, end: i + 1 });
    });
    return found;
  };

  // Thumbnails
  const sheet = at("sheet");
  const thumbs = data.pictures.map((uri, i) => {
    const thumb = make("figure", "thumb");
    thumb.id = `thumb-${i}`;
    thumb.setAttribute("role", "option");
    thumb.title = `${clock(data.seconds[i])} after the start`;
    const image = make("img");
    image.src = uri;
    image.alt = `view at ${clock(data.seconds[i])}`;
    image.decoding = "async";
    const tag = make("figcaption", "tag");
    tag.append(make("b"), make("span", "", clock(data.seconds[i])));
    thumb.append(image, tag);
    sheet.append(thumb);
    return thumb;
  });
  const showLabels = () => {
    thumbs.forEach((thumb, i) => {
      paint(thumb, labels[i]);
      thumb.querySelector("b").textContent = labels[i] < 0 ? "none" : names[labels[i]];
    });
  };

  // Areas to choose from
  const showAreas = () => {
    const box = at("areas");
    box.replaceChildren();
    [...names.keys(), -1].forEach((area) => {
      const button = make("button", "area");
      button.type = "button";
      const key = area < 0 ? "0" : area < 9 ? String(area + 1) : "·";
      const given = labels.filter((label) => label === area).length;
      button.append(make("kbd", "", key), make("span", "", area < 0 ? "none" : names[area]), make("span", "count", given));
      button.dataset.area = area;
      paint(button, area);
      button.addEventListener("click", () => give(area));
      box.append(button);
    });
    const form = make("form", "add");
    const field = make("input");
    field.placeholder = "another area";
    field.setAttribute("aria-label", "Name of another area");
    const add = make("button", "", "Add");
    form.append(field, add);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      addArea(field.value.trim());
    });
    box.append(form);
  };

  // The drive along time
  const showStrip = () => {
    const strip = at("strip");
    strip.replaceChildren();
    for (const run of runs()) {
      const part = make("div", "run", run.area < 0 ? "" : names[run.area]);
      part.style.flex = `${Number(data.borders[run.end]) - Number(data.borders[run.begin])} 1 0`;
      part.title = run.area < 0 ? "none" : names[run.area];
      paint(part, run.area);
      strip.append(part);
    }
    strip.append(make("div", "mark"));
  };

  // The plan from above
  const SVG = "http://www.w3.org/2000/svg";
  const dots = [];
  let dotSize = 1;
  const drawPlan = () => {
    const plan = at("plan");
    const known = data.places.filter((place) => place);
    const corners = [...data.polygons.flat(), ...known];
    if (!data.polygons.length || !known.length) return;
    const x = corners.map((c) => c[0]);
    const y = corners.map((c) => c[1]);
    const [left, right, low, high] = [Math.min(...x), Math.max(...x), Math.min(...y), Math.max(...y)];
    const unit = Math.max(right - left, high - low) / 100;
    dotSize = 0.8 * unit;
    plan.setAttribute("viewBox", `${left - unit} ${-high - unit} ${right - left + 2 * unit} ${high - low + 2 * unit}`);
    const add = (tag, attributes, text) => {
      const made = document.createElementNS(SVG, tag);
      for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
      if (text !== undefined) made.textContent = text;
      plan.append(made);
      return made;
    };
    data.polygons.forEach((polygon, area) => {
      const points = polygon.map((c) => `${c[0]},${-c[1]}`).join(" ");
      add("polygon", { points, fill: colourOf(area), stroke: colourOf(area) });
    });
    data.places.forEach((place) => {
      dots.push(place && add("circle", { cx: place[0], cy: -place[1], r: dotSize, class: "way" }));
    });
    data.polygons.forEach((polygon, area) => {
      const middle = [0, 1].map((k) => polygon.reduce((sum, c) => sum + c[k], 0) / polygon.length);
      add("text", { x: middle[0], y: -middle[1], "font-size": 6 * unit }, data.names[area]);
    });
  };

  const showSelection = () => {
    const [low, high] = chosen();
    thumbs.forEach((thumb, i) => {
      const isIn = i >= low && i <= high;
      thumb.classList.toggle("chosen", isIn);
      thumb.setAttribute("aria-selected", isIn);
      if (dots[i]) {
        dots[i].setAttribute("class", isIn ? "way chosen" : "way");
        dots[i].setAttribute("r", (isIn ? 2 : 1) * dotSize);
      }
    });
    sheet.setAttribute("aria-activedescendant", `thumb-${cursor}`);
    const mark = at("strip").querySelector(".mark");
    const [from, to] = [Number(data.borders[low]) - start, Number(data.borders[high + 1]) - start];
    mark.style.left = `${(100 * from) / whole}%`;
    mark.style.width = `${(100 * (to - from)) / whole}%`;
    tell();
  };
  const tell = (text) => {
    const [low, high] = chosen();
    const missing = labels.filter((area) => area < 0).length;
    const span = low === high ? `${clock(data.seconds[low])} selected` : `${clock(data.seconds[low])} to ${clock(data.seconds[high])} selected, ${high - low + 1} thumbnails`;
    const left = missing ? `${missing} of ${count} without an area` : "every thumbnail has an area";
    at("status").textContent = text ?? `${span} · ${left}${isSaved ? "" : " · not saved"}`;
    at("undo").disabled = !past.length;
    at("redo").disabled = !future.length;
  };
  const showAll = () => {
    showLabels();
    showAreas();
    showStrip();
    showSelection();
  };

  // What can be done
  const remember = () => {
    past.push({ names: [...names], labels: [...labels], anchor, cursor });
    future = [];
    isSaved = false;
  };
  const give = (area) => {
    if (area >= names.length) return;
    remember();
    const [low, high] = chosen();
    labels.fill(area, low, high + 1);
    isGiven = true;
    showAll();
    sheet.focus({ preventScroll: true });
  };
  const addArea = (name) => {
    if (!name) return;
    if (names.includes(name)) {
      tell(`there is an area ${name} already`);
      return;
    }
    remember();
    names.push(name);
    showAll();
    sheet.focus({ preventScroll: true });
  };
  const goBack = (from, to) => {
    if (!from.length) return;
    to.push({ names: [...names], labels: [...labels], anchor, cursor });
    ({ names, labels, anchor, cursor } = from.pop());
    isSaved = false;
    showAll();
  };
  const select = (i, isLonger) => {
    const [low, high] = chosen();
    if (isLonger && isGiven) anchor = i > high ? clamp(high + 1) : i < low ? clamp(low - 1) : i;
    if (!isLonger) anchor = i;
    cursor = i;
    isGiven = false;
    showSelection();
  };
  const move = (step, isLonger) => {
    const [low, high] = chosen();
    const from = isGiven || !isLonger ? (step > 0 ? high : low) : cursor;
    select(clamp(from + step), isLonger);
    thumbs[cursor].scrollIntoView({ block: "nearest" });
  };
  const goToMissing = () => {
    const order = [...labels.keys()].map((i) => (cursor + 1 + i) % count);
    const found = order.find((i) => labels[i] < 0);
    if (found === undefined) return;
    select(found, false);
    thumbs[found].scrollIntoView({ block: "center" });
  };
  const quoted = (name) => (/[",]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
  const save = () => {
    const named = runs().filter((run) => run.area >= 0);
    if (!named.length) {
      tell("nothing to save: no thumbnail has an area yet");
      return;
    }
    const lines = named.map((run) => `${data.borders[run.begin]},${data.borders[run.end]},${quoted(names[run.area])}`);
    const blob = new Blob([`from_s,to_s,area\n${lines.join("\n")}\n`], { type: "text/csv" });
    const link = make("a");
    link.href = URL.createObjectURL(blob);
    link.download = data.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    isSaved = true;
    tell(`saved ${named.length} ranges as ${data.file}; wheelsight places train RECORDING --labels ${data.file} --out MODEL`);
  };

  // Mouse and pen
  let isDragging = false;
  const indexUnder = (event) => thumbs.indexOf(document.elementFromPoint(event.clientX, event.clientY)?.closest(".thumb"));
  sheet.addEventListener("pointerdown", (event) => {
    const i = thumbs.indexOf(event.target.closest(".thumb"));
    if (i < 0 || event.button) return;
    select(i, event.shiftKey);
    isDragging = event.pointerType !== "touch"; // a finger scrolls
  });
  addEventListener("pointermove", (event) => {
    if (!isDragging) return;
    const i = indexUnder(event);
    if (i >= 0 && i !== cursor) {
      cursor = i;
      showSelection();
    }
    if (event.clientY > innerHeight - 40) scrollBy(0, 30);
    else if (event.clientY < at("bar").getBoundingClientRect().bottom + 20) scrollBy(0, -30);
  });
  addEventListener("pointerup", () => {
    isDragging = false;
  });
  at("strip").addEventListener("click", (event) => {
    const box = at("strip").getBoundingClientRect();
    const wanted = start + (whole * (event.clientX - box.left)) / box.width;
    const after = data.borders.findIndex((border) => Number(border) > wanted);
    select(clamp(after < 0 ? count - 1 : after - 1), event.shiftKey);
    thumbs[cursor].scrollIntoView({ block: "center" });
  });

  // Keys
  const columns = () => getComputedStyle(sheet).gridTemplateColumns.split(" ").length;
  const steps = { ArrowLeft: () => -1, ArrowRight: () => 1, ArrowUp: () => -columns(), ArrowDown: () => columns() };
  const commands = {
    a: () => {
      [anchor, cursor] = [0, count - 1];
      showSelection();
    },
    s: save,
    y: () => goBack(future, past),
    z: () => goBack(past, future),
    Z: () => goBack(future, past),
  };
  addEventListener("keydown", (event) => {
    if (event.target.closest("input:not([type=range])") || event.altKey) return;
    const isCommand = event.ctrlKey || event.metaKey;
    let act;
    if (isCommand) act = commands[event.key];
    else if (steps[event.key] && !event.target.closest("input")) act = () => move(steps[event.key](), event.shiftKey);
    else if (/^[1-9]$/.test(event.key)) act = () => give(Number(event.key) - 1);
    else if (["0", "Delete", "Backspace"].includes(event.key)) act = () => give(-1);
    else if (event.key === "n") act = goToMissing;
    if (!act) return;
    event.preventDefault();
    act();
  });

  at("undo").addEventListener("click", () => goBack(past, future));
  at("redo").addEventListener("click", () => goBack(future, past));
  at("save").addEventListener("click", save);
  at("size").addEventListener("input", (event) => sheet.style.setProperty("--size", `${event.target.value}px`));
  addEventListener("beforeunload", (event) => {
    if (!isSaved) event.preventDefault();
  });
  drawPlan();
  showAll();
})();
