# SPDX-License-Identifier: Apache-2.0
"""The benchmark: how exact and how fast each engine is, and other people's co-simulation on the same circuit.

Correctness rows gate, speed rows inform. What each row means stands in docs/benchmarks.md. A measurement that fails is
an ERROR row; the others are still made.
"""

from __future__ import annotations

import functools
import importlib.metadata
import itertools
import math
import os
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import engines, records
from dermis.engines import cosim
from dermis.engines.batch import fingerprint
from dermis.errors import DermisError, InputError, SimulatorError
from dermis.files import write_between
from dermis.report import verdict
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from tb.programs.accuracy import converter
from tb.programs.bench import bench_engines, bench_history, bench_peers, bench_vfc
from tb.programs.bench.bench_vfc import Circuit, Job, Run

DOCS = "docs/benchmarks.md"
BEGIN, END = "<!-- begin: bench (written by dermis bench --docs) -->", "<!-- end: bench -->"

STEPS = {"step_10n": 10e-9, "step_100n": 100e-9, "step_1u": 1e-6}
RUN_LIMIT_S = 60.0
"""For one process; all take under 5 s on an idle machine."""

# A step of 10 ns costs others a hundred points a clock and more: fewer clocks there.
_PEER_CLOCKS = {"step_10n": 300, "step_100n": 1000, "step_1u": 1000}


class Measurements:
    """What the sections share: settings, scratch space, and results that more than one of them needs."""

    def __init__(self, work: Path, repeat: int, quick: bool) -> None:
        self.work = work
        self.repeat = repeat
        self.quick = quick
        self.circuit = Circuit()
        self.held = replace(self.circuit, preset=True)  # every frame starts alike: for many frames in one run
        self.speed_frames = 3 if quick else 5
        self._runs = 0

    def place(self) -> Path:
        """A directory that is not there yet."""
        self._runs += 1
        return self.work / f"run_{self._runs:03d}"

    def measure(self, job: Job, replay: Run | None = None) -> Run:
        """Run a job of bench_vfc."""
        return bench_vfc.measure(job, self.place(), RUN_LIMIT_S, replay)

    @functools.cached_property
    def exact_runs(self) -> dict[str, tuple[Run, float, int]]:
        """By step: a run of the real Verilog in Icarus, its largest error in volt, |pulses - exact|."""
        found = {}
        for name, step in STEPS.items():
            run = self.measure(Job(self.circuit, 1, step, keep=True))
            found[name] = run, self.error_v(run, self.circuit), _miscount(self.circuit, run)
        return found

    @functools.cached_property
    def xspice_runs(self) -> dict[str, bench_peers.PeerRun]:
        """By step: the same in plain ngspice with XSPICE."""
        return {
            name: bench_peers.xspice(self.circuit, step, _PEER_CLOCKS[name], self.place(), RUN_LIMIT_S)
            for name, step in STEPS.items()
        }

    @functools.cached_property
    def recorded(self) -> Run:
        """A run with preset whose bits can be replayed."""
        return self.measure(Job(self.held, 1, keep=True))

    def error_v(self, run: Run, circuit: Circuit) -> float:
        """Largest error of the first frame of a run that kept what crossed the bridge."""
        assert run.voltage is not None
        assert run.charge is not None
        return bench_vfc.edge_error_v(circuit, run.voltage[0], run.charge[0])


def _miscount(circuit: Circuit, run: Run) -> int:
    return int(np.max(np.abs(run.codes - circuit.pulses)))


def _rate(run: Run, circuit: Circuit) -> float:
    return float(np.median(run.rates(circuit)))


# ---- sections ---------------------------------------------------------------------------------------------------


def _machine(m: Measurements) -> Iterator[Row]:
    yield verdict.report("machine.cores", os.cpu_count(), "cores", machine_line())
    yield busy_row("machine.busy_cores")


def busy_row(name: str) -> Row:
    """How many cores work for others, in the second that this takes."""
    busy = _busy_cores(1.0)
    note = "other work is running: speeds are too low" if busy > 0.2 else "nothing else is running"
    return verdict.report(name, round(busy, 2), "cores", f"in the second before; {note}")


def _busy_cores(seconds: float) -> float:
    """How many cores work while this process sleeps."""

    def ticks() -> tuple[int, int]:
        numbers = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
        return sum(numbers), numbers[3] + numbers[4]  # idle, and waiting for a disk

    total, idle = ticks()
    time.sleep(seconds)
    total_after, idle_after = ticks()
    return (os.cpu_count() or 1) * (1.0 - (idle_after - idle) / max(1, total_after - total))


