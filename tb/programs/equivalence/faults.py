# SPDX-License-Identifier: Apache-2.0
"""Faults: one of each kind in the channel of Fig. 5a for the gate, and each kind at every place for the benches.

A fault by rule is one changed line of spice/sky130. It is noticed if a bench at typical misses a limit, is off its
record, does not end, or takes a transistor outside its class: what `make characterise` says. Faults of the top are
made in the front end of two rows and columns; a test counts the cells of its pads (tb/spice/test_front_end.py).
"""

import re
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dermis.chip import sky130
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.scene.extracted import CIRCUIT
from scripts import judged
from scripts.characterise import results, runs
from scripts.characterise.benches import BENCHES
from scripts.schematics.command import parse, undrawable
from tb.programs.equivalence.gate import Case

LOOP = Case(codes=(0, 64, 240), clocks=48)  # the column that has the faults

_TABLES = Path(__file__).with_name("faults.toml")
_TOLD = tomllib.loads(_TABLES.read_text(encoding="utf-8"))
FAULTS, OTHER_RAIL, REASONS = (_TOLD[name] for name in ("gate", "other_rail", "passes"))


def written(kind: str, folder: Path) -> Path:
    """Write a copy of spice/sky130 with a fault and return its folder."""
    file, right, wrong = (FAULTS[kind][name] for name in ("file", "right", "wrong"))
    place = folder / kind
    shutil.copytree(CIRCUIT, place, dirs_exist_ok=True)
    text = (CIRCUIT / file).read_text(encoding="utf-8")
    if text.count(right) != 1:
        raise ValueError(f"{file}: {right!r} occurs {text.count(right)} times, not once")
    write_atomic(place / file, text.replace(right, wrong))
    return place


TOP = "dermis_analog_front_end"
TRANSISTORS = {"nmos": "nmos_lv", "pmos": "pmos_lv", "nmos_lv": "nmos", "pmos_lv": "pmos"}
"""The transistor of the other oxide."""
LIMIT_S, TASK_LIMIT_S = 60.0, 3600.0
"""Time limits of one attempt of ngspice (the slowest bench takes 9 s) and of all benches of a fault, in s."""


@dataclass(frozen=True)
class Fault:
    """A changed line."""

    kind: str
    file: str
    subckt: str
    line: str
    wrong: str  # empty: the element is missing

    @property
    def name(self) -> str:
        """Its subcircuit, element and kind."""
        return f"{self.subckt}.{self.line.split()[0]}.{self.kind}"


def _changed(line: str, nets: set[str]) -> Iterator[tuple[str, str]]:
    """Yield the faults of an element: kind and wrong line. `nets` are the pins of its subcircuit."""
    name, *words = line.split()
    model = next(n for n, word in enumerate(words) if n + 1 == len(words) or "=" in words[n + 1])
    pins, device, sizes = words[:model], words[model], words[model + 1 :]
    what = "passive" if device.startswith("sky130") else "transistor" if device in TRANSISTORS else "circuit"
    if what == "passive":
        yield "missing", ""
        if length := re.search(r" l=([\d.]+)", line):
            yield "half", line.replace(length[0], f" l={float(length[1]) / 2:g}")
    if what == "transistor":
        # A device of 1.8 V has no k; ngspice would take a k of its own for that of the circuit around it.
        plain = [size for size in sizes if size[0] != "k"]
        yield "oxide", " ".join([name, *pins, TRANSISTORS[device], *plain])
        if pins[3] != pins[2]:
            yield "bulk", " ".join([name, *pins[:3], pins[2], device, *sizes])
    if device == "inverter":
        yield "oxide", " ".join([name, *pins[:4], "inverter_lv", *sizes])
    if device == "inverter_lv":
        yield "oxide", " ".join([name, *pins, pins[3], "inverter", *sizes])
    for at, net in enumerate(pins[:3] if what == "transistor" else pins):
        if there := [rail for rail in OTHER_RAIL[what].get(net, ()) if rail in nets]:
            yield f"rail{at + 1}", " ".join([name, *pins[:at], there[0], *pins[at + 1 :], device, *sizes])


