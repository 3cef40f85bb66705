// SPDX-License-Identifier: Apache-2.0
// The page: what presses, what is shown, and the scene as a link and as TOML. The chip itself runs in a worker.
"use strict";

const DESIGN = /*{design}*/null;
const WASM = "/*{wasm}*/";
const WORKER = /*{worker}*/"";

const $ = (id) => document.getElementById(id);
const {rows: ROWS, cols: COLS} = DESIGN, CELLS = ROWS * COLS;
const sheet = $("sheet"), waves = $("waves");

// ---- the worker --------------------------------------------------------------------------------------------------

const worker = new Worker(URL.createObjectURL(new Blob([WORKER], {type: "text/javascript"})));
const waiting = new Map();
let asked = 0, state = null;

function ask(type, data = {}) {
  return new Promise((done) => {
    waiting.set(++asked, done);
    worker.postMessage({type, id: asked, ...data});
  });
}

worker.onmessage = ({data}) => {
  if (data.type === "result") {
    waiting.get(data.id)(data.result);
    waiting.delete(data.id);
    return;
  }
  if (data.type === "failed") return complain(`The chip stopped: ${data.error}`);
  const first = !state && data.latest;
  if (data.latest || !state) state = data;
  if (first) window.demo.firstCode = performance.now();
  draw();
};
worker.onerror = (error) => complain(`The chip stopped: ${error.message}`);

// ---- the scene ---------------------------------------------------------------------------------------------------

const start = {shape: "spherical", force_n: 9, width: 6, length: 6, center_row: 7, center_col: 8, angle_deg: 0};
let bodies = [start];       // what presses, in the words of a scene
let fingers = new Map();    // pointer -> its body
let selected = 0;           // the body that sliders and keys change
let probe = {row: 7, col: 8};
let recording = null;       // {name, unit, ohm, force, count, text}
let seed = 1;

const sliders = ["row_ohm", "column_ohm", "lateral", "offset", "mismatch", "noise", "flicker"];
const zeros = Object.fromEntries(sliders.map((name) => [name, 0]));
const presets = {
  ideal: zeros,
  typical: {...zeros, row_ohm: 1, column_ohm: 0.5, lateral: 10, offset: 0.2, mismatch: 1},
  harsh: {...zeros, row_ohm: 10, column_ohm: 5, lateral: 20, offset: 0.2, mismatch: 3},
};

// What each setting does, in words; shown in its panel while it has the focus or the pointer.
const WHAT = {
  ideal: "No loss in the wiring: every code is that of its own taxel.",
  typical: "1 Ω row drivers, 0.5 Ω columns, small offsets and mismatch: a careful board.",
  harsh: "10 Ω row drivers, 5 Ω columns: loaded rows sag, columns of offset and gain appear.",
  corrected: "From codes and known wiring the host solves for every taxel. Left as read, right corrected.",
  shape: "The body that presses. Shift and a click add one more; their forces add.",
  force: "Force on the taxel at the peak. 15 N is code 255; more stays at 255.",
  width: "Extent along a row, before the turn. Wide bodies draw more current from a row.",
  length: "Extent along a column, before the turn. Long bodies load more taxels of it.",
  angle: "Turns the body. A ridge along a row loses more than one across the rows.",
  keep: "Without the tick a touch presses as long as it lasts, as a finger does.",
  row_ohm: "In series with a row, whose whole current passes it: loaded rows read low.",
  column_ohm: "Before a converter: its column leaves 0 V, and current leaks to other rows.",
  lateral: "Conduction between neighbours: matters once columns differ in voltage.",
  offset: "Input voltage of each column: drives a current through all its taxels.",
  mismatch: "Spread of the mirrors: each column has its own gain, seen as stripes.",
  noise: "Noise of the comparators. One packet is 1 V: codes near a step move.",
  flicker: "Slow noise of the reference: all columns of a row wander together.",
  mode: "Slow shows single clocks, Chip is the rate of the silicon, Full that of the browser.",
  slow: "Clocks a second in slow motion. The row being read has an orange frame.",
  step: "Stops the chip and advances it by one clock, one row or one frame.",
  view: "Length of the waveforms, from where the gate of the pressed row opens.",
  columns: "One converter a column. The smaller the force, the rarer its charge pulses.",
  unit: "Newtons press the skin; codes stand for the resistance that gives them.",
  file: "One frame of the file for each frame of the chip, 500 a second.",
  link: "The address holds bodies, wiring and seed: all who open it see the same codes.",
  toml: "dermis run answers this file with the same codes, noise included.",
};

function wire(preset) {
  for (const name of sliders) $(name).value = preset[name];
}
const value = (id) => Number($(id).value);
// Laterals go from 10 kohm down to 100 ohm on a logarithmic slider; 0 leaves them out.
const lateralOhm = () => value("lateral") ? Number((10000 / 10 ** (value("lateral") / 20)).toPrecision(2)) : 0;
const round = (number, digits) => Number(number.toFixed(digits));

