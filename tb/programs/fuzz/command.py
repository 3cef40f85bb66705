# SPDX-License-Identifier: Apache-2.0
"""`dermis fuzz`: Hypothesis draws hostile input for every reader, each in a process of its own.

A target is a module target_NAME with `strategy() -> SearchStrategy[bytes]`, `prepare(place)`, called once
with the directory of its inputs, and `run(data, place)`, which returns "taken" or "refused" or raises Finding.
"""

import contextlib
import hashlib
import importlib
import tempfile
import types
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import hypothesis
from hypothesis import HealthCheck, Verbosity

from dermis.chip import netlist
from dermis.places import BUILD, ROOT
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene import schema, stimulus
from scripts import judged, workers
from tb.programs.fuzz.oracle import Finding

INPUTS = {"scene": 12_000, "frames": 12_000}
"""Inputs of a whole run by target, few where one takes long."""

ROUND = 2_000  # inputs of one process, which remembers all of them
ROUND_S, SEEDED_INPUTS = 900.0, 3_000
WORK = BUILD / "fuzz"
FOUND = ROOT / "tb" / "programs" / "fuzz" / "found"

# ---- seeded faults: each replaces one function of the package, and shows that an oracle works ---------------------


def _title_in_deck(whole: Any) -> Any:
    def titled(made: Any, *rest: Any, **more: Any) -> Any:
        deck = whole(made, *rest, **more)
        return deck.__class__(**{**vars(deck), "lines": (f"* {made.scene.title}", *deck.lines)})

    return titled


def _digit(whole: Any) -> Any:
    return lambda v: f"{v:.1g}" if isinstance(v, float) and v % 1 else whole(v)


FAULTS = {
    "title_in_deck": ("scene", netlist, "frame_deck", _title_in_deck),
    "resolved_keeps_one_digit": ("scene", schema, "_toml_value", _digit),
    "room_for_the_limit": (
        "frames",
        stimulus,
        "read_bytes",
        lambda _: lambda path, limit, by=None: open(path, "rb").read(limit),
    ),
    "nan_accepted": ("frames", stimulus, "_check_values", lambda _: lambda *given: None),
}
"""Target that must meet a fault, then the attribute of a module and its replacement as a function of it."""


@contextlib.contextmanager
def prepared(name: str) -> Iterator[tuple[types.ModuleType, Path]]:
    """Import and prepare a target in a directory of its own."""
    target = importlib.import_module(f"tb.programs.fuzz.target_{name}")
    with (
        tempfile.TemporaryDirectory(prefix=f"fuzz_{name}_", ignore_cleanup_errors=True) as directory,
        contextlib.chdir(directory),
    ):
        place = Path(directory).resolve()
        target.prepare(place)
        yield target, place


def fuzz(name: str, inputs: int, seed: int, fault: str = "") -> dict[str, Any]:
    """Run inputs of a target and store the smallest one of each finding in FOUND, unless a fault is seeded.

    Returns the numbers of inputs, taken and refused, and `found`: the texts of findings by signature.
    """
    counts: Counter[str] = Counter()
    found: dict[str, tuple[bytes, Finding]] = {}
    last = WORK / f"{name}.{seed}.last"  # stays if the process dies of it
    with prepared(name) as (target, place), warnings.catch_warnings():
        warnings.simplefilter("ignore", hypothesis.errors.HypothesisWarning)  # inputs are long to print
        if fault:
            _, of, attribute, change = FAULTS[fault]
            setattr(of, attribute, change(getattr(of, attribute)))

        @hypothesis.seed(seed)
        @hypothesis.settings(
            max_examples=inputs,
            database=None,  # FOUND is the database: that of Hypothesis takes no seed
            deadline=None,
            verbosity=Verbosity.quiet,
            report_multiple_bugs=not fault,
            suppress_health_check=list(HealthCheck),
        )
        @hypothesis.given(target.strategy())
        def test(data: bytes) -> None:
            counts["inputs"] += not found  # those that shrink a finding do not count
            last.write_bytes(data)
            try:
                counts[target.run(data, place)] += 1
            except Finding as finding:
                if len(data) <= len(found.get(finding.signature, (data,))[0]):
                    found[finding.signature] = data, finding
                raise

        with contextlib.suppress(Finding, ExceptionGroup, hypothesis.errors.Flaky):  # they are in `found`
            test()
    for signature, (data, finding) in {} if fault else found.items():
        digest = hashlib.sha256(signature.encode()).hexdigest()[:8]
        (FOUND / f"{name}_{finding.kind}_{digest}").write_bytes(data)
    return {**counts, "found": {signature: str(finding) for signature, (_, finding) in found.items()}}


