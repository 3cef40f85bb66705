# SPDX-License-Identifier: Apache-2.0
"""`dermis accuracy`: error against processor time of every engine and of peers on the same work.

One converter, without a pole and with the amplifier's pole of 1 MHz: the error is that of the
integrator's voltage at the clock edges, against the exact solution in 50 digits for the charge pulses
of the method's own digital side. Frames of 16 x 16 resistances with eight effects: the error is the mean
difference of the codes from a reference in 50 digits (tb/reference/frame.py). Times are processor times.
"""

import itertools
import math
import statistics
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dermis import engines
from dermis.chip import netlist
from dermis.effects import AutoTable
from dermis.engines import cosim
from dermis.errors import DermisError, SimulatorError
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.report.figures import COLOURS, GREY, save
from dermis.report.verdict import Row
from tb.programs.bench import circuit as circuits
from tb.programs.bench import peers
from tb.programs.bench.circuit import Circuit
from tb.programs.bench.measure import busy_row, cpu_once, random_plan
from tb.reference import frame as reference

OUT = BUILD / "accuracy"
FRAMES = "frames, eight effects"
NO_POLE, POLE = "converter, no pole", "converter, amplifier pole"
ALONE = "bound: ngspice alone"
"""With Verilog and a loop that cost nothing; not a method that one can choose."""
FILES = {NO_POLE: "converter_ideal", POLE: "converter_pole", FRAMES: "frames_effects"}
"""File of each work, csv and figure."""

Found = tuple[float, float, float]
"""Error, largest error of a code or count in LSB, seconds of processor time a clock or a frame."""


@dataclass(frozen=True)
class Method:
    """A method with a setting; a slow one runs once."""

    work: str
    name: str
    setting: str
    run: Callable[[], Found]
    slow: bool = False


@dataclass(frozen=True)
class Point:
    """One method at one setting, a line of the csv: medians of its runs.

    The error is in volt at the clock edges, for frames the mean |code - reference| in LSB.
    """

    work: str
    method: str
    setting: str
    error: float
    largest_lsb: float
    seconds: float

    @property
    def row(self) -> Row:
        note = f"{self.setting}; {self.seconds:.3g} s; codes off by {self.largest_lsb:g} at most"
        name = row_name(self.work, self.method, self.setting)
        return verdict.report(name, self.error, "LSB" if self.work == FRAMES else "V", note)


def row_name(*words: str) -> str:
    return ".".join(("accuracy", *words)).replace(": ", "_").replace(", ", ".").replace(" ", "_")


def measure(methods: Sequence[Method], repeat: int) -> tuple[list[Point], list[Row]]:
    """Run every method `repeat` times in turns, so that other load affects all alike.

    One that fails is an ERROR row with the reason.
    """
    found: dict[Method, list[Found]] = {}
    failed: list[Row] = []
    turns = [m for turn in range(repeat) for m in methods if not (turn and m.slow)]
    with progress.slots("accuracy", len(turns), "runs") as show:
        for done, method in enumerate(turns):
            show(done, f"{method.work}, {method.name}, {method.setting}")
            try:
                found.setdefault(method, []).append(method.run())
            except DermisError as failure:
                failed.append(verdict.error(row_name(method.work, method.name, method.setting), str(failure)))
    points = [
        Point(m.work, m.name, m.setting, *runs[0][:2], statistics.median(seconds for *_, seconds in runs))
        for m, runs in found.items()
        if runs
    ]
    return points, failed


LIMIT_S = 120.0
CLOCKS = 400
STEPS_S = (10e-9, 30e-9, 100e-9, 300e-9, 1e-6)
RELTOLS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Values around the project's 1e-4, two decades to either side."""

IDEAL = Circuit(gate_clocks=CLOCKS)
CIRCUITS = {NO_POLE: IDEAL, POLE: replace(IDEAL, t_gbw_s=1.0 / (2.0 * math.pi * 1e6))}
EXACT, CONTROLLED = netlist.options(pole=False), netlist.options(pole=True)


def options_with(line: str, **other: float | str) -> str:
    """Return a line of options with some changed; of an option given twice ngspice uses the first."""
    values = dict(word.split("=") for word in line.split()[1:])
    values |= {name: f"{v:g}" if isinstance(v, float) else str(v) for name, v in other.items()}
    return ".options " + " ".join(f"{name}={value}" for name, value in values.items())


