# SPDX-License-Identifier: Apache-2.0
"""What is fuzzed: a target makes seeds, mutates them, and runs one input under the oracles."""

from __future__ import annotations

import importlib
import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

GUIDES: dict[str, tuple[str, ...]] = {
    "scene": (
        "dermis.scene.scene",
        "dermis.scene.schema",
        "dermis.errors",
        "dermis.scene.stimulus",
        "dermis.scene.sensor",
        "dermis.effects",
        "scripts.effect_tables",
        "dermis.plan",
        "dermis.chip.netlist",
        "dermis.chip.spice_text",
        "tomllib._parser",
    ),
    "frames": (
        "dermis.scene.stimulus",
        "dermis.scene.schema",
        "dermis.errors",
        "numpy.lib.format",
        "zipfile",
    ),
    "spi": ("dermis.chip.spi_protocol",),
    "registers": (
        "tb.reference.chip",
        "dermis.chip.spi_protocol",
    ),
    "design": (
        "dermis.scene.design",
        "dermis.scene.schema",
        "scripts.generate",
        "dermis.scene.scene",
        "dermis.errors",
    ),
    "command": (
        "dermis.cli",
        "dermis.scene.scene",
        "dermis.report.plan_table",
        "scripts.regression",
        "scripts.calculator",
        "dermis.report.output",
        "dermis.errors",
    ),
}
"""Target -> the modules of which the covered lines are told; the branches of all of the package guide the mutations."""

NAMES = tuple(GUIDES)


class Run(Protocol):
    """One input: bytes, and a directory in which it may do what its target lets it."""

    def __call__(self, data: bytes, place: Path) -> str:
        """Return "taken" or "refused", or raise Finding."""


@dataclass(frozen=True)
class Target:
    """Something that takes input from outside.

    Attributes
    ----------
    name : one of `NAMES`
    what : in a few words, for the table
    seeds : the first inputs
    mutate : (input, random numbers) -> another input
    prepare : called once in a process with the directory of its inputs, before memory is limited
    run : one input under the oracles
    """

    name: str
    what: str
    seeds: Any
    mutate: Any
    prepare: Any
    run: Run


def load(name: str) -> Target:
    """The target of a name."""
    found: Target = importlib.import_module(f"tb.programs.fuzz.{name}_target").TARGET
    return found


def short(target: Target, place: Path, inputs: int, seed: int) -> dict[str, int]:
    """Run so many inputs, seeds first, without guidance: the same inputs for one seed on every machine.

    Returns
    -------
    dict
        How many were "taken" and "refused".

    Raises
    ------
    Finding
        The first one.
    """
    rng = random.Random(f"{target.name} {seed}")
    seeds = target.seeds()
    counts = {"taken": 0, "refused": 0}
    for n in range(inputs):
        data = seeds[n] if n < len(seeds) and n % 2 == 0 else rng.choice(seeds)
        for _ in range(rng.choice((1, 1, 2, 4)) if n % 2 else 0):
            data = target.mutate(data, rng)
        counts[target.run(data, place)] += 1
    return counts
