# SPDX-License-Identifier: Apache-2.0
"""Search for wrong codes of `auto` over onsets and over pairs and triples of effects.

The random scenes of the campaign turn many effects on at moderate strengths. A bound that forgets another effect, or
the current before the gate, shows where few effects are strong and taxels change from open to pressed. Each scene here
has one to four effects at strengths up to a decade beyond their range and many frames of few taxels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import bounds, effects, engines
from dermis import plan as planning
from dermis.engines import event, filter
from dermis.errors import InputError, SimulatorError
from dermis.records import Plan
from dermis.scene import scene, schema
from dermis.scene.design import TOPOLOGIES

FRAMES = 192
"""Frames of a scene."""

KINDS = ("onset", "pairs")
"""Scenes with motion between open and pressed taxels, and scenes of several effects."""


def scene_of(kind: str, seed: int, number: int) -> Plan:
    """Return scene `number` of a kind as a plan with auto; raises InputError where no engine takes it."""
    rng = np.random.default_rng([*f"{kind} {seed}".encode(), number])
    topology = str(rng.choice(TOPOLOGIES))
    rows, cols = (int(n) for n in rng.integers(1, [6, 5]))
    data = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "interface": {"topology": topology},
        "effects": _effects(kind, rng, topology),
    }
    path = Path(f"{kind}_{number}.toml")
    table = schema.validate(scene.SceneTable, data, path)
    interface = scene.resolve(table, path).table.interface
    unit_ohm = interface.v_bias_v / (interface.k * interface.i0_a)
    ohm = _ohm(rng, (FRAMES, rows, cols), unit_ohm)
    world = scene.resolve(table.model_copy(update={"stimulus": table.stimulus.given(ohm)}), path)
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


def _ohm(rng: np.random.Generator, shape: tuple[int, ...], unit_ohm: float) -> NDArray[np.float64]:
    """Return resistances [frames, rows, cols]: open and pressed in turn, near steps of the code, or anything."""
    steps = rng.integers(0, 257, shape) + rng.normal(0.0, rng.choice([1e-6, 1e-3, 0.1]), shape)
    duty = np.where(rng.random(shape) < 0.5, (steps + 0.5) / 510.0, 10.0 ** rng.uniform(-4.0, 0.3, shape))
    opened = rng.random(shape) < 0.3
    if rng.random() < 0.5:  # every second frame pressed
        opened[:: 2 if rng.random() < 0.5 else 3] = True
    light = 10.0 ** rng.uniform(-9.0, -3.0, shape) * (rng.random(shape) < 0.5)
    with np.errstate(divide="ignore"):
        return unit_ohm / np.maximum(np.where(opened, light, duty), 0.0)


def run_scene(kind: str, seed: int, number: int) -> dict[str, int]:
    """Compare the codes of `auto` with engine event in one scene; returns counts by name."""
    counts = {"scenes": 1, "refused": 0, "codes": 0, "wrong": 0}
    try:
        plan = scene_of(kind, seed, number)
        engines.check(plan)
        found, true = filter.run(plan).codes, event.run(plan).codes
    except (InputError, SimulatorError):
        return counts | {"refused": 1}
    return counts | {"codes": found.size, "wrong": int((found != true).sum())}