function effects() {
  const spread = (scale, pattern) => pattern.map((share) => Number((scale * share).toPrecision(9)));
  return {
    row_ohm: value("row_ohm"), column_ohm: value("column_ohm"), lateral_ohm: lateralOhm(),
    noise_v: value("noise") / 1000, flicker: value("flicker") / 100,
    offset_v: spread(value("offset") / 1000, DESIGN.offset_pattern),
    ratio_error: spread(value("mismatch") / 100, DESIGN.mismatch_pattern),
  };
}

// Pressure under a body relative to its peak, as dermis.scene.stimulus has it with one sample a taxel.
function profile(body, row, col) {
  const down = row - body.center_row, right = col - body.center_col, angle = body.angle_deg * Math.PI / 180;
  const t = (right * Math.cos(angle) + down * Math.sin(angle)) / (body.width / 2);
  const s = (down * Math.cos(angle) - right * Math.sin(angle)) / (body.length / 2);
  const edge = 1 + 1e-9, inside = body.shape === "spherical" || body.shape === "round";
  if (inside ? t * t + s * s > edge : Math.abs(t) > edge || Math.abs(s) > edge) return 0;
  if (body.shape === "triangular") return Math.max(1 - Math.abs(t), 0);
  if (body.shape === "cylindrical") return Math.sqrt(Math.max(1 - t * t, 0));
  if (body.shape === "spherical") return Math.sqrt(Math.max(1 - t * t - s * s, 0));
  return 1;
}

function forces() {
  if (recording) {
    const frame = state && state.frame >= 0 ? state.frame : 0;
    return recording.force.subarray(frame * CELLS, (frame + 1) * CELLS);
  }
  const out = new Float64Array(CELLS);
  for (const body of bodies)
    for (let i = 0; i < CELLS; i++) out[i] += body.force_n * profile(body, Math.floor(i / COLS), i % COLS);
  return out;
}

const ohms = (force) => force.map((newtons) => DESIGN.k_force_n_ohm / newtons);

function send(fresh = false) {
  worker.postMessage({type: "scene", effects: effects(), seed, corrected: $("corrected").checked,
    view: value("view"), watched: probe.row, ohm: ohms(forces()), fresh});
}

function refresh(fresh = false) {
  for (const id of Object.keys(units)) say(id);
  compare();
  send(fresh);
}

function changed() {
  refresh();
  if (!recording) history.replaceState(null, "", link());
}

// The corrected map beside the one as read, and the preset that the sliders are at.
function compare() {
  const on = $("corrected").checked, at = Object.keys(presets).find((id) => sliders.every((name) => value(name) === presets[id][name]));
  document.querySelector("main").classList.toggle("compare", on);
  for (const id of ["fixed", "before", "after"]) $(id).hidden = !on;
  for (const id of Object.keys(presets)) $(id).setAttribute("aria-pressed", id === at);
  $("story").textContent = on ? WHAT.corrected : WHAT[at] || "A wiring of your own, from the sliders below.";
}

const units = {
  force: (x) => `${x.toFixed(1)} N`, width: (x) => `${x} taxels`, length: (x) => `${x} taxels`, angle: (x) => `${x}°`,
  row_ohm: (x) => x ? `${x} Ω` : "off", column_ohm: (x) => x ? `${x} Ω` : "off",
  lateral: () => lateralOhm() ? `${lateralOhm()} Ω` : "off", offset: (x) => x ? `${x} mV` : "off",
  mismatch: (x) => x ? `${x} %` : "off", noise: (x) => x ? `${x} mV` : "off", flicker: (x) => x ? `${x} %` : "off",
  slow: () => `${clocksPerSecond()} clk/s`, at: (x) => `${x}`,
};

function say(id) {
  const text = units[id](value(id));
  document.querySelector(`output[for=${id}]`).textContent = text;
  $(id).setAttribute("aria-valuetext", text);
}

const clocksPerSecond = () => Number((10 ** value("slow")).toPrecision(2));

// ---- link and TOML -----------------------------------------------------------------------------------------------

function link() {
  const query = new URLSearchParams();
  for (const b of bodies)
    query.append("b", [b.shape, b.force_n, b.width, b.length, b.center_row, b.center_col, b.angle_deg].join(","));
  for (const name of sliders) if (value(name)) query.set(name, value(name));
  if ($("corrected").checked) query.set("corrected", "1");
  query.set("seed", seed);
  return "#" + query.toString().replaceAll("%2C", ",");
}

