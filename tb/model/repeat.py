# SPDX-License-Identifier: Apache-2.0
"""Runs scenes and prints a digest of every number that comes out: equal in every process that runs them, or a defect.

.venv/bin/python tb/model/repeat.py SCENE[:ENGINE] ... prints one JSON object, scene to digest.
"""

import hashlib
import itertools
import json
import sys

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.decode import force
from dermis.records import Plan
from dermis.scene import scene

FRAMES = 24  # of a scene: enough for cuts at every place that matters, few enough for a second a scene


def numbers(made: Plan) -> dict[str, NDArray]:
    """All arrays of a run, the resistances behind it and the forces decoded from it, by name."""
    result = engines.run(made)
    decoded = force.decode(made, result.codes)
    arrays = {"ohm": made.resistance_ohm, "codes": result.codes}
    arrays |= {"force_n": decoded.force_n} | result.info
    return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}


def joined(made: Plan, cuts: list[int]) -> dict[str, NDArray]:
    """The same, from parts that end at `cuts`, as processes or machines run them (dermis.engines.batch)."""
    edges = [0, *cuts, made.frames]
    parts = [numbers(made.part(first, stop)) for first, stop in itertools.pairwise(edges)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def digest(arrays: dict[str, NDArray]) -> str:
    """Hash of arrays, bit by bit."""
    told = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        told.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return told.hexdigest()


def load(name: str) -> Plan:
    """The first frames of a scene, `stem` or `stem:engine`."""
    stem, _, engine = name.partition(":")
    made = plan.load(scene.find(stem), engine or None)
    engines.check(made)
    return made.part(0, min(FRAMES, made.frames))


if __name__ == "__main__":
    print(json.dumps({name: digest(numbers(load(name))) for name in sys.argv[1:]}))
