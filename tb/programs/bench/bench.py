# SPDX-License-Identifier: Apache-2.0
"""The benchmark: accuracy and speed of each engine, and of other co-simulators on the same circuit.

Errors have limits, speeds have aims; docs/benchmarks.md explains each row. A failed measurement
is an ERROR row, and the others are still made.
"""

from __future__ import annotations

import functools
import os
import shutil
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
from dermis.errors import InputError, SimulatorError
from dermis.places import ROOT
from dermis.processes import children
from dermis.records import Plan
from dermis.report import progress, verdict
from dermis.report.output import machine_line
from dermis.report.verdict import Row
from tb.programs.bench import circuit as circuits
from tb.programs.bench import engines as engine_rows
from tb.programs.bench import peers
from tb.programs.bench.circuit import Circuit, Job, Run
from tb.programs.bench.measure import busy_row, random_plan, time_limit

STEPS = {"step_10n": 10e-9, "step_100n": 100e-9, "step_1u": 1e-6}
RUN_LIMIT_S = 60.0
"""For one process; all take under 5 s on an idle machine."""

# A step of 10 ns costs the peers a hundred points a clock and more, so fewer clocks are run.
PEER_CLOCKS = {"step_10n": 300, "step_100n": 1000, "step_1u": 1000}
CIRCUIT = Circuit()
LONG_CIRCUIT = replace(CIRCUIT, gate_clocks=8000)
"""For speeds: some 0.2 s."""
ICARUS, VERILATOR = "icarus", "verilator"


class Measurements:
    """Settings and scratch space."""

    def __init__(self, work: Path, repeat: int, quick: bool) -> None:
        self.work, self.repeat, self.quick = work, repeat, quick
        self._runs = 0

    def place(self) -> Path:
        """Return the path of a new directory."""
        self._runs += 1
        return self.work / f"run_{self._runs:03d}"

    def measure(self, job: Job) -> Run:
        """Run a job in a separate process."""
        return circuits.measure(job, self.place(), RUN_LIMIT_S)


def machine_rows(m: Measurements) -> Iterator[Row]:
    """Describe the machine and what else runs on it."""
    yield verdict.report("machine.cores", os.cpu_count(), "cores", machine_line())
    yield busy_row("machine.busy_cores")


def accuracy_rows(m: Measurements) -> Iterator[Row]:
    """Compare the integrator at the clock edges, and the count, with the exact solution."""
    kinds = {name: (Job(CIRCUIT, step, keep=True), "Icarus") for name, step in STEPS.items()}
    kinds[VERILATOR] = Job(CIRCUIT, keep=True, simulator=VERILATOR), "step 1 us, Verilator"
    for name, (job, note) in kinds.items():
        run = m.measure(job)
        note = f"{CIRCUIT.clocks} clocks; {note}, {run.rate:.0f} clocks/s with every sample kept"
        yield verdict.judge(f"cosim.edge_error_v.{name}", run.error_v, note)
        note = f"{run.code} of {CIRCUIT.pulses} pulses"
        yield verdict.judge(f"cosim.count_error.{name}", run.miscount, note)


def _peer_rows(peer: str, run: Callable[..., peers.PeerRun], m: Measurements) -> Iterator[Row]:
    for name, step_s in STEPS.items():
        done = run(CIRCUIT, step_s, PEER_CLOCKS[name], m.place(), RUN_LIMIT_S)
        note = f"{done.clocks} clocks in {done.seconds:.3g} s"
        yield verdict.report(f"peer.{peer}.edge_error_v.{name}", done.error_v, "V", note)
        yield verdict.report(f"peer.{peer}.count_error.{name}", done.count_error, "pulses")


def xspice_rows(m: Measurements) -> Iterator[Row]:
    """Measure ngspice with its event-driven code models."""
    yield from _peer_rows("xspice", peers.xspice, m)


def speed_rows(m: Measurements) -> Iterator[Row]:
    """Measure clocks a second of cosim and of XSPICE in turns, so that other load affects all."""
    rates: dict[str, list[float]] = {ICARUS: [], VERILATOR: [], "xspice": []}
    for _ in range(m.repeat):
        for simulator in (ICARUS, VERILATOR):
            run = m.measure(Job(LONG_CIRCUIT, STEPS["step_1u"], simulator))
            if run.miscount:
                raise SimulatorError(f"{simulator} counted {run.code}, not {LONG_CIRCUIT.pulses}")
            rates[simulator].append(run.rate)
        done = peers.xspice(CIRCUIT, STEPS["step_1u"], CIRCUIT.clocks, m.place(), RUN_LIMIT_S)
        rates["xspice"].append(done.clocks / done.seconds)
    for simulator in (ICARUS, VERILATOR):
        yield verdict.median(f"cosim.clocks_per_s.{simulator}", rates[simulator], "1/s")
    note = "the transient alone, without start and waveform file"
    yield verdict.median("peer.xspice.clocks_per_s", rates["xspice"], "1/s", note)
    pairs = [ours / theirs for ours, theirs in zip(rates[ICARUS], rates["xspice"], strict=True)]
    yield verdict.median("cosim.speed_ratio.xspice", pairs, "1", "Icarus over XSPICE in pairs, step 1 us")