def tolerances(reltol: float, **other: str) -> str:
    """Return the options with a pole, all tolerances scaled together, so that none hides the others."""
    share = reltol / 1e-4
    # At a reltol of 1e-4 they are those of netlist.py.
    moved = {"abstol": 1e-12 * share, "vntol": 1e-7 * share, "chgtol": 1e-14 * share}
    return options_with(CONTROLLED, reltol=reltol, **moved, **other)


_FEW, _LEAST_S, _ATTEMPTS = 40, 2e-3, 5
"""Clocks of the run whose time is that of the start, and the least time of the others: a start may vary by ms."""


def _alone(circuit: Circuit, where: Path) -> Found:
    """Time ngspice alone on the edges of a run before it; its error is that of the run, not measured here."""
    job = circuits.converter(circuit, simulator="verilator", alone=True)
    return 0.0, 0.0, circuits.frame(job, where, LIMIT_S).alone_s / circuit.clocks


def _simulator(
    program: Callable[..., circuits.Run], step_s: float, options: str, circuit: Circuit, where: Path
) -> Found:
    """Time the clocks of a simulator: those of a long run less those of a short one."""
    for attempt in range(_ATTEMPTS):
        runs = [
            cpu_once(partial(program, circuit, step_s, n, where / f"{attempt}_{n}", LIMIT_S, options))
            for n in (CLOCKS, _FEW)
        ]
        done, start = (process_s if math.isnan(run.cpu_s) else run.cpu_s for run, process_s in runs)
        if done - start > _LEAST_S:
            run = runs[0][0]
            return run.error_v, run.miscount, (done - start) / (CLOCKS - _FEW)
    raise SimulatorError(f"{CLOCKS} clocks are too short to time against the start of the process", where)


def converter_methods(work: str, where: Path, quick: bool) -> Iterator[Method]:
    """Yield every method that runs a circuit, each run in a new directory."""
    circuit, number = CIRCUITS[work], itertools.count()

    def method(name: str, setting: str, run: Callable[..., Found], *how: Any) -> Method:
        def once() -> Found:
            return run(*how, circuit, where / f"{FILES[work]}_{next(number):04d}")

        return Method(work, name, setting, once)

    steps = STEPS_S[1::3] if quick else STEPS_S
    for simulator, step in itertools.product(("icarus",) if quick else ("icarus", "verilator"), steps):
        cosim = partial(circuits.cosim, simulator=simulator)
        yield method(f"cosim, {simulator}, step", f"trap, step {step:g} s", _simulator, cosim, step, EXACT)
    if circuit.t_gbw_s:
        for rule, reltol in itertools.product(("trap", "gear"), RELTOLS[1::2] if quick else RELTOLS):
            options = tolerances(reltol, method=rule, maxord="2")
            setting = f"{rule}, reltol {reltol:g}"
            yield method(f"cosim, icarus, {rule}, reltol", setting, _simulator, circuits.cosim, 1e-6, options)
    if work == NO_POLE:
        yield method(ALONE, "edges of cosim, step 1e-06 s", _alone)
    # XSPICE takes the options with truncation control too; they make its errors larger.
    kinds = {"": EXACT, ", controlled": CONTROLLED}
    for (words, options), step in itertools.product(kinds.items(), steps[::2]):
        setting = f"trap, step {step:g} s{words}"
        yield method("peer: ngspice XSPICE", setting, _simulator, peers.xspice, step, options)
    for (peer, program), step in itertools.product(peers.GUESTS.items(), steps[::2]):
        if peers.missing(peer) is None:
            yield method(f"peer: {peer}", f"exchange, step {step:g} s", _simulator, program, step, EXACT)


ORDER_STEPS_S = (100e-9, 50e-9, 25e-9, 12.5e-9)
ORDER_CLOCKS = 60


def order_row(work: Path, options: str = EXACT, steps_s: Sequence[float] = ORDER_STEPS_S) -> Row:
    """Judge the order of convergence of the closed loop with an amplifier pole."""
    errors = [
        circuits.cosim(CIRCUITS[POLE], h, ORDER_CLOCKS, work / f"order_{n}", LIMIT_S, options).error_v
        for n, h in enumerate(steps_s)
    ]
    found = (np.diff(np.log(errors)) / np.diff(np.log(steps_s))).tolist()
    told = ", ".join(f"{e:.3g} V at {h:g} s" for e, h in zip(errors, steps_s, strict=True))
    note = f"least of {', '.join(f'{order:.3f}' for order in found)}; {told}"
    return verdict.judge("accuracy.order", min(found), note)


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
SOLVERS = {
    "trap, reltol 0.0001": cosim.Solver(),
    "trap, reltol 0.01": cosim.Solver(options=tolerances(1e-2)),
    "gear of order 1": cosim.Solver(options=tolerances(1e-4, method="gear", maxord="1")),
}
"""Settings of ngspice for a whole frame, the project's own first."""
_MANY = 64


