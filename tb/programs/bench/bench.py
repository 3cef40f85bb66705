# SPDX-License-Identifier: Apache-2.0
"""The benchmark: accuracy and speed of each engine, and of other simulators on the same circuit.

Errors have limits, speeds have aims; docs/benchmarks.md explains each row. A failed measurement
is an ERROR row, and the others are still made.
"""

import functools
import itertools
import math
import os
import re
import shutil
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from dermis import effects, engines
from dermis.array import array
from dermis.chip import hdl, netlist
from dermis.engines import cosim
from dermis.errors import InputError, SimulatorError
from dermis.places import ROOT
from dermis.processes import children, cpu_time
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.report.output import machine_line
from dermis.report.verdict import Row
from scripts import judged
from tb.programs.bench import circuit as circuits
from tb.programs.bench import peers
from tb.programs.bench.circuit import Circuit, Job
from tb.programs.bench.measure import busy_row, one_core, random_plan

STEPS = {"step_10n": 10e-9, "step_100n": 100e-9, "step_1u": 1e-6}
RUN_LIMIT_S = 60.0  # for one process; all take under 5 s on an idle machine

# A step of 10 ns costs the peers a hundred points a clock and more, so fewer clocks are run.
PEER_CLOCKS = {"step_10n": 300, "step_100n": 1000, "step_1u": 1000}
CIRCUIT = Circuit()
LONG_CIRCUIT = replace(CIRCUIT, gate_clocks=8000)  # for speeds: some 0.2 s
SIMULATORS = ICARUS, VERILATOR = "icarus", "verilator"
EXAMPLES = ("sigma_delta", "sar", "oscillator")

SAMPLE_S = 0.25  # shortest sample of speed; a shorter one measures the resolution of the timer
SERIES = {"lateral": True, "row_driver": True, "column_input": True}
"""Lateral and series resistances with the values of the design."""
SIZES = (16, 32, 64, 128, 256)
LARGE = 256  # rows and columns of a large frame


@dataclass
class Measurements:
    work: Path
    repeat: int
    quick: bool
    runs: Iterator[int] = field(default_factory=itertools.count)

    def place(self) -> Path:
        return self.work / f"run_{next(self.runs):03d}"


def machine_rows(m: Measurements) -> Iterator[Row]:
    yield verdict.report("machine.cores", os.cpu_count(), "cores", machine_line())
    yield busy_row("machine.busy_cores")


def _error_rows(name: str, kind: str, run: circuits.Run) -> Iterator[Row]:
    """Report the integrator at the clock edges, and the count, against the exact solution."""
    note = f"{run.clocks} clocks at {run.rate:.0f}/s with every sample kept"
    yield verdict.measured(f"{name}.edge_error_v.{kind}", run.error_v, "V", note)
    yield verdict.measured(f"{name}.count_error.{kind}", run.miscount, "pulses", f"{run.code} pulses")


def accuracy_rows(m: Measurements) -> Iterator[Row]:
    """Measure the errors of cosim, with Icarus at every step and with Verilator at one of 1 us."""
    kinds = {name: (step_s, ICARUS) for name, step_s in STEPS.items()}
    for kind, (step_s, simulator) in (kinds | {VERILATOR: (STEPS["step_1u"], VERILATOR)}).items():
        job = CIRCUIT, step_s, CIRCUIT.gate_clocks, m.place(), RUN_LIMIT_S
        yield from _error_rows("cosim", kind, circuits.cosim(*job, simulator=simulator))


def peer_rows(peer: str, m: Measurements) -> Iterator[Row]:
    """Measure the same errors of another simulator."""
    for kind, step_s in STEPS.items():
        job = CIRCUIT, step_s, PEER_CLOCKS[kind], m.place(), RUN_LIMIT_S
        yield from _error_rows(f"peer.{peer}", kind, peers.PEERS[peer](*job))


def speed_rows(m: Measurements) -> Iterator[Row]:
    """Measure clocks a second of cosim and of XSPICE in turns, so that other load affects all."""
    rates: dict[str, list[float]] = defaultdict(list)
    for _ in range(m.repeat):
        for simulator in SIMULATORS:
            job = LONG_CIRCUIT, STEPS["step_1u"], LONG_CIRCUIT.gate_clocks, m.place(), RUN_LIMIT_S
            run = circuits.cosim(*job, simulator=simulator, keep=False)
            if run.miscount:
                raise SimulatorError(f"{simulator} counted {run.code}, not {LONG_CIRCUIT.pulses}")
            rates[simulator].append(run.rate)
        done = peers.xspice(CIRCUIT, STEPS["step_1u"], CIRCUIT.clocks, m.place(), RUN_LIMIT_S)
        rates["xspice"].append(done.rate)
    for simulator in SIMULATORS:
        yield verdict.median(f"cosim.clocks_per_s.{simulator}", rates[simulator], "1/s")
    note = "the transient alone, without start and waveform file"
    yield verdict.median("peer.xspice.clocks_per_s", rates["xspice"], "1/s", note)
    pairs = [ours / theirs for ours, theirs in zip(rates[ICARUS], rates["xspice"], strict=True)]
    yield verdict.median("cosim.speed_ratio.xspice", pairs, "1", "Icarus over XSPICE in pairs, step 1 us")