def _accuracy(m: Measurements) -> Iterator[Row]:
    for name, (run, error, count) in m.exact_runs.items():
        note = f"{m.circuit.clocks} clocks at {_rate(run, m.circuit):.0f}/s with every sample kept, Icarus"
        yield verdict.judge(f"cosim.edge_error_v.{name}", error, note)
        yield verdict.judge(
            f"cosim.count_error.{name}", count, f"{run.codes[0]} of {m.circuit.pulses} pulses"
        )
    held = {"preset": m.recorded, "verilator": m.measure(Job(m.held, 1, simulator="verilator", keep=True))}
    notes = {
        "preset": "step 1 us, started by the preset switch as on the chip",
        "verilator": "as preset, Verilator",
    }
    for name, run in held.items():
        yield verdict.judge(f"cosim.edge_error_v.{name}", m.error_v(run, m.held), notes[name])
        yield verdict.judge(f"cosim.count_error.{name}", _miscount(m.held, run), f"{run.codes[0]} pulses")


def _order(m: Measurements) -> Iterator[Row]:
    where = m.place()
    where.mkdir(parents=True)
    _, orders = converter.orders(where)
    note = f"largest steps of {', '.join(converter.step_words(h) for h in converter.ORDER_STEPS_S)}, amplifier pole"
    yield verdict.judge("accuracy.order", min(orders), note)


def _peer_accuracy(m: Measurements) -> Iterator[Row]:
    for name, run in m.xspice_runs.items():
        note = f"{run.clocks} clocks at {run.rate:.0f}/s"
        yield verdict.report(f"peer.xspice.edge_error_v.{name}", run.error_v, "V", note)
        yield verdict.report(f"peer.xspice.count_error.{name}", run.count_error, "pulses")
        ours = m.exact_runs[name][1]
        ratio = ours / run.error_v if run.error_v else math.nan
        note = "error of cosim over error of XSPICE at the same step"
        yield verdict.report(f"cosim.error_ratio.xspice.{name}", ratio, "1", note)


def _speed(m: Measurements) -> Iterator[Row]:
    step = STEPS["step_1u"]
    rates: dict[str, list[float]] = {"icarus": [], "verilator": [], "xspice": []}
    cpu: dict[str, list[float]] = {"icarus": [], "verilator": []}
    for _ in range(m.repeat):
        # Taken in turns, so that whatever else the machine does meets all of them.
        for simulator in ("icarus", "verilator"):
            run = m.measure(Job(m.held, m.speed_frames, step, simulator))
            if _miscount(m.held, run):
                raise SimulatorError(f"{simulator} counted {run.codes}, not {m.held.pulses}")
            rates[simulator].append(_rate(run, m.held))
            cpu[simulator].append(float(np.median(m.held.clocks / run.cpu_seconds)))
        peer = bench_peers.xspice(m.circuit, step, m.circuit.clocks, m.place(), RUN_LIMIT_S)
        rates["xspice"].append(peer.rate)
    for simulator in ("icarus", "verilator"):
        note = f"{statistics.median(cpu[simulator]):.0f} a second of processor time"
        yield verdict.median(f"cosim.clocks_per_s.{simulator}", rates[simulator], "1/s", note)
    yield verdict.median(
        "peer.xspice.clocks_per_s",
        rates["xspice"],
        "1/s",
        "the transient alone, without start and waveform file",
    )
    pairs = [ours / theirs for ours, theirs in zip(rates["icarus"], rates["xspice"], strict=True)]
    yield verdict.median("cosim.speed_ratio.xspice", pairs, "1", "Icarus over XSPICE in pairs, step 1 us")


