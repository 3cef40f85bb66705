# SPDX-License-Identifier: Apache-2.0
"""Tables of text: marks, names of columns, frames with boundaries."""

import codecs
import contextlib
import csv
import functools
import math
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.errors import InputError, one_line, quoted
from dermis.ndarrays import Floats
from dermis.scene.stimulus import VALUES_MAX

_WORDS = r"times?|t|ts|stamp|timestamps?|datetime|epoch|elapsed|zeit|uhrzeit|minutes|hours|mi(lli|cro)s|[nmu]?s(ecs?)?"
_WORDS += "|(nano|micro|milli)?seconds?"
_CLOCKED = rf"[%#]?(.*[./ _])?({_WORDS})"
_TIME = re.compile(_CLOCKED + r"([ _.\[(].*)?", re.IGNORECASE)
_BARE_TIME = re.compile(_CLOCKED, re.IGNORECASE)
_TIME_UNIT = re.compile(
    r"(?:.*[^a-zµμ])?(?:(?P<ns>n)(?:s|secs?|anos?|anosecs?|anoseconds?)|(?P<us>[uµμ](?:s|secs?)|micros?(?:ec|econd)?s?)|"
    r"(?P<ms>m)(?:s|secs?|illis?|illisecs?|illiseconds?)|(?P<s>s)(?:ecs?|econds?)?|(?P<min>min)(?:s|utes?)?|"
    r"(?P<h>h)(?:rs?|ours?)?|(?P<d>d)(?:ays?)?)[\])]?"
)
NUMBER = r"((?:\d+[.,]?\d*|(?<![\w)])[.,]\d+)(?:[eE][-+]?\d+)?)"
_OTHER = re.compile(
    r"(sum|tot|cop|cent|flag|stat|imu|acc|gyro|mag|quat|temp|seq|ind|idx|id$|frame|count|no$|nr$|n$|unnamed|crc|area|peak|"
    r"max|min|mean|av|std|label|date|volt|batt|sync|trig|event|header|row$|col)",
    re.IGNORECASE,
)
"""Beginnings of names that are known to be no taxel: other columns that are left out are warned of."""
ROW, COL = ("r", "row", "rows", "y", "height"), ("c", "col", "cols", "column", "columns", "x", "width")
"""Words for the number of a row and that of a column."""
_MARKS = {
    "utf-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE), "utf-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE),
}  # fmt: skip
_EMPTY = {"", "-", "--", "null", "none", "nan", "na", "n/a", "#n/a", "nil", "missing", "b"}
"""Cells without a value; Tekscan writes B where there is no sensel."""
_COUNTER = re.compile(
    r"(.*[._ /])?(seq|frame(_?(no|nr|number|id))?|counter|sample|index|idx)|id|no|nr|n|unnamed.*|",
    re.IGNORECASE,
)
LABEL = re.compile(r"[\W_]*frame\b[\W_]*(\d{1,9})(.*)", re.IGNORECASE)
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
STAMP = re.compile(NUMBER + r"\s*(m?s)(ec\w*)?\b")
"""Seconds or milliseconds in the label of a frame."""
CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")
_WHOLE_S = re.compile(r"\d{1,12}|(.*[ T])?\d{1,2}:\d\d:\d\d(\s*[AP]M)?", re.IGNORECASE)
"""A number, or a clock with or without a date, that may have the part of a second in another column."""
_DATE = re.compile(r"\d{4}[-/]\d\d[-/]\d\d|\d{1,2}[./]\d{1,2}[./]\d{2,4}|\d{1,2}-[A-Za-z]{3}-\d{4}")
"""A date in a column beside that of the clock."""
_DATED = re.compile(r"\d{1,4}[-/. ]\w{1,3}[-/. ]\d{1,4}|[A-Za-z]{3,9} \d{1,2}(,? \d{4})?")
"""Any date, also one that may be read in two ways."""
_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec".split()
_DAY_FIRST = re.compile(r"(\d{1,2})(?:-([A-Za-z]{3})-(\d{4})|\.(\d{1,2})\.(\d{4}|\d\d)\b)")
"""04-Mar-2024, 4.3.2024 and 04.03.24."""
_DIGITS = re.compile(r"((?:19|20)\d\d)(\d\d)(\d\d)T?(\d\d)(\d\d)(\d\d(?:\.\d+)?)Z?")
"""Date and time without marks, as in 20240304100000.02."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
"""Seconds of the units of `--time-unit`."""
PER_SECOND = {"ms": 10**3, "us": 10**6, "ns": 10**9}
_NUMBERS_SURE = 16
"""A first line 0, 1, 2, ... of fewer values may be a frame, and is asked for."""

FACTORS = {
    "kpa": {
        "kpa": 1.0, "pa": 1e-3, "hpa": 0.1, "mbar": 0.1, "bar": 100.0, "mpa": 1e3, "psi": 6.894757293,
        "mmhg": 0.1333223874, "n/cm2": 10.0, "n/mm2": 1e3, "kg/cm2": 98.0665, "lbf/in2": 6.894757293,
        "kgf/cm2": 98.0665, "g/cm2": 0.0980665, "torr": 0.1333223684, "pascal": 1e-3,
    },
    "newtons": {
        "n": 1.0, "newton": 1.0, "newtons": 1.0, "kg": 9.80665, "kgf": 9.80665, "g": 9.80665e-3, "gf": 9.80665e-3,
        **dict.fromkeys(("lb", "lbs", "lbf", "pound", "pounds"), 4.4482216), "mn": 1e-3, "cn": 1e-2, "kn": 1e3,
        **dict.fromkeys(("gram", "grams"), 9.80665e-3), **dict.fromkeys(("kilogram", "kilograms"), 9.80665),
    },
    "ohm": {"ohm": 1.0, "ohms": 1.0, "ω": 1.0, "kohm": 1e3, "kω": 1e3},
}  # fmt: skip
"""Factors of the units of pressure, force and resistance to the unit of `recording.UNITS`."""
_RAW = ("counts", "count", "adc", "raw", "lsb", "code", "codes", "bit", "bits", "digits", "au", "a.u.")
"""Units of readings that are no physical ones."""
_UNIT = re.compile(r"[\[(]((?!\d+[\])])[^\])]*)[\])]|\d[ _.]+([^\W\d_]+)$")
"""Unit in the name of a taxel: in brackets, or after its number."""
_MAYBE_UNIT = re.compile(r"^\W*[^\W\d]{1,3}$|[/^²%]|[a-z][A-Z]|^[\d.,]+\W*[^\W\d]|[^\W\d]\W+\d")
"""A short word, or one with marks or a number; others are names."""
_STATED = re.compile(
    r"(?:.*(?:pressure|force)s?(?: values)? in|"
    r"[#%\s]*(?:force|pressure|values?|taxels?|data|sensor)?\s*units?\s*[:=,;\t])"
    r"\s*((?:[\d.]+ +)?[^\s,;]+)[\s,;]*$|[#%\s]*(?:force|pressure|value|taxel|data)s?\s*[\[(]([^\])]+)[\])][\s,;]*$",
    re.IGNORECASE,
)
"""Unit of the values in a comment."""
KNOWN = "npy, npz, mat, HDF5 and ROS 2 bags (.mcap, .db3) are known by their suffix"
PLACES_MAX = 1 << 16
"""The largest array: 256 x 256."""


@dataclass(frozen=True)
class Layout:
    """Layout that a file does not state; None: taken from the file.

    key : array of an npz, mat or HDF5 file; topic, or topic.field, of a bag.
    time_key : array of the times in such a file, or the name or number of the column of a text.
    skip : leading columns of a text that are no taxels.
    time_unit, gaps : one of `TIME_UNITS`, one of `recording.GAPS`.
    rate_hz : frames a second; overrules times in the file; inf: no times are needed.
    missing : value of a place without a taxel; NaN counts as well.
    axes : names of `recording.AXES` in the order of an array, or the number of the part to take along an axis.
    frames_first : an array of three axes that fits [frames, rows, cols] is that, also with as many frames as rows.
    taxels : first and last column of the taxels of a text, from 0.
    part : sensor, or group of names, from 1, where a text has several.
    header : whether a first line of numbers has numbers of columns.
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
    frames_first: bool = False
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

    values : [lines, taxels], [frames, rows, cols], or the axes of a binary file; NaN where a value is missing.
    time : [frames] or [lines], in `time_unit` if that is known.
    start : added to `time` to give the times of the file, where that would lose digits.
    number : numbers of the frames, where the file has them.
    by_line, binary : a line, or a part of the first axis, is a frame; an array whose axes may be in any order.
    unit, factor : of `recording.UNITS`, and what values of the file were multiplied by.
    """

    values: Floats
    time: Floats | None = None
    time_unit: str | None = None
    time_from: str = "the file"
    start: Fraction | int = 0
    number: Floats | None = None
    by_line: bool = False
    binary: bool = False
    shape: tuple[int, int] | None = None
    unit: str | None = None
    factor: float = 1.0
    area_mm2: float | None = None
    order: str = "row by row, as in the file"
    ignored: list[str] = field(default_factory=list)

    def scale(self, unit: str) -> bool:
        """Turn values into kPa, N or ohm by their unit; return False for one that is not known, which leaves them."""
        unit = re.sub(r'[\s^,;"]', "", unit).replace("²", "2")
        unit = unit if unit in ("MN", "mPa") else unit.lower()  # mega is no milli
        for name, known in FACTORS.items():
            if unit in known:
                self.values, self.unit, self.factor = self.values * known[unit], name, known[unit]
        return self.unit is not None or unit in _RAW


def warn(path: Path, text: str) -> None:
    """Warn of a reading that a user must check."""
    warnings.warn(f"{path}: {text}", stacklevel=2)


def decoded(path: Path, data: bytes) -> str:
    """Return text in UTF-8, UTF-16, UTF-32 or Latin-1."""
    even, odd = data[:4096:2].count(0), data[1:4096:2].count(0)
    kinds = ["utf-16-le" if odd > even else "utf-16-be"] if even or odd else ["utf-8-sig", "latin-1"]
    kinds = next(([name] for name, marks in _MARKS.items() if data.startswith(marks)), kinds)
    for kind in kinds:
        try:
            text = data.decode(kind)
        except UnicodeDecodeError as error:
            at = error.start
        else:
            if (bad := re.search(r"[\0-\x08\x0e-\x1f]", text)) is None:
                return text
            at = bad.start()
            break
    raise InputError(path, f"byte {at}", "no text", f"a text; {KNOWN}")


# ---- cells


def cells_of(line: str, mark: str | None) -> list[str]:
    """Split a line; brackets of lists are kept."""
    joint = mark or " "
    if '"' in line:
        parts = r'"[^"\[]*(\[(?:[^\]",;\s]+[,;\s]+){2,}[^\]"]*\])[^"]*"'  # a name may be p[0,1]
        line = re.sub(parts, lambda m: joint.join(re.split(r"[,;\s]+(?=[^\s\]])", m[1])), line)
    quoted_cells = '"' in line and next(csv.reader([line], delimiter=joint, skipinitialspace=True))
    return [cell.strip(' \t"') for cell in quoted_cells or line.split(mark)]


def _bare(cells: list[str]) -> list[str]:
    """Return cells without brackets; (1,2) is a pair and no number."""
    return [cell if re.fullmatch(r"[\[(].*,.*[\])]", cell) else cell.strip(" []()") for cell in cells]


def _are_places(cells: list[str]) -> bool:
    """Return True for the names (0,0), (0,1), ... of a whole array, which are no numbers with a decimal comma."""
    found = [re.fullmatch(r"[\[(]?(\d{1,3}),(\d{1,3})[\])]?", cell) for cell in cells]
    places = [match.groups() for match in found if match]
    rows, cols = (len(set(numbers)) for numbers in zip(*places, strict=True)) if places else (0, 0)
    return len(places) > 3 and len(set(places)) == len(places) == rows * cols


def decimal(number: str) -> float:
    """Return a number with a decimal point or comma."""
    return float(number.replace(",", "."))


def bounded(path: Path, values: int) -> None:
    if values > VALUES_MAX:
        raise InputError(path, "values", values, f"at most {VALUES_MAX}")


def number_of(cell: str) -> float:
    """Return a number, NaN for an empty cell; ValueError for other text."""
    if cell.lower() in _EMPTY:
        return math.nan
    if _COMMA.fullmatch(cell):
        return decimal(cell)
    if "_" in cell:  # float() takes 1_000
        raise ValueError
    return float(cell)


def is_number(cell: str, read=number_of) -> bool:
    try:
        read(cell)
    except ValueError:
        return False
    return True


def seconds_of(cell: str) -> float:
    """Return seconds of a clock, or of a date and time; ValueError for other text."""
    if half := re.fullmatch(r"(.*?)(\d{1,2})(:\d\d:\d\d\S*)\s*([AP])M", cell, re.IGNORECASE):
        cell = f"{half[1]}{int(half[2]) % 12 + 12 * (half[4] in 'pP'):02d}{half[3]}"
    if digits := _DIGITS.fullmatch(cell):
        cell = "{}-{}-{} {}:{}:{}".format(*digits.groups())
    cell = re.sub(r"(\d{4})/(\d\d)/(\d\d)", r"\1-\2-\3", cell)
    if (date := _DAY_FIRST.match(cell)) and (date[4] or date[2].lower() in _MONTHS):
        month = int(date[4]) if date[4] else _MONTHS.index(date[2].lower()) + 1
        year = date[3] or date[5]
        cell = f"{year if len(year) == 4 else '20' + year}-{month:02d}-{int(date[1]):02d}{cell[date.end() :]}"
    if clock := CLOCK.fullmatch(cell.strip()):
        return int(clock[1]) * 3600 + int(clock[2]) * 60 + decimal(clock[3])
    if not re.search(r"\D\d\d:\d\d", cell):
        raise ValueError
    time = datetime.fromisoformat(re.sub(r"\s+(?=[+-]\d\d:?\d\d$)", "", cell))
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def _parted(name: str) -> str:
    """Return a name with timeMs as time_Ms."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)


