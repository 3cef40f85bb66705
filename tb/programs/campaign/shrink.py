# SPDX-License-Identifier: Apache-2.0
"""Makes a world that breaks a law as small and as plain as it gets, one change at a time."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dermis.errors import DermisError
from tb.programs.campaign import trial
from tb.programs.campaign.world import Data, World, lines_of, size


def shrink(world: World, engines: str, seed: int, law: str, limit_s: float) -> World:
    """The smallest world found within `limit_s` seconds that breaks the law as `world` does.

    Greedy: of all changes that make it smaller the first that still breaks the law is taken, until none does. An
    exception must stay the same exception.
    """
    until = time.monotonic() + limit_s
    kind = _kind(world, engines, seed, law)
    if kind is None:
        return world
    tried: set[str] = set()
    moves = True
    while moves:
        moves = False
        for candidate in _candidates(world):
            if time.monotonic() > until:
                return world
            text = candidate.to_toml()
            if text in tried or not size(candidate) < size(world):
                continue
            tried.add(text)
            if _kind(candidate, engines, seed, law) == kind:
                world, moves = candidate, True
                break
    return world


def _kind(world: World, engines: str, seed: int, law: str) -> str | None:
    only = None if law == "typed_errors" else [law]
    try:
        broken = trial.run(world, engines, seed, only).broken
    except DermisError:  # the candidate is no scene at all
        return None
    what = next((b.what for b in broken if b.law == law), None)
    # Of an exception its name and place, of a law that is broken that it is.
    return None if what is None else (what.split(":")[0] if "Error" in what.split(":")[0] else "broken")


def _candidates(world: World) -> Iterator[World]:
    scene = world.scene
    if scene["stimulus"]["kind"] != "resistance" or "sensor" in scene:
        plain = _as_resistances(world)
        if plain is not None:
            yield plain
    if world.design:
        yield replace(world, design={})
        for section in world.design:
            yield replace(world, design={k: v for k, v in world.design.items() if k != section})
    on = scene.get("effects", {})
    for half in (list(on)[: len(on) // 2], list(on)[len(on) // 2 :]):
        if len(on) > 3:
            yield _with(world, "effects", {k: on[k] for k in half})
    for name in on:
        yield _with(world, "effects", {k: v for k, v in on.items() if k != name})
    for key in scene.get("interface", {}):
        yield _with(world, "interface", {k: v for k, v in scene["interface"].items() if k != key})
    yield from _fewer_taxels(world)
    for name, table in on.items():
        if isinstance(table, dict) and name != "auto":
            yield _with(world, "effects", on | {name: True})
            for key, value in table.items():
                rest = {k: v for k, v in table.items() if k != key}
                yield _with(world, "effects", on | {name: rest})
                for plainer in _plainer(value):
                    yield _with(world, "effects", on | {name: table | {key: plainer}})
    for key, value in scene.get("interface", {}).items():
        for plainer in _plainer(value):
            yield _with(world, "interface", scene["interface"] | {key: plainer})
    for name, lines in world.files.items():
        for digits in (1, 2, 4):
            rounded = [[_rounded(v, digits) for v in line] for line in lines]
            yield replace(world, files={**world.files, name: rounded})
        for r, line in enumerate(lines):
            for c, value in enumerate(line):
                for plainer in (math.inf, 1e3, *_plainer(value)):
                    changed = [list(other) for other in lines]
                    changed[r][c] = float(plainer)
                    yield replace(world, files={**world.files, name: changed})
    if scene.get("run"):
        yield _with(world, "run", {})


def _with(world: World, section: str, table: Data) -> World:
    scene = {k: v for k, v in world.scene.items() if k != section}
    return replace(world, scene=scene | {section: table} if table else scene)


def _plainer(value: Any) -> list[Any]:
    if isinstance(value, list):
        return [value[0]]
    if isinstance(value, float) and value and math.isfinite(value):
        return [_rounded(value, 1), _rounded(value, 2), _rounded(value, 4)]
    return []


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}")


def _as_resistances(world: World) -> World | None:
    """The same resistances from a file, without what made them."""
    with tempfile.TemporaryDirectory() as directory:
        try:
            ohm = world.plan(Path(directory), "event").resistance_ohm
        except Exception:  # it cannot be planned, which may be what it breaks
            return None
    scene = {k: v for k, v in world.scene.items() if k not in ("sensor", "stimulus", "effects")}
    on = {k: v for k, v in world.scene.get("effects", {}).items() if not k.startswith("sensor_")}
    scene |= {"stimulus": {"kind": "resistance", "file": "taxels.csv"}, "effects": on}
    return replace(world, scene=scene, files={"taxels.csv": lines_of(ohm)})


def _fewer_taxels(world: World) -> Iterator[World]:
    if world.scene["stimulus"].get("file") != "taxels.csv":
        return
    rows, cols = world.scene["array"]["rows"], world.scene["array"]["cols"]
    ohm = np.array(world.files["taxels.csv"]).reshape(-1, rows, cols)
    for axis, count in enumerate(ohm.shape):
        halves = [range(count // 2), range(count // 2, count)] if count > 2 else []
        singles = [[i for i in range(count) if i != gone] for gone in range(count)]
        for kept in [list(h) for h in halves] + singles:
            if kept:
                yield _taken(world, ohm, axis, kept)


def _taken(world: World, ohm: np.ndarray, axis: int, kept: list[int]) -> World:
    fewer = np.take(ohm, kept, axis)
    scene = dict(world.scene) | {"array": {"rows": fewer.shape[1], "cols": fewer.shape[2]}}
    if axis == 2:  # lists of one value a column
        scene["effects"] = {
            name: {k: [v[i] for i in kept] if isinstance(v, list) else v for k, v in table.items()}
            if isinstance(table, dict)
            else table
            for name, table in scene.get("effects", {}).items()
        }
    return replace(world, scene=scene, files={"taxels.csv": lines_of(fewer)})