def _shares(m: Measurements) -> Iterator[Row]:
    recorded = m.recorded
    names = ("icarus", "verilator")
    hdl: dict[str, list[float]] = {name: [] for name in names}
    whole: dict[str, list[float]] = {name: [] for name in names}
    alone: list[float] = []

    def us(run: Run) -> float:
        return 1e6 * float(np.median(run.cpu_seconds)) / m.held.clocks

    for _ in range(1 if m.quick else m.repeat):
        alone.append(us(m.measure(Job(m.held, m.speed_frames, simulator=None), recorded)))
        for name in names:
            hdl[name].append(
                us(m.measure(Job(m.held, m.speed_frames, simulator=name, replay=True), recorded))
            )
            whole[name].append(us(m.measure(Job(m.held, m.speed_frames, simulator=name))))
    yield verdict.median(
        "cosim.clock_us.ngspice", alone, "us", "processor time a clock: ngspice and the call into it, no HDL"
    )
    for name in names:
        note = "processor time a clock: HDL simulator, cocotb and bridge, the analog half replayed at no cost"
        yield verdict.median(f"cosim.clock_us.{name}", hdl[name], "us", note)
        shares = [1.0 - part / total for part, total in zip(hdl[name], whole[name], strict=True)]
        yield verdict.median(
            f"cosim.ngspice_share.{name}", shares, "1", "what the clock costs less without ngspice"
        )


def _guest(peer: str, m: Measurements) -> Iterator[Row]:
    if reason := bench_peers.missing(peer):
        for name in _guest_names(peer):
            yield verdict.skip(name, reason)
        return
    version = f"{peer} {importlib.metadata.version(peer.replace('_', '-'))}"
    steps = {k: v for k, v in STEPS.items() if not (m.quick and k == "step_10n")}
    runs = {}
    for name, step in steps.items():
        runs[name] = run = bench_peers.GUESTS[peer](
            m.circuit, step, _PEER_CLOCKS[name], m.place(), RUN_LIMIT_S
        )
        rate = bench_peers.rate(peer, m.circuit, step, m.place, RUN_LIMIT_S)
        note = f"{run.clocks} clocks at {rate:.0f}/s, {version}"
        yield verdict.report(f"peer.{peer}.edge_error_v.{name}", run.error_v, "V", note)
        yield verdict.report(f"peer.{peer}.count_error.{name}", run.count_error, "pulses")
    for name in STEPS.keys() - steps.keys():
        yield verdict.skip(f"peer.{peer}.edge_error_v.{name}", "left out by --quick", "V")
        yield verdict.skip(f"peer.{peer}.count_error.{name}", "left out by --quick", "pulses")
    rates = [
        bench_peers.rate(peer, m.circuit, STEPS["step_1u"], m.place, RUN_LIMIT_S) for _ in range(m.repeat)
    ]
    yield verdict.median(f"peer.{peer}.clocks_per_s", rates, "1/s", "step 1 us, Icarus")


def _guest_names(peer: str) -> tuple[str, ...]:
    kinds = [f"{kind}.{step}" for kind in ("edge_error_v", "count_error") for step in STEPS]
    return tuple(f"peer.{peer}.{rest}" for rest in (*kinds, "clocks_per_s"))


def _frame(m: Measurements) -> Iterator[Row]:
    one, two = (bench_engines.random_plan(m.work, frames, "cosim") for frames in (1, 2))
    expected = {
        1: engines.run(replace(one, engine="closed")).codes,
        2: engines.run(replace(two, engine="closed")).codes,
    }
    worst = 0

    def seconds(which: records.Plan, **options: Any) -> float:
        nonlocal worst
        begin = time.perf_counter()
        result = cosim.run(which, work=m.place(), **options)
        taken = time.perf_counter() - begin
        difference = np.abs(result.codes.astype(int) - expected[which.frames].astype(int))
        worst = max(worst, int(difference.max()))
        return taken / which.frames

    cosim.run(one, simulator="verilator", analog="exact", work=m.place())  # builds, so that none is timed
    cosim.run(one, analog="exact", work=m.place())
    repeat = 1 if m.quick else min(3, m.repeat)
    icarus, verilator, both, exact = ([] for _ in range(4))
    for _ in range(repeat):
        icarus.append(seconds(one))
        verilator.append(seconds(one, simulator="verilator"))
        both.append(seconds(two))
        exact.append(seconds(one, analog="exact"))
    rows, cols = one.rows, one.cols
    note = f"{rows}x{cols} resistances over the range, start of the processes included"
    yield verdict.median("cosim.frame_s", icarus, "s", f"Icarus, one core; {note}")
    yield verdict.median("cosim.frame_s.verilator", verilator, "s", "the same, Verilator")
    yield verdict.median("cosim.frame_s.two_cores", both, "s", "a frame, of two at once in Icarus")
    yield verdict.median(
        "cosim.frame_s.exact_half", exact, "s", "Icarus, the exact converter instead of ngspice"
    )
    yield verdict.judge(
        "cosim.frame_code_error_lsb", worst, f"{repeat * 4} runs against engine closed, all taxels"
    )