def time_unit_of(name: str) -> str | None:
    """Return the unit that the name of a time has, as in time_ms and Time [us]."""
    return _unit_in(name)[1]


def _unit_in(name: str) -> tuple[str, str | None]:
    """Return what stands before the unit of a time in its name, and the unit."""
    match = _TIME_UNIT.fullmatch(_parted(name).lower())
    return (match[0][: match.start(match.lastgroup)], match.lastgroup) if match else ("", None)


def is_part_of(name: str, whole: str) -> bool:
    """Return True for the name of parts of a second next to that of whole ones, as stamp_nsec and stamp_sec."""
    (start, unit), (before, fine) = _unit_in(whole), _unit_in(name)
    return unit in (None, "s") and fine in PER_SECOND and before in ("", start)


def is_time(name: str, known: re.Pattern = _TIME) -> bool:
    """Return True if a name is that of a time."""
    return bool(known.fullmatch(name) or known.fullmatch(_parted(name)))


def asks_unit(name: str) -> bool:
    """Return True for the name of a time with more words, which may be a unit."""
    unit = re.search(r"[\[( _.]\W*\w{1,2}\W*$", name)
    return is_time(name) and not is_time(name, _BARE_TIME) and unit is not None


def _alike(one: tuple[float, bool], other: tuple[float, bool]) -> bool:
    """Return True if two of `Table._span` may be the same time; one without a unit has any."""
    factors = (
        [1.0] if one[1] and other[1] else [a / b for a in TIME_UNITS.values() for b in TIME_UNITS.values()]
    )
    return any(abs(one[0] - f * other[0]) <= 0.1 * min(abs(one[0]), abs(f * other[0])) for f in factors)


