# SPDX-License-Identifier: Apache-2.0
"""`dermis faults`: commands that are disturbed, judged, and run once more."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from dermis.errors import InputError, one_line
from dermis.files import locked, write_atomic
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts import workers
from scripts.checkpoint import Checkpoint, stamp
from tb.programs.faults.bench import Bench
from tb.programs.faults.trials import Trial, every

DOCS = "build/faults.md"
PLACE = ROOT / "build" / "faults"
TRIAL_LIMIT_S = 3600.0
"""A trial runs a command and its rerun, each for at most bench.END_LIMIT_S, and what it waits for."""
CODE = Path(__file__).parent, ROOT / "scripts"


def words_of(trial: Trial) -> set[str]:
    """Return the words of a name that `--only` takes: its parts, and the last word of what is done."""
    parts = trial.name.split(".")[:-1]
    return {*parts, *parts[-1].rpartition("_")[::2]}


def chosen(only: Sequence[str], runs: int | None) -> list[Trial]:
    """Return the trials with some words in their names, at most `runs`, spread over them."""
    found = [trial for trial in every() if words_of(trial).issuperset(only)]
    if not found:
        words = sorted({word for trial in every() for word in words_of(trial)} - {""})
        raise InputError("command line", "--only", " ".join(only), f"words among {', '.join(words)}")
    if runs is not None and runs < len(found):
        found = [found[i * len(found) // runs] for i in range(runs)]
    return found


def measure(trial: Trial, bench: Bench) -> Row:
    """Run a trial; its row counts the faults."""
    name = f"faults.{trial.name}"
    try:
        faults, note = trial.run(bench)
    except PermissionError as error:
        return verdict.skip(name, f"needs more rights: {one_line(str(error))}")
    return verdict.within(name, len(faults), "faults", None, 0, one_line("; ".join([*faults, note]), 400))


def run(trials: Sequence[Trial], bench: Bench, jobs: int, store: Checkpoint) -> list[Row]:
    """Run the trials without a row in worker processes, and store each row."""
    tasks = {trial.name: workers.Task(measure, (trial, bench), TRIAL_LIMIT_S) for trial in trials}
    done = sum(name in store.pieces for name in tasks)
    with progress.slots("faults", len(tasks), "trials") as tell:

        def on_done(name: str) -> None:
            nonlocal done
            done += 1
            tell(done, name)

        missed = store.run(tasks, jobs, on_done)
    return [store.pieces.get(name) or verdict.error(f"faults.{name}", missed[name]) for name in tasks]


def table(rows: Sequence[Row]) -> str:
    """Return a Markdown table with a line for each group and subject."""
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        _, group, subject, *_ = row["name"].split(".")
        kinds.setdefault((group, subject), []).append(row)
    lines = ["| group | subject | trials | ended with | faults |", "|---|---|--:|---|--:|"]
    for (group, subject), own in kinds.items():
        ends = Counter(row["note"].rpartition("; ")[2] for row in own)
        how = ", ".join(f"{end} ({count})" for end, count in ends.most_common())
        wrong = sum(row["value"] or 0 for row in own) + sum(row["status"] == "ERROR" for row in own)
        lines.append(f"| {group} | `{subject}` | {len(own)} | {how} | {wrong} |")
    by_status = Counter(row["status"] for row in rows)
    counts = ", ".join(f"{by_status[status]} {status}" for status in verdict.COLOURS)
    return "\n".join([f"{len(rows)} trials: {counts}.", "", *lines, ""])


@click.command("faults")
@click.option("--only", multiple=True, metavar="WORD", help="Trials with a word in their name (repeatable).")
@click.option("--subject", metavar="NAME", help="The same as --only NAME.")
@click.option("--runs", type=click.IntRange(1), help="Number of trials, spread over those chosen.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Random seed for fault times."
)
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Trials at a time.")
@click.option("--fresh", is_flag=True, help="Ignore the rows of an interrupted run.")
@click.option("--docs", is_flag=True, help=f"Write the table in {DOCS}.")
@click.option("--list", "listed", is_flag=True, help="Print the names of the trials and run nothing.")
def faults_command(
    only: tuple[str, ...],
    subject: str | None,
    runs: int | None,
    seed: int,
    jobs: int,
    fresh: bool,
    docs: bool,
    listed: bool,
) -> int:
    """Kill, interrupt, fill, close and cut real commands and judge the result; rows in
    build/faults.json.
    """
    words = (*only, *((subject,) if subject else ()))
    if docs and (words or runs):
        raise InputError("command line", "--docs", "with --only, --subject or --runs", "a whole run")
    trials = chosen(words, runs)
    if listed:
        click.echo("\n".join(trial.name for trial in trials))
        return 0
    PLACE.mkdir(parents=True, exist_ok=True)
    with locked(PLACE / "lock", wait=False) as lock:
        if lock is None:
            raise InputError(PLACE, "lock", "held", "one `dermis faults` at a time in a tree")
        bench = Bench(PLACE / "tree", seed)
        bench.copy()
        store = Checkpoint(PLACE / f"rows_{seed}.json", stamp(*CODE), fresh=fresh)
        if not store.pieces:  # a trial that disturbs a build would find it done
            for place in ("build/models", "trials"):
                shutil.rmtree(bench.tree / place, ignore_errors=True)
        rows = run(trials, bench, jobs, store)
    verdict.write_rows("faults", rows)
    verdict.print_rows(rows, f"Faults of runs ({len(rows)} trials)")
    if docs:
        write_atomic(ROOT / DOCS, table(rows))
    return verdict.exit_code(rows)