def _engines(make: Callable[[Path, int, bool], Iterator[Row]], m: Measurements) -> Iterator[Row]:
    where = m.place()
    where.mkdir(parents=True)
    return make(where, m.repeat, m.quick)


def _setup(m: Measurements) -> Iterator[Row]:
    taken = []
    for _ in range(1 + (1 if m.quick else 3)):
        where = m.place()
        where.mkdir(parents=True)
        begin = time.perf_counter()
        # Never cut short: an interrupted set-up costs the next one a new .venv.
        status = bench_vfc.call(["make", "-C", ROOT, "setup"], where, 900, MAKEFLAGS="")
        taken.append(time.perf_counter() - begin)
        if status:
            raise SimulatorError(f"make setup ended with {status}", where)
    yield verdict.median("setup.second_call_s", taken[1:], "s")


@dataclass(frozen=True)
class Section:
    """Measurements made together: the rows they promise, and how long they may take."""

    names: tuple[str, ...]
    make: Callable[[Measurements], Iterator[Row]]
    limit_s: float


def _steps(*heads: str) -> tuple[str, ...]:
    return tuple(f"{head}.{step}" for head in heads for step in STEPS)


SECTIONS = (
    Section(("machine.cores", "machine.busy_cores"), _machine, 60),
    Section(
        (
            *_steps("cosim.edge_error_v", "cosim.count_error"),
            *(
                f"cosim.{kind}.{how}"
                for kind in ("edge_error_v", "count_error")
                for how in ("preset", "verilator")
            ),
        ),
        _accuracy,
        300,
    ),
    Section(("accuracy.order",), _order, 300),
    Section(
        _steps("peer.xspice.edge_error_v", "peer.xspice.count_error", "cosim.error_ratio.xspice"),
        _peer_accuracy,
        180,
    ),
    Section(
        (
            "cosim.clocks_per_s.icarus",
            "cosim.clocks_per_s.verilator",
            "peer.xspice.clocks_per_s",
            "cosim.speed_ratio.xspice",
        ),
        _speed,
        300,
    ),
    Section(
        (
            "cosim.clock_us.ngspice",
            *(
                f"cosim.{kind}.{name}"
                for name in ("icarus", "verilator")
                for kind in ("clock_us", "ngspice_share")
            ),
        ),
        _shares,
        300,
    ),
    *(Section(_guest_names(peer), functools.partial(_guest, peer), 300) for peer in bench_peers.GUESTS),
    Section(
        (
            "cosim.frame_s",
            "cosim.frame_s.verilator",
            "cosim.frame_s.two_cores",
            "cosim.frame_s.exact_half",
            "cosim.frame_code_error_lsb",
        ),
        _frame,
        600,
    ),
    *(
        Section(names, functools.partial(_engines, make), limit_s)
        for names, make, limit_s in bench_engines.SECTIONS
    ),
    Section(("setup.second_call_s",), _setup, 1800),
)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the main thread when the block takes longer."""

    def ring(signum: int, frame: Any) -> None:
        raise TimeoutError(f"took more than {seconds:g} s")

    handler = signal.signal(signal.SIGALRM, ring)
    timer = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer)  # pytest keeps its own limit there
        signal.signal(signal.SIGALRM, handler)


def run_section(section: Section, m: Measurements) -> list[Row]:
    """The rows of a section; those that a failure kept from being measured are ERROR rows with its reason."""
    rows: list[Row] = []
    reason = "not measured"
    try:
        with time_limit(section.limit_s):
            for row in section.make(m):
                rows.append(row)
    except (DermisError, TimeoutError, subprocess.SubprocessError) as error:
        reason = str(error)
    # Whatever a section does wrong is an ERROR row; the others still run.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
    made = {row["name"] for row in rows}
    return rows + [verdict.error(name, reason) for name in section.names if name not in made]


def chosen(only: Sequence[str]) -> list[Section]:
    """Sections that promise a row of one of the names, or of a name below it; all without names."""
    if not only:
        return list(SECTIONS)

    def fits(name: str, wanted: str) -> bool:
        return name == wanted or name.startswith(wanted + ".")

    known = [name for section in SECTIONS for name in section.names]
    for wanted in only:
        if not any(fits(name, wanted) for name in known):
            heads = sorted({".".join(name.split(".")[:2]) for name in known})
            raise InputError(
                "command line", "--only", wanted, "a row, or the beginning of one: " + ", ".join(heads)
            )
    return [s for s in SECTIONS if any(fits(name, wanted) for name in s.names for wanted in only)]


# ---- docs -------------------------------------------------------------------------------------------------------


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def docs_table(rows: Sequence[Row]) -> str:
    """The rows as Markdown, under a sentence that names the machine."""
    machine = next((row["note"] for row in rows if row["name"] == "machine.cores"), "machine unknown")
    lines = [
        f"Machine: {machine}.",
        "",
        "| name | value | unit | limit | status | note |",
        "|---|--:|---|---|---|---|",
    ]
    for (status, note), group in itertools.groupby(rows, key=lambda row: (row["status"], row["note"])):
        same = [row for row in group if row["name"] != "machine.cores"]
        heads = {".".join(row["name"].split(".")[:2]) for row in same}
        if status == "SKIP" and len(same) > 1 and len(heads) == 1:
            lines.append(f"| `{heads.pop()}.*` | | | | SKIP | {_cell(note)} |")
            continue
        for row in same:
            value = "" if row["value"] is None else f"{row['value']:.4g}"
            bounds = (("≥", row["min"]), ("≤", row["max"]))
            limit = ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)
            lines.append(
                f"| `{row['name']}` | {value} | {row['unit']} | {limit} | {status} | {_cell(note)} |"
            )
    return "\n".join(lines)


def write_docs(rows: Sequence[Row], root: Path = ROOT) -> None:
    """Put the table between its marks in docs/benchmarks.md.

    Raises
    ------
    InputError
        The marks are not there.
    """
    write_between(root / DOCS, BEGIN, END, docs_table(rows))


@click.command("bench")
@click.option("--quick", is_flag=True, help="Fewer repetitions; for a look, not for docs.")
@click.option("--repeat", type=click.IntRange(min=1), help="Runs behind a median; default 5, with --quick 2.")
@click.option(
    "--only", multiple=True, metavar="NAME", help="Rows of this name or below it only (may be repeated)."
)
@click.option("--docs", is_flag=True, help=f"Also write the table in {DOCS}.")
@click.option("--bless", is_flag=True, help="Also make this run the one that later ones are compared with.")
@click.option("--history", is_flag=True, help="Only show the runs that were kept, beside each other.")
def bench_command(
    quick: bool, repeat: int | None, only: tuple[str, ...], docs: bool, bless: bool, history: bool
) -> int:
    """Measure accuracy and speed, into build/bench.json; with --only, what was measured now is all that is in it.

    Every run is kept in build/bench_history and compared with the blessed one, models/bench_blessed.json.
    """
    for flag, given in (("--docs", docs), ("--bless", bless)):
        if given and (quick or only):
            raise InputError("command line", flag, "with --quick or --only", "a whole run")
    if history:
        bench_history.print_history(bench_history.history())
        return 0
    before = bench_history.blessed()  # one that cannot be read is said before anything is measured
    sections = chosen(only)
    base = ROOT / "build" / "bench"
    base.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=base))  # its own: two may run at once
    m = Measurements(work, repeat or (2 if quick else 5), quick)
    rows: list[Row] = []
    for section in sections:
        begin = time.perf_counter()
        click.echo(f"bench: {section.names[0]} and {len(section.names) - 1} more ...", err=True)
        rows += run_section(section, m)
        click.echo(f"bench:   {time.perf_counter() - begin:.0f} s", err=True)
    machine = machine_line()
    run = bench_history.record(
        rows, machine, fingerprint()[:12], {"quick": quick, "repeat": m.repeat, "only": list(only)}
    )
    kept = bench_history.keep(run)
    said = list(bench_history.report(rows, machine, before, whole=not only and not quick))
    rows += bench_history.summary(rows, before)
    verdict.write_rows("bench", rows)
    verdict.print_rows(rows, "Benchmark")
    click.echo("\n".join([*said, f"kept: {kept.relative_to(ROOT)}"]))
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if broken:
        click.echo(f"decks and logs of what broke are in {work}")
    else:
        shutil.rmtree(work, ignore_errors=True)
    if docs and broken:
        click.echo(f"not written: {DOCS}, for {broken[0]} was not measured")
    elif docs:
        write_docs(rows)
        click.echo(f"written: {DOCS}")
    if bless:
        bench_history.bless(run, rows)
        click.echo(f"written: {bench_history.BLESSED.relative_to(ROOT)}")
    return verdict.exit_code(rows)
