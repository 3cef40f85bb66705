// SPDX-License-Identifier: Apache-2.0
// The worker: keeps the chip running at the chosen speed and tells the page what it sees, 60 times a second at most.
"use strict";

const POST_MS = 16, WORK_MS = 12;
let chip, design, mode = "chip", clocksPerSecond = 200, corrected = false, view = 160, watched = 0;
let frames = null, frame = 0, playing = false; // of a recording: resistances [count, cells]
let latest = null, total = 0, wrong = 0, crcErrors = 0, posted = 0;
let counted = 0, since = 0, rate = 0, owed = 0, before = 0, busy = 0;

const channel = new MessageChannel();
channel.port1.onmessage = tick;
const again = () => channel.port2.postMessage(0);

function read() {
  const answer = chip.answer(), {duty, packet} = chip.inputs(answer.number);
  let off = 0;
  for (let i = 0; i < chip.cells; i++) off += answer.codes[i] !== formula(duty[i], packet[i], design);
  latest = {...answer, off, duty: duty.slice()};
  total++;
  counted++;
  wrong += off;
  crcErrors += !answer.good;
}

function load() {
  chip.ohm.set(frames.ohm.subarray(frame * chip.cells, (frame + 1) * chip.cells));
}

function clock(most, traced) {
  const from = chip.wasm.clocks(), event = chip.wasm.run(most, traced ? 1 : 0);
  if (event === FRAME) read();
  // A recording goes on with every frame that the chip begins; what it began with is in `duty` already.
  if (event === BEGUN && frames && playing) {
    frame = (frame + 1) % frames.count;
    load();
  }
  return chip.wasm.clocks() - from;
}

function many(clocks, traced) {
  while (clocks > 0) clocks -= clock(clocks, traced);
}

// Like an oscilloscope: the trace begins where the gate of the watched row opens.
function trigger() {
  const most = design.slot_clocks * (design.rows + 1);
  let run = 0;
  while (run < most && (chip.wasm.row() !== watched || chip.wasm.decision() !== 1)) run += clock(8, false);
  while (run < most && chip.wasm.decision() === 1) run += clock(1, false);
  many(view - 1, true);
}

function post(force) {
  const now = performance.now();
  if (!force && now - posted < POST_MS) return;
  if (mode === "chip" || mode === "fast") trigger();
  posted = now;
  if (now - since > 500) {
    rate = counted / (now - since) * 1000;
    counted = 0;
    since = now;
  }
  const state = {
    type: "state", latest, total, wrong, crcErrors, rate, frame: frames ? frame : -1, busy,
    clocks: chip.wasm.clocks(), row: chip.wasm.row(), decision: chip.wasm.decision(), trace: chip.trace(view),
  };
  if (latest) {
    state.read = chip.force(latest.codes, false);
    state.force = corrected ? chip.force(latest.codes, true) : state.read;
  }
  postMessage(state);
}

function tick() {
  const start = performance.now();
  if (mode === "pause") return;
  if (mode === "fast") {
    while (performance.now() - start < WORK_MS) clock(5000, false);
  } else {
    const perSecond = mode === "chip" ? design.f_clk_hz : clocksPerSecond;
    owed = Math.min(owed + perSecond * (start - before) / 1000, perSecond * 0.05);
    while (owed >= 1 && performance.now() - start < WORK_MS) owed -= clock(Math.floor(owed), mode === "slow");
  }
  before = start;
  busy = performance.now() - start;
  post(false);
  if (mode === "fast") again();
  else setTimeout(tick, 4);
}

// Read `count` frames of what presses now from a reset: the answer of `dermis run` with the same scene.
function measure(count) {
  const out = [];
  chip.wasm.reset();
  frame = 0;
  if (frames) load();
  while (out.length < count * chip.cells) {
    const event = chip.wasm.run(1e6, 0);
    if (event === BEGUN && frames) {
      frame = (frame + 1) % frames.count;
      load();
    }
    if (event === FRAME) {
      read();
      out.push(...latest.codes);
    }
  }
  return {codes: out, off: latest.off, good: latest.good};
}

// Frames a second without a pause, and the processor time of it as the wall clock has it.
function bench(count) {
  const start = performance.now();
  for (let done = total + count; total < done;) clock(1e6, false);
  return count / (performance.now() - start) * 1000;
}

const handlers = {
  async start(data) {
    design = data.design;
    chip = await Chip.make(data.wasm, design);
  },
  scene(data) {
    chip.set(data.effects, data.seed);
    corrected = data.corrected;
    view = data.view;
    watched = data.watched;
    if (!frames) chip.ohm.set(data.ohm);
    if (data.fresh) {
      chip.wasm.reset();
      wrong = total = crcErrors = 0;
      while (!latest) clock(1e6, false);
      before = since = performance.now();
      again();
    }
    post(true);
  },
  mode(data) {
    const stopped = mode === "pause";
    mode = data.mode;
    clocksPerSecond = data.clocksPerSecond;
    owed = 0;
    counted = 0;
    before = since = performance.now();
    if (stopped && mode !== "pause") again();
    post(true);
  },
  step(data) {
    if (data.unit === "frame") {
      const done = total;
      while (total === done) clock(1e6, true);
    } else many(data.unit === "row" ? design.slot_clocks : 1, true);
    post(true);
  },
  recording(data) {
    frames = data.frames;
    frame = 0;
    playing = data.playing;
    if (frames) load();
    post(true);
  },
  play(data) {
    playing = data.playing;
    if (data.frame >= 0) frame = data.frame;
    if (frames) load();
    post(true);
  },
  measure(data) { return measure(data.count); },
  bench(data) { return bench(data.count); },
};

let chain = Promise.resolve(); // one message after the other, though the first compiles the chip
onmessage = ({data}) => {
  chain = chain.then(async () => {
    const result = await handlers[data.type](data);
    if (data.id) postMessage({type: "result", id: data.id, result});
  }).catch((error) => postMessage({type: "failed", error: String(error)}));
};