def loop_rows(m: Measurements) -> Iterator[Row]:
    """Measure what Verilog and loop add to ngspice alone, in processor time, one after the other."""
    made = random_plan(1, "cosim")
    deck = functools.partial(netlist.frame_deck, made, 0)
    frame = Job(made.timing, made.cols, hdl.reader_parameters(made, False), deck, alone=True)
    jobs = {"frame": frame, "converter": circuits.converter(LONG_CIRCUIT, alone=True)}
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for _, (name, job), simulator in itertools.product(range(m.repeat), jobs.items(), SIMULATORS):
        done = circuits.frame(replace(job, simulator=simulator), m.place(), RUN_LIMIT_S)
        found[name, simulator].append(done.cpu_s / done.alone_s)
    for simulator in SIMULATORS:
        note = f"one frame of {made.rows}x{made.cols}, from its first time point to its last"
        yield verdict.median(f"cosim.loop_over_ngspice.{simulator}", found["frame", simulator], "1", note)
    for simulator in SIMULATORS:
        shares, note = 1.0 / np.array(found["converter", simulator]), "one VFC, clocks/s over ngspice alone"
        yield verdict.median(f"cosim.ngspice_share.{simulator}", shares, "1", note)


def example_rows(m: Measurements) -> Iterator[Row]:
    """Measure the examples of docs/lockstep.md against their closed forms; the worse of both simulators."""
    for name in EXAMPLES:
        folder, errors, said = ROOT / "docs" / "examples" / name, [], ""
        for simulator in SIMULATORS:
            build = hdl.build(simulator, name, {}, sources=[folder / f"{name}.v"], where="lockstep")
            where = m.place()
            shutil.copytree(folder, where)
            path = {"PYTHONPATH": os.pathsep.join([str(where), *sys.path])}
            with suppress(SystemExit):  # of cocotb's runner; without a result there is no error in the log
                hdl.run_cocotb(simulator, build, name, f"test_{name}", where, path, limit_s=RUN_LIMIT_S)
            found = re.search(r"error = (\S+) \S+ (.*)", (where / "hdl.log").read_text())
            if found is None:
                raise SimulatorError(f"example {name} gave no result in {simulator}", where)
            errors.append(float(found[1]))
            said = found[2]
        yield verdict.judge(f"lockstep.examples.{name}", max(errors), said)


def guest_rows(peer: str, m: Measurements) -> Iterator[Row]:
    """Measure a simulator that may be installed: error at three steps, clocks a second at 1 us."""
    if reason := peers.missing(peer):
        yield verdict.skip(f"peer.{peer}", reason)
        return
    yield from peer_rows(peer, m)
    few, many, rates = 100, 4000, []  # starts differ by 10 ms, and 3900 clocks take 0.5 s or more
    for _ in range(m.repeat):
        short_s, long_s = (
            peers.GUESTS[peer](CIRCUIT, STEPS["step_1u"], clocks, m.place(), RUN_LIMIT_S).seconds
            for clocks in (few, many)
        )
        rates.append((many - few) / (long_s - short_s))
    note = f"step 1 us, Icarus, waveform kept, without the start; {peers.PIP[peer]}"
    yield verdict.median(f"peer.{peer}.clocks_per_s", rates, "1/s", note)


