# SPDX-License-Identifier: Apache-2.0
"""The process that inputs run in: `python -m tb.programs.fuzz.worker JSON`; it may be ended or end itself at any input.

Nothing of the package is loaded before atheris has been told which modules guide it.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import struct
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tb.programs.fuzz.target import GUIDES

AGAIN = 500
"""Inputs after which the memory limit is set anew, beyond what the corpus in memory has grown to."""

COMPILED = (
    "dermis.array.star_mesh",
    "dermis.converter.noise",
    "dermis.converter.coupling",
    "dermis.converter.currents",
    "dermis.converter.loops",
)
"""Modules that numba compiles, which it cannot where atheris has put its calls."""

OWN = tuple(
    f"tb.programs.fuzz.{name}"
    for name in ("grammar", "oracle", "deck", *(f"{target}_target" for target in GUIDES))
)
"""Modules whose branches say nothing of the package."""

COUNTS = struct.Struct("<QQQ")
"""How inputs, taken and refused are told while the process runs: 24 bytes, written in place."""


def _place(name: str) -> Path:
    import tempfile

    return Path(tempfile.mkdtemp(prefix=f"fuzz_{name}_")).resolve()


def _load(name: str) -> tuple[Any, Path]:
    from tb.programs.fuzz import target

    loaded = target.load(name)
    place = _place(name)
    loaded.prepare(place)
    return loaded, place


class Collector:
    """Runs inputs, counts outcomes, and keeps the first input of each finding.

    Parameters
    ----------
    name : target
    found : directory for the inputs of findings, each with a JSON file that says what was seen
    counts : file that the counts are written to
    """

    def __init__(self, name: str, found: Path, counts: Path) -> None:
        self.target, self.place = _load(name)
        self._seeds = self.target.seeds()
        self.found = found
        self._counts = os.open(counts, os.O_RDWR | os.O_CREAT, 0o644)
        self.inputs = self.taken = self.refused = 0
        self._seen: set[str] = set()

    def __call__(self, data: bytes) -> None:
        """One input."""
        from tb.programs.fuzz import oracle

        if self.inputs % AGAIN == 0:
            oracle.limit_memory()
        self.inputs += 1
        try:
            outcome = self.target.run(data, self.place)
            self.taken += outcome == "taken"
            self.refused += outcome == "refused"
        except oracle.Finding as finding:
            self._keep(data, finding)
        os.pwrite(self._counts, COUNTS.pack(self.inputs, self.taken, self.refused), 0)

    def _keep(self, data: bytes, finding: Any) -> None:
        if finding.signature in self._seen:
            return
        self._seen.add(finding.signature)
        stem = (
            f"{self.target.name}_{finding.kind}_{hashlib.sha256(finding.signature.encode()).hexdigest()[:8]}"
        )
        (self.found / stem).write_bytes(data)
        told = {
            "target": self.target.name,
            "kind": finding.kind,
            "place": finding.place,
            "text": finding.text,
        }
        (self.found / f"{stem}.json").write_text(json.dumps(told))


def fuzz(name: str, inputs: int, seed: int, work: str) -> None:
    """Run libFuzzer over a target with its own mutations and atheris' branches; it ends the process."""
    import atheris

    directory = Path(work)
    # Whole packages are included: atheris knows no smaller part.
    packages = sorted({module.split(".")[0] for module in GUIDES[name]})
    with atheris.instrument_imports(include=packages, exclude=[*COMPILED, *OWN]):
        from tb.programs.fuzz import target

        target.load(name)
    collect = Collector(name, directory / "found", directory / "counts")
    seeds = directory / "seeds"
    seeds.mkdir(exist_ok=True)
    for n, data in enumerate(collect._seeds):
        (seeds / f"{n:04d}").write_bytes(data)

    def mutate(data: bytes, size: int, number: int) -> bytes:
        rng = random.Random(number)
        if rng.random() < 0.15:
            return atheris.Mutate(data, size)
        for _ in range(rng.choice((1, 1, 1, 2))):
            data = collect.target.mutate(data, rng)
        return data[:size]

    arguments = [
        sys.argv[0],
        f"-runs={inputs}",
        f"-seed={seed + 1}",
        "-max_len=32768",
        "-len_control=0",
        "-mutate_depth=1",
        "-timeout=150",
        "-rss_limit_mb=0",
        "-malloc_limit_mb=0",
        "-reload=0",
        f"-artifact_prefix={directory / 'found'}/",
        "-verbosity=1",
        str(directory / "corpus"),
        str(seeds),
    ]
    atheris.Setup(arguments, collect, custom_mutator=mutate)
    atheris.Fuzz()


