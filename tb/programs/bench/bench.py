# SPDX-License-Identifier: Apache-2.0
"""The benchmark: accuracy and speed of each engine, and of other co-simulators on the same circuit.

Errors have limits, speeds have aims; docs/benchmarks.md explains each row. A failed measurement
is an ERROR row, and the others are still made.
"""

from __future__ import annotations

import functools
import importlib.metadata
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import engines
from dermis.engines import cosim
from dermis.engines.batch import fingerprint
from dermis.errors import DermisError, InputError, SimulatorError
from dermis.files import write_between
from dermis.places import ROOT
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from tb.programs.accuracy import converter
from tb.programs.bench import circuit as circuits
from tb.programs.bench import engines as engine_rows
from tb.programs.bench import history as past
from tb.programs.bench import peers
from tb.programs.bench.circuit import Circuit, Job, Run
from tb.programs.bench.measure import busy_row, markdown, random_plan, time_limit

DOCS = "docs/benchmarks.md"
BEGIN, END = "<!-- begin: bench (written by dermis bench --docs) -->", "<!-- end: bench -->"
SHOWN = (
    "cosim.edge_error_v.step_1u", "cosim.clocks_per_s", "cosim.speed_ratio.xspice", "peer.xspice.edge_error_v.step_1u",
    "cosim.frame_s", "closed.frames_per_s.series", "closed.speed_ratio.badcrossbar", "event.frames_per_s",
    "rtl.frames_per_s.verilator", "array.exponent",
)  # fmt: skip
"""Rows of the table in the documentation; build/bench.json has all."""

STEPS = {"step_10n": 10e-9, "step_100n": 100e-9, "step_1u": 1e-6}
RUN_LIMIT_S = 60.0
"""For one process; all take under 5 s on an idle machine."""

# A step of 10 ns costs the peers a hundred points a clock and more, so fewer clocks are run.
_PEER_CLOCKS = {"step_10n": 300, "step_100n": 1000, "step_1u": 1000}


class Measurements:
    """Settings, scratch space, and results that more than one section needs."""

    def __init__(self, work: Path, repeat: int, quick: bool) -> None:
        self.work, self.repeat, self.quick = work, repeat, quick
        self.circuit = Circuit()
        self.held = replace(
            self.circuit, preset=True
        )  # the same start for every frame, for many frames in one run
        self._runs = 0

    def place(self) -> Path:
        """Return the path of a new directory."""
        self._runs += 1
        return self.work / f"run_{self._runs:03d}"

    def made_place(self) -> Path:
        """Return a new directory."""
        where = self.place()
        where.mkdir(parents=True)
        return where

    def measure(self, job: Job) -> Run:
        """Run a job in a separate process."""
        return circuits.measure(job, self.place(), RUN_LIMIT_S)

    @functools.cached_property
    def exact_runs(self) -> dict[str, Run]:
        """Runs of the real Verilog in Icarus by step."""
        return {name: self.measure(Job(self.circuit, 1, step, keep=True)) for name, step in STEPS.items()}


def _machine(m: Measurements) -> Iterator[Row]:
    yield verdict.report("machine.cores", os.cpu_count(), "cores", machine_line())
    yield busy_row("machine.busy_cores")


def _accuracy(m: Measurements) -> Iterator[Row]:
    kinds = {
        name: (m.circuit, run, f"Icarus, {run.rate(m.circuit):.0f} clocks/s with every sample kept")
        for name, run in m.exact_runs.items()
    }
    for name, simulator in (("preset", "icarus"), ("verilator", "verilator")):
        run = m.measure(Job(m.held, 1, simulator=simulator, keep=True))
        kinds[name] = m.held, run, f"step 1 us, started by the preset switch as on the chip, {simulator}"
    for name, (circuit, run, note) in kinds.items():
        note = f"{circuit.clocks} clocks; {note}"
        yield verdict.judge(f"cosim.edge_error_v.{name}", run.error_v(circuit), note)
        note = f"{run.codes[0]} of {circuit.pulses} pulses"
        yield verdict.judge(f"cosim.count_error.{name}", run.miscount(circuit), note)


