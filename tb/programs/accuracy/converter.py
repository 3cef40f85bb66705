# SPDX-License-Identifier: Apache-2.0
"""One converter: error of the integrator's voltage at the clock edges against processor time a clock; peers too.

Two circuits, both those of bench_vfc: without a pole, where the reference is exact rationals, and with the amplifier's
pole of 1 MHz, where it is the closed form in 50 digits. Each is given the charge pulses that the method's own digital
side made, so that its error is one of the analog solution; a wrong count shows beside it. The reference's charge pulses
rise and fall in 1 ns for every method, also for one that knows no such ramp.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dermis.chip import netlist
from dermis.chip.analog import Edge
from dermis.chip.ngspice import NgspiceHalf
from dermis.engines import rtl
from dermis.errors import SimulatorError
from dermis.processes import cpu_time
from dermis.report import verdict
from dermis.report.verdict import Row
from scripts import workers
from tb.programs.accuracy import chip, probe
from tb.programs.accuracy.point import Point, point_name
from tb.programs.bench import bench_peers, bench_vfc
from tb.programs.bench.bench_vfc import CHARGE, Circuit, Job

RUN_LIMIT_S = 120.0
CLOCKS = 400
T_GBW_S = 1.0 / (2.0 * math.pi * 1e6)
STEPS_S = (10e-9, 30e-9, 100e-9, 300e-9, 1e-6)
# Longest step of the run with the Verilog; 1 for that run, and in how many each of its steps is cut for the others.
EXTRAPOLATED_S = (300e-9, 150e-9, 100e-9, 60e-9, 30e-9)
CUTS = ((1, 2), (1, 2, 3))
# The project takes 1e-4; two decades to either side.
RELTOLS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)

IDEAL = Circuit(gate_clocks=CLOCKS)
CIRCUITS = {"converter, no pole": IDEAL, "converter, amplifier pole": replace(IDEAL, t_gbw_s=T_GBW_S)}

EXACT, POLE = netlist.options(pole=False), netlist.options(pole=True)


def options_with(line: str, **other: float | str) -> str:
    """A line of options with some of them changed: of an option given twice ngspice takes the first."""
    values = dict(word.split("=") for word in line.split()[1:])
    values |= {
        name: f"{value:g}" if isinstance(value, float) else str(value) for name, value in other.items()
    }
    return ".options " + " ".join(f"{name}={value}" for name, value in values.items())


def tolerances(reltol: float, **other: str) -> str:
    """The options behind a pole with all tolerances moved together, as reltol is moved from the project's 1e-4."""
    share = reltol / 1e-4
    # They go along with reltol, so that none of them hides the others: at 1e-4 these are the project's (netlist.py).
    return options_with(
        POLE, reltol=reltol, abstol=1e-12 * share, vntol=1e-7 * share, chgtol=1e-14 * share, **other
    )


@dataclass(frozen=True)
class Method:
    """A way to run a circuit: (circuit, directory) -> error in volt, miscount, seconds a clock."""

    name: str
    setting: str
    run: Callable[[Circuit, Path], tuple[float, float, float]]


def step_words(seconds: float) -> str:
    """A step in ns or us."""
    # From 1 us on in microseconds.
    return f"{1e9 * seconds:g} ns" if seconds < 1e-6 else f"{1e6 * seconds:g} us"


def _ours(simulator: str, step: float, options: str) -> Callable[[Circuit, Path], tuple[float, float, float]]:
    def run(circuit: Circuit, where: Path) -> tuple[float, float, float]:
        job = Job(circuit, 1, step, simulator, keep=True, options=options)
        done = bench_vfc.measure(job, where, RUN_LIMIT_S)
        assert done.voltage is not None
        assert done.charge is not None
        error = bench_vfc.edge_error_v(circuit, done.voltage[0], done.charge[0])
        miscount = float(np.max(np.abs(done.codes - circuit.pulses)))
        return error, miscount, float(done.cpu_seconds[0]) / circuit.clocks

    return run


def extrapolated(
    simulator: str, step: float, cuts: tuple[int, ...]
) -> Callable[[Circuit, Path], tuple[float, float, float]]:
    """The same pulses with every step cut in 2, 3, ... and without the Verilog, taken together for a step of zero.

    The error of trapezoids of equal steps goes on as h^2, h^4, h^6, ... (Richardson): as many runs as `cuts` has
    take so many powers away but one, with Lagrange's weights at h^2 = 0. What two of them differ by is also an
    estimate of the error. For the voltage alone: the comparator has seen that of the first run.

    Parameters
    ----------
    simulator : "icarus" or "verilator"
    step : float
        Longest step of the first run in seconds.
    cuts : tuple of int
        1 for the run with the Verilog, then in how many each of its steps is cut.
    """
    weights = [math.prod(n * n / (n * n - m * m) for m in cuts if m != n) for n in cuts]

    def run(circuit: Circuit, where: Path) -> tuple[float, float, float]:
        job = Job(circuit, 1, step, simulator, keep=True, options=EXACT, cuts=cuts[0])
        first = bench_vfc.measure(job, where, RUN_LIMIT_S)
        assert first.charge is not None
        runs = [first]
        for cut in cuts[1:]:
            again = replace(job, cuts=cut, simulator=None)
            place = where.with_name(f"{where.name}_{cut}")
            runs.append(bench_vfc.measure(again, place, RUN_LIMIT_S, first))
        better = sum(weight * done.voltage[0] for weight, done in zip(weights, runs, strict=True))
        error = bench_vfc.edge_error_v(circuit, better, first.charge[0])
        miscount = float(np.max(np.abs(first.codes - circuit.pulses)))
        return error, miscount, float(sum(done.cpu_seconds[0] for done in runs)) / circuit.clocks

    return run


