# SPDX-License-Identifier: Apache-2.0
"""`dermis faults`: commands that are disturbed, judged, and run once more."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import click

from dermis.errors import InputError, one_line
from dermis.files import locked
from dermis.places import BUILD, ROOT
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts import judged, workers
from scripts.checkpoint import Checkpoint, stamp
from tb.programs.faults.bench import Bench
from tb.programs.faults.trials import Trial, every

PLACE = BUILD / "faults"
TRIAL_LIMIT_S = 3600.0
"""A trial runs a command and its rerun, each for at most bench.END_LIMIT_S, and what it waits for."""
CODE = Path(__file__).parent, ROOT / "scripts"


def chosen(only: Sequence[str], runs: int | None) -> list[Trial]:
    """Return the trials with some words in their names, at most `runs`, spread over them."""
    found = [trial for trial in every() if all(word in trial.name for word in only)]
    if not found:
        raise InputError("command line", "--only", " ".join(only), "parts of a name that --list shows")
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
    with progress.slots("faults", len(tasks), "trials") as tell:
        missed = store.run(tasks, jobs, tell)
    return [store.pieces.get(name) or verdict.error(f"faults.{name}", missed[name]) for name in tasks]


@click.command("faults")
@click.option("--only", multiple=True, metavar="WORD", help="Trials with a word in their name (repeatable).")
@click.option("--runs", type=click.IntRange(1), help="Number of trials, spread over those chosen.")
@judged.number("--seed", 0, "Random seed for fault times.")
@judged.number("--jobs", 2, "Trials at a time.", 1, 64)
@click.option("--fresh", is_flag=True, help="Ignore the rows of an interrupted run.")
@click.option("--list", "listed", is_flag=True, help="Print the names of the trials and run nothing.")
def faults_command(
    only: tuple[str, ...], runs: int | None, seed: int, jobs: int, fresh: bool, listed: bool
) -> int:
    """Kill, interrupt, fill, close and cut real commands and judge the result; rows in build/faults.json."""
    trials = chosen(only, runs)
    if listed:
        click.echo("\n".join(trial.name for trial in trials))
        return 0
    PLACE.mkdir(parents=True, exist_ok=True)
    with locked(PLACE / "lock", wait=False) as lock:
        if lock is None:
            raise InputError(PLACE, "lock", "held", "one `dermis faults` at a time in a tree")
        bench = Bench(PLACE, seed)
        store = Checkpoint(PLACE / f"rows_{seed}.json", stamp(*CODE), fresh=fresh)
        if not store.pieces:  # a trial that disturbs a build would find it done
            for place in ("models", "trials"):
                shutil.rmtree(PLACE / place, ignore_errors=True)
        rows = run(trials, bench, jobs, store)
    return judged.finish("faults", rows, f"Faults of runs ({len(rows)} trials)")
