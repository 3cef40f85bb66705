# SPDX-License-Identifier: Apache-2.0
"""Whole frames: error of the codes, and of the integrators, against time a frame: every engine, effects in or out.

The work is frames of 16 x 16 resistances over the sensor's range with eight effects; the reference is 50 digits
(exact.py). Times are processor time, start of a process included where an engine starts one. Of the integrators it is
looked at how far their voltage is off, whole packets apart, which the codes have: in engine event at the end of each
gate, in the other two at every clock of it in every fifth row, given the method's own pulses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.effects import AutoTable
from dermis.engines import Result, certificate, cosim
from dermis.errors import SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict, waves
from dermis.report.verdict import Row
from tb.programs.accuracy import exact, probe
from tb.programs.accuracy.converter import EXACT, POLE, failure_row, options_with, tolerances
from tb.programs.accuracy.point import Point
from tb.programs.bench import bench_vfc
from tb.programs.bench.bench_engines import random_plan
from tb.programs.bench.bench_vfc import Circuit

WORK = "frames, eight effects"
INTEGRATORS = "frames, integrators"
EFFECTS = {
    "row_driver": True,
    "column_input": True,
    "mirror_ratio": {"ratio_error": 0.004},
    "offset_current": True,
    "integrator_bandwidth": {"gbw_hz": 5e6},
    "comparator_offset": True,
    "charge_packet": True,
    "preset_error": {"v_v": 2e-3},
}
"""All that the reference knows; values that make each of them count, or the design's."""

