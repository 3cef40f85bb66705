# SPDX-License-Identifier: Apache-2.0
"""Texts of any kind: tables, and the exports of Tekscan, XSENSOR and novel emed."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from dermis.decode import recording_text as tables
from dermis.decode.recording_text import NUMBER, Found, Layout, Table, warn
from dermis.errors import InputError, one_line, quoted

_MM = {
    "mm": 1.0, "millimeters": 1.0, "cm": 10.0, "centimeters": 10.0, "m": 1e3, "meters": 1e3, "in": 25.4, "inch": 25.4,
    "inches": 25.4,
}  # fmt: skip
_ROW = re.compile(r"(?!.*[a-zA-DF-Z]{2})[-+.\dB]")
"""Beginning of a row of numbers: no words; E may be an exponent, B a place without a sensel."""
_PICTURE = re.compile(r"\W*pict-?no\.?:?\s*(\d{1,9})", re.IGNORECASE)

# Forces of 1 N have two digits behind the point.
_MARGIN = 0.02


def read(path: Path, data: bytes, layout: Layout) -> Found:
    """Read a text of any kind; InputError where it leaves a question open."""
    said = tables.decoded(path, data)
    lines = said.splitlines()
    if re.match(r"\s*(\{|\[\s*\{)", said):
        raise InputError(path, "file", "JSON", f"a table with a line for a frame, as csv; {tables.KNOWN}")
    head = [line.strip(' ",;\t').lower() for line in lines[:4000]]
    if any(h.startswith("rows") for h in head) and any(tables.LABEL.match(h) for h in head):
        return _sheets(path, lines, layout)
    if any(_PICTURE.match(line) for line in lines):
        return _emed(path, lines, layout)
    table = Table(path, lines, layout)
    found, ends = table.found(), [row[-1] for row in table.sample]
    before = [len(cell) for cell in ends[: min(20, table.count - 1)]]
    if not said.endswith(("\n", "\r")) and len(ends[-1]) < min(before, default=0):
        warn(path, f"the last line ends with {quoted(ends[-1])} and no new line: cut off?")
    return found


def _sheets(path: Path, lines: list[str], layout: Layout) -> Found:
    """Read an export of Tekscan or XSENSOR: a header of keys, and a table parted by `Frame n`."""
    said: dict[str, str] = {}
    kept, parts = [""] * len(lines), {}
    at, part = None, ""  # last label; sensor, or None in a group
    known = re.compile(
        r"(rows|cols|columns|row_spacing|col_spacing|sensel_area|seconds_per_frame|units|sensel width|sensel height)"
        r"\b[\s\",;:=]*(.*)", re.IGNORECASE,
    )  # fmt: skip
    for n, raw in enumerate(lines):
        line = raw.strip(' \t",;')
        if label := tables.LABEL.match(line):
            stamp = tables.STAMP.search(label[2])
            kept[n], at, part = f"#frame:{label[1]}" + (f"({stamp[0]})" if stamp else ""), n, ""
        elif match := known.match(line):
            said.setdefault(match[1].lower().replace("columns", "cols"), match[2])
        elif at is not None and line.lower().startswith(("sensor", "group")):
            part = None if line.lower().startswith("group") else line[7:].strip(" ,;\t")
        elif at is not None and line.lower().startswith("time") and (clock := tables.CLOCK.search(line)):
            kept[at] += f"({tables.seconds_of(clock[0])!r}s)"
        elif None not in (at, part) and _ROW.match(line):
            parts.setdefault(part, []).append(n)
    try:
        rows, cols = (int(re.split(r"\D", said[name])[0]) for name in ("rows", "cols"))
    except (KeyError, ValueError):
        allowed = "whole numbers of both in the header"
        raise InputError(path, "rows, cols", ", ".join(said) or "nothing", allowed) from None
    if (layout.part is None and len(parts) != 1) or (layout.part or 1) > len(parts):
        listed = ", ".join(f"{n} {part}" for n, part in enumerate(parts, 1)) or "none"
        raise InputError(path, "sensors", one_line(listed, 200), f"--part 1..{len(parts)}")
    chosen = list(parts)[(layout.part or 1) - 1]
    for n in parts[chosen]:
        kept[n] = lines[n].rstrip(" \t,;")
    found = Table(path, kept, replace(layout, rows=rows, cols=cols, header=False)).found()
    found.shape, found.order = (rows, cols), "row by row, as the maker writes them"
    found.ignored = [f"sensor {part}" for part in parts if part != chosen]
    step = re.match(NUMBER, said.get("seconds_per_frame", ""))
    if step and found.time is None and found.number is not None:
        found.time, found.time_from = found.number * tables.decimal(step[0]), "seconds_per_frame"
        found.time_unit = "s"
    found.area_mm2 = _area(said)
    found.scale(said.get("units", ""))
    return found


def _emed(path: Path, lines: list[str], layout: Layout) -> Found:
    """Read a list of novel emed: pictures with numbers of rows and columns at their margins, and sums as Force."""
    numbers: list[int] = []
    entries: list[tuple[int, int, int, float]] = []  # picture, row, column, value
    columns: list[str] = []
    sums: list[tuple[float, float]] = []
    inside = False
    for number, line in enumerate(lines, 1):
        cells = line.replace(",", ".").split()
        if match := _PICTURE.match(line):
            if numbers[-1:] != [int(match[1])]:  # else another page of the same picture
                numbers.append(int(match[1]))
            columns, inside = [], True
        elif inside and not columns:
            columns = cells if all(re.fullmatch(r"[0-9]{1,5}|Force", c) for c in cells) else []
        elif inside and cells and re.fullmatch(r"[0-9]{1,5}", cells[0]):
            if len(cells) != len(columns) + 1 or not all(map(tables.is_number, cells)):
                said = f"a row and {len(columns)} values"
                raise InputError(path, f"line {number}", one_line(line, 40), said)
            row, *values = map(float, cells)
            for column, value in zip(columns, values, strict=True):
                if column == "Force":
                    sums.append((sum(values[:-1]), value))
                else:
                    entries.append((len(numbers) - 1, int(row), int(column), value))
        elif columns:
            inside = False
    if not entries:
        raise InputError(path, "pictures", 0, "a picture with numbers of rows and columns")
    picture, *place = np.array([entry[:3] for entry in entries]).T
    low, high = np.min(place, axis=1), np.max(place, axis=1)
    rows, cols = (high - low + 1).tolist()
    if (layout.rows or rows, layout.cols or cols) != (rows, cols):
        low, (rows, cols) = np.array([1, 1]), (layout.rows or high[0], layout.cols or high[1])
        if (high > (rows, cols)).any():
            raise InputError(path, "--rows, --cols", f"{rows}, {cols}", f"at least {high[0]} and {high[1]}")
    tables.bounded(path, len(numbers) * rows * cols)
    # A picture shows the part that is pressed.
    frames = np.zeros((len(numbers), rows, cols))
    frames[picture, place[0] - low[0], place[1] - low[1]] = [entry[3] for entry in entries]
    found = Found(frames, number=np.array(numbers, dtype=float), shape=(rows, cols))
    found.order = f"by the numbers at the margins, rows from {low[0]} and columns from {low[1]}"
    found.ignored = ["Force"]
    head = " ".join(lines[: next(n for n, line in enumerate(lines) if _PICTURE.match(line))])
    if step := re.search(rf"Time(?:/| per )picture:?\s*{NUMBER}\s*(m?s)", head):
        found.time, found.time_from = found.number * tables.decimal(step[1]), "time per picture"
        found.time_unit = step[2]
    if size := re.search(rf"Sensor size\D*{NUMBER}\s*(?:mm|cm)?\s*[x*]\s*{NUMBER}\s*(mm|cm)", head):
        found.area_mm2 = math.prod(tables.decimal(side) * _MM[size[3]] for side in size.groups()[:2])
        # The margins have newtons, so they tell the unit of the values.
        known = [force / total for total, force in sums if force > 1]
        unit_n = np.median(known) / found.area_mm2 if known else 0.0
        factor = next((f for f in (1.0, 10.0) if abs(unit_n * 1e3 / f - 1) < _MARGIN), None)
        if factor is not None:
            found.values, found.unit = frames * factor, "kpa"
    return found


def _area(said: dict[str, str]) -> float | None:
    """Return the area of a sensel in mm2 from the header of a maker."""
    found = {}
    for key in ("row_spacing", "col_spacing", "sensel height", "sensel width", "sensel_area"):
        text = said.get(key, "").lower()
        number, unit = re.search(NUMBER, text), re.search(r"[a-z]+", re.sub(NUMBER, "", text))
        if number and unit and unit[0] in _MM:
            found[key] = tables.decimal(number[0]), _MM[unit[0]]
    if "sensel_area" in found:
        return found["sensel_area"][0] * found["sensel_area"][1] ** 2
    return math.prod(side * mm for side, mm in [*found.values()][:2]) if len(found) >= 2 else None