def _order(m: Measurements) -> Iterator[Row]:
    yield converter.order_row(m.made_place())


def _xspice(m: Measurements) -> Iterator[Row]:
    for name, step in STEPS.items():
        run = peers.xspice(m.circuit, step, _PEER_CLOCKS[name], m.place(), RUN_LIMIT_S)
        yield from _peer_rows("xspice", name, run, f"{run.clocks} clocks at {run.rate:.0f}/s")


def _peer_rows(peer: str, step: str, run: peers.PeerRun, note: str) -> Iterator[Row]:
    yield verdict.report(f"peer.{peer}.edge_error_v.{step}", run.error_v, "V", note)
    yield verdict.report(f"peer.{peer}.count_error.{step}", run.count_error, "pulses")


def _speed(m: Measurements) -> Iterator[Row]:
    step = STEPS["step_1u"]
    rates: dict[str, list[float]] = {"icarus": [], "verilator": [], "xspice": []}
    for _ in range(m.repeat):
        # In turns, so that other load on the machine affects all of them.
        for simulator in ("icarus", "verilator"):
            run = m.measure(Job(m.held, 3 if m.quick else 5, step, simulator))
            if run.miscount(m.held):
                raise SimulatorError(f"{simulator} counted {run.codes}, not {m.held.pulses}")
            rates[simulator].append(run.rate(m.held))
        rates["xspice"].append(peers.xspice(m.circuit, step, m.circuit.clocks, m.place(), RUN_LIMIT_S).rate)
    for simulator in ("icarus", "verilator"):
        yield verdict.median(f"cosim.clocks_per_s.{simulator}", rates[simulator], "1/s")
    note = "the transient alone, without start and waveform file"
    yield verdict.median("peer.xspice.clocks_per_s", rates["xspice"], "1/s", note)
    pairs = [ours / theirs for ours, theirs in zip(rates["icarus"], rates["xspice"], strict=True)]
    yield verdict.median("cosim.speed_ratio.xspice", pairs, "1", "Icarus over XSPICE in pairs, step 1 us")


def _guest(peer: str, m: Measurements) -> Iterator[Row]:
    if reason := peers.missing(peer):
        for name in _guest_names(peer):
            yield verdict.skip(name, reason)
        return
    version = f"{peer} {importlib.metadata.version(peer.replace('_', '-'))}"
    for name, step in STEPS.items():
        if m.quick and name == "step_10n":
            yield verdict.skip(f"peer.{peer}.edge_error_v.{name}", "left out by --quick", "V")
            yield verdict.skip(f"peer.{peer}.count_error.{name}", "left out by --quick", "pulses")
            continue
        run = peers.GUESTS[peer](m.circuit, step, _PEER_CLOCKS[name], m.place(), RUN_LIMIT_S)
        yield from _peer_rows(peer, name, run, f"{run.clocks} clocks, {version}")
    rates = [peers.rate(peer, m.circuit, STEPS["step_1u"], m.place, RUN_LIMIT_S) for _ in range(m.repeat)]
    yield verdict.median(f"peer.{peer}.clocks_per_s", rates, "1/s", "step 1 us, Icarus")


def _guest_names(peer: str) -> tuple[str, ...]:
    kinds = [f"{kind}.{step}" for kind in ("edge_error_v", "count_error") for step in STEPS]
    return tuple(f"peer.{peer}.{rest}" for rest in (*kinds, "clocks_per_s"))


