# SPDX-License-Identifier: Apache-2.0
"""Decks of the transistor blocks through ngspice, each once: results are stored under the hash of their deck.

A result stands in build/characterise/<hash>.json, and the hash is that of all that decides about it: the deck, the
models of its corner, the blocks that it uses (and no others: a change of the mirror leaves the comparator's results
valid), how it is solved, and the version of ngspice. One file a result, so that commands which run at the same time
share them and a killed one loses what it was running, no more.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

from dermis.chip import ladder, spice_batch
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.scene.design import ROOT
from scripts.characterise.benches import Condition, deck

KEPT = ROOT / "build" / "characterise" / "kept"
FAILED = ROOT / "build" / "characterise" / "failed"
"""Decks and logs of failed runs."""

START = ladder.Level(start=1)
"""Newton's method by itself finds the operating point of none of these decks: it is not tried first."""

MODELS = ROOT / "build" / "sky130"
"""Where dermis.chip.sky130 puts the models of a corner, in files that are named after their content."""

_INCLUDE = re.compile(r'^\s*\.include\s+"?([^"\n]+?)"?\s*$', re.IGNORECASE)
_SUBCKT = re.compile(r"^\s*\.subckt\s+(\S+)", re.IGNORECASE)
_ENDS = re.compile(r"^\s*\.ends\b", re.IGNORECASE)


@dataclass(frozen=True)
class Measured:
    """Results of a deck.

    Attributes
    ----------
    values : by lower-case name of its `.meas`
    rungs : what was given up on the way, in words (docs/ladder.md)
    seconds : wall clock of ngspice
    """

    values: Mapping[str, float]
    rungs: tuple[str, ...] = ()
    seconds: float = 0.0


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
    inside: list[str] | None = None
    for line in _lines(text, Path()):
        if found := _SUBCKT.match(line):
            inside = circuits[found[1].lower()] = []
        (own if inside is None else inside).append(line)
        if _ENDS.match(line):
            inside = None
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
    """Return the stored result of a hash, or None."""
    try:
        told = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
        return Measured(dict(told["values"]), tuple(told["rungs"]), float(told["seconds"]))
    except (OSError, ValueError, KeyError, TypeError):  # none, or not one of ours
        return None


def keep(name: str, what: str, measured: Measured) -> None:
    """Store a result atomically; `what` names it for a reader of the file."""
    told = {"what": what} | asdict(measured)
    write_atomic(KEPT / f"{name}.json", json.dumps(told, indent=1) + "\n")


def simulate(text: str, limit_s: float, failed: Path | None = None) -> Measured:
    """Run a resolved deck without use of stored results.

    Parameters
    ----------
    text : of `resolved`
    limit_s : wall clock of one attempt of ngspice, seconds
    failed : where deck and log stay if it is given up; default FAILED

    Raises
    ------
    SimulatorError
        ngspice gave it up on every rung, took too long or did not measure something.
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
    return Measured(dict(found.values), rungs, time.monotonic() - start)


def measured(
    body: str, condition: Condition, limit_s: float = 150.0, options: str = "", blocks: Path | None = None
) -> dict[str, float]:
    """Return the `.meas` of a bench at a condition, stored or from ngspice.

    Parameters
    ----------
    body, condition, options, blocks : as in benches.deck
    limit_s : wall clock of one attempt of ngspice, seconds

    Raises
    ------
    SimulatorError
        As `simulate`.
    """
    text = resolved(deck(body, condition, options, blocks))
    if (there := kept(key(text))) is None:
        there = simulate(text, limit_s)
        keep(key(text), f"{condition}", there)
    return dict(there.values)
