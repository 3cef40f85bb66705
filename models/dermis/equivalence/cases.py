# SPDX-License-Identifier: Apache-2.0
"""Columns through the closed loop in processes, each once: what one showed is kept by the content of its deck."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dermis import design as design_module
from dermis import ngspice, workers
from dermis.characterise import runs
from dermis.characterise.benches import Condition
from dermis.design import ROOT
from dermis.equivalence import gate, loop
from dermis.equivalence.extract import TOPOLOGIES
from dermis.equivalence.gate import Case
from dermis.equivalence.loop import Slot
from dermis.kept import Kept

WORK = ROOT / "build" / "equivalence"

CONDITIONS = (
    Condition("tt", 27.0),
    Condition("ss", -40.0),
    Condition("ff", 125.0),
    Condition("sf", 27.0),
    Condition("fs", 27.0),
)
"""What is extracted: typical, both ends of speed at the temperature that makes them worse, both skews."""

RANGES = (80, 20, 40, 160)

_OPEN_S, _CLOCK_S = 120.0, 1.0
"""Limit of a column: its operating point, and each of its clocks, thirty times what they take on an idle core."""


def everything() -> list[Case]:
    """The columns of the gate: every channel at k = 80 and every range of Fig. 5a at three corners, the skews once."""
    first = [Case(topology, 80, at) for at in CONDITIONS[:3] for topology in TOPOLOGIES]
    first += [Case("conveyor_mirror", 80, at) for at in CONDITIONS[3:]]
    ranges = [Case("conveyor_mirror", k, at) for at in CONDITIONS[:3] for k in RANGES if k != 80]
    return first + ranges


def limit_s(case: Case) -> float:
    """Wall clock that a column may take."""
    return _OPEN_S + _CLOCK_S * case.clocks * len(case.codes)


def _pack(slots: Sequence[Slot]) -> list[dict[str, Any]]:
    return [
        {
            "comparator": "".join("01"[bool(b)] for b in s.comparator),
            "bits": "".join("01"[bool(b)] for b in s.bits),
            "stored_v": [round(float(v), 9) for v in s.stored_v],
        }
        for s in slots
    ]


def _unpack(packed: Sequence[dict[str, Any]]) -> list[Slot]:
    def flags(text: str) -> np.ndarray:
        return np.array([c == "1" for c in text])

    return [Slot(flags(p["comparator"]), flags(p["bits"]), np.array(p["stored_v"])) for p in packed]


def simulate(case: Case, blocks: Path | None, log: Path) -> list[dict[str, Any]]:
    """A column in this process, which ngspice wants for itself."""
    return _pack(gate.transistor_slots(case, design_module.load(), log, blocks))


def stamp() -> str:
    """Of what decides about a column besides its deck: who steps ngspice, and how."""
    files = (Path(loop.__file__), ngspice.SOURCE, Path(ngspice.__file__))
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:16]


def _name(case: Case, blocks: Path | None) -> str:
    design = design_module.load()
    deck = loop.deck_of(
        case.topology, case.k, gate.resistances(case, design).tolist(), case.condition, design, blocks
    )
    return runs.key("\n".join(deck.lines)) + f"_{case.clocks}"


def shown(
    asked: Sequence[tuple[Case, Path | None]],
    jobs: int,
    tell: Callable[[int], None] = lambda done: None,
    fresh: bool = False,
) -> list[list[Slot] | str]:
    """What columns show, in the order in which they are asked for; a text where one was not measured says why.

    Parameters
    ----------
    asked : columns, each of spice/sky130 or of a changed copy
    jobs : processes at a time
    tell : called with how many are done
    fresh : run those that are kept as well
    """
    kept = Kept(WORK / "columns.json", stamp())
    names = [_name(*one) for one in asked]
    todo = [n for n, name in enumerate(names) if fresh or name not in kept.pieces]
    found: dict[int, str] = {}
    tell(len(asked) - len(todo))
    tasks = (
        workers.Task(simulate, (*asked[n], WORK / "logs" / f"{names[n]}.log"), limit_s(asked[n][0]))
        for n in todo
    )
    for done, (number, outcome) in enumerate(workers.run(tasks, jobs, fresh=True), 1):
        n = todo[number]
        if outcome.fault:
            found[n] = outcome.fault
        else:
            kept.put(names[n], outcome.value)
        tell(len(asked) - len(todo) + done)
    return [found[n] if n in found else _unpack(kept.pieces[name]) for n, name in enumerate(names)]


def full(case: Case) -> Case:
    """The same column with a gate of the chip's own length."""
    return dataclasses.replace(case, clocks=design_module.load().timing.gate_clocks)
