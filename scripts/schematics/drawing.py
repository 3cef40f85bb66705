# SPDX-License-Identifier: Apache-2.0
"""Draw sheets of xschem as SVG with searchable text.

The SVG of xschem itself has letters as strokes, pins as squares and lines without width.
"""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from html import escape
from pathlib import Path
from typing import NamedTuple

from dermis.errors import InputError
from dermis.files import text_of
from dermis.scene.design import ROOT

SHEETS = ROOT / "spice" / "schematic"
LETTER_HEIGHT, LETTER_WIDTH = 52.0, 29.0
"""Height and mean width of a letter of size 1 in xschem, in units of the grid."""
PORTS = ("ipin", "opin", "iopin")
STYLE = """
path, circle { fill: none; stroke: #1b1b1b; stroke-width: 1.6; stroke-linecap: round }
.wire { stroke: #1d5f99; stroke-width: 1.3 }
.fill { fill: #1b1b1b; stroke: none }
.dot { fill: #1d5f99; stroke: none }
text { font-family: Helvetica, Arial, 'Liberation Sans', sans-serif; fill: #555; white-space: pre }
.t1 { fill: #1d5f99 }
.t2 { fill: #8a8a8a }
.t4 { fill: #1b1b1b; font-weight: 600 }
"""

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
        """Return fields as numbers."""
        return [float(field) for field in self.fields[first:last]]


def attributes(text: str) -> dict[str, str]:
    """Return the pairs `name=value` or `name="value"` of a field."""
    return {k: re.sub(r"\\(.)", r"\1", quoted or plain) for k, quoted, plain in _ATTRIBUTE.findall(text)}


@cache
def records(path: Path) -> tuple[Record, ...]:
    """Return the records of a sheet or symbol; InputError if the file does not follow the
    format.
    """
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
    """Return a text and the corners of its box. It is always horizontal; a flip moves it to the
    other side.
    """
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
        pins = (
            r.numbers(1, 5) for r in place.drawing if r.kind == "B" and place.kind not in ("label", *PORTS)
        )
        ends.update(place.at((a + c) / 2, (b + d) / 2) for a, b, c, d in pins)

    def through(x: float, y: float) -> int:
        return sum(
            min(a, c) <= x <= max(a, c) and min(b, d) <= y <= max(b, d) and (x, y) not in ((a, b), (c, d))
            for a, b, c, d in wires
        )

    return [end for end, count in ends.items() if count + 2 * through(*end) >= 3]


def draw(sheet: Path) -> str:
    """Return a sheet as SVG."""
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
    ground = f'<style>{STYLE}</style><rect x="{left:g}" y="{top:g}" {size} fill="white"/>'
    return "\n".join((head, ground, *(line for line, _ in drawn), *dots, "</svg>\n"))
