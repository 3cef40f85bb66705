# SPDX-License-Identifier: Apache-2.0
"""Tables of text: marks, names of columns, frames with boundaries, and exports of Tekscan and XSENSOR."""

from __future__ import annotations

import codecs
import csv
import math
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.errors import InputError, one_line, quoted
from dermis.scene.stimulus import VALUES_MAX

Floats = NDArray[np.float64]

_TIME = re.compile(
    r"[%#]?(.*[./ _])?(time|t|ts|stamp|timestamp|elapsed|zeit|(nano|micro|milli)?seconds?|[nmu]?s(ecs?)?)([ _.\[(].*)?",
    re.IGNORECASE,
)
_TIME_UNIT = re.compile(
    r"(?:.*[^a-zµμ])?(?:(n)(?:s|secs?|anos?|anosecs?|anoseconds?)|([uµμ])(?:s|secs?)|(micro)s?(?:ec|econd)?s?|"
    r"(m)(?:s|secs?|illis?|illisecs?|illiseconds?)|(s)(?:ecs?|econds?)?)[\])]?"
)
_OTHER = re.compile(
    r"(sum|tot|cop|cent|flag|stat|imu|acc|gyro|mag|quat|temp|seq|ind|idx|id$|frame|count|no$|nr$|n$|unnamed|crc|area|peak|"
    r"max|min|mean|av|std|label|date|volt|batt|sync|trig|event|header|row$|col)",
    re.IGNORECASE,
)
"""Beginnings of names that are known to be no taxel: other columns that are left out are warned of."""
_ROW, _COL = ("r", "row", "y"), ("c", "col", "column", "x")
_EMPTY = {"", "-", "--", "null", "none", "nan", "na", "n/a", "#n/a", "nil", "missing", "b"}
"""Cells without a value; Tekscan writes B where there is no sensel."""
_LABEL = re.compile(r"[\W_]*frame\b[\W_]*(\d{1,9})(.*)", re.IGNORECASE)
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_STAMP = re.compile(r"(\d+[.,]?\d*)\s*(m?s)(ec\w*)?\b")
"""Seconds or milliseconds in the label of a frame."""
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")
# Forces of 1 N have two digits behind the point.
_MARGIN = 0.02
_NUMBERS_SURE = 16
"""A first line 0, 1, 2, ... of fewer values may be a frame, and is asked for."""

KPA = {
    "kpa": 1.0, "pa": 1e-3, "hpa": 0.1, "mbar": 0.1, "bar": 100.0, "mpa": 1e3, "psi": 6.894757293, "mmhg": 0.1333223874,
    "n/cm2": 10.0, "n/mm2": 1e3, "kg/cm2": 98.0665, "kgf/cm2": 98.0665, "g/cm2": 0.0980665,
}  # fmt: skip
"""kPa of a unit of pressure."""
NEWTONS = {
    "n": 1.0,
    "newtons": 1.0,
    "kg": 9.80665,
    "kgf": 9.80665,
    "g": 9.80665e-3,
    "gf": 9.80665e-3,
    "lbs": 4.448222,
}
"""N of a unit of force."""
_MM = {
    "mm": 1.0, "millimeters": 1.0, "cm": 10.0, "centimeters": 10.0, "m": 1e3, "meters": 1e3, "in": 25.4, "inch": 25.4,
    "inches": 25.4,
}  # fmt: skip
PLACES_MAX = 1 << 16
"""The largest array: 256 x 256."""
_PICTURE = re.compile(r"\W*pict-?no\.?:?\s*(\d{1,9})", re.IGNORECASE)


@dataclass(frozen=True)
class Layout:
    """Layout that a file does not state; None: taken from the file.

    Attributes
    ----------
    rows, cols : int or None
    key : str or None
        Array of an npz, mat or HDF5 file; topic, or topic.field, of a bag.
    time_key : str or None
        Array of the times in such a file, or the name or number of the column of a text.
    skip : int or None
        Leading columns of a text that are no taxels.
    time_unit : str or None
        One of `recording.TIME_UNITS`.
    rate_hz : float or None
        Frames a second; overrules times in the file.
    missing : float or None
        Value of a place without a taxel; NaN counts as well.
    gaps : str
        One of `recording.GAPS`.
    axes : tuple or None
        Names of `recording.AXES` in the order of an array, or the number of the part to take along an axis.
    taxels : (int, int) or None
        First and last column of the taxels of a text, from 0.
    part : int or None
        Sensor, or group of names, from 1, where a text has several.
    header : bool or None
        Whether a first line of numbers has numbers of columns.
    """

    rows: int | None = None
    cols: int | None = None
    key: str | None = None
    time_key: str | None = None
    skip: int | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    missing: float | None = None
    gaps: str = "keep"
    axes: tuple[str | int, ...] | None = None
    taxels: tuple[int, int] | None = None
    part: int | None = None
    header: bool | None = None

    @property
    def size(self) -> int | None:
        """Taxels of the array, if rows and columns are given."""
        return self.rows * self.cols if self.rows and self.cols else None


@dataclass(eq=False)
class Found:
    """Content of a file.

    Attributes
    ----------
    values : ndarray
        [lines, taxels], [frames, rows, cols], or the axes of a binary file; NaN where a value is missing.
    time : ndarray or None
        [frames] or [lines], in `time_unit` if that is known.
    start : float
        Added to `time` to give stamps since 1970, where that would lose digits.
    number : ndarray or None
        Numbers of the frames, where the file has them.
    by_line : bool
        A line, or a part of the first axis, is a frame.
    binary : bool
        An array whose axes may be in any order.
    shape : (rows, cols) or None
    unit : str or None
        Of `recording.UNITS`.
    """

    values: Floats
    time: Floats | None = None
    time_unit: str | None = None
    time_from: str = "the file"
    start: float = 0.0
    number: Floats | None = None
    by_line: bool = False
    binary: bool = False
    shape: tuple[int, int] | None = None
    unit: str | None = None
    area_mm2: float | None = None
    order: str = "row by row, as in the file"
    ignored: list[str] = field(default_factory=list)

    def scale(self, unit: str) -> None:
        """Turn values in a unit of pressure or force into kPa or N; any other unit leaves them as they are."""
        unit = re.sub(r'[\s^,;"]', "", unit).lower().replace("²", "2")
        for name, known in (("kpa", KPA), ("newtons", NEWTONS)):
            if unit in known:
                self.values, self.unit = self.values * known[unit], name