function follow(hash) {
  const query = new URLSearchParams(hash.replace(/^#/, ""));
  if (![...query].length) return;
  const shapes = [...$("shape").options].map((option) => option.value);
  const read = query.getAll("b").map((text) => {
    const [shape, ...numbers] = text.split(","), [force_n, width, length, center_row, center_col, angle_deg] = numbers.map(Number);
    const body = {shape, force_n, width, length, center_row, center_col, angle_deg};
    const good = shapes.includes(shape) && numbers.length === 6 && numbers.every((n) => n !== "" && Number.isFinite(Number(n)));
    return good && force_n >= 0 && width > 0 && length > 0 ? body : null;
  });
  if (read.includes(null) || read.length > 64) return complain("The link holds no scene that this page can read.");
  bodies = read;
  selected = Math.max(0, bodies.length - 1);
  for (const name of sliders) $(name).value = Number(query.get(name)) || 0;
  $("corrected").checked = query.get("corrected") === "1";
  seed = Math.min(2 ** 32 - 1, Math.max(0, Math.floor(Number(query.get("seed")) || 0)));
  controls();
}

function toml() {
  const on = effects(), text = JSON.stringify, list = (values) => `[${values.join(", ")}]`;
  const lines = ["# Saved by the demo page of dermis; answer it with: dermis run FILE", 'title = "Pressed in the browser"', "", "[stimulus]"];
  if (recording) lines.push('kind = "frames"', `file = ${text(recording.name)}`, `unit = "${recording.unit}"`, "");
  else if (!bodies.length) lines.push('kind = "uniform"', "force_n = 0.0", "");
  else lines.push('kind = "several"', "");
  for (const body of recording ? [] : bodies) {
    lines.push("[[stimulus.parts]]", 'kind = "indenter"');
    for (const [key, of] of Object.entries(body)) lines.push(`${key} = ${text(of)}`);
    lines.push("");
  }
  // Slider, effect and key of a scene, value.
  const written = [
    ["row_ohm", "row_driver", "r_ohm", on.row_ohm], ["column_ohm", "column_input", "r_ohm", on.column_ohm],
    ["lateral", "lateral", "r_ohm", on.lateral_ohm], ["offset", "column_offset", "v_v", list(on.offset_v)],
    ["mismatch", "mirror_ratio", "ratio_error", list(on.ratio_error)], ["noise", "comparator_noise", "v_v", on.noise_v],
    ["flicker", "flicker_noise", "relative", on.flicker],
  ];
  lines.push("[effects]");
  for (const [slider, effect, key, of] of written) if (value(slider)) lines.push(`${effect} = { ${key} = ${of} }`);
  lines.push("", "[run]", 'engine = "event"', `seed = ${seed}`, "");
  return lines.join("\n");
}

// ---- recordings --------------------------------------------------------------------------------------------------

const FILE_MAX = 64e6;

function parseCsv(text) {
  const lines = text.split(/\r\n|\n|\r/).map((line, at) => [line.trim(), at + 1]).filter(([line]) => line);
  if (!lines.length) throw new Error("the file is empty");
  const width = lines[0][0].split(",").length;
  if (width !== CELLS && width !== COLS)
    throw new Error(`line ${lines[0][1]} has ${width} values; a frame has ${CELLS}, a row of it ${COLS}`);
  const values = [];
  for (const [line, number] of lines) {
    const cells = line.split(",");
    if (cells.length !== width) throw new Error(`line ${number} has ${cells.length} values, the first has ${width}`);
    for (const cell of cells) {
      if (!/^\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*$/i.test(cell))
        throw new Error(`line ${number}: ${JSON.stringify(cell.trim().slice(0, 20))} is not a number`);
      values.push(Number(cell));
    }
  }
  if (values.length % CELLS) throw new Error(`${lines.length} lines are no whole frames of ${ROWS} lines`);
  return Float64Array.from(values);
}

function parseNpy(buffer) {
  const bytes = new Uint8Array(buffer), data = new DataView(buffer);
  if (String.fromCharCode(...bytes.subarray(1, 6)) !== "NUMPY") throw new Error("the file is not what numpy.save writes");
  const wide = bytes[6] > 1, length = wide ? data.getUint32(8, true) : data.getUint16(8, true), begin = (wide ? 12 : 10) + length;
  const head = String.fromCharCode(...bytes.subarray(wide ? 12 : 10, begin));
  const kind = /'descr':\s*'([<>|=])([uif])(\d)'/.exec(head), shape = /'shape':\s*\(([^)]*)\)/.exec(head);
  if (!kind || !shape) throw new Error("an npy file of integers or floating point numbers is wanted");
  if (/'fortran_order':\s*True/.test(head)) throw new Error("save the array in C order: numpy.ascontiguousarray");
  const sizes = shape[1].split(",").filter((part) => part.trim()).map(Number), size = Number(kind[3]);
  const frames = sizes.length === 2 ? 1 : sizes[0];
  if (sizes.length < 2 || sizes.length > 3 || sizes.at(-1) !== COLS || sizes.at(-2) !== ROWS || !(frames >= 1))
    throw new Error(`the array is [${sizes}]; [frames, ${ROWS}, ${COLS}] or [${ROWS}, ${COLS}] is wanted`);
  const getter = {u1: "getUint8", u2: "getUint16", u4: "getUint32", i1: "getInt8", i2: "getInt16", i4: "getInt32",
    f4: "getFloat32", f8: "getFloat64"}[kind[2] + size];
  if (kind[2] + size !== "i8" && kind[2] + size !== "u8" && !getter) throw new Error(`numbers of type ${kind[2]}${size} are not read here`);
  if (buffer.byteLength - begin < frames * CELLS * size) throw new Error("the file ends before its last frame");
  const out = new Float64Array(frames * CELLS), little = kind[1] !== ">";
  for (let i = 0; i < out.length; i++) {
    const at = begin + i * size;
    out[i] = getter ? data[getter](at, little) : Number(kind[2] === "u" ? data.getBigUint64(at, little) : data.getBigInt64(at, little));
  }
  return out;
}

async function open(file) {
  complain("");
  try {
    if (!/\.(csv|npy)$/i.test(file.name)) throw new Error("a csv or npy file is wanted");
    if (file.size > FILE_MAX) throw new Error(`at most ${FILE_MAX / 1e6} MB are read here; dermis run takes more`);
    const values = /\.csv$/i.test(file.name) ? parseCsv(await file.text()) : parseNpy(await file.arrayBuffer());
    const unit = $("unit").value, codes = unit === "codes";
    const bad = values.findIndex((v) => !(v >= 0 && Number.isFinite(v)) || (codes && (v > DESIGN.code_max || v % 1)));
    if (bad >= 0) {
      const frame = Math.floor(bad / CELLS), at = bad % CELLS;
      throw new Error(`frame ${frame}, row ${Math.floor(at / COLS)}, column ${at % COLS} is ${values[bad]}; `
        + (codes ? `a whole number 0 to ${DESIGN.code_max} is wanted` : "a force of 0 or more is wanted"));
    }
    // A code stands for the resistance whose ideal code it is.
    const unitOhm = DESIGN.v_bias_v / (DESIGN.k * DESIGN.i0_a);
    const ohm = codes ? values.map((code) => unitOhm * DESIGN.gate_clocks / code) : ohms(values);
    recording = {name: file.name, unit, ohm, force: ohm.map((r) => DESIGN.k_force_n_ohm / r), count: values.length / CELLS};
    $("at").max = recording.count - 1;
    $("player").hidden = false;
    $("play").textContent = "Hold";
    await ask("recording", {frames: {ohm, count: recording.count}, playing: true});
    changed();
  } catch (error) {
    complain(`${file.name}: ${error.message}`);
  }
}

async function close() {
  recording = null;
  $("player").hidden = true;
  $("file").value = "";
  await ask("recording", {frames: null, playing: false});
  changed();
}

function complain(text) {
  $("alert").textContent = text;
  $("alert").hidden = !text;
}

// ---- drawing -----------------------------------------------------------------------------------------------------

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const colours = {};
function theme() {
  for (const name of ["ink", "soft", "line", "grid", "panel", "integrator", "comparator", "charge", "accent", "hover"])
    colours[name] = css(`--${name}`);
  redraw();
}

// Points of viridis and, for errors, of a diverging map; between them a straight line.
const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
const DIVERGING = [[5, 72, 130], [67, 147, 195], [209, 229, 240], [247, 247, 247], [253, 219, 199], [214, 96, 77], [140, 10, 30]];
function colour(map, share) {
  const at = Math.min(Math.max(share, 0), 1) * (map.length - 1), low = Math.min(Math.floor(at), map.length - 2);
  return map[low].map((part, i) => Math.round(part + (map[low + 1][i] - part) * (at - low)));
}
const light = ([r, g, b]) => 0.2126 * (r / 255) ** 2.2 + 0.7152 * (g / 255) ** 2.2 + 0.0722 * (b / 255) ** 2.2;

function fit(canvas) {
  const scale = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const width = Math.round(box.width * scale), height = Math.round(box.height * scale);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, box.width, box.height);
  return [pen, box.width, box.height];
}