def guest_rows(peer: str, m: Measurements) -> Iterator[Row]:
    """Measure a simulator that may be installed: error at three steps, clocks a second at 1 us."""
    if reason := peers.missing(peer):
        yield verdict.skip(f"peer.{peer}", reason)
        return
    yield from _peer_rows(peer, peers.GUESTS[peer], m)
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
    one, two = (random_plan(m.work, frames, "cosim") for frames in (1, 2))
    kinds: dict[str, tuple[str, Plan, dict[str, Any]]] = {
        "": ("Icarus, one core", one, {}),
        ".verilator": ("Verilator, one core", one, {"simulator": VERILATOR}),
        ".two_cores": ("one of two parallel frames, Icarus", two, {}),
        ".exact_half": ("Icarus, the exact converter instead of ngspice", one, {"analog": "exact"}),
    }
    for simulator in (ICARUS, VERILATOR):  # builds, so that none is timed
        cosim.run(one, simulator=simulator, analog="exact", work=m.place())
    repeat, worst = 1 if m.quick else min(3, m.repeat), 0
    times: dict[str, list[float]] = {kind: [] for kind in kinds}
    for _ in range(repeat):
        for kind, (_, made, options) in kinds.items():
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


@dataclass(frozen=True)
class Section:
    """Measurements made together: the rows, or heads of rows, that they make, and their time limit."""

    names: tuple[str, ...]
    make: Callable[[Measurements], Iterator[Row]]
    limit_s: float


def _of_engines(make: Callable[..., Iterator[Row]], limit_s: float, *names: str) -> Section:
    return Section(names, lambda m: make(m.work, m.repeat, m.quick), limit_s)


SECTIONS = (
    Section(("machine",), machine_rows, 60),
    Section(("cosim.edge_error_v", "cosim.count_error"), accuracy_rows, 300),
    Section(("peer.xspice.edge_error_v", "peer.xspice.count_error"), xspice_rows, 180),
    Section(("cosim.clocks_per_s", "peer.xspice.clocks_per_s", "cosim.speed_ratio.xspice"), speed_rows, 300),
    *(Section((f"peer.{peer}",), functools.partial(guest_rows, peer), 300) for peer in peers.GUESTS),
    Section(("cosim.frame_s", "cosim.frame_code_error_lsb"), frame_rows, 600),
    _of_engines(engine_rows.closed_rows, 180, "closed.frames_per_s"),
    _of_engines(engine_rows.badcrossbar_rows, 180, *engine_rows.BADCROSSBAR_ROWS),
    _of_engines(engine_rows.event_rows, 300, "event.frames_per_s", "event.cost_per_taxel_ratio"),
    _of_engines(engine_rows.off_rows, 120, "effects_off.time_ratio"),
    _of_engines(engine_rows.exponent_rows, 300, "array.exponent"),
    _of_engines(engine_rows.rtl_rows, 300, "rtl.frames_per_s"),
    Section(("setup.second_call_s",), setup_rows, 1800),
)


def run_section(section: Section, m: Measurements) -> list[Row]:
    """Return the rows of a section, and an ERROR row for each name of which a failure left no row."""
    rows: list[Row] = []
    reason = "not measured"
    try:
        with time_limit(section.limit_s):
            for row in section.make(m):
                rows.append(row)
    except Exception as error:  # the other sections still run
        reason = f"{type(error).__name__}: {error}"
    else:
        return rows
    missing = [name for name in section.names if not any(row["name"].startswith(name) for row in rows)]
    return rows + [verdict.error(name, reason) for name in missing or section.names[-1:]]


def chosen(only: Sequence[str]) -> list[Section]:
    """Return the sections that make the rows of some names, or all sections.

    Raises
    ------
    InputError
        A name is none.
    """

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
    "--only",
    multiple=True,
    metavar="NAME",
    help="Only what makes the rows NAME and NAME.* (repeatable).",
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
    verdict.write_rows("bench", rows)
    verdict.print_rows(rows, "Benchmark")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if broken:
        click.echo(f"decks and logs of failed measurements are in {work}")
    else:
        shutil.rmtree(work, ignore_errors=True)
    return verdict.exit_code(rows)