def warn(path: Path, text: str) -> None:
    """Warn of a reading that a user must check."""
    warnings.warn(f"{path}: {text}", stacklevel=2)


def decoded(path: Path, data: bytes) -> str:
    """Return text in UTF-8, UTF-16, UTF-32 or Latin-1."""
    marks = {
        codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32", codecs.BOM_UTF16_LE: "utf-16",
        codecs.BOM_UTF16_BE: "utf-16",
    }  # fmt: skip
    kind = next((name for mark, name in marks.items() if data.startswith(mark)), None)
    if kind is None and b"\0" in (start := data[:4096]):
        kind = "utf-16-le" if start[1::2].count(0) > start[::2].count(0) else "utf-16-be"
    try:
        if kind is not None:
            text = data.decode(kind)
        else:
            try:
                text = data.decode("utf-8-sig")
            except UnicodeDecodeError:
                text = data.decode("latin-1")
        if (bad := re.search(r"[\0-\x08\x0e-\x1f]", text)) is None:
            return text
        at = bad.start()
    except UnicodeDecodeError as error:
        at = error.start
    raise InputError(
        path, f"byte {at}", "no text", "a text; npy, npz, mat and HDF5 are known by their suffix"
    )


def read(path: Path, data: bytes, layout: Layout) -> Found:
    """Read a text; InputError where it leaves a question open."""
    lines = decoded(path, data).splitlines()
    head = [line.strip(' ",;\t').lower() for line in lines[:4000]]
    if any(h.startswith("rows") for h in head) and any(_LABEL.match(h) for h in head):
        return _maker(path, lines, layout)
    if any(_PICTURE.match(line) for line in lines):
        return _emed(path, lines, layout)
    return Table(path, lines, layout).found()


# ---- cells


def cells_of(line: str, mark: str | None) -> list[str]:
    """Split a line; brackets of lists are kept."""
    if '"' in line:
        joint = mark or " "
        line = re.sub(
            r'"[^"\[]*(\[[^\]"]*\])[^"]*"', lambda m: joint.join(re.split(r"[,;\s]+(?=[^\s\]])", m[1])), line
        )
        row = (
            next(csv.reader([line], delimiter=joint, skipinitialspace=True))
            if '"' in line
            else line.split(mark)
        )
    else:
        row = line.split(mark)
    return [cell.strip(' \t"') for cell in row]


def _bare(cells: list[str]) -> list[str]:
    return [cell.strip(" []()") for cell in cells]


def _decimal(number: str) -> float:
    """Return a number with a decimal point or comma."""
    return float(number.replace(",", "."))


def _bounded(path: Path, values: int) -> None:
    if values > VALUES_MAX:
        raise InputError(path, "values", values, f"at most {VALUES_MAX}")


def number_of(cell: str) -> float:
    """Return a number, NaN for an empty cell; ValueError for other text."""
    if cell.lower() in _EMPTY:
        return math.nan
    if _COMMA.fullmatch(cell):
        return _decimal(cell)
    if "_" in cell:  # float() takes 1_000
        raise ValueError
    return float(cell)


def _is(cell: str, read=number_of) -> bool:
    try:
        read(cell)
    except ValueError:
        return False
    return True


def _stamp(cell: str) -> float:
    """Return seconds of a clock, or of a date and time; ValueError for other text."""
    dotted = re.match(r"(\d{1,2})\.(\d{1,2})\.(\d{4}|\d\d)\b(.*)", cell)
    if dotted:
        day, month, year, rest = dotted.groups()
        cell = f"{year if len(year) == 4 else '20' + year}-{month:0>2}-{day:0>2}{rest}"
        cell = re.sub(r"(:\d\d),(\d+)$", r"\1.\2", cell)
    if clock := _CLOCK.fullmatch(cell.strip()):
        return int(clock[1]) * 3600 + int(clock[2]) * 60 + _decimal(clock[3])
    time = datetime.fromisoformat(cell) if re.search(r"\D\d\d:\d\d", cell) else None
    if time is None:
        raise ValueError
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def time_unit_of(name: str) -> str | None:
    """Return the unit that the name of a time has, as in time_ms and Time [us]."""
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
    match = _TIME_UNIT.fullmatch(name)
    if match is None:
        return None
    n, u, micro, m, _ = match.groups()
    return "ns" if n else "us" if u or micro else "ms" if m else "s"


def is_time(name: str) -> bool:
    """Return True if a name is that of a time."""
    return bool(_TIME.fullmatch(name)) or bool(_TIME.fullmatch(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)))


# ---- tables


