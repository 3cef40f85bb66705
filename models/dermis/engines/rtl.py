# SPDX-License-Identifier: Apache-2.0
"""Engine `rtl`: the real Verilog in Verilator or Icarus with the real-number models of models/verilog.

The array is solved here and its column currents are handed over in a file; everything behind the columns is
Verilog. One build serves all scenes of the same size with the same effects, since what differs from column to column
comes in at run time.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis import hdl
from dermis.array import column_currents
from dermis.design import ROOT, TOPOLOGIES
from dermis.engines import Result
from dermis.errors import SimulatorError
from dermis.lint import rtl_include_dirs, rtl_sources
from dermis.plan import Plan
from dermis.vfc import W_PRESET

Floats = NDArray[np.float64]

HONOURS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "r_trace_row_ohm",
        "r_trace_column_ohm",
        "i_leak_a",
        "v_column_offset_v",
        "g_lateral_row_s",
        "g_lateral_column_s",
        "gain",
        "i_offset_a",
        "inv_gain_dc",
        "g_in_s",
        "v_int_max_v",
        "v_int_min_v",
        "packet_error",
        "preset_error_v",
        "v_comp_offset_v",
        "v_hysteresis_v",
        "t_comp_delay_s",
    }
)

MODELS = ROOT / "models" / "verilog"

# A short gives an infinite current; at this one any converter saturates, and sums of it stay finite.
_X_MAX = 1e12
_LEAK_MAX = 1e12

_VALUES_AT_ONCE = 1 << 19
"""Currents in one file: 2048 frames of 16x16 in 4 MB."""

SLOT_LIMIT_S = 120.0
"""Longest wait for further rows; sixteen columns take 30 us a row in Verilator and 30 ms in Icarus."""


def run(
    plan: Plan,
    progress: Callable[[int], None] | None = None,
    *,
    simulator: str = "verilator",
    sync_latch: bool = False,
    work: Path | None = None,
    models: Path = MODELS,
) -> Result:
    """Read every frame of a plan through the Verilog.

    Parameters
    ----------
    plan : Plan
    progress : callable, optional
        Called with the number of row slots done so far.
    simulator : "verilator" or "icarus"
    sync_latch : build the chip with the flip-flop + latch synchronizer
    work : directory for the files handed over, emptied first; default one in build/rtl_runs that stays only after a
        failure
    models : where the real-number models are; a test gives a copy with a seeded fault

    Returns
    -------
    Result
        codes uint8 [frames, rows, cols]; info["x"] is the duty behind them.

    Raises
    ------
    SimulatorError
        The simulator failed, stopped answering or left no proper result.
    """
    places = value_places(models)
    effects = effect_bits(plan, places)
    command = build(plan, effects, simulator, sync_latch, models)
    scratch = work is None
    if work is None:
        base = ROOT / "build" / "rtl_runs"
        base.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=base, prefix=f"{plan.scene.path.stem}_"))
    else:
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
    codes = np.empty(plan.resistance_ohm.shape, dtype=np.uint8 if plan.timing.code_max < 256 else np.uint16)
    duty = np.empty(plan.resistance_ohm.shape)
    base_network = plan.network(0)
    step = max(1, _VALUES_AT_ONCE // (plan.rows * plan.cols))
    for first in range(0, plan.frames, step):
        part = slice(first, min(first + step, plan.frames))
        g = plan.conductance_s(part)
        current = column_currents(base_network, g)
        duty[part] = plan.converter.duty(current)
        write_currents(plan, work / "currents.bin", current, g, effects, places, sync_latch)
        rows = 0 if progress is None else first * plan.rows

        def on_rows(done: int, before: int = rows) -> None:
            if progress is not None:
                progress(before + done)

        codes[part] = simulate(plan, command, work, part.stop - part.start, on_rows)
    if scratch:
        shutil.rmtree(work, ignore_errors=True)
    return Result(codes, {"x": duty, "simulator": simulator})


# ---- what is built ----------------------------------------------------------------------------------------------


def value_places(models: Path = MODELS) -> dict[str, int]:
    """Numbers of effects and run-time values, by name, from values.vh."""
    text = (models / "values.vh").read_text()
    return {n: int(v) for n, v in re.findall(r"^`define DERMIS_(\w+)\s+(\d+)\b", text, re.MULTILINE)}


def effect_bits(plan: Plan, places: dict[str, int]) -> int:
    """What a plan needs built: one bit an effect; 0 is the ideal reader."""
    active = plan.active_fields()
    names = set()
    for field, name in (
        ("gain", "GAIN"),
        ("i_offset_a", "I_OFFSET"),
        ("packet_error", "PACKET"),
        ("preset_error_v", "W_PRESET"),
        ("v_comp_offset_v", "RISE"),
        ("v_hysteresis_v", "RISE"),
        ("v_hysteresis_v", "FALL"),
        ("t_comp_delay_s", "DELAY"),
        ("v_int_max_v", "W_LOW"),
        ("v_int_min_v", "W_LOW"),
        ("inv_gain_dc", "LEAK"),
    ):
        if field in active:
            names.add(name)
    if "W_LOW" in names:
        names.add("W_PRESET")  # the range may be too small for the preset
    if "LEAK" in names and plan.topology == "direct":
        names.add("EACH_FRAME")  # the whole column hangs on the virtual ground
    return sum(1 << places[name] for name in names)


def build(plan: Plan, effects: int, simulator: str, sync_latch: bool, models: Path = MODELS) -> list[str]:
    """Command that runs the reader of a plan, built only if it is not there yet."""
    parameters = {
        "ROWS": plan.rows,
        "COLS": plan.cols,
        "CODE_BITS": plan.timing.code_max.bit_length(),
        "GATE_CLOCKS": plan.timing.gate_clocks,
        "SETTLE_CLOCKS": plan.timing.settle_clocks,
        "SYNC_LATCH": int(sync_latch),
        "TOPOLOGY": TOPOLOGIES.index(plan.topology),
        "EFFECTS": effects,
    }
    main = models / ("skin_main.cpp" if simulator == "verilator" else "skin_alone.sv")
    sources = [*rtl_sources(), *model_sources(models)]
    return hdl.program(simulator, "skin", parameters, sources, [*rtl_include_dirs(), models], main)


def model_sources(models: Path = MODELS) -> list[Path]:
    """The models that models/verilog/files.f lists, in order."""
    lines = (line.split("//", 1)[0].strip() for line in (MODELS / "files.f").read_text().splitlines())
    return [models / Path(line).name for line in lines if line and not line.startswith("+")]


# ---- what goes in -----------------------------------------------------------------------------------------------


def write_currents(
    plan: Plan, path: Path, current: Floats, g: Floats, effects: int, places: dict[str, int], sync_latch: bool
) -> None:
    """Write what array.sv reads, in big-endian words of 64 bits: number of frames, run-time values, then each frame."""
    converter, frames = plan.converter, current.shape[0]
    with np.errstate(over="ignore"):
        i_column = np.clip(current / (converter.k * converter.i0_a), -_X_MAX, _X_MAX)
    values = run_time_values(plan, g, places, sync_latch)  # [frames, cols, values]
    blocks = [i_column.reshape(frames, -1)]
    if effects >> places["EACH_FRAME"] & 1:
        blocks.insert(0, values.reshape(frames, -1))
    with path.open("wb") as file:
        file.write(np.array([frames], dtype=">i8").tobytes())
        file.write(values[0].astype(">f8").tobytes())
        file.write(np.concatenate(blocks, axis=1).astype(">f8").tobytes())


def run_time_values(plan: Plan, g: Floats, places: dict[str, int], sync_latch: bool) -> Floats:
    """Run-time values of values.vh, [frames, cols, VALUES] (one frame where they are the same in all)."""
    converter = plan.converter
    packet_v = converter.packet_v()
    amplitude = 1.0 / (
        1.0 + converter.inv_gain_dc
    )  # output of the integrator over the voltage of its capacitor
    scale = packet_v * amplitude
    low, high = np.sort(
        [converter.v_sign * converter.v_int_min_v, converter.v_sign * converter.v_int_max_v], axis=0
    )
    low, high = low / scale, high / scale

    # Pieces of a clock: a until the comparator is looked at or the latch opens, whichever is first; b until the
    # other; c the rest.
    sample = 1.0 - converter.t_comp_delay_s * converter.f_clk_hz
    opens = 0.5 if sync_latch else 1.0
    t_a, t_b = np.minimum(sample, opens), np.maximum(sample, opens)
    if "t_comp_delay_s" not in plan.active_fields():
        t_a, t_b = (t_a, t_a) if sync_latch else (0.0 * t_a, 0.0 * t_a)
    elif not sync_latch:
        t_b = t_a
    length = np.array([t_a, t_b - t_a, 1.0 - t_b])
    leak = leak_a_clock(plan, g)[..., np.newaxis, :]  # [frames, 1, cols]
    with np.errstate(divide="ignore", invalid="ignore"):
        fill = np.where(leak > 0, -np.expm1(-leak * length) / leak, length)
    keep = np.exp(-leak * length)
    columns = {
        "GAIN": converter.gain,
        "I_OFFSET": converter.i_offset_a / converter.i0_a,
        "PACKET": 1.0 + converter.packet_error,
        "W_PRESET": np.clip(W_PRESET + converter.preset_error_v / packet_v, low, high),
        "RISE": (converter.v_comp_offset_v + converter.v_hysteresis_v / 2) / scale,
        "FALL": (converter.v_comp_offset_v - converter.v_hysteresis_v / 2) / scale,
        "DELAY": t_a,
        "T_B": t_b,
        "SEEN_B": np.where(sample > opens, 1.0, 0.0),
        "W_LOW": low,
        "W_HIGH": high,
        "LEAK": keep[:, 0],
        "KEEP_B": keep[:, 1],
        "KEEP_C": keep[:, 2],
        "FILL_A": fill[:, 0],
        "FILL_B": fill[:, 1],
        "FILL_C": fill[:, 2],
    }
    out = np.zeros((leak.shape[0], plan.cols, places["VALUES"]))
    for name, value in columns.items():
        out[:, :, places[name]] = value
    return out


def leak_a_clock(plan: Plan, g: Floats) -> Floats:
    """Fraction of the charge that is lost in a clock, [frames, cols] (one frame where it is the same in all)."""
    converter = plan.converter
    across = converter.g_in_s[np.newaxis]
    if plan.topology == "direct" and converter.inv_gain_dc.any():
        across = across + np.minimum(g, _LEAK_MAX).sum(axis=1)
    leak = (
        across
        * converter.inv_gain_dc
        / (1.0 + converter.inv_gain_dc)
        / converter.c_int_f
        / converter.f_clk_hz
    )
    return np.minimum(leak, _LEAK_MAX)


# ---- what comes out ---------------------------------------------------------------------------------------------


def simulate(
    plan: Plan, command: list[str], work: Path, frames: int, on_rows: Callable[[int], None]
) -> NDArray[np.uint16]:
    """Run the reader on work/currents.bin and return what it wrote, [frames, rows, cols]."""
    out, log = work / "codes.txt", work / "simulator.log"
    out.unlink(missing_ok=True)
    width = len(_line_template(plan))
    with log.open("wb") as console:
        child = subprocess.Popen(
            command,
            cwd=work,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )
    try:
        size, since = 0, time.monotonic()
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = child.wait(0.05)
                break
            now = out.stat().st_size if out.exists() else 0
            if now != size:
                size, since = now, time.monotonic()
                on_rows(min(size // width, frames * plan.rows))
            elif time.monotonic() - since > SLOT_LIMIT_S:
                raise SimulatorError(f"{Path(command[0]).name} wrote no row for {SLOT_LIMIT_S:g} s", log)
    finally:
        if child.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    if code != 0:
        raise SimulatorError(f"{Path(command[0]).name} ended with exit code {code}", log)
    on_rows(frames * plan.rows)
    return read_codes(plan, out, frames, log)


def _end_with_parent() -> None:
    """Have Linux end the child when the parent is killed: PR_SET_PDEATHSIG."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def _line_template(plan: Plan) -> str:
    """One row as skin.sv writes it: its number, then the codes from the last column to the first, in hex."""
    row_bits = max(1, (plan.rows - 1).bit_length())
    bits = plan.cols * plan.timing.code_max.bit_length()
    return "0" * -(-row_bits // 4) + " " + "0" * -(-bits // 4) + "\n"


_NIBBLE = np.full(256, 255, dtype=np.uint8)
_NIBBLE[np.frombuffer(b"0123456789abcdef", dtype=np.uint8)] = np.arange(16)


def read_codes(plan: Plan, path: Path, frames: int, log: Path) -> NDArray[np.uint16]:
    """Read what the reader wrote, [frames, rows, cols].

    Raises
    ------
    SimulatorError
        Anything but every row of every frame once, in order.
    """
    template = _line_template(plan)
    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError:
        raise SimulatorError("the simulator left no codes", log) from None
    if data.size != frames * plan.rows * len(template):
        rows = data.size / len(template)
        raise SimulatorError(f"the simulator left {rows:g} rows instead of {frames * plan.rows}", path)
    lines = data.reshape(frames * plan.rows, len(template))
    gap = template.index(" ")
    digits = _NIBBLE[np.delete(lines, [gap, len(template) - 1], axis=1)]
    if (digits > 15).any() or (lines[:, gap] != 32).any() or (lines[:, -1] != 10).any():
        at = int(np.argmax((digits > 15).any(axis=1)))
        text = lines[at].tobytes().decode(errors="replace").strip()
        raise SimulatorError(
            f"frame {at // plan.rows}, row {at % plan.rows}: {text!r} is not a row of codes", path
        )
    number = digits[:, :gap].astype(np.int64) @ 16 ** np.arange(gap - 1, -1, -1)
    if (number != np.tile(np.arange(plan.rows), frames)).any():
        at = int(np.argmax(number != np.tile(np.arange(plan.rows), frames)))
        raise SimulatorError(
            f"frame {at // plan.rows}: the chip handed over row {number[at]} in place of row {at % plan.rows}",
            path,
        )
    width = plan.timing.code_max.bit_length()
    nibbles = digits[:, gap:][:, ::-1, np.newaxis]
    bits = np.unpackbits(nibbles, axis=2, bitorder="little")[:, :, :4]
    bits = bits.reshape(len(lines), -1)[:, : plan.cols * width].reshape(frames, plan.rows, plan.cols, width)
    return (bits @ (1 << np.arange(width))).astype(np.uint16)
