# SPDX-License-Identifier: Apache-2.0
"""Decks of the transistor blocks through ngspice, each once, over conditions: results are stored by their deck.

docs/characterise.md says what the hash of a deck is made of. One file a result, so that commands which run at the same
time share them and a killed one loses what it was running, no more.
"""

import hashlib
import json
import math
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from dermis.chip import spice_batch
from dermis.chip.netlist import OPTIONS_TRANSISTORS
from dermis.chip.sky130 import CORNERS, PASSIVE_CORNERS
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.lockstep import ladder
from dermis.scene.design import ROOT
from scripts import workers
from scripts.characterise.benches import BENCHES, CODES_A_UNIT, Bench, Condition, deck

KEPT = ROOT / "build" / "characterise" / "kept"
FAILED = ROOT / "build" / "characterise" / "failed"
"""Decks and logs of failed runs."""

LIMIT_S = 150.0
"""Wall clock of one attempt of ngspice."""
START = ladder.Level(start=1)
"""Newton's method by itself finds the operating point of none of these decks: it is not tried first."""

MODELS = ROOT / "build" / "sky130"
"""Where dermis.chip.sky130 puts the models of a corner, in files that are named after their content."""

_INCLUDE = re.compile(r'^\s*\.include\s+"?([^"\n]+?)"?\s*$', re.IGNORECASE)
_SUBCKT = re.compile(r"^\s*\.subckt\s+(\S+)", re.IGNORECASE)
_ENDS = re.compile(r"^\s*\.ends\b", re.IGNORECASE)


@dataclass(frozen=True)
class Measured:
    values: Mapping[str, float]  # by lower-case name of its `.meas`
    rungs: tuple[str, ...] = ()  # what was given up on the way, in words (docs/ladder.md)
    seconds: float = 0.0  # wall clock of ngspice
    exceeded: Mapping[str, Sequence[float]] = field(default_factory=dict)  # as of spice_batch.Measured


@lru_cache(256)
def _text(path: Path, _: int) -> str:
    return path.read_text(encoding="utf-8")


def _lines(text: str, folder: Path) -> Iterator[str]:
    """Yield the lines of a deck without comments, includes resolved except the models of a corner."""
    for line in text.splitlines():
        if found := _INCLUDE.match(line):
            path = folder / found[1]
            if path.parent == MODELS:
                yield line
            else:
                yield from _lines(_text(path, path.stat().st_mtime_ns), path.parent)
        elif (words := line.split()) and not words[0].startswith("*"):
            yield " ".join(words)


def resolved(text: str) -> str:
    """Return a deck in one piece, without comments and unused blocks.

    The deck that runs is the deck that is hashed, even if files change meanwhile.
    """
    own: list[str] = []
    circuits: dict[str, list[str]] = {}
    inside = own
    for line in _lines(text, Path()):
        if found := _SUBCKT.match(line):
            inside = circuits[found[1].lower()] = []
        inside.append(line)
        if _ENDS.match(line):
            inside = own
    reached: dict[str, list[str]] = {}
    waiting = [own]
    while waiting:
        for word in {word for line in waiting.pop() for word in line.lower().split()}:
            if word in circuits and word not in reached:
                reached[word] = circuits[word]
                waiting.append(circuits[word])
    blocks = [line for name in sorted(reached) for line in reached[name]]
    title, *rest = [line for line in own if line.lower() != ".end"]
    return "\n".join([title, *blocks, *rest, ".end"]) + "\n"


def key(text: str) -> str:
    """Return the hash of all inputs of a resolved deck."""
    solved = (spice_batch.version(), START, ladder.START, ladder.STEPS)
    # A model file is named after its content; its folder differs between machines.
    return hashlib.sha256(f"{solved}\n{text.replace(str(MODELS), '')}".encode()).hexdigest()[:24]


def kept(name: str) -> Measured | None:
    try:
        told = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
        values, exceeded = dict(told["values"]), dict(told["exceeded"])
        return Measured(values, tuple(told["rungs"]), float(told["seconds"]), exceeded)
    except (OSError, ValueError, KeyError, TypeError):  # none, or not one of ours
        return None


