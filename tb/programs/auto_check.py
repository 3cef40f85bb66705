# SPDX-License-Identifier: Apache-2.0
"""Compares codes and processor time of [effects] auto with engine event and everything on, over many scenes."""

from __future__ import annotations

import random
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from dermis import effects, engines, records
from dermis import plan as planning
from dermis.converter import course
from dermis.engines import event, masking
from dermis.errors import InputError
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene import scene, schema
from dermis.scene.scene import SCENES
from tb.programs import auto_bounds
from tb.reference import scenes
from tb.reference.scenes import PROFILES, World

_LONG = 200
"""Frames of a long scene."""

REPEATS = 3
"""Timed runs of a scene."""


@dataclass(frozen=True)
class Outcome:
    """One scene: codes that differ from everything on, verdicts, and processor time in s."""

    name: str
    conversions: int
    wrong: int
    walked: int
    reason: str
    looseness: float
    seconds: float
    seconds_all: float

    @property
    def speedup(self) -> float:
        """Processor time of everything on over that of auto, both with planning."""
        return self.seconds_all / self.seconds

    @property
    def walked_part(self) -> float:
        """Part of the cells that engine event walked."""
        return self.walked / self.conversions


def random_scene(seed: int, number: int, frames: int) -> World:
    """Return random scene `number` of a seed, with auto."""
    limits = replace(PROFILES["auto"], frames=(frames,))
    return scenes.random_scene(random.Random(f"{seed} {number}"), limits)


def compare(world: scene.Scene, name: str) -> Outcome:
    """Run a scene with auto and with everything on, and compare.

    Times are the medians of runs of either, in turn; a first run that compiles does not move them.

    Raises
    ------
    InputError
        Engine event refuses the scene with everything on.
    """
    seconds, seconds_all = [], []
    for _ in range(REPEATS):
        start = time.process_time()
        plan = planning.make(world, "event")
        result = engines.run(plan)
        middle = time.process_time()
        full = event.run(planning.whole(world, "event"))
        seconds.append(middle - start)
        seconds_all.append(time.process_time() - middle)
    found = result.info["filter"]
    return Outcome(
        name=name,
        conversions=result.codes.size,
        wrong=int((result.codes != full.codes).sum()),
        walked=found["everything"],
        reason=found["reason"] or plan.topology,
        looseness=found["bound_over_shift"],
        seconds=statistics.median(seconds),
        seconds_all=statistics.median(seconds_all),
    )


def campaign(count: int, seed: int, frames: int, stored: bool = False) -> tuple[list[Outcome], list[str]]:
    """Return the outcomes of `count` random scenes, with every stored one if asked, and the names of those refused.

    A refusal is engine event's, with everything on. The same seed gives the same scenes.
    """
    outcomes: list[Outcome] = []
    refused: list[str] = []

    def take(world: scene.Scene, name: str) -> None:
        try:
            outcomes.append(compare(world, name))
        except InputError:
            refused.append(name)

    with tempfile.TemporaryDirectory() as directory, slots("auto-check", count, "scenes") as on_done:
        for number in range(count):
            take(random_scene(seed, number, frames).read(Path(directory)), f"random {number}")
            on_done(number + 1)
    for path in sorted(SCENES.glob("*.toml")) if stored else ():
        take(scene.with_auto(scene.load(path)), path.stem)
    return outcomes, refused


def fixed_cost(repeats: int = 101) -> verdict.Row:
    """Judge the processor time that auto takes for any scene: of one decided taxel, without its array solve."""
    stimulus = {"kind": "uniform", "code": 100}
    data = {"array": {"rows": 1, "cols": 1}, "stimulus": stimulus, "effects": {"auto": {}}}
    world = scene.from_data(data, Path("fixed_cost.toml"))
    found = []
    for _ in range(repeats):
        start = time.process_time()
        made = planning.make(world, "event")
        result = engines.run(made)
        middle = time.process_time()
        course.solve_gate(made, slice(0, 1))
        found.append(1e3 * (2.0 * middle - start - time.process_time()))
    walked = result.info["filter"]["everything"]
    return verdict.judge(
        "auto.fixed_ms", float(np.median(found)), f"of {repeats} runs, {walked} cells walked"
    )


_OPEN_ROWS = (5, 10)


