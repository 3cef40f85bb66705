# SPDX-License-Identifier: Apache-2.0
"""One converter: error of the integrator's voltage at the clock edges against processor time a
clock; peers too.

Two circuits, without a pole and with the amplifier's pole of 1 MHz; the reference is the exact
solution in 50 digits. It takes the charge pulses of the method's own digital side, so the error is
one of the analog solution; a wrong count is reported as LSB. Pulses of the reference rise and fall
in 1 ns.
"""

from __future__ import annotations

import itertools
import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist
from dermis.chip.analog import Edge
from dermis.chip.ngspice import NgspiceHalf
from dermis.engines import rtl
from dermis.errors import SimulatorError
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from tb.programs.accuracy import chip
from tb.programs.accuracy.points import Method, Outcome
from tb.programs.bench import circuit as circuits
from tb.programs.bench import peers
from tb.programs.bench.circuit import CHARGE, Circuit, Job
from tb.programs.bench.measure import cpu_once

RUN_LIMIT_S = 120.0
CLOCKS = 400
T_GBW_S = 1.0 / (2.0 * math.pi * 1e6)
STEPS_S = (10e-9, 30e-9, 100e-9, 300e-9, 1e-6)
EXTRAPOLATED_S = (300e-9, 150e-9, 100e-9, 60e-9, 30e-9)
CUTS = ((1, 2), (1, 2, 3))
"""1 for the run with the Verilog, then the number of parts of each of its steps."""
RELTOLS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Values around the project's 1e-4, two decades to either side."""

IDEAL = Circuit(gate_clocks=CLOCKS)
CIRCUITS = {"converter, no pole": IDEAL, "converter, amplifier pole": replace(IDEAL, t_gbw_s=T_GBW_S)}
EXACT, POLE = netlist.options(pole=False), netlist.options(pole=True)

Run = Callable[[Circuit, Path], Outcome]


def options_with(line: str, **other: float | str) -> str:
    """Return a line of options with some of them changed; of an option given twice ngspice uses the
    first.
    """
    values = dict(word.split("=") for word in line.split()[1:])
    values |= {name: f"{v:g}" if isinstance(v, float) else str(v) for name, v in other.items()}
    return ".options " + " ".join(f"{name}={value}" for name, value in values.items())


def tolerances(reltol: float, **other: str) -> str:
    """Return the options with a pole, with all tolerances scaled together, so that none hides the
    others.
    """
    share = reltol / 1e-4
    # At a reltol of 1e-4 they are those of netlist.py.
    moved = {"abstol": 1e-12 * share, "vntol": 1e-7 * share, "chgtol": 1e-14 * share}
    return options_with(POLE, reltol=reltol, **moved, **other)


def step_words(seconds: float) -> str:
    """Return a step in ns or us."""
    # A change of unit, not a tolerance: below a microsecond, ns.
    return f"{1e9 * seconds:g} ns" if seconds < 1e-6 else f"{1e6 * seconds:g} us"


def _cosim(simulator: str, step_s: float, options: str, circuit: Circuit, where: Path) -> Outcome:
    done = circuits.measure(Job(circuit, step_s, simulator, keep=True, options=options), where, RUN_LIMIT_S)
    return Outcome(done.error_v, done.miscount, done.cpu_per_clock_s)


def extrapolated(
    simulator: str, step_s: float, cuts: tuple[int, ...], circuit: Circuit, where: Path
) -> Outcome:
    """Solve the pulses of a run again with every step divided by 2, 3, ... and extrapolate to a
    step of zero.

    The error of the trapezoidal rule with equal steps is a series in h^2 (Richardson); each further
    run removes one power, with Lagrange's weights at h^2 = 0. Only the voltage is extrapolated: the
    comparator used that of the first run.
    """
    weights = [math.prod(n * n / (n * n - m * m) for m in cuts if m != n) for n in cuts]
    job = Job(circuit, step_s, simulator, keep=True, options=EXACT, cuts=cuts[0])
    runs = [circuits.measure(job, where, RUN_LIMIT_S)]
    for cut in cuts[1:]:
        again = replace(job, cuts=cut, simulator=None, charge=runs[0].charge)
        runs.append(circuits.measure(again, where.with_name(f"{where.name}_{cut}"), RUN_LIMIT_S))
    better = sum(weight * done.voltage for weight, done in zip(weights, runs, strict=True))
    error_v = replace(runs[0], voltage=better).error_v
    return Outcome(error_v, runs[0].miscount, sum(done.cpu_per_clock_s for done in runs))


