# SPDX-License-Identifier: Apache-2.0
"""Engine `rtl`: the real Verilog in Verilator or Icarus with the real-number models of models/verilog.

The array is solved here and its column currents are handed over in a file; everything after the
columns is Verilog. One build serves all scenes of the same size with the same effects, since what
differs from column to column comes in at run time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.array.array import column_currents
from dermis.chip import hdl, netlist, read_out, spi_protocol
from dermis.chip.sources import listed, rtl_include_dirs, rtl_sources
from dermis.converter import course, injection, walk, walk_loops
from dermis.converter.coupling import Coupling, columns_in_gates, couples, coupling
from dermis.converter.vfc import code_type
from dermis.engines import Result, event
from dermis.errors import InputError, SimulatorError
from dermis.ndarrays import Floats
from dermis.places import ROOT
from dermis.processes import children
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES

HONOURS = netlist.HONOURS
"""Record fields that the models have, as those of SPICE: all but the random ones."""
MODELS = ROOT / "models" / "verilog"
_VALUES_AT_ONCE = 1 << 19  # currents in one file: 2048 frames of 16x16 in 4 MB

FRAME_LIMIT_S = 120.0
"""Longest wait for a further frame; 16 x 16 take 0.6 ms in Verilator and 0.5 s in Icarus."""


def refuses(plan: Plan) -> InputError | None:
    """Return the error for a plan outside the limits of the chip or of the array solve, or None."""
    return hdl.beyond_the_chip(plan) or event.refuses(plan)


def run(
    plan: Plan,
    progress: Callable[[int], None] | None = None,
    *,
    simulator: str = "verilator",
    sync_latch: bool = False,
    work: Path | None = None,
) -> Result:
    """Read every frame of a plan through the Verilog.

    Parameters
    ----------
    progress : called with the number of row slots done so far
    simulator : "verilator" or "icarus"
    sync_latch : build the chip with the flip-flop + latch synchronizer
    work : directory for the files handed over, emptied first; default one in build/rtl_runs that stays only after a
        failure

    Returns codes uint8 [frames, rows, cols].

    InputError if the chip is not made for such an array or timing; SimulatorError if the simulator failed, stopped
    answering or left no proper result.
    """
    effects, places = effect_bits(plan), value_places()
    codes = np.empty(plan.resistance_ohm.shape, dtype=code_type(plan.timing.code_max))
    values = places["VALUES"] + 2 * plan.cols if effects >> places["EACH_ROW"] & 1 else 1
    with hdl.work_directory("rtl_runs", plan, work) as files:
        for part in plan.parts(_VALUES_AT_ONCE // values):
            currents = currents_of(plan, part)
            command = build(plan, effects, currents, simulator, sync_latch)
            write_inputs(plan, part, files, currents, effects, sync_latch)

            def on_rows(done: int, before: int = part.start * plan.rows) -> None:
                if progress is not None:
                    progress(before + done)

            codes[part] = simulate(plan, command, files, part.stop - part.start, on_rows)
    return Result(codes, {"simulator": simulator})


def value_places() -> dict[str, int]:
    """Numbers of effects and run-time values, by name, from values.vh."""
    text = (MODELS / "values.vh").read_text()
    return {n: int(v) for n, v in re.findall(r"^`define DERMIS_(\w+)\s+(\d+)\b", text, re.MULTILINE)}


# Bits of the models by record field; other fields act on the column currents alone.
BUILT_FOR = {
    "gain": ("GAIN",),
    "i_offset_a": ("I_OFFSET",),
    "packet_error": ("PACKET",),
    "preset_error_v": ("W_PRESET",),
    "v_comp_offset_v": ("RISE",),
    "v_hysteresis_v": ("RISE", "FALL"),
    "t_comp_delay_s": ("DELAY",),
    "v_int_max_v": ("W_LOW", "W_PRESET"),  # the range may be too small for the preset
    "v_int_min_v": ("W_LOW", "W_PRESET"),
    "inv_gain_dc": ("LEAK",),
    "t_gbw_s": ("GBW", "LEAK"),
    "inv_i_range_a": ("I_RANGE",),
    "q_mirror_c": ("Q_MIRROR",),
}


def effect_bits(plan: Plan) -> int:
    """Return the bits of the effects that a plan needs in the models; 0 is the ideal reader."""
    places = value_places()
    names = {name for field in plan.active_fields() for name in BUILT_FOR.get(field, ())}
    if "LEAK" in names and plan.topology == "direct":
        # The load of the virtual ground differs from frame to frame, and with its neighbours from row to row.
        names |= {"EACH_ROW", "COUPLED"} if couples(plan) else {"EACH_ROW"}
    return sum(1 << places[name] for name in names)


def build(plan: Plan, effects: int, currents: Currents, simulator: str, sync_latch: bool) -> list[str]:
    """Command that runs the reader of a plan, built only if it is not there yet."""
    parameters = {
        **hdl.reader_parameters(plan, sync_latch),
        "TOPOLOGY": TOPOLOGIES.index(plan.topology),
        "EFFECTS": effects,
        "TERMS": currents.basis.shape[1],
        "DARK": currents.cells.shape[-1] // currents.basis.shape[1] - 1,
    }
    main = MODELS / ("skin_main.cpp" if simulator == "verilator" else "skin_alone.sv")
    # Listed by their paths from the root; a copy has them elsewhere.
    sources = [*rtl_sources(), *(MODELS / path.name for path in listed(MODELS / "files.f"))]
    return hdl.program(simulator, "skin", parameters, sources, [*rtl_include_dirs(), MODELS], main)


@dataclass(frozen=True, eq=False)
class Currents:
    """Column currents of some frames in units of k i0.

    Attributes
    ----------
    cells : [frames, rows, cols, terms], the input of course.sv; twice as many where a slow mirror sees a current in the
        break after a row
    basis : [1 + clocks of a slot, terms], functions of time where a row is driven, and as means over a slot's clocks;
        one term where a current is constant in its slot
    coupling : of the columns of the direct interface
    """

    cells: Floats
    basis: Floats
    coupling: Coupling | None = None


def currents_of(plan: Plan, part: slice) -> Currents:
    """Column currents of some frames; where they change in time, as engine event has them."""
    injection.check_lines(plan, part)
    converter, coupled = plan.converter, coupling(plan, part)
    if not plan.active_fields() & (course.FIELDS - {"q_mirror_c"}) and not course.has_idle_current(plan):
        most = converter.saturating_duty()
        current = column_currents(plan.network(0), plan.conductance_s(part))
        with np.errstate(over="ignore"):
            unit = np.clip(current / (converter.k * converter.i0_a), -most, most)
        return Currents(unit[..., np.newaxis], np.ones((1, 1)), coupled)
    slots = course.Slots(plan, part)
    gain = np.tile(converter.gain, slots.frames)
    # A row is followed by the break in front of the next one.
    behind = [] if slots.idle is None else [np.roll(slots.idle / gain, -1, axis=0)]
    cells = np.concatenate([slots.terms / gain, *behind], axis=1)
    cells = cells.reshape(slots.rows, -1, slots.frames, slots.cols).transpose(2, 0, 3, 1)
    basis = np.concatenate([slots.basis.begin[np.newaxis], slots.basis.mean])
    return Currents(cells, basis, coupled)


def write_inputs(
    plan: Plan, part: slice, work: Path, currents: Currents, effects: int, sync_latch: bool
) -> None:
    """Write the input of array.sv and drive.sv: big-endian words of 64 bits."""
    each = bool(effects >> value_places()["EACH_ROW"] & 1)
    values = run_time_values(plan, part, currents.coupling, each, sync_latch)
    frames = currents.cells.shape[0]
    values = values.reshape(*values.shape[:2], -1)
    if currents.coupling is not None:
        values = np.concatenate([values, currents.coupling.links.reshape(frames, plan.rows, -1)], axis=2)
    blocks = [currents.cells.reshape(frames, -1)]
    if each:
        blocks.append(values.reshape(frames, -1))
    with (work / "currents.bin").open("wb") as file:
        file.write(np.array([frames], dtype=">i8").tobytes())
        file.write(values[0, 0].astype(">f8").tobytes())
        file.write(np.concatenate(blocks, axis=1).astype(">f8").tobytes())
    if currents.basis.shape[1] > 1:
        (work / "basis.bin").write_bytes(currents.basis.astype(">f8").tobytes())


def run_time_values(
    plan: Plan, part: slice, coupled: Coupling | None, each: bool, sync_latch: bool
) -> Floats:
    """Run-time values of values.vh, [frames, rows, cols, VALUES]; without `each` those of the first row alone."""
    column_s = columns_in_gates(plan, part if each else slice(part.start, part.start + 1))
    converter, active = plan.converter, plan.active_fields()
    column = walk.cells_of(plan, np.zeros(column_s.shape), column_s, coupled)
    if not each:
        column = walk.Cells(**{name: value[:, :1] for name, value in vars(column).items()})

    # Pieces of a clock: a until the comparator is looked at or the latch opens, whichever is first; b until the
    # other; c the rest.
    sample, opens = 1.0 - column.delay, np.full_like(column.delay, 0.5 if sync_latch else 1.0)
    t_a, t_b = np.minimum(sample, opens), np.maximum(sample, opens)
    if "t_comp_delay_s" not in active:
        t_a = t_b = opens if sync_latch else np.zeros_like(opens)
    elif not sync_latch:
        t_b = t_a
    values = {
        "GAIN": converter.gain,
        "I_OFFSET": converter.i_offset_a / converter.i0_a,
        "PACKET": column.packet,
        "W_PRESET": column.w0,
        "RISE": column.rise,
        "COUPLED": converter.inv_gain_dc / (1.0 + converter.inv_gain_dc),
        "FALL": column.fall,
        "DELAY": t_a,
        "T_B": t_b,
        "SEEN_B": np.where(sample > opens, 1.0, 0.0),
        "W_LOW": column.low,
        "W_HIGH": column.high,
        "I_RANGE": converter.inv_i_range_a * converter.k * converter.i0_a,
        "Q_MIRROR": np.maximum(converter.q_mirror_c * converter.f_clk_hz / converter.i0_a, 1e-15),
    }
    rows = walk.rows_of(column, 1.0)
    modes = walk_loops.modes_of(rows.cells).reshape(2, 4, *t_a.shape)
    names = ("", "LEAK", "SLOW_"), ("FAST_", "GBW", "FAST_")
    for (name, keep_a, of_mode), (rate, drive, weight, _) in zip(names[: 1 + rows.lags], modes, strict=False):
        for piece, length in (("A", t_a), ("B", t_b - t_a), ("C", 1.0 - t_b)):
            with np.errstate(divide="ignore", invalid="ignore"):
                grown = np.where(rate == 0, length, np.expm1(rate * length) / rate)
            values[keep_a if piece == "A" else f"{name}KEEP_{piece}"] = np.exp(rate * length)
            values[f"{name}FILL_{piece}"] = drive * grown
        values |= {f"{of_mode}RATE": rate, f"{of_mode}DRIVE": drive, f"{of_mode}WEIGHT": weight}
    if rows.lags:
        values["FAST_START"], values["LAG"] = modes[1, 3], column.lag
    places = value_places()
    out = np.zeros((*column.w0.shape, places["VALUES"]))
    for name, value in values.items():
        out[..., places[name]] = value
    return out


def simulate(
    plan: Plan, command: list[str], work: Path, frames: int, on_rows: Callable[[int], None]
) -> NDArray[np.uint16]:
    """Run the reader on work/currents.bin and return its codes, [frames, rows, cols]."""
    out, log, name = work / "frames.txt", work / "simulator.log", Path(command[0]).name
    out.unlink(missing_ok=True)
    frame_bytes = spi_protocol.frame_bytes(plan.rows, plan.cols, plan.timing.code_max.bit_length())
    width = 2 * (ANSWER_BYTES + frame_bytes) + 1

    def written() -> int:
        size = out.stat().st_size if out.exists() else 0
        on_rows(min(size // width, frames) * plan.rows)
        return size

    code = children.run_child(command, work, log, FRAME_LIMIT_S, progress=written)
    if code is None:
        raise SimulatorError(f"{name} wrote no frame for {FRAME_LIMIT_S:g} s", log)
    if code != 0:
        raise SimulatorError(f"{name} ended with {children.ended(code)}", log)
    if not out.exists():
        raise SimulatorError("the simulator left no frames", log)
    return read_codes(plan, out, frames)


ANSWER_BYTES = 3
"""Bytes before a frame: token and length."""


def read_codes(plan: Plan, path: Path, frames: int) -> NDArray[np.uint16]:
    """Read the answers that the host wrote, a line a frame; return codes [frames, rows, cols].

    SimulatorError for anything but every frame once, whole and in order.
    """
    lines = path.read_text(errors="replace").split("\n")
    if lines.pop() or len(lines) != frames:
        raise SimulatorError(f"the simulator left {len(lines)} whole frames instead of {frames}", path)
    codes = []
    for frame, line in enumerate(lines):
        try:
            answer = bytes.fromhex(line)
            head, data = answer[:ANSWER_BYTES], answer[ANSWER_BYTES:]
            if head[:1] != bytes([spi_protocol.TOKEN_FRAME]) or int.from_bytes(head[1:], "big") != len(data):
                raise SimulatorError(f"the chip answers FRAME with {line[:40]}")
            codes.append(read_out.codes_of_frame(data, frame, plan.timing, plan.cols))
        except ValueError:
            said = f"frame {frame}: {line[:40]!r} is not a frame of the host protocol"
            raise SimulatorError(said, path) from None
        except SimulatorError as error:
            raise SimulatorError(f"frame {frame}: {error.what}", path) from None
    return np.array(codes)