const shown = () => document.querySelector("input[name=shown]:checked").value;

function ramp() {
  const [pen, width, height] = fit($("ramp")), map = shown() === "error" ? DIVERGING : VIRIDIS;
  for (let x = 0; x < width; x++) {
    pen.fillStyle = `rgb(${colour(map, x / width)})`;
    pen.fillRect(x, 0, 1, height);
  }
  const [low, high] = {newtons: ["0", `${DESIGN.force_max_n} N`], codes: ["0", DESIGN.code_max], error: ["−2 N", "+2 N"]}[shown()];
  $("scale-low").textContent = low;
  $("scale-high").textContent = high;
}

function drawMap(canvas, truth, force) {
  const [pen, width] = fit(canvas), cell = width / COLS, kind = shown(), {codes} = state.latest, texts = [];
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.font = `${Math.max(9.5, Math.min(13, cell * 0.36))}px system-ui, "DejaVu Sans", sans-serif`;
  for (let i = 0; i < CELLS; i++) {
    const x = i % COLS * cell, y = Math.floor(i / COLS) * cell, newtons = force[i], off = newtons - Math.min(truth[i], DESIGN.force_max_n);
    const paint = kind === "error" ? colour(DIVERGING, 0.5 + off / 4)
      : colour(VIRIDIS, kind === "codes" ? codes[i] / DESIGN.code_max : newtons / DESIGN.force_max_n);
    pen.fillStyle = `rgb(${paint})`;
    pen.fillRect(x + 0.5, y + 0.5, cell - 1, cell - 1);
    if (cell < 20) continue;
    const number = kind === "newtons" ? newtons : off;
    const text = kind === "codes" ? codes[i] || "" : Math.abs(number) >= 0.05 ? number.toFixed(1) : "";
    if (text) texts.push([text, x + cell / 2, y + cell / 2 + 0.5, paint]);
  }
  outlines(pen, cell, kind === "error");
  // Each number has a border of its taxel's colour, so that no outline runs through it.
  pen.lineWidth = 5;
  pen.lineJoin = "round";
  for (const [text, x, y, paint] of texts) {
    pen.strokeStyle = `rgb(${paint})`;
    pen.strokeText(text, x, y);
    pen.fillStyle = light(paint) > 0.18 ? "#000000" : "#ffffff";
    pen.fillText(text, x, y);
  }
  return [pen, width, cell];
}