# ---- tables


class Table:
    """A table with a frame, or a row of one, in each line."""

    def __init__(self, path: Path, lines: list[str], layout: Layout) -> None:
        self.path, self.layout = path, layout
        # The monitor of the Arduino IDE writes a clock and an arrow.
        arrow = re.compile(r"^(\d\d:\d\d:\d\d[.,]\d+) -> ?")
        if any(map(arrow.match, lines)):
            rest = next(arrow.sub("", line) for line in reversed(lines) if arrow.match(line))
            lines = [arrow.sub(rf"\1{_mark_of(rest) or ' '}", line) for line in lines]
        filled = [(n, line) for n, line in enumerate(lines, 1) if line.strip(" \t,;")]
        data = [line for _, line in filled if not _is_comment(line)]
        ends = [line for line in data if not LABEL.match(line)][-20:] or data[-1:]
        self.mark = Counter(map(_mark_of, ends)).most_common(1)[0][0] if ends else None
        start = next((k for k, (_, line) in enumerate(filled) if self._starts(line)), len(filled))
        self.head, self.lines = [line for _, line in filled[:start]], filled[start:]
        self.block, self.label = self._blocks(lines)
        if not self.lines and len(data) > 1:
            number, line = next((n, line) for n, line in filled[1:] if line in data)
            bad = next((c for c in _bare(cells_of(line, self.mark)) if c and not is_number(c)), line)
            raise self._ask(f"line {number}", quoted(one_line(bad, 40)), "numbers as 0.5 or 0,5, and a time")
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

    @functools.cached_property
    def words(self) -> list[int]:
        """Columns without a number."""
        return [k for k in range(self.width) if not any(is_number(row[k]) for row in self.sample)]

    def _ask(self, key: str, value: object, allowed: str) -> InputError:
        return InputError(self.path, key, value, allowed)

    def _unclear(self, value: object, allowed: str) -> InputError:
        return self._ask("header", value, f"{allowed}, or --taxels FIRST..LAST by number")

    def _starts(self, line: str) -> bool:
        if _is_comment(line) or LABEL.match(line):
            return False
        cells = cells_of(line, self.mark)
        filled = [cell for cell in _bare(cells) if cell]
        good = 0 if _are_places(cells) else sum(map(is_number, filled))
        return good > len(filled) / 2 or (good > 0 and any(is_number(c, seconds_of) for c in filled))

    def _cells(self, line: str) -> list[str]:
        cells = _bare(cells_of(line, self.mark))
        return cells[:-1] if self.trailing and len(cells) > 1 and cells[-1] == "" else cells

    def _blocks(self, lines: list[str]) -> tuple[NDArray, dict[int, tuple[int, float]]]:
        """Return the block of every line, and number and time (or NaN) of labels; drop lines that only part blocks."""
        kept, block, labels, number = [], [], {}, 0
        known = dict(self.lines)
        first = min(known, default=len(lines) + 1)
        # Blank lines part no frames that have labels: XSENSOR has one after every row.
        labelled = sum(LABEL.match(line) is not None for line in lines) > 1
        early = [line for line in self.head if LABEL.match(line)][-1:] if known else []
        for n, line in [(0, line) for line in early] + list(enumerate(lines[first - 1 :], first)):
            label = LABEL.match(line)
            words = line.split(None, 1)[:1] if block and n in known and line.lstrip()[:1].isalpha() else []
            if words and is_time(words[0]) and not self._starts(line) and line not in self.head:
                warn(self.path, f"another table begins at line {n}, and is left out: {one_line(line, 40)}")
                break
            # MVP and MPP of novel are the mean and the largest of each column.
            if n in known and not (label or _is_comment(line, "MVP", "MPP") or line in self.head):
                kept.append((n, line))
                block.append(number)
                continue
            number += bool(block) and block[-1] == number and (bool(label) or not labelled)
            if label:
                stamp = STAMP.search(label[2])
                scale = 1e-3 if stamp and stamp[2] == "ms" else 1.0
                labels[number] = int(label[1]), decimal(stamp[1]) * scale if stamp else math.nan
        self.lines = kept
        return np.array(block, int), labels

    def _names(self) -> list[str]:
        first = cells_of(self.lines[0][1], self.mark)
        width = len(first)
        opens = [k for k, cell in enumerate(first) if cell.startswith("[")]
        closes = [k for k, cell in enumerate(first) if cell.endswith("]")]
        lists = [(k, end - k + 1) for k, end in zip(opens, closes, strict=False) if k <= end]
        plain = self._cells(self.lines[0][1])
        units: list[str] = []
        for head in reversed(self.head):
            names = cells_of(head.lstrip("# "), self.mark)
            if len(names) in (width, len(plain)) and len(names) > 1:
                if not any(map(str.isdigit, "".join(names))) and not units and head != self.head[0]:
                    units = names  # or names without numbers; known by the line above
                    continue
                if len(units) == len(names):
                    pairs = zip(names, _bare(units), strict=True)
                    names = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
                if self.trailing:
                    # The mark at the end of every line separates nothing if the header has no name there.
                    self.trailing = len(names) == width - 1 or not names[-1]
                return names[:-1] if self.trailing and len(names) == width and not names[-1] else names
            # A list in one column, as ROS tools write arrays.
            for k, count in lists:
                if k < len(names):
                    names[k : k + 1] = [f"{names[k]}[{n}]" for n in range(count)]
            if lists and len(names) == width:
                return names
        last = next((h for h in reversed(self.head) if not _is_comment(h)), "")
        short = len(cells_of(last, self.mark)) > 1 and not LABEL.match(last)
        numbered = self.layout.header is not False and not (short and len(plain) < _NUMBERS_SURE)
        if numbered and self._is_numbered(plain):
            self.lines, self.block = self.lines[1:], self.block[1:]
            if not self.lines:
                raise self._ask("lines", "a header only", "at least one line of numbers")
            return first[: len(plain)]
        if self.layout.header:
            allowed = "names or numbers of columns, or --header no"
            raise self._ask("header", one_line(self.lines[0][1]), allowed)
        if short:
            allowed = f"{len(plain)}, as many as the line below it has values"
            raise self._ask("header", f"{len(cells_of(last, self.mark))} names", allowed)
        return []

    def _is_numbered(self, cells: list[str]) -> bool:
        """Return True for a first line of numbers of columns: 0, 1, 2, ... or 1, 2, 3, ..."""
        numbers = Counter(int(c) for c in cells if re.fullmatch(r"\d{1,6}", c))
        words = [c for c in cells if not re.fullmatch(r"\d{1,6}", c)]
        if len(numbers) < 2 or len(set(numbers.values())) > 1 or any(is_number(c) and c for c in words):
            return False
        consecutive = min(numbers) in (0, 1) and max(numbers) - min(numbers) + 1 == len(numbers)
        # Beside a name, as novel writes time[secs] and the numbers of its sensors, any numbers that rise are names.
        if not consecutive and not (any(words) and list(numbers) == sorted(numbers)):
            return False
        below = self._cells(self.lines[1][1]) if len(self.lines) > 1 else []
        if words and any(not is_number(c) or not c for c in below[:1] if not words[0]):
            return False
        if self.layout.header:
            return True
        if words and len(below) == len(cells):
            under = [b for b, c in zip(below, cells, strict=True) if c in words]
            if any(is_number(b) and b for b in under):
                return True
            if under == words:
                return False
        steps: set[float] = set()
        with contextlib.suppress(ValueError):  # a cell of text below
            steps = {number_of(b) - number_of(a) for a, b in zip(cells, below, strict=False)}
        if steps == {0.0} and len(cells) < _NUMBERS_SURE:
            return False
        if len(numbers) < _NUMBERS_SURE or len(steps) == 1:
            allowed = "--header yes if these are numbers of columns, --header no if it is data"
            raise self._ask("line 1", one_line(self.lines[0][1], 40), allowed)
        warn(self.path, "the first line has numbers of columns and is no frame; --header no otherwise")
        return True

    # ---- columns

    def found(self) -> Found:
        layout = self.layout
        chosen = self._chosen()
        keys = self._times(chosen)
        placed = self._by_names if self.names else self._unnamed
        order, columns, shape, by_line = placed(chosen, keys)
        lower = [] if by_line else [name.lower() for name in self.names]
        words = ("row", "r"), ("frame", "frame_id", "sample")
        row_key, frame_key = (next((lower.index(w) for w in said if w in lower), None) for said in words)
        extra = [k for k in (row_key, frame_key) if k is not None]
        bounded(self.path, self.count * len(columns))
        table, moments = self._parsed([*extra, *(c for c in columns if c is not None)], keys)
        values = np.full((self.count, len(columns)), np.nan)
        values[:, [n for n, c in enumerate(columns) if c is not None]] = table[:, len(extra) :]
        said = [self.names[k] or f"column {k}" if self.names else f"column {k}" for k in range(self.width)]
        out = [k for k in range(self.width) if k not in columns and k not in keys and k not in extra]
        if chosen is None and not layout.part and self.names:
            named = [k for k in out if self.names[k] and not is_time(said[k])]
            strange = [said[k] for k in named if not _OTHER.match(re.split(r"[./]", said[k])[-1])]
            shown = one_line(", ".join(strange[:8]), 200)
            if len(strange) > max(8, len(columns) / 4):
                raise self._unclear(f"{len(strange)} columns as {shown}", "--part N")
            if strange:
                warn(self.path, f"columns that are taken for no taxels: {shown}")
        found = Found(values, by_line=by_line, shape=shape, order=order, ignored=[said[k] for k in out])
        if keys:
            found.time_from = " and ".join(said[k] for k in keys)
            self._timed(found, moments, keys)
        name = self.names[next(k for k in columns if k is not None)] if self.names else ""
        self._scale(found, name)
        self._counters(out, values)
        if row_key is not None:
            # A row may have a time of its own.
            by_time = found.time is not None and len(np.unique(found.time)) < len(found.time)
            by = table[:, 1] if frame_key is not None else found.time if by_time else None
            return self._rows(found, table[:, 0], by)
        return self._framed(found)

    def _scale(self, found: Found, name: str) -> None:
        """Turn values into kPa, N or ohm by the unit in the name of a taxel, or in a comment that says nothing else."""
        stated = sorted({match[1] or match[2] for line in self.head if (match := _STATED.match(line))})
        if len(stated) > 1:
            warn(self.path, f"comments state several units, and none is taken: {', '.join(stated)}")
            stated = []
        named = ["".join(pair) for pair in _UNIT.findall(name)]  # in brackets, or after a number
        # The last known one counts.
        if any(found.scale(unit) for unit in (*stated, *reversed(named))):
            return
        for unit in (*stated, *named):
            if unit in stated or _MAYBE_UNIT.search(unit) or name.endswith((f"[{unit}]", f"({unit})")):
                warn(self.path, f"{quoted(unit)} is no unit that is known: values are taken as they are")

    def _chosen(self) -> list[int] | None:
        """Return the columns that options name for taxels."""
        layout = self.layout
        if layout.taxels is None and layout.skip is None:
            return None
        low, high = layout.taxels or (layout.skip or 0, self.width - 1)
        if not low <= high < self.width:
            raise self._ask("--taxels or --skip", f"{low}..{high}", f"columns 0..{self.width - 1}")
        return list(range(low, high + 1))

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
        stamps = [k for k, cell in enumerate(first) if is_number(cell, seconds_of) and not is_number(cell)]
        if names:
            counts = Counter(_template(name)[0] for name in names)
            alone = [k for k in range(self.width) if is_time(names[k]) and counts[_template(names[k])[0]] < 4]
            named = [k for k in alone if k in stamps or (is_number(first[k]) and first[k])]
            for k in named:
                if len(keys := self._with_parts(k)) > 1:
                    return keys
            if alone and not named and self.layout.rate_hz is None and first[alone[0]]:
                allowed = "a number, a clock, or a date as 2024-03-04 12:00:00; or --rate"
                raise self._ask(names[alone[0]], quoted(first[alone[0]]), allowed)
            spans = [span for span in map(self._span, named) if span is not None]
            if not all(_alike(spans[0], other) for other in spans[1:]):
                listed = " and ".join(self.names[k] for k in named[:2])
                warn(self.path, f"{listed} differ: {self.names[named[0]]} is taken; --time-key otherwise")
            if named:
                return named[:1]
        if stamps or names:
            return self._with_parts(stamps[0]) if stamps else []
        # Whole seconds since 1970 with nanoseconds beside them, or a stamp since 1970: no taxel has 1e9.
        for k in range(min(4, self.width)):
            cells = [row[k] for row in self.sample]
            if not (chosen and k in chosen) and all(is_number(c) and number_of(c) > 1e9 for c in cells):
                pairs = [row[k : k + 2] for row in self.sample]
                whole = all(re.fullmatch(r"\d+", c) for pair in pairs for c in pair)
                whole = whole and k + 1 < min(4, self.width)
                fine = whole and len(cells[0]) == 10 and 1e6 < max(int(part) for _, part in pairs) < 10**9
                return [k, k + 1] if fine else [k]
        return []

    def _span(self, k: int) -> tuple[float, bool] | None:
        """Return the time from the first to the last one of the sample, and if it is in seconds; None for no number."""
        first, last = self.sample[0][k], self.sample[-1][k]
        read, unit = number_of, TIME_UNITS.get(time_unit_of(self.names[k]))
        if not is_number(first):
            read, unit = seconds_of, 1.0
        return ((read(last) - read(first)) * (unit or 1.0), bool(unit)) if is_number(last, read) else None

    def _with_parts(self, k: int) -> list[int]:
        """Return the columns of a time: a date before its clock, and the part of a second after whole ones."""
        cells, others = [row[k] for row in self.sample], [j for j in range(self.width) if j != k]
        date: list[int] = []
        if all(re.fullmatch(CLOCK.pattern + r"(\s*[APap][Mm])?", cell) for cell in cells):
            date = [j for j in others if all(_DATE.fullmatch(row[j]) for row in self.sample)][:1]
            unclear = (j for j in others if all(_DATED.fullmatch(row[j]) for row in self.sample))
            if not date and self.layout.rate_hz is None and (j := next(unclear, None)) is not None:
                allowed = "a date as 2024-03-04, or --time-key, or --rate"
                raise self._ask(f"column {j}", quoted(self.sample[0][j]), allowed)
        if self.names and all(_WHOLE_S.fullmatch(cell) for cell in cells):
            for j in others:
                # stamp.sec and stamp.nanosec, secs and nsecs, s and us, or ms beside any.
                parts = [row[j] for row in self.sample]
                if is_part_of(self.names[j], self.names[k]):
                    per_s = PER_SECOND[_unit_in(self.names[j])[1]]
                    if all(re.fullmatch(r"\d{1,9}", p) and int(p) < per_s for p in parts):
                        return [*date, k, j]
        return [*date, k]

    def _as_in_file(self, chosen: list[int]):
        """Return what `_by_names` returns, for chosen columns whose names do not tell."""
        warn(self.path, "names do not say the places of the chosen columns; taken row by row")
        return "row by row, as in the file", chosen, None, True

    def _by_names(self, chosen: list[int] | None, keys: list[int]):
        """Return order, columns by place (None: no taxel), shape or None, and True if a line is a frame."""
        layout, size = self.layout, self.layout.size
        if layout.axes is not None:
            raise self._ask("--axes", ",".join(map(str, layout.axes)), "left out: the names say the places")
        groups: dict[tuple[str, int], list[int]] = {}
        seen: Counter = Counter()
        for k in range(self.width) if chosen is None else chosen:
            text, numbers = _template(self.names[k])
            if k not in keys and (chosen is not None or (numbers and k not in self.words)):
                seen[text, numbers] += 1
                groups.setdefault((text, seen[text, numbers]), []).append(k)
        for (text, again), columns in groups.items():
            if again > 1 and 2 * len(columns) < len(groups[text, 1]):
                raise self._unclear(f"the name {self.names[columns[0]]} twice", "names that differ")
        many = max(map(len, groups.values()), default=0)
        parts = [g for g in groups.values() if 2 * len(g) >= many > 1 or len(g) == size]
        fitting = [g for g in parts if len(g) == size]
        if layout.part is not None:
            parts = parts[layout.part - 1 : layout.part]
        elif len(fitting) == 1:
            parts = fitting
        if chosen is not None and (len(groups) != 1 or "#" not in next(iter(groups))[0]):
            return self._as_in_file(chosen)
        if len(parts) != 1:
            listed = ", ".join(f"{len(g)} of {self.names[g[0]]}" for g in parts[:6]) or "no taxels by number"
            allowed = (
                "--part N for one of several arrays; a line with one value is not read: write a line a frame"
            )
            raise self._unclear(listed, allowed)
        columns, first = parts[0], self.names[parts[0][0]]
        texts = _template(first)[0].split("#")
        numbers = np.array([[min(n, PLACES_MAX) for n in _template(self.names[k])[1]] for k in columns])
        if numbers.max() >= PLACES_MAX:
            raise self._unclear(first, f"numbers below {PLACES_MAX}")
        changing = [d for d in range(numbers.shape[1]) if len(set(numbers[:, d])) > 1]
        words = [re.split(r"[^a-z]+", texts[d].rstrip(" _.[](),-"))[-1] for d in changing]
        numbers = numbers[:, changing]
        if len(changing) == 1:
            try:
                place, count, by_line = self._flat(first, numbers[:, 0], words[0])
            except InputError:
                if chosen is None:
                    raise
                return self._as_in_file(chosen)
            shape = None
        else:
            two = len(changing) == 2
            plain = two and not re.search("[a-z]", texts[changing[0] + 1])
            turned = two and words[0] in COL and (plain or words[1] in ROW)
            named = turned or plain or (words[0] in ROW and words[-1] in COL)
            if (plain and words[0] in ("c", "x")) or not named:
                raise self._unclear(first, "names with row and column, as r0c0")
            numbers = numbers[:, ::-1] if turned else numbers
            shape, by_line = self._grid(first, numbers, plain), True
            place, count = (numbers - numbers.min()) @ (shape[1], 1), shape[0] * shape[1]
        table: list[int | None] = [None] * count
        for k, n in zip(columns, place.tolist(), strict=True):
            table[n] = k
        if None in table:
            warn(self.path, f"{table.count(None)} of {count} places have no column: no taxel there")
        known = [(n, k) for n, k in enumerate(table) if k is not None]
        first = self.names[known[0][1]]
        said = f"by names, {first} first{'' if shape else ', row by row'}"
        places = [(self.names[k], *divmod(n, shape[1])) for n, k in known if shape]
        if told := next((place for place in reversed(places) if place[1] != place[2]), None):
            said += f", {told[0]} in row {told[1]}, column {told[2]}"
        return said, table, shape, by_line

    def _grid(self, first: str, numbers: NDArray, plain: bool) -> tuple[int, int]:
        """Return the size of an array whose names have row and column."""
        if (numbers.min(axis=0) > 1).any():
            raise self._unclear(first, "rows and columns from 0 or 1")
        most = numbers.max(axis=0) - numbers.min() + 1
        rows, cols = self.layout.rows or int(most[0]), self.layout.cols or int(most[1])
        if (most > (rows, cols)).any():
            said = f"{most[0]} x {most[1]} places as {first}"
            raise self._ask("header", said, f"places in {rows} x {cols}, or other --rows and --cols")
        if min(rows, cols) <= 2 and max(rows, cols) > (8 if plain else 32) and not self.layout.size:
            raise self._unclear(f"{rows} x {cols} places", "--rows and --cols, for one of two arrays")
        if rows * cols > PLACES_MAX:
            raise self._ask("header", f"{rows} x {cols} places", f"at most {PLACES_MAX}")
        return rows, cols

    def _flat(self, first: str, numbers: NDArray, word: str) -> tuple[NDArray, int, bool]:
        """Return places, their count, and True if a line is a frame, of names with one number."""
        low, most, count, size = int(numbers.min()), int(numbers.max()), len(numbers), self.layout.size
        if low > 1 or sorted(numbers.tolist()) != list(range(low, low + count)):
            if size is not None and count < size and (most == size or (low == 0 and most < size)):
                return numbers - (most == size), size, True
            lost = sorted(set(range(most + 1)) - set(numbers.tolist()) - {0})
            said = f"{count} names as {first}, {f'not {lost[0]}' if lost else f'from {low}'}"
            raise self._unclear(said, "numbers from 0 or 1 without a gap, --rows and --cols of all")
        # A data frame of rows names its columns by numbers.
        fits = count == self.layout.cols
        a_row = count != size and (word in COL or (first.isdigit() and fits))
        if word in (*COL, *ROW) and size is None and "row" not in [n.lower() for n in self.names]:
            if not fits or word in ROW:
                allowed = "--rows and --cols: a line may be a row of a frame, or a frame"
                raise self._ask("header", f"{count} columns {first}..", allowed)
        if size is not None and count != size and not (a_row and fits):
            allowed = f"{size}, as --rows {self.layout.rows} --cols {self.layout.cols} say"
            raise self._ask("columns", f"{count} taxels", allowed)
        return numbers - low, count, not a_row

    def _unnamed(self, chosen: list[int] | None, keys: list[int]):
        """Return the layout of columns without names, as `_by_names`."""
        rows, cols = self.layout.rows, self.layout.cols
        inside = range(self.width) if chosen is None else chosen
        left = [k for k in inside if k not in keys and k not in self.words]
        for cell in (self.sample[0][k] for k in self.words if chosen is None):
            if re.search(r"[:=>]\s*-?\d[\d.]*$", cell) and not is_number(cell, seconds_of):
                allowed = "a number or a text in a cell; --taxels leaves it out"
                raise self._ask("line 1", quoted(cell), allowed)
        if self.layout.axes is not None:
            good = True
        elif rows and cols:
            good = len(left) in (rows * cols, cols)
        else:
            frames = len(set(self.block.tolist())) > 1 and len(self.lines) > self.block[-1] + 1
            good = square(len(left)) or frames or (bool(rows or cols) and len(left) % (rows or cols) == 0)
        if not left or not good:
            allowed = "--rows and --cols; --skip N, --taxels FIRST..LAST for the taxels; --time-key N"
            raise self._ask("columns", f"{len(left)} without names", allowed)
        return "row by row, as in the file", left, None, bool(keys)

    def _parsed(self, columns: Sequence[int], keys: list[int]) -> tuple[Floats, list[list[str]]]:
        """Return the values of columns, and the cells of the times, by line."""
        table = np.empty((self.count, len(columns)))
        moments: list[list[str]] = []
        comma = False
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
            if keys:
                moments.append(_bare([cells[k].strip() for k in keys]))
        shown = [cell for row in self.sample for cell in row]
        points = any(re.fullmatch(r"[-+]?\d*\.\d+", cell) for cell in shown)
        comma = comma or any(map(_COMMA.fullmatch, shown))
        if comma and (points or any("." in self._cells(line)[k] for _, line in self.lines for k in columns)):
            raise self._ask("numbers", "decimal commas and points", "one of them; thousands without a mark")
        self._refuse_thousands(table, columns, "," if comma else ".")
        return table, moments

    def _refuse_thousands(self, table: Floats, columns: Sequence[int], mark: str) -> None:
        """Refuse numbers whose decimal mark may be one of thousands: 1,234 beside 985."""
        form = rf"[-+]?[1-9]\d{{0,2}}\{mark}\d{{3}}"
        shown = (row[k] for row in self.sample for k in columns)
        if any(mark in cell and not re.fullmatch(form, cell) for cell in shown):
            return
        size = np.abs(table[np.isfinite(table)])
        broken = size % 1 != 0
        part, whole = 1e3 * size[broken], size[~broken]
        # Rounding of a number below 1000 is 1e-13.
        if not part.size or part.min() < 1e3 or np.abs(part - np.round(part)).max() > 1e-6:
            return
        if not 0 < whole.max(initial=0.0) < 1000:
            return
        cells = [self._cells(line)[k] for _, line in self.lines for k in columns]
        marked = [cell for cell in cells if mark in cell]
        plain = any(re.fullmatch(r"[-+]?[1-9]\d{0,2}", cell) for cell in cells)
        if marked and plain and all(re.fullmatch(form, cell) for cell in marked):
            raise self._ask("numbers", quoted(marked[0]), f"no mark of thousands; a decimal as 1{mark}2340")

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
        cells, *fine = zip(*moments, strict=True)
        whole = all(re.fullmatch(r"-?\d{1,19}", c) for row in moments for c in row)
        if fine and _DATE.fullmatch(cells[0]):
            if (dates := _by_day(cells)) is None:
                allowed = "a date as 2024-03-04: day or month may be first; or --time-key, or --rate"
                raise self._ask("date", quoted(cells[0]), allowed)
            clocks, *fine = fine
            cells = [" ".join(pair) for pair in zip(dates, clocks, strict=True)]
        if fine:
            per_s = PER_SECOND[(self.names and _unit_in(self.names[keys[-1]])[1]) or "ns"]
            pairs = list(zip(cells, fine[0], strict=True))
            if not all(_WHOLE_S.fullmatch(s) and re.fullmatch(r"\d{1,9}", part) for s, part in pairs):
                raise self._ask("time", " ".join(moments[0]), "whole seconds and a part, or --time-key")
            if max(map(int, fine[0])) >= per_s:
                raise self._ask(self.names[keys[-1]], max(fine[0]), f"below {per_s}, or --time-key")
            ticks = [int(s if s.isdigit() else seconds_of(s)) * per_s + int(part) for s, part in pairs]
            found.time = past_midnight(np.array([t - ticks[0] for t in ticks], dtype=float) / per_s)
            found.time_unit, found.start = "s", Fraction(ticks[0], per_s)
            return
        filled = [c for c in cells if c.lower() not in _EMPTY]
        plain = not filled or (is_number(filled[0]) and not all(map(_DIGITS.fullmatch, filled)))
        read = number_of if plain else seconds_of
        if bad := next((c for c in filled if not is_number(c, read)), None):
            raise self._ask("time", quoted(bad), "a date and time, a clock, or a number, in every line")
        if whole and abs(int(cells[0])) > 2**52:
            # Differences of whole stamps are exact; a double holds nanoseconds since 1970 to 256 ns.
            found.start = int(cells[0])
            found.time = np.array([int(c) - found.start for c in cells], dtype=float)
        else:
            found.time = np.array([math.nan if c.lower() in _EMPTY else read(c) for c in cells])
        if read is seconds_of:
            found.time, found.time_unit = past_midnight(found.time), "s"
        elif self.names:
            found.time_unit = time_unit_of(self.names[keys[0]])

    def _counters(self, out: list[int], values: Floats) -> None:
        """Warn of a counter of frames that leaves out numbers, has some twice, or falls."""
        for k in out if self.names else ():
            column = self._column(k) if _COUNTER.fullmatch(self.names[k]) else [""]
            if all(re.fullmatch(r"\d{1,15}", c) for c in column):
                numbers = np.array([int(c) for c in column])
                steps = np.diff(numbers)
                # A counter of 8, 16 or 32 bits that reaches its last numbers goes on from 0.
                size = next((s for s in (1 << 8, 1 << 16, 1 << 32) if 0.9 * s <= numbers.max() < s), 0)
                steps = np.where((steps < 0) & (numbers[1:] < 0.1 * size), steps + size, steps)
                name, falls = self.names[k] or f"column {k}", np.flatnonzero(steps < 0)
                if len(falls) > len(steps) / 4:
                    if len(set(column)) == len(column):
                        warn(self.path, f"{name} falls at its value {falls[0] + 2}: frames in another order?")
                elif len(falls):
                    warn(self.path, f"{name} begins again at its value {falls[0] + 2}: recordings joined?")
                if (steps == 1).any() and (lost := int((steps[steps > 1] - 1).sum())):
                    warn(self.path, f"{name} leaves out {lost} numbers: frames lost?")
                again = np.flatnonzero(steps == 0)
                same = int((values[again + 1] == values[again]).all(axis=1).sum())
                if same and (steps == 1).any():
                    warn(self.path, f"{name} has {same} numbers twice: frames doubled?")

    def _column(self, k: int) -> list[str]:
        return [row[k] for _, line in self.lines if len(row := self._cells(line)) > k]

    # ---- frames of several lines

    def _rows(self, found: Found, row: Floats, frame: Floats | None) -> Found:
        """Return frames from lines with the number of their row."""
        if not (np.isfinite(row).all() and (row == np.floor(row)).all() and row.min() in (0, 1)):
            raise self._ask("row", float(row.min()), "whole numbers from 0 or 1")
        place = (row - row.min()).astype(int)
        new = np.diff(place) <= 0 if frame is None else np.diff(frame) != 0
        index = np.concatenate([[0], np.cumsum(new)]).astype(int)
        rows, width = self.layout.rows or int(place.max()) + 1, found.values.shape[1]
        bounded(self.path, (int(index[-1]) + 1) * rows * width)
        if place.max() >= rows:
            raise self._ask("row", int(row.max()), f"{rows} rows, as --rows says")
        filled = np.zeros((index[-1] + 1, rows), int)
        np.add.at(filled, (index, place), 1)
        if (filled > 1).any():
            n, r = np.argwhere(filled > 1)[0]
            raise self._ask(f"frame {n}", f"row {r} twice", "each row once in a frame")
        for n in np.flatnonzero((filled == 0).any(axis=1))[:8]:
            lost = ", ".join(map(str, np.flatnonzero(filled[n] == 0)[:8]))
            warn(self.path, f"frame {n} has no row {lost}: missing there")
        values = np.full((*filled.shape, width), np.nan)
        values[index, place] = found.values
        found.values, found.shape = values, values.shape[1:]
        found.time = None if found.time is None else found.time[np.concatenate([[True], new])]
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
        else:
            if layout.rows and layout.cols == width and layout.rows in heights:
                height, blocks = layout.rows, len(heights)
            said = f"{height} lines of {width} values"
            if (layout.rows or height, layout.cols or width) != (height, width) or 2 * blocks <= len(heights):
                raise self._ask("blocks", said, "frames of --rows and --cols, with as many lines")
            if square(width) and width != height and not layout.rows and width >= 36:
                raise self._ask("blocks", said, "--rows and --cols of a frame")
            whole = heights == height
            self._refuse_numbered(found.values[whole[self.block]].reshape(-1, height, width))
            for n in np.flatnonzero(~whole):
                name = self.label[n][0] if n in self.label else n
                warn(self.path, f"frame {name} has {heights[n]} of {height} lines: missing as a whole")
            values = np.full((len(heights), height, width), np.nan)
            values[whole] = found.values[whole[self.block]].reshape(-1, height, width)
            found.values, found.shape = values, (height, width)
            if found.time is not None:
                found.time = found.time[np.searchsorted(self.block, np.arange(len(heights)))]
        if len(self.label) == len(heights) == len(found.values):
            found.number, time = np.array([self.label[n] for n in range(len(heights))], dtype=float).T
            if found.time is None and np.isfinite(time).all():
                found.time, found.time_unit = past_midnight(time), "s"
                found.time_from = "stamps of the frames"
        return found

    def _refuse_numbered(self, frames: Floats) -> None:
        """Ask about frames [frames, rows, cols] without names, whose first column may number rows or frames, or be a
        time.
        """
        layout, first = self.layout, frames[:, :, 0]
        if self.names or layout.cols or layout.taxels or layout.skip is not None or frames.shape[2] < 2:
            return
        steps = np.diff(first, axis=1)
        rows = (steps == 1).all() and np.isin(first[:, 0], (0, 1)).all()
        in_time = len(first) > 1 and (steps >= 0).all() and (np.diff(first[:, 0]) > 0).all()
        in_time = in_time and (first[1:, 0] >= first[:-1, -1]).all()
        if steps.size and (rows or in_time):
            shown = ", ".join(f"{value:g}" for value in first.ravel()[:6])
            raise self._ask("column 0", f"{shown} ...", "--skip 1 if that is no taxel, --cols if it is")


