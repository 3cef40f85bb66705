# SPDX-License-Identifier: Apache-2.0
"""The command as a user calls it, and a look at which processes are left."""

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from dermis.effects import EFFECTS
from dermis.records import Plan
from dermis.scene.design import ROOT

MakePlan = Callable[..., Plan]
FaultyChip = Callable[[str, str, str], None]

UNIT_OHM = 250.0
"""V_b / (k i0), so that x = 250 ohm / R."""

RANDOM = {name for name, effect in EFFECTS.items() if effect.random}
SENSOR = {name for name in EFFECTS if name.startswith("sensor_")}
OF_THE_CHIP = [name for name in EFFECTS if name not in RANDOM | SENSOR]
"""Effects of a deck: no random numbers, and the sensor sheet is not in it."""


def of_codes(codes: np.ndarray) -> np.ndarray:
    """Resistances with x = c / 510 exactly."""
    with np.errstate(divide="ignore"):
        return UNIT_OHM * 510 / np.asarray(codes, dtype=float)


def scene_of(on: Mapping[str, object]) -> str:
    """Effects as a scene has them: tables of numbers, true or false."""

    def text(value: object) -> str:
        if isinstance(value, Mapping):
            return "{ " + ", ".join(f"{key} = {number!r}" for key, number in value.items()) + " }"
        return str(value).lower()

    return "\n".join(f"{name} = {text(value)}" for name, value in on.items())


def effects_of(topology: str) -> dict[str, object]:
    """Every effect of the chip that a topology has, as its example."""
    chosen = (EFFECTS[name] for name in OF_THE_CHIP)
    return {e.name: e.example(topology) for e in chosen if topology in e.topologies}


def dermis(*arguments: str, limit_s: float = 120, **options: object) -> subprocess.CompletedProcess[str]:
    """Call the command line in a process of its own."""
    command = [sys.executable, "-m", "dermis", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=limit_s, cwd=ROOT, **options)


def processes_with(text: str) -> list[int]:
    """Processes, other than this one, whose command or environment holds a text."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            said = (entry / "cmdline").read_bytes() + (entry / "environ").read_bytes()
            state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
        # The process has ended meanwhile.
        except OSError:
            continue
        if text.encode() in said and state != "Z":
            found.append(int(entry.name))
    return found
