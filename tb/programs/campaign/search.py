# SPDX-License-Identifier: Apache-2.0
"""The standing searches of a campaign: `auto` against event, `Skin` against simulate, intervals against the truth."""

from dataclasses import replace
from typing import Any

import numpy as np

import dermis
from dermis import bounds, effects, engines
from dermis import plan as planning
from dermis.decode import decoder
from dermis.engines import event, filter
from dermis.errors import InputError, SimulatorError
from dermis.ndarrays import Floats
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES
from dermis.skin import Skin
from tb.reference import scenes

# The random scenes of the campaign turn many effects on at moderate strengths. A bound that forgets another effect, or
# the current before the gate, shows where few effects are strong and taxels change from open to pressed. Each scene
# has one to four effects at strengths up to a decade beyond their range and many frames of few taxels.
FILTER_KINDS, FILTER_FRAMES = ("onset", "pairs"), 192
"""Scenes with motion between open and pressed taxels, and scenes of several effects."""


def onset_or_pairs(kind: str, seed: int, number: int) -> Plan:
    """Return scene `number` of a kind as a plan with auto; raises InputError where no engine takes it."""
    rng = np.random.default_rng([*f"{kind} {seed}".encode(), number])
    topology = str(rng.choice(TOPOLOGIES))
    shape = (FILTER_FRAMES, *(int(n) for n in rng.integers(1, [6, 5])))
    on = _effects(kind, rng, topology)
    with np.errstate(divide="ignore"):
        ohm = scenes.unit_ohm({}) / _duties(rng, shape)
    world = scenes.of_resistances(ohm, on, {"topology": topology}, f"{kind}_{number}")
    return replace(planning.make(world, "event"), filtered=True, seed=number)


def _effects(kind: str, rng: np.random.Generator, topology: str) -> dict[str, Any]:
    there = [e for e in effects.EFFECTS.values() if topology in e.topologies and e.considered]
    bounded = [e for e in there if e.bound is not bounds.honoured]
    honoured = [e for e in there if e.bound is bounds.honoured]
    chosen = [bounded[i] for i in rng.choice(len(bounded), int(rng.integers(1, 4)), replace=False)]
    if rng.random() < 0.5:
        chosen.append(honoured[int(rng.integers(len(honoured)))])
    on: dict[str, Any] = {}
    for effect in chosen:
        on |= {name: dict(value) for name, value in effect.needs.items() if name not in on}
        try:
            strength = None if rng.random() < 0.3 else effect.draw(rng, float(rng.random() < 0.5))
            on[effect.name] = strength or True
        except KeyError:
            on[effect.name] = True
    slow = effects.EFFECTS["mirror_lag"]
    if kind == "onset":
        on["motion"] = True
        if topology in slow.topologies and rng.random() < 0.7:
            on["mirror_lag"] = slow.draw(rng, 1.0)
    elif rng.random() < 0.5:
        on["motion"] = True
    return on


def _duties(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Return duties [frames, rows, cols]: open and pressed in turn, near steps of the code, or anything."""
    steps = rng.integers(0, 257, shape) + rng.normal(0.0, rng.choice([1e-6, 1e-3, 0.1]), shape)
    duty = np.where(rng.random(shape) < 0.5, (steps + 0.5) / 510.0, 10.0 ** rng.uniform(-4.0, 0.3, shape))
    opened = rng.random(shape) < 0.3
    if rng.random() < 0.5:  # every second frame pressed
        opened[:: 2 if rng.random() < 0.5 else 3] = True
    light = 10.0 ** rng.uniform(-9.0, -3.0, shape) * (rng.random(shape) < 0.5)
    return np.maximum(np.where(opened, light, duty), 0.0)


def filter_counts(kind: str, seed: int, number: int) -> dict[str, int]:
    """Compare the codes of `auto` with engine event in one scene; returns counts by name."""
    counts = {"refused": 0, "codes": 0, "wrong": 0}
    try:
        made = onset_or_pairs(kind, seed, number)
        engines.check(made)
        found, true = filter.run(made).codes, event.run(made).codes
    except (InputError, SimulatorError):
        return counts | {"refused": 1}
    return counts | {"codes": found.size, "wrong": int((found != true).sum())}


SKIN_KINDS, SKIN_FRAMES = ("offset", "light", "full", "short", "any"), 8
"""Scenes with column offsets, touches of a few counts, taxels beyond full scale, shorted taxels and rows, and any."""

DYNAMIC = {"motion", *(name for name in effects.EFFECTS if name.startswith("sensor_"))}
FLAGGED = decoder.SATURATED | decoder.SHORT | decoder.UNSOLVED | decoder.NEAR_SATURATED


def sheet(kind: str, rng: np.random.Generator) -> tuple[dict[str, Any], Floats]:
    """Return a scene and forces [frames, rows, cols] in newtons, inf for a short."""
    rows, cols = (int(n) for n in rng.choice([[16, 16], [8, 8], [5, 12], [16, 3]]))
    on: dict[str, Any] = {}
    for name, effect in effects.EFFECTS.items():
        chance = 0.9 if name in ("row_driver", "column_input", "lateral") else 0.15
        if rng.random() < chance and effect.bound is bounds.honoured and name not in DYNAMIC:
            on[name] = True if rng.random() < 0.4 else effect.draw(rng)
    if kind in ("offset", "light"):
        on["column_offset"] = {"v_v": (rng.uniform(-2e-3, 2e-3, cols)).tolist()}
    force = rng.uniform(0.0, 6.0, (SKIN_FRAMES, rows, cols)) * (rng.random((SKIN_FRAMES, rows, cols)) < 0.5)
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


def skin_counts(kind: str, seed: int, number: int) -> dict[str, int]:
    """Compare one scene; returns counts: codes, wrong ones, cells that are not flagged, and those beyond theirs."""
    rng = np.random.default_rng([*f"{kind} {seed}".encode(), number])
    world, force = sheet(kind, rng)
    counts = {"refused": 0, "codes": 0, "wrong": 0, "cells": 0, "missed": 0}
    try:
        skin = Skin(world)
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
    counts["cells"], counts["missed"] = int(kept.sum()), int((kept & ~found.holds(force)).sum())
    return counts


SEARCHES = dict.fromkeys(FILTER_KINDS, filter_counts) | dict.fromkeys(SKIN_KINDS, skin_counts)
"""Compares one scene of a kind: called with the kind, a seed and a number."""