_PROBE = '  always @(posedge clk_i) $display("integrator %b %b %.17g", d_preset, d_charge, v_c);\n'
_SAID = re.compile(rb"^integrator ([01]) ([01]) (\S+)$", re.MULTILINE)


def probed(
    made: Plan, simulator: str, work: Path
) -> tuple[NDArray[np.uint16], NDArray[np.float64], NDArray[np.int64]]:
    """Run the first frame of a plan of one converter in engine rtl, with a line in its models that
    prints the integrator.

    Returns
    -------
    codes : ndarray
        Codes of the frame.
    output : [gate clocks] output of the integrator in packets at every clock of the gate after the
        opening, just before the events of that clock.
    charge : [gate clocks] state of the charge switch, 0 or 1, at the clocks from the opening of the gate on.

    Raises
    ------
    SimulatorError
        The simulator failed, or did not write the whole gate.
    """
    work.mkdir(parents=True)
    place = Path(shutil.copytree(rtl.MODELS, work / "models"))
    text = (place / "vfc.sv").read_text()
    if text.count("endmodule") != 1:
        raise ValueError(f"{place / 'vfc.sv'} is not one module")
    (place / "vfc.sv").write_text(text.replace("endmodule", f"{_PROBE}endmodule"))
    result = rtl.run(made.part(0, 1), simulator=simulator, work=work / "run", models=place)
    log, gate = work / "run" / "simulator.log", made.timing.gate_clocks
    held, charge, output = np.array(_SAID.findall(log.read_bytes()), dtype=float).reshape(-1, 3).T
    # The first clock that is not held ends the first clock of the gate: the one before it is its opening.
    begin = np.flatnonzero((held[:-1] == 1) & (held[1:] == 0))
    if not begin.size or begin[0] + gate >= output.size:
        raise SimulatorError("the gate is missing", log)
    inside = slice(begin[0] + 1, begin[0] + gate + 1)
    return result.codes[0], output[inside], charge[inside].astype(np.int64)


_RTL_FRAMES = {"verilator": 4000, "icarus": 40}
"""Large enough to make the start of a process a small part of the time."""


def _rtl(simulator: str, circuit: Circuit, where: Path) -> Outcome:
    """Run the Verilog with real-number models, whose packets begin at the edge itself, without
    ramps.
    """
    effects = (
        {"integrator_bandwidth": {"gbw_hz": 0.5 / (math.pi * circuit.t_gbw_s)}} if circuit.t_gbw_s else {}
    )
    settle_s = (circuit.settle_clocks + circuit.break_clocks) / circuit.f_clk_hz
    duty = np.full((_RTL_FRAMES[simulator], 1, 1), float(circuit.duty))
    made = chip.plan_at(duty, effects, circuit.f_clk_hz, circuit.gate_clocks, settle_s)
    codes, output, charge = probed(made, simulator, where)
    exact = circuits.exact_voltage(replace(circuit, settle_clocks=0), charge)[1:]
    error = float(np.max(np.abs(-circuit.packet_v * output - exact)))
    rtl.run(made.part(0, 1), simulator=simulator)  # builds, so that it is not timed
    result, seconds = cpu_once(partial(rtl.run, made, simulator=simulator))
    if not np.array_equal(result.codes[0], codes):
        raise SimulatorError("the models with a probe give other codes")
    miscount = float(np.max(np.abs(result.codes.astype(int) - circuit.pulses)))
    return Outcome(error, miscount, seconds / (len(duty) * made.timing.slot_clocks))


# The start of a peer's process is subtracted by a second run of a few clocks. Starts differ by
# milliseconds.
_FEW, _LEAST_S, _ATTEMPTS = 40, 5e-3, 5


def _peer(program: Callable[..., peers.PeerRun], step_s: float, options: str, circuit: Circuit, where: Path):
    for attempt in range(_ATTEMPTS):
        (done, seconds), (_, start) = (
            cpu_once(
                partial(program, circuit, step_s, clocks, where / f"{attempt}_{clocks}", RUN_LIMIT_S, options)
            )
            for clocks in (CLOCKS, _FEW)
        )
        if seconds - start > _LEAST_S:
            return Outcome(done.error_v, done.count_error, (seconds - start) / (CLOCKS - _FEW))
    raise SimulatorError(f"{CLOCKS} clocks are too short to time against the start of the process", where)