def keep(name: str, what: str, measured: Measured) -> None:
    """Store a result atomically; `what` names it for a reader of the file."""
    told = {"what": what} | asdict(measured)
    write_atomic(KEPT / f"{name}.json", json.dumps(told, indent=1) + "\n")


def simulate(text: str, limit_s: float = LIMIT_S, failed: Path | None = None) -> Measured:
    """Run a resolved deck without use of stored results; `limit_s` is for one attempt of ngspice.

    SimulatorError if ngspice gave it up on every rung, took too long or did not measure something;
    deck and log stay in `failed`, by default FAILED.
    """
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="characterise_") as folder:
        path = Path(folder) / "characterise.sp"
        path.write_text(text, encoding="utf-8")
        try:
            found = spice_batch.run(path, limit_s, START)
        except SimulatorError as error:
            place = (failed or FAILED) / hashlib.sha256(text.encode()).hexdigest()[:12]
            shutil.copytree(folder, place, dirs_exist_ok=True)
            raise SimulatorError(error.what, place / path.with_suffix(".log").name) from error
    rungs = tuple(str(retry) for retry in found.retries)
    return Measured(dict(found.values), rungs, time.monotonic() - start, dict(found.exceeded))


def measured(body: str, condition: Condition, blocks: Path | None = None) -> dict[str, float]:
    """Return the `.meas` of a bench at a condition, stored or from ngspice; arguments as of `deck`."""
    text = resolved(deck(body, condition, blocks=blocks))
    if (there := kept(key(text))) is None:
        there = simulate(text)
        keep(key(text), f"{condition}", there)
    return dict(there.values)


CELSIUS = (-40.0, 27.0, 125.0)
SUPPLIES = (0.9, 1.0, 1.1)
TYPICAL = Condition()
EXTRACTED = TYPICAL, *(Condition(*at) for at in (("ss", -40.0), ("ff", 125.0), ("sf", 27.0), ("fs", 27.0)))
"""Conditions of models/extracted: typical, slow and fast at their worse temperature, both skews."""

EXTREMES = (TYPICAL, Condition("ss", -40.0, 0.9), Condition("ff", 125.0, 1.1))
"""Conditions of the numerical checks and of `--short`: typical, slowest and fastest."""

SAMPLES, SHORT_SAMPLES = 100, 2
"""Draws of the mismatch, in a whole run and with `--short`."""

_TRAN = re.compile(r"^(\.tran\s+)([\d.]+)([a-z]*)", re.MULTILINE | re.IGNORECASE)

# The text of a bench, and options that replace its own, by the way to solve its transient. The step
# of .tran is the largest that ngspice takes; half_step also halves the tolerances that choose it. An operating point
# has `tight` alone, at every condition.
NUMERICS: Mapping[str, Callable[[Bench], tuple[str, Mapping[str, float | str]]]] = {
    "": lambda bench: (bench.body, {}),
    "half_step": lambda bench: (
        _TRAN.sub(lambda m: f"{m[1]}{float(m[2]) / 2:g}{m[3]}", bench.body),
        {"trtol": bench.trtol / 2, "reltol": 5e-4},
    ),
    "gear": lambda bench: (bench.body, {"method": "gear", "maxord": 2}),
    # As a frame in transistors is read (dermis.chip.netlist).
    "as_frames": lambda bench: (bench.body, OPTIONS_TRANSISTORS),
    "tight": lambda bench: (bench.body, {"reltol": 1e-5}),
}