class Table:
    """A table with a frame, or a row of one, in each line."""

    def __init__(self, path: Path, lines: list[str], layout: Layout) -> None:
        self.path, self.layout = path, layout
        filled = [(n, line) for n, line in enumerate(lines, 1) if line.strip(" \t,;")]
        self.mark = _mark_of(filled[-1][1]) if filled else None
        start = next((k for k, (_, line) in enumerate(filled) if self._starts(line)), len(filled))
        self.head, self.lines = [line for _, line in filled[:start]], filled[start:]
        self.block, self.label = self._blocks(lines)
        if not self.lines:
            raise self._ask("lines", "a header only" if filled else 0, "at least one line of numbers")
        # Every line ends with a mark that separates nothing.
        ends = (line.rstrip(" ").endswith(self.mark or "") for _, line in self.lines)
        self.trailing = self.mark is not None and all(ends)
        self.names = self._names()
        self.width, self.count = len(self._cells(self.lines[0][1])), len(self.lines)
        if self.names and len(self.names) != self.width:
            allowed = f"{self.width}, as many as a line has values"
            raise self._ask("header", f"{len(self.names)} names", allowed)
        chosen = (*self.lines[:20], self.lines[-1])
        self.sample = [self._cells(line) for _, line in chosen]
        for (number, _), row in zip(chosen, self.sample, strict=True):
            if len(row) != self.width:
                allowed = f"{self.width} values, as the first line"
                raise self._ask(f"line {number}", f"{len(row)} values", allowed)

    @property
    def words(self) -> list[int]:
        """Columns without a number."""
        return [k for k in range(self.width) if not any(_is(row[k]) for row in self.sample)]

    def _ask(self, key: str, value: object, allowed: str) -> InputError:
        return InputError(self.path, key, value, allowed)

    def _starts(self, line: str) -> bool:
        cells = _bare(cells_of(line, self.mark))
        if line.lstrip().startswith(("#", "%")) or _LABEL.match(line):
            return False
        good = sum(_is(cell) and cell != "" for cell in cells)
        return good > sum(cell != "" for cell in cells) / 2 or (
            good > 0 and any(_is(c, _stamp) for c in cells)
        )

    def _cells(self, line: str) -> list[str]:
        cells = _bare(cells_of(line, self.mark))
        return cells[:-1] if self.trailing and len(cells) > 1 and cells[-1] == "" else cells

    def _blocks(self, lines: list[str]) -> tuple[NDArray, dict[int, tuple[int, float]]]:
        """Return the block of every line, and number and time (or NaN) of labels; drop lines that only part blocks."""
        kept, block, labels, number = [], [], {}, 0
        known = dict(self.lines)
        first = min(known, default=len(lines) + 1)
        early = [line for line in self.head if _LABEL.match(line)][-1:] if known else []
        for n, line in [(0, line) for line in early] + list(enumerate(lines[first - 1 :], first)):
            label = _LABEL.match(line)
            words = line.split(None, 1)[:1] if block and n in known and line.lstrip()[:1].isalpha() else []
            if words and is_time(words[0]) and not self._starts(line) and line not in self.head:
                warn(self.path, f"another table begins at line {n}, and is left out: {one_line(line, 40)}")
                break
            # MVP and MPP of novel are the mean and the largest of each column.
            apart = label or line.lstrip().startswith(("#", "%", "MVP", "MPP")) or line in self.head
            if n in known and not apart:
                kept.append((n, line))
                block.append(number)
                continue
            number += bool(block) and block[-1] == number
            if label:
                stamp = _STAMP.search(label[2])
                scale = 1e-3 if stamp and stamp[2] == "ms" else 1.0
                labels[number] = int(label[1]), _decimal(stamp[1]) * scale if stamp else math.nan
        self.lines = kept
        return np.array(block, int), labels

    def _names(self) -> list[str]:
        """Return the names of the columns, or none."""
        first = cells_of(self.lines[0][1], self.mark)
        width, lists, start = len(first), [], None
        for k, cell in enumerate(first):
            if cell.startswith("["):
                start = k
            if cell.endswith("]") and start is not None:
                lists.append((start, k - start + 1))
                start = None
        plain = self._cells(self.lines[0][1])
        for head in reversed(self.head):
            names = cells_of(head.lstrip("# "), self.mark)
            if len(names) in (width, len(plain)) and len(names) > 1:
                return self._trimmed(names, width)
            # A list in one column, as ROS tools write arrays.
            for k, count in lists:
                if k < len(names):
                    names[k : k + 1] = [f"{names[k]}[{n}]" for n in range(count)]
            if lists and len(names) == width:
                return names
        last = next((h for h in reversed(self.head) if not h.lstrip().startswith(("#", "%"))), "")
        short = len(cells_of(last, self.mark)) > 1 and not _LABEL.match(last)
        numbered = self.layout.header is not False and not (short and len(plain) < _NUMBERS_SURE)
        if numbered and self._is_numbered(plain):
            self.lines, self.block = self.lines[1:], self.block[1:]
            if not self.lines:
                raise self._ask("lines", "a header only", "at least one line of numbers")
            return first[: len(plain)]
        if self.layout.header:
            raise self._ask(
                "header", one_line(self.lines[0][1]), "names or numbers of columns, or --header no"
            )
        if short:
            allowed = f"{len(plain)}, as many as the line below it has values"
            raise self._ask("header", f"{len(cells_of(last, self.mark))} names", allowed)
        return []

    def _trimmed(self, names: list[str], width: int) -> list[str]:
        if self.trailing:
            # The mark at the end of every line separates nothing if the header has no name there.
            self.trailing = len(names) == width - 1 or not names[-1]
        return names[:-1] if self.trailing and len(names) == width and not names[-1] else names

    def _is_numbered(self, cells: list[str]) -> bool:
        """Return True for a first line of numbers of columns: 0, 1, 2, ... or 1, 2, 3, ..."""
        numbers = Counter(int(c) for c in cells if re.fullmatch(r"\d{1,6}", c))
        words = [c for c in cells if not re.fullmatch(r"\d{1,6}", c)]
        if len(numbers) < 2 or len(set(numbers.values())) > 1 or any(_is(c) and c for c in words):
            return False
        consecutive = min(numbers) in (0, 1) and max(numbers) - min(numbers) + 1 == len(numbers)
        # Beside a name, as novel writes time[secs] and the numbers of its sensors, any numbers that rise are names.
        if not consecutive and not (any(words) and list(numbers) == sorted(numbers)):
            return False
        below = self._cells(self.lines[1][1]) if len(self.lines) > 1 else []
        if words and any(not _is(c) or not c for c in below[:1] if not words[0]):
            return False
        if words and len(below) == len(cells):
            return (
                any(_is(b) and b for b, c in zip(below, cells, strict=True) if c in words)
                or self.layout.header
            )
        if self.layout.header:
            return True
        try:
            steps = {number_of(b) - number_of(a) for a, b in zip(cells, below, strict=False)}
        except ValueError:
            steps = set()
        if steps == {0.0} and len(cells) < _NUMBERS_SURE:
            return False
        if len(numbers) < _NUMBERS_SURE or len(steps) == 1:
            allowed = "--header yes if these are numbers of columns, --header no if it is data"
            raise self._ask("line 1", one_line(self.lines[0][1], 40), allowed)
        warn(
            self.path, "the first line has the numbers of the columns and is no frame; --header no otherwise"
        )
        return True

    # ---- columns

    def found(self) -> Found:
        layout = self.layout
        chosen = self._chosen()
        keys = self._times(chosen)
        row_key = frame_key = None
        if self.names:
            order, columns, shape, by_line = self._by_names(chosen, keys)
            if not by_line:
                lower = [name.lower() for name in self.names]
                row_key = next((lower.index(w) for w in ("row", "r") if w in lower), None)
                frame_key = next(
                    (lower.index(w) for w in ("frame", "frame_id", "sample") if w in lower), None
                )
        else:
            order, columns, shape, by_line = self._unnamed(chosen, keys)
        extra = [k for k in (row_key, frame_key) if k is not None]
        _bounded(self.path, self.count * len(columns))
        table, moments = self._parsed([*extra, *(c for c in columns if c is not None)], keys)
        values = np.full((self.count, len(columns)), np.nan)
        values[:, [n for n, c in enumerate(columns) if c is not None]] = table[:, len(extra) :]
        said = [self.names[k] or f"column {k}" if self.names else f"column {k}" for k in range(self.width)]
        out = [k for k in range(self.width) if k not in columns and k not in keys and k not in extra]
        strange = [
            said[k]
            for k in out
            if self.names
            and said[k]
            and not _OTHER.match(re.split(r"[./]", said[k])[-1])
            and not is_time(said[k])
        ]
        if len(strange) > max(8, len(columns) / 4) and chosen is None and not layout.part:
            shown = one_line(", ".join(strange[:4]), 80)
            raise self._ask(
                "header", f"{len(strange)} columns as {shown}", "--taxels FIRST..LAST by number, or --part N"
            )
        if strange and chosen is None and not layout.part:
            warn(self.path, f"columns that are taken for no taxels: {one_line(', '.join(strange[:8]), 200)}")
        found = Found(values, by_line=by_line, shape=shape, order=order, ignored=[said[k] for k in out])
        if keys:
            found.time_from = " and ".join(said[k] for k in keys)
            self._timed(found, moments, keys)
        stated = re.search(r"pressure values in\s+(\S+)", "\n".join(self.head), re.IGNORECASE)
        if stated is not None:
            found.scale(stated[1])
        self._counters(out)
        if row_key is not None:
            return self._rows(found, table[:, 0], table[:, 1] if frame_key is not None else found.time)
        return self._framed(found)

    def _chosen(self) -> list[int] | None:
        """Return the columns that options name for taxels."""
        layout = self.layout
        if layout.taxels is not None:
            low, high = layout.taxels
            if high >= self.width:
                raise self._ask("--taxels", f"{low}..{high}", f"columns 0..{self.width - 1}")
            return list(range(low, high + 1))
        if layout.skip is None:
            return None
        if layout.skip >= self.width:
            raise self._ask("--skip", layout.skip, f"less than the {self.width} columns")
        return list(range(layout.skip, self.width))

    def _times(self, chosen: list[int] | None) -> list[int]:
        """Return the column of the time, or those of seconds and nanoseconds."""
        key, names, first = self.layout.time_key, self.names, self.sample[0]
        if key is not None:
            if key in names:
                return [names.index(key)]
            if re.fullmatch(r"\d+", key) and int(key) < self.width:
                return [int(key)]
            allowed = "a name of the header, or a number of a column from 0: " + ", ".join(names[:8])
            raise self._ask("--time-key", key, allowed)
        timed = [k for k in range(self.width) if _is(first[k], _stamp) or (_is(first[k]) and first[k])]
        if names:
            counts = Counter(_template(name)[0] for name in names)
            for k in timed:
                # ROS: stamp.sec and stamp.nanosec, secs and nsecs.
                fine = re.fullmatch(r"(.*?)(nano|n)(secs?|seconds?)", names[k], re.IGNORECASE)
                pair = [
                    j
                    for j in timed
                    if fine and re.fullmatch(re.escape(fine[1]) + "(secs?|seconds?|s)", names[j], re.I)
                ]
                if pair:
                    return [pair[0], k]
            named = [k for k in timed if is_time(names[k]) and counts[_template(names[k])[0]] < 4]
            return named[:1]
        stamps = [k for k in timed if not _is(first[k])]
        if stamps:
            return stamps[:1]
        # Whole seconds since 1970 with nanoseconds beside them, or a stamp since 1970: no taxel has 1e9.
        columns = [[row[k] for row in self.sample] for k in range(min(4, self.width))]
        whole = [all(re.fullmatch(r"\d+", c) for c in column) for column in columns]
        for k, column in enumerate(columns):
            if chosen is not None and k in chosen:
                continue
            if not all(_is(c) and number_of(c) > 1e9 for c in column):
                continue
            after = columns[k + 1] if k + 1 < len(columns) and whole[k + 1] else []
            if (
                whole[k]
                and after
                and len(column[0]) == 10
                and all(int(c) < 10**9 for c in after)
                and max(map(int, after)) > 1e6
            ):
                return [k, k + 1]
            return [k]
        return []

    def _by_names(self, chosen: list[int] | None, keys: list[int]):
        """Return order, columns by place (None: no taxel), shape or None, and True if a line is a frame."""
        layout = self.layout
        groups: dict[tuple, list[int]] = {}
        seen: Counter = Counter()
        for k in range(self.width) if chosen is None else chosen:
            text, numbers = _template(self.names[k])
            if k in keys or (not numbers and chosen is None) or (k in self.words and chosen is None):
                continue
            seen[text, numbers] += 1
            groups.setdefault((text, seen[text, numbers]), []).append(k)
        for (text, again), columns in groups.items():
            if again > 1 and len(columns) < len(groups[text, 1]) / 2:
                raise self._ask(
                    "header", f"the name {self.names[columns[0]]} twice", "--taxels FIRST..LAST by number"
                )
        size = layout.size
        large = max(map(len, groups.values()), default=0)
        parts = [g for g in groups if 2 * len(groups[g]) >= large > 1 or len(groups[g]) == size]
        fitting = [g for g in parts if len(groups[g]) == size]
        if layout.part is not None:
            parts = parts[layout.part - 1 : layout.part]
        elif len(fitting) == 1:
            parts = fitting
        if chosen is not None and (len(groups) != 1 or not next(iter(groups))[0].count("#")):
            warn(self.path, "names do not say the places of the chosen columns; taken row by row")
            return "row by row, as in the file", chosen, None, True
        if len(parts) != 1:
            listed = (
                ", ".join(f"{len(groups[g])} of {self.names[groups[g][0]]}" for g in parts[:6])
                or "no numbers"
            )
            raise self._ask(
                "header", listed, "--part N for one of several arrays, or --taxels FIRST..LAST by number"
            )
        columns = groups[parts[0]]
        numbers = np.array([[min(n, PLACES_MAX) for n in _template(self.names[k])[1]] for k in columns])
        if numbers.max() >= PLACES_MAX:
            raise self._ask(
                "header", self.names[columns[0]], f"numbers below {PLACES_MAX}, or --taxels FIRST..LAST"
            )
        texts = re.split("#", parts[0][0])
        changing = [d for d in range(numbers.shape[1]) if len(set(numbers[:, d])) > 1]
        words = [
            re.split(r"[^a-z]+", texts[d])[-1] or re.split(r"[^a-z]+", texts[d].strip(" _.[](),-"))[-1]
            for d in changing
        ]
        numbers = numbers[:, changing]
        if len(changing) == 1:
            return self._flat(columns, numbers[:, 0], words[0])
        between = texts[changing[0] + 1] if changing else ""
        plain = not re.search("[a-z]", between)
        if len(changing) == 2 and words[0] in _COL and words[1] in _ROW:
            numbers = numbers[:, ::-1]
        elif len(changing) != 2 or not (plain or (words[0] in _ROW and words[1] in _COL)):
            raise self._ask(
                "header", self.names[columns[0]], "names with row and column, or --taxels FIRST..LAST"
            )
        low = numbers.min(axis=0)
        if (low > 1).any():
            raise self._ask(
                "header", self.names[columns[0]], "rows and columns from 0 or 1, or --taxels FIRST..LAST"
            )
        numbers = numbers - low.min()
        rows, cols = (layout.rows or numbers[:, 0].max() + 1), (layout.cols or numbers[:, 1].max() + 1)
        if (numbers >= (rows, cols)).any():
            raise self._ask(
                "header",
                f"{self.names[columns[-1]]}",
                f"places in {rows} x {cols}, or other --rows and --cols",
            )
        if min(rows, cols) <= 2 and max(rows, cols) > 32 and not (layout.rows and layout.cols):
            raise self._ask(
                "header", f"{rows} x {cols} places", "--rows and --cols, or --taxels for one of two arrays"
            )
        if rows * cols > PLACES_MAX:
            raise self._ask("header", f"{rows} x {cols} places", f"at most {PLACES_MAX}")
        places: list[int | None] = [None] * (rows * cols)
        for k, (r, c) in zip(columns, numbers.tolist(), strict=True):
            places[r * cols + c] = k
        if None in places:
            warn(self.path, f"{places.count(None)} of {rows} x {cols} places have no column: no taxel there")
        return f"by names, {self.names[columns[0]]} first", places, (rows, cols), True

    def _flat(self, columns: list[int], numbers: NDArray, word: str):
        """Return the layout of names with one number."""
        low, count = int(numbers.min()), len(columns)
        size = self.layout.size
        if low > 1 or sorted(numbers.tolist()) != list(range(low, low + count)):
            if (
                size is not None
                and (numbers.max() == size or (low == 0 and numbers.max() < size))
                and count < size
            ):
                # Numbers of places in the array: those without a column have no taxel.
                places: list[int | None] = [None] * size
                for k, n in zip(columns, (numbers - (numbers.max() == size)).tolist(), strict=True):
                    places[n] = k
                warn(self.path, f"{size - count} of {size} numbers have no column: no taxel there")
                return f"by names, {self.names[columns[0]]} first, row by row", places, None, True
            lost = sorted(set(range(int(numbers.max()) + 1)) - set(numbers.tolist()) - {0})
            said = f"{count} names as {self.names[columns[0]]}, {f'not {lost[0]}' if lost else f'from {low}'}"
            allowed = (
                "numbers from 0 or 1 without a gap, --rows and --cols that have the last one, or --taxels"
            )
            raise self._ask("header", said, allowed)
        ordered = [columns[k] for k in np.argsort(numbers)]
        # A data frame of rows names its columns by numbers.
        a_row = count != size and (
            word in _COL or (self.names[columns[0]].isdigit() and count == self.layout.cols)
        )
        if word in (*_COL, *_ROW) and size is None and "row" not in [n.lower() for n in self.names]:
            if self.layout.cols != count or word in _ROW:
                allowed = "--rows and --cols: a line may be a row of a frame, or a frame"
                raise self._ask("header", f"{count} columns {self.names[ordered[0]]}..", allowed)
        if size is not None and count != size and not (a_row and count == self.layout.cols):
            allowed = f"{size}, as --rows {self.layout.rows} --cols {self.layout.cols} say"
            raise self._ask("columns", f"{count} taxels", allowed)
        return f"by names, {self.names[ordered[0]]} first, row by row", ordered, None, not a_row

    def _unnamed(self, chosen: list[int] | None, keys: list[int]):
        """Return the layout of columns without names, as `_by_names`."""
        rows, cols = self.layout.rows, self.layout.cols
        inside = range(self.width) if chosen is None else chosen
        left = [k for k in inside if k not in keys and k not in self.words]
        if self.layout.axes is not None:
            good = True
        elif rows and cols:
            good = len(left) in (rows * cols, cols)
        else:
            frames = len(set(self.block.tolist())) > 1 and len(self.lines) > self.block[-1] + 1
            good = square(len(left)) or frames or (bool(rows or cols) and len(left) % (rows or cols) == 0)
        if not left or not good:
            allowed = (
                "--rows and --cols; --skip N, --taxels FIRST..LAST for those that are taxels; --time-key N"
            )
            raise self._ask("columns", f"{len(left)} without names", allowed)
        return "row by row, as in the file", left, None, bool(keys)

    def _parsed(self, columns: Sequence[int], keys: list[int]) -> tuple[Floats, list[list[str]]]:
        """Return the values of columns, and the cells of the times, by line."""
        table = np.empty((self.count, len(columns)))
        moments: list[list[str]] = []
        comma = point = False
        for i, (number, line) in enumerate(self.lines):
            plain = not any(mark in line for mark in '"[(')
            cells = line.split(self.mark) if plain else self._cells(line)
            if len(cells) - (plain and self.trailing) != self.width:
                raise self._ask(f"line {number}", f"{len(cells)} values", f"{self.width}, as the first line")
            try:
                if "_" in line:
                    raise ValueError
                table[i] = [float(cells[k]) for k in columns]
            except ValueError:
                cells = self._cells(line)
                table[i] = self._numbers([cells[k] for k in columns], columns, f"line {number}")
                comma = comma or any("," in cells[k] for k in columns)
            if comma or i == 0:
                point = point or any("." in cells[k] for k in columns)
            if keys:
                moments.append(_bare([cells[k].strip() for k in keys]))
        if comma and (point or any("." in self._cells(line)[k] for _, line in self.lines for k in columns)):
            raise self._ask("numbers", "decimal commas and points", "one of them")
        return table, moments

    def _numbers(self, cells: Sequence[str], columns: Sequence[int], where: str) -> list[float]:
        found = []
        for k, cell in zip(columns, cells, strict=True):
            try:
                found.append(number_of(cell))
            except ValueError:
                allowed = "a number; --skip or --taxels leave out columns"
                raise self._ask(f"{where}, value {k + 1}", quoted(cell), allowed) from None
        return found

    def _timed(self, found: Found, moments: list[list[str]], keys: list[int]) -> None:
        """Add the times of the cells in `keys`, and their unit if it is known."""
        cells = [row[0] for row in moments]
        whole = all(re.fullmatch(r"-?\d{1,19}", c) for row in moments for c in row)
        if len(keys) == 2:
            if not whole:
                raise self._ask("time", " ".join(moments[0]), "whole seconds and nanoseconds, or --time-key")
            ns = [int(s) * 10**9 + int(n) for s, n in moments]
            found.time, found.time_unit = np.array([t - ns[0] for t in ns], dtype=float) * 1e-9, "s"
            return
        filled = [c for c in cells if c.lower() not in _EMPTY]
        read = number_of if not filled or _is(filled[0]) else _stamp
        if bad := next((c for c in filled if not _is(c, read)), None):
            raise self._ask("time", quoted(bad), "a date and time, a clock, or a number, in every line")
        if whole and abs(int(cells[0])) > 2**52:
            # Differences of whole stamps are exact; a double holds nanoseconds since 1970 to 256 ns.
            found.start = float(cells[0])
            found.time = np.array([int(c) - int(cells[0]) for c in cells], dtype=float)
        else:
            found.time = np.array([math.nan if c.lower() in _EMPTY else read(c) for c in cells])
        if read is _stamp:
            found.time, found.time_unit = past_midnight(found.time), "s"
        elif self.names:
            found.time_unit = time_unit_of(self.names[keys[0]])

    def _counters(self, out: list[int]) -> None:
        """Warn of lost numbers in a counter of frames."""
        for k in out:
            name = self.names[k].lower() if self.names else ""
            if re.fullmatch(
                r"(.*[._ /])?(seq|frame|frame_?(no|nr|number|id)|counter|sample|index|idx)", name
            ):
                column = self._column(k)
                steps = (
                    np.diff([int(c) for c in column]) if all(re.fullmatch(r"\d+", c) for c in column) else []
                )
                if len(steps) and (steps > 1).any() and (steps == 1).any():
                    lost = int((steps[steps > 1] - 1).sum())
                    warn(self.path, f"{self.names[k]} leaves out {lost} numbers: frames lost?")

    def _column(self, k: int) -> list[str]:
        return [row[k] for _, line in self.lines if len(row := self._cells(line)) > k]

    # ---- frames of several lines

    def _rows(self, found: Found, row: Floats, frame: Floats | None) -> Found:
        """Return frames from lines with the number of their row."""
        path = self.path
        if not (np.isfinite(row).all() and (row == np.floor(row)).all() and row.min() in (0, 1)):
            raise self._ask("row", float(row.min()), "whole numbers from 0 or 1")
        place = (row - row.min()).astype(int)
        if frame is None:
            new = np.diff(place) <= 0
        else:
            new = np.diff(frame) != 0
        index = np.concatenate([[0], np.cumsum(new)]).astype(int)
        rows = self.layout.rows or int(place.max()) + 1
        if (index[-1] + 1) * rows * found.values.shape[1] > VALUES_MAX:
            raise self._ask("row", int(row.max()), f"at most {VALUES_MAX} values in all")
        if place.max() >= rows:
            raise self._ask("row", int(row.max()), f"{rows} rows, as --rows says")
        filled = np.zeros((index[-1] + 1, rows), int)
        np.add.at(filled, (index, place), 1)
        if (filled > 1).any():
            n, r = np.argwhere(filled > 1)[0]
            raise self._ask(f"frame {n}", f"row {r} twice", "each row once in a frame")
        for n in np.flatnonzero((filled == 0).any(axis=1))[:8]:
            warn(
                path,
                f"frame {n} has no row {', '.join(map(str, np.flatnonzero(filled[n] == 0)[:8]))}: missing there",
            )
        values = np.full((*filled.shape, found.values.shape[1]), np.nan)
        values[index, place] = found.values
        found.values, found.shape = values, values.shape[1:]
        first = np.concatenate([[True], new])
        found.time = None if found.time is None else found.time[first]
        return found

    def _framed(self, found: Found) -> Found:
        """Return frames from blocks of lines; a block of another height is a lost frame."""
        layout, (lines, width) = self.layout, found.values.shape
        heights = np.bincount(self.block)
        height, blocks = Counter(heights.tolist()).most_common(1)[0]
        if found.shape or found.by_line or width == layout.size or len(heights) == 1 or height == 1:
            found.by_line = found.by_line or width == layout.size or (len(heights) > 1 and height == 1)
            if not found.by_line and layout.rows and layout.cols == width and lines > layout.rows:
                warn(self.path, "nothing parts the frames: a lost line would shift all later ones")
            return found
        if layout.rows and layout.cols == width and layout.rows in heights:
            height, blocks = layout.rows, len(heights)
        said = f"{height} lines of {width} values"
        if (layout.rows or height, layout.cols or width) != (height, width) or 2 * blocks <= len(heights):
            raise self._ask("blocks", said, "frames of --rows and --cols, with as many lines")
        if square(width) and width != height and not layout.rows and width >= 36:
            raise self._ask("blocks", said, "--rows and --cols of a frame")
        whole = heights == height
        for n in np.flatnonzero(~whole):
            name = self.label[n][0] if n in self.label else n
            warn(self.path, f"frame {name} has {heights[n]} of {height} lines: missing as a whole")
        values = np.full((len(heights), height, width), np.nan)
        values[whole] = found.values[whole[self.block]].reshape(-1, height, width)
        found.values, found.shape = values, (height, width)
        if found.time is not None:
            found.time = found.time[np.searchsorted(self.block, np.arange(len(heights)))]
        if len(self.label) == len(heights):
            found.number, time = np.array([self.label[n] for n in range(len(heights))], dtype=float).T
            if found.time is None and np.isfinite(time).all():
                found.time, found.time_unit = past_midnight(time), "s"
                found.time_from = "stamps of the frames"
        return found


