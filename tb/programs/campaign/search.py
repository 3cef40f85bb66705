# SPDX-License-Identifier: Apache-2.0
"""The standing searches of a campaign: `auto` against event, `Skin` against simulate, intervals against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

from dermis.report import verdict
from dermis.report.progress import slots
from scripts import workers
from scripts.checkpoint import Checkpoint
from tb.programs.campaign import combined, intervals

_TASK, _LIMIT_S = 50, 900.0  # scenes of a task; its first scene compiles loops


class Search(NamedTuple):
    """A search: what runs one of its scenes, and the scenes of a short and of a whole run."""

    run_scene: Callable[[str, int, int], dict[str, int]]
    short: int
    whole: int


SEARCHES = {kind: Search(combined.run_scene, 20, 2_600) for kind in combined.KINDS}
SEARCHES |= {kind: Search(intervals.run_scene, 20, 1_000) for kind in intervals.KINDS}


def run_scenes(kind: str, seed: int, first: int, stop: int) -> dict[str, int]:
    """Run scenes first .. stop - 1 of a search and return the sums of their counts."""
    counts: Counter[str] = Counter()
    for number in range(first, stop):
        found = SEARCHES[kind].run_scene(kind, seed, number)
        counts.update(found)
        if found["wrong"] or found.get("missed"):
            counts[f"scene {number}"] += found["wrong"] + found.get("missed", 0)
    return dict(counts)


def run(seed: int, short: bool, store: Checkpoint, processes: int) -> Iterator[verdict.Row]:
    """Run the searches, as far as `store` has no piece of them yet, and yield their rows."""
    tasks, scenes = {}, 0
    for kind, search in SEARCHES.items():
        many = search.short if short else search.whole
        scenes += many
        for first in range(0, many, _TASK):
            work = kind, seed, first, min(first + _TASK, many)
            tasks[f"{kind} {work[2]}-{work[3]}"] = workers.Task(run_scenes, work, _LIMIT_S)
    with slots("campaign search", scenes, "scenes") as show:

        def on_done(name: str) -> None:
            show(sum(store.pieces[n]["scenes"] for n in tasks if n in store.pieces))

        lost = store.run(tasks, processes, on_done)
    by_kind: dict[str, Counter[str]] = {kind: Counter() for kind in SEARCHES}
    for name in tasks:
        by_kind[name.partition(" ")[0]].update(store.pieces.get(name, {}))
    for kind in combined.KINDS:
        yield _row(f"auto.{kind}_wrong_codes", by_kind[kind], lost, kind)
    skin: Counter[str] = sum((by_kind[kind] for kind in intervals.KINDS), Counter())
    yield _row("skin.simulate_wrong_codes", skin, {n: f for n, f in lost.items() if "any" in n}, "any")
    for kind in intervals.KINDS:
        found = by_kind[kind]
        share = 1.0 - found["missed"] / found["cells"] if found["cells"] and not _lost(lost, kind) else None
        note = f"{found['missed']} of {found['cells']} cells beyond their interval; {_where(found)}"
        yield verdict.judge(f"decode.interval_coverage.{kind}", share, note)


def _lost(lost: dict[str, str], kind: str) -> str:
    return next((fault for name, fault in lost.items() if name.startswith(f"{kind} ")), "")


def _where(counts: Counter[str]) -> str:
    found = [name for name in counts if name.startswith("scene ")]
    return f"{counts['scenes']} scenes, {counts['refused']} refused" + "".join(f", {n}" for n in found[:5])


def _row(name: str, counts: Counter[str], lost: dict[str, str], kind: str) -> verdict.Row:
    fault = _lost(lost, kind)
    value = counts["wrong"] if counts["codes"] and not fault else None
    return verdict.judge(name, value, fault or f"of {counts['codes']} codes; {_where(counts)}")
