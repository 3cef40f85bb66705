# SPDX-License-Identifier: Apache-2.0
"""One converter: error of the integrator's voltage at the clock edges against processor time a clock; peers too.

Two circuits, both those of bench_vfc: without a pole, where the reference is exact rationals, and with the amplifier's
pole of 1 MHz, where it is the closed form in 50 digits. Each is given the charge pulses that the method's own digital
side made, so that its error is one of the analog solution; a wrong count shows beside it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dermis import bench_peers, bench_vfc, cpu_time, netlist, workers
from dermis.accuracy.point import Point
from dermis.analog import Edge
from dermis.bench_vfc import CHARGE, Circuit, Job
from dermis.errors import SimulatorError
from dermis.ngspice import NgspiceHalf

RUN_LIMIT_S = 120.0
CLOCKS = 400
T_GBW_S = 1.0 / (2.0 * math.pi * 1e6)
STEPS_S = (10e-9, 30e-9, 100e-9, 300e-9, 1e-6)
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


# The start of a peer's process is taken off by a second run of so many clocks.
_FEW = 40


def _peer(name: str, step: float, options: str) -> Callable[[Circuit, Path], tuple[float, float, float]]:
    def once(circuit: Circuit, clocks: int, where: Path) -> tuple[bench_peers.PeerRun, float]:
        begin = cpu_time.cpu_used_s()
        if name == "xspice":
            done = bench_peers.xspice(circuit, step, clocks, where, RUN_LIMIT_S, options)
        else:
            done = bench_peers.GUESTS[name](circuit, step, clocks, where, RUN_LIMIT_S)
        return done, cpu_time.cpu_used_s() - begin

    def run(circuit: Circuit, where: Path) -> tuple[float, float, float]:
        done, seconds = once(circuit, CLOCKS, where)
        _, start = once(circuit, _FEW, where.with_name(where.name + "_few"))
        # Processor time is known to some 1 ms.
        return done.error_v, done.count_error, max(seconds - start, 1e-3) / (CLOCKS - _FEW)

    return run


def methods(circuit: Circuit, quick: bool) -> Iterator[Method]:
    """Every method and setting that runs a circuit."""
    steps = STEPS_S[1::3] if quick else STEPS_S
    tolerances = RELTOLS[1::2] if quick else RELTOLS
    few = steps if quick else STEPS_S[::2]
    for simulator in ("icarus",) if quick else ("icarus", "verilator"):
        for step in steps if simulator == "icarus" else few:
            run = _ours(simulator, step, EXACT)
            yield Method(f"cosim, {simulator}, step", f"trap, step {step_words(step)}", run)
    for method in ("trap", "gear") if circuit.t_gbw_s else ():
        for reltol in tolerances:
            # abstol, vntol and chgtol go along, so that none of them hides the others.
            share = reltol / 1e-4
            # Those of netlist.py at its reltol of 1e-4, and in proportion.
            scaled = {"abstol": 1e-12 * share, "vntol": 1e-7 * share, "chgtol": 1e-14 * share}
            options = options_with(POLE, reltol=reltol, **scaled, method=method, maxord="2")
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
    for step in few:
        options = POLE if circuit.t_gbw_s else EXACT
        yield Method("peer: ngspice XSPICE", f"trap, step {step_words(step)}", _peer("xspice", step, options))
    # The others jump the charge switch between two steps whatever follows it: the plain circuit shows all of it.
    for peer in () if circuit.t_gbw_s else bench_peers.GUESTS:
        if bench_peers.missing(peer) is None:
            for step in few:
                yield Method(f"peer: {peer}", f"exchange, step {step_words(step)}", _peer(peer, step, EXACT))


def measure(work: Path, repeat: int, quick: bool, tell: Callable[[str], None]) -> list[Point]:
    """Every method on both circuits, `repeat` times in turns, so that other work on the machine meets all."""
    found: list[Point] = []
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
                    tell(f"{method.name}, {method.setting}: {failure}")
                    continue
                errors[i] = error, miscount
                times[i].append(seconds)
        for method, error, taken in zip(chosen, errors, times, strict=True):
            if error is not None:
                found.append(Point(name, method.name, method.setting, error[0], "V", error[1], tuple(taken)))
    return found


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