def past_midnight(time: Floats) -> Floats:
    """Return times in seconds of a clock that starts again at midnight."""
    return time + 86400.0 * np.cumsum(np.diff(time, prepend=time[0]) < -43200)


def square(count: int) -> bool:
    return count > 0 and round(count**0.5) ** 2 == count


def _template(name: str) -> tuple[str, tuple[int, ...]]:
    parts = re.split(r"(\d+)", name)
    return "#".join(parts[::2]).lower(), tuple(int(n) if len(n) < 19 else PLACES_MAX for n in parts[1::2])


def _mark_of(line: str) -> str | None:
    """Return the character between the cells of a line; None: spaces."""
    line = re.sub(r'"[^"]*"', "q", line)
    if mark := next((m for m in (";", "\t", "|") if m in line), None):
        return mark
    if "," in line and re.search(r"\d,\d+\s+[-+\d]", line) and not re.search(r",\s", line):
        return None  # 0,5 1,5: decimal commas between spaces
    return "," if "," in line else None


# ---- makers


def _maker(path: Path, lines: list[str], layout: Layout) -> Found:
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
        if label := _LABEL.match(line):
            stamp = _STAMP.search(label[2])
            kept[n], at, part = f"#frame:{label[1]}" + (f"({stamp[0]})" if stamp else ""), n, ""
        elif match := known.match(line):
            said.setdefault(match[1].lower().replace("columns", "cols"), match[2])
        elif at is not None and line.lower().startswith(("sensor", "group")):
            part = None if line.lower().startswith("group") else line[7:].strip(" ,;\t")
        elif at is not None and line.lower().startswith("time") and (clock := _CLOCK.search(line)):
            kept[at] += f"({_stamp(clock[0])!r}s)"
        elif (
            None not in (at, part) and re.match(r"[-+.\dB]", line) and not re.search(r"[a-zA-DF-Z]{2}", line)
        ):
            parts.setdefault(part, []).append(n)
    try:
        rows, cols = (int(re.split(r"\D", said[name])[0]) for name in ("rows", "cols"))
    except (KeyError, ValueError):
        allowed = "whole numbers of both in the header"
        raise InputError(path, "rows, cols", ", ".join(said) or "nothing", allowed) from None
    if (layout.rows or rows, layout.cols or cols) != (rows, cols):
        allowed = f"{rows} and {cols}, as the file says"
        raise InputError(path, "--rows, --cols", f"{layout.rows}, {layout.cols}", allowed)
    if (layout.part is None and len(parts) != 1) or (layout.part or 1) > len(parts):
        listed = ", ".join(f"{n} {part}" for n, part in enumerate(parts, 1)) or "none"
        raise InputError(path, "sensors", one_line(listed, 200), f"--part 1..{len(parts)}")
    chosen = list(parts)[(layout.part or 1) - 1]
    for n in parts[chosen]:
        kept[n] = lines[n].rstrip(" \t,;")
    found = Table(path, kept, replace(layout, rows=rows, cols=cols, header=False)).found()
    found.order = "row by row, as the maker writes them"
    found.ignored = [f"sensor {part}" for part in parts if part != chosen]
    if found.time is None and found.number is not None:
        if step := re.match(r"[\d.,]+", said.get("seconds_per_frame", "")):
            found.time, found.time_from = found.number * _decimal(step[0]), "seconds_per_frame"
            found.time_unit = "s"
    found.area_mm2 = _area(said)
    found.scale(said.get("units", ""))
    return found


