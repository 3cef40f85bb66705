# SPDX-License-Identifier: Apache-2.0
"""Tables of Markdown."""

from __future__ import annotations

from collections.abc import Iterable


def table(head: Iterable[str], rows: Iterable[Iterable[str]], rule: str = "---") -> str:
    """Return a table; `rule` aligns its columns, one for all or `---|--:` with one each."""
    head = list(head)
    rules = rule.split("|") if "|" in rule else [rule] * len(head)
    lines = [f"| {' | '.join(head)} |".replace("|  |", "| |"), f"|{'|'.join(rules)}|"]
    return "\n".join([*lines, *(f"| {' | '.join(cells)} |" for cells in rows)])
