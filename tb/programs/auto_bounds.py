# SPDX-License-Identifier: Apache-2.0
"""Search for scenes that need the bounds of the filter: each bound, halved in turn, must give a wrong code.

A scene has one effect, at a strength drawn over its range, and few taxels whose duty runs through a whole code in
small steps, so that a level that is off by more than its bound gives a wrong code in some of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import bounds, effects, records
from dermis import plan as planning
from dermis.converter import decide, vfc_loops
from dermis.engines import event, filter
from dermis.errors import InputError
from dermis.scene import scene, schema

Floats = NDArray[np.float64]

STEPS = 2048
"""Duties in a code."""

TRIES = 400
"""Scenes for a bound."""


@contextmanager
def halved(name: str) -> Iterator[None]:
    """Halve the bound of an effect."""
    effect = effects.EFFECTS[name]
    effects.EFFECTS[name] = replace(effect, bound=replace(effect.bound, factor=0.5))
    try:
        yield
    finally:
        effects.EFFECTS[name] = effect


def _plan(name: str, strength: int, codes: Floats) -> records.Plan:
    """Return a plan of codes [frames, rows, cols] with one effect, whose strength is drawn."""
    effect, rng = effects.EFFECTS[name], np.random.default_rng(strength)
    topology = str(rng.choice(effect.topologies))
    on: dict[str, Any] = {other: dict(value) for other, value in effect.needs.items()}
    on[name] = effect.draw(rng, 1.0) or True
    if name == "comparator_noise":
        on[name] = {"v_v": 2.0 * effect.range()["v_v"][1]}
    data = {
        "array": {"rows": codes.shape[1], "cols": codes.shape[2]},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "interface": {"topology": topology},
        "effects": on,
    }
    path = Path(f"{name}.toml")
    table = schema.validate(scene.SceneTable, data, path)
    interface = scene.resolve(table, path).table.interface
    with np.errstate(divide="ignore"):
        ohm = interface.v_bias_v / (interface.k * interface.i0_a) * 510 / codes
    world = scene.resolve(table.model_copy(update={"stimulus": table.stimulus.given(ohm)}), path)
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


def _part(plan: records.Plan) -> Any:
    return filter._Part(plan, slice(0, plan.frames), filter.Table(filter.bounding(plan)))


def violations(plan: records.Plan) -> int:
    """Codes of engine event outside those at the solved level plus and minus its bound."""
    part = _part(plan)
    s, full = part.s, plan.timing.code_max
    level = part.columns[bounds.LEVEL] - part.columns[bounds.BEGIN] - s.shift
    packet = np.broadcast_to(part.columns[bounds.PACKET], level.shape)
    error = np.minimum(s.error, 1e6)
    least, most = (
        np.minimum(_counts(s.x, plan.timing.gate_clocks, level + sign * error, packet), full)
        for sign in (1.0, -1.0)
    )
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


def names() -> list[str]:
    """Effects with a bound, without those whose largest random number is rare: their bounds are so many sigmas."""
    rare = ("ktc_noise", "flicker_noise", "thermal_noise", "shot_noise", "clock_jitter")
    return [
        n for n, effect in effects.EFFECTS.items() if effect.bound is not bounds.honoured and n not in rare
    ]


def caught(name: str, tries: int = TRIES) -> int | None:
    """Return the number of the first scene in which the halved bound of an effect gives a wrong code, or None."""
    with halved(name):
        return next((trial for trial in range(tries) if wrong(name, trial)), None)


def mutants(tries: int = TRIES) -> tuple[dict[str, int], list[str]]:
    """Return the scene by effect whose halved bound was caught, and the effects of which none was."""
    found = {name: caught(name, tries) for name in names()}
    return {n: t for n, t in found.items() if t is not None}, [n for n, t in found.items() if t is None]
