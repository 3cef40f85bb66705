# SPDX-License-Identifier: Apache-2.0
"""`dermis faults`: faults in the run itself, each a command that is disturbed, judged, and run once more."""

from __future__ import annotations

import concurrent.futures
import contextlib
import signal
import time
from collections import Counter
from collections.abc import Iterator, Sequence

import click

from dermis.engines import batch
from dermis.errors import InputError, one_line
from dermis.files import locked, write_between
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts.checkpoint import Checkpoint
from tb.programs.faults.bench import Bench
from tb.programs.faults.trials import Trial, every

DOCS = "build/faults.md"
MARKS = "<!-- begin: faults (written by dermis faults --docs) -->", "<!-- end: faults -->"
PLACE = ROOT / "build" / "faults"


def chosen(only: Sequence[str], runs: int | None) -> list[Trial]:
    """Trials with all of some words in their names; at most so many of each kind, spread over them."""
    found = [trial for trial in every() if all(word in trial.name.split(".") for word in only)]
    if not found:
        words = sorted({word for trial in every() for word in trial.name.split(".")[:-1]})
        raise InputError("command line", "--only", " ".join(only), f"words among {', '.join(words)}")
    if runs is not None and runs < len(found):
        found = [found[i * len(found) // runs] for i in range(runs)]
    return found


def measure(trial: Trial, bench: Bench) -> Row:
    """Run a trial; its row counts what was wrong."""
    start = time.monotonic()
    try:
        faults, note = trial.run(bench, trial.name)
    except PermissionError as error:
        return verdict.skip(
            f"faults.{trial.name}", f"needs more rights than this user has: {one_line(str(error))}"
        )
    except Exception as error:  # a trial that breaks measured nothing
        return verdict.error(f"faults.{trial.name}", f"{type(error).__name__}: {one_line(str(error), 300)}")
    said = "; ".join([*faults, note] if note else faults)
    row = verdict.within(f"faults.{trial.name}", len(faults), "faults", None, 0, one_line(said, 400))
    return {**row, "seconds": round(time.monotonic() - start, 1)}


@contextlib.contextmanager
def heard() -> Iterator[None]:
    """Let what this process ignores reach the commands that it starts.

    A shell has SIGINT ignored by what runs behind it, nohup SIGHUP, and commands inherit that: a trial that sends one
    would disturb nothing, and pass.
    """
    ignored = [number for number in children.SIGNALS if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)  # no handler outlives exec
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def run(trials: Sequence[Trial], bench: Bench, jobs: int, kept: Checkpoint) -> list[Row]:
    """Run trials side by side, keep each row as it comes, and take those that are there already."""
    todo = [trial for trial in trials if trial.name not in kept.pieces]
    with (
        progress.slots("faults", len(trials), "trials") as on_trials,
        children.ending(),
        heard(),
        concurrent.futures.ThreadPoolExecutor(jobs) as pool,
    ):
        tasks = {pool.submit(measure, trial, bench): trial for trial in todo}
        try:
            for number, task in enumerate(
                concurrent.futures.as_completed(tasks), len(trials) - len(todo) + 1
            ):
                kept.put(tasks[task].name, task.result())
                on_trials(number)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            bench.end()
            raise
    return [kept.pieces[trial.name] for trial in trials]


def table(rows: Sequence[Row]) -> str:
    """A line for each group and subject: trials, how they ended, and what was wrong."""
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        _, group, subject, *_ = row["name"].split(".")
        kinds.setdefault((group, subject), []).append(row)
    lines = ["| group | subject | what | trials | ended with | faults |", "|---|---|---|--:|---|--:|"]
    for (group, subject), own in kinds.items():
        what = dict.fromkeys(" ".join(row["name"].split(".")[3:]).rstrip("0123456789 ") for row in own)
        ends = Counter(row["note"].rpartition("; ")[2] for row in own)
        how = ", ".join(f"{end} ({count})" if count > 1 else end for end, count in ends.most_common())
        wrong = sum(row["value"] or 0 for row in own) + sum(row["status"] == "ERROR" for row in own)
        lines.append(f"| {group} | `{subject}` | {', '.join(what)} | {len(own)} | {how} | {wrong} |")
    kills = sum(row["name"].split(".")[1] == "kill" for row in rows)
    counts = ", ".join(
        f"{sum(row['status'] == status for row in rows)} {status}" for status in verdict.COLOURS
    )
    seconds = sum(row.get("seconds", 0.0) for row in rows)
    head = f"{len(rows)} trials, {kills} of them kills: {counts}; {seconds:.0f} s of trials."
    return "\n".join([head, "", *lines])


@click.command("faults")
@click.option(
    "--only",
    multiple=True,
    metavar="WORD",
    help="Trials with this word in their name, such as a group.",
)
@click.option("--subject", metavar="NAME", help="The same as --only NAME.")
@click.option("--runs", type=click.IntRange(1), help="At most so many trials, spread over those chosen.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the moments of faults."
)
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Trials at a time.")
@click.option(
    "--fresh", is_flag=True, help="Do not take the rows of a run of the same sources that was broken off."
)
@click.option("--docs", is_flag=True, help=f"Also write the table in {DOCS}.")
@click.option("--list", "listed", is_flag=True, help="Say what trials there are, and run nothing.")
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
    """Disturb real commands - kill, interrupt, fill, close, cut - and judge what is left; rows in build/faults.json."""
    words = (*only, *((subject,) if subject else ()))
    if docs and (words or runs):
        raise InputError("command line", "--docs", "with --only, --subject or --runs", "a whole run")
    trials = chosen(words, runs)
    if listed:
        for trial in trials:
            click.echo(trial.name)
        return 0
    PLACE.mkdir(parents=True, exist_ok=True)
    with locked(PLACE / "lock", wait=False) as lock:
        if lock is None:
            raise InputError(PLACE, "lock", "held", "one `dermis faults` at a time in a tree")
        return _faults(trials, seed, jobs, fresh, docs)


def _faults(trials: Sequence[Trial], seed: int, jobs: int, fresh: bool, docs: bool) -> int:
    bench = Bench(PLACE / "tree", seed)
    bench.copy()
    kept = Checkpoint(
        PLACE / f"rows_{seed}.json",
        batch.fingerprint(bench.tree / "models" / "dermis", bench.tree),
        fresh=fresh,
    )
    if not kept.pieces:
        bench.forget_builds()
    rows = run(trials, bench, jobs, kept)
    verdict.write_rows("faults", rows)
    verdict.print_rows(rows, f"Faults in the run itself ({len(rows)} trials)")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if docs and broken:
        click.echo(f"not written: {DOCS}, for {broken[0]} was not measured")
    elif docs:
        write_between(ROOT / DOCS, *MARKS, table(rows))
        click.echo(f"written: {DOCS}")
    return verdict.exit_code(rows)