_RTL_FRAMES = {"verilator": 4000, "icarus": 40}  # so many that the start of a process is little of the time


def _rtl(simulator: str) -> Callable[[Circuit, Path], tuple[float, float, float]]:
    """The same circuit in engine `rtl`: the Verilog with real-number models, whose packets begin at the edge itself."""

    def run(circuit: Circuit, where: Path) -> tuple[float, float, float]:
        effects = {}
        if circuit.t_gbw_s:
            effects["integrator_bandwidth"] = {"gbw_hz": 1.0 / (2.0 * math.pi * circuit.t_gbw_s)}
        gate, settle_s = (
            circuit.gate_clocks,
            (circuit.settle_clocks + circuit.break_clocks) / circuit.f_clk_hz,
        )
        frames = _RTL_FRAMES[simulator]
        duty = np.full((frames, 1, 1), float(circuit.duty))
        made = chip.plan_at(duty, effects, circuit.f_clk_hz, gate, settle_s)
        seen, output, charge = probe.run(made, simulator, where)
        opened = replace(circuit, settle_clocks=0)
        exact = bench_vfc.exact_voltage(opened, charge[0, 0])[1:]
        error = float(np.max(np.abs(-circuit.packet_v * output[0, 0] - exact)))
        rtl.run(made.part(0, 1), simulator=simulator)  # builds, so that it is not timed
        begin = cpu_time.cpu_used_s()
        codes = rtl.run(made, simulator=simulator).codes
        seconds = cpu_time.cpu_used_s() - begin
        if not np.array_equal(codes[:1], seen.codes):
            raise SimulatorError("the models with a probe count otherwise")
        miscount = float(np.max(np.abs(codes.astype(int) - circuit.pulses)))
        return error, miscount, seconds / (frames * made.timing.slot_clocks)

    return run


# The start of a peer's process is taken off by a second run of so many clocks.
_FEW = 40
# Starts of two processes differ by some milliseconds of processor time, on a busy machine by more.
_LEAST_S = 5e-3
_ATTEMPTS = 5


def _peer(name: str, step: float, options: str) -> Callable[[Circuit, Path], tuple[float, float, float]]:
    def once(circuit: Circuit, clocks: int, where: Path) -> tuple[bench_peers.PeerRun, float]:
        run = bench_peers.xspice if name == "xspice" else bench_peers.GUESTS[name]
        begin = cpu_time.cpu_used_s()
        done = run(circuit, step, clocks, where, RUN_LIMIT_S, options=options)
        return done, cpu_time.cpu_used_s() - begin

    def run(circuit: Circuit, where: Path) -> tuple[float, float, float]:
        for attempt in range(_ATTEMPTS):
            place = where.with_name(f"{where.name}_{attempt}")
            done, seconds = once(circuit, CLOCKS, place)
            _, start = once(circuit, _FEW, place.with_name(place.name + "_few"))
            if seconds - start > _LEAST_S:
                return done.error_v, done.count_error, (seconds - start) / (CLOCKS - _FEW)
        raise SimulatorError(f"{CLOCKS} clocks are too short to time beside the start of the process", where)

    return run