def _by_day(dates: Sequence[str]) -> list[str] | None:
    """Return dates with slashes as day.month.year, None if the day may be first or second; others as they are."""
    parts = [re.fullmatch(r"(\d{1,2})/(\d{1,2})/(\d{2,4})", date) for date in dates]
    if not all(parts):
        return list(dates)
    day = [max(int(part[n]) for part in parts if part) > 12 for n in (1, 2)]
    if day[0] == day[1]:
        return None
    return [".".join((p[1], p[2], p[3]) if day[0] else (p[2], p[1], p[3])) for p in parts if p]


def past_midnight(time: Floats) -> Floats:
    """Return times in seconds of a clock that starts again at midnight."""
    return time + 86400.0 * np.cumsum(np.diff(time, prepend=time[0]) < -43200)


def square(count: int) -> bool:
    return count > 0 and round(count**0.5) ** 2 == count


def _template(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the words of a name and its numbers; numbers before a row and a column belong to the words."""
    before = re.match(r"(.*\d.*?)(?=r(?:ow)?[ _]?\d+[ _]?c(?:ol)?[ _]?\d+$)", name, re.IGNORECASE)
    start = before[1] if before else ""
    parts = re.split(r"(\d+)", name[len(start) :])
    numbers = tuple(int(n) if len(n) < 19 else PLACES_MAX for n in parts[1::2])
    return start.lower() + "#".join(parts[::2]).lower(), numbers


def _is_comment(line: str, *more: str) -> bool:
    return line.lstrip().startswith(("#", "%", *more))


def _mark_of(line: str) -> str | None:
    """Return the character between the cells of a line; None: spaces."""
    line = re.sub(r'"[^"]*"', "q", line)
    if mark := next((m for m in (";", "\t", "|") if m in line), None):
        return mark
    if "," in line and re.search(r"\d,\d+\s+[-+\d]", line) and not re.search(r",\s", line):
        return None  # 0,5 1,5: decimal commas between spaces
    return "," if "," in line else None
