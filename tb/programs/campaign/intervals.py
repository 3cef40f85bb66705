# SPDX-License-Identifier: Apache-2.0
"""`Skin` against `simulate`, and decoded intervals against the truth, over every effect that both accept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dermis
from dermis import effects, plan
from dermis.decode import decoder
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from dermis.skin import Skin

Floats = NDArray[np.float64]

KINDS = ("offset", "light", "full", "short", "any")
"""Scenes with column offsets, touches of a few counts, taxels beyond full scale, shorted taxels and rows, and any."""

FRAMES = 8
FLAGGED = decoder.SATURATED | decoder.SHORT | decoder.UNSOLVED | decoder.NEAR_SATURATED


def scene_of(kind: str, rng: np.random.Generator) -> tuple[dict[str, Any], Floats]:
    """Return a scene and forces [frames, rows, cols] in newtons, inf for a short."""
    rows, cols = (int(n) for n in rng.choice([[16, 16], [8, 8], [5, 12], [16, 3]]))
    on: dict[str, Any] = {}
    for name, effect in effects.EFFECTS.items():
        chance = 0.9 if name in ("row_driver", "column_input", "lateral") else 0.15
        if rng.random() < chance and _decodes(name):
            on[name] = True if rng.random() < 0.4 else effect.draw(rng)
    if kind in ("offset", "light"):
        on["column_offset"] = {"v_v": (rng.uniform(-2e-3, 2e-3, cols)).tolist()}
    force = rng.uniform(0.0, 6.0, (FRAMES, rows, cols)) * (rng.random((FRAMES, rows, cols)) < 0.5)
    if kind == "light":
        force = rng.uniform(0.0, 0.5, force.shape) * (rng.random(force.shape) < 0.3)
    if kind == "full":
        force = np.where(rng.random(force.shape) < 0.1, rng.uniform(10.0, 55.0, force.shape), force)
        on["comparator_offset"] = {"v_v": float(rng.uniform(-0.3, 0.4))}
        on["preset_error"] = {"v_v": float(rng.uniform(-0.2, 0.2))}
        on["charge_packet"] = {"packet_error": float(rng.uniform(-0.05, 0.05))}
    if kind == "short":
        # A shorted row and a shorted taxel of another one leave every code below full scale (docs/decode.md).
        col = slice(None) if rng.random() < 0.3 else int(rng.integers(cols))
        force[:, rng.integers(rows), col] = np.inf
    return {"array": {"rows": rows, "cols": cols}, "effects": on}, force


def _decodes(name: str) -> bool:
    effect = effects.EFFECTS[name]
    return effect.bound is effects.bounds.honoured and not name.startswith("sensor_") and name != "motion"


def run_scene(kind: str, seed: int, number: int) -> dict[str, int]:
    """Compare one scene; returns counts: codes, wrong ones, cells that are not flagged, and those beyond theirs."""
    rng = np.random.default_rng([*f"{kind} {seed}".encode(), number])
    world, force = scene_of(kind, rng)
    counts = {"scenes": 1, "refused": 0, "codes": 0, "wrong": 0, "cells": 0, "missed": 0}
    try:
        data = world | {"stimulus": {"kind": "uniform", "force_n": 0.0}}
        skin = Skin(plan.make(scene.from_data(data, Path("intervals.toml")), "closed"))
        with np.errstate(divide="ignore"):
            ohm = np.where(np.isinf(force), 0.0, skin.plan.sensor.resistance_ohm(np.minimum(force, 1e6)))
        codes = dermis.simulate(world, resistance_ohm=ohm, engine="closed").codes
    except (InputError, SimulatorError):
        return counts | {"refused": 1}
    finite = np.isfinite(force)
    if finite.all():
        counts["wrong"] = int((skin.read(force) != codes).sum())
        counts["codes"] = codes.size
    found = skin.decode(codes)
    kept = (found.flags & FLAGGED == 0) & finite
    # Roundings of the law at the edge of a code.
    inside = (found.low_n <= force * (1 + 1e-9)) & (force * (1 - 1e-9) <= found.high_n)
    counts["cells"], counts["missed"] = int(kept.sum()), int((kept & ~inside).sum())
    return counts
