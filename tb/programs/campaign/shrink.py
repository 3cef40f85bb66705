# SPDX-License-Identifier: Apache-2.0
"""Make a world that breaks a law as small as possible, one change at a time."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tb.reference.scenes import World


def shrink(world: World, fails: Callable[[World], bool], limit_s: float) -> World:
    """Return the smallest world found within `limit_s` seconds for which `fails` holds.

    Greedy: of all smaller candidates the first that fails is taken, until none does.
    """
    until, tried = time.monotonic() + limit_s, {world.to_toml()}
    candidates = _candidates(world)
    while time.monotonic() < until and (candidate := next(candidates, None)):
        text = candidate.to_toml()
        if text not in tried and size(candidate) < size(world) and fails(candidate):
            world, candidates = candidate, _candidates(candidate)
        tried.add(text)
    return world


def size(value: Any) -> float:
    """Return how much there is to a world or a value: entries, and digits of numbers."""
    if isinstance(value, World):
        return size(value.scene) + size(value.design) + size(value.files)
    if isinstance(value, Mapping):
        return sum(3 + size(inner) for inner in value.values())
    if isinstance(value, list):
        return sum(1 + size(inner) for inner in value)
    if isinstance(value, float):
        return 0.02 * len(repr(value)) if math.isfinite(value) else 0.0
    return 1e-3 * math.log1p(abs(value)) if isinstance(value, int) else 0.0


def _candidates(world: World) -> Iterator[World]:
    if world.scene["stimulus"]["kind"] != "resistance" or "sensor" in world.scene:
        yield from _as_resistances(world)
    yield replace(world, design={})
    on = list(world.scene.get("effects", {}).items())
    for half in (on[: len(on) // 2], on[len(on) // 2 :]):
        yield replace(world, scene=world.scene | {"effects": dict(half)})
    yield from _fewer_taxels(world)
    for design in _simpler(world.design):
        yield replace(world, design=design)
    for name in ("effects", "interface", "run"):
        for table in _simpler(world.scene.get(name, {})):
            yield replace(world, scene=world.scene | {name: table})
    for name, lines in world.files.items():
        for digits in (1, 2, 4):
            yield replace(
                world, files=world.files | {name: [[_rounded(v, digits) for v in n] for n in lines]}
            )
        for r, line in enumerate(lines):
            for c, value in enumerate(line):
                for other in (math.inf, 1e3, *_simpler(value)):
                    changed = [*lines[:r], [*line[:c], other, *line[c + 1 :]], *lines[r + 1 :]]
                    yield replace(world, files=world.files | {name: changed})


def _simpler(value: Any) -> Iterator[Any]:
    """Yield simpler values: a table with an entry less or simpler, one number of a list, fewer
    digits.
    """
    if isinstance(value, Mapping):
        for name in value:
            yield {k: v for k, v in value.items() if k != name}
        for name, inner in value.items():
            for other in (
                *([True] if isinstance(inner, Mapping) and name != "auto" else []),
                *_simpler(inner),
            ):
                yield {**value, name: other}
    elif isinstance(value, list) and value:
        yield value[0]
    elif isinstance(value, float) and value and math.isfinite(value):
        yield from (_rounded(value, digits) for digits in (1, 2, 4))


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}")


def _as_resistances(world: World) -> Iterator[World]:
    """Yield the same resistances from a file, without the sensor that made them."""
    with tempfile.TemporaryDirectory() as directory:
        try:
            ohm = world.plan(Path(directory), "event").resistance_ohm
        except Exception:  # the scene cannot be planned, which may be its defect
            return
    scene = {k: v for k, v in world.scene.items() if k not in ("sensor", "stimulus")}
    on = {k: v for k, v in scene.get("effects", {}).items() if not k.startswith("sensor_")}
    scene |= {"stimulus": {"kind": "resistance", "file": "taxels.csv"}, "effects": on}
    yield replace(world, scene=scene, files={"taxels.csv": lines_of(ohm)})


def lines_of(frames: Any) -> list[list[float]]:
    """Return frames [frames, rows, cols] as lines of a csv file, one row a line."""
    return [[float(v) for v in row] for frame in frames for row in frame]


def _fewer_taxels(world: World) -> Iterator[World]:
    if world.scene["stimulus"].get("file") != "taxels.csv":
        return
    rows, cols = world.scene["array"]["rows"], world.scene["array"]["cols"]
    ohm = np.array(world.files["taxels.csv"]).reshape(-1, rows, cols)
    for axis, count in enumerate(ohm.shape):
        whole = list(range(count))
        for left in (whole[: count // 2], whole[count // 2 :], *(whole[:n] + whole[n + 1 :] for n in whole)):
            if 0 < len(left) < count:
                fewer = np.take(ohm, left, axis)
                scene = world.scene | {"array": {"rows": fewer.shape[1], "cols": fewer.shape[2]}}
                if axis == 2:
                    scene["effects"] = _columns(scene.get("effects", {}), left)
                yield replace(world, scene=scene, files={"taxels.csv": lines_of(fewer)})


def _columns(value: Any, left: list[int]) -> Any:
    """Keep some columns of the lists in a table."""
    if isinstance(value, Mapping):
        return {name: _columns(inner, left) for name, inner in value.items()}
    return [value[n] for n in left] if isinstance(value, list) else value
