# SPDX-License-Identifier: Apache-2.0
"""Run hard cases: each case with each engine in a worker process with a time limit, judged by the
limit of the case.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence

import click

from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.places import ROOT
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts import workers
from tb.programs import hard
from tb.programs.hard import Case, Measured

DOCS = "build/hard_cases.md"

PREPARE_LIMIT_S = 900.0
"""Time limit for loops that Numba compiles and Verilog that Verilator builds: 60 s on an idle
core.
"""

NGSPICE = ("circuit", "stiff")
"""Groups with a new process for each run, as ngspice keeps failed circuits.
"""

SLOW = ("cosim", "verilator")
"""Runs left out of the short set: processes and builds take seconds, and the tests of these engines
cover them.
"""


def chosen(words: Sequence[str], short: bool) -> list[Case]:
    """Return cases whose group or name has one of the words; with `short` the short set without its
    slow runs.

    Raises
    ------
    InputError
        There is none.
    """
    found = [
        case
        for case in hard.all_cases()
        if (case.short or not short)
        and (not words or any(word in case.name or word == case.group for word in words))
    ]
    if short:
        quick = [{name: run for name, run in case.runs.items() if name not in SLOW} for case in found]
        found = [dataclasses.replace(case, runs=runs) for case, runs in zip(found, quick, strict=True)]
    if not found:
        what = " ".join(words) or "(nothing)"
        raise InputError("command line", "--only", what, "part of a name that --list shows, or a group")
    return found


def run(cases: Sequence[Case], jobs: int) -> list[Row]:
    """Run cases and return a row for each run, in the order of the cases; `seconds` in a row is its
    wall time.
    """
    pairs = [(case, name) for case in cases for name in case.runs]
    rows: dict[tuple[str, str], Row] = {}
    with progress.slots("hard", len(pairs), "runs") as tell:
        for fresh in (False, True):
            own = [pair for pair in pairs if (pair[0].group in NGSPICE) == fresh]
            # A generator: the limit depends on the load when a run begins.
            tasks = (workers.Task(case.runs[name], (), case.limit_s * _busy()) for case, name in own)
            for number, outcome in workers.run(tasks, jobs, fresh=fresh):
                case, name = own[number]
                row = rows[case.name, name] = row_of(case, name, outcome)
                if row["status"] != "PASS":  # at once, as the rest may take minutes
                    click.echo(_wrong(row), err=True)
                tell(len(rows), f"after {case.name} in {name}")
    found = []
    for case in cases:
        found += [rows[case.name, name] for name in case.runs]
        found += [verdict.skip(_name(case, engine), why, case.unit) for engine, why in case.refused.items()]
    return found


def _busy() -> float:
    """Return the number of processes per core, at least 1: a run takes this factor longer."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def _name(case: Case, engine: str) -> str:
    return f"{case.group}.{case.name}.{engine}"


def row_of(case: Case, engine: str, outcome: workers.Outcome) -> Row:
    """Judge the outcome of a run."""
    name, found, seconds = _name(case, engine), outcome.value, outcome.seconds
    if outcome.fault:
        row = verdict.error(name, outcome.fault, case.unit)
    elif not isinstance(found, Measured):
        row = verdict.error(name, f"returned a {type(found).__name__}, not a measurement", case.unit)
    else:
        error = None if found.error is None else abs(found.error)
        row = verdict.within(name, error, case.unit, None, case.limit, found.note)
        seconds = seconds if found.seconds is None else found.seconds
    return row | {"max": case.limit, "seconds": round(seconds, 4)}


def prepare(cases: Sequence[Case]) -> Iterator[Row]:
    """Compile code of the cases before the timed runs; yield an ERROR row for each module that
    failed.
    """
    names = {case.name for case in cases}
    for module in hard.modules():
        own = tuple(case for case in module.cases() if case.name in names)
        if not own or not hasattr(module, "prepare"):
            continue
        for _, outcome in workers.run([workers.Task(module.prepare, (own,), PREPARE_LIMIT_S)], 1):
            if outcome.fault:
                yield verdict.error(f"{own[0].group}.prepare", outcome.fault)