def frame_methods(quick: bool) -> Iterator[Method]:
    many, bare = random_plan(_MANY, "event", **EFFECTS), random_plan(_MANY, "closed")
    truth = cache(partial(reference.codes, many))  # 50 digits take 0.1 s a conversion

    def method(name: str, setting: str, made: Plan, slow: bool = False, **options: Any) -> Method:
        def run() -> Found:
            work = partial(engines.run, made, **options)
            if made.engine == "rtl":
                engines.run(made.part(0, 1), **options)  # builds, so that it is not timed
            # A run too short to time is repeated.
            result, seconds = cpu_once(work) if slow else (work(), cpu_time.cpu_seconds(work))
            off = np.abs(result.codes[0].astype(int) - truth())
            return float(off.mean()), float(off.max()), seconds / len(result.codes)

        return Method(FRAMES, name, setting, run, slow)

    yield method("closed, effects out", "none of 8 in", bare)
    for budget in BUDGETS_LSB[1::2] if quick else BUDGETS_LSB:
        made = replace(many, auto=AutoTable(budget_lsb=budget), filtered=True)
        yield method("auto, by budget", f"budget {budget:g} LSB, {made.engine}", made)
    yield method("event", "8 of 8 in", many)
    for simulator, some in (("verilator", many), ("icarus", many.part(0, 2))):
        yield method(f"rtl, {simulator}", "8 of 8 in", replace(some, engine="rtl"), True, simulator=simulator)
    one, every = replace(many.part(0, 1), engine="cosim"), list(SOLVERS.items())
    for simulator, some in (("icarus", every[:1]), ("verilator", every[:1] if quick else every)):
        for words, solver in some:
            options = {"simulator": simulator, "solver": solver}
            yield method(f"cosim, {simulator}", f"8 of 8 in, {words}", one, True, **options)


def points_csv(points: Sequence[Any]) -> str:
    """Return records, a dataclass each, as csv."""
    return pd.DataFrame(points).to_csv(index=False)


