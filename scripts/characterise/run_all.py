# SPDX-License-Identifier: Apache-2.0
"""The runs of the benches over conditions, in processes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dermis.chip.netlist import OPTIONS_TRANSISTORS
from dermis.chip.sky130 import CORNERS, PASSIVE_CORNERS
from dermis.errors import InputError, SimulatorError, one_line
from scripts import workers
from scripts.characterise import runs
from scripts.characterise.benches import BENCHES, Bench, Condition, deck

CELSIUS = (-40.0, 27.0, 125.0)
SUPPLIES = (0.9, 1.0, 1.1)
TYPICAL = Condition()

EXTREMES = (TYPICAL, Condition("ss", -40.0, 0.9), Condition("ff", 125.0, 1.1))
"""Conditions of the numerical checks and of `--short`: typical, slowest and fastest."""

SAMPLES, SHORT_SAMPLES = 100, 2
"""Draws of the mismatch, in a whole run and with `--short`."""

_TRAN = re.compile(r"^(\.tran\s+)([\d.]+)([a-z]*)", re.MULTILINE | re.IGNORECASE)

# The text of a bench, and options that replace its own, by the way to solve its transient. The step
# of .tran is the largest that ngspice takes; half_step also halves the tolerances that choose it.
NUMERICS: Mapping[str, Callable[[Bench], tuple[str, Mapping[str, float | str]]]] = {
    "": lambda bench: (bench.body, {}),
    "half_step": lambda bench: (
        _TRAN.sub(lambda m: f"{m[1]}{float(m[2]) / 2:g}{m[3]}", bench.body),
        {"trtol": bench.trtol / 2, "reltol": 5e-4},
    ),
    "gear": lambda bench: (bench.body, {"method": "gear", "maxord": 2}),
    # As a frame in transistors is read (dermis.chip.netlist).
    "as_frames": lambda bench: (bench.body, OPTIONS_TRANSISTORS),
}


@dataclass(frozen=True)
class Job:
    """One run of ngspice: a bench at a condition, solved as it is or as NUMERICS says."""

    bench: str
    condition: Condition
    numerics: str = ""

    def deck(self) -> str:
        """Return the whole deck."""
        bench = BENCHES[self.bench]
        body, options = NUMERICS[self.numerics](bench)
        # A bench that leaves ngspice its own has the deck without the word, not another one.
        options = ({} if bench.trtol == Bench.trtol else {"trtol": bench.trtol}) | options
        words = (f"{n}={v if isinstance(v, str) else format(v, 'g')}" for n, v in options.items())
        return deck(body, self.condition, " ".join(words))


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job: values of its quantities, or in `fault` the reason for none."""

    values: Mapping[str, float]
    fault: str = ""
    measured: runs.Measured | None = None


def is_transient(bench: Bench) -> bool:
    """Return True for a bench with time steps."""
    return _TRAN.search(bench.body) is not None


def conditions(at: str | None = None) -> list[Condition]:
    """Return all conditions with nominal passives, or those of a text: "ss,-40,0.9", "ss_low,*,1".

    Raises
    ------
    InputError
        It names none.
    """
    corner, *numbers = (word.strip() for word in (at or "*,*,*").split(","))
    known = (*CORNERS, *PASSIVE_CORNERS)
    try:
        celsius, supplies = (
            every if word == "*" else (float(word),)
            for word, every in zip(numbers, (CELSIUS, SUPPLIES), strict=True)
        )
        good = corner in ("*", *known) and all(-40 <= c <= 125 for c in celsius)
        good = good and all(0.8 <= s <= 1.2 for s in supplies)
    except ValueError:
        good = False
    if not good:
        allowed = f"corner,celsius,supply of {' '.join(known)}, -40 .. 125, 0.8 .. 1.2; * for all"
        raise InputError("command line", "--at", at, allowed)
    corners = CORNERS if corner == "*" else (corner,)
    return [Condition(name, c, s) for name in corners for c in celsius for s in supplies]