const worst = (truth, force) => force.reduce((most, newtons, i) =>
  truth[i] <= DESIGN.force_max_n ? Math.max(most, Math.abs(newtons - truth[i])) : most, 0);

function drawSheet(truth) {
  const corrected = $("corrected").checked, [pen, width, cell] = drawMap(sheet, truth, state.read), {row} = state;
  if (corrected) {
    drawMap($("fixed"), truth, state.force);
    $("before").textContent = `As read: at most ${worst(truth, state.read).toFixed(2)} N off`;
    $("after").textContent = `Corrected: at most ${worst(truth, state.force).toFixed(2)} N off`;
  }
  if (modeNow() === "pause" || modeNow() === "slow") {
    pen.strokeStyle = "#ff7b1c";
    pen.lineWidth = 3;
    if (row >= 0) pen.strokeRect(1.5, row * cell + 1.5, width - 3, cell - 3);
  }
  pen.strokeStyle = shown() === "error" ? "#14181f" : "#ffffff";
  pen.lineWidth = 2;
  pen.strokeRect(probe.col * cell + 1, probe.row * cell + 1, cell - 2, cell - 2);
  const i = probe.row * COLS + probe.col, {codes} = state.latest;
  $("probe").textContent = `Row ${probe.row}, column ${probe.col}: code ${codes[i]}, ${state.read[i].toFixed(2)} N read, `
    + `${corrected ? `${state.force[i].toFixed(2)} N corrected, ` : ""}${truth[i].toFixed(2)} N there`;
}

function outlines(pen, cell, dark) {
  pen.lineWidth = 2;
  pen.setLineDash([5, 4]);
  if (!recording) bodies.forEach((body, n) => {
    pen.save();
    pen.translate((body.center_col + 0.5) * cell, (body.center_row + 0.5) * cell);
    pen.rotate(body.angle_deg * Math.PI / 180);
    const w = body.width * cell / 2, l = body.length * cell / 2;
    pen.beginPath();
    if (body.shape === "spherical" || body.shape === "round") pen.ellipse(0, 0, w, l, 0, 0, 7);
    else pen.rect(-w, -l, 2 * w, 2 * l);
    pen.strokeStyle = dark ? "#14181f" : n === selected ? "#ffffff" : "#c8c8c8";
    pen.stroke();
    pen.restore();
  });
  pen.setLineDash([]);
}

function polyline(pen, paint, points) {
  pen.strokeStyle = paint;
  pen.beginPath();
  for (const point of points) pen.lineTo(...point);
  pen.stroke();
}

const chosen = () => [...document.querySelectorAll("#columns input:checked")].map((box) => Number(box.value));

