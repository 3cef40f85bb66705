# SPDX-License-Identifier: Apache-2.0
"""Compares codes and processor time of [effects] auto with engine event and everything on, over many scenes."""

import random
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import click
import numpy as np

from dermis import bounds, effects, engines
from dermis import plan as planning
from dermis.converter import course, decide, vfc_loops
from dermis.engines import event, filter, masking
from dermis.errors import InputError
from dermis.ndarrays import Floats
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.progress import slots
from dermis.scene import scene
from dermis.scene.scene import SCENES
from scripts import judged
from tb.reference import scenes

_LONG = 200  # frames of a long scene
REPEATS = 3  # timed runs of a scene


@dataclass(frozen=True)
class Outcome:
    """One scene with auto and with everything on."""

    name: str
    conversions: int
    wrong: int  # codes that differ
    walked: int  # cells that engine event walked
    reason: str
    looseness: float
    speedup: float  # processor time of everything on over that of auto, both with planning


def compare(world: scene.Scene, name: str) -> Outcome:
    """Compare a scene with auto and with everything on; InputError where engine event refuses the latter.

    Times are the medians of runs of either, in turn; a first run that compiles does not move them.
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
    found, wrong = result.info["filter"], int((result.codes != full.codes).sum())
    reason, looseness = found["reason"] or plan.topology, found["bound_over_shift"]
    speedup = statistics.median(seconds_all) / statistics.median(seconds)
    return Outcome(name, result.codes.size, wrong, found["everything"], reason, looseness, speedup)


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

    limits = replace(scenes.PROFILES["auto"], frames=(frames,))
    with tempfile.TemporaryDirectory() as directory, slots("auto-check", count, "scenes") as on_done:
        for number in range(count):
            drawn = scenes.random_scene(random.Random(f"{seed} {number}"), limits)
            take(drawn.read(Path(directory)), f"random {number}")
            on_done(number + 1)
    for path in sorted(SCENES.glob("*.toml")) if stored else ():
        take(scene.with_auto(scene.load(path)), path.stem)
    return outcomes, refused


def fixed_cost(repeats: int = 101) -> verdict.Row:
    """Judge the processor time that auto takes for any scene: of one decided taxel, without its array solve."""
    ohm = np.full((1, 1, 1), scenes.unit_ohm({}) * 510 / 100)
    world = scenes.of_resistances(ohm, {"auto": {}}, name="fixed_cost")
    found = []
    for _ in range(repeats):
        start = time.process_time()
        made = planning.make(world, "event")
        result = engines.run(made)
        middle = time.process_time()
        course.solve_gate(made, slice(0, 1))
        found.append(1e3 * (2.0 * middle - start - time.process_time()))
    walked = result.info["filter"]["everything"]
    note = f"of {repeats} runs, {walked} cells walked"
    return verdict.judge("auto.fixed_ms", float(np.median(found)), note)


_OPEN_ROWS = [5, 10]


def two_open_rows(cols: int, seed: int) -> Plan:
    """Return a pressed frame of 16 rows for engine cosim, every effect on that it takes, with two open rows.

    Taxels that are open are drawn again, in the two rows only after one is open there.
    """
    rng = np.random.default_rng(seed)
    on = {"auto": {}} | {e.name: False for e in effects.EFFECTS.values() if e.random}
    ohm = 520 * 60 ** rng.random((1, 16, cols))
    while True:
        made = planning.make(scenes.of_resistances(ohm, on, name="cosim_speedup"), "cosim")
        again = masking.decide(made).open.copy()
        again[0, _OPEN_ROWS] = ~again[0, _OPEN_ROWS].any(axis=1, keepdims=True)
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


def rows(few: list[Outcome], many: list[Outcome], refused: list[str]) -> list[verdict.Row]:
    """Return the verdicts of short scenes, long ones, and names of refused ones."""
    every = [*few, *many]
    wrong = [f"{o.name} ({o.wrong})" for o in every if o.wrong]
    mostly = [f"{o.name} ({o.reason})" for o in every if o.walked > 0.5 * o.conversions]
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
    return found


# A search for scenes that need the bounds of the filter: each bound, halved in turn, must give a wrong code. A scene
# has one effect, at a strength drawn over its range, and few taxels whose duty runs through a whole code in small
# steps, so that a level that is off by more than its bound gives a wrong code in some of them.
STEPS = 2048  # duties in a code
TRIES = 400  # scenes for a bound


def _plan(name: str, strength: int, codes: Floats) -> Plan:
    """Return a plan of codes [frames, rows, cols] with one effect, whose strength is drawn."""
    effect, rng = effects.EFFECTS[name], np.random.default_rng(strength)
    topology = str(rng.choice(effect.topologies))
    on: dict[str, Any] = {other: dict(value) for other, value in effect.needs.items()}
    on[name] = effect.draw(rng, 1.0) or True
    if name == "comparator_noise":
        on[name] = {"v_v": 2.0 * effect.range()["v_v"][1]}
    with np.errstate(divide="ignore"):
        ohm = scenes.unit_ohm({}) * 510 / codes
    world = scenes.of_resistances(ohm, on, {"topology": topology}, name)
    return replace(planning.make(world, "event"), filtered=True, seed=int(strength))


def _steps(name: str, rng: np.random.Generator) -> Floats:
    """Return steps between codes, [1, rows, cols] or two frames for motion; some are below the first or the last."""
    rows, cols = (int(n) for n in rng.integers(1, [4, 3]))
    shape = (2 if name == "motion" else 1, rows, cols)
    steps = np.exp(rng.uniform(np.log(0.5), np.log(300.0), shape))
    steps = np.where(rng.random(shape) < 0.5, rng.uniform(0.0, 500.0, shape), steps)
    if name == "comparator_noise":
        # Many decisions of a slow converter are near the level: one of them draws a large number.
        steps = np.zeros(shape)
    if name == "mirror_lag":
        # After a row without current the output is late, then by more than half a packet a clock.
        steps = rng.uniform(200.0, 350.0, (1, 2, 1)) * [[[0.0], [1.0]]]
    opened = (steps == 0.0) if name == "mirror_lag" else rng.random(steps.shape) < 0.2
    return np.where(opened, -0.5, np.floor(steps)) + 0.5


def _around(steps: Floats, reach: Floats | float, many: int) -> Floats:
    """Codes [frames, rows, cols] that run from `reach` below each step to as much above it."""
    sweep = np.linspace(-1.0, 1.0, many)[:, None, None, None] * reach
    return np.where(steps > 0.0, np.maximum(steps + sweep, 0.0), 0.0).reshape(-1, *steps.shape[1:])


def _part(plan: Plan) -> Any:
    return filter._Part(plan, slice(0, plan.frames), filter.Table(filter.bounding(plan)))


def violations(plan: Plan) -> int:
    """Codes of engine event outside those at the solved level plus and minus its bound."""
    part = _part(plan)
    s, full = part.s, plan.timing.code_max
    level = part.columns[bounds.LEVEL] - part.columns[bounds.BEGIN] - s.shift
    packet = np.broadcast_to(part.columns[bounds.PACKET], level.shape)
    error = np.minimum(s.error, 1e6)
    counts = (_counts(s.x, plan.timing.gate_clocks, level + by, packet) for by in (error, -error))
    least, most = (np.minimum(count, full) for count in counts)
    # More than the charge at which x is clipped moves a code up only.
    most = np.where(s.x >= decide.X_CLIP * np.maximum(packet, 1.0) * (1.0 - 1e-12), full, most)
    codes = event.run(plan).codes
    return int(((codes < least) | (codes > most)).sum())


_counts = np.vectorize(vfc_loops.count_one, otypes=[int])


def wrong(name: str, trial: int) -> int:
    """Return the violations of the bounds in scene `trial` of an effect; 0 if engine event refuses the scene."""
    rng = np.random.default_rng([trial, *name.encode()])
    steps = _steps(name, rng)
    strength = rng.integers(1 << 32)
    try:
        coarse = _part(_plan(name, strength, _around(steps, 0.5, 9))).s
        reach = 4.0 * (coarse.error + np.abs(coarse.shift)).max(axis=0)
        return violations(_plan(name, strength, _around(steps, np.minimum(reach, 0.5), STEPS)))
    except InputError:
        return 0


def bounded_effects() -> list[str]:
    """Return the effects with a bound that is no number of sigmas, whose largest draw is rare."""
    rare = ("ktc_noise", "flicker_noise", "thermal_noise", "shot_noise", "clock_jitter")
    bounded = (name for name, effect in effects.EFFECTS.items() if effect.bound is not bounds.honoured)
    return [name for name in bounded if name not in rare]


def caught(name: str, tries: int = TRIES) -> int | None:
    """Return the number of the first scene in which the halved bound of an effect gives a wrong code, or None."""
    effect = effects.EFFECTS[name]
    half = replace(effect, bound=replace(effect.bound, factor=0.5))
    with mock.patch.dict(effects.EFFECTS, {name: half}):
        return next((trial for trial in range(tries) if wrong(name, trial)), None)


def halved_bounds(tries: int) -> verdict.Row:
    """Judge the share of halved bounds that give a wrong code in a number of scenes."""
    found = {name: caught(name, tries) for name in bounded_effects()}
    missed = [name for name, trial in found.items() if trial is None]
    note = f"not caught: {', '.join(missed) or 'none'}"
    return verdict.judge("auto.mutated_bounds_caught", 1.0 - len(missed) / len(found), note)


@click.command("auto-check")
@judged.number("--scenes", 1000, "Number of random scenes.", low=1)
@judged.number("--seed", 0, "Random seed of the first scene.")
@judged.number("--frames", 12, "Frames per scene.", low=2)
@judged.number("--long", 40, "Number of scenes with 200 frames.")
@judged.number("--mutants", TRIES, "Scenes per halved bound, which must show an error; 0 for none.")
@judged.number("--cosim", 16, "Columns of the frame in engine cosim; 0 for none.", high=64)
def auto_check_command(scenes: int, seed: int, frames: int, long: int, mutants: int, cosim: int) -> int:
    """Random and stored scenes with auto against everything on: codes, verdicts, processor time."""
    few, refused = campaign(scenes, seed, frames, stored=True)
    many, more = campaign(long, seed, _LONG) if long else ([], [])
    found = rows(few, many, refused + more)
    if mutants:
        found.append(halved_bounds(mutants))
    found.append(fixed_cost())
    if cosim:
        found.append(cosim_speedup(cosim, seed))
    title = f"{scenes} random scenes and every stored one, auto against all effects in engine event"
    return judged.finish("auto", found, title)
