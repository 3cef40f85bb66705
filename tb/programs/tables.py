# SPDX-License-Identifier: Apache-2.0
"""Verdict rows as a Markdown table."""

from __future__ import annotations

from collections.abc import Sequence

from dermis.report.verdict import Row


def markdown(rows: Sequence[Row]) -> str:
    """Return a table of rows."""
    lines = ["| row | value | unit | status | note |", "|---|--:|---|---|---|"]
    for row in rows:
        note = row["note"].replace("|", "\\|")
        lines.append(f"| {row['name']} | {row['value']} | {row['unit']} | {row['status']} | {note} |")
    return "\n".join(lines)
