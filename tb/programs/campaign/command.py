# SPDX-License-Identifier: Apache-2.0
"""`dermis campaign`: many random worlds in worker processes, with a state that a killed campaign goes on from."""

from __future__ import annotations

import hashlib
import itertools
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import click

from dermis.engines import batch
from dermis.errors import InputError
from dermis.files import write_atomic, write_between
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene.design import ROOT
from scripts import workers
from scripts.checkpoint import Kept
from tb.programs.campaign import draw, laws, shrink, trial
from tb.programs.campaign.world import World

STATE = ROOT / "build" / "campaign"
FOUND = ROOT / "tb" / "hard" / "found"
DOCS = ROOT / "docs" / "campaign.md"

# Worlds of one task: enough that handing it out costs nothing, few enough that little is lost when one is killed.
_A_TASK = {"closed,event": 50, "rtl": 10, "cosim": 2, "auto,cosim": 2}
# Longest a single world may take. The first of its kind compiles loops (10 s, a minute on a busy machine) or Verilog.
LIMIT_S = {"closed,event": 120.0, "rtl": 240.0, "cosim": 240.0, "auto,cosim": 240.0}
_SHORT = {"closed,event": 200, "rtl": 10, "cosim": 2, "auto,cosim": 4}
_FULL = {"closed,event": 100_000, "rtl": 2_000, "cosim": 300, "auto,cosim": 300}
# From so many scenes on every law must have had something to compare: the rarest is asked for one scene in 50.
_TELLING = {"closed,event": 2_000, "rtl": 10, "cosim": 10, "auto,cosim": 40}
# Seconds to shrink one example, and examples of a law that are shrunk and kept.
_SHRINK_S, _KEPT = 120.0, 4


@dataclass
class Tally:
    """What worlds came to, of a task or of all: sums of counts, and every world that is broken."""

    worlds: int = 0
    refused: int = 0
    given_up: int = 0
    conversions: int = 0
    asked: dict[str, int] = field(default_factory=dict)
    compared: dict[str, int] = field(default_factory=dict)
    broken: list[tuple[int, str, str]] = field(default_factory=list)  # world, law, what
    seconds: float = 0.0

    def add(self, other: Tally) -> None:
        """Take another's counts in."""
        self.worlds += other.worlds
        self.refused += other.refused
        self.given_up += other.given_up
        self.conversions += other.conversions
        self.seconds += other.seconds
        for mine, theirs in ((self.asked, other.asked), (self.compared, other.compared)):
            for law, count in theirs.items():
                mine[law] = mine.get(law, 0) + count
        self.broken += [(int(number), law, what) for number, law, what in other.broken]


def worlds_of(engines: str, seed: int, first: int, stop: int) -> Tally:
    """Worlds first .. stop - 1: what a worker does."""
    tally, start = Tally(), time.process_time()
    with tempfile.TemporaryDirectory() as directory:
        for number in range(first, stop):
            world = draw.world(seed, number, engines, Path(directory))
            outcome = trial.run(world, engines, number, scratch=Path(directory))
            broken = [(number, b.law, b.what) for b in outcome.broken]
            refused, given_up = int(bool(outcome.refused)), int(outcome.given_up)
            tally.add(
                Tally(
                    1,
                    refused,
                    given_up,
                    outcome.conversions,
                    dict(outcome.asked),
                    dict(outcome.compared),
                    broken,
                )
            )
    tally.seconds = time.process_time() - start
    return tally


