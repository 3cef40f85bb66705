# SPDX-License-Identifier: Apache-2.0
"""`dermis campaign`: random scenes in worker processes against laws; a killed campaign continues."""

import random
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError
from dermis.files import write_atomic
from dermis.places import BUILD, ROOT
from dermis.report import verdict
from dermis.report.progress import slots
from scripts import judged, workers
from scripts.checkpoint import Checkpoint, stamp
from tb.programs.campaign import laws, search
from tb.reference.scenes import PROFILES, World, random_scene

STATE = BUILD / "campaign"
FOUND = ROOT / "tb" / "programs" / "campaign" / "found"
CODE = ROOT / "tb" / "programs" / "campaign", ROOT / "tb" / "reference"
_EXAMPLES = 4  # examples stored of each law


@dataclass(frozen=True)
class Size:
    """Scenes of a task, seconds of a scene, scenes of a short and of a whole run.

    From `telling` scenes of laws on each must have applied; the rarest is asked about one scene in 50.
    """

    task: int
    limit_s: float  # the first scene of a worker compiles loops for 10 s, or Verilog for a minute
    short: int
    whole: int
    telling: int = 0


SIZES = {
    "closed,event": Size(50, 120.0, 200, 100_000, 2_000),
    "rtl": Size(10, 240.0, 10, 2_000, 10),
    "cosim": Size(2, 240.0, 2, 300, 10),
    **dict.fromkeys(search.FILTER_KINDS, Size(50, 225.0, 20, 2_600)),
    **dict.fromkeys(search.SKIN_KINDS, Size(50, 225.0, 20, 1_000)),
}
"""By the engines whose laws are asked about, and by kind of search."""


@dataclass
class Tally:
    """Sums over scenes: counts by name, and (number, law, line) of each violation."""

    counts: Counter[str] = field(default_factory=Counter)
    broken: list[tuple[int, str, str]] = field(default_factory=list)


def scene_of(engines: str, seed: int, number: int) -> World:
    """Return a scene of a campaign, the same for a seed and a number whatever runs before."""
    return replace(random_scene(random.Random(f"{seed} {number}"), PROFILES[engines]), engines=engines)


def run_scenes(name: str, seed: int, first: int, stop: int) -> dict[str, Any]:
    """Run scenes first .. stop - 1 of some engines or a search in a worker and return their piece."""
    counts: Counter[str] = Counter()
    broken, start = [], time.process_time()
    for number in range(first, stop):
        counts["worlds"] += 1
        if name in search.SEARCHES:
            compared = search.SEARCHES[name](name, seed, number)
            counts.update(compared)
            broken += [(number, name, "")] if compared["wrong"] or compared.get("missed") else []
            continue
        found = laws.judge(scene_of(name, seed, number), name, number)
        counts["refused"] += bool(found.refused)
        counts["given_up"] += found.given_up
        counts["conversions"] += found.conversions
        for what, names in (("asked", found.asked), ("compared", found.compared)):
            counts.update({f"{what}.{law}": count for law, count in names.items()})
        broken += [(number, *one) for one in found.broken]
    counts["milliseconds"] = round(1e3 * (time.process_time() - start))
    return {"counts": dict(counts), "broken": broken}


def run(name: str, seed: int, scenes: int, store: Checkpoint, processes: int) -> Tally:
    """Run the scenes that have no piece yet; tasks that hang or crash run again scene by scene."""
    size, total = SIZES[name], Tally()

    def tasks(ends: Iterable[tuple[int, int]], limit_s: float) -> dict[str, workers.Task]:
        return {f"{name} {a}-{b}": workers.Task(run_scenes, (name, seed, a, b), limit_s) for a, b in ends}

    # Most scenes take milliseconds: a task has the time of a few that compile first.
    ends = [(first, min(first + size.task, scenes)) for first in range(0, scenes, size.task)]
    every = tasks(ends, 4.0 * size.limit_s)
    with slots(f"campaign {name}", scenes, "scenes") as show:

        def tell(*_: Any) -> None:
            show(sum(store.pieces[n]["counts"]["worlds"] for n in every if n in store.pieces))

        lost = [every.pop(piece).arguments[2:] for piece in store.run(every, processes, tell)]
        alone = tasks([(n, n + 1) for first, stop in lost for n in range(first, stop)], size.limit_s)
        for piece, fault in store.run(alone, processes, tell).items():
            violation = (alone[piece].arguments[2], "ends", fault)
            store.put(piece, {"counts": {"worlds": 1}, "broken": [violation]})
    for piece in (store.pieces[n] for n in (*every, *alone)):
        total.counts.update(piece["counts"])
        total.broken += map(tuple, piece["broken"])
    return total


def store_cases(engines: str, seed: int, total: Tally, where: Path) -> list[Path]:
    """Store the first examples of each broken law as cases, as they were drawn."""
    paths, by_law = [], Counter[str]()
    for number, law, line in sorted(total.broken):
        by_law[law] += 1
        if by_law[law] <= _EXAMPLES:
            paths.append(where / f"{law}_{engines.replace(',', '_')}_{seed}_{number}.toml")
            write_atomic(paths[-1], replace(scene_of(engines, seed, number), why=f"{law}: {line}").to_toml())
    return paths


