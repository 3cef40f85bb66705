# SPDX-License-Identifier: Apache-2.0
"""The table and the figures of docs/characterise.md."""

from __future__ import annotations

from collections.abc import Sequence

from dermis.chip import spice_batch
from dermis.files import write_between
from dermis.report.machine import machine_line
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts.characterise import figures
from scripts.characterise.results import Series
from scripts.characterise.run_all import Runs

DOCS = ROOT / "docs" / "characterise.md"
FIGURES = ROOT / "docs" / "figures"
BEGIN, END = "<!-- begin: table (written by dermis characterise --docs) -->", "<!-- end: table -->"


def table(found: Sequence[Series], rows: Sequence[Row], runs: Runs) -> str:
    """Every row: least, typical, most, limits, the worst place."""
    seconds = sum(o.measured.seconds for o in runs.outcomes.values() if o.measured is not None)
    climbed = sum(bool(o.measured and o.measured.rungs) for o in runs.outcomes.values())
    failed = sum(bool(o.fault) for o in runs.outcomes.values())
    lines = [
        f"{len(runs.outcomes)} runs of ngspice {spice_batch.version()}, {seconds / 60:.0f} minutes of wall clock in "
        f"ngspice, with other work beside them ({machine_line()}); "
        f"{climbed} needed a further rung of the ladder, {failed} ended as ERROR. "
        "A row again: `dermis characterise --only sky130.ROW` and what stands under *worst*.",
        "",
        "| row | least | typical | most | limit | unit | status | worst |",
        "|---|--:|--:|--:|---|---|---|---|",
    ]
    for one, row in zip(found, rows, strict=True):
        numbers = (
            min(one.values.values(), default=None),
            one.typical,
            max(one.values.values(), default=None),
        )
        least, typical, most = ("" if n is None else f"{n:.3g}" for n in numbers)
        low = "" if row["min"] is None else f"{row['min']:g}"
        high = "" if row["max"] is None else f"{row['max']:g}"
        limit = f"{low} .. {high}" if low or high else ""
        worst = f"`{one.worst}`" if one.values else ""
        lines.append(
            f"| {one.name} | {least} | {typical} | {most} | {limit} | {row['unit']} | {row['status']} | {worst} |"
        )
    return "\n".join(lines)


def write(found: Sequence[Series], rows: Sequence[Row], runs: Runs) -> None:
    """Write table and figures."""
    write_between(DOCS, BEGIN, END, table(found, rows, runs))
    for name, draw in figures.FIGURES.items():
        draw(runs.outcomes, FIGURES / f"characterise_{name}.png")
