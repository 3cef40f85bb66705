# SPDX-License-Identifier: Apache-2.0
"""Hypothesis on one target, in a process whose package the target may change."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import itertools
import os
import tempfile
import types
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase, Verbosity

from dermis.errors import SimulatorError
from dermis.places import BUILD, ROOT
from scripts import workers
from tb.programs.fuzz.oracle import Finding

NAMES = ("scene", "frames", "spi", "registers", "design", "command")
"""Targets. Each is a module target_NAME with `strategy() -> SearchStrategy[bytes]`, `prepare(place)`,
called once in a process with the directory of its inputs, and `run(data, place)`, which returns "taken"
or "refused" or raises Finding."""

WORK = BUILD / "fuzz"
FOUND = ROOT / "tb" / "programs" / "fuzz" / "found"


def file_of(name: str, kind: str, signature: str) -> Path:
    """Return the file of a finding; `make test` repeats what is there."""
    return FOUND / f"{name}_{kind}_{hashlib.sha256(signature.encode()).hexdigest()[:8]}"


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


def fuzz(name: str, inputs: int, seed: int, fault: str = "", stored: bool = False) -> dict[str, Any]:
    """Run inputs of a target and store the smallest input of each finding in FOUND.

    Parameters
    ----------
    name, inputs, seed : target, number of inputs, random seed
    fault : a seeded fault; the run ends with its first finding, and stores nothing
    stored : first run the inputs in FOUND, which are the example database (that of Hypothesis takes
        no seed)

    Returns
    -------
    dict
        inputs, taken, refused, and found: signature -> text.
    """
    from tb.programs.fuzz.faults import FAULTS

    counts: Counter[str] = Counter()
    found: dict[str, tuple[bytes, Finding]] = {}
    with prepared(name) as (target, place), warnings.catch_warnings():
        warnings.simplefilter("ignore", hypothesis.errors.HypothesisWarning)  # inputs are long to print
        if fault:
            FAULTS[fault].seed()
        # The last input stays on the disk if the process dies of it.
        last = os.open(WORK / f"{name}.{seed}.last", os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)

        def one(data: bytes) -> None:
            counts["inputs"] += not found  # those that shrink a finding do not count
            os.ftruncate(last, 0)
            os.pwrite(last, data, 0)
            try:
                counts[target.run(data, place)] += 1
            except Finding as finding:
                if fault and finding.kind not in FAULTS[fault].kinds:
                    return
                if len(data) <= len(found.get(finding.signature, (data,))[0]):
                    found[finding.signature] = data, finding
                raise

        settings = hypothesis.settings(
            max_examples=inputs,
            database=None,
            deadline=None,
            phases=(Phase.generate,) if fault else (Phase.explicit, Phase.generate, Phase.shrink),
            verbosity=Verbosity.quiet,
            report_multiple_bugs=not fault,
            suppress_health_check=list(HealthCheck),
        )
        test = hypothesis.seed(seed)(settings(hypothesis.given(target.strategy())(one)))
        for file in FOUND.glob(f"{name}_*") if stored else ():
            test = hypothesis.example(file.read_bytes())(test)
        with contextlib.suppress(Finding, ExceptionGroup, hypothesis.errors.Flaky):  # they are in `found`
            test()
        os.close(last)
    for signature, (data, finding) in {} if fault else found.items():
        file_of(name, finding.kind, signature).write_bytes(data)
    return {**counts, "found": {signature: str(finding) for signature, (_, finding) in found.items()}}


def replay(files: Sequence[Path]) -> list[str]:
    """Run stored inputs, named after their targets, and return a line for each that is a finding."""
    lines = []
    for name, own in itertools.groupby(sorted(files), lambda file: file.name.partition("_")[0]):
        with prepared(name) as (target, place):
            for file in own:
                try:
                    target.run(file.read_bytes(), place)
                except Finding as finding:
                    lines.append(f"{file.name}: {finding}")
    return lines


def alone(function: Any, *arguments: Any, limit_s: float = 550.0) -> Any:
    """Run one call in a process of its own."""
    WORK.mkdir(parents=True, exist_ok=True)
    [(_, outcome)] = workers.run([workers.Task(function, arguments, limit_s)], 1, fresh=True)
    if outcome.fault:
        raise SimulatorError(f"fuzz {function.__name__}: {outcome.fault}")
    return outcome.value
