# SPDX-License-Identifier: Apache-2.0
"""One plan over several processes of this machine: the same codes, sooner.

A plan is cut into parts of whole frames (Plan.part). A part keeps its place in time and its random
numbers, so its codes are those that it has in a run of the whole plan, however many parts there are
and whoever runs them.
"""

import functools
import hashlib
import itertools
import statistics
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dermis import engines
from dermis.engines import Result
from dermis.errors import InputError, SimulatorError
from dermis.places import PACKAGE, ROOT
from dermis.processes import pool
from dermis.records import Plan

# 1024 frames of 16x16: half a second to two seconds of engine event with everything on, and 4 MB of doubles both ways.
_VALUES_A_PART = 1 << 18
_PARTS_A_WORKER = 4  # so that the slowest one does not hold up the rest for long

_PACKAGE_FILES = ("**/*.py", "**/*.c")
_DATA_FILES = (
    "models/design.toml",
    *(f"models/verilog/*.{end}" for end in ("cpp", "f", "sv", "vh")),
    *(f"rtl/*.{end}" for end in ("f", "v", "vh")),
    *(f"spice/**/*.{end}" for end in ("sp", "inc")),
)
"""Files of the package and of its data that determine codes."""


def run(
    plan: Plan, progress: Callable[[int], None] | None = None, *, processes: int = 1, **options: Any
) -> Result:
    """Run a plan through its engine in parts.

    Parameters
    ----------
    progress : called with the number of row slots done so far, over all parts
    processes : processes of this machine; 1 runs the plan here, uncut
    options : passed to the engine

    Returns what engines.run does; of the engine's further results, arrays of one value a frame are joined, others are
    kept where all parts agree.

    InputError for engine cosim with processes (it has its own), and the plan's own; SimulatorError if a worker died.
    """
    engines.check(plan)
    if processes > 1 and plan.engine == "cosim":
        allowed = "1 for engine cosim, which takes all cores by itself"
        raise InputError("command line", "--processes", processes, allowed)
    if processes <= 1 or plan.frames == 1:
        return engines.run(plan, progress, **options)
    light, todo = replace(plan, force_n=None), bounds(plan, processes)  # no engine reads forces
    calls = ((_run_part, (light.part(*part), options)) for part in todo)
    results: dict[int, Result] = {}
    done = 0
    with pool.workers(min(processes, plan.frames), pool.ONE_THREAD) as executor:
        for index, task in spread(calls, executor, processes):
            first, stop = todo[index]
            try:
                results[index] = task.result()
            except pool.WorkerLost as error:
                raise SimulatorError(f"frames {first} to {stop - 1}: {error.what}") from None
            done += (stop - first) * plan.rows
            if progress is not None:
                progress(done)
    return _joined([results[i] for i in range(len(todo))], [stop - first for first, stop in todo])


def bounds(plan: Plan, workers: int) -> list[tuple[int, int]]:
    """First and last + 1 frame of every part."""
    at_most = max(1, _VALUES_A_PART // (plan.rows * plan.cols))
    parts = max(-(-plan.frames // at_most), min(plan.frames, workers * _PARTS_A_WORKER))
    edges = [plan.frames * i // parts for i in range(parts + 1)]
    return list(itertools.pairwise(edges))


def spread(
    calls: Iterable[tuple[Callable[..., Any], tuple[Any, ...]]], executor: Executor, workers: int
) -> Iterator[tuple[int, Future[Any]]]:
    """Give calls (function, arguments) to an executor, as its workers become free.

    Yields (number of the call, its future) as they end, in any order.
    """
    waiting = enumerate(calls)
    running: dict[Future[Any], int] = {}

    def start(many: int) -> None:
        for index, (function, arguments) in itertools.islice(waiting, many):
            running[executor.submit(function, *arguments)] = index

    start(2 * workers)  # enough that no worker waits, few enough that the calls do not pile up
    while running:
        for task in wait(running, return_when=FIRST_COMPLETED).done:
            index = running.pop(task)
            start(1)
            yield index, task


def _joined(parts: list[Result], frames: list[int]) -> Result:
    def join(values: list[Any]) -> Any:
        sizes = [len(v) if isinstance(v, np.ndarray) and v.ndim else None for v in values]
        if sizes == frames:
            return np.concatenate(values)
        return values[0] if all(np.array_equal(values[0], v) for v in values[1:]) else None

    info = {name: join([part.info.get(name) for part in parts]) for name in parts[0].info}
    for name in ("array", "filter"):  # neither arrays by frame nor alike in all parts
        if tables := [part.info[name] for part in parts if name in part.info]:
            info[name] = _merged(tables)
            if name == "filter":
                median = statistics.median(table["bound_over_shift"] for table in tables)
                info[name]["bound_over_shift"] = median
    info = {name: value for name, value in info.items() if value is not None}
    return Result(join([part.codes for part in parts]), info)


def _merged(values: list[Any]) -> Any:
    """Join tables entry by entry: the sum of counts, the largest measure; a word stands in for a measure."""
    if isinstance(values[0], dict):
        names = dict.fromkeys(itertools.chain(*values))
        return {name: _merged([table[name] for table in values if name in table]) for name in names}
    if isinstance(values[0], list):
        return [_merged(list(entries)) for entries in zip(*values, strict=True)]
    if words := [value for value in values if isinstance(value, str)]:
        return next(filter(None, words), "")
    return sum(values) if isinstance(values[0], int) else max(values)


def _run_part(part: Plan, options: dict[str, Any]) -> Result:
    """Run one part in a worker."""
    return engines.run(part, **options)


@functools.cache
def fingerprint(package: Path = PACKAGE, root: Path = ROOT) -> str:
    """Hash every file that decides about codes: package, design values, Verilog and circuits."""
    text = hashlib.sha256()
    for place, patterns in ((package, _PACKAGE_FILES), (root, _DATA_FILES)):
        for file in sorted({file for pattern in patterns for file in place.glob(pattern) if file.is_file()}):
            data = file.read_bytes()
            text.update(f"{file.relative_to(place)}\0{len(data)}\0".encode() + data)
    return text.hexdigest()
