# SPDX-License-Identifier: Apache-2.0
"""Compares codes and processor time of [effects] auto with engine event and everything on, over
many scenes.
"""

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

from dermis import auto, effects, engines, records
from dermis import plan as planning
from dermis.converter import currents
from dermis.engines import event, masking
from dermis.errors import InputError
from dermis.places import ROOT
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene import scene, schema
from dermis.scene.scene import SCENES
from tb.programs import auto_bounds, auto_picture
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
    topology: str
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
    def open(self) -> float:
        """Part of the cells that engine event walked."""
        return self.walked / self.conversions


def random_scene(seed: int, number: int, frames: int) -> World:
    """Return random scene `number` of a seed, with auto."""
    limits = replace(PROFILES["auto"], frames=(frames,))
    return scenes.random_scene(random.Random(f"{seed} {number}"), limits)


# Each of these is on or off in a compiled loop of its own.
_LOOPS = (
    {"ripple", "motion"},
    {"c_row_f", "c_column_f", "c_taxel_f"},
    {"q_mirror_c"},
    {"inv_i_range_a"},
    {"t_gbw_s"},
    {"t_comp_delay_s"},
    {"v_hysteresis_v"},
    {"v_int_max_v", "v_int_min_v"},
    event.RANDOM,
)


def _loops(plan: records.Plan) -> tuple[Any, ...]:
    active = plan.active_fields()
    return (plan.engine, plan.topology == "direct", *(bool(active & group) for group in _LOOPS))


def compare(world: scene.Scene, name: str, warm: set[Any] | None = None, repeats: int = REPEATS) -> Outcome:
    """Run a scene with auto and with everything on, and compare.

    With `warm`, a set to be handed from scene to scene, loops are compiled before they are timed.
    Times are the medians of `repeats` runs of either, in turn.

    Raises
    ------
    InputError
        Engine event refuses the scene with everything on.
    """

    def everything() -> engines.Result:
        return event.run(planning.whole(world, "event"))

    def filtered() -> engines.Result:
        return engines.run(planning.make(world, "event"))

    chosen = planning.make(world, "event")
    if warm is not None and _loops(chosen) not in warm:
        warm.add(_loops(chosen))
        everything(), filtered()
    seconds, seconds_all = [], []
    for _ in range(repeats):
        start = time.process_time()
        result = filtered()
        middle = time.process_time()
        full = everything()
        seconds.append(middle - start)
        seconds_all.append(time.process_time() - middle)
    found = result.info["filter"]
    return Outcome(
        name=name,
        topology=chosen.topology,
        conversions=result.codes.size,
        wrong=int((result.codes != full.codes).sum()),
        walked=found["everything"],
        reason=found["reason"],
        looseness=found["bound_over_shift"],
        seconds=statistics.median(seconds),
        seconds_all=statistics.median(seconds_all),
    )


def campaign(count: int, seed: int, frames: int, stored: bool = False) -> tuple[list[Outcome], list[str]]:
    """Outcomes of `count` random scenes, and of every stored one if asked; and the names of those
    refused.

    A refusal is engine event's, with everything on. The same seed gives the same scenes.
    """
    outcomes: list[Outcome] = []
    refused: list[str] = []
    warm: set[Any] = set()

    def take(world: scene.Scene, name: str) -> None:
        try:
            outcomes.append(compare(world, name, warm))
        except InputError:
            refused.append(name)

    with tempfile.TemporaryDirectory() as directory, slots("auto-check", count, "scenes") as on_done:
        for number in range(count):
            take(random_scene(seed, number, frames).read(Path(directory)), f"random {number}")
            on_done(number + 1)
    for path in sorted(SCENES.glob("*.toml")) if stored else ():
        take(auto.with_auto(scene.load(path)), path.stem)
    return outcomes, refused


def fixed_cost(repeats: int = 101) -> verdict.Row:
    """Row of the processor time that auto takes for any scene: of one decided taxel, without its array solve."""
    stimulus = {"kind": "uniform", "code": 100}
    data = {"array": {"rows": 1, "cols": 1}, "stimulus": stimulus, "effects": {"auto": {}}}
    world = scene.from_data(data, Path("fixed_cost.toml"))
    found = []
    for _ in range(repeats):
        start = time.process_time()
        made = planning.make(world, "event")
        result = engines.run(made)
        middle = time.process_time()
        currents.course(made, slice(0, 1))
        found.append(1e3 * (2.0 * middle - start - time.process_time()))
    walked = result.info["filter"]["everything"]
    return verdict.judge(
        "auto.fixed_ms", float(np.median(found)), f"of {repeats} runs, {walked} cells walked"
    )