def lines_of(module: Any) -> set[int]:
    """Lines of a module that can run."""
    file = module.__file__
    found: set[int] = set()
    todo = [compile(Path(file).read_text(encoding="utf-8"), file, "exec")]
    while todo:
        code = todo.pop()
        if code.co_name != "<module>":  # what runs when a module is loaded says nothing of an input
            found |= {line for _, _, line in code.co_lines() if line}
        todo += [c for c in code.co_consts if hasattr(c, "co_lines")]
    return found


def cover(name: str, files: list[str], seconds: float) -> dict[str, list[int]]:
    """Lines that inputs reach, of those there are, by module."""
    from tb.programs.fuzz import oracle

    loaded, place = _load(name)
    modules = {m: sys.modules[m] for m in GUIDES[name] if m in sys.modules}
    reached: dict[str, set[int]] = {module.__file__: set() for module in modules.values()}

    def local(frame: Any, event: str, _: Any) -> Any:
        if event == "line":
            reached[frame.f_code.co_filename].add(frame.f_lineno)
        return local

    def trace(frame: Any, event: str, _: Any) -> Any:
        return local if frame.f_code.co_filename in reached else None

    oracle.limit_memory(oracle.ADDRESS_BYTES * 4)
    end = time.monotonic() + seconds
    for file in files:
        if time.monotonic() > end:
            break
        sys.settrace(trace)
        try:
            loaded.run(Path(file).read_bytes(), place)
        except oracle.Finding:  # it is told where it was found
            continue
        finally:
            sys.settrace(None)
    told = {}
    for module_name, module in modules.items():
        there = lines_of(module)
        told[module_name] = [len(reached[module.__file__] & there), len(there)]
    return told


def replay(files: list[str]) -> list[dict[str, str]]:
    """Run inputs that were found once; a row for each that is still a finding. A file's name begins with its target."""
    from tb.programs.fuzz import oracle

    rows = []
    loaded: dict[str, tuple[Any, Path]] = {}
    for file in sorted(files):
        name = Path(file).name.split("_")[0]
        if name not in loaded:
            loaded[name] = _load(name)
        oracle.limit_memory()
        one, place = loaded[name]
        try:
            one.run(Path(file).read_bytes(), place)
        except oracle.Finding as finding:
            rows.append({"file": Path(file).name, "signature": finding.signature, "text": str(finding)})
    return rows


def reduce(file: str, signature: str, seconds: float) -> None:
    """Make the input of a finding smaller while it stays the same finding, for so long."""
    from tb.programs.fuzz import oracle

    path = Path(file)
    loaded, place = _load(path.name.split("_")[0])
    oracle.limit_memory()
    end = time.monotonic() + seconds

    def same(data: bytes) -> bool:
        try:
            loaded.run(data, place)
        except oracle.Finding as finding:
            return finding.signature == signature
        return False

    data = smaller(path.read_bytes(), same, lambda: time.monotonic() > end)
    path.write_bytes(data)


