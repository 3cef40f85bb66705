# SPDX-License-Identifier: Apache-2.0
"""`dermis extract` writes the parameters of the channels in transistors, `dermis equivalence` holds them to it."""

from __future__ import annotations

import os
from collections.abc import Sequence

import click

from dermis.chip.sky130 import CORNERS
from dermis.errors import InputError
from dermis.files import write_between
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene import extracted
from dermis.scene.design import ROOT
from scripts.characterise import runs
from tb.programs.equivalence import cases, extract, gate
from tb.programs.equivalence.gate import Case

LENGTH = Case(codes=(0, 64, 200, 250))
"""Cases that are also read with a gate of the full length."""

DOCS = ROOT / "docs" / "equivalence.md"


@click.command("extract")
@click.option("--check", is_flag=True, help="Write nothing; say which files are older than the circuit.")
@click.option("--corner", multiple=True, type=click.Choice(CORNERS), help="Only the files of these corners.")
def extract_command(check: bool, corner: tuple[str, ...]) -> int:
    """Measure the blocks in transistors and write models/extracted, one file a condition."""
    if check:
        rows = [stale_row()]
        verdict.print_rows(rows)
        return verdict.exit_code(rows)
    conditions = [at for at in cases.CONDITIONS if not corner or at.corner in corner]
    with progress.slots("extract", len(conditions), "conditions") as tell:
        for done, at in enumerate(conditions, 1):
            wanted = [(case.topology, case.k) for case in cases.everything() if case.condition == at]
            path = extracted.write(at.corner, at.celsius, extract.channels(at, wanted, runs.measured))
            click.echo(f"{path.relative_to(ROOT)}")
            tell(done, f"after {path.name}")
    return 0


def stale_row() -> Row:
    """How many files are missing or older than the circuit, and why."""
    paths = [extracted.path_of(at.corner, at.celsius) for at in cases.CONDITIONS]
    why = [extracted.stale(p) if p.exists() else f"{p.name}: missing" for p in paths]
    return verdict.judge("equivalence.stale_files", sum(map(bool, why)), "; ".join(filter(None, why)))


def chosen(words: Sequence[str]) -> list[Case]:
    """The columns with any of these words in their names, or all of them."""
    found = [c for c in cases.everything() if not words or any(w in c.name for w in words)]
    if not found:
        known = ", ".join(c.name for c in cases.everything())
        raise InputError("command line", "--only", " ".join(words), f"part of one of {known}")
    return found


def gate_rows(chosen_cases: Sequence[Case], jobs: int, fresh: bool = False) -> list[Row]:
    """A row a column: the largest distance in counts between the circuit and the model of it."""
    with progress.slots("equivalence", len(chosen_cases), "columns") as tell:
        found = cases.shown([(case, None) for case in chosen_cases], jobs, tell, fresh)
    rows = []
    for case, slots in zip(chosen_cases, found, strict=True):
        name = f"equivalence.counts_apart.{case.name}"
        if isinstance(slots, str):
            rows.append(verdict.error(name, slots))
            continue
        try:
            told = gate.compare(case, slots)
        except ValueError as error:
            rows.append(verdict.error(name, str(error)))
            continue
        apart = ", ".join(f"{code}: {d:+.2f}" for code, d in zip(told["codes"], told["apart"], strict=True))
        rows.append(verdict.judge(name, told["worst"], apart))
    return rows


def length_rows(jobs: int, fresh: bool = False) -> list[Row]:
    """Judge the short gate against the full one: counted codes, and predictions of the short one."""
    short = LENGTH
    with progress.slots("equivalence", 2, "gates") as tell:
        found = cases.shown([(short, None), (cases.full(short), None)], jobs, tell, fresh)
    name = "equivalence.short_gate_error"
    if any(isinstance(slots, str) for slots in found):
        return [verdict.error(name, "; ".join(s for s in found if isinstance(s, str)))]
    foreseen = gate.read(found[0]).counts()
    counted = [int(slot.bits.sum()) for slot in found[1]]
    # A count is truncated: up to one below the prediction.
    beyond = [max(c - u, u - c - 1.0, 0.0) for c, u in zip(counted, foreseen, strict=True)][
        gate.SETTLING_ROWS :
    ]
    said = ", ".join(f"{c} ({u:.2f})" for c, u in zip(counted, foreseen, strict=True))
    return [verdict.judge(name, max(beyond), f"counted in 510 clocks (foreseen from {short.clocks}): {said}")]


def table(rows: Sequence[Row]) -> str:
    """The rows of the gate for docs/equivalence.md."""
    lines = ["| column | counts apart | by ideal code | |", "|---|--:|---|---|"]
    for row in rows:
        if row["name"] == "equivalence.stale_files":
            continue
        value = "" if row["value"] is None else f"{row['value']:.2f}"
        name = row["name"].removeprefix("equivalence.").removeprefix("counts_apart.")
        lines.append(f"| `{name}` | {value} | {row['note']} | {row['status']} |")
    return "\n".join(lines)


@click.command("equivalence")
@click.option("--only", multiple=True, metavar="WORD", help="Columns with this word in their names.")
@click.option(
    "--faults",
    "with_faults",
    is_flag=True,
    help="Seed faults in the netlists instead, and see which are caught.",
)
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=os.cpu_count(), show_default=True, help="Processes."
)
@click.option("--fresh", is_flag=True, help="Run what is kept from earlier runs as well.")
@click.option("--docs", is_flag=True, help="Also write the table in docs/equivalence.md.")
def equivalence_command(only: tuple[str, ...], with_faults: bool, jobs: int, fresh: bool, docs: bool) -> int:
    """Channels in transistors against the models extracted from them; rows in build/equivalence.json."""
    if docs and only:
        raise InputError("command line", "--docs", "with --only", "a whole run")
    if with_faults:
        from tb.programs.equivalence import faults

        return faults.command(only, jobs, fresh, docs)
    rows = [stale_row(), *gate_rows(chosen(only), jobs, fresh)]
    if not only:
        rows += length_rows(jobs, fresh)
    verdict.write_rows("equivalence", rows)
    verdict.print_rows(rows, "equivalence")
    if docs:
        begin, end = (
            "<!-- " + word + " -->"
            for word in ("begin: gate (written by dermis equivalence --docs)", "end: gate")
        )
        write_between(DOCS, begin, end, table(rows))
    return verdict.exit_code(rows)