def two_open_rows(cols: int, seed: int) -> records.Plan:
    """Return a pressed frame of 16 rows for engine cosim, every effect on that it takes, with two open rows.

    Taxels that engine event is not certain of are drawn again; in the two rows only after one is
    open there.
    """
    rng = np.random.default_rng(seed)
    random_off = {e.name: False for e in effects.EFFECTS.values() if e.random}
    ohm = 520 * 60 ** rng.random((16, cols))
    data = {
        "array": {"rows": 16, "cols": cols},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "effects": {"auto": {}} | random_off,
    }
    table = schema.validate(scene.SceneTable, data, Path("cosim_speedup.toml"))
    while True:
        stimulus = table.stimulus.given(ohm)
        world = scene.resolve(table.model_copy(update={"stimulus": stimulus}), Path("cosim_speedup.toml"))
        made = planning.make(world, "cosim")
        open_ = masking.decide(made).open[0]
        again = open_.copy()
        for row in _OPEN_ROWS:
            again[row] = not open_[row].any()
        if not again.any():
            return made
        ohm = np.where(again, 520 * 60 ** rng.random(ohm.shape), ohm)


def cosim_speedup(cols: int, seed: int) -> verdict.Row:
    """Judge the processor time of a frame with every row solved over that with two, if no code differs."""
    made = two_open_rows(cols, seed)
    masked, whole = engines.run(made), engines.run(replace(made, filtered=False))
    wrong = int((masked.codes != whole.codes).sum())
    times = [result.info["processor_s"] for result in (whole, masked)]
    rows_solved = masked.info["masked"]["rows_solved"]
    note = f"{times[0]:.3g} s and {times[1]:.3g} s for 16 x {cols}; {rows_solved} rows solved, {wrong} codes differ"
    return verdict.judge("auto.cosim_speedup", 0.0 if wrong else times[0] / times[1], note)


def rows(
    few: list[Outcome],
    many: list[Outcome],
    refused: list[str],
    halved: tuple[dict[str, int], list[str]] | None = None,
) -> list[verdict.Row]:
    """Return the verdicts of short scenes, long ones, names of refused ones, and halved bounds (`mutants`)."""
    every = [*few, *many]
    wrong = [f"{o.name} ({o.wrong})" for o in every if o.wrong]
    mostly = [f"{o.name} ({o.reason})" for o in every if o.walked_part > 0.5]
    loose = [o.looseness for o in every if o.looseness > 0]
    total = sum(o.conversions for o in every)
    walked = sum(o.walked for o in every) / total
    note = f"{walked:.2%} of the cells are walked by engine event"
    found = [
        verdict.report("auto.scenes", len(every), "scenes", note),
        verdict.judge("auto.refused", len(refused) / (len(every) + len(refused)), ", ".join(refused)),
        verdict.judge("auto.conversions", total),
        verdict.judge("auto.wrong_codes", sum(o.wrong for o in every), ", ".join(wrong)),
        verdict.judge("auto.scenes_mostly_open", len(mostly) / len(every), ", ".join(mostly)),
    ]
    if loose:
        median = float(np.median(loose))
        found.append(verdict.judge("auto.bound_over_shift.median", median, f"of {len(loose)} scenes"))
    for name, outcomes in (("12_frames", few), ("200_frames", many)):
        if not outcomes:
            continue
        lower, median, upper = np.quantile([o.speedup for o in outcomes], (0.25, 0.5, 0.75)).tolist()
        note = f"of {len(outcomes)} scenes; quarters {lower:.3g} and {upper:.3g}"
        found.append(verdict.judge(f"auto.speedup.median_{name}", median, note))
        if outcomes is few:
            found.append(verdict.judge(f"auto.speedup.lower_quarter_{name}", lower, note))
    if halved is not None:
        caught, missed = halved
        share = len(caught) / (len(caught) + len(missed))
        note = f"not caught: {', '.join(missed) or 'none'}"
        found.append(verdict.judge("auto.mutated_bounds_caught", share, note))
    return found


def _number(name: str, default: int, help: str, low: int = 0, high: int | None = None) -> Any:
    return click.option(name, default=default, show_default=True, type=click.IntRange(low, high), help=help)


@click.command("auto-check")
@_number("--scenes", 1000, "Number of random scenes.", low=1)
@_number("--seed", 0, "Random seed of the first scene.")
@_number("--frames", 12, "Frames per scene.", low=2)
@_number("--long", 40, "Number of scenes with 200 frames.")
@_number("--mutants", auto_bounds.TRIES, "Scenes per halved bound, which must show an error; 0 for none.")
@_number("--cosim", 16, "Columns of the frame in engine cosim; 0 for none.", high=64)
def auto_check_command(scenes: int, seed: int, frames: int, long: int, mutants: int, cosim: int) -> int:
    """Random and stored scenes with auto against everything on: codes, verdicts, processor time."""
    few, refused = campaign(scenes, seed, frames, stored=True)
    many, more = campaign(long, seed, _LONG) if long else ([], [])
    found = rows(few, many, refused + more, auto_bounds.mutants(mutants) if mutants else None)
    found.append(fixed_cost())
    if cosim:
        found.append(cosim_speedup(cosim, seed))
    verdict.write_rows("auto", found)
    verdict.print_rows(
        found, f"{scenes} random scenes and every stored one, auto against all effects in engine event"
    )
    return verdict.exit_code(found)