class Campaign:
    """A campaign of `scenes` worlds and its state on disk.

    Attributes
    ----------
    done : dict
        First world of a task, and the one behind its last, as "first-stop" -> its tally. Tasks of a run of another
        length stay in the state and count for nothing here.
    """

    def __init__(self, engines: str, seed: int, scenes: int, *, fresh: bool = False) -> None:
        self.engines, self.seed, self.scenes = engines, seed, scenes
        path = STATE / f"{engines.replace(',', '_')}_{seed}.json"
        self.kept = Kept(path, batch.fingerprint(), fresh=fresh)
        self.done = {name: Tally(**tally) for name, tally in self.kept.pieces.items()}

    def tasks(self) -> list[tuple[int, int]]:
        """First world, and the one behind the last, of every task of this run."""
        step = _A_TASK[self.engines]
        return [(first, min(first + step, self.scenes)) for first in range(0, self.scenes, step)]

    def run(self, processes: int) -> None:
        """Run what is not done yet; what hangs or crashes is found again world by world."""
        limit_s = LIMIT_S[self.engines]
        waiting = [task for task in self.tasks() if _name(task) not in self.done]
        again: list[tuple[int, int]] = []
        done = self.total().worlds
        with slots(f"campaign {self.engines}", self.scenes, "scenes") as on_done:
            tasks = (
                # Most worlds take milliseconds: a task has the time of a few that have to compile first.
                workers.Task(worlds_of, (self.engines, self.seed, *task), 4.0 * limit_s)
                for task in waiting
            )
            for number, outcome in workers.run(tasks, processes):
                if outcome.fault:
                    again.append(waiting[number])
                    continue
                done += self._keep(waiting[number], outcome.value)
                on_done(done)
            for task in again:
                done += self._keep(task, self._one_by_one(task, processes))
                on_done(done)
        self.kept.save()

    def _keep(self, task: tuple[int, int], tally: Tally) -> int:
        self.done[_name(task)] = tally
        self.kept.put(_name(task), asdict(tally), now=False)
        return tally.worlds

    def _one_by_one(self, task: tuple[int, int], processes: int) -> Tally:
        numbers = range(*task)
        tasks = [
            workers.Task(worlds_of, (self.engines, self.seed, n, n + 1), LIMIT_S[self.engines])
            for n in numbers
        ]
        tally = Tally()
        for number, outcome in workers.run(tasks, processes):
            if outcome.fault:
                tally.add(Tally(1, broken=[(numbers[number], "ends", outcome.fault)]))
            else:
                tally.add(outcome.value)
        return tally

    def total(self) -> Tally:
        """All worlds together."""
        tally = Tally()
        for task in self.tasks():
            if _name(task) in self.done:
                tally.add(self.done[_name(task)])
        return tally


def _name(task: tuple[int, int]) -> str:
    return f"{task[0]}-{task[1]}"


def keep(campaign: Campaign, total: Tally, where: Path, processes: int) -> list[Path]:
    """Shrink the first examples of every law that was broken, and store them as cases."""
    chosen: list[tuple[int, str, str]] = []
    for _, examples in itertools.groupby(sorted(total.broken, key=lambda b: (b[1], b[0])), lambda b: b[1]):
        chosen += list(itertools.islice(examples, _KEPT))
    tasks = [
        workers.Task(shrunk, (campaign.engines, campaign.seed, number, law, what), 3.0 * _SHRINK_S)
        for number, law, what in chosen
    ]
    kept = []
    for number, outcome in workers.run(tasks, processes):
        index, law, what = chosen[number]
        # What hangs or crashes does so while it is shrunk: it is stored as it was drawn.
        text = outcome.value or _case(campaign.engines, campaign.seed, index, f"{law}: {what}").to_toml()
        name = f"{law}_{hashlib.sha256(text.encode()).hexdigest()[:8]}.toml"
        write_atomic(where / name, text)
        kept.append(where / name)
    return kept


def _case(engines: str, seed: int, number: int, why: str) -> World:
    with tempfile.TemporaryDirectory() as scratch:
        return replace(draw.world(seed, number, engines, Path(scratch)), why=why, engines=engines)


def shrunk(engines: str, seed: int, number: int, law: str, what: str) -> str:
    """The smallest world that breaks the law as this one does, as text: what a worker does."""
    one = _case(engines, seed, number, f"{law}: {what}")
    return (one if law == "ends" else shrink.shrink(one, engines, number, law, _SHRINK_S)).to_toml()


def rows(campaign: Campaign, total: Tally) -> Iterator[verdict.Row]:
    """Verdict rows of a campaign."""
    name = campaign.engines.replace(",", "_")
    note = f"seed {campaign.seed}, {total.refused} refused with one line, {total.given_up} of them as exit 3"
    yield verdict.judge(f"campaign.scenes_missing.{name}", campaign.scenes - total.worlds, note)
    share = total.given_up / max(total.worlds, 1)
    yield verdict.judge(f"campaign.given_up.{name}", share, f"{total.given_up} scenes end with exit 3")
    yield verdict.report(
        f"campaign.conversions.{name}", total.conversions, "conversions", f"{total.seconds:.0f} core-s"
    )
    ends = [b for b in total.broken if b[1] == "ends"]
    yield verdict.judge(
        f"campaign.broken.{name}.ends",
        len(ends),
        ends[0][2] if ends else "no hang, no crash, no process left",
    )
    for law in ["typed_errors", *laws.ENGINES[campaign.engines]]:
        broken = [b for b in total.broken if b[1] == law]
        note = f"scene {broken[0][0]}: {broken[0][2]}" if broken else laws.meaning(campaign.engines, law)
        asked = total.worlds if law == "typed_errors" else total.asked.get(law, 0)
        compared = total.worlds if law == "typed_errors" else total.compared.get(law, 0)
        yield verdict.judge(
            f"campaign.broken.{name}.{law}", len(broken), f"compared {compared}, asked {asked} times: {note}"
        )
        if total.worlds >= _TELLING[campaign.engines]:
            yield verdict.judge(f"campaign.compared.{name}.{law}", compared)