def passives() -> list[Condition]:
    """Return the ends of resistors and capacitors, at nominal supply."""
    return [Condition(corner, c) for corner in PASSIVE_CORNERS for c in CELSIUS]


def jobs_of(
    names: Sequence[str],
    at: str | None,
    sample: int | None,
    many: int | None,
    short: bool,
    ways: Sequence[str] = (),
) -> list[Job]:
    """Return the runs that the options ask for: corners, mismatch, other ways to solve transients.

    Of a condition by itself only the `ways` that are asked for.
    """
    if at is not None or sample is not None:
        places, ways, last = [TYPICAL] if at is None else conditions(at), ["", *ways], many or 0
        begin = places[0]
        if sample is not None:
            places = [replace(place, sample=sample) for place in places]
        jobs = [Job(name, place, way) for name in names for place in places for way in ways]
        numerics = []
    else:
        places, begin = list(EXTREMES) if short else [*conditions(), *passives()], TYPICAL
        last = (SHORT_SAMPLES if short else SAMPLES) if many is None else many
        jobs = [Job(name, place) for place in places for name in names]
        numerics = [
            Job(name, place, way)
            for way in filter(None, NUMERICS)
            for place in EXTREMES
            for name in names
            if is_transient(BENCHES[name])
        ]
    drawn = [replace(begin, sample=n) for n in range(1, last + 1)]
    return [
        *jobs,
        *(Job(name, place) for place in drawn for name in names if BENCHES[name].samples),
        *numerics,
    ]


def outcome(job: Job, measured: runs.Measured) -> Outcome:
    """Return the quantities of the measurements of a job."""
    bench = BENCHES[job.bench]
    try:
        values = bench.values(measured.values)
    except (ArithmeticError, KeyError, ValueError) as error:
        return Outcome({}, f"its values do not follow: {type(error).__name__}: {error}", measured)
    if odd := [name for name in bench.units if not math.isfinite(values.get(name, math.nan))]:
        return Outcome({}, f"not a number: {', '.join(odd)}", measured)
    return Outcome({name: float(values[name]) for name in bench.units}, "", measured)


class Runs:
    """Jobs, their stored results and the remaining ones.

    Parameters
    ----------
    jobs : each once
    fresh : measure again what is kept
    """

    def __init__(self, jobs: Iterable[Job], *, fresh: bool = False) -> None:
        self.outcomes: dict[Job, Outcome] = {}
        self.todo: dict[Job, str] = {}  # with its deck
        for job in dict.fromkeys(jobs):
            text = runs.resolved(job.deck())
            there = None if fresh else runs.kept(runs.key(text))
            if there is None:
                self.todo[job] = text
            else:
                self.outcomes[job] = outcome(job, there)

    def run(self, processes: int, progress: Callable[[int], None]) -> None:
        """Run the remaining jobs and store each result at once; a failure of ngspice is an Outcome.

        Parameters
        ----------
        processes : at a time
        progress : called with the number of jobs done, of all
        """
        todo = list(self.todo)
        # The time limit of each attempt is ngspice's; that of the task is for a process that hangs.
        tasks = (
            workers.Task(_attempt, (self.todo[job], limit_s, runs.FAILED), 100.0 * limit_s)
            for job in todo
            for limit_s in (BENCHES[job.bench].limit_s,)
        )
        for number, done in workers.run(tasks, processes):
            job, measured, fault = todo[number], *(done.value or (None, done.fault))
            if measured is None:
                self.outcomes[job] = Outcome({}, fault)
            else:
                runs.keep(runs.key(self.todo[job]), f"{job.bench} at {job.condition}", measured)
                self.outcomes[job] = outcome(job, measured)
            progress(len(self.outcomes))


def _attempt(text: str, limit_s: float, failed: Path) -> tuple[runs.Measured | None, str]:
    try:
        return runs.simulate(text, limit_s, failed), ""
    except SimulatorError as error:
        return None, one_line(str(error), 400)