def frame_rows(m: Measurements) -> Iterator[Row]:
    """Measure whole frames in cosim, and compare their codes with those of engine closed."""
    one, two = (random_plan(frames, "cosim") for frames in (1, 2))
    kinds: dict[str, tuple[str, Plan, dict[str, Any]]] = {
        "": ("Icarus, one core", one, {}),
        ".verilator": ("Verilator, one core", one, {"simulator": VERILATOR}),
        ".two_cores": ("one of two parallel frames, Icarus", two, {}),
        ".exact_half": ("Icarus, the exact converter instead of ngspice", one, {"analog": "exact"}),
    }
    for simulator in SIMULATORS:  # builds, so that none is timed
        cosim.run(one, simulator=simulator, analog="exact", work=m.place())
    repeat, worst = 1 if m.quick else min(3, m.repeat), 0
    times: dict[str, list[float]] = defaultdict(list)
    for kind, (_, made, options) in [*kinds.items()] * repeat:
        begin = time.perf_counter()
        codes = cosim.run(made, work=m.place(), **options).codes.astype(int)
        times[kind].append((time.perf_counter() - begin) / made.frames)
        expected = engines.run(replace(made, engine="closed")).codes
        worst = max(worst, int(np.abs(codes - expected).max()))
    for kind, (note, *_) in kinds.items():
        note += f"; {one.rows}x{one.cols} resistances over the range, start of the processes included"
        yield verdict.median(f"cosim.frame_s{kind}", times[kind], "s", note)
    note = f"{repeat * len(kinds)} runs against engine closed, all taxels"
    yield verdict.judge("cosim.frame_code_error_lsb", worst, note)


def all_effects(engine: str) -> tuple[dict[str, bool], list[str]]:
    """Return the effects an engine honours with their physical defaults, and names it refuses."""
    # event refuses `return` together with line_capacitance
    names = [name for name in effects.EFFECTS if name != "return"]
    probe = random_plan(1, engine, **dict.fromkeys(names, True))
    lost = {name for field in engines.refused(probe, engine) for name in probe.effects_of_field(field)}
    return {name: True for name in names if name not in lost}, sorted({*lost, "return"})


def _runner(made: Plan) -> Callable[[], engines.Result]:
    engines.check(made)
    return functools.partial(engines.runner(made.engine), made)


def _cpu_ratios(first: Plan, second: Plan, repeat: int) -> list[float]:
    """Return processor time of one plan over that of another, measured in pairs."""
    runs = _runner(first), _runner(second)
    for run in runs:
        run()  # compiles and fills caches
    return [cpu_time.cpu_seconds(runs[0]) / cpu_time.cpu_seconds(runs[1]) for _ in range(repeat)]


def _speed(name: str, run: Callable[[], Any], frames: int, repeat: int, note: str, least_s: float) -> Row:
    """Return the row of frames a second of a call, repeated for `least_s` a sample."""
    rates, cpu = [], []
    for _ in range(repeat):
        count, begin, cpu_begin = 0, time.perf_counter(), cpu_time.cpu_used_s()
        while not count or time.perf_counter() - begin < least_s:
            run()
            count += frames
        rates.append(count / (time.perf_counter() - begin))
        cpu.append(count / (cpu_time.cpu_used_s() - cpu_begin))
    said = f"{statistics.median(cpu):.0f} a second of processor time"
    return verdict.median(name, rates, "1/s", f"resistances over the range; {note}; {said}")


def engine_row(m: Measurements, name: str, frames: int, on: dict[str, Any], note: str) -> Row:
    """Measure frames per second of an engine, the first part of a row's name, with some effects."""
    run = _runner(random_plan(frames, name.partition(".")[0], **on))
    run()  # compiles and fills caches
    return _speed(name, run, frames, m.repeat, note, SAMPLE_S)


def closed_rows(m: Measurements) -> Iterator[Row]:
    """Measure the closed engine: ideal, with lateral and series resistances, with traces."""
    kinds = {"": (512, {}), ".series": (512, SERIES), ".trace": (128, {**SERIES, "trace": True})}
    for kind, (frames, on) in kinds.items():
        yield engine_row(m, f"closed.frames_per_s{kind}", frames, on, " ".join(on) or "ideal")