def _of_text(file: str, text: str) -> Iterator[Fault]:
    subckt, nets = "", set()
    for line in text.replace("\n+", "").splitlines():
        if line.startswith(".subckt"):
            subckt, nets = line.split()[1], set(line.split()[2:])
        elif line.startswith("x") and subckt and not line.startswith(("xesd_", "xclamp ")):
            for kind, wrong in _changed(line, nets):
                yield Fault(kind, file, subckt, line, wrong)
            if subckt == TOP:
                yield from _neighbours(file, line)


def _neighbours(file: str, line: str) -> Iterator[Fault]:
    """Yield the faults of the top that take a net of row or column 1 in place of that of 0."""
    words = line.split()
    for at, net in enumerate(words[1:-1], 1):
        if (found := re.fullmatch(r"(\D+)([01])", net)) and words[0][-1] == "0":
            wrong = " ".join([*words[:at], f"{found[1]}{1 - int(found[2])}", *words[at + 1 :]])
            yield Fault(f"neighbour{at}", file, TOP, line, wrong)


def by_rule() -> list[Fault]:
    """Return every fault, by file; the top's are those of two rows and columns, at row and column 0."""
    found = []
    for path in sorted(CIRCUIT.glob("*.sp")):
        if path.stem != TOP:
            found += _of_text(path.name, path.read_text(encoding="utf-8"))
    return [*found, *_of_text("", sky130.front_end(2, 2))]


@cache
def _reach() -> dict[str, tuple[str, set[str]]]:
    """Return the deck of every bench, quickest first, and the subcircuits in it."""
    decks = {name: runs.resolved(runs.Job(name, runs.TYPICAL).deck()) for name in BENCHES}
    kept = {name: runs.kept(runs.key(text)) for name, text in decks.items()}
    order = sorted(decks, key=lambda name: kept[name].seconds if kept[name] else 60.0)
    return {n: (decks[n], set(re.findall(r"^\.subckt (\S+)", decks[n], re.MULTILINE))) for n in order}


def noticed(fault: Fault, folder: Path) -> str:
    """Return the bench and the row that notice a fault; empty if none does."""
    right = (CIRCUIT / fault.file).read_text(encoding="utf-8") if fault.file else sky130.front_end(2, 2)
    start = re.search(rf"^\.subckt {fault.subckt}\s", right, re.MULTILINE).start()
    wrong = right[:start] + right[start:].replace(f"\n{fault.line}\n", f"\n{fault.wrong or '*'}\n", 1)
    if odd := undrawable(parse(wrong, CIRCUIT)):
        return f"make schematics: {odd[0]}"
    place = folder / re.sub(r"\W", "_", fault.name)
    shutil.rmtree(place, ignore_errors=True)
    if fault.file:
        shutil.copytree(CIRCUIT, place)
        write_atomic(place / fault.file, wrong)
    for name, (sound, reached) in _reach().items():
        if fault.subckt not in reached:
            continue
        deck = runs.Job(name, runs.TYPICAL).deck(place if fault.file else None)
        text = runs.resolved(deck if fault.file else deck.replace(right.strip(), wrong.strip()))
        if text == sound:
            continue
        try:
            measured = runs.simulate(text, LIMIT_S, place / "failed")
        except SimulatorError as error:
            return f"{name}: {error}"[:120]
        if outside := sky130.outside_class(measured.exceeded):
            return f"{name}: {outside[0]}"
        outcome = runs.outcome(runs.Job(name, runs.TYPICAL), measured)
        if outcome.fault:
            return f"{name}: {outcome.fault}"
        if said := results.missed(outcome.values) or results.moved(outcome.values):
            return f"{name}: {said[0]}"
    shutil.rmtree(place, ignore_errors=True)
    return ""


def digest() -> str:
    """Return the digest of what decides about a fault, besides the circuit."""
    decks = sorted((name, deck) for name, (deck, _) in _reach().items())
    return judged.digest((Path(__file__), _TABLES, results.RECORD), *decks)


def reason(name: str) -> str:
    """Return why a fault passes."""
    return next((why for pattern, why in REASONS.items() if re.search(pattern, name)), "not known")