def pareto(points: Sequence[Point]) -> list[Point]:
    """Return the Pareto front, the fastest point first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def time_at(front: Sequence[Point], error: float) -> float | None:
    """Return the time at which a front reaches an error; None if it never does.

    Between two settings of one method it interpolates in the logarithms; between two methods it
    takes the slower.
    """
    if error < front[-1].error:
        return None
    if error >= front[0].error:
        return front[0].seconds
    fast, slow = next((p, q) for p, q in itertools.pairwise(front) if q.error <= error < p.error)
    if fast.method != slow.method:
        return slow.seconds
    share = math.log(fast.error / error) / math.log(fast.error / slow.error)
    return fast.seconds * (slow.seconds / fast.seconds) ** share


def ratios(points: Sequence[Point], quick: bool = False) -> Iterator[Row]:
    """Compare cosim with the best of the peers on one circuit, and its error over all steps."""
    for work, short in ((NO_POLE, "no_pole"), (POLE, "amplifier_pole")):
        own = [p for p in points if p.work == work]
        theirs = pareto([p for p in own if p.method.startswith("peer")])
        front = pareto([p for p in own if p.method.startswith("cosim")])
        alone = [p.seconds for p in own if p.method == ALONE]
        if theirs and front:
            name = f"accuracy.speed_at_equal_error.{short}"
            speeds = [(p.seconds / t, p) for p in theirs if (t := time_at(front, p.error)) is not None]
            ratio, at = min(speeds, key=lambda pair: pair[0], default=(None, theirs[0]))
            note = f"their time over ours at equal error, the lowest: {at.method}, {at.setting}, {at.error:.2g} V"
            if ratio is None and quick:
                yield verdict.skip(f"{name}.best_peer", f"no setting of --quick is as exact; {note}", "1")
            else:
                yield verdict.measured(f"{name}.best_peer", ratio, "1", note)
            if alone:
                for place, error in (("one_percent", 0.01 * IDEAL.packet_v), ("coarsest", theirs[0].error)):
                    mine, peer = time_at(front, error), time_at(theirs, error)
                    ratio = bound = None
                    if mine is not None and peer is not None:
                        ratio, bound = peer / mine, peer / alone[0]
                    note = f"at {error:.2g} V; ngspice alone would give {bound or math.nan:.3g}"
                    yield verdict.measured(f"{name}.{place}", ratio, "1", note)
            within = [(p, [q.error for q in front if q.seconds <= p.seconds]) for p in theirs]
            gains = [p.error / max(min(errors), 1e-16) for p, errors in within if errors]
            note = "their error over ours at equal time, the lowest over their front"
            gain = min(gains, default=None)
            yield verdict.measured(f"accuracy.error_at_equal_time.{short}.best_peer", gain, "1", note)
        errors = [p.error for p in own if p.method == "cosim, icarus, step"]
        if len(errors) > 1:
            note = "largest over least error of cosim over all maximum steps"
            yield verdict.measured(f"accuracy.step_ratio.{short}", max(errors) / min(errors), "1", note)


def draw(points: Sequence[Point], path: Path) -> None:
    """Draw error against time of the points of one work with their Pareto front; peers are open."""
    figure = Figure(figsize=(11.5, 6.2), layout="constrained")
    axes = figure.add_subplot()
    frames = points[0].work == FRAMES
    # Below: one code of 256 off by one is 0.004 LSB; doubles carry 1e-16 V through 400 clocks of 0.1 V.
    floor, lsb = (1e-3, 1.0) if frames else (1e-13, IDEAL.packet_v)
    for p in points:
        if p.method == ALONE:
            axes.axvline(p.seconds, color=GREY, linewidth=0.9, linestyle="--", label=ALONE)
    points = [p for p in points if p.method != ALONE]
    for i, name in enumerate(dict.fromkeys(p.method for p in points)):
        own = [p for p in points if p.method == name]
        axes.plot(
            [p.seconds for p in own], [max(p.error, floor) for p in own], "osD^vP*X<>"[i % 10],
            color=COLOURS[i % len(COLOURS)], ms=7, mfc="none" if name.startswith("peer") else None, label=name,
        )  # fmt: skip
    front = pareto(points)
    steps = {"drawstyle": "steps-post", "color": GREY, "linewidth": 6, "alpha": 0.3, "zorder": 0}
    axes.plot([p.seconds for p in front], [max(p.error, floor) for p in front], label="Pareto front", **steps)
    for share in (1.0, 0.1):
        axes.axhline(share * lsb, color=GREY, linewidth=0.9, linestyle=":", label=f"{share:g} LSB")
    axes.set(xscale="log", yscale="log", title=f"Error against time: {points[0].work}")
    axes.set_xlabel(f"processor time a {'frame' if frames else 'clock'} / s")
    axes.set_ylabel(f"mean |code - reference| / LSB, exact at {floor:g}" if frames else "largest error / V")
    axes.grid(which="major", linewidth=0.4, alpha=0.6)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    save(figure, path)


@click.command("accuracy")
@click.option("--quick", is_flag=True, help="Fewer settings, one run each.")
@click.option("--only", type=click.Choice(("order", "converter", "frames")), help="Run one part.")
def accuracy_command(quick: bool, only: str | None) -> int:
    """Measure and draw error against simulation time, in build/accuracy."""
    rows, methods = [busy_row("accuracy.busy_cores")], []
    with tempfile.TemporaryDirectory(prefix="accuracy_") as scratch:
        if only in (None, "order"):
            rows.append(order_row(Path(scratch)))
            verdict.print_rows(rows, "First: the order of convergence")
        if only in (None, "converter"):
            methods += [m for work in CIRCUITS for m in converter_methods(work, Path(scratch), quick)]
            missing = {peer: peers.missing(peer) for peer in peers.GUESTS}
            rows += [verdict.skip(f"accuracy.peer.{peer}", why) for peer, why in missing.items() if why]
        if only in (None, "frames"):
            methods += frame_methods(quick)
        points, failed = measure(methods, 1 if quick else 3)
        rows += [*failed, *ratios(points, quick)]
    for name, file in FILES.items():
        if own := [p for p in points if p.work == name]:
            write_atomic(OUT / f"{file}.csv", points_csv(own))
            draw(own, OUT / f"{file}.png")
    shown = [*rows, *(point.row for point in points)]
    verdict.write_rows("accuracy", shown)
    verdict.print_rows(shown, "Accuracy against simulation time")
    return verdict.exit_code(rows)
