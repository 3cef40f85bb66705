# SPDX-License-Identifier: Apache-2.0
"""`dermis extract` writes the parameters of the channels in transistors; `dermis equivalence` tests them."""

import dataclasses
from collections.abc import Iterable, Sequence

import click

from dermis.errors import InputError
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene import design as design_module
from dermis.scene import extracted
from dermis.scene.design import ROOT
from scripts import judged, workers
from scripts.characterise import results, runs
from scripts.characterise.benches import BENCHES
from scripts.checkpoint import Checkpoint
from tb.programs.equivalence import columns, extract, faults, gate
from tb.programs.equivalence.columns import Slot
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
    with progress.slots("extract", len(runs.EXTRACTED), "conditions") as tell:
        for done, at in enumerate(runs.EXTRACTED, 1):
            wanted = [(case.topology, case.k) for case in gate.everything() if case.condition == at]
            path = extracted.write(at.corner, at.celsius, extract.channels(at, wanted))
            click.echo(f"{path.relative_to(ROOT)}")
            tell(done, f"after {path.name}")
    return 0


def chosen(names: Iterable[str], only: Sequence[str], allowed: str = "") -> list[str]:
    """Return the names that hold one of the words, or all of them; InputError for none where `allowed` are named."""
    found = [name for name in names if not only or any(word in name for word in only)]
    if allowed and not found:
        raise InputError("command line", "--only", " ".join(only), f"part of one of {allowed}")
    return found


def stale_row() -> Row:
    """Judge how many files are missing or older than the circuit, with the reasons."""
    paths = [extracted.path_of(at.corner, at.celsius) for at in runs.EXTRACTED]
    why = [extracted.stale(p) if p.exists() else f"{p.name}: missing" for p in paths]
    return verdict.judge("equivalence.stale_files", sum(map(bool, why)), "; ".join(filter(None, why)))


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
    found = columns.records([short, full], jobs, "length", fresh)
    if any(isinstance(slots, str) for slots in found):
        return verdict.error(name, "; ".join(s for s in found if isinstance(s, str)))
    foreseen = gate.counts(gate.read(found[0]))
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
    if not (kinds := chosen(faults.FAULTS, only)):
        return []
    asked = [faults.LOOP.column(faults.written(kind, columns.WORK / "faults")) for kind in kinds]
    found = columns.records(asked, jobs, "faults", fresh)
    rows = [fault_row(kind, slots) for kind, slots in zip(kinds, found, strict=True)]
    known = [row["status"] == "PASS" for row in rows if row["status"] != "ERROR"]
    share = sum(known) / len(known) if known else None
    note = f"{len(known)} of {len(rows)} measured"
    return [*rows, verdict.judge("equivalence.faults_caught", share, note)]


def rule_rows(only: Sequence[str], jobs: int, fresh: bool) -> list[Row]:
    """Put the faults of every rule to the benches: a row for each that passes, and the share of the others."""
    every = {fault.name: fault for fault in faults.by_rule()}
    asked = [every[name] for name in chosen(every, only)]
    stamp = judged.digest((), extracted.circuit_digests(), faults.digest())
    kept = Checkpoint(columns.WORK / "rules.json", stamp, fresh=fresh)
    work, limit_s = columns.WORK / "rules", faults.TASK_LIMIT_S
    tasks = {fault.name: workers.Task(faults.noticed, (fault, work), limit_s) for fault in asked}
    with progress.slots("rules", len(tasks), "faults") as tell:
        lost = kept.run(tasks, jobs, tell)
    passed = [name for name in tasks if not (kept.pieces | lost)[name]]  # one that never ends is noticed
    share = 1.0 - len(passed) / len(tasks) if tasks else None
    note = f"{len(tasks) - len(passed)} of {len(tasks)}"
    rows = [verdict.skip(f"equivalence.passes.{name}", faults.reason(name)) for name in passed]
    return [*rows, verdict.judge("equivalence.faults_noticed", share, note)]


@click.command("equivalence")
@click.option("--only", multiple=True, metavar="WORD", help="Columns with this word in their names.")
@click.option("--faults", "seeded", is_flag=True, help="Seed faults in the netlists; say which are caught.")
@columns.JOBS
@columns.FRESH
def equivalence_command(only: tuple[str, ...], seeded: bool, jobs: int, fresh: bool) -> int:
    """Channels in transistors against the models extracted from them; rows in build/equivalence.json."""
    if seeded:
        known = (*faults.FAULTS, *(fault.name for fault in faults.by_rule()))
        chosen(known, only, f"{', '.join(faults.FAULTS)}, or of SUBCIRCUIT.ELEMENT.KIND")
        rows = fault_rows(only, jobs, fresh) + rule_rows(only, jobs, fresh)
    else:
        every = {case.name: case for case in gate.everything()}
        cases = [every[name] for name in chosen(every, only, ", ".join(every))]
        found = columns.records([case.column() for case in cases], jobs, "equivalence", fresh)
        rows = [stale_row(), *(gate_row(*pair) for pair in zip(cases, found, strict=True))]
        rows += [] if only else [length_row(jobs, fresh)]
    target = "equivalence_faults" if seeded else "equivalence"
    return judged.finish(target, rows, target)