def _frame(m: Measurements) -> Iterator[Row]:
    one, two = (random_plan(m.work, frames, "cosim") for frames in (1, 2))
    worst = 0

    def seconds(which: Plan, **options: Any) -> float:
        nonlocal worst
        begin = time.perf_counter()
        codes = cosim.run(which, work=m.place(), **options).codes.astype(int)
        taken = time.perf_counter() - begin
        expected = engines.run(replace(which, engine="closed")).codes
        worst = max(worst, int(np.abs(codes - expected).max()))
        return taken / which.frames

    ways: dict[str, tuple[str, Plan, dict[str, Any]]] = {
        "": ("Icarus, one core", one, {}),
        ".verilator": ("Verilator, one core", one, {"simulator": "verilator"}),
        ".two_cores": ("one of two parallel frames, Icarus", two, {}),
        ".exact_half": ("Icarus, the exact converter instead of ngspice", one, {"analog": "exact"}),
    }
    cosim.run(one, simulator="verilator", analog="exact", work=m.place())  # builds, so that none is timed
    cosim.run(one, analog="exact", work=m.place())
    repeat = 1 if m.quick else min(3, m.repeat)
    times: dict[str, list[float]] = {kind: [] for kind in ways}
    for _ in range(repeat):
        for kind, (_, which, options) in ways.items():
            times[kind].append(seconds(which, **options))
    for kind, (note, *_) in ways.items():
        note += f"; {one.rows}x{one.cols} resistances over the range, start of the processes included"
        yield verdict.median(f"cosim.frame_s{kind}", times[kind], "s", note)
    note = f"{repeat * len(ways)} runs against engine closed, all taxels"
    yield verdict.judge("cosim.frame_code_error_lsb", worst, note)


def _setup(m: Measurements) -> Iterator[Row]:
    taken = []
    for _ in range(2 if m.quick else 4):
        where, begin = m.made_place(), time.perf_counter()
        # The limit is generous: an interrupted set-up costs the next one a new .venv.
        status = circuits.call(["make", "-C", ROOT, "setup"], where, 900, MAKEFLAGS="")
        taken.append(time.perf_counter() - begin)
        if status:
            raise SimulatorError(f"make setup ended with {status}", where)
    yield verdict.median("setup.second_call_s", taken[1:], "s")


@dataclass(frozen=True)
class Section:
    """Measurements made together: their rows and time limit."""

    names: tuple[str, ...]
    make: Callable[[Measurements], Iterator[Row]]
    limit_s: float


def _names(*heads: str, kinds: Sequence[str] = tuple(STEPS)) -> tuple[str, ...]:
    return tuple(f"{head}.{kind}" for head in heads for kind in kinds)


def _engine_section(make: Any, m: Measurements) -> Iterator[Row]:
    return make(m.made_place(), m.repeat, m.quick)


SECTIONS = (
    Section(("machine.cores", "machine.busy_cores"), _machine, 60),
    Section(
        _names("cosim.edge_error_v", "cosim.count_error", kinds=(*STEPS, "preset", "verilator")),
        _accuracy,
        300,
    ),
    Section(("accuracy.order",), _order, 300),
    Section(_names("peer.xspice.edge_error_v", "peer.xspice.count_error"), _xspice, 180),
    Section(
        (
            *_names("cosim.clocks_per_s", kinds=("icarus", "verilator")),
            "peer.xspice.clocks_per_s",
            "cosim.speed_ratio.xspice",
        ),
        _speed,
        300,
    ),
    *(Section(_guest_names(peer), functools.partial(_guest, peer), 300) for peer in peers.GUESTS),
    Section(
        (
            "cosim.frame_s",
            *_names("cosim.frame_s", kinds=("verilator", "two_cores", "exact_half")),
            "cosim.frame_code_error_lsb",
        ),
        _frame,
        600,
    ),
    *(
        Section(names, functools.partial(_engine_section, make), limit_s)
        for names, make, limit_s in engine_rows.SECTIONS
    ),
    Section(("setup.second_call_s",), _setup, 1800),
)