def replay(name: str) -> dict[str, dict[str, str]]:
    """Run the stored inputs of a target; return the texts of `found`, by file."""
    found = {}
    with prepared(name) as (target, place):
        for file in sorted(FOUND.glob(f"{name}_*")):
            try:
                target.run(file.read_bytes(), place)
            except Finding as finding:
                found[file.name] = str(finding)
    return {"found": found}


def rows_of(tasks: Sequence[workers.Task], outcomes: Sequence[workers.Outcome]) -> list[Row]:
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    findings: dict[str, list[str]] = defaultdict(list)
    missed, seeded = [], 0
    for task, outcome in zip(tasks, outcomes, strict=True):
        name, *rest = task.arguments
        piece = dict(outcome.value or {})
        found = list(piece.pop("found", {}).values())
        if fault := rest[2] if len(rest) > 2 else "":
            seeded += 1
            missed += [] if found else [f"{fault}: {outcome.fault or 'not seen'}"]
            continue
        findings[name] += [*found, *filter(None, [outcome.fault])]
        counts[name].update(piece)
    rows = []
    for name, own in counts.items():
        note = f"{own['taken']} taken, {own['refused']} refused"
        rows.append(verdict.report(f"fuzz.inputs.{name}", own["inputs"], "inputs", note))
        note = "; ".join(f"{text:.200}" for text in findings[name][:3])
        rows.append(verdict.judge(f"fuzz.findings.{name}", len(findings[name]), note))
    if seeded:
        rows.append(verdict.judge("fuzz.seeded_faults_missed", len(missed), f"of {seeded}; {missed}"))
    return rows


def tasks_of(names: Sequence[str], inputs: int | None, seed: int) -> list[workers.Task]:
    """Return the processes of a run: stored inputs, new ones, seeded faults."""
    share = sum(INPUTS[name] for name in names)
    tasks = [workers.Task(replay, (name,), ROUND_S) for name in names]
    for name in names:
        wanted = INPUTS[name] if inputs is None else max(1, round(inputs * INPUTS[name] / share))
        for n, first in enumerate(range(0, wanted, ROUND)):
            arguments = name, min(ROUND, wanted - first), seed * 10_000 + n
            tasks.append(workers.Task(fuzz, arguments, ROUND_S))
    seeded = [(target, SEEDED_INPUTS, seed, fault) for fault, (target, *_) in FAULTS.items()]
    return tasks + [workers.Task(fuzz, a, ROUND_S) for a in seeded if a[0] in names]


@click.command("fuzz")
@click.option("--only", multiple=True, type=click.Choice(list(INPUTS)), help="Targets (repeatable).")
@judged.number("--inputs", None, f"Inputs of all targets; default {sum(INPUTS.values())}.", 1, 10**9)
@judged.number("--seed", 0, "Random seed.", 0, 10**6)
@judged.number("--jobs", 2, "Worker processes.", 1, 64)
def fuzz_command(only: tuple[str, ...], inputs: int | None, seed: int, jobs: int) -> int:
    """Give hostile input to everything that reads; rows in build/fuzz.json.

    A finding is shrunk and stored in tb/programs/fuzz/found; the next run starts with it.
    """
    WORK.mkdir(parents=True, exist_ok=True)
    tasks = tasks_of(only or list(INPUTS), inputs, seed)
    outcomes = [workers.Outcome()] * len(tasks)
    with progress.slots("fuzz", len(tasks), "rounds") as show:
        for done, (number, outcome) in enumerate(workers.run(tasks, jobs, fresh=True), 1):
            outcomes[number] = outcome
            show(done, str(tasks[number].arguments[0]))
    rows = rows_of(tasks, outcomes)
    return judged.finish("fuzz", rows, "Hostile input")
