# SPDX-License-Identifier: Apache-2.0
"""Verdict rows: a measured value against its limit in models/spec.toml, with four outcomes.

PASS and FAIL are measurements; ERROR is a value not measured (None, NaN, infinite); SKIP has a reason.
"""

import json
import math
import statistics
from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.scene.design import Limit, spec

Row = dict[str, Any]
KEYS = ("name", "value", "unit", "min", "max", "status", "note")
AIM_MISSED = "aim missed"
"""Start of the note of a row that misses a limit without gate; every other SKIP has no value."""
COLOURS = {"PASS": "green", "FAIL": "bold red", "ERROR": "bold magenta", "SKIP": "yellow"}


def limit(name: str) -> Limit:
    """Return the limit of a name: its own, or that of the longest dotted prefix that has one.

    Raises KeyError without such a limit in models/spec.toml: a value without one is `report`-ed, not judged.
    """
    parts = name.split(".")
    for end in range(len(parts), 1, -1):
        if found := spec().get(".".join(parts[:end])):
            return found
    raise KeyError(f"models/spec.toml has no limit for {name}")


def _number(value: Any) -> int | float | None:
    if value is None or not math.isfinite(number := float(value)):
        return None
    # Doubles hold whole numbers up to 2^53 exactly.
    whole = number.is_integer() and abs(number) < 2**53 and not isinstance(value, float)
    return int(number) if whole else number


def _row(*values: Any) -> Row:
    return dict(zip(KEYS, values, strict=True))


def _with(said: str, note: str) -> str:
    return f"{said}; {note}" if note else said


def judge(name: str, value: Any, note: str = "") -> Row:
    """Judge a value against its limit and return the verdict row.

    A limit with ``gate = false`` is an aim: a miss gives SKIP, with "aim missed", value and aim in the note.
    """
    rule = limit(name)
    row = within(name, value, rule.unit, rule.min, rule.max, note)
    if row["status"] == "FAIL" and not rule.gate:
        below = rule.min is not None and row["value"] < rule.min
        aim = f"at least {rule.min:g}" if below else f"at most {rule.max:g}"
        miss = f"{AIM_MISSED}: {row['value']:.4g}, wanted {aim}"
        return row | {"status": "SKIP", "note": _with(miss, note)}
    return row


def aims_missed(rows: Sequence[Row]) -> list[Row]:
    """Return the rows whose value misses a limit without gate."""
    return [row for row in rows if row["status"] == "SKIP" and row["note"].startswith(AIM_MISSED)]


def within(name: str, value: Any, unit: str, low: float | None, high: float | None, note: str = "") -> Row:
    """Judge a value against limits that are not in models/spec.toml."""
    number = _number(value)
    if number is None:
        said = "not measured" if value is None else f"not a number: {value}"
        return _row(name, None, unit, low, high, "ERROR", _with(said, note))
    missed = (low is not None and number < low) or (high is not None and number > high)
    return _row(name, number, unit, low, high, "FAIL" if missed else "PASS", note)


def report(name: str, value: Any, unit: str, note: str = "") -> Row:
    """Return the row of a value that has no limit: PASS when measured, else ERROR."""
    number = _number(value)
    if number is None and not note:
        note = "not measured"
    return _row(name, number, unit, None, None, "ERROR" if number is None else "PASS", note)


def measured(name: str, value: Any, unit: str, note: str = "") -> Row:
    """Judge a value if it has a limit, else report it."""
    try:
        limit(name)
    except KeyError:
        return report(name, value, unit, note)
    return judge(name, value, note)


def median(name: str, values: Sequence[float], unit: str, note: str = "") -> Row:
    """Return the row of the median of measurements: spread in the note, all in "runs"."""
    spread = f"{len(values)} runs, {min(values):.4g} .. {max(values):.4g}"
    row = measured(name, statistics.median(values), unit, _with(spread, note))
    return row | {"runs": [float(value) for value in values]}


def skip(name: str, reason: str, unit: str = "") -> Row:
    """Return the row of a check that did not run, with the reason."""
    if not reason:
        raise ValueError("a SKIP needs its reason")
    try:
        rule = limit(name)
    except KeyError:
        return _row(name, None, unit, None, None, "SKIP", reason)
    return _row(name, None, rule.unit, rule.min, rule.max, "SKIP", reason)


def error(name: str, reason: str, unit: str = "") -> Row:
    """Return the row of a check that ran but did not measure, with the reason."""
    return skip(name, reason, unit) | {"status": "ERROR"}


WRITTEN: list[tuple[str, list[Row]]] = []
"""Tables that this process has written, by target, for the report page."""


def write_rows(target: str, rows: Sequence[Row]) -> None:
    """Write build/<target>.json whole or not at all."""
    write_atomic(BUILD / f"{target}.json", json.dumps(list(rows), indent=1, allow_nan=False) + "\n")
    WRITTEN.append((target, list(rows)))


def console() -> Console:
    """Return a console as wide as the terminal, or of a fixed width elsewhere."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(width=150, highlight=False)


def in_words(row: Row) -> str:
    """Return value, unit and limits of a row as text."""
    words = {"min": "at least", "max": "at most"}
    limits = [f"{word} {row[key]:.6g}" for key, word in words.items() if row[key] is not None]
    value = "no value" if row["value"] is None else f"{row['value']:.4g} {row['unit']}"
    return f"{value} ({' and '.join(limits)})" if limits else value


def print_table(
    title: str, heads: Sequence[str], rows: Iterable[Sequence[str | Text]], numbers: Sequence[str]
) -> Console:
    """Print a table whose columns `numbers` are aligned to the right; return its console. Brackets are no markup."""
    named = Text(title, style="table.title") if title else None
    table = Table(title=named, box=box.SIMPLE_HEAD, title_justify="left")
    for heading in heads:
        number = heading in numbers
        side = "right" if number else "left"
        table.add_column(Text(heading), justify=side, overflow="fold", no_wrap=number)
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    screen = console()
    screen.print(table)
    return screen


def print_rows(rows: Sequence[Row], title: str = "") -> None:
    """Print the rows as a table, and a line with the number of each outcome."""
    numbers = ("value", "min", "max")
    lines = []
    for row in rows:
        status = Text(row["status"], style=COLOURS[row["status"]])
        values = ("" if row[key] is None else f"{row[key]:.6g}" for key in numbers)
        lines.append((row["name"], *values, row["unit"], status, row["note"]))
    screen = print_table(title, ("name", *numbers, "unit", "status", "note"), lines, numbers)
    counts = ", ".join(f"{sum(r['status'] == s for r in rows)} {s}" for s in COLOURS)
    missed = len(aims_missed(rows))
    screen.print(f"{counts}, {missed} of them missed aims" if missed else counts)


def exit_code(rows: Sequence[Row]) -> int:
    """Return 0 if there are rows and every one is PASS or SKIP, else 1."""
    return 0 if rows and all(row["status"] in ("PASS", "SKIP") for row in rows) else 1
