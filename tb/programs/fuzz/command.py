# SPDX-License-Identifier: Apache-2.0
"""`dermis fuzz`: hostile input to every reader in worker processes; findings are shrunk and
stored.
"""

from __future__ import annotations

import shutil
from collections import Counter

import click

from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts import workers
from tb.programs.fuzz import runner
from tb.programs.fuzz.faults import FAULTS
from tb.programs.fuzz.runner import NAMES, WORK
from tb.programs.tables import markdown

INPUTS = dict(zip(NAMES, (10_000, 12_000, 40_000, 30_000, 8_000, 1_000), strict=True))
"""Inputs of a whole run, few where one takes long."""

ROUND = 2_000
"""Inputs of one process, which remembers all of them."""

ROUND_S, SEEDED_S, SEEDED_INPUTS = 900.0, 240.0, 3_000


class Tally:
    """Results of the rounds of a target, and the seeded faults that no input met."""

    def __init__(self) -> None:
        self.counts: dict[str, Counter[str]] = {}
        self.found: dict[str, dict[str, str]] = {}
        self.missed: dict[str, str] = {}
        self.seeded = 0

    def add(self, task: workers.Task, outcome: workers.Outcome) -> None:
        """Add the outcome of a task of `runner.fuzz`."""
        name, _, seed, fault, _ = task.arguments
        piece = outcome.value or {}
        if fault:
            self.seeded += 1
            if not piece.get("found"):
                self.missed[fault] = outcome.fault or "not seen"
            return
        found = self.found.setdefault(name, {})
        found |= piece.pop("found", {})
        self.counts.setdefault(name, Counter()).update(piece)
        if outcome.fault:
            last, signature = WORK / f"{name}.{seed}.last", f"crash of round {seed}"
            found[signature] = outcome.fault
            if last.exists():
                shutil.copyfile(last, runner.file_of(name, "crash", signature))

    def rows(self) -> list[Row]:
        """Return the rows of build/fuzz.json."""
        rows = []
        for name, counts in self.counts.items():
            note = f"{counts['taken']} taken, {counts['refused']} refused"
            rows.append(verdict.report(f"fuzz.inputs.{name}", counts["inputs"], "inputs", note))
            note = "; ".join(f"{text:.200}" for text in list(self.found[name].values())[:3])
            rows.append(verdict.judge(f"fuzz.findings.{name}", len(self.found[name]), note))
        total = sum(counts["inputs"] for counts in self.counts.values())
        rows.append(verdict.report("fuzz.inputs.all", total, "inputs"))
        if self.seeded:
            note = f"of {self.seeded}; " + ", ".join(f"{name}: {why}" for name, why in self.missed.items())
            rows.append(verdict.judge("fuzz.seeded_faults_missed", len(self.missed), note.rstrip("; ")))
        return rows


def tasks_of(
    names: tuple[str, ...], inputs: int | None, seed: int, stored: bool, faults: bool
) -> list[workers.Task]:
    """Return the processes of a run; with `stored` those that start with the stored findings."""
    share, tasks = sum(INPUTS[name] for name in names), []
    for name in names:
        wanted = INPUTS[name] if inputs is None else max(1, round(inputs * INPUTS[name] / share))
        for n, first in enumerate(range(0, wanted, ROUND)):
            arguments = name, min(ROUND, wanted - first), seed * 10_000 + n, "", stored and n == 0
            tasks.append(workers.Task(runner.fuzz, arguments, ROUND_S))
    for fault, case in FAULTS.items() if faults else ():
        if case.target in names:
            arguments = case.target, SEEDED_INPUTS, seed, fault, False
            tasks.append(workers.Task(runner.fuzz, arguments, SEEDED_S))
    return tasks


@click.command("fuzz")
@click.option("--only", multiple=True, type=click.Choice(NAMES), help="Targets (repeatable).")
@click.option(
    "--inputs", type=click.IntRange(1, 10**9), help=f"Inputs of all targets; default {sum(INPUTS.values())}."
)
@click.option("--seed", type=click.IntRange(0, 10**6), default=0, show_default=True, help="Random seed.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Worker processes.")
@click.option("--fresh", is_flag=True, help="Do not start with the stored findings.")
@click.option(
    "--faults/--no-faults", "seed_faults", default=True, help="Also check that seeded faults are seen."
)
@click.option("--docs", is_flag=True, help="Write the table to build/fuzz.md.")
def fuzz_command(
    only: tuple[str, ...],
    inputs: int | None,
    seed: int,
    jobs: int,
    fresh: bool,
    seed_faults: bool,
    docs: bool,
) -> int:
    """Give hostile input to everything that reads; rows in build/fuzz.json.

    A finding is shrunk and stored in tb/programs/fuzz/found; the next run starts with it.
    """
    WORK.mkdir(parents=True, exist_ok=True)
    tasks, tally = tasks_of(only or NAMES, inputs, seed, not fresh, seed_faults), Tally()
    with progress.slots("fuzz", len(tasks), "rounds") as show:
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs, fresh=True), 1):
            tally.add(tasks[number], outcome)
            show(done, f"{tasks[number].arguments[0]} {tasks[number].arguments[3]}")
    rows = tally.rows()
    verdict.write_rows("fuzz", rows)
    verdict.print_rows(rows, "Hostile input")
    if docs:
        write_atomic(BUILD / "fuzz.md", markdown(rows) + "\n")
    return verdict.exit_code(rows)
