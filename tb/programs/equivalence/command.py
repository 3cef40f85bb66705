# SPDX-License-Identifier: Apache-2.0
"""`dermis extract` writes the parameters of the channels in transistors; `dermis equivalence` tests them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Sequence
from typing import Any

import click

from dermis.errors import InputError
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene import design as design_module
from dermis.scene import extracted
from dermis.scene.design import ROOT
from scripts import workers
from scripts.characterise import results, runs
from scripts.characterise.benches import BENCHES
from scripts.checkpoint import Checkpoint
from tb.programs.equivalence import columns, extract, faults, gate, rules
from tb.programs.equivalence.columns import Column, Slot
from tb.programs.equivalence.gate import Case

LENGTH = Case(codes=(0, 64, 200, 250))
"""The column that is also read with a gate of the full length."""


@click.command("extract")
@click.option("--check", is_flag=True, help="Write nothing; say which files are older than the circuit.")
def extract_command(check: bool) -> int:
    """Measure the blocks in transistors and write models/extracted, one file a condition."""
    if check:
        rows = [stale_row()]
        verdict.print_rows(rows)
        return verdict.exit_code(rows)
    typical = runs.Runs(runs.Job(name, runs.TYPICAL) for name in BENCHES)
    typical.run(2, lambda done: None)
    results.record(typical.outcomes)
    with progress.slots("extract", len(gate.CONDITIONS), "conditions") as tell:
        for done, at in enumerate(gate.CONDITIONS, 1):
            wanted = [(case.topology, case.k) for case in gate.everything() if case.condition == at]
            path = extracted.write(at.corner, at.celsius, extract.channels(at, wanted, runs.measured))
            click.echo(f"{path.relative_to(ROOT)}")
            tell(done, f"after {path.name}")
    return 0


def chosen(every: dict[str, Any], only: Sequence[str]) -> list[Any]:
    """Return the values whose names hold one of the words, or all of them."""
    found = [value for name, value in every.items() if not only or any(word in name for word in only)]
    if not found:
        raise InputError("command line", "--only", " ".join(only), f"part of one of {', '.join(every)}")
    return found


def stale_row() -> Row:
    """Judge how many files are missing or older than the circuit, with the reasons."""
    paths = [extracted.path_of(at.corner, at.celsius) for at in gate.CONDITIONS]
    why = [extracted.stale(p) if p.exists() else f"{p.name}: missing" for p in paths]
    return verdict.judge("equivalence.stale_files", sum(map(bool, why)), "; ".join(filter(None, why)))


def _records(title: str, asked: Sequence[Column], jobs: int, fresh: bool) -> list[list[Slot] | str]:
    with progress.slots(title, len(asked), "columns") as tell:
        return columns.records(asked, jobs, tell, fresh)


def gate_row(case: Case, slots: list[Slot] | str) -> Row:
    """Judge the largest distance in counts between a column in transistors and its model."""
    name = f"equivalence.counts_apart.{case.name}"
    try:
        if isinstance(slots, str):
            return verdict.error(name, slots)
        apart = gate.compare(case, slots)
    except ValueError as error:
        return verdict.error(name, str(error))
    note = ", ".join(f"{code}: {d:+.2f}" for code, d in apart.items())
    return verdict.judge(name, max(map(abs, apart.values())), note)


def length_row(jobs: int, fresh: bool) -> Row:
    """Judge the prediction of a short gate against the counts of a full one."""
    name = "equivalence.short_gate_error"
    short = LENGTH.column()
    full = dataclasses.replace(short, clocks=design_module.load().timing.gate_clocks)
    found = _records("equivalence", [short, full], jobs, fresh)
    if any(isinstance(slots, str) for slots in found):
        return verdict.error(name, "; ".join(s for s in found if isinstance(s, str)))
    foreseen = gate.read(found[0]).counts()
    counted = [int(slot.bits.sum()) for slot in found[1]]
    # A count is truncated: up to one below the prediction.
    beyond = [max(c - u, u - c - 1.0, 0.0) for c, u in zip(counted, foreseen, strict=True)]
    said = ", ".join(f"{c} ({u:.2f})" for c, u in zip(counted, foreseen, strict=True))
    note = f"counted in {full.clocks} clocks (foreseen from {short.clocks}): {said}"
    return verdict.judge(name, max(beyond[gate.SETTLING_ROWS :]), note)


def fault_row(kind: str, slots: list[Slot] | str) -> Row:
    """Return PASS for a fault that the gate noticed, SKIP for one that it missed, ERROR for one not measured."""
    name = f"equivalence.fault.{kind}"
    if isinstance(slots, str):
        return verdict.error(name, slots, "caught")
    row = gate_row(faults.LOOP, slots)
    if row["status"] == "PASS":
        return verdict.skip(name, f"not noticed; {row['note']}", "caught")
    return verdict.report(name, 1, "caught", row["note"])


def fault_rows(only: Sequence[str], jobs: int, fresh: bool) -> list[Row]:
    """Put the seeded faults to the gate: a row each, and the share of those noticed."""
    kinds = [kind for kind in faults.FAULTS if not only or any(word in kind for word in only)]
    if not kinds:
        return []
    asked = [faults.LOOP.column(faults.written(kind, columns.WORK / "faults")) for kind in kinds]
    found = _records("faults", asked, jobs, fresh)
    rows = [fault_row(kind, slots) for kind, slots in zip(kinds, found, strict=True)]
    known = [row["status"] == "PASS" for row in rows if row["status"] != "ERROR"]
    note = f"{len(known)} of {len(rows)} measured"
    return [
        *rows,
        verdict.judge("equivalence.faults_caught", sum(known) / len(known) if known else None, note),
    ]


def rule_rows(only: Sequence[str], jobs: int, fresh: bool) -> list[Row]:
    """Put the faults of every rule to the benches: a row for each that passes, and the share of the others."""
    asked = [fault for fault in rules.faults() if not only or any(word in fault.name for word in only)]
    stamp = hashlib.sha256(json.dumps([extracted.circuit_digests(), rules.digest()]).encode()).hexdigest()
    kept = Checkpoint(columns.WORK / "rules.json", stamp, fresh=fresh)
    todo = [fault for fault in asked if fault.name not in kept.pieces]
    tasks = (
        workers.Task(rules.noticed, (fault, columns.WORK / "rules"), rules.TASK_LIMIT_S) for fault in todo
    )
    with progress.slots("rules", len(asked), "faults") as tell:
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs), len(asked) - len(todo) + 1):
            kept.put(todo[number].name, outcome.value if not outcome.fault else outcome.fault, now=False)
            tell(done)
    kept.save()
    passed = [fault.name for fault in asked if not kept.pieces[fault.name]]
    share = 1.0 - len(passed) / len(asked) if asked else None
    rows = [verdict.skip(f"equivalence.passes.{name}", rules.reason(name)) for name in passed]
    return [
        *rows,
        verdict.judge("equivalence.faults_noticed", share, f"{len(asked) - len(passed)} of {len(asked)}"),
    ]


@click.command("equivalence")
@click.option("--only", multiple=True, metavar="WORD", help="Columns with this word in their names.")
@click.option("--faults", "seeded", is_flag=True, help="Seed faults in the netlists; say which are caught.")
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=os.cpu_count(), show_default=True, help="Processes."
)
@click.option("--fresh", is_flag=True, help="Run what is kept from earlier runs as well.")
def equivalence_command(only: tuple[str, ...], seeded: bool, jobs: int, fresh: bool) -> int:
    """Channels in transistors against the models extracted from them; rows in build/equivalence.json."""
    if seeded:
        names = (*faults.FAULTS, *(fault.name for fault in rules.faults()))
        if only and not any(word in name for word in only for name in names):
            allowed = f"part of one of {', '.join(faults.FAULTS)}, or of SUBCIRCUIT.ELEMENT.KIND"
            raise InputError("command line", "--only", " ".join(only), allowed)
        rows = fault_rows(only, jobs, fresh) + rule_rows(only, jobs, fresh)
    else:
        cases = chosen({case.name: case for case in gate.everything()}, only)
        found = _records("equivalence", [case.column() for case in cases], jobs, fresh)
        rows = [stale_row(), *(gate_row(*pair) for pair in zip(cases, found, strict=True))]
        rows += [] if only else [length_row(jobs, fresh)]
    target = "equivalence_faults" if seeded else "equivalence"
    verdict.write_rows(target, rows)
    verdict.print_rows(rows, target)
    return verdict.exit_code(rows)