function drawWaves() {
  const [pen, width, height] = fit(waves), {trace} = state, n = trace.comp.length, columns = chosen(), clocks = [...Array(n).keys()];
  const left = 54, right = 8, top = 18, plot = width - left - right, x = (i) => left + plot * i / Math.max(1, n - 1);
  pen.font = '12px system-ui, "DejaVu Sans", sans-serif';
  pen.textBaseline = "middle";
  // The scan: which row is driven, and where the gate is open.
  pen.textAlign = "center";
  let from = 0;
  for (let i = 1; i <= n; i++) {
    if (i < n && trace.row[i] === trace.row[from] && trace.preset[i] === trace.preset[from]) continue;
    pen.fillStyle = trace.preset[from] ? colours.grid : colours.hover;
    pen.fillRect(x(from), 0, x(i) - x(from), top - 3);
    const text = trace.row[from] > ROWS ? "" : trace.preset[from] ? `row ${trace.row[from]} settles` : `row ${trace.row[from]} counts`;
    if (pen.measureText(text).width + 6 < x(i) - x(from)) {
      pen.fillStyle = colours.soft;
      pen.fillText(text, (x(from) + x(i)) / 2, (top - 3) / 2);
    }
    from = i;
  }
  if (!columns.length) {
    pen.fillStyle = colours.soft;
    pen.fillText("Choose a column below.", width / 2, height / 2);
    return;
  }
  const lane = (height - top - 16) / columns.length;
  columns.forEach((column, k) => {
    const y0 = top + k * lane, analog = lane * 0.56, digital = lane * 0.13;
    const volts = (v) => y0 + 8 + (1.25 - v) / 2.5 * analog; // +-1.25 V
    pen.lineWidth = 1;
    polyline(pen, colours.grid, [[left, volts(0)], [width - right, volts(0)]]);
    pen.textAlign = "left";
    pen.fillStyle = colours.ink;
    pen.font = 'bold 13px system-ui, "DejaVu Sans", sans-serif';
    pen.fillText(`col ${column}`, 2, y0 + 9);
    pen.font = '12px system-ui, "DejaVu Sans", sans-serif';
    pen.textAlign = "right";
    pen.fillStyle = colours.soft;
    pen.fillText("0 V", left - 5, volts(0));
    pen.lineWidth = n > 700 ? 1 : 1.6;
    // Stored charge drives the output down; one packet is packet_v.
    const output = (i) => Math.max(-1.25, Math.min(1.25, -trace.v[i * COLS + column] * DESIGN.packet_v));
    polyline(pen, colours.integrator, clocks.map((i) => [x(i), volts(output(i))]));
    for (const [bits, paint, y] of [[trace.comp, colours.comparator, y0 + 10 + analog], [trace.charge, colours.charge, y0 + 14 + analog + digital]]) {
      const level = (i) => y + (bits[i] >> column & 1 ? 0 : digital - 2);
      polyline(pen, paint, clocks.flatMap((i) => [[x(i), level(i)], [x(Math.min(i + 1, n - 1)), level(i)]]));
    }
  });
  pen.fillStyle = colours.soft;
  pen.textAlign = "right";
  const us = n / DESIGN.f_clk_hz * 1e6;
  pen.fillText(`${n} clocks, ${us.toFixed(us < 100 ? 1 : 0)} µs of the chip's time`, width - right, height - 7);
}

let bytesDrawn = 0;
function drawBytes() {
  const now = performance.now();
  if (now - bytesDrawn < 120 && modeNow() !== "pause") return; // a reader follows eight a second
  bytesDrawn = now;
  const {bytes, good, number, crc, found} = state.latest;
  const hex = (from, to) => [...bytes.subarray(from, to)].map((byte) => byte.toString(16).padStart(2, "0").toUpperCase()).join(" ");
  const each = DESIGN.code_max > 255 ? 2 : 1, overflow = 1 + COLS * each, slot = overflow + Math.ceil(COLS / 8);
  const line = (...parts) => `<p>${parts.map(([tag, text]) => `<${tag}>${text}</${tag}>`).join("")}</p>`;
  const lines = [line(["b", "token"], ["span", hex(0, 1)], ["b", "length"], ["span", hex(1, 3)],
    ["b", "format, flags, number, columns, bits, gate"], ["span", hex(3, 11)])];
  for (let r = 0; r < ROWS; r++) {
    const at = 11 + r * slot, parts = [];
    for (let from = at + 1; from < at + overflow; from += 8) parts.push(["i", hex(from, Math.min(from + 8, at + overflow))]);
    lines.push(line(["b", `row ${hex(at, at + 1)}`], ...parts, ["b", "overflow"], ["span", hex(at + overflow, at + slot)]));
  }
  const end = 11 + ROWS * slot, four = (n) => n.toString(16).padStart(4, "0").toUpperCase();
  lines.push(line(["b", "CRC-16"], ["span", hex(end, end + 2)], ["b", "computed here"], ["span", four(crc)]));
  $("bytes").innerHTML = lines.join("");
  $("verdict").textContent = good ? `frame ${number}: CRC ${four(found)} is right` : `frame ${number}: CRC is wrong`;
  $("verdict").className = good ? "badge good" : "badge bad";
}

let drawing = 0;
function draw() {
  if (!drawing) drawing = requestAnimationFrame(paint);
}
function redraw() {
  ramp();
  draw();
}

