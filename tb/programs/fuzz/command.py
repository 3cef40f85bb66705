# SPDX-License-Identifier: Apache-2.0
"""`dermis fuzz`: every target in processes of its own, resumable, its findings made small and stored, a row each."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import click

from dermis.engines import batch
from dermis.errors import InputError, SimulatorError, one_line
from dermis.files import write_atomic, write_between
from dermis.places import BUILD, ROOT
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from scripts.checkpoint import Checkpoint
from tb.programs.fuzz import worker
from tb.programs.fuzz.target import GUIDES, NAMES

WORK = ROOT / "build" / "fuzz"
FOUND = ROOT / "tb" / "fuzz" / "found"
DOCS = BUILD / "fuzz.md"
BEGIN, END = "<!-- begin: fuzz (written by dermis fuzz --docs) -->", "<!-- end: fuzz -->"

INPUTS = {
    "scene": 10_000,
    "frames": 12_000,
    "spi": 40_000,
    "registers": 30_000,
    "design": 8_000,
    "command": 1_000,
}
"""Inputs of a whole run: 101 000; few where one takes long, so that all take about as long."""

ROUND = 5_000
"""Inputs of one process: what a run that is interrupted loses of one target, and how far memory may creep."""

ROUND_S = 900.0
"""Longest time of one process, on a machine that does much else."""

REDUCE_S, COVER_S, SEEDED_S = 30.0, 40.0, 60.0
SEEDED_INPUTS = 2_000
"""Inputs within which a seeded fault must be seen; each of them is met by some of the first thousand."""

RESTARTS = 20
"""Processes that may die on an input of a target before it is given up."""


@dataclass
class Progress:
    """What is done of a target; kept in build/fuzz/TARGET/state.json."""

    inputs: int = 0
    taken: int = 0
    refused: int = 0
    seconds: float = 0.0
    rounds: int = 0
    crashes: int = 0
    branches: int = 0
    features: int = 0
    findings: list[str] = field(default_factory=list)
    died: list[str] = field(default_factory=list)
    lines: dict[str, list[int]] = field(default_factory=dict)


def _kept(name: str, seed: int) -> Checkpoint:
    return Checkpoint(WORK / name / "state.json", f"{batch.fingerprint()} {seed}")


def _progress(kept: Checkpoint) -> Progress:
    """What an earlier run of the same seed on the same code has done, or nothing."""
    return Progress(**kept.pieces.get("progress", {}))


def _worker(log: Path, limit_s: float, **asked: Any) -> int | None:
    """Run a worker process; its exit code, None at its limit."""
    command = [sys.executable, "-m", "tb.programs.fuzz.worker", json.dumps(asked)]
    return children.run_child(command, log.parent, log, limit_s)


def _asked(log: Path, limit_s: float, **asked: Any) -> Any:
    """What a worker answers.

    Raises
    ------
    SimulatorError
        It did not.
    """
    answer = log.with_suffix(".answer.json")
    answer.unlink(missing_ok=True)
    code = _worker(log, limit_s, answer=str(answer), **asked)
    if code != 0 or not answer.exists():
        said = "took more than its time" if code is None else f"ended with exit code {code}"
        raise SimulatorError(f"the worker that was to {asked['mode']} {said}", log)
    return json.loads(answer.read_text())


def run_target(name: str, inputs: int, seed: int, on_inputs: Callable[[int], None]) -> Progress:
    """Run inputs of a target, from where an earlier run of this seed and code stopped.

    Findings go to tb/fuzz/found; a process that ended and left no input is told in `died`.
    """
    directory = WORK / name
    kept = _kept(name, seed)
    done = _progress(kept)
    if not done.inputs:
        shutil.rmtree(directory, ignore_errors=True)
    for part in ("found", "corpus"):
        (directory / part).mkdir(parents=True, exist_ok=True)
    log = directory / "worker.log"
    while done.inputs < inputs and done.crashes <= RESTARTS:
        log.unlink(missing_ok=True)
        counts = directory / "counts"
        counts.unlink(missing_ok=True)
        start = time.monotonic()
        more = min(ROUND, inputs - done.inputs)
        code = _worker(
            log,
            ROUND_S,
            mode="fuzz",
            name=name,
            inputs=more,
            seed=seed * 1000 + done.rounds,
            work=str(directory),
        )
        ran = counts.read_bytes() if counts.exists() else b""
        if len(ran) != worker.COUNTS.size or not worker.COUNTS.unpack(ran)[0]:
            raise SimulatorError(f"the worker of {name} ran no input ({_end(code)})", log)
        total, taken, refused = worker.COUNTS.unpack(ran)
        done.inputs, done.taken, done.refused = (
            done.inputs + total,
            done.taken + taken,
            done.refused + refused,
        )
        done.seconds += time.monotonic() - start
        done.rounds += 1
        if code != 0:
            done.crashes += 1
            if not _keep_crash(name, directory / "found", log, code):
                done.died.append(
                    f"round {done.rounds} {_end(code)} after {total} inputs and left none; see {log}"
                )
        text = log.read_text(errors="replace")
        if told := re.findall(r"cov: (\d+) ft: (\d+)", text):
            done.branches, done.features = (
                max(a, int(b)) for a, b in zip((done.branches, done.features), told[-1], strict=True)
            )
        done.findings = sorted({*done.findings, *_store(name, directory)})
        kept.put("progress", asdict(done))
        on_inputs(total)
    return done


def _end(code: int | None) -> str:
    return f"was ended at {ROUND_S:g} s" if code is None else f"ended with exit code {code}"


def _keep_crash(name: str, found: Path, log: Path, code: int | None) -> bool:
    """Make a finding of the input that libFuzzer left when the process ended; whether it left one."""
    kept = False
    for left in sorted(found.iterdir()):
        if left.name.split("-")[0] in ("crash", "timeout", "oom", "leak"):
            data = left.read_bytes()
            left.unlink()
            kept = True
            stem = f"{name}_crash_{hashlib.sha256(data).hexdigest()[:8]}"
            (found / stem).write_bytes(data)
            end = one_line(log.read_text(errors="replace")[-400:], 300)
            told = {
                "target": name,
                "kind": "crash",
                "place": "the process",
                "text": f"exit code {code}: {end}",
            }
            (found / f"{stem}.json").write_text(json.dumps(told))
    return kept


def _store(name: str, directory: Path) -> list[str]:
    """Make new findings small and put them into tb/fuzz/found, from where `make test` replays them; their lines."""
    lines = []
    for told in sorted((directory / "found").glob("*.json")):
        data, kept = told.with_suffix(""), FOUND / told.stem
        said = json.loads(told.read_text())
        signature = f"{said['kind']} {said['place']}"
        lines.append(f"{told.stem}: {signature}: {said['text'][:200]}")
        if kept.exists():
            continue
        if said["kind"] != "crash":
            _worker(
                directory / "reduce.log",
                2 * REDUCE_S + 60,
                mode="reduce",
                file=str(data),
                signature=signature,
                seconds=REDUCE_S,
            )
        write_atomic(kept, data.read_bytes())
    return lines


def cover(name: str, done: Progress) -> None:
    """Measure which lines the inputs that are kept reach."""
    directory = WORK / name
    files = sorted(str(path) for part in ("seeds", "corpus") for path in (directory / part).glob("*"))
    done.lines = _asked(
        directory / "cover.log", COVER_S + 120, mode="cover", name=name, files=files, seconds=COVER_S
    )


def short(inputs: dict[str, int], seed: int = 0) -> dict[str, dict[str, Any]]:
    """A short deterministic run of some targets in one worker: what was taken and refused, or the first finding."""
    told: dict[str, dict[str, Any]] = _one_worker("short", inputs=inputs, seed=seed)
    return told


def _one_worker(mode: str, limit_s: float = 300.0, **asked: Any) -> Any:
    with tempfile.TemporaryDirectory() as directory:
        log = Path(directory) / f"{mode}.log"
        try:
            return _asked(log, limit_s, mode=mode, **asked)
        except SimulatorError as error:
            # The log goes with the directory: its end is all there will be.
            end = one_line(log.read_text(errors="replace")[-1000:], 600)
            raise SimulatorError(f"{error.what}: {end}") from None


def replay(files: list[Path]) -> list[dict[str, str]]:
    """Run inputs of tb/fuzz/found in a worker; the rows of those that are findings still."""
    if not files:
        return []
    told: list[dict[str, str]] = _one_worker("replay", files=[str(path) for path in files])
    return told


def seeded(names: list[str], seed: int = 0, inputs: int = SEEDED_INPUTS) -> dict[str, dict[str, Any]]:
    """Put each seeded fault in alone and see how many inputs it takes to be seen; by fault."""
    told: dict[str, dict[str, Any]] = _one_worker(
        "seeded", 60.0 + SEEDED_S * len(names), faults=names, inputs=inputs, seed=seed, seconds=SEEDED_S
    )
    return told


def rows_of(
    done: dict[str, Progress], wanted: dict[str, int], faults: dict[str, dict[str, Any]]
) -> list[Row]:
    """The rows of build/fuzz.json."""
    rows = []
    for name, state in done.items():
        note = f"{state.taken} taken, {state.refused} refused, {state.seconds:.0f} s"
        rows.append(verdict.within(f"fuzz.inputs.{name}", state.inputs, "inputs", wanted[name], None, note))
        if state.died:
            note = f"{len(state.died)} of {state.rounds} processes, the first: {state.died[0]}"
            rows.append(verdict.error(f"fuzz.ends.{name}", one_line(note, 400)))
        first = "; " + one_line(state.findings[0], 200) if state.findings else ""
        rows.append(
            verdict.judge(f"fuzz.findings.{name}", len(state.findings), f"of {state.inputs} inputs{first}")
        )
        reached, there = (sum(v[n] for v in state.lines.values()) for n in (0, 1))
        if there:
            rows.append(
                verdict.report(f"fuzz.lines.{name}", 100.0 * reached / there, "%", f"{reached} of {there}")
            )
    total = sum(state.inputs for state in done.values())
    rows.append(verdict.report("fuzz.inputs.all", total, "inputs"))
    if faults:
        missed = [name for name, told in faults.items() if not told["kind"]]
        note = f"of {len(faults)}" + (f"; missed: {', '.join(missed)}" if missed else "")
        rows.append(verdict.judge("fuzz.seeded_faults_missed", len(missed), note))
    return rows


def docs_table(done: dict[str, Progress], faults: dict[str, dict[str, Any]]) -> str:
    """Return the tables of inputs and of seeded faults."""
    from tb.programs.fuzz.faults import FAULTS

    lines = [
        "| target | inputs | taken | refused | branches | lines of its modules | findings left | s |",
        "|---|---:|---:|---:|---:|---|---:|---:|",
    ]
    for name, state in done.items():
        covered = ", ".join(
            f"{m.removeprefix('dermis.')} {100 * a / b:.0f} %" for m, (a, b) in state.lines.items() if b
        )
        lines.append(
            f"| {name} | {state.inputs} | {state.taken} | {state.refused} | {state.branches} | {covered} | "
            f"{len(state.findings)} | {state.seconds:.0f} |"
        )
    lines.append(
        f"| all | {sum(s.inputs for s in done.values())} | | | | | {sum(len(s.findings) for s in done.values())} | |"
    )
    if faults:
        lines += ["", "| seeded fault | target | seen as | after inputs |", "|---|---|---|---:|"]
        for name, told in faults.items():
            fault = FAULTS[name]
            lines.append(
                f"| {fault.what} | {fault.target} | {told['kind'] or 'NOT SEEN'} | {told['inputs']} |"
            )
    return "\n".join(lines)


def _counts(inputs: int | None, only: tuple[str, ...]) -> dict[str, int]:
    for name in only:
        if name not in NAMES:
            raise InputError("command line", "--only", name, f"one of {', '.join(NAMES)}")
    names = only or NAMES
    if inputs is None:
        return {name: INPUTS[name] for name in names}
    share = sum(INPUTS[name] for name in names)
    return {name: max(1, round(inputs * INPUTS[name] / share)) for name in names}


def _whole(only: tuple[str, ...], inputs: int | None, seed_faults: bool, docs: bool) -> None:
    """Refuse to write tables of a part, and to run without atheris."""
    if docs and (only or inputs is not None or not seed_faults):
        raise InputError("command line", "--docs", "with --only, --inputs or --no-faults", "a whole run")
    if reason := missing():
        raise InputError(
            "command line", "fuzz", reason, "Python 3.11 to 3.13 on x86_64, as requirements.txt says"
        )


def missing() -> str:
    """Why inputs guided by coverage cannot be run here, or nothing."""
    return "" if importlib.util.find_spec("atheris") else "atheris is not installed"


@click.command("fuzz")
@click.option(
    "--only", multiple=True, metavar="TARGET", help=f"Only this target (repeatable): {', '.join(GUIDES)}."
)
@click.option(
    "--inputs",
    type=click.IntRange(1, 10**9),
    help=f"Inputs over all targets; default {sum(INPUTS.values())}.",
)
@click.option("--seed", type=click.IntRange(0, 10**6), default=0, show_default=True, help="Of the mutations.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Targets at a time.")
@click.option("--fresh", is_flag=True, help="Forget what an earlier run of this seed and code has done.")
@click.option(
    "--faults/--no-faults", "seed_faults", default=True, help="Also show that every seeded fault is seen."
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
    """Hostile input, guided by coverage, to everything that reads; rows in build/fuzz.json.

    A run that is interrupted goes on where it stopped, unless the code has changed since. What is found is made
    small, stored in tb/fuzz/found and replayed by `make test` from then on.
    """
    from tb.programs.fuzz.faults import FAULTS

    wanted = _counts(inputs, only)
    _whole(only, inputs, seed_faults, docs)
    if fresh:
        for name in wanted:
            shutil.rmtree(WORK / name, ignore_errors=True)
    WORK.mkdir(parents=True, exist_ok=True)
    FOUND.mkdir(parents=True, exist_ok=True)
    if not any(_progress(_kept(name, seed)).inputs < wanted[name] for name in wanted):
        click.echo(
            "every input was run before on this code with this seed; --fresh runs them again", err=True
        )
    done: dict[str, Progress] = {}
    ran, lock = 0, threading.Lock()
    with progress.slots("fuzz", sum(wanted.values()), "inputs") as show, children.threads(jobs) as pool:

        def on_inputs(more: int) -> None:
            nonlocal ran
            with lock:
                ran += more
                show(ran)

        def one(name: str) -> Progress:
            state = run_target(name, wanted[name], seed, on_inputs)
            cover(name, state)
            _kept(name, seed).put("progress", asdict(state))
            return state

        futures = {name: pool.submit(one, name) for name in wanted}
        done = {name: future.result() for name, future in futures.items()}
        chosen = [name for name, fault in FAULTS.items() if fault.target in wanted] if seed_faults else []
        parts = [part for n in range(jobs) if (part := chosen[n::jobs])]
        told = {name: row for part in pool.map(seeded, parts) for name, row in part.items()}
    faults = {name: told[name] for name in chosen}
    rows = rows_of(done, wanted, faults)
    verdict.write_rows("fuzz", rows)
    verdict.print_rows(rows, "Hostile input")
    broken = [row["name"] for row in rows if row["status"] == "ERROR"]
    if docs and broken:
        click.echo(f"not written: {DOCS.relative_to(ROOT)}, for {broken[0]} was not measured", err=True)
    elif docs:
        write_between(DOCS, BEGIN, END, docs_table(done, faults))
    return verdict.exit_code(rows)