def event_rows(m: Measurements) -> Iterator[Row]:
    """Measure the event engine, and the cost of a taxel of a large frame."""
    on, lost = all_effects("event")
    note = f"{len(on)} effects with their physical defaults, noise included; without {', '.join(lost)}"
    yield engine_row(m, "event.frames_per_s.ideal", 128, {}, "no effect")
    yield engine_row(m, "event.frames_per_s.all_effects", 64, on, f"{note}, which event refuses")
    # The filter is not the engine's own runner.
    large = functools.partial(engines.run, random_plan(16, "event", 64, auto={}, trace=True))
    large()
    yield _speed("auto.frames_per_s.64.trace", large, 16, m.repeat, "64x64, auto with traces", SAMPLE_S)
    # Converters only: array.exponent has the cost of the network.
    small = random_plan((LARGE // 16) ** 2, "event", 16)
    note = "processor time of one frame of 256x256 over 256 of 16x16, in pairs; no effect"
    ratios = _cpu_ratios(random_plan(1, "event", LARGE), small, m.repeat)
    yield verdict.median("event.cost_per_taxel_ratio", ratios, "1", note)


def off_rows(m: Measurements) -> Iterator[Row]:
    off = dict.fromkeys(effects.EFFECTS, False)
    for kind, engine, frames in (("", "event", 32), (".closed", "closed", 512)):
        named, bare = (random_plan(frames, engine, **on) for on in (off, {}))
        note = f"{engine}: {len(off)} effects named and off over the bare scene, processor time, in pairs"
        ratios = _cpu_ratios(named, bare, 2 * m.repeat + 1)
        yield verdict.median(f"effects_off.time_ratio{kind}", ratios, "1", note)


BADCROSSBAR_ROWS = (
    "peer.badcrossbar.frames_per_s",
    "closed.speed_ratio.badcrossbar",
    "closed.difference.badcrossbar",
)


def badcrossbar_rows(m: Measurements) -> Iterator[Row]:
    """Solve a frame with distributed lines, row by row, by badcrossbar and by our solver in pairs."""
    if reason := peers.missing("badcrossbar"):
        yield from (verdict.skip(name, reason) for name in BADCROSSBAR_ROWS)
        return
    network = random_plan(1, "closed", trace={"r_row_ohm": 1.0, "r_column_ohm": 1.0}).network(0)
    g = np.broadcast_to(network.g_taxel_s, (64, *network.g_taxel_s.shape)).copy()
    rates, ratios = [], []
    for _ in range(m.repeat):
        seconds, currents = peers.badcrossbar(network, 2 * RUN_LIMIT_S, 1 if m.quick else 5)
        rates.append(1.0 / seconds)
        ours = [cpu_time.cpu_seconds(lambda: array.column_currents(network, g)) for _ in range(5)]
        ratios.append(len(g) / statistics.median(ours) * seconds)
    difference = float(np.max(np.abs(array.column_currents(network, g[:1])[0] / currents - 1.0)))
    speed, ratio, apart = BADCROSSBAR_ROWS
    note = f"{peers.PIP['badcrossbar'].split()[0]}: a frame with 1 ohm a pitch, all rows at once"
    yield verdict.median(speed, rates, "1/s", f"{note}, processor time")
    note = "our frames per second over badcrossbar's, the same network, in pairs"
    yield verdict.median(ratio, ratios, "1", note)
    yield verdict.judge(apart, difference, "largest relative difference of a column current")


def exponent_rows(m: Measurements) -> Iterator[Row]:
    """Measure the growth of the network solve with the number of taxels."""
    for kind, on in (("", SERIES), (".trace", {**SERIES, "trace": True})):
        sizes = SIZES[:-1] if m.quick or kind else SIZES
        times = [_solve_s(size, 1 if m.quick else min(m.repeat, 3), on) for size in sizes]
        exponent = float(np.polyfit(np.log([n * n for n in sizes]), np.log(times), 1)[0])
        last = math.log(times[-1] / times[-2]) / math.log((sizes[-1] / sizes[-2]) ** 2)
        each = ", ".join(f"{n}: {1e9 * t / n**2:.0f}" for n, t in zip(sizes, times, strict=True))
        note = f"t ~ taxels^e, {sizes[0]}x{sizes[0]} to {sizes[-1]}x{sizes[-1]}, {' '.join(on)}; "
        note += f"between the last two {last:.2f}; ns a taxel: {each}"
        yield verdict.judge(f"array.exponent{kind}", exponent, note)


def _solve_s(size: int, repeat: int, on: dict[str, Any]) -> float:
    """Return the processor time per frame of the array solve in batches as of engine closed."""
    frames = max(1, (1 << 15) // size**2)
    made = random_plan(frames, "closed", size, **on)
    solve = functools.partial(array.column_currents, made.network(0), made.conductance_s())
    solve()
    return statistics.median(cpu_time.cpu_seconds(solve) for _ in range(repeat)) / frames


def rtl_rows(m: Measurements) -> Iterator[Row]:
    """Measure the real Verilog with real-number models."""
    for simulator, frames in ((VERILATOR, 256 if m.quick else 2048), (ICARUS, 2 if m.quick else 4)):
        run = functools.partial(engines.run, random_plan(frames, "rtl"), simulator=simulator)
        wrong = int((run().codes != engines.run(random_plan(frames, "closed")).codes).sum())  # builds
        if wrong:
            raise SimulatorError(f"{simulator}: {wrong} of {frames} frames' codes differ from engine closed")
        note = f"{frames} at a time, start of the process included; codes are those of closed"
        yield _speed(f"rtl.frames_per_s.{simulator}", run, frames, min(m.repeat, 3), note, 0.0)


def setup_rows(m: Measurements) -> Iterator[Row]:
    """Measure `make setup` with nothing to do; the first call may have something."""
    taken = []
    for _ in range(2 if m.quick else 4):
        begin, log = time.perf_counter(), m.work / "setup.log"
        # The limit is generous: an interrupted set-up costs the next one a new .venv.
        command = ["make", "-C", str(ROOT), "setup"]
        children.run_logged(command, m.work, log, 900, "make setup", {"MAKEFLAGS": ""})
        taken.append(time.perf_counter() - begin)
    yield verdict.median("setup.second_call_s", taken[1:], "s")


class Section(NamedTuple):
    """Measurements made together, and the rows, or heads of rows, that they make."""

    make: Callable[[Measurements], Iterator[Row]]
    names: tuple[str, ...]
    one_core: bool = False


SECTIONS = (
    Section(machine_rows, ("machine",)),
    Section(accuracy_rows, ("cosim.edge_error_v", "cosim.count_error")),
    Section(functools.partial(peer_rows, "xspice"), ("peer.xspice.edge_error_v", "peer.xspice.count_error")),
    Section(speed_rows, ("cosim.clocks_per_s", "peer.xspice.clocks_per_s", "cosim.speed_ratio.xspice")),
    Section(loop_rows, ("cosim.loop_over_ngspice", "cosim.ngspice_share")),
    Section(example_rows, ("lockstep.examples",)),
    *(Section(functools.partial(guest_rows, peer), (f"peer.{peer}",)) for peer in peers.GUESTS),
    Section(frame_rows, ("cosim.frame_s", "cosim.frame_code_error_lsb")),
    Section(closed_rows, ("closed.frames_per_s",), True),
    Section(badcrossbar_rows, BADCROSSBAR_ROWS, True),
    Section(event_rows, ("event.frames_per_s", "auto.frames_per_s", "event.cost_per_taxel_ratio"), True),
    Section(off_rows, ("effects_off.time_ratio",), True),
    Section(exponent_rows, ("array.exponent",), True),
    Section(rtl_rows, ("rtl.frames_per_s",), True),
    Section(setup_rows, ("setup.second_call_s",)),
)


def run_section(section: Section, m: Measurements) -> list[Row]:
    """Return the rows of a section, and an ERROR row for each name of which a failure left no row."""
    rows: list[Row] = []
    try:
        with one_core() if section.one_core else nullcontext():
            for row in section.make(m):
                rows.append(row)
    except Exception as error:  # the other sections still run
        reason = f"{type(error).__name__}: {error}"
    else:
        return rows
    missing = [name for name in section.names if not any(row["name"].startswith(name) for row in rows)]
    return rows + [verdict.error(name, reason) for name in missing or section.names[-1:]]


def chosen(only: Sequence[str]) -> list[Section]:
    """Return the sections that make the rows of some names, or all; InputError for a name of none."""

    def fits(name: str, wanted: str) -> bool:
        return f"{name}.".startswith(f"{wanted}.") or f"{wanted}.".startswith(f"{name}.")

    known = [name for section in SECTIONS for name in section.names]
    for wanted in only:
        if not any(fits(name, wanted) for name in known):
            raise InputError("command line", "--only", wanted, f"a row of {', '.join(known)}")
    return [s for s in SECTIONS if not only or any(fits(name, w) for name in s.names for w in only)]


@click.command("bench")
@click.option("--quick", is_flag=True, help="Fewer repetitions; not for the documentation.")
@click.option("--repeat", type=click.IntRange(min=1), help="Runs of each median; default 5, with --quick 2.")
@click.option(
    "--only", multiple=True, metavar="NAME", help="Only what makes the rows NAME and NAME.* (repeatable)."
)
def bench_command(quick: bool, repeat: int | None, only: tuple[str, ...]) -> int:
    """Measure accuracy and speed; rows in build/bench.json, with --only these rows alone."""
    sections = chosen(only)
    base = ROOT / "build" / "bench"
    base.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=base))  # a new one, as two runs may be parallel
    m = Measurements(work, repeat or (2 if quick else 5), quick)
    rows: list[Row] = []
    with progress.slots("bench", len(sections), "sections") as tell:
        for done, section in enumerate(sections):
            tell(done, f"{section.names[0]} and {len(section.names) - 1} more")
            rows += run_section(section, m)
    code = judged.finish("bench", rows, "Benchmark")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if broken:
        click.echo(f"decks and logs of failed measurements are in {work}")
    else:
        shutil.rmtree(work, ignore_errors=True)
    return code