def smaller(data: bytes, same: Callable[[bytes], bool], over: Callable[[], bool]) -> bytes:
    """Leave out lines, then pieces of bytes, down to single ones, while `same` says so."""
    for split in (b"\n", b""):
        parts = data.split(split) if split else [data[n : n + 1] for n in range(len(data))]
        size = len(parts) // 2
        while size and not over():
            at = 0
            while at < len(parts) and not over():
                shorter = parts[:at] + parts[at + size :]
                if shorter and same(split.join(shorter)):
                    parts = shorter
                else:
                    at += size
            size //= 2
        data = split.join(parts)
    return data


def seeded(faults: list[str], inputs: int, seed: int, seconds: float) -> dict[str, dict[str, Any]]:
    """Put each fault in alone, in a child of this process, and run inputs until an oracle sees it.

    Parameters
    ----------
    faults : names out of `tb.programs.fuzz.faults`
    inputs, seconds : when the fault counts as not seen
    seed : of the mutations
    """
    from tb.programs.fuzz.faults import FAULTS

    told = {}
    loaded: dict[str, tuple[Any, Path]] = {}
    # Target by target, for the last of them changes what all use.
    for name in sorted(faults, key=lambda fault: list(GUIDES).index(FAULTS[fault].target)):
        case = FAULTS[name]
        if case.target not in loaded:
            loaded[case.target] = _load(case.target)
        told[name] = _in_child(
            lambda case=case: _until_seen(case, *loaded[case.target], inputs, seed), seconds
        )
    return told


def _in_child(work: Callable[[], dict[str, Any]], seconds: float) -> dict[str, Any]:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(int(seconds))  # outside of an input nothing else ends it
        try:
            os.write(writer, json.dumps(work()).encode())
        except BaseException:  # whatever it is, the parent goes on with the next fault
            traceback.print_exc()
            sys.stderr.flush()
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        said = answer.read()
    os.waitpid(child, 0)
    return json.loads(said) if said else {"inputs": 0, "kind": "", "place": "", "text": "no answer"}


def _until_seen(case: Any, target: Any, place: Path, inputs: int, seed: int) -> dict[str, Any]:
    from tb.programs.fuzz import oracle

    seeds = target.seeds()
    case.break_it()
    oracle.limit_memory()
    rng = random.Random(seed)
    for n in range(inputs):
        data = seeds[n] if n < len(seeds) else rng.choice(seeds)
        for _ in range(0 if n < len(seeds) else rng.choice((1, 1, 2, 4))):
            data = target.mutate(data, rng)
        try:
            target.run(data, place)
        except oracle.Finding as finding:
            if finding.kind in case.kinds:
                return {
                    "inputs": n + 1,
                    "kind": finding.kind,
                    "place": finding.place,
                    "text": finding.text[:1000],
                }
    return {"inputs": inputs, "kind": "", "place": "", "text": "not seen"}


def short(inputs: dict[str, int], seed: int) -> dict[str, dict[str, Any]]:
    """Run so many inputs of each target without guidance: the same for one seed on every machine."""
    from tb.programs.fuzz import oracle, target

    told: dict[str, dict[str, Any]] = {}
    for name in sorted(inputs, key=list(GUIDES).index):
        loaded, place = _load(name)
        oracle.limit_memory()
        try:
            told[name] = target.short(loaded, place, inputs[name], seed)
        except oracle.Finding as finding:
            told[name] = {"finding": str(finding)}
    return told


MODES: dict[str, Callable[..., Any]] = {
    "fuzz": fuzz,
    "cover": cover,
    "replay": replay,
    "reduce": reduce,
    "seeded": seeded,
    "short": short,
}


def main() -> None:
    """Do what the JSON of the command line says; what it returns goes to the file that `answer` names."""
    sys.dont_write_bytecode = True
    asked = json.loads(sys.argv[1])
    answer = asked.pop("answer", None)
    try:
        told = MODES[asked.pop("mode")](**asked)
    except Exception:  # the log is all that is left of a worker
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    if answer is not None:
        Path(answer).write_text(json.dumps(told))
    sys.stdout.flush()
    # Not by way of what libraries do at the end: a child of a target may still be there.
    os._exit(0)


if __name__ == "__main__":
    main()