def _print(cases: Sequence[Case], rows: Sequence[Row]) -> None:
    """Print a line for each case, then missed and unmeasured runs, and the counts."""
    for case in cases:
        runs = [_said(row) for row in _of(case, rows) if row["status"] != "SKIP"]
        click.echo(f"{case.group} {case.name}: {'; '.join(runs)}")
    for row in rows:
        if row["status"] not in ("PASS", "SKIP"):
            click.echo(_wrong(row))
    click.echo(summary(cases, rows))


def _wrong(row: Row) -> str:
    return f"{row['status']} {row['name']}: {row['value']} {row['unit']}: {row['note']}"


def summary(cases: Sequence[Case], rows: Sequence[Row]) -> str:
    """Return the number of runs by status, and their time."""
    counts = ", ".join(f"{sum(r['status'] == s for r in rows)} {s}" for s in verdict.COLOURS)
    timed = [row for row in rows if "seconds" in row]
    if not timed:
        return f"{len(cases)} cases, no runs: {counts}"
    longest = max(timed, key=lambda row: row["seconds"])
    return (
        f"{len(cases)} cases, {len(timed)} runs: {counts}; {sum(row['seconds'] for row in timed):.0f} s in all, "
        f"the longest {longest['seconds']:.2g} s ({longest['name']})."
    )


def _of(case: Case, rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["name"].startswith(f"{case.group}.{case.name}.")]


def _said(row: Row) -> str:
    engine = row["name"].rsplit(".", 1)[1]
    if row["status"] == "SKIP":
        return f"{engine}: not expressible, {row['note']}"
    value = "ERROR" if row["value"] is None else f"{row['value']:.2g}"
    miss = " FAIL" if row["status"] == "FAIL" else ""
    return f"{engine} {value}{miss} ({row['seconds']:.2g} s)"


def table(cases: Sequence[Case], rows: Sequence[Row]) -> str:
    """Return the cases as Markdown, a line each with error and seconds of its runs."""
    lines = [
        summary(cases, rows),
        "",
        "| group | case | why it is hard | expected, and source | tolerance | error (seconds) |",
        "|---|---|---|---|---|---|",
    ]
    for case in cases:
        cells = [
            case.group,
            f"`{case.name}`",
            case.why,
            f"{case.expected}; {case.source}",
            f"{case.limit:g} {case.unit}: {case.tolerance}",
            "; ".join(_said(row) for row in _of(case, rows)),
        ]
        cells = [" ".join(cell.split()).replace("|", "\\|") for cell in cells]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


@click.command("hard")
@click.option(
    "--only", multiple=True, metavar="WORD", help="Cases with WORD in their name, or a group (repeatable)."
)
@click.option("--short", is_flag=True, help="Run the short set of the tests.")
@click.option("--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Parallel runs.")
@click.option("--docs", is_flag=True, help=f"Require a whole run, which writes {DOCS}.")
@click.option("--list", "listed", is_flag=True, help="List the cases and run nothing.")
def hard_command(only: tuple[str, ...], short: bool, jobs: int, docs: bool, listed: bool) -> int:
    """Run hard cases in every engine that can express them, against exact answers; rows in
    build/hard.json.
    """
    if docs and (only or short):
        raise InputError("command line", "--docs", "with --only or --short", "a whole run")
    cases = chosen(only, short)
    if listed:
        for case in cases:
            click.echo(f"{case.group:10} {case.name:45} {' '.join(case.runs)}")
        return 0
    rows = [*prepare(cases), *run(cases, jobs)]
    verdict.write_rows("hard", rows)
    _print(cases, rows)
    if not (only or short):
        write_atomic(ROOT / DOCS, table(cases, rows))
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(rows)