def run_section(section: Section, m: Measurements) -> list[Row]:
    """Return the rows of a section; rows that a failure prevented are ERROR rows with its
    reason.
    """
    rows: list[Row] = []
    reason = "not measured"
    try:
        with time_limit(section.limit_s):
            for row in section.make(m):
                rows.append(row)
    except (DermisError, TimeoutError, subprocess.SubprocessError) as error:
        reason = str(error)
    # Any other defect of a section is an ERROR row as well; the others still run.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
    made = {row["name"] for row in rows}
    return rows + [verdict.error(name, reason) for name in section.names if name not in made]


def chosen(only: Sequence[str]) -> list[Section]:
    """Return the sections with a row of one of the names, or of a name below it; all sections
    without names.
    """

    def fits(name: str, wanted: str) -> bool:
        return name == wanted or name.startswith(wanted + ".")

    known = [name for section in SECTIONS for name in section.names]
    for wanted in only:
        if not any(fits(name, wanted) for name in known):
            heads = ", ".join(sorted({".".join(name.split(".")[:2]) for name in known}))
            raise InputError("command line", "--only", wanted, f"a row, or the beginning of one: {heads}")
    return [s for s in SECTIONS if not only or any(fits(name, w) for name in s.names for w in only)]


def write_docs(rows: Sequence[Row], root: Path = ROOT) -> None:
    """Put the table between its marks in docs/benchmarks.md.

    Raises
    ------
    InputError
        The marks are missing.
    """
    machine = next((row["note"] for row in rows if row["name"] == "machine.cores"), "machine unknown")
    write_between(root / DOCS, BEGIN, END, f"Machine: {machine}.\n\n{markdown(rows, SHOWN)}")


@click.command("bench")
@click.option("--quick", is_flag=True, help="Fewer repetitions; not for the documentation.")
@click.option("--repeat", type=click.IntRange(min=1), help="Runs of each median; default 5, with --quick 2.")
@click.option("--only", multiple=True, metavar="NAME", help="Only rows NAME and NAME.* (repeatable).")
@click.option("--docs", is_flag=True, help=f"Also write the table in {DOCS}.")
@click.option("--bless", is_flag=True, help="Make this run the reference of later runs.")
@click.option("--history", is_flag=True, help="Show earlier runs and measure nothing.")
def bench_command(
    quick: bool, repeat: int | None, only: tuple[str, ...], docs: bool, bless: bool, history: bool
) -> int:
    """Measure accuracy and speed; rows in build/bench.json, with --only these rows alone.

    Every run is kept in build/bench_history and compared with the blessed one,
    models/bench_blessed.json.
    """
    for flag, given in (("--docs", docs), ("--bless", bless)):
        if given and (quick or only):
            raise InputError("command line", flag, "with --quick or --only", "a whole run")
    if history:
        past.print_history(past.history())
        return 0
    before = past.blessed()  # an unreadable file is reported before the measurements
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
    machine = machine_line()
    options = {"quick": quick, "repeat": m.repeat, "only": list(only)}
    run = past.record(rows, machine, fingerprint()[:12], options)
    kept = past.keep(run)
    said = list(past.report(rows, machine, before, whole=not only and not quick))
    rows += past.summary(rows, before)
    verdict.write_rows("bench", rows)
    verdict.print_rows(rows, "Benchmark")
    click.echo("\n".join([*said, f"kept: {kept.relative_to(ROOT)}"]))
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if broken:
        click.echo(f"decks and logs of failed measurements are in {work}")
    else:
        shutil.rmtree(work, ignore_errors=True)
    if docs and broken:
        click.echo(f"not written: {DOCS}, because {broken[0]} was not measured")
    elif docs:
        write_docs(rows)
        click.echo(f"written: {DOCS}")
    if bless:
        past.bless(run, rows)
        click.echo(f"written: {past.BLESSED.relative_to(ROOT)}")
    return verdict.exit_code(rows)
