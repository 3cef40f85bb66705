# SPDX-License-Identifier: Apache-2.0
"""Whole frames: error of the codes, and of the integrators, against time a frame, for every engine.

Frames of 16 x 16 resistances over the sensor's range with eight effects; the reference has 50
digits (tb/reference/frame.py). Times are processor time, start of a process included. The error of
an integrator is that of its voltage, whole packets apart, given the method's own pulses: in event
at the end of each gate, in rtl and cosim at every clock of it in every fifth row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.chip import netlist
from dermis.effects import AutoTable
from dermis.engines import Result, certificate, cosim
from dermis.errors import InputError, SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict, waves
from dermis.report.verdict import Row
from dermis.scene import scene
from tb.programs.accuracy import converter
from tb.programs.bench import circuit as circuits
from tb.programs.bench import measure
from tb.programs.bench.circuit import Circuit
from tb.programs.bench.measure import Method, Outcome, Point, cpu_once, random_plan
from tb.reference import frame as reference

WORK = "frames, eight effects"
INTEGRATORS = "frames, integrators"
CHANNEL = "one channel, SKY130 transistors"
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
"""The effects of the reference, each with a value that changes codes."""

BUDGETS_LSB = (3.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
_MANY = 64
_EVERY = 5  # 50 digits take 0.1 s a conversion, and rows are alike


def solvers() -> dict[str, cosim.Solver]:
    """Return solver settings for a whole frame by name, the project's own first."""

    def gear(order: int) -> cosim.Solver:
        return cosim.Solver(options=converter.tolerances(1e-4, method="gear", maxord=str(order)))

    return {
        "trap, reltol 0.0001, step 1 us": cosim.Solver(),
        "trap, reltol 0.0001, step 30 ns": cosim.Solver(t_max_step_s=30e-9),
        "trap, reltol 0.01": cosim.Solver(options=converter.tolerances(1e-2)),
        "trap, reltol 1e-06": cosim.Solver(options=converter.tolerances(1e-6)),
        "trap, chgtol 1e-17": cosim.Solver(options=converter.options_with(converter.POLE, chgtol=1e-17)),
        "gear of order 2, reltol 0.0001": gear(2),
        "gear of order 1, reltol 0.0001": gear(1),
        "trap, no truncation control, step 100 ns": cosim.Solver(
            t_max_step_s=100e-9, options=converter.EXACT
        ),
        "trap, no truncation control, step 30 ns": cosim.Solver(t_max_step_s=30e-9, options=converter.EXACT),
    }


# ---- integrators ------------------------------------------------------------------------------------------------


def charge_error_v(made: Plan, w_end: NDArray[np.float64], truth: reference.Frame) -> float:
    """Return the largest error of the charge at the end of a gate, whole packets apart, in volt."""
    packet = 1.0 + made.converter.packet_error
    apart = (w_end - truth.w_end) / packet
    return float(np.max(np.abs(apart - np.rint(apart)) * packet * made.converter.packet_v()))


def output_error_v(
    made: Plan, volts: NDArray[np.float64], told: NDArray[np.int64], t_edge_s: float, truth: reference.Frame
) -> float:
    """Return the largest error of integrator outputs at the clocks of their gates; every fifth row.

    Parameters
    ----------
    made : Plan
    volts : [rows, cols, clocks] outputs in volt, at the 1st, 2nd, ... clock after the opening of the gate
    told : [rows, cols, clocks] states of the charge switch at the opening and at the clocks after it
    t_edge_s : rise and fall time of a packet's current
    truth : the frame
    """
    converter_, worst = made.converter, 0.0
    packet_v = converter_.packet_v()
    for row in range(0, made.rows, _EVERY):
        for c in range(made.cols):
            circuit = Circuit(
                i_in_a=float(truth.x[row, c] * converter_.i0_a[c]),
                i0_a=float(converter_.i0_a[c] * (1.0 + converter_.packet_error[c])),
                c_int_f=float(converter_.c_int_f[c]),
                f_clk_hz=converter_.f_clk_hz,
                t_edge_s=t_edge_s,
                settle_clocks=0,
                t_gbw_s=float(converter_.t_gbw_s[c]),
            )
            found = circuits.exact_voltage(circuit, told[row, c])[1:]
            # The solution does not depend on the level: the start is added.
            start = 0.5 * packet_v[c] - float(converter_.preset_error_v[c]) - circuit.v_start_v
            worst = max(worst, float(np.max(np.abs(volts[row, c] - found - start))))
    return worst


