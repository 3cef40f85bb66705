# SPDX-License-Identifier: Apache-2.0
"""Sessions in worker processes: Hypothesis draws inputs of a target, and shrinks the first input of
each finding.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import sys
import tempfile
import time
import types
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
from hypothesis import HealthCheck, Phase, Verbosity, configuration

from tb.programs.fuzz import oracle, target
from tb.programs.fuzz.faults import FAULTS
from tb.programs.fuzz.oracle import Finding

AGAIN = 500
"""Inputs after which the memory limit is set anew, for Hypothesis remembers inputs."""

SHRINK_S = 30.0
ROOM_BYTES = 8 << 30
"""Address space for preparing a target, in bytes: compilers of loops and their libraries."""


@contextlib.contextmanager
def prepared(name: str) -> Iterator[tuple[target.Target, Path]]:
    """Load and prepare a target in a directory of its own."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory(prefix=f"fuzz_{name}_", ignore_cleanup_errors=True) as directory:
        place = Path(directory).resolve()
        configuration.set_hypothesis_home_dir(place / "hypothesis")
        loaded = target.load(name)
        oracle.limit_memory(
            ROOM_BYTES
        )  # that of the target before is too small for what loads and compiles now
        loaded.prepare(place)
        try:
            yield loaded, place
        finally:
            loaded.end()
            os.chdir(before)


def _limits(inputs: int, shrink: bool) -> hypothesis.settings:
    return hypothesis.settings(
        max_examples=inputs,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
        verbosity=Verbosity.quiet,
        report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck),
    )


class Session:
    """Runs inputs of a target, counts them, and holds the smallest input of each finding."""

    def __init__(self, loaded: target.Target, place: Path, last: Path | None = None) -> None:
        self.target, self.place = loaded, place
        self.counts: Counter[str] = Counter()
        self.found: dict[str, tuple[bytes, Finding]] = {}
        # The last input stays on the disk if the process dies of it.
        self._last = None if last is None else os.open(last, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
        self._shrinking, self._until = "", 0.0

    def run(self, inputs: int, seed: int, shrink: bool = True) -> None:
        """Run a number of inputs."""
        warnings.simplefilter(
            "ignore", hypothesis.errors.HypothesisWarning
        )  # inputs of 30 kB are long to print
        strategy = self.target.inputs()
        _limits(50, False)(
            hypothesis.given(strategy)(lambda data: None)
        )()  # tables are built before memory is limited
        oracle.limit_memory()
        while (left := inputs - self.counts["inputs"]) > 0:
            self._shrinking = ""
            given = hypothesis.given(strategy)(self._one)
            try:
                hypothesis.seed(seed * 100 + len(self.found))(_limits(left, shrink)(given))()
            except (Finding, hypothesis.errors.Flaky):
                if not shrink:
                    return
            if inputs - self.counts["inputs"] == left:
                return  # no further input exists

    def _one(self, data: bytes) -> None:
        if not self._shrinking:
            if self.counts["inputs"] % AGAIN == 0:
                oracle.limit_memory()
            self.counts["inputs"] += 1
            if self._last is not None:
                os.ftruncate(self._last, len(data))
                os.pwrite(self._last, data, 0)
        elif time.monotonic() > self._until and data != self.found[self._shrinking][0]:
            return
        try:
            outcome = self.target.run(data, self.place)
        except Finding as finding:
            signature = finding.signature
            if not self._shrinking and signature not in self.found:
                self._shrinking, self._until = signature, time.monotonic() + SHRINK_S
            if signature == self._shrinking:
                self.found[signature] = data, finding
                raise
        else:
            self.counts[outcome] += not self._shrinking


def fuzz(name: str, inputs: int, seed: int, last: str) -> dict[str, Any]:
    """Run a round of inputs and return its piece: counts and findings, the input of each as latin-1
    text.
    """
    start = time.monotonic()
    with prepared(name) as (loaded, place):
        session = Session(loaded, place, Path(last))
        session.run(inputs, seed)
    found = [
        {"kind": f.kind, "signature": s, "text": f.text, "data": data.decode("latin-1")}
        for s, (data, f) in session.found.items()
    ]
    return {"counts": {**session.counts, "seconds": time.monotonic() - start}, "found": found}


def seeded(fault: str, inputs: int, seed: int) -> dict[str, Any]:
    """Seed a fault and run inputs until its oracle sees it; return the kind seen and the inputs
    taken.
    """
    case, other = FAULTS[fault], ""
    with prepared(case.target) as (loaded, place):
        session = Session(loaded, place)
        case.seed()
        while session.counts["inputs"] < inputs:
            before = len(session.found)
            session.run(inputs, seed, shrink=False)
            for _, finding in session.found.values():
                if finding.kind in case.kinds:
                    return {
                        "kind": finding.kind,
                        "inputs": session.counts["inputs"],
                        "text": finding.text[:300],
                    }
                other = str(finding)[:300]
            if len(session.found) == before:
                break
    return {"kind": "", "inputs": session.counts["inputs"], "text": other}


def replay(files: list[str]) -> list[str]:
    """Run stored inputs, named after their targets, and return a line for each that is still a
    finding.
    """
    lines = []
    by_target = itertools.groupby(
        sorted(files, key=lambda f: target.NAMES.index(Path(f).name.split("_")[0])),
        lambda f: Path(f).name.split("_")[0],
    )
    for name, own in by_target:
        with prepared(name) as (loaded, place):
            for file in own:
                oracle.limit_memory()
                try:
                    loaded.run(Path(file).read_bytes(), place)
                except Finding as finding:
                    lines.append(f"{Path(file).name}: {finding}")
    return lines


def cover(name: str, inputs: int, seed: int) -> list[int]:
    """Return the lines of a target's modules that some inputs reach, and the lines there are."""
    reached: set[tuple[str, int]] = set()

    def local(frame: types.FrameType, event: str, _: Any) -> Any:
        reached.add((frame.f_code.co_filename, frame.f_lineno))
        return local

    with prepared(name) as (loaded, place):
        files = {sys.modules[module].__file__ or "" for module in loaded.modules if module in sys.modules}

        def traced(data: bytes, place: Path) -> str:
            sys.settrace(lambda frame, event, _: local if frame.f_code.co_filename in files else None)
            try:
                return loaded.run(data, place)
            except Finding:  # a round reports it; tracing takes time and memory
                return "taken"
            finally:
                sys.settrace(None)

        Session(dataclasses.replace(loaded, run=traced), place).run(inputs, seed, shrink=False)
    there = {(file, line) for file in files for line in _lines(compile(Path(file).read_text(), file, "exec"))}
    return [len(reached & there), len(there)]


def _lines(code: types.CodeType) -> set[int]:
    """Return the lines of the functions in a module."""
    inner = [const for const in code.co_consts if isinstance(const, types.CodeType)]
    own = {line for _, _, line in code.co_lines() if line} if code.co_name != "<module>" else set()
    return own.union(*(_lines(one) for one in inner))