def _emed(path: Path, lines: list[str], layout: Layout) -> Found:
    """Read a list of novel emed: pictures with numbers of rows and columns at their margins, and sums as Force."""
    frames: list[tuple[int, dict[tuple[int, int], float]]] = []
    columns: list[str] = []
    sums: list[tuple[list[float], float]] = []
    inside = False
    for number, line in enumerate(lines, 1):
        cells = line.replace(",", ".").split()
        if match := _PICTURE.match(line):
            if not frames or frames[-1][0] != int(match[1]):  # else another page of the same picture
                frames.append((int(match[1]), {}))
            columns, inside = [], True
        elif inside and not columns:
            columns = cells if cells and all(re.fullmatch(r"[0-9]{1,5}|Force", c) for c in cells) else []
        elif inside and cells and re.fullmatch(r"[0-9]{1,5}", cells[0]):
            if len(cells) != len(columns) + 1 or not all(map(_is, cells)):
                raise InputError(
                    path, f"line {number}", one_line(line, 40), f"a row and {len(columns)} values"
                )
            if columns[-1] == "Force":
                sums.append(([float(cell) for cell in cells[1:-1]], float(cells[-1])))
            for column, cell in zip(columns, cells[1:], strict=True):
                if column != "Force":
                    frames[-1][1][int(cells[0]), int(column)] = float(cell)
        elif columns:
            inside = False
    places = np.array([at for _, frame in frames for at in frame])
    if not places.size:
        raise InputError(path, "pictures", 0, "a picture with numbers of rows and columns")
    low, high = places.min(axis=0), places.max(axis=0)
    rows, cols = (high - low + 1).tolist()
    if (layout.rows or rows, layout.cols or cols) != (rows, cols):
        low, (rows, cols) = np.array([1, 1]), (layout.rows or high[0], layout.cols or high[1])
        if (high > (rows, cols)).any():
            raise InputError(path, "--rows, --cols", f"{rows}, {cols}", f"at least {high[0]} and {high[1]}")
    _bounded(path, len(frames) * rows * cols)
    # A picture shows the part that is pressed.
    values = np.zeros((len(frames), rows, cols))
    for n, (_, frame) in enumerate(frames):
        for (r, c), value in frame.items():
            values[n, r - low[0], c - low[1]] = value
    head = " ".join(lines[: lines.index(next(line for line in lines if _PICTURE.match(line)))])
    found = Found(
        values, number=np.array([n for n, _ in frames], dtype=float), shape=(rows, cols), time_unit="s"
    )
    found.order = f"by the numbers at the margins, rows from {low[0]} and columns from {low[1]}"
    found.ignored = ["Force"]
    if step := re.search(r"Time(?:/| per )picture:?\s*([\d.,]+)\s*(m?s)", head):
        scale = 1e-3 if step[2] == "ms" else 1.0
        found.time, found.time_from = (
            found.number * _decimal(step[1]) * scale,
            "time per picture",
        )
    if size := re.search(r"Sensor size\D*([\d.,]+)\s*(?:mm|cm)?\s*[x*]\s*([\d.,]+)\s*(mm|cm)", head):
        found.area_mm2 = math.prod(_decimal(side) * _MM[size[3]] for side in size.groups()[:2])
        # The margins have newtons, so they tell the unit of the values.
        known = [(sum(values), force) for values, force in sums if force > 1]
        unit_n = np.median([force / total for total, force in known]) / found.area_mm2 if known else 0.0
        factor = next((f for f in (1.0, 10.0) if abs(unit_n * 1e3 / f - 1) < _MARGIN), None)
        if factor is not None:
            found.values, found.unit = values * factor, "kpa"
    return found


def _area(said: dict[str, str]) -> float | None:
    """Return the area of a sensel in mm2 from the header of a maker."""
    found = []
    for key in ("row_spacing", "col_spacing", "sensel height", "sensel width", "sensel_area"):
        number, unit = (
            re.search(r"\d+([.,]\d+)?", said.get(key, "")),
            re.search(r"[a-z]+", said.get(key, "").lower()),
        )
        if number and unit and unit[0] in _MM:
            found.append((key, _decimal(number[0]), _MM[unit[0]]))
    if found and found[-1][0] == "sensel_area":
        return found[-1][1] * found[-1][2] ** 2
    return found[0][1] * found[0][2] * found[1][1] * found[1][2] if len(found) >= 2 else None
