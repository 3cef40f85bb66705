# SPDX-License-Identifier: Apache-2.0
"""`dermis fuzz`: hostile input to every reader in worker processes; findings are shrunk and
stored.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError, SimulatorError, one_line
from dermis.files import write_atomic, write_between
from dermis.places import BUILD, ROOT
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts import workers
from scripts.checkpoint import Checkpoint, stamp
from tb.programs.fuzz import session
from tb.programs.fuzz.faults import FAULTS
from tb.programs.fuzz.target import NAMES

WORK = BUILD / "fuzz"
FOUND = ROOT / "tb" / "programs" / "fuzz" / "found"
DOCS = BUILD / "fuzz.md"
CODE = Path(__file__).parent, ROOT / "tb" / "reference", ROOT / "scripts"

INPUTS = {
    "scene": 10_000,
    "frames": 12_000,
    "spi": 40_000,
    "registers": 30_000,
    "design": 8_000,
    "command": 1_000,
}
"""Inputs of a whole run, few where one takes long."""

ROUND = 2_000
"""Inputs of one process: an interrupted run loses as many."""

ROUND_S, SEEDED_S = 900.0, 240.0
"""Time limits of a process on a busy machine."""

SEEDED_INPUTS, COVER_INPUTS = 3_000, 200


def rounds(wanted: Mapping[str, int], seed: int) -> dict[str, workers.Task]:
    """Return the processes of a run by name of their piece."""
    tasks = {}
    for name, inputs in wanted.items():
        for n, first in enumerate(range(0, inputs, ROUND)):
            size, piece = min(ROUND, inputs - first), f"{name}.{n}.{min(ROUND, inputs - first)}"
            arguments = name, size, seed * 10_000 + n, str(WORK / f"{piece}.last")
            tasks[piece] = workers.Task(session.fuzz, arguments, ROUND_S)
    return tasks


def store_finding(name: str, kind: str, signature: str, data: bytes) -> Path:
    """Write the input of a finding to FOUND; `make test` replays it."""
    path = FOUND / f"{name}_{kind}_{hashlib.sha256(signature.encode()).hexdigest()[:8]}"
    if not path.exists():
        write_atomic(path, data)
    return path


def alone(function: Any, *arguments: Any, limit_s: float = 300.0) -> Any:
    """Run one call in a process of its own, whose memory it limits."""
    [(_, outcome)] = workers.run([workers.Task(function, arguments, limit_s)], 1, fresh=True)
    if outcome.fault:
        raise SimulatorError(f"fuzz {function.__name__} {arguments[0]}: {outcome.fault}")
    return outcome.value


def rows_of(
    wanted: Mapping[str, int], pieces: Mapping[str, Any], faults: Mapping[str, str], seen: Mapping[str, Any]
) -> list[Row]:
    """Return the rows of build/fuzz.json.

    Parameters
    ----------
    wanted : target -> inputs
    pieces : of the checkpoint
    faults : piece -> how its process failed
    seen : seeded fault -> what was seen of it
    """
    rows, total = [], 0
    for name, inputs in wanted.items():
        own = [piece for key, piece in pieces.items() if key.startswith(f"{name}.")]
        counts: Counter[str] = Counter()
        for piece in own:
            counts.update(piece["counts"])
        total += counts["inputs"]
        note = f"{counts['taken']} taken, {counts['refused']} refused, {counts['seconds']:.0f} s"
        rows.append(verdict.within(f"fuzz.inputs.{name}", counts["inputs"], "inputs", inputs, None, note))
        found = {one["signature"]: one["text"] for piece in own for one in piece["found"]}
        for key, fault in faults.items():
            if key.startswith(f"{name}."):
                if (WORK / f"{key}.last").exists():
                    found[f"crash of {key}"] = fault
                else:
                    rows.append(verdict.error(f"fuzz.ends.{name}", one_line(f"round {key}: {fault}", 400)))
        first = "".join(f"; {one_line(f'{s}: {text}', 200)}" for s, text in list(found.items())[:1])
        rows.append(
            verdict.judge(f"fuzz.findings.{name}", len(found), f"of {counts['inputs']} inputs{first}")
        )
        reached, there = pieces.get(f"lines.{name}", (0, 0))
        if there:
            percent, note = 100.0 * reached / there, f"{reached} of {there}, by {COVER_INPUTS} inputs"
            rows.append(verdict.report(f"fuzz.lines.{name}", percent, "%", note))
    rows.append(verdict.report("fuzz.inputs.all", total, "inputs"))
    if seen:
        missed = [name for name, said in seen.items() if not said["kind"]]
        note = f"of {len(seen)}" + (f"; missed: {', '.join(missed)}" if missed else "")
        rows.append(verdict.judge("fuzz.seeded_faults_missed", len(missed), note))
    return rows


def docs_table(rows: list[Row], seen: Mapping[str, Any]) -> str:
    """Return the tables of build/fuzz.md."""
    value = {row["name"]: row["value"] for row in rows}
    note = {row["name"]: row["note"] for row in rows}
    lines = ["| target | inputs | outcome | findings |", "|---|---:|---|---:|"]
    for name in NAMES:
        inputs = f"fuzz.inputs.{name}"
        lines.append(f"| {name} | {value[inputs]} | {note[inputs]} | {value[f'fuzz.findings.{name}']} |")
    lines += ["", "| seeded fault | target | seen as | after inputs |", "|---|---|---|---:|"]
    for name, said in seen.items():
        fault = FAULTS[name]
        lines.append(
            f"| {fault.meaning} | {fault.target} | {said['kind'] or 'NOT SEEN'} | {said['inputs']} |"
        )
    return "\n".join(lines)


def _wanted(inputs: int | None, only: tuple[str, ...]) -> dict[str, int]:
    for name in only:
        if name not in NAMES:
            raise InputError("command line", "--only", name, f"one of {', '.join(NAMES)}")
    names = only or NAMES
    share = sum(INPUTS[name] for name in names)
    return {n: INPUTS[n] if inputs is None else max(1, round(inputs * INPUTS[n] / share)) for n in names}


@click.command("fuzz")
@click.option("--only", multiple=True, metavar="TARGET", help=f"Targets (repeatable): {', '.join(NAMES)}.")
@click.option(
    "--inputs", type=click.IntRange(1, 10**9), help=f"Inputs of all targets; default {sum(INPUTS.values())}."
)
@click.option("--seed", type=click.IntRange(0, 10**6), default=0, show_default=True, help="Random seed.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Worker processes.")
@click.option("--fresh", is_flag=True, help="Ignore an earlier run with this seed and code.")
@click.option(
    "--faults/--no-faults", "seed_faults", default=True, help="Also check that seeded faults are seen."
)
@click.option("--docs", is_flag=True, help="Write the tables to build/fuzz.md.")
def fuzz_command(
    only: tuple[str, ...],
    inputs: int | None,
    seed: int,
    jobs: int,
    fresh: bool,
    seed_faults: bool,
    docs: bool,
) -> int:
    """Give hostile input to everything that reads; rows in build/fuzz.json.

    An interrupted run continues, unless the code has changed. A finding is shrunk and stored in
    tb/programs/fuzz/found.
    """
    wanted = _wanted(inputs, only)
    if docs and (only or inputs is not None or not seed_faults):
        raise InputError("command line", "--docs", "with --only, --inputs or --no-faults", "a whole run")
    WORK.mkdir(parents=True, exist_ok=True)
    store = Checkpoint(WORK / f"state_{seed}.json", stamp(*CODE), fresh=fresh)
    tasks = rounds(wanted, seed)
    ran = sum(int(name.split(".")[2]) for name in tasks if name in store.pieces)
    if all(name in store.pieces for name in tasks):
        click.echo("every input ran before with this code and seed; --fresh runs them again", err=True)
    with progress.slots("fuzz", sum(wanted.values()), "inputs") as show:

        def on_done(name: str) -> None:
            nonlocal ran
            ran += int(name.split(".")[2])
            show(ran, f"after {name}")

        faults = store.run(tasks, jobs, on_done, fresh=True)
        for name in faults:
            last = WORK / f"{name}.last"
            if last.exists():
                store_finding(name.split(".")[0], "crash", last.read_text("latin-1"), last.read_bytes())
        for name in tasks:
            for one in store.pieces[name]["found"] if name in store.pieces else ():
                data = one["data"].encode("latin-1")
                click.echo(
                    f"stored: {store_finding(name.split('.')[0], one['kind'], one['signature'], data)}"
                )
        more = {f"lines.{n}": workers.Task(session.cover, (n, COVER_INPUTS, seed), SEEDED_S) for n in wanted}
        chosen = [name for name, fault in FAULTS.items() if fault.target in wanted] if seed_faults else []
        for name in chosen:
            more[f"seeded.{name}"] = workers.Task(session.seeded, (name, SEEDED_INPUTS, seed), SEEDED_S)
        missing = {"kind": "", "inputs": 0, "text": "no answer"}
        store.run(more, jobs, fresh=True)
    seen = {name: store.pieces.get(f"seeded.{name}", missing) for name in chosen}
    pieces = {name: piece for name, piece in store.pieces.items() if name in tasks or name in more}
    rows = rows_of(wanted, pieces, faults, seen)
    verdict.write_rows("fuzz", rows)
    verdict.print_rows(rows, "Hostile input")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if docs and broken:
        click.echo(f"not written: {DOCS.relative_to(ROOT)}, for {broken[0]} was not measured", err=True)
    elif docs:
        marks = "<!-- begin: fuzz (written by dermis fuzz --docs) -->", "<!-- end: fuzz -->"
        write_between(DOCS, *marks, docs_table(rows, seen))
    return verdict.exit_code(rows)
