# SPDX-License-Identifier: Apache-2.0
"""Columns through the closed loop in processes, each once: records are stored under the hash of their deck."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dermis.chip import ngspice
from dermis.chip.ngspice import Deck
from dermis.scene import design as design_module
from dermis.scene.design import ROOT, TOPOLOGIES
from scripts import workers
from scripts.characterise import runs
from scripts.characterise.benches import Condition
from scripts.checkpoint import Checkpoint
from tb.programs.equivalence import gate, loop
from tb.programs.equivalence.gate import Case
from tb.programs.equivalence.loop import Slot

WORK = ROOT / "build" / "equivalence"

CONDITIONS = (
    Condition("tt", 27.0),
    Condition("ss", -40.0),
    Condition("ff", 125.0),
    Condition("sf", 27.0),
    Condition("fs", 27.0),
)
"""Extracted conditions: typical, slow and fast at their worse temperature, both skews."""

RANGES = (80, 20, 40, 160)

_SHOWN = "slots"
"""Key of the record in the file of a column."""

_OPEN_S, _CLOCK_S = 120.0, 1.0
"""Time limits of a column: operating point and clock, thirty times those on an idle core."""


def everything() -> list[Case]:
    """Return the columns of the gate.

    Every channel at k = 80 and every range of Fig. 5a at three corners, both supplies and both ends of resistors and
    capacitors there, the skews once; at typical some draws of the mismatch.
    """
    first = [Case(topology, 80, at) for at in CONDITIONS[:3] for topology in TOPOLOGIES]
    first += [Case("conveyor_mirror", 80, at) for at in CONDITIONS[3:]]
    ranges = [Case("conveyor_mirror", k, at) for at in CONDITIONS[:3] for k in RANGES if k != 80]
    supplies = [
        Case("conveyor_mirror", 80, dataclasses.replace(at, supply=s))
        for at in CONDITIONS[:3]
        for s in (0.9, 1.1)
    ]
    passives = [
        Case("conveyor_mirror", 80, dataclasses.replace(at, corner=f"{at.corner}_{end}"))
        for at in CONDITIONS[:3]
        for end in ("low", "high")
    ]
    typical = CONDITIONS[0]
    draws = [Case("conveyor_mirror", 80, dataclasses.replace(typical, sample=n)) for n in range(1, 6)]
    draws += [Case("direct", 80, dataclasses.replace(typical, sample=n)) for n in range(1, 3)]
    return first + ranges + supplies + passives + draws


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


@dataclasses.dataclass(frozen=True)
class Column:
    """A column to run.

    Attributes
    ----------
    deck : in one piece
    clocks : decisions of each row
    sign : of the integrator's voltage over the stored charge
    """

    deck: Deck
    clocks: int
    sign: float = -1.0

    @property
    def name(self) -> str:
        """Of its record and log."""
        return runs.key("\n".join(self.deck.lines)) + f"_{self.clocks}"

    @property
    def limit_s(self) -> float:
        """Wall clock that it may take."""
        return _OPEN_S + _CLOCK_S * self.clocks * (len(self.deck.sources) - 2)


def simulate(column: Column, log: Path) -> list[dict[str, Any]]:
    """A column in this process, which ngspice wants for itself."""
    log.parent.mkdir(parents=True, exist_ok=True)
    os.chdir(log.parent)  # the transistor model writes a file in its working directory
    return _pack(loop.column(column.deck, column.clocks, column.sign, design_module.load(), log))


def stamp() -> str:
    """Return the digest of the code that steps ngspice, which decides about a column besides its deck."""
    files = (Path(loop.__file__), ngspice.SOURCE, Path(ngspice.__file__))
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:16]


def deck(case: Case, blocks: Path | None = None) -> Deck:
    """Return the deck of a case in one piece, so that the hashed deck is the one that runs."""
    design = design_module.load()
    ohm = gate.resistances(case, design).tolist()
    return whole(loop.deck_of(case.topology, case.k, ohm, case.condition, design, blocks))


def whole(made: Deck) -> Deck:
    """Return a deck in one piece."""
    text = runs.resolved("\n".join((*made.lines, ".end")))
    return dataclasses.replace(made, lines=tuple(line for line in text.splitlines() if line != ".end"))


def shown(
    asked: Sequence[tuple[Case, Path | None]],
    jobs: int,
    tell: Callable[[int], None] = lambda done: None,
    fresh: bool = False,
    work: Path = WORK,
) -> list[list[Slot] | str]:
    """Return the records of cases, each of spice/sky130 or of a changed copy; the rest as in `records`."""
    signs = {"conveyor_mirror_inverted": 1.0}
    columns = [Column(deck(*one), one[0].clocks, signs.get(one[0].topology, -1.0)) for one in asked]
    return records(columns, jobs, tell, fresh, work)


def records(
    columns: Sequence[Column],
    jobs: int,
    tell: Callable[[int], None] = lambda done: None,
    fresh: bool = False,
    work: Path = WORK,
) -> list[list[Slot] | str]:
    """Return the records of columns in order; a text is the reason for a missing one.

    Parameters
    ----------
    columns : what to run
    jobs : processes at a time
    tell : called with how many are done
    fresh : run those that are kept as well
    work : folder that keeps one file a column, so that commands share them
    """
    names = [column.name for column in columns]
    kept = [Checkpoint(work / "columns" / f"{name}.json", stamp(), fresh=fresh) for name in names]
    todo = [n for n, own in enumerate(kept) if _SHOWN not in own.pieces]
    found: dict[int, str] = {}
    tell(len(columns) - len(todo))
    tasks = (
        workers.Task(simulate, (columns[n], work / "logs" / f"{names[n]}.log"), columns[n].limit_s)
        for n in todo
    )
    for done, (number, outcome) in enumerate(workers.run(tasks, jobs, fresh=True), 1):
        n = todo[number]
        if outcome.fault:
            found[n] = outcome.fault
        else:
            kept[n].put(_SHOWN, outcome.value)
        tell(len(columns) - len(todo) + done)
    return [found[n] if n in found else _unpack(own.pieces[_SHOWN]) for n, own in enumerate(kept)]


def full(case: Case) -> Case:
    """The same column with a gate of the chip's own length."""
    return dataclasses.replace(case, clocks=design_module.load().timing.gate_clocks)
