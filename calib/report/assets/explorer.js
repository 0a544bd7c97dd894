"use strict";
// Curves of a log: torque and residual over time, residual over speed, position and load, with one cursor for all of them and the 3D player;
// the residual with and without an effect that is clicked; the residual of all held-out logs side by side.
// Data: <script type="application/json" id="explorer">. Wheel or + and - zoom in time, drag or Shift with arrows moves, arrows move the cursor.
(() => {
  const data = JSON.parse(document.getElementById("explorer").textContent);
  const root = document.getElementById("explorer-view");
  const find = (name) => root.querySelector(`[data-part=${name}]`);
  const [jointBox, logBox, toggles, readout, canvas, choices, share] =
    ["joint", "log", "series", "readout", "curves", "effects", "share"].map(find);
  const ink = canvas.getContext("2d");
  const state = { log: 0, joint: data.joint, effect: -1, from: 0, to: 1, at: 0, on: {} };
  const names = { measured: "measured", before: data.words.before, after: data.words.after };
  const roles = data.roles;
  const effects = data.effects || [];
  let boxes = [];

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const log = () => data.logs[state.log];
  const dash = { before: [5, 3], after: [], effect: [2, 2], measured: [] };
  // an identified effect is shown by the corrected arm without it, any other by the nominal arm with it
  const beside = () => (effects[state.effect].identified ? "after" : "before");
  const every = () => (state.effect < 0 ? roles : [...roles, "effect"]);

  const kept = new Map();
  function curves(number = state.log) {
    const key = `${number}/${state.joint}/${state.effect}`;
    if (kept.has(key)) return kept.get(key);
    const l = data.logs[number];
    const column = (name) => l[name].map((row) => row[state.joint]);
    const tau = column("tau");
    const value = { t: l.t, tau, q: column("q"), dq: column("dq"), predicted: {}, residual: {} };
    for (const role of every()) {
      value.predicted[role] = role !== "effect" ? column(role) : l.effects[state.effect][state.joint] || value.predicted[beside()];
      value.residual[role] = tau.map((x, k) => x - value.predicted[role][k]);
    }
    if (kept.size > 40) kept.clear();
    kept.set(key, value);
    return value;
  }

  function extent(lists, indices) {
    let low = Infinity, high = -Infinity;
    for (const list of lists) for (const k of indices) {
      const x = list[k];
      if (x < low) low = x;
      if (x > high) high = x;
    }
    if (!(high > low)) [low, high] = [low - 1, low + 1];
    const room = 0.05 * (high - low);
    return [low - room, high + room];
  }

  function ticks(low, high, most) {
    const raw = (high - low) / most;
    const size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * size).find((s) => s >= raw);
    const out = [];
    for (let x = Math.ceil(low / step) * step; x <= high + 1e-9 * step; x += step) out.push(Math.abs(x) < step / 1e6 ? 0 : x);
    return out;
  }

  const short = (x) => String(Number(x.toPrecision(3)));

  function frame(box, title, xlabel) {
    const { x, y, w, h } = box;
    ink.strokeStyle = css("grid");
    ink.fillStyle = css("muted");
    ink.lineWidth = 1;
    ink.textAlign = "right";
    ink.textBaseline = "middle";
    for (const v of ticks(box.y0, box.y1, Math.max(2, h / 36))) {
      const at = y + h - ((v - box.y0) / (box.y1 - box.y0)) * h;
      ink.beginPath(); ink.moveTo(x, at); ink.lineTo(x + w, at); ink.stroke();
      ink.fillText(short(v), x - 5, at);
    }
    ink.textAlign = "center";
    ink.textBaseline = "top";
    for (const v of ticks(box.x0, box.x1, Math.max(2, w / 80))) {
      const at = x + ((v - box.x0) / (box.x1 - box.x0)) * w;
      ink.beginPath(); ink.moveTo(at, y); ink.lineTo(at, y + h); ink.stroke();
      ink.fillText(short(v), at, y + h + 4);
    }
    ink.fillStyle = css("ink");
    ink.textAlign = "left";
    ink.textBaseline = "bottom";
    ink.fillText(title, x, y - 4);
    ink.textAlign = "right";
    ink.fillStyle = css("muted");
    ink.fillText(xlabel, x + w, y - 4);
  }

  const px = (box, v) => box.x + ((v - box.x0) / (box.x1 - box.x0)) * box.w;
  const py = (box, v) => box.y + box.h - ((v - box.y0) / (box.y1 - box.y0)) * box.h;

  function clip(box, drawing) {
    ink.save();
    ink.beginPath(); ink.rect(box.x, box.y, box.w, box.h); ink.clip();
    drawing();
    ink.restore();
  }

  function line(box, xs, ys, indices, role) {
    clip(box, () => {
      ink.strokeStyle = css({ measured: "ink", effect: "refit" }[role] || role);
      ink.lineWidth = role === "measured" ? 1 : 1.4;
      ink.setLineDash(dash[role]);
      ink.beginPath();
      let last = -1;
      for (const k of indices) {
        // a hole in the rows stays a hole
        const near = last >= 0 && xs[k] - xs[last] < 5 * data.step;
        ink[near ? "lineTo" : "moveTo"](px(box, xs[k]), py(box, ys[k]));
        last = k;
      }
      ink.stroke();
      ink.setLineDash([]);
    });
  }

  function cloud(box, xs, ys, indices, role) {
    clip(box, () => {
      ink.fillStyle = css(role === "effect" ? "refit" : role);
      ink.globalAlpha = 0.45;
      for (const k of indices) ink.fillRect(px(box, xs[k]) - 1, py(box, ys[k]) - 1, 2, 2);
      ink.globalAlpha = 1;
    });
  }

  function nearest(t) {
    const list = log().t;
    let low = 0, high = list.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (list[middle] <= t) low = middle; else high = middle;
    }
    return t - list[low] < list[high] - t ? low : high;
  }

  function visible() {
    const end = log().t[log().t.length - 1];
    const [a, b] = [nearest(state.from * end), nearest(state.to * end)];
    const out = [];
    for (let k = a; k <= b; k++) out.push(k);
    return out;
  }

  function draw() {
    const wide = canvas.clientWidth;
    const narrow = wide < 620;
    const many = data.logs.length > 1;
    const below = narrow ? 900 : 620;
    const tall = below + (many ? (narrow ? 150 * data.logs.length : 160) : 0);
    const scale = Math.min(devicePixelRatio || 1, 2);
    canvas.style.height = `${tall}px`;
    canvas.width = wide * scale;
    canvas.height = tall * scale;
    ink.setTransform(scale, 0, 0, scale, 0, 0);
    ink.clearRect(0, 0, wide, tall);
    ink.font = "12px system-ui, sans-serif";
    const c = curves();
    const indices = visible();
    const shown = every().filter((role) => state.on[role]);
    const end = c.t[c.t.length - 1];
    const left = 56, width = wide - left - 12;
    const unit = data.unit;
    const torques = [c.tau, ...shown.map((role) => c.predicted[role])];
    const residuals = shown.length ? shown.map((role) => c.residual[role]) : [c.tau.map(() => 0)];
    boxes = [];
    const box = (kind, x, y, w, h, xs, [x0, x1], [y0, y1]) => { const b = { kind, x, y, w, h, xs, x0, x1, y0, y1 }; boxes.push(b); return b; };
    const times = [state.from * end, state.to * end];
    let b = box("time", left, 22, width, 180, c.t, times, extent(torques, indices));
    frame(b, `torque [${unit}]`, "time [s]");
    if (state.on.measured) line(b, c.t, c.tau, indices, "measured");
    for (const role of shown) line(b, c.t, c.predicted[role], indices, role);
    const range = extent(residuals, indices);
    b = box("time", left, 244, width, 120, c.t, times, range);
    frame(b, `residual [${unit}]`, "time [s]");
    for (const role of shown) line(b, c.t, c.residual[role], indices, role);
    const load = c.predicted[roles[roles.length - 1]];
    const parts = [["speed [rad/s]", c.dq], ["position [rad]", c.q], [`load, predicted [${unit}]`, load]];
    parts.forEach(([label, xs], k) => {
      const each = narrow ? width : (wide - 12) / 3 - left;
      const x = narrow ? left : left + k * (each + left);
      const y = narrow ? 408 + k * 164 : 408;
      const part = box("cloud", x, y, each, narrow ? 116 : 180, xs, extent([xs], indices), range);
      frame(part, narrow || k === 0 ? `residual [${unit}]` : "", label);
      for (const role of shown) cloud(part, xs, c.residual[role], indices, role);
    });
    if (many) sideBySide(shown, below, left, wide, narrow);
    cursor(c, shown);
    compare(c, indices);
  }

  // The residual of this joint on every log, on one scale.
  function sideBySide(shown, top, left, wide, narrow) {
    const all = data.logs.map((l, k) => [l, curves(k), l.t.map((_, row) => row)]);
    const ranges = all.map(([, c, rows]) => extent(shown.length ? shown.map((role) => c.residual[role]) : [c.tau.map(() => 0)], rows));
    const range = [Math.min(...ranges.map((r) => r[0])), Math.max(...ranges.map((r) => r[1]))];
    const each = narrow ? wide - left - 12 : (wide - 12) / data.logs.length - left;
    all.forEach(([l, c, rows], k) => {
      const [x, y] = narrow ? [left, top + 22 + 150 * k] : [left + k * (each + left), top + 22];
      const box = { kind: "log", log: k, x, y, w: each, h: 100, xs: c.t, x0: 0, x1: c.t[c.t.length - 1], y0: range[0], y1: range[1] };
      boxes.push(box);
      frame(box, fitted(`${k === state.log ? "▸ " : ""}${l.name}`, each - 60), "time [s]");
      for (const role of shown) line(box, c.t, c.residual[role], rows, role);
    });
  }

  function fitted(text, width) {
    if (ink.measureText(text).width <= width) return text;
    while (text.length > 4 && ink.measureText(`${text}…`).width > width) text = text.slice(0, -1);
    return `${text}…`;
  }

  const rms = (list, indices) => Math.sqrt(indices.reduce((sum, k) => sum + list[k] ** 2, 0) / Math.max(1, indices.length));

  // What the clicked effect does to the residual of what is seen.
  function compare(c, indices) {
    if (state.effect < 0) { share.textContent = ""; return; }
    const { name, identified } = effects[state.effect];
    const [here, changed] = [beside(), "effect"].map((role) => `${short(rms(c.residual[role], indices))} ${data.unit}`);
    const [withIt, without] = identified ? [here, changed] : [changed, here];
    const of = identified ? `the ${names.after}` : `the ${names.before}`;
    share.textContent = `${name}: residual RMS of ${data.joints[state.joint]}, in what is shown: ${of} with it ${withIt}, without it ${without}`;
  }

  function choose(k) {
    state.effect = state.effect === k ? -1 : k;
    const found = effects[state.effect];
    if (found && found.joint !== null) { state.joint = found.joint; jointBox.value = String(found.joint); }
    for (const role of roles) state.on[role] = !found || role === beside();
    names.effect = found ? `${found.identified ? names.after : names.before} ${found.identified ? "without" : "with"} ${found.name}` : "";
    [...choices.querySelectorAll("button")].forEach((b, i) => b.setAttribute("aria-pressed", String(i === state.effect)));
    marks();
    draw();
  }

  function marks() {
    toggles.replaceChildren(...["measured", ...every()].map((role) => {
      const label = document.createElement("label");
      const tick = Object.assign(document.createElement("input"), { type: "checkbox", checked: state.on[role] });
      const mark = Object.assign(document.createElement("span"), { className: `mark mark-${role}`, textContent: " " });
      tick.addEventListener("change", () => { state.on[role] = tick.checked; draw(); });
      label.append(tick, mark, ` ${names[role]}`);
      return label;
    }));
  }

  function cursor(c, shown) {
    const k = nearest(state.at);
    for (const b of boxes) {
      if (b.kind === "log" && b.log !== state.log) continue;
      ink.strokeStyle = css("accent");
      ink.lineWidth = 1;
      const x = px(b, b.xs[k]);
      if (x < b.x - 1 || x > b.x + b.w + 1) continue;
      ink.beginPath(); ink.moveTo(x, b.y); ink.lineTo(x, b.y + b.h); ink.stroke();
      if (b.kind === "cloud") for (const role of shown) {
        ink.fillStyle = css("accent");
        ink.beginPath(); ink.arc(x, py(b, c.residual[role][k]), 4, 0, 7); ink.fill();
      }
    }
    const values = shown.map((role) => `${names[role]} ${short(c.predicted[role][k])}, residual ${short(c.residual[role][k])}`);
    readout.textContent = `t ${c.t[k].toFixed(2)} s · measured ${short(c.tau[k])} ${data.unit} · ${values.join(" · ")}`;
    canvas.setAttribute("aria-label", `Curves of ${data.joints[state.joint]}. ${readout.textContent}`);
  }

  function seek(t, tell = true) {
    const end = log().t[log().t.length - 1];
    state.at = Math.min(end, Math.max(0, t));
    draw();
    if (tell) document.dispatchEvent(new CustomEvent("calib-seek", { detail: { log: log().name, time: state.at } }));
  }

  function zoom(factor, about = state.at / log().t[log().t.length - 1]) {
    const size = Math.min(1, Math.max(0.01, (state.to - state.from) * factor));
    const share = (about - state.from) / (state.to - state.from);
    state.from = Math.min(1 - size, Math.max(0, about - share * size));
    state.to = state.from + size;
    draw();
  }

  function pan(by) {
    const size = state.to - state.from;
    state.from = Math.min(1 - size, Math.max(0, state.from + by * size));
    state.to = state.from + size;
    draw();
  }

  const inside = (event) => {
    const r = canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - r.left, event.clientY - r.top];
    return [boxes.find((b) => x >= b.x && x <= b.x + b.w && y >= b.y && y <= b.y + b.h), x, y];
  };
  let held = null;

  function point(event) {
    const [b, x, y] = inside(event);
    if (!b) return;
    if (b.kind === "log") {
      if (event.type !== "click" && b.log !== state.log) return; // another log is chosen by a click, not in passing
      if (b.log !== state.log) { state.log = b.log; logBox.value = String(b.log); }
    }
    if (b.kind !== "cloud") { seek(b.x0 + ((x - b.x) / b.w) * (b.x1 - b.x0)); return; }
    const c = curves();
    const role = every().filter((r) => state.on[r]).pop();
    if (!role) return;
    let best = -1, least = 400;
    for (const k of visible()) {
      const d = (px(b, b.xs[k]) - x) ** 2 + (py(b, c.residual[role][k]) - y) ** 2;
      if (d < least) [least, best] = [d, k];
    }
    if (best >= 0) seek(c.t[best]);
  }

  canvas.addEventListener("pointerdown", (event) => { held = event.clientX; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (held === null) { point(event); return; }
    const [b] = inside(event);
    if (b && b.kind === "time") pan((held - event.clientX) / b.w);
    held = event.clientX;
  });
  canvas.addEventListener("click", point);
  canvas.addEventListener("dblclick", () => { [state.from, state.to] = [0, 1]; draw(); });
  canvas.addEventListener("wheel", (event) => {
    const [b, x] = inside(event);
    if (!b || b.kind !== "time") return;
    event.preventDefault();
    const end = log().t[log().t.length - 1];
    zoom(event.deltaY > 0 ? 1.25 : 0.8, (b.x0 + ((x - b.x) / b.w) * (b.x1 - b.x0)) / end);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const end = log().t[log().t.length - 1];
    const step = ((state.to - state.from) * end) / 100;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way) { if (event.shiftKey) pan(0.1 * way); else seek(state.at + way * step); }
    else if (event.key === "+") zoom(0.8);
    else if (event.key === "-") zoom(1.25);
    else if (event.key === "Home") { [state.from, state.to] = [0, 1]; draw(); }
    else return;
    event.preventDefault();
  });

  for (const [box, list, key] of [[jointBox, data.joints, "joint"], [logBox, data.logs.map((l) => l.name), "log"]]) {
    list.forEach((name, k) => box.append(new Option(name, String(k))));
    box.value = String(state[key]);
    box.addEventListener("change", () => { state[key] = Number(box.value); seek(Math.min(state.at, log().t[log().t.length - 1])); });
  }
  logBox.parentElement.hidden = data.logs.length < 2;
  for (const role of ["measured", ...roles, "effect"]) state.on[role] = true;
  marks();
  if (effects.length) choices.append("with and without:");
  effects.forEach((found, k) => {
    const button = Object.assign(document.createElement("button"), {
      type: "button", textContent: found.name, className: found.identified ? "identified" : "",
      title: found.identified ? "identified: the corrected arm with and without it" : "not identified: the nominal arm with and without it",
    });
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("click", () => choose(k));
    choices.append(button);
  });
  document.addEventListener("calib-time", (event) => {
    const k = data.logs.findIndex((l) => l.name === event.detail.motion);
    if (k < 0) return;
    if (k !== state.log) { state.log = k; logBox.value = String(k); }
    seek(event.detail.time, false);
  });
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
})();