def recorded(made: Plan, record: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return outputs in volt and pulses of frame 0 of a recorded co-simulation, as `output_error_v`
    takes them.
    """
    timing, gate = made.timing, made.timing.gate_clocks
    time_s, v_int = waves.integrator_waves(record, made.cols)
    charge = waves.trace(record, "charge")
    volts = np.empty((made.rows, made.cols, gate))
    told = np.empty((made.rows, made.cols, gate), dtype=np.int64)
    begin_s = float(record["wave0_begin_s"])
    for row in range(made.rows):
        # The analog part begins when the first row is driven.
        opens = row * timing.slot_clocks + timing.settle_clocks - timing.break_clocks
        at = begin_s + (opens + 1 + np.arange(gate)) / timing.f_clk_hz
        for c in range(made.cols):
            volts[row, c] = np.interp(at, time_s, v_int[c])
            told[row, c] = [word >> c & 1 for word in charge[opens - 1 : opens - 1 + gate]]
    return volts, told


# ---- methods ----------------------------------------------------------------------------------------------------


class Frames:
    """Methods on frames with a known result, and the codes outside the bounds of certified runs."""

    def __init__(self, work: Path, truth: reference.Frame) -> None:
        self.work, self.truth = work, truth
        self.certified = self.outside = 0

    def outcome(self, codes: NDArray[Any], seconds: float, volts: float | None = None) -> dict[str, Outcome]:
        """Return the outcome of codes [rows, cols] and, with `volts`, that of the integrators."""
        off = np.abs(codes.astype(int) - self.truth.codes)
        found = {WORK: Outcome(float(off.mean()), float(off.max()), seconds, "LSB")}
        if volts is not None:
            found[INTEGRATORS] = Outcome(volts, float(off.max()), seconds)
        return found

    def plain(self, made: Plan) -> dict[str, Outcome]:
        """Run closed or event; a run too short to time is repeated."""
        result = engines.run(made)
        seconds = cpu_time.cpu_seconds(partial(engines.run, made)) / made.frames
        whole = "w_end" in result.info
        volts = charge_error_v(made, np.asarray(result.info["w_end"])[0], self.truth) if whole else None
        return self.outcome(result.codes[0], seconds, volts)

    def bound(self, made: Plan) -> dict[str, Outcome]:
        """Run with certified codes; the error is the mean of the bound that the run states."""

        def run() -> Result:
            return certificate.certify(made, engines.run(made))

        result, seconds = run(), cpu_time.cpu_seconds(run) / made.frames
        assert result.low is not None
        assert result.high is not None
        codes, low, high = (array[0].astype(int) for array in (result.codes, result.low, result.high))
        bound = np.maximum(high - codes, codes - low)
        self.certified += 1
        self.outside += int((np.abs(codes - self.truth.codes) > bound).sum())
        return {WORK: Outcome(float(bound.mean()), float(bound.max()), seconds, "LSB")}

    def rtl(self, made: Plan, simulator: str) -> dict[str, Outcome]:
        """Run without a probe for the time; a separate run without ramps gives the integrators."""
        _, output, told = converter.probed(made, simulator, self.work / f"probe_{simulator}")
        engines.run(made.part(0, 1), simulator=simulator)  # builds, so that it is not timed
        result, seconds = cpu_once(partial(engines.run, made, simulator=simulator))
        volts = -output * made.converter.packet_v()[:, None]
        # No ramp: far below the rounding of a clock in seconds.
        error = output_error_v(made, volts, told, 1e-30, self.truth)
        return self.outcome(result.codes[0], seconds / made.frames, error)

    def cosim(self, made: Plan, simulator: str, solver: cosim.Solver) -> dict[str, Outcome]:
        """Run the co-simulation with its waves."""
        result, seconds = cpu_once(
            partial(engines.run, made, simulator=simulator, solver=solver, record=True)
        )
        error = output_error_v(made, *recorded(made, result.info["records"][0]), solver.t_edge_s, self.truth)
        return self.outcome(result.codes[0], seconds / made.frames, error)

    def methods(self, quick: bool) -> Iterator[Method]:
        """Yield every engine and setting."""
        many = random_plan(self.work, _MANY, "event", **EFFECTS)
        bare = random_plan(self.work, _MANY, "closed")
        yield Method("closed, effects out", "none of 8 in", partial(self.plain, bare))
        for budget in BUDGETS_LSB[1::2] if quick else BUDGETS_LSB:
            made = plan.make(many.scene, None, AutoTable(budget_lsb=budget))
            text = f"budget {budget:g} LSB, {made.engine}"
            yield Method("auto, by budget", text, partial(self.plain, made))
            yield Method("auto, certified bound", text, partial(self.bound, made))
        yield Method("event", "8 of 8 in", partial(self.plain, many))
        for simulator, some in (("verilator", many), ("icarus", many.part(0, 2))):
            run = partial(self.rtl, replace(some, engine="rtl"), simulator)
            yield Method(f"rtl, {simulator}", "8 of 8 in", run, slow=True)
        one = replace(many.part(0, 1), engine="cosim")
        every = list(solvers().items())
        for simulator, some in (("icarus", every[:1]), ("verilator", every[:1] if quick else every)):
            for words, solver in some:
                run = partial(self.cosim, one, simulator, solver)
                yield Method(f"cosim, {simulator}", f"8 of 8 in, {words}", run, slow=True)


def measured(
    work: Path, repeat: int, quick: bool, tell: Callable[[str], None]
) -> tuple[list[Point], list[Row]]:
    """Run every method `repeat` times in turns against the reference; return points and verdict
    rows.
    """
    work.mkdir(parents=True, exist_ok=True)
    tell("reference in 50 digits")
    every = Frames(work, reference.frame(random_plan(work, _MANY, "event", **EFFECTS)))
    points, rows = measure.measure(WORK, list(every.methods(quick)), repeat, tell)
    note = f"codes of the 50-digit reference outside the bounds of {every.certified} certified runs"
    # No runs, no verdict.
    rows.append(verdict.judge("accuracy.outside_certified", every.outside if every.certified else None, note))
    return points, rows


# ---- one channel in transistors ---------------------------------------------------------------------------------

R_OHM = 1371.0
"""About a third of full scale, not on a boundary of two codes."""


def channel_plan(work: Path) -> Plan:
    """Return a sheet of one taxel, its channel in transistors."""
    data = {
        "array": {"rows": 1, "cols": 1},
        "stimulus": {"kind": "uniform", "r_ohm": R_OHM},
        "run": {"engine": "cosim", "views": "sky130"},
    }
    return plan.make(scene.from_data(data, work / "channel.toml"))


def channel(work: Path, tell: Callable[[str], None]) -> tuple[list[Point], list[Row]]:
    """Compare solver options in transistors with a run of a tenth of the tolerances and steps of 10
    ns.

    There is no exact solution. Missing transistors or tools are a SKIP row, a failure an ERROR row.
    """
    try:
        made = channel_plan(work)
        deck = netlist.frame_deck(made, 0, [1.0, 1.0, 0.0])
        line = next(line for line in reversed(deck.lines) if line.startswith(".options"))
        values = dict(word.split("=") for word in line.split()[1:])

        def scaled(share: float, **other: str) -> str:
            moved = {n: share * float(values[n]) for n in ("reltol", "abstol", "vntol", "chgtol")}
            return converter.options_with(line, **moved, **other)

        def run(solver: cosim.Solver) -> tuple[int, NDArray[np.float64], float]:
            result, taken = cpu_once(
                partial(engines.run, made, simulator="verilator", solver=solver, record=True)
            )
            volts, _ = recorded(made, result.info["records"][0])
            return int(result.codes[0, 0, 0]), volts, taken / made.timing.slot_clocks

        tell(f"{CHANNEL}, reference")
        code, expected, _ = run(cosim.Solver(t_max_step_s=10e-9, options=scaled(0.1)))
        packet_v, points = float(made.converter.packet_v()[0]), []
        for words, solver in {
            "trap, tolerances x 10": cosim.Solver(options=scaled(10.0)),
            "trap, as the project has it": cosim.Solver(),
            "trap, step 50 ns": cosim.Solver(t_max_step_s=50e-9),
            "gear of order 2": cosim.Solver(options=scaled(1.0, method="gear", maxord="2")),
        }.items():
            tell(f"{CHANNEL}, {words}")
            found, volts, taken = run(solver)
            apart = volts - expected
            # A pulse that falls a clock later is a packet for a clock: whole packets are not
            # counted.
            error = float(np.max(np.abs(apart - packet_v * np.rint(apart / packet_v))))
            points.append(
                Point(
                    CHANNEL, "cosim, verilator, sky130", words, error, "V", float(abs(found - code)), (taken,)
                )
            )
    except InputError as error:
        return [], [verdict.skip("accuracy.cosim.sky130", str(error))]
    except SimulatorError as error:
        return [], [verdict.error("accuracy.cosim.sky130", str(error))]
    return points, []
