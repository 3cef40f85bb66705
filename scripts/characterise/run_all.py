# SPDX-License-Identifier: Apache-2.0
"""Which benches are run where, and their way through processes of this machine or a Dask cluster."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace

from dermis.chip.netlist import OPTIONS_TRANSISTORS
from dermis.chip.sky130 import CORNERS, PASSIVE_CORNERS
from dermis.engines import batch
from dermis.errors import DermisError, InputError, one_line
from dermis.processes import pool
from scripts.characterise import runs
from scripts.characterise.benches import BENCHES, Bench, Condition, deck

CELSIUS = (-40.0, 27.0, 125.0)
SUPPLIES = (0.9, 1.0, 1.1)
TYPICAL = Condition()

EXTREMES = (TYPICAL, Condition("ss", -40.0, 0.9), Condition("ff", 125.0, 1.1))
"""Conditions of the numerical checks and of `--short`: typical, slowest and fastest."""

GUESS_S = 0.3
"""Mean seconds of a run on an idle core, the estimate for a bench without stored results."""


@dataclass(frozen=True)
class Job:
    """One run of ngspice: a bench at a condition, solved as it is or in another way (see NUMERICS)."""

    bench: str
    condition: Condition
    numerics: str = ""

    def deck(self) -> str:
        """The whole deck."""
        bench = BENCHES[self.bench]
        body, options = NUMERICS[self.numerics](bench)
        # A bench that leaves ngspice its own has the deck without the word, not another one.
        given = {} if bench.trtol == Bench.trtol else {"trtol": bench.trtol}
        return deck(body, self.condition, " ".join(f"{n}={_said(v)}" for n, v in (given | options).items()))


def _said(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


_TRAN = re.compile(r"^(\.tran\s+)([\d.]+)([a-z]*)", re.MULTILINE | re.IGNORECASE)

# How a transient may be solved: the text of its bench, and options that replace the bench's own. The step of .tran is
# the largest that ngspice takes; half of everything is half of it and half of the tolerances that choose shorter ones.
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


def is_transient(bench: Bench) -> bool:
    """Return True for a bench with time steps."""
    return _TRAN.search(bench.body) is not None


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job: values of its quantities, or in `fault` the reason for none."""

    values: Mapping[str, float]
    fault: str = ""
    measured: runs.Measured | None = None


def conditions(at: str | None = None) -> list[Condition]:
    """All conditions with nominal passives, or those that a text such as "ss,-40,0.9" or "ss_low,*,1" names.

    Raises
    ------
    InputError
        It names none.
    """
    words = ["*", "*", "*"] if at is None else [word.strip() for word in at.split(",")]
    known = (*CORNERS, *PASSIVE_CORNERS)
    allowed = f"corner,celsius,supply of {' '.join(known)}, -40 .. 125, 0.8 .. 1.2; * for all"
    if len(words) != 3 or (words[0] != "*" and words[0] not in known):
        raise InputError("command line", "--at", at, allowed)
    try:
        celsius = CELSIUS if words[1] == "*" else (float(words[1]),)
        supplies = SUPPLIES if words[2] == "*" else (float(words[2]),)
    except ValueError:
        raise InputError("command line", "--at", at, allowed) from None
    if not all(-40.0 <= c <= 125.0 for c in celsius) or not all(0.8 <= s <= 1.2 for s in supplies):
        raise InputError("command line", "--at", at, allowed)
    corners = CORNERS if words[0] == "*" else (words[0],)
    return [Condition(corner, c, s) for corner in corners for c in celsius for s in supplies]


def passives() -> list[Condition]:
    """Ends of resistors and capacitors, at nominal supply."""
    return [Condition(corner, c) for corner in PASSIVE_CORNERS for c in CELSIUS]


def samples(first: int, last: int, at: Condition = TYPICAL) -> list[Condition]:
    """Mismatch with the seeds first .. last."""
    return [replace(at, sample=n) for n in range(first, last + 1)]


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
        self.todo: list[Job] = []
        self._fresh = fresh
        self._begun: list[Job] = []
        self._decks: dict[Job, str] = {}
        for job in dict.fromkeys(jobs):
            text = runs.resolved(job.deck())
            there = None if fresh else runs.kept(runs.key(text))
            if there is None:
                self._decks[job] = text
                self.todo.append(job)
            else:
                self.outcomes[job] = outcome(job, there)

    def seconds(self) -> float:
        """Estimate the core time of the remaining jobs from the stored runs of each bench."""
        took: dict[str, list[float]] = {}
        for job, done in self.outcomes.items():
            if done.measured is not None:
                took.setdefault(job.bench, []).append(done.measured.seconds)
        usual = {name: statistics.median(seconds) for name, seconds in took.items()}
        return sum(usual.get(job.bench, GUESS_S) for job in self.todo)

    def run(self, jobs: int, scheduler: str | None, progress: Callable[[int], None]) -> None:
        """Run the remaining jobs and store each result at once.

        Parameters
        ----------
        jobs : processes of this machine
        scheduler : address of a Dask scheduler, whose workers are used instead
        progress : called with the number of jobs done, of all

        Raises
        ------
        InputError
            A scheduler that does not answer.
        SimulatorError
            The cluster is lost. A failure of ngspice is an Outcome.
        """
        if not self.todo:
            return
        self._begun.clear()
        with _executor(min(jobs, len(self.todo)), scheduler) as (executor, workers, look):
            version = None if scheduler is None else batch.fingerprint()
            for index, task in batch.spread(self._calls(version), executor, workers, look):
                job = self._begun[index]
                try:
                    measured = task.result()
                except DermisError as error:
                    # A failure of a job is a result; the loss of the workers is not.
                    if isinstance(error, InputError):
                        raise
                    self.outcomes[job] = Outcome({}, one_line(str(error), 400))
                else:
                    runs.keep(runs.key(self._decks[job]), f"{job.bench} at {job.condition}", measured)
                    self.outcomes[job] = outcome(job, measured)
                progress(len(self.outcomes))

    def _calls(
        self, version: str | None
    ) -> Iterator[tuple[Callable[..., runs.Measured], tuple[object, ...]]]:
        for job in self.todo:
            # Another command may have measured it since this one began.
            if not self._fresh and (there := runs.kept(runs.key(self._decks[job]))) is not None:
                self.outcomes[job] = outcome(job, there)
                continue
            self._begun.append(job)
            limit_s = BENCHES[job.bench].limit_s
            if version is None:
                yield runs.simulate, (self._decks[job], limit_s, runs.FAILED)
            else:
                yield _elsewhere, (job, limit_s, version)


def _elsewhere(job: Job, limit_s: float, version: str) -> runs.Measured:
    """A job on another machine, whose paths are its own."""
    batch.same_version(version)
    return runs.simulate(runs.resolved(job.deck()), limit_s)


@contextmanager
def _executor(jobs: int, scheduler: str | None) -> Iterator[tuple[Executor, int, Callable[[], None]]]:
    if scheduler is not None:
        with batch.cluster(scheduler) as found:
            yield found
        return
    with pool.workers(jobs, pool.ONE_THREAD) as executor:
        yield executor, jobs, lambda: None