@dataclass(frozen=True)
class Job:
    """One run of ngspice: a bench at a condition, solved as it is or as NUMERICS says."""

    bench: str
    condition: Condition
    numerics: str = ""

    def deck(self, blocks: Path | None = None) -> str:
        """Return the whole deck, of spice/sky130 or of a changed copy."""
        bench = BENCHES[self.bench]
        body, options = NUMERICS[self.numerics](bench)
        # A bench that leaves ngspice its own has the deck without the word, not another one.
        options = ({} if bench.trtol == Bench.trtol else {"trtol": bench.trtol}) | options
        words = (f"{n}={v if isinstance(v, str) else format(v, 'g')}" for n, v in options.items())
        return deck(body, self.condition, " ".join(words), blocks)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job: values of its quantities, or in `fault` the reason for none."""

    values: Mapping[str, float]
    fault: str = ""
    measured: Measured | None = None


def conditions(at: str | None = None) -> list[Condition]:
    """Return all conditions with nominal passives, or those of a text: "ss,-40,0.9", "ss_low,*,1"."""
    known = (*CORNERS, *PASSIVE_CORNERS)
    allowed = f"corner,celsius,supply of {' '.join(known)}, -40 .. 125, 0.8 .. 1.2; * for all"
    try:
        corner, c, s = (word.strip() for word in (at or "*,*,*").split(","))
        celsius, supplies = CELSIUS if c == "*" else (float(c),), SUPPLIES if s == "*" else (float(s),)
    except ValueError:
        raise InputError("command line", "--at", at, allowed) from None
    if corner not in ("*", *known) or not (-40 <= min(celsius) <= 125 and 0.8 <= min(supplies) <= 1.2):
        raise InputError("command line", "--at", at, allowed)
    corners = CORNERS if corner == "*" else (corner,)
    return [Condition(name, c, s) for name in corners for c in celsius for s in supplies]


def jobs_of(
    names: Sequence[str],
    at: Sequence[str],
    sample: int | None,
    many: int | None,
    short: bool,
    ways: Sequence[str] = (),
) -> list[Job]:
    """Return the runs that the options ask for: corners, mismatch, other ways to solve transients.

    Of a condition by itself only the `ways` that are asked for.
    """
    if at or sample is not None:
        places = list(dict.fromkeys(place for one in at for place in conditions(one))) or [TYPICAL]
        ways, last = ["", *ways], many or 0
        begin = places[0]
        places = [replace(place, sample=sample) for place in places]
        jobs = [Job(name, place, way) for name in names for place in places for way in ways]
        numerics = []
    else:
        # Resistors and capacitors are at their ends at nominal supply.
        ends = [Condition(corner, celsius) for corner in PASSIVE_CORNERS for celsius in CELSIUS]
        places, begin = list(EXTREMES) if short else [*conditions(), *ends], TYPICAL
        last = (SHORT_SAMPLES if short else SAMPLES) if many is None else many
        jobs = [Job(name, place) for place in places for name in names]
        numerics = [
            Job(name, place, way)
            for way in filter(None, NUMERICS)
            for place in (places if way == "tight" else EXTREMES)
            for name in names
            if bool(_TRAN.search(BENCHES[name].body)) == (way != "tight")
            and CODES_A_UNIT.keys() & {q.partition(".")[0] for q in BENCHES[name].units}
        ]
    drawn = [replace(begin, sample=n) for n in range(1, last + 1)]
    jobs += [Job(name, place) for place in drawn for name in names if BENCHES[name].samples]
    return jobs + numerics


def outcome(job: Job, measured: Measured) -> Outcome:
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
    """Jobs, each once, their stored results unless `fresh`, and the remaining ones."""

    def __init__(self, jobs: Iterable[Job], *, fresh: bool = False) -> None:
        self.outcomes: dict[Job, Outcome] = {}
        self.todo: dict[Job, str] = {}  # with its deck
        self._jobs = list(dict.fromkeys(jobs))
        for job in self._jobs:
            text = resolved(job.deck())
            there = None if fresh else kept(key(text))
            if there is None:
                self.todo[job] = text
            else:
                self.outcomes[job] = outcome(job, there)

    def run(self, processes: int, progress: Callable[[int], None]) -> None:
        """Run the remaining jobs and store each result at once; a failure of ngspice is an Outcome.

        `progress` is called with the number of jobs done, of all.
        """
        todo = list(self.todo)
        # LIMIT_S is ngspice's own; the time limit of the task is for a process that hangs.
        tasks = (workers.Task(simulate, (self.todo[job], LIMIT_S, FAILED), 100.0 * LIMIT_S) for job in todo)
        for number, done in workers.run(tasks, processes):
            job = todo[number]
            if done.fault:
                self.outcomes[job] = Outcome({}, done.fault)
            else:
                keep(key(self.todo[job]), f"{job.bench} at {job.condition}", done.value)
                self.outcomes[job] = outcome(job, done.value)
            progress(len(self.outcomes))
        # In the order of the jobs, whatever ended first: tables and ties do not depend on it.
        self.outcomes = {job: self.outcomes[job] for job in self._jobs}