BUDGETS_LSB = (3.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
_MANY = 64
_EVERY = 5  # 50 digits take 0.1 s a conversion; rows are alike


SOLVERS: tuple[tuple[str, cosim.Solver], ...] = (
    ("trap, reltol 0.0001, step 1 us", cosim.Solver()),
    ("trap, reltol 0.0001, step 30 ns", cosim.Solver(t_max_step_s=30e-9)),
    ("trap, reltol 0.01", cosim.Solver(options=tolerances(1e-2))),
    ("trap, reltol 1e-06", cosim.Solver(options=tolerances(1e-6))),
    ("trap, chgtol 1e-17", cosim.Solver(options=options_with(POLE, chgtol=1e-17))),
    ("gear of order 2, reltol 0.0001", cosim.Solver(options=tolerances(1e-4, method="gear", maxord="2"))),
    ("gear of order 1, reltol 0.0001", cosim.Solver(options=tolerances(1e-4, method="gear", maxord="1"))),
    ("trap, no truncation control, step 100 ns", cosim.Solver(t_max_step_s=100e-9, options=EXACT)),
    ("trap, no truncation control, step 30 ns", cosim.Solver(t_max_step_s=30e-9, options=EXACT)),
)
"""What ngspice is told over a whole frame; the first line is what the project takes."""


@dataclass(frozen=True)
class Outcome:
    """Codes [rows, cols] of frame 0, processor seconds a frame, largest error of an integrator in volt if it has one.

    `bound` is what the run itself says of its codes: how far at most they may be off, [rows, cols].
    """

    codes: NDArray[np.int64]
    seconds: float
    volts: float | None = None
    bound: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class Method:
    """A way to get codes; a slow one runs once."""

    name: str
    setting: str
    run: Callable[[], Outcome]
    slow: bool = False


def _first(result: Result) -> NDArray[np.int64]:
    return result.codes[0].astype(np.int64)


def charge_error_v(made: Plan, w_end: NDArray[np.float64], truth: exact.Frame) -> float:
    """Largest error of the charge at the end of a gate, whole packets apart, in volt on the integrator."""
    packet = 1.0 + made.converter.packet_error
    apart = (w_end - truth.w_end) / packet
    return float(np.max(np.abs(apart - np.rint(apart)) * packet * made.converter.packet_v()))


def output_error_v(
    made: Plan, volts: NDArray[np.float64], told: NDArray[np.int64], t_edge_s: float, truth: exact.Frame
) -> float:
    """Largest error of integrator outputs at the clocks of their gates, given their own pulses; every fifth row.

    Parameters
    ----------
    made : Plan
    volts : [rows, cols, clocks] outputs in volt, at the 1st, 2nd, ... clock behind the opening of the gate
    told : [rows, cols, clocks] what the charge switch was told at the opening and at the clocks behind it
    t_edge_s : time in which a packet's current rises and falls
    truth : the frame
    """
    converter, worst = made.converter, 0.0
    packet_v = converter.packet_v()
    for row in range(0, made.rows, _EVERY):
        for c in range(made.cols):
            circuit = Circuit(
                i_in_a=float(truth.x[row, c] * converter.i0_a[c]),
                i0_a=float(converter.i0_a[c] * (1.0 + converter.packet_error[c])),
                c_int_f=float(converter.c_int_f[c]),
                f_clk_hz=converter.f_clk_hz,
                t_edge_s=t_edge_s,
                settle_clocks=0,
                t_gbw_s=float(converter.t_gbw_s[c]),
            )
            found = bench_vfc.exact_voltage(circuit, told[row, c])[1:]
            # Nothing here depends on the level: where it starts is added.
            start = 0.5 * packet_v[c] - float(converter.preset_error_v[c]) - circuit.v_start_v
            worst = max(worst, float(np.max(np.abs(volts[row, c] - found - start))))
    return worst


def recorded(made: Plan, record: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Of frame 0 of a recorded co-simulation what `output_error_v` takes: outputs in volt, and pulses."""
    timing, gate = made.timing, made.timing.gate_clocks
    time_s, v_int = waves.integrator_waves(record, made.cols)
    charge = np.array(waves.trace(record, "charge"), dtype=object)
    volts = np.empty((made.rows, made.cols, gate))
    told = np.empty((made.rows, made.cols, gate), dtype=np.int64)
    begin_s = float(record["wave0_begin_s"])
    for row in range(made.rows):
        # The analog half begins where the first row is driven.
        opens = row * timing.slot_clocks + timing.settle_clocks - timing.break_clocks
        at = begin_s + (opens + 1 + np.arange(gate)) / timing.f_clk_hz
        bits = charge[opens - 1 : opens - 1 + gate]
        for c in range(made.cols):
            volts[row, c] = np.interp(at, time_s, v_int[c])
            told[row, c] = [int(word) >> c & 1 for word in bits]
    return volts, told


def _event(made: Plan, truth: exact.Frame) -> Outcome:
    """A run too short to time is repeated."""
    result = engines.run(made)
    seconds = cpu_time.cpu_seconds(partial(engines.run, made)) / made.frames
    whole = made.engine == "event" and not made.left_out_lsb
    volts = charge_error_v(made, np.asarray(result.info["w_end"])[0], truth) if whole else None
    return Outcome(_first(result), seconds, volts)


def certified(made: Plan) -> Outcome:
    """The run with codes between which those of the chip lie: what it says of its own error."""

    def run() -> Result:
        return certificate.certify(made, engines.run(made))

    result = run()
    seconds = cpu_time.cpu_seconds(run) / made.frames
    assert result.low is not None
    assert result.high is not None
    codes = _first(result)
    bound = np.maximum(result.high[0].astype(int) - codes, codes - result.low[0].astype(int))
    return Outcome(codes, seconds, None, bound)


def _rtl(made: Plan, simulator: str, place: Path, truth: exact.Frame) -> Outcome:
    """Timed without a probe; the look at the integrators is a run of its own, whose packets have no ramps."""
    _, output, told = probe.run(made, simulator, place)
    volts = -output * made.converter.packet_v()[:, None]
    engines.run(made.part(0, 1), simulator=simulator)  # builds, so that it is not timed
    begin = cpu_time.cpu_used_s()
    result = engines.run(made, simulator=simulator)
    seconds = (cpu_time.cpu_used_s() - begin) / made.frames
    # No ramp: far below the rounding of a clock in seconds.
    return Outcome(_first(result), seconds, output_error_v(made, volts, told, 1e-30, truth))


def _cosim(made: Plan, simulator: str, solver: cosim.Solver, truth: exact.Frame) -> Outcome:
    begin = cpu_time.cpu_used_s()
    result = engines.run(made, simulator=simulator, solver=solver, record=True)
    seconds = (cpu_time.cpu_used_s() - begin) / made.frames
    volts, told = recorded(made, result.info["records"][0])
    return Outcome(_first(result), seconds, output_error_v(made, volts, told, solver.t_edge_s, truth))


def methods(work: Path, quick: bool, truth: exact.Frame) -> Iterator[Method]:
    """Every engine and setting."""
    many = random_plan(work, _MANY, "event", **EFFECTS)
    few = many.part(0, 2)
    bare = random_plan(work, _MANY, "closed")
    yield Method("closed, effects out", "none of 8 in", partial(_event, bare, truth))
    for budget in BUDGETS_LSB[1::2] if quick else BUDGETS_LSB:
        made = plan.make(replace(many.scene), None, AutoTable(budget_lsb=budget))
        text = f"budget {budget:g} LSB: {len(made.on)} of 8 in, {made.engine}"
        yield Method("auto, by budget", text, partial(_event, made, truth))
        yield Method("auto, certified bound", text, partial(certified, made))
    yield Method("event", "8 of 8 in", partial(_event, many, truth))
    for simulator, some in (("verilator", many), ("icarus", few)):
        made = replace(some, engine="rtl")
        run = partial(_rtl, made, simulator, work / f"probe_{simulator}", truth)
        yield Method(f"rtl, {simulator}", "8 of 8 in", run, slow=True)
    one = replace(many.part(0, 1), engine="cosim")
    yield Method(
        "cosim, icarus",
        "8 of 8 in, " + SOLVERS[0][0],
        partial(_cosim, one, "icarus", SOLVERS[0][1], truth),
        True,
    )
    for words, solver in SOLVERS[:1] if quick else SOLVERS:
        run = partial(_cosim, one, "verilator", solver, truth)
        yield Method("cosim, verilator", f"8 of 8 in, {words}", run, slow=True)


def measure(
    work: Path, repeat: int, quick: bool, tell: Callable[[str], None]
) -> tuple[list[Point], list[Row]]:
    """Every method `repeat` times in turns, against the reference; points of both works, and rows that gate."""
    work.mkdir(parents=True, exist_ok=True)
    tell("reference in 50 digits")
    truth = exact.frame(random_plan(work, _MANY, "event", **EFFECTS))
    chosen = list(methods(work, quick, truth))
    outcomes: list[list[Outcome]] = [[] for _ in chosen]
    rows: list[Row] = []
    for turn in range(repeat):
        for i, method in enumerate(chosen):
            if turn and method.slow:
                continue
            tell(f"{WORK}, {method.name}, {method.setting}, {turn + 1} of {repeat}")
            try:
                outcomes[i].append(method.run())
            except SimulatorError as failure:
                rows.append(failure_row(WORK, method.name, method.setting, failure))
    points, outside, certified_runs = [], 0, 0
    for method, found in zip(chosen, outcomes, strict=True):
        if not found:
            continue
        off = np.abs(found[0].codes - truth.codes)
        shown = off
        if (bound := found[0].bound) is not None:
            certified_runs += 1
            outside += int((off > bound).sum())
            shown = bound
        seconds = tuple(outcome.seconds for outcome in found)
        largest = float(shown.max())
        points.append(Point(WORK, method.name, method.setting, float(shown.mean()), "LSB", largest, seconds))
        if (volts := found[0].volts) is not None:
            points.append(
                Point(INTEGRATORS, method.name, method.setting, volts, "V", float(off.max()), seconds)
            )
    note = f"codes of the 50-digit reference outside what a certified run says, {certified_runs} budgets"
    # Nothing was judged where nothing ran.
    rows.append(verdict.judge("accuracy.outside_certified", outside if certified_runs else None, note))
    return points, rows
