# SPDX-License-Identifier: Apache-2.0
"""Run hard cases: each with each engine in a worker process with a time limit."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

import click

from dermis.errors import InputError
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts import workers
from tb.programs.hard import converter, networks
from tb.programs.hard.case import Case, Measured

MODULES = {"array": networks, "converter": converter}
"""Group -> module with `cases()`; the quickest first, so that a table is there within seconds."""

SLOW = ("cosim", "verilator")
"""Runs left out of the short set: they take seconds, and the tests of these engines cover them."""


def chosen(words: Sequence[str], short: bool) -> list[Case]:
    """Return cases whose group or name has one of the words, short ones without slow runs; InputError for none."""
    found = []
    for case in (case for module in MODULES.values() for case in module.cases()):
        if words and not any(word in case.name or word == case.group for word in words):
            continue
        if short:
            quick = {name: run for name, run in case.runs.items() if name not in SLOW and case.short}
            case = dataclasses.replace(case, runs=quick)
        if case.runs:
            found.append(case)
    if not found:
        what = " ".join(words) or "(nothing)"
        raise InputError("command line", "--only", what, "part of a name that --list shows, or a group")
    return found


def run(cases: Sequence[Case], jobs: int, group: str) -> list[Row]:
    """Return a row for each run of a group's cases, then one for each reason of skipped cases."""
    own = [case for case in cases if case.group == group]
    pairs = [(case, name) for case in own for name in case.runs]
    rows: list[Row] = [{}] * len(pairs)
    with progress.slots(f"hard {group}", len(pairs), "runs") as tell:
        # A generator: the limit depends on the load when a run begins.
        tasks = (workers.Task(case.runs[name], (), case.limit_s * workers.busy()) for case, name in pairs)
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs), 1):
            row = rows[number] = row_of(*pairs[number], outcome)
            if row["status"] != "PASS":  # at once, as the rest may take minutes
                click.echo(f"{row['status']} {row['name']}: {row['value']}: {row['note']}", err=True)
            tell(done, row["name"])
    skipped = Counter(reason for case in own for reason in case.refused.items())
    for (engine, why), count in skipped.items():
        rows.append(verdict.skip(f"{group}.{engine}", f"{count} case{'s' * (count > 1)}: {why}"))
    return rows


def row_of(case: Case, engine: str, outcome: workers.Outcome) -> Row:
    """Judge the outcome of a run; `seconds` in the row is its wall time."""
    name, found = f"{case.group}.{case.name}.{engine}", outcome.value
    if outcome.fault:
        row = verdict.error(name, outcome.fault, case.unit)
    elif not isinstance(found, Measured):
        row = verdict.error(name, f"returned a {type(found).__name__}, not a measurement", case.unit)
    else:
        error = None if found.error is None else abs(found.error)
        row = verdict.within(name, error, case.unit, None, case.limit, found.note)
    return row | {"max": case.limit, "seconds": round(outcome.seconds, 4)}


@click.command("hard")
@click.option(
    "--only", multiple=True, metavar="WORD", help="Cases with WORD in their name, or a group (repeatable)."
)
@click.option("--short", is_flag=True, help="Run the short set of the tests.")
@click.option("--jobs", type=click.IntRange(1, 256), default=2, show_default=True, help="Parallel runs.")
@click.option("--list", "listed", is_flag=True, help="List the cases and run nothing.")
def hard_command(only: tuple[str, ...], short: bool, jobs: int, listed: bool) -> int:
    """Run hard cases in every engine that takes them, against exact answers; rows in build/hard.json."""
    cases = chosen(only, short)
    if listed:
        for case in cases:
            click.echo(f"{case.group:10} {case.name:45} {' '.join(case.runs)}")
        return 0
    rows: list[Row] = []
    for group in dict.fromkeys(case.group for case in cases):
        found = run(cases, jobs, group)
        verdict.print_rows(found, f"Hard cases: {group}")
        rows += found
    verdict.write_rows("hard", rows)
    return verdict.exit_code(rows)
