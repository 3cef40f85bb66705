# SPDX-License-Identifier: Apache-2.0
"""Retries after ngspice gives up a circuit: an ordered ladder, each attempt reported, then advice.

If no operating point is found, the next method to *start* is tried; if a transient stops, the next
method to *step*. docs/ladder.md has the table, the reasons and a circuit for every rung.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

from dermis.errors import SimulatorError

T = TypeVar("T")
Phase = Literal["start", "steps"]


@dataclass(frozen=True)
class Rung:
    """A method to start, or to step; docs/ladder.md says what each may do to a result.

    Attributes
    ----------
    name : its name in reports
    options : text of an `.options` line after the deck's own, whose values it replaces; empty for none
    optran : ngspice's command for what it may do besides Newton's method for an operating point
    guess : Newton's method must confirm its operating point, as a nodeset
    """

    name: str
    options: str = ""
    optran: str = ""
    guess: bool = False


# optran: Newton first (or not), gmin steps, source steps, step, length and supply ramp of a hidden transient (0: none).
# In that of `ramp` supplies rise in 10 us and rest for 90 us.
START = (
    Rung("newton", optran="optran 1 0 0 0 0 0"),
    Rung("gmin_stepping", optran="optran 1 1 0 0 0 0"),
    Rung("source_stepping", optran="optran 1 0 1 0 0 0"),
    Rung("ramp", optran="optran 0 0 0 1e-07 0.0001 1e-05", guess=True),
)
"""Ways to an operating point, in the order in which they are tried."""

# Truncation control stays as the deck has it. A deck without a pole has it off (netlist.py): switched on, it looks at
# the node capacitors too, to reltol 1e-6 of chgtol, 1e-20 C, and no step passes an edge of an ideal comparator.
_NODES = "cshunt=1e-16"
STEPS = (Rung("plain"), Rung("capacitance", _NODES), Rung("gear", f"{_NODES} method=gear maxord=2"))
"""Ways to step, in the order of trials; none loosens a tolerance (docs/ladder.md)."""


@dataclass(frozen=True)
class Level:
    """Position of a circuit on the ladder: index of its start and of its steps."""

    start: int = 0
    steps: int = 0

    @property
    def name(self) -> str:
        """Its rungs that are not the first."""
        names = [r[i].name for r, i in ((START, self.start), (STEPS, self.steps)) if i]
        return " and ".join(names) or STEPS[0].name

    @property
    def option_lines(self) -> tuple[str, ...]:
        """Lines after those of the deck."""
        text = STEPS[self.steps].options
        return (f".options {text}",) if text else ()

    def above(self, phase: Phase) -> Level | None:
        """Return the next rung after a failure, or None."""
        start, steps = self.start + (phase == "start"), self.steps + (phase == "steps")
        return Level(start, steps) if start < len(START) and steps < len(STEPS) else None


PLAIN = Level()


class Abort(SimulatorError):
    """ngspice loaded a circuit and gave it up.

    Parameters
    ----------
    phase : "start" without an operating point, "steps" in a transient
    said : ngspice's own words, on one line
    time_s : simulated time, seconds
    node : node or device that ngspice names, or None
    log : where all that it said is
    """

    def __init__(
        self, phase: Phase, said: str, time_s: float, node: str | None, log: Path | str | None
    ) -> None:
        self.phase, self.said, self.time_s, self.node = phase, said, time_s, node
        super().__init__(f"ngspice at {time_s:.9g} s: {said}", log)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.phase, self.said, self.time_s, self.node, self.log)


@dataclass(frozen=True)
class Retry:
    """One failed attempt, as in results and summaries: its rung and the next one, None after the last."""

    rung: str
    next: str | None
    said: str
    time_s: float
    node: str | None

    def __str__(self) -> str:
        then = f"; again with {self.next} (docs/ladder.md)" if self.next else ""
        return f"at {self.time_s:.9g} s: {self.said}{then}"


class Climb:
    """The rungs that one circuit, `what` in reports ("frame 3"), has climbed from `level` on.

    `report` is given one line for every retry; by default it goes to standard error.
    """

    def __init__(self, what: str, level: Level = PLAIN, report: Callable[[str], None] | None = None) -> None:
        self.what, self.level = what, level
        self.retries: list[Retry] = []
        self._report = report or partial(print, file=sys.stderr, flush=True)

    def up(self, abort: Abort) -> Level:
        """Take the next rung after an abort and report it; SimulatorError with advice if there is none."""
        above = self.level.above(abort.phase)
        name = above.name if above else None
        self.add([Retry(self.level.name, name, abort.said, abort.time_s, abort.node)])
        if above is None:
            tried = ", ".join(retry.rung for retry in self.retries)
            raise SimulatorError(f"{abort.what}; tried: {tried}; {advice(abort)}", abort.log) from abort
        self.level = above
        return above

    def add(self, retries: Iterable[Retry]) -> None:
        """Keep and report attempts that were given up, here or in another process."""
        for retry in retries:
            self.retries.append(retry)
            self._report(f"ngspice, {self.what}, {retry}")


def climb(attempt: Callable[[Level], T], rungs: Climb) -> T:
    """Return `attempt(level)` of a circuit, from the beginning one rung higher after each Abort.

    SimulatorError if no rung is left; `rungs` keeps and reports failed attempts.
    """
    while True:
        try:
            return attempt(rungs.level)
        except Abort as abort:
            rungs.up(abort)


_NODES_SAID = (
    r"trouble with node \"([^\"]+)\"",
    r"trouble with (\S+-instance \S+)",
    r"singular matrix:\s+check nodes? (\S+(?: and \S+)?)",
    r"(?m)^(?:stderr |stdout )?(\S+)\s+[-+.\deinfa]+\s+[-+.\deinfa]+ \*$",  # "*": did not converge
    r"node \"([^\"]+)\" is",
)


def node_of(text: str) -> str | None:
    """Return the node or device in a message of ngspice, or None."""
    for pattern in _NODES_SAID:
        if found := [n for n in re.findall(pattern, text) if n != "cause"]:
            return found[-1] if pattern is _NODES_SAID[0] else found[0]
    return None


def advice(abort: Abort) -> str:
    """Return advice for a circuit that fails on every rung."""
    at = f" at {abort.node}" if abort.node else ""
    if "singular" in abort.said:
        return (
            f"try: look{at} for a node without a dc path to ground, a loop of voltage sources, "
            "or a cut of current sources; a resistor there decides it"
        )
    if abort.phase == "start":
        return f"try: a nodeset{at}, or a start from initial conditions; no state in which all laws hold was found"
    return (
        f"try: look{at} for a law that jumps or contradicts itself, or a number far beyond the others; "
        "give it a finite slope or a capacitor"
    )
