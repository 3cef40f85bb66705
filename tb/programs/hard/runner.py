# SPDX-License-Identifier: Apache-2.0
"""Runs hard cases: each case with each engine in a worker process with a limit, judged by the case's own tolerance."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence

import click

from dermis.errors import InputError
from dermis.files import write_between
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts import workers
from tb.programs import hard
from tb.programs.hard import Case, Measured

DOCS = "build/hard_cases.md"
BEGIN, END = "<!-- begin: hard (written by dermis hard --docs) -->", "<!-- end: hard -->"

PREPARE_LIMIT_S = 900.0
"""For what a module compiles before its cases run, loops by Numba, Verilog by Verilator: 60 s on an idle core."""


NGSPICE = ("circuit", "stiff")
"""Groups with ngspice in their own process, which keeps circuits that did not come to their end: a process a run."""

SLOW = ("cosim", "verilator")
"""Runs that are left out of the short set: processes and builds of seconds, which the tests of those engines make."""


def chosen(words: Sequence[str], short: bool) -> list[Case]:
    """Cases whose group or name has one of the words in it; with `short` those of the short set, less their slow runs.

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
    """Run cases and return a row a run, in the order of the cases; `seconds` in a row is its wall time."""
    pairs = [(case, name) for case in cases for name in case.runs]
    rows: list[Row | None] = [None] * len(pairs)
    done = 0
    with progress.slots("hard", len(pairs), "runs") as tell:
        for fresh in (False, True):
            own = [i for i, (case, _) in enumerate(pairs) if (case.group in NGSPICE) == fresh]
            # Made one by one as they begin: on a machine that is busy with other things a run takes longer, and may.
            tasks = (
                workers.Task(pairs[i][0].runs[pairs[i][1]], (), pairs[i][0].limit_s * _busy()) for i in own
            )
            for number, outcome in workers.run(tasks, jobs, fresh=fresh):
                row = rows[own[number]] = row_of(*pairs[own[number]], outcome)
                if row["status"] != "PASS":  # now, for what comes may take minutes
                    click.echo(_wrong(row), err=True)
                done += 1
                tell(done)
    by_case: dict[str, list[Row]] = {case.name: [] for case in cases}
    for (case, _), row in zip(pairs, rows, strict=True):
        assert row is not None
        by_case[case.name].append(row)
    for case in cases:
        by_case[case.name] += [
            verdict.skip(_name(case, engine), why, case.unit) for engine, why in case.refused.items()
        ]
    return [row for case in cases for row in by_case[case.name]]


def _busy() -> float:
    """How many processes want each core, at least 1: so much longer does a run take that would have had one alone."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def _name(case: Case, engine: str) -> str:
    return f"{case.group}.{case.name}.{engine}"


def row_of(case: Case, engine: str, outcome: workers.Outcome) -> Row:
    """Judge what became of a run."""
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
    """Let the modules compile what their cases need before any clock runs; an ERROR row for each that could not."""
    chosen_names = {case.name for case in cases}
    for module in hard.modules():
        own = tuple(case for case in module.cases() if case.name in chosen_names)
        if not own or not hasattr(module, "prepare"):
            continue
        for _, outcome in workers.run([workers.Task(module.prepare, (own,), PREPARE_LIMIT_S)], 1):
            if outcome.fault:
                yield verdict.error(f"{own[0].group}.prepare", outcome.fault)


def _print(cases: Sequence[Case], rows: Sequence[Row]) -> None:
    """A line a case with what each run found, then what missed or was not measured, and the counts."""
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
    """How many runs ended how, and how long they took."""
    counts = ", ".join(f"{sum(r['status'] == s for r in rows)} {s}" for s in verdict.COLOURS)
    timed = [row for row in rows if "seconds" in row]
    if not timed:
        return f"{len(cases)} cases, none of them run: {counts}"
    longest = max(timed, key=lambda row: row["seconds"])
    return (
        f"{len(cases)} cases, {len(timed)} runs: {counts}; {sum(row['seconds'] for row in timed):.0f} s in all, "
        f"the longest {longest['seconds']:.2g} s ({longest['name']})."
    )


def _of(case: Case, rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["name"].startswith(f"{case.group}.{case.name}.")]


# ---- docs -------------------------------------------------------------------------------------------------------


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _said(row: Row) -> str:
    engine = row["name"].rsplit(".", 1)[1]
    if row["status"] == "SKIP":
        return f"{engine}: not expressible, {row['note']}"
    value = "ERROR" if row["value"] is None else f"{row['value']:.2g}"
    miss = " FAIL" if row["status"] == "FAIL" else ""
    return f"{engine} {value}{miss} ({row['seconds']:.2g} s)"


def docs_table(cases: Sequence[Case], rows: Sequence[Row]) -> str:
    """A table a group: one line a case, in its last column error and seconds of each run."""
    lines: list[str] = []
    for group in dict.fromkeys(case.group for case in cases):
        lines += ["", f"### {group.capitalize()}", ""]
        lines += [
            "| case | why it is hard | expected, and from where | tolerance | error (seconds) |",
            "|---|---|---|---|---|",
        ]
        for case in (c for c in cases if c.group == group):
            cells = [
                f"`{case.name}`",
                case.why,
                f"{case.expected}; {case.source}",
                f"{case.limit:g} {case.unit}: {case.tolerance}",
                "; ".join(_said(row) for row in _of(case, rows)),
            ]
            lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return "\n".join([summary(cases, rows), *lines])


# ---- command ----------------------------------------------------------------------------------------------------


@click.command("hard")
@click.option(
    "--only", multiple=True, metavar="WORD", help="Cases with this in their name, or of this group."
)
@click.option("--short", is_flag=True, help="The short set that the tests run.")
@click.option("--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Runs at a time.")
@click.option("--docs", is_flag=True, help=f"Also write the table in {DOCS}.")
@click.option("--list", "listed", is_flag=True, help="Say what cases there are, and run nothing.")
def hard_command(only: tuple[str, ...], short: bool, jobs: int, docs: bool, listed: bool) -> int:
    """Hard cases through every engine that can express them, against exact answers; rows in build/hard.json."""
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
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if docs and broken:
        click.echo(f"not written: {DOCS}, for {broken[0]} was not measured")
    elif docs:
        write_between(ROOT / DOCS, BEGIN, END, docs_table(cases, rows))
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(rows)