def methods(circuit: Circuit, quick: bool) -> Iterator[tuple[str, str, Run]]:
    """Yield name, setting and function of every method that runs a circuit."""
    steps = STEPS_S[1::3] if quick else STEPS_S
    few = steps if quick else STEPS_S[::2]
    for simulator in ("icarus",) if quick else ("icarus", "verilator"):
        yield f"rtl, {simulator}", "exact between edges, no ramps", partial(_rtl, simulator)
        for step in steps if simulator == "icarus" else few:
            run = partial(_cosim, simulator, step, EXACT)
            yield f"cosim, {simulator}, step", f"trap, step {step_words(step)}", run
    if circuit.t_gbw_s:
        for method, reltol in itertools.product(("trap", "gear"), RELTOLS[1::2] if quick else RELTOLS):
            run = partial(_cosim, "icarus", 1e-6, tolerances(reltol, method=method, maxord="2"))
            yield f"cosim, icarus, {method}, reltol", f"{method}, reltol {reltol:g}", run
        for step, cuts in itertools.product((100e-9,) if quick else EXTRAPOLATED_S, CUTS):
            words = f"step {step_words(step)} over {', '.join(str(cut) for cut in cuts)}"
            yield "cosim, verilator, extrapolated", words, partial(extrapolated, "verilator", step, cuts)
    # XSPICE takes the options with truncation control as well; they make the errors of the peers
    # larger.
    for words, options in (("", EXACT), (", truncation control", POLE)):
        for step in few:
            run = partial(_peer, peers.xspice, step, options)
            yield "peer: ngspice XSPICE", f"trap, step {step_words(step)}{words}", run
    for (peer, program), step in itertools.product(peers.GUESTS.items(), few):
        if peers.missing(peer) is None:
            run = partial(_peer, program, step, EXACT)
            yield f"peer: {peer}", f"exchange, step {step_words(step)}", run


def batches(work: Path, quick: bool) -> dict[str, list[Method]]:
    """Return the methods of both circuits by work, each run in a new directory."""
    number = itertools.count()

    def once(run: Run, circuit: Circuit) -> Outcome:
        return run(circuit, work / f"run_{next(number):04d}")

    return {
        name: [Method(who, how, partial(once, run, circuit)) for who, how, run in methods(circuit, quick)]
        for name, circuit in CIRCUITS.items()
    }


# ---- order of convergence -----------------------------------------------------------------------------------------

ORDER_STEPS_S = (100e-9, 50e-9, 25e-9, 12.5e-9)
ORDER_CLOCKS = 60


def loop_error_v(circuit: Circuit, step_s: float, options: str, log: Path) -> float:
    """Return the largest error at the clock edges of the converter closed over two flip-flops
    written here.
    """
    half = NgspiceHalf(
        circuits.deck(circuit, options=options),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=step_s,
        t_stop_s=circuit.clocks / circuit.f_clk_hz,
        log=log,
        use_ic=True,
    )
    half.advance(0.0, [])
    edges: list[Edge] = []
    sample = charge = False
    told, voltage = [], [math.nan]
    for clock in range(1, circuit.clocks + 1):
        now = clock / circuit.f_clk_hz
        comparator, v_int = half.advance(now, edges)
        voltage.append(v_int)
        before, charge = charge, sample
        sample = bool(comparator > 0.0) and not sample and clock > circuit.settle_clocks
        edges = [(now, CHARGE, float(charge))] if charge != before else []
        told.append(charge)
    half.close()
    return circuits.edge_error_v(circuit, np.array(voltage), np.array(told, dtype=int))


def orders(work: Path, options: str = EXACT) -> tuple[list[float], list[float]]:
    """Return errors at ORDER_STEPS_S in volt, and the order between each and the next.

    Raises
    ------
    SimulatorError
        ngspice failed, or its process.
    """
    circuit = replace(IDEAL, gate_clocks=ORDER_CLOCKS, t_gbw_s=T_GBW_S)
    errors = [
        # A process each: libngspice holds one circuit.
        circuits.in_process(loop_error_v, circuit, step_s, options, work / "ngspice.log", limit_s=RUN_LIMIT_S)
        for step_s in ORDER_STEPS_S
    ]
    return errors, (np.diff(np.log(errors)) / np.diff(np.log(ORDER_STEPS_S))).tolist()


def order_row(work: Path) -> Row:
    """Judge the order of convergence of the closed loop with an amplifier pole."""
    errors, found = orders(work)
    told = ", ".join(f"{e:.3g} V at {step_words(h)}" for e, h in zip(errors, ORDER_STEPS_S, strict=True))
    note = f"least of {', '.join(f'{order:.3f}' for order in found)}; {told}"
    return verdict.judge("accuracy.order", min(found), note)