def rows(engines: str, seed: int, scenes: int, total: Tally) -> Iterator[verdict.Row]:
    name, counts = engines.replace(",", "_"), total.counts
    given_up = f"{counts['given_up']} scenes end with exit 3"
    note = f"seed {seed}, {counts['refused']} refused with one line, {given_up}"
    yield verdict.judge(f"campaign.scenes_missing.{name}", scenes - counts["worlds"], note)
    yield verdict.judge(f"campaign.given_up.{name}", counts["given_up"] / max(counts["worlds"], 1), given_up)
    seconds = f"{counts['milliseconds'] / 1e3:.0f} core-s"
    yield verdict.report(f"campaign.conversions.{name}", counts["conversions"], "conversions", seconds)
    ends = [one for one in total.broken if one[1] == "ends"]
    note = ends[0][2] if ends else "no hang, no crash, no process left"
    yield verdict.judge(f"campaign.broken.{name}.ends", len(ends), note)
    for law in laws.ENGINES[engines]:
        asked, compared = (counts[f"{what}.{law}"] for what in ("asked", "compared"))
        broken = [one for one in total.broken if one[1] == law]
        note = f"scene {broken[0][0]}: {broken[0][2]}" if broken else laws.meaning(engines, law)
        note = f"compared {compared}, asked {asked} times: {note}"
        yield verdict.judge(f"campaign.broken.{name}.{law}", len(broken), note)
        if counts["worlds"] >= SIZES[engines].telling:
            yield verdict.judge(f"campaign.compared.{name}.{law}", compared)


def search_rows(seed: int, short: bool, store: Checkpoint, processes: int) -> Iterator[verdict.Row]:
    totals = {}
    for kind in search.SEARCHES:
        scenes = SIZES[kind].short if short else SIZES[kind].whole
        totals[kind] = run(kind, seed, scenes, store, processes)
    for kind in search.FILTER_KINDS:
        yield _wrong_codes(f"auto.{kind}_wrong_codes", totals[kind])
    every = [totals[kind] for kind in search.SKIN_KINDS]
    counts = sum((total.counts for total in every), Counter())
    total = Tally(counts, [one for total in every for one in total.broken])
    yield _wrong_codes("skin.simulate_wrong_codes", total)
    for kind in search.SKIN_KINDS:
        missed, cells = (totals[kind].counts[name] for name in ("missed", "cells"))
        share, note = (
            1.0 - missed / cells if cells else None,
            f"{missed} of {cells} cells beyond their interval",
        )
        yield _searched(f"decode.interval_coverage.{kind}", share, note, totals[kind])


def _wrong_codes(name: str, total: Tally) -> verdict.Row:
    codes = total.counts["codes"]
    return _searched(name, total.counts["wrong"] if codes else None, f"of {codes} codes", total)


def _searched(name: str, value: float | None, note: str, total: Tally) -> verdict.Row:
    """Judge a search; one with a scene that did not end is not measured."""
    if ends := [line for _, law, line in total.broken if law == "ends"]:
        return verdict.judge(name, None, ends[0])
    note += f"; {total.counts['worlds']} scenes, {total.counts['refused']} refused"
    return verdict.judge(name, value, note + "".join(f", scene {n}" for n, _, _ in total.broken[:5]))


@click.command("campaign")
@judged.number(
    "--scenes", None, "Number of scenes; default 100000, rtl 2000, those with cosim 300.", 1, 10**9
)
@judged.number("--seed", 0, "Random seed.", 0, 2**32 - 1)
@click.option(
    "--engines",
    default="closed,event",
    show_default=True,
    type=click.Choice(sorted(laws.ENGINES)),
    help="closed and event against each other and the laws; rtl or cosim against event.",
)
@click.option("--resume/--fresh", default=True, show_default=True, help="Continue a killed campaign.")
@judged.number("--processes", 2, "Worker processes.", 1, 256)
@click.option("--short", is_flag=True, help="Run a few scenes.")
@click.option("--found", type=click.Path(file_okay=False), default=str(FOUND), help="Directory of new cases.")
def campaign_command(
    scenes: int | None, seed: int, engines: str, resume: bool, processes: int, short: bool, found: str
) -> int:
    """Run random scenes through the engines and check laws of physics; rows in build/campaign.json."""
    if short and scenes is not None:
        raise InputError("command line", "--short and --scenes", scenes, "one of the two")
    size, name = SIZES[engines], engines.replace(",", "_")
    many = size.short if short else scenes or size.whole
    store = Checkpoint(STATE / f"{name}_{seed}.json", stamp(*CODE), fresh=not resume)
    total = run(engines, seed, many, store, processes)
    cases = store_cases(engines, seed, total, Path(found))
    found_rows = list(rows(engines, seed, many, total))
    if engines == "closed,event" and (short or scenes is None):
        found_rows += search_rows(seed, short, store, processes)
    code = judged.finish("campaign", found_rows, f"{many} random scenes, engines {engines}")
    for path in cases:
        click.echo(f"new case: {path}")
    return code