function paint() {
  drawing = 0;
  if (!state || !state.latest) return;
  const truth = forces();
  if (recording && document.activeElement !== $("at")) {
    $("at").value = state.frame;
    say("at");
  }
  drawSheet(truth);
  drawWaves();
  drawBytes();
  // Rounding alone costs half a code.
  const most = worst(truth, state.force);
  $("error").textContent = `${most.toFixed(2)} N`;
  $("error").className = most <= DESIGN.force_max_n / DESIGN.code_max ? "good" : "bad";
  $("rate").textContent = modeNow() === "pause" ? "paused" : modeNow() === "slow" ? "slow" : Math.round(state.rate);
  const noisy = value("noise") > 0;
  $("wrong").textContent = `${state.latest.off} of ${CELLS}${noisy && state.latest.off ? ", by noise" : ""}`;
  $("wrong").className = !state.latest.off ? "good" : noisy ? "" : "bad";
  $("crc").textContent = state.crcErrors ? `${state.total - state.crcErrors} of ${state.total}` : `all ${state.total}`;
  $("crc").className = state.crcErrors ? "bad" : "good";
  const d = state.decision, row = state.row < 0 ? "between two rows" : `row ${state.row}`;
  $("where").textContent = `Clock ${state.clocks}, ${row}, ${d > 1 ? `decision ${d} of ${DESIGN.gate_clocks}` : "settling"}. `
    + `The chip itself takes ${(1e6 / DESIGN.f_clk_hz).toFixed(1)} µs a clock and reads ${DESIGN.frames_per_s} frames a second.`;
}

// ---- input -------------------------------------------------------------------------------------------------------

const modeNow = () => document.querySelector("input[name=mode]:checked").value;
const limit = (at, most) => Math.min(Math.max(at, 0), most - 1);
const grid = (number) => round(number, 2);

function place(event) {
  const box = sheet.getBoundingClientRect();
  return {center_col: grid((event.clientX - box.left) / box.width * COLS - 0.5),
    center_row: grid((event.clientY - box.top) / box.height * ROWS - 0.5)};
}

function made(at) {
  return {shape: $("shape").value, force_n: value("force"), width: value("width"), length: value("length"), ...at, angle_deg: value("angle")};
}

function look(at) {
  const {row} = probe;
  probe = {row: limit(Math.round(at.center_row), ROWS), col: limit(Math.round(at.center_col), COLS)};
  if (probe.row !== row) send(); // the waveforms are those of its row
}

sheet.addEventListener("pointerdown", (event) => {
  if (recording) return;
  event.preventDefault();
  sheet.focus();
  sheet.setPointerCapture(event.pointerId);
  if (!fingers.size && !event.shiftKey) bodies = [];
  const body = made(place(event));
  bodies = [...bodies, body].slice(-64);
  selected = bodies.length - 1;
  fingers.set(event.pointerId, body);
  look(body);
  changed();
});
sheet.addEventListener("pointermove", (event) => {
  const body = fingers.get(event.pointerId), at = place(event);
  look(at);
  if (body) {
    Object.assign(body, at);
    changed();
  } else draw();
});
function lift(event) {
  const body = fingers.get(event.pointerId);
  if (!fingers.delete(event.pointerId) || $("keep").checked) return;
  bodies = bodies.filter((other) => other !== body);
  selected = Math.max(0, bodies.length - 1);
  changed();
}
sheet.addEventListener("pointerup", lift);
sheet.addEventListener("pointercancel", lift);
sheet.addEventListener("wheel", (event) => {
  event.preventDefault();
  harder(event.deltaY < 0 ? 0.5 : -0.5);
}, {passive: false});

function harder(by) {
  $("force").value = value("force") + by;
  edit();
}

sheet.addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 0.25 : 1, moves = {ArrowUp: [-step, 0], ArrowDown: [step, 0], ArrowLeft: [0, -step], ArrowRight: [0, step]};
  if (moves[event.key]) {
    const [down, right] = moves[event.key], body = bodies[selected];
    const from = body && !recording ? body : {center_row: probe.row, center_col: probe.col};
    const at = {center_row: grid(limit(from.center_row + down, ROWS)), center_col: grid(limit(from.center_col + right, COLS))};
    look(at);
    if (body && !recording) {
      bodies[selected] = {...body, ...at};
      changed();
    } else draw();
  } else if (event.key === "Enter" || event.key === " ") {
    if (!recording) bodies = bodies.length ? [] : [made({center_row: probe.row, center_col: probe.col})];
    selected = 0;
    changed();
  } else if (event.key === "+" || event.key === "=") harder(0.5);
  else if (event.key === "-") harder(-0.5);
  else return;
  event.preventDefault();
});

// Sliders of the indenter follow the selected body and change it.
function edit() {
  const body = bodies[selected];
  if (body && !recording) bodies[selected] = made({center_row: body.center_row, center_col: body.center_col});
  changed();
}
function controls() {
  const body = bodies[selected];
  if (body) {
    $("shape").value = body.shape;
    for (const [id, of] of [["force", body.force_n], ["width", body.width], ["length", body.length], ["angle", body.angle_deg]]) $(id).value = of;
  }
}