def methods(circuit: Circuit, quick: bool) -> Iterator[Method]:
    """Every method and setting that runs a circuit."""
    steps = STEPS_S[1::3] if quick else STEPS_S
    reltols = RELTOLS[1::2] if quick else RELTOLS
    few = steps if quick else STEPS_S[::2]
    for simulator in ("icarus",) if quick else ("icarus", "verilator"):
        yield Method(f"rtl, {simulator}", "exact between edges, no ramps", _rtl(simulator))
        for step in steps if simulator == "icarus" else few:
            run = _ours(simulator, step, EXACT)
            yield Method(f"cosim, {simulator}, step", f"trap, step {step_words(step)}", run)
    for method in ("trap", "gear") if circuit.t_gbw_s else ():
        for reltol in reltols:
            options = tolerances(reltol, method=method, maxord="2")
            yield Method(
                f"cosim, icarus, {method}, reltol",
                f"{method}, reltol {reltol:g}",
                _ours("icarus", 1e-6, options),
            )
    if circuit.t_gbw_s and not quick:
        for chgtol in (1e-13, 1e-15, 1e-17):
            options = options_with(POLE, chgtol=chgtol)
            yield Method(
                "cosim, icarus, trap, chgtol", f"trap, chgtol {chgtol:g}", _ours("icarus", 1e-6, options)
            )
    for step, cuts in itertools.product((100e-9,) if quick else EXTRAPOLATED_S, CUTS):
        if circuit.t_gbw_s:
            words = f"step {step_words(step)} over {', '.join(str(cut) for cut in cuts)}"
            yield Method("cosim, verilator, extrapolated", words, extrapolated("verilator", step, cuts))
    # Peers take the options with truncation control as well where that serves them; it makes the guests' errors larger.
    for words, options in (("", EXACT), (", truncation control", POLE)):
        for step in few:
            setting = f"trap, step {step_words(step)}{words}"
            yield Method("peer: ngspice XSPICE", setting, _peer("xspice", step, options))
    for peer in bench_peers.GUESTS:
        if bench_peers.missing(peer) is None:
            for step in few:
                yield Method(f"peer: {peer}", f"exchange, step {step_words(step)}", _peer(peer, step, EXACT))


def measure(
    work: Path, repeat: int, quick: bool, tell: Callable[[str], None]
) -> tuple[list[Point], list[Row]]:
    """Every method on both circuits, `repeat` times in turns, so that other work on the machine meets all.

    A method that fails is an ERROR row with the reason; its point is missing.
    """
    found: list[Point] = []
    failed: list[Row] = []
    number = itertools.count()
    for name, circuit in CIRCUITS.items():
        chosen = list(methods(circuit, quick))
        times: list[list[float]] = [[] for _ in chosen]
        errors: list[tuple[float, float] | None] = [None] * len(chosen)
        for turn in range(repeat):
            for i, method in enumerate(chosen):
                tell(f"{name}, {method.name}, {method.setting}, {turn + 1} of {repeat}")
                try:
                    error, miscount, seconds = method.run(circuit, work / f"run_{next(number):04d}")
                except SimulatorError as failure:
                    failed.append(failure_row(name, method.name, method.setting, failure))
                    continue
                errors[i] = error, miscount
                times[i].append(seconds)
        for method, error, taken in zip(chosen, errors, times, strict=True):
            if error is not None:
                found.append(Point(name, method.name, method.setting, error[0], "V", error[1], tuple(taken)))
    return found, failed


def failure_row(work: str, method: str, setting: str, failure: SimulatorError) -> Row:
    """The row of a point that was not measured."""
    return verdict.error(point_name(work, method, setting), str(failure))


# ---- order of convergence -----------------------------------------------------------------------------------------

ORDER_STEPS_S = (100e-9, 50e-9, 25e-9, 12.5e-9)
ORDER_CLOCKS = 60


def loop_error_v(circuit: Circuit, step: float, options: str, log: Path) -> float:
    """Largest error at the clock edges of the converter closed over two flip-flops written here."""
    half = NgspiceHalf(
        bench_vfc.deck(circuit, options=options),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=step,
        t_stop_s=circuit.clocks / circuit.f_clk_hz,
        log=log,
        use_ic=True,
    )
    half.advance(0.0, [])
    edges: list[Edge] = []
    sample = charge = False
    told, voltage = [False], [math.nan]
    for clock in range(1, circuit.clocks + 1):
        now = clock / circuit.f_clk_hz
        comparator, v_int = half.advance(now, edges)
        voltage.append(v_int)
        before, charge = charge, sample
        sample = bool(comparator > 0.0) and not sample and clock > circuit.settle_clocks
        edges = [(now, CHARGE, float(charge))] if charge != before else []
        told.append(charge)
    half.close()
    return bench_vfc.edge_error_v(circuit, np.array(voltage), np.array(told[1:], dtype=int))


def orders(work: Path, options: str = EXACT, t_gbw_s: float = T_GBW_S) -> tuple[list[float], list[float]]:
    """Errors at ORDER_STEPS_S in volt, and the order between each and the next.

    Raises
    ------
    SimulatorError
        ngspice failed, or its process.
    """
    circuit = replace(IDEAL, gate_clocks=ORDER_CLOCKS, t_gbw_s=t_gbw_s)
    tasks = [
        workers.Task(loop_error_v, (circuit, step, options, work / "ngspice.log"), RUN_LIMIT_S)
        for step in ORDER_STEPS_S
    ]
    errors = [math.nan] * len(tasks)
    for number, outcome in workers.run(tasks, 1):
        if outcome.fault:
            raise SimulatorError(outcome.fault)
        errors[number] = outcome.value
    between = zip(errors, errors[1:], ORDER_STEPS_S, ORDER_STEPS_S[1:], strict=False)
    return errors, [math.log(a / b) / math.log(h / g) for a, b, h, g in between]