def record(campaign: Campaign, total: Tally, processes: int, found: list[verdict.Row]) -> str:
    """The record of a campaign as Markdown for docs/campaign.md."""
    failed = sum(r["status"] != "PASS" for r in found)
    lines = [
        f'`make campaign ARGS="--engines {campaign.engines} --scenes {campaign.scenes} --seed {campaign.seed} '
        f'--processes {processes}"`: {total.worlds} scenes, {total.refused} of them refused with one line '
        f"({total.given_up} as exit 3), "
        f"{total.conversions} conversions, {len(total.broken)} laws broken, {failed} rows failed, "
        f"{total.seconds / 60:.1f} core-minutes.",
        "",
        "| law | asked | compared | broken |",
        "|---|--:|--:|--:|",
    ]
    for law in ("typed_errors", *laws.ENGINES[campaign.engines]):
        asked = total.worlds if law == "typed_errors" else total.asked.get(law, 0)
        compared = total.worlds if law == "typed_errors" else total.compared.get(law, 0)
        broken = sum(b[1] == law for b in total.broken)
        lines.append(f"| {laws.meaning(campaign.engines, law)} | {asked} | {compared} | {broken} |")
    return "\n".join(lines)


@click.command("campaign")
@click.option(
    "--scenes",
    type=click.IntRange(1, 10**9),
    help="How many; default 100000, rtl 2000, those with cosim 300.",
)
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(0, 2**32 - 1), help="Of all scenes."
)
@click.option(
    "--engines",
    default="closed,event",
    show_default=True,
    type=click.Choice(sorted(laws.ENGINES)),
    help="closed,event against each other and the laws; rtl or cosim against event; what auto leaves out against cosim",
)
@click.option("--resume/--fresh", default=True, show_default=True, help="Go on where a killed one stopped.")
@click.option("--processes", default=2, show_default=True, type=click.IntRange(1, 256), help="At a time.")
@click.option("--docs", is_flag=True, help="Write the record into docs/campaign.md.")
@click.option("--short", is_flag=True, help="A few scenes only.")
@click.option(
    "--found", type=click.Path(file_okay=False), default=str(FOUND), help="Where shrunk failures go as cases."
)
def campaign_command(
    scenes: int | None,
    seed: int,
    engines: str,
    resume: bool,
    processes: int,
    docs: bool,
    short: bool,
    found: str,
) -> int:
    """Random scenes through the engines, against each other and against laws of the physics."""
    if short and scenes is not None:
        raise InputError("command line", "--short and --scenes", scenes, "one of the two")
    if short and docs:
        raise InputError("command line", "--short and --docs", "both", "a record of more than the short run")
    many = _SHORT[engines] if short else scenes or _FULL[engines]
    campaign = Campaign(engines, seed, many, fresh=not resume)
    if there := campaign.total().worlds:
        click.echo(f"{there} scenes are there from before; --fresh begins anew", err=True)
    try:
        campaign.run(processes)
    except BaseException:
        campaign.kept.save()  # what is done is done, whatever ended the rest
        raise
    total = campaign.total()
    cases = keep(campaign, total, Path(found), processes) if total.broken else []
    judged = list(rows(campaign, total))
    verdict.write_rows("campaign", judged)
    verdict.print_rows(judged, f"{many} random scenes, engines {engines}")
    for path in cases:
        click.echo(f"a case for tb/hard/found: {path}")
    if docs:
        name = engines.replace(",", "_")
        text = record(campaign, total, processes, judged)
        write_between(
            DOCS, f"<!-- begin: {name} (written by dermis campaign --docs) -->", f"<!-- end: {name} -->", text
        )
    return verdict.exit_code(judged)