for (const id of ["shape", "force", "width", "length", "angle"]) $(id).addEventListener("input", edit);
for (const id of [...sliders, "view"]) $(id).addEventListener("input", changed);
$("corrected").addEventListener("input", () => {
  // A wiring without a loss has nothing to correct.
  if ($("corrected").checked && !sliders.some(value)) wire(presets.harsh);
  const kind = $("corrected").checked ? "error" : "newtons";
  document.querySelector(`input[name=shown][value=${kind}]`).checked = true;
  ramp();
  changed();
});
for (const panel of document.querySelectorAll(".panel:has(.what)"))
  for (const kind of ["focusin", "pointerover", "input"])
    panel.addEventListener(kind, ({target}) => {
      const field = target.closest(".field, .check, .segments, .columns, .drop, button, label"), control = field?.querySelector("input, select") ?? field;
      const name = control?.closest(".columns") ? "columns" : control?.dataset.step ? "step" : control?.name || control?.id;
      if (WHAT[name]) panel.querySelector(".what").textContent = WHAT[name];
    });
for (const [id, preset] of Object.entries(presets))
  $(id).addEventListener("click", () => {
    wire(preset);
    changed();
  });
$("clear").addEventListener("click", () => {
  bodies = [];
  changed();
});
for (const box of document.querySelectorAll("input[name=shown]")) box.addEventListener("change", redraw);

function speed() {
  say("slow");
  worker.postMessage({type: "mode", mode: modeNow(), clocksPerSecond: clocksPerSecond()});
}
for (const box of document.querySelectorAll("input[name=mode]")) box.addEventListener("change", speed);
$("slow").addEventListener("input", speed);
for (const button of document.querySelectorAll("[data-step]"))
  button.addEventListener("click", () => {
    document.querySelector("input[name=mode][value=pause]").checked = true;
    speed();
    worker.postMessage({type: "step", unit: button.dataset.step});
  });

function save(name, text) {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(new Blob([text], {type: "text/plain"}));
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
}
$("toml").addEventListener("click", () => save("pressed.toml", toml()));
$("link").addEventListener("click", async () => {
  const button = $("link");
  try {
    await navigator.clipboard.writeText(location.href);
    button.textContent = "Copied";
  } catch {
    button.textContent = "Copy it from the address bar";
  }
  setTimeout(() => { button.textContent = "Copy link"; }, 2000);
});

$("file").addEventListener("change", () => $("file").files[0] && open($("file").files[0]));
for (const name of ["dragover", "dragleave", "drop"])
  document.addEventListener(name, (event) => {
    event.preventDefault();
    document.body.classList.toggle("over", name === "dragover");
    if (name === "drop" && event.dataTransfer.files[0]) open(event.dataTransfer.files[0]);
  });
function play(playing, frame) {
  $("play").textContent = playing ? "Hold" : "Play";
  worker.postMessage({type: "play", playing, frame});
}
$("play").addEventListener("click", () => play($("play").textContent === "Play", -1));
$("at").addEventListener("input", () => {
  say("at");
  play(false, value("at"));
});
$("close").addEventListener("click", close);

// ---- begin -------------------------------------------------------------------------------------------------------

$("sheet-title").textContent = `Skin, ${ROWS} \u00d7 ${COLS}`;
sheet.setAttribute("aria-label", `The skin, ${ROWS} by ${COLS} taxels`);
$("force").max = DESIGN.force_max_n;
for (const id of ["width", "length"]) $(id).max = Math.max(ROWS, COLS);
[...$("view").options].slice(-2).forEach((option, i) => { option.textContent = (i + 1) * DESIGN.slot_clocks; });
for (let c = 0; c < COLS; c++) {
  const label = document.createElement("label"), box = document.createElement("input"), text = document.createElement("span");
  Object.assign(box, {type: "checkbox", value: c, checked: [6, 8, 10].includes(c)});
  box.setAttribute("aria-label", `Column ${c}`);
  box.addEventListener("change", () => {
    if (chosen().length > 4) box.checked = false;
    draw();
  });
  text.textContent = c;
  label.append(box, text);
  $("columns").append(label);
}
$("build").textContent = DESIGN.build;
document.body.classList.toggle("inside", window.top !== window); // the page around it says what this is
for (const panel of document.querySelectorAll(".panel:has(.what)")) panel.querySelector(".what").textContent = WHAT[panel.dataset.what];
window.addEventListener("hashchange", () => {
  follow(location.hash);
  changed();
});
window.addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);

// For scripts and tests: what `dermis run` of toml() must answer, and the speed of this browser.
window.demo = {
  toml, link, ask,
  async codes(frames = 1) {
    send();
    return ask("measure", {count: frames});
  },
  bench: (frames = 500) => ask("bench", {count: frames}),
  state: () => state,
};

(async () => {
  const bytes = Uint8Array.from(atob(WASM), (letter) => letter.charCodeAt(0));
  worker.postMessage({type: "start", design: DESIGN, wasm: bytes});
  theme();
  follow(location.hash);
  refresh(true);
})();
