# SPDX-License-Identifier: Apache-2.0
"""`dermis faults`: commands that are disturbed, judged, and run once more."""

from __future__ import annotations

import concurrent.futures
import contextlib
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from dermis.errors import InputError, one_line
from dermis.files import locked, write_between
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts.checkpoint import Checkpoint, stamp
from tb.programs.faults.bench import Bench
from tb.programs.faults.trials import Trial, every

DOCS = "build/faults.md"
MARKS = "<!-- begin: faults (written by dermis faults --docs) -->", "<!-- end: faults -->"
PLACE = ROOT / "build" / "faults"
CODE = Path(__file__).parent, ROOT / "scripts"


def chosen(only: Sequence[str], runs: int | None) -> list[Trial]:
    """Return the trials with some words in their names, at most `runs`, spread over them."""
    found = [trial for trial in every() if all(word in trial.name.split(".") for word in only)]
    if not found:
        words = sorted({word for trial in every() for word in trial.name.split(".")[:-1]})
        raise InputError("command line", "--only", " ".join(only), f"words among {', '.join(words)}")
    if runs is not None and runs < len(found):
        found = [found[i * len(found) // runs] for i in range(runs)]
    return found


def measure(trial: Trial, bench: Bench) -> Row:
    """Run a trial; its row counts the faults."""
    start = time.monotonic()
    try:
        faults, note = trial.run(bench, trial.name)
    except PermissionError as error:
        return verdict.skip(f"faults.{trial.name}", f"needs more rights: {one_line(str(error))}")
    except Exception as error:  # a trial that fails measured nothing
        return verdict.error(f"faults.{trial.name}", f"{type(error).__name__}: {one_line(str(error), 300)}")
    said = one_line("; ".join([*faults, note] if note else faults), 400)
    row = verdict.within(f"faults.{trial.name}", len(faults), "faults", None, 0, said)
    return {**row, "seconds": round(time.monotonic() - start, 1)}


@contextlib.contextmanager
def signals_reach_commands() -> Iterator[None]:
    """Let signals that this process ignores reach its commands, which would inherit that.

    A shell ignores SIGINT for background commands, and nohup ignores SIGHUP.
    """
    ignored = [number for number in children.SIGNALS if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)  # no handler outlives exec
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def run(trials: Sequence[Trial], bench: Bench, jobs: int, store: Checkpoint) -> list[Row]:
    """Run the trials without a row, `jobs` at a time, and store each row."""
    todo = [trial for trial in trials if trial.name not in store.pieces]
    with (
        progress.slots("faults", len(trials), "trials") as on_trials,
        children.ending(),
        signals_reach_commands(),
        concurrent.futures.ThreadPoolExecutor(jobs) as pool,
    ):
        tasks = {pool.submit(measure, trial, bench): trial for trial in todo}
        try:
            done = concurrent.futures.as_completed(tasks)
            for number, task in enumerate(done, len(trials) - len(todo) + 1):
                store.put(tasks[task].name, task.result())
                on_trials(number)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            bench.end()
            raise
    return [store.pieces[trial.name] for trial in trials]


def table(rows: Sequence[Row]) -> str:
    """Return a Markdown table with a line for each group and subject."""
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        _, group, subject, *_ = row["name"].split(".")
        kinds.setdefault((group, subject), []).append(row)
    lines = ["| group | subject | trials | ended with | faults |", "|---|---|--:|---|--:|"]
    for (group, subject), own in kinds.items():
        ends = Counter(row["note"].rpartition("; ")[2] for row in own)
        how = ", ".join(f"{end} ({count})" if count > 1 else end for end, count in ends.most_common())
        wrong = sum(row["value"] or 0 for row in own) + sum(row["status"] == "ERROR" for row in own)
        lines.append(f"| {group} | `{subject}` | {len(own)} | {how} | {wrong} |")
    kills = sum(row["name"].split(".")[1] == "kill" for row in rows)
    by_status = Counter(row["status"] for row in rows)
    counts = ", ".join(f"{by_status[status]} {status}" for status in verdict.COLOURS)
    return "\n".join([f"{len(rows)} trials, {kills} of them kills: {counts}.", "", *lines])


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
            shutil.rmtree(bench.tree / "build" / "models", ignore_errors=True)
        rows = run(trials, bench, jobs, store)
    verdict.write_rows("faults", rows)
    verdict.print_rows(rows, f"Faults of runs ({len(rows)} trials)")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if docs and broken:
        click.echo(f"not written: {DOCS}, for {broken[0]} was not measured", err=True)
    elif docs:
        write_between(ROOT / DOCS, *MARKS, table(rows))
    return verdict.exit_code(rows)
