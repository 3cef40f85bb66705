# SPDX-License-Identifier: Apache-2.0
"""Tables and marks of Markdown."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from dermis.errors import SimulatorError
from dermis.files import write_between
from dermis.report.verdict import Row


def table(head: Iterable[str], rows: Iterable[Iterable[str]], rule: str = "---") -> str:
    """Return a table; `rule` aligns its columns, one for all or `---|--:` with one each. Bars in cells are escaped."""
    head = list(head)
    rules = rule.split("|") if "|" in rule else [rule] * len(head)
    lines = [f"| {' | '.join(head)} |".replace("|  |", "| |"), f"|{'|'.join(rules)}|"]
    escaped = ((cell.replace("|", "\\|") for cell in cells) for cells in rows)
    return "\n".join([*lines, *(f"| {' | '.join(cells)} |" for cells in escaped)])


def limits(low: float | None, high: float | None) -> str:
    """Return the cell of two limits, empty without any."""
    said = ("" if limit is None else f"{limit:g}" for limit in (low, high))
    return " .. ".join(said).strip() if (low, high) != (None, None) else ""


def rows_table(rows: Iterable[Row]) -> str:
    lines = []
    for row in rows:
        bounds = (("≥", row["min"]), ("≤", row["max"]))
        limit = ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)
        value = "" if row["value"] is None else f"{row['value']:.6g}"
        lines.append((f"`{row['name']}`", value, row["unit"], limit, row["status"], row["note"]))
    head = ("name", "value", "unit", "limit", "status", "note")
    return table(head, lines, "---|--:|---|---|---|---")


def write(page: Path, name: str, command: str, content: str) -> None:
    """Put a table of a command between its marks in a page; InputError if they are not there once."""
    begin = f"<!-- begin: {name} (written by dermis {command} --docs) -->"
    write_between(page, begin, f"<!-- end: {name} -->", content)


def filled(text: str, parts: Mapping[str, str], name: str) -> str:
    """Return a text with its marks replaced; SimulatorError if one does not occur once."""
    for mark, part in parts.items():
        if text.count(mark) != 1:
            raise SimulatorError(f"{name} has no single mark {mark}")
        text = text.replace(mark, part)
    return text