_OPEN_ROWS = (5, 10)


def two_open_rows(cols: int, seed: int) -> records.Plan:
    """Return a pressed frame of 16 rows for engine cosim, every effect on that it takes, with two
    open rows.

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
    """Row of the processor time of a frame with every row solved over that with two, if no code
    differs.
    """
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
    """Verdict rows: outcomes of short scenes, of long ones, names of refused scenes, and halved
    bounds.

    `halved` is from `auto_bounds.mutants`.
    """
    every = [*few, *many]
    wrong = [f"{o.name} ({o.wrong})" for o in every if o.wrong]
    mostly = [f"{o.name} ({o.reason or o.topology})" for o in every if o.open > 0.5]
    total = sum(o.conversions for o in every)
    walked = sum(o.walked for o in every) / total
    found = [
        verdict.report(
            "auto.scenes", len(every), "scenes", f"{walked:.2%} of the cells are walked by engine event"
        ),
        verdict.judge("auto.refused", len(refused) / (len(every) + len(refused)), ", ".join(refused)),
        verdict.judge("auto.conversions", total),
        verdict.judge("auto.wrong_codes", sum(o.wrong for o in every), ", ".join(wrong)),
        verdict.judge("auto.scenes_mostly_open", len(mostly) / len(every), ", ".join(mostly)),
    ]
    loose = [o.looseness for o in every if o.looseness > 0]
    if loose:
        found.append(
            verdict.judge("auto.bound_over_shift.median", float(np.median(loose)), f"of {len(loose)} scenes")
        )
    for name, outcomes in (("12_frames", few), ("200_frames", many)):
        if not outcomes:
            continue
        ratios = [o.speedup for o in outcomes]
        note = f"of {len(ratios)} scenes; quarters {np.quantile(ratios, 0.25):.3g} and {np.quantile(ratios, 0.75):.3g}"
        found.append(verdict.judge(f"auto.speedup.median_{name}", float(np.median(ratios)), note))
        if outcomes is few:
            lower = float(np.quantile(ratios, 0.25))
            found.append(verdict.judge(f"auto.speedup.lower_quarter_{name}", lower, note))
    if halved is not None:
        caught, missed = halved
        note = f"not caught: {', '.join(missed) or 'none'}"
        found.append(
            verdict.judge("auto.mutated_bounds_caught", len(caught) / (len(caught) + len(missed)), note)
        )
    return found


@click.command("auto-check")
@click.option(
    "--scenes", default=1000, show_default=True, type=click.IntRange(min=1), help="Number of random scenes."
)
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Random seed of the first scene."
)
@click.option("--frames", default=12, show_default=True, type=click.IntRange(min=2), help="Frames per scene.")
@click.option(
    "--long",
    default=40,
    show_default=True,
    type=click.IntRange(min=0),
    help="Number of scenes with 200 frames.",
)
@click.option(
    "--mutants",
    "halved",
    default=auto_bounds.TRIES,
    show_default=True,
    type=click.IntRange(min=0),
    help="Scenes per halved bound, which must show an error; 0 for none.",
)
@click.option(
    "--cosim",
    "cols",
    default=16,
    show_default=True,
    type=click.IntRange(min=0, max=64),
    help="Columns of the frame in engine cosim; 0 for none.",
)
@click.option("--picture", is_flag=True, help="Only draw time against exactness in docs/figures.")
def auto_check_command(
    scenes: int, seed: int, frames: int, long: int, halved: int, cols: int, picture: bool
) -> int:
    """Random and stored scenes with auto against everything on: codes, verdicts, processor time."""
    if picture:
        auto_picture.draw(auto_picture.measure(), ROOT / "docs" / "figures" / "auto_time.png")
        click.echo("drawn: docs/figures/auto_time.png")
        return 0
    few, refused = campaign(scenes, seed, frames, stored=True)
    many, more = campaign(long, seed, _LONG) if long else ([], [])
    found = rows(few, many, refused + more, auto_bounds.mutants(halved) if halved else None)
    found.append(fixed_cost())
    if cols:
        found.append(cosim_speedup(cols, seed))
    verdict.write_rows("auto", found)
    verdict.print_rows(
        found, f"{scenes} random scenes and every stored one, auto against all effects in engine event"
    )
    return verdict.exit_code(found)
