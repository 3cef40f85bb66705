// SPDX-License-Identifier: Apache-2.0
// The compiled chip as an object: settings in, frames out. Runs in a worker; no part of the page is used here.
"use strict";

const FRAME = 1, BEGUN = 2; // what run() returns: a frame was read; a frame has begun

class Chip {
  // design: values of models/design.toml, as the build writes them into the page.
  static async make(bytes, design) {
    const nothing = () => 0; // the C library may ask for files; nothing here opens one
    const system = {fd_close: nothing, fd_seek: nothing, fd_write: nothing};
    const {instance} = await WebAssembly.instantiate(bytes, {wasi_snapshot_preview1: system});
    instance.exports._initialize();
    instance.exports.reset(); // takes its memory now: views of it would be lost when it grows
    return new Chip(instance.exports, design);
  }

  constructor(wasm, design) {
    const memory = wasm.memory.buffer, cells = design.rows * design.cols;
    const floats = (at, length) => new Float64Array(memory, at, length);
    this.wasm = wasm;
    this.design = design;
    this.cells = cells;
    this.settings = floats(wasm.settings(), 8);
    this.gain = floats(wasm.gain(), design.cols);
    this.offset = floats(wasm.offset_v(), design.cols);
    this.ohm = floats(wasm.resistance_ohm(), cells);
    this.measured = floats(wasm.measured(), cells);
    this.ohm.fill(Infinity);
    this.gain.fill(1);
  }

  set(effects, seed) {
    const d = this.design;
    this.settings.set([
      d.v_bias_v, d.k * d.i0_a, effects.row_ohm, effects.column_ohm,
      effects.lateral_ohm > 0 ? 1 / effects.lateral_ohm : 0, effects.noise_v / d.packet_v, effects.flicker, seed,
    ]);
    for (let c = 0; c < d.cols; c++) {
      this.gain[c] = 1 + effects.ratio_error[c];
      this.offset[c] = effects.offset_v[c];
    }
  }

  // The latest answer on the SPI pins: its bytes, and what they say.
  answer() {
    const bytes = new Uint8Array(this.wasm.memory.buffer, this.wasm.answer(), this.wasm.answer_bytes()).slice();
    return {bytes, ...parse(bytes, this.design)};
  }

  // Duties and packets that a frame was made from.
  inputs(number) {
    const of = (at) => new Float64Array(this.wasm.memory.buffer, at, this.cells);
    return {duty: of(this.wasm.duty(number)), packet: of(this.wasm.packet(number))};
  }

  // Force in newtons of codes: by the ideal law, or with what the array takes put back.
  force(codes, corrected) {
    const d = this.design, unit = d.k * d.i0_a;
    const force = new Float64Array(this.cells);
    for (let i = 0; i < this.cells; i++) this.measured[i] = codes[i] / d.gate_clocks;
    if (corrected) this.wasm.correct(d.sweeps);
    for (let i = 0; i < this.cells; i++) {
      force[i] = d.k_force_n_ohm * (corrected ? this.measured[i] : this.measured[i] * unit / d.v_bias_v);
    }
    return force;
  }

  // The last `clocks` of the trace, oldest first.
  trace(clocks) {
    const {wasm, design} = this, length = wasm.trace_length(), end = wasm.clocks();
    const n = Math.min(clocks, length, end), from = (end - n) % length, first = Math.min(n, length - from);
    // Of a ring of `each` numbers a clock, the part up to its end and the part from its begin.
    const part = (Kind, at, each = 1) => {
      const ring = new Kind(wasm.memory.buffer, at, length * each), out = new Kind(n * each);
      out.set(ring.subarray(from * each, (from + first) * each));
      out.set(ring.subarray(0, (n - first) * each), first * each);
      return out;
    };
    return {
      end, v: part(Float32Array, wasm.trace_v(), design.cols), comp: part(Uint32Array, wasm.trace_comp()),
      charge: part(Uint32Array, wasm.trace_charge()), row: part(Uint8Array, wasm.trace_row()),
      preset: part(Uint8Array, wasm.trace_preset()),
    };
  }
}

// CRC-16/CCITT-FALSE.
function crc16(bytes, from, to) {
  let crc = 0xffff;
  for (let i = from; i < to; i++) {
    crc ^= bytes[i] << 8;
    for (let bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? (crc << 1 ^ 0x1021) & 0xffff : crc << 1;
  }
  return crc;
}

// What an answer of the SPI says: token, length, header, slots of number, codes and overflow bits, CRC (docs/spi.md).
function parse(bytes, design) {
  const head = 3, {rows, cols} = design, each = design.code_max > 255 ? 2 : 1, slot = 1 + cols * each + Math.ceil(cols / 8);
  const end = head + 8 + rows * slot;
  const codes = new Uint16Array(rows * cols);
  if (bytes[0] !== 0x3c || bytes.length !== end + 2) return {good: false, number: 0, codes, crc: 0, found: 0};
  for (let r = 0; r < rows; r++) {
    const at = head + 8 + r * slot;
    for (let c = 0; c < cols; c++) {
      const from = at + 1 + c * each;
      codes[bytes[at] * cols + c] = each === 2 ? bytes[from] << 8 | bytes[from + 1] : bytes[from];
    }
  }
  const crc = crc16(bytes, head, end), found = bytes[end] << 8 | bytes[end + 1];
  return {good: crc === found, number: bytes[head + 2] << 8 | bytes[head + 3], codes, crc, found};
}

// The code that charge balance gives: packets of `packet` paid for by `duty` in the gate, at most one in two clocks.
function formula(duty, packet, design) {
  const gate = design.gate_clocks;
  let ones;
  if (!(duty > 0)) return 0;
  if (2 * duty <= packet) ones = Math.floor((gate * duty - 0.5) / packet) + 1;
  else {
    const first = Math.max(1, Math.ceil(0.5 / duty));
    ones = first > gate ? 0 : Math.floor((gate - first) / 2) + 1;
  }
  return Math.min(design.code_max, Math.max(0, ones));
}
