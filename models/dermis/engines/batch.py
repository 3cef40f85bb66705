# SPDX-License-Identifier: Apache-2.0
"""One plan over several processes of this machine, or over the workers of a Dask cluster: the same
codes, sooner.

A plan is cut into parts of whole frames (Plan.part). A part keeps its place in time and its random
numbers, so its codes are those that it has in a run of the whole plan, however many parts there are
and whoever runs them.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dermis import engines
from dermis.array import solve_error
from dermis.engines import Result, filter, masking
from dermis.errors import InputError, SimulatorError, one_line, optional
from dermis.places import PACKAGE, ROOT
from dermis.processes import children, pool
from dermis.records import Plan

# 2^18 taxels are 1024 frames of 16x16: half a second to two seconds of the event engine with everything on, and
# 4 MB of doubles both ways, below the size at which Dask warns.
_VALUES_A_PART = 1 << 18

# Parts a worker, so that the slowest one does not hold up the rest for long.
_PARTS_A_WORKER = 4

CONNECT_S = 10
"""Longest wait for the answer of a scheduler, in seconds."""

_ADDRESS = r"(tcp|tls|ws|wss)://[^/\s]+:\d{1,5}"

WORKER_S = 60
"""Longest wait for a first worker, and for another once all are lost, in seconds."""

LOOK_S = 2.0
"""Seconds between two checks of a cluster."""

_PACKAGE_FILES = ("**/*.py", "**/*.c")
_DATA_FILES = (
    "models/design.toml",
    *(f"models/verilog/*.{end}" for end in ("cpp", "f", "sv", "vh")),
    *(f"rtl/*.{end}" for end in ("f", "v", "vh")),
    *(f"spice/**/*.{end}" for end in ("sp", "inc")),
)
"""Files of the package and of its data that determine codes."""


def run(
    plan: Plan,
    progress: Callable[[int], None] | None = None,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    **options: Any,
) -> Result:
    """Run a plan through its engine in parts.

    Parameters
    ----------
    plan : Plan
    progress : callable, optional
        Called with the number of row slots done so far, over all parts.
    processes : int
        Processes of this machine; 1 runs the plan here, uncut.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://host:8786; its workers are used instead.
    options : passed to the engine

    Returns
    -------
    Result
        As from engines.run; of the engine's further results, arrays of one value a frame are joined, others
        are kept where all parts agree.

    Raises
    ------
    InputError
        Engine cosim with processes (it has its own); a scheduler that does not answer; the plan's own.
    SimulatorError
        A worker died, or runs another version of dermis.
    """
    engines.check(plan)
    if scheduler is not None:
        with cluster(scheduler) as (executor, workers, look):
            return _run_parts(plan, executor, workers, progress, options, look)
    if processes > 1 and plan.engine == "cosim":
        allowed = "1 for engine cosim, which takes all cores by itself"
        raise InputError("command line", "--processes", processes, allowed)
    if processes <= 1 or plan.frames == 1:
        return engines.run(plan, progress, **options)
    with pool.workers(min(processes, plan.frames), pool.ONE_THREAD) as executor:
        return _run_parts(plan, executor, processes, progress, options)


def bounds(plan: Plan, workers: int) -> list[tuple[int, int]]:
    """First and last + 1 frame of every part."""
    at_most = max(1, _VALUES_A_PART // (plan.rows * plan.cols))
    parts = max(-(-plan.frames // at_most), min(plan.frames, workers * _PARTS_A_WORKER))
    edges = [plan.frames * i // parts for i in range(parts + 1)]
    return list(itertools.pairwise(edges))


def spread(
    calls: Iterable[tuple[Callable[..., Any], tuple[Any, ...]]],
    executor: Executor,
    workers: int,
    look: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Future[Any]]]:
    """Give calls to an executor, and yield (number of the call, its future) as they end, in any
    order.

    Parameters
    ----------
    calls : function and arguments each; taken from as workers become free
    executor, workers : of `pool.workers` or `cluster`, and how many there are
    look : called while nothing ends; raises where nothing will
    """
    waiting = enumerate(calls)
    running: dict[Future[Any], int] = {}

    def start(many: int) -> None:
        for index, (function, arguments) in itertools.islice(waiting, many):
            running[executor.submit(function, *arguments)] = index

    start(2 * workers)  # enough that no worker waits, few enough that the calls do not pile up
    while running:
        ended = wait(running, LOOK_S, FIRST_COMPLETED).done
        if not ended:
            look()
        for task in ended:
            index = running.pop(task)
            start(1)
            yield index, task


def _run_parts(
    plan: Plan,
    executor: Executor,
    workers: int,
    progress: Callable[[int], None] | None,
    options: dict[str, Any],
    look: Callable[[], None] = lambda: None,
) -> Result:
    light = replace(plan, force_n=None)  # no engine reads it
    todo = bounds(plan, workers)
    results: dict[int, Result] = {}
    done = 0
    calls = ((_run_part, (light.part(*part), fingerprint(), options)) for part in todo)
    for index, task in spread(calls, executor, workers, look):
        first, stop = todo[index]
        try:
            results[index] = task.result()
        except pool.WorkerLost as error:
            raise SimulatorError(f"frames {first} to {stop - 1}: {error.what}") from None
        done += (stop - first) * plan.rows
        if progress is not None:
            progress(done)
    return _joined([results[i] for i in range(len(todo))], [stop - first for first, stop in todo])


def _joined(parts: list[Result], frames: list[int]) -> Result:
    def join(values: list[Any]) -> Any:
        sizes = [len(v) if isinstance(v, np.ndarray) and v.ndim else None for v in values]
        if sizes == frames:
            return np.concatenate(values)
        return values[0] if all(np.array_equal(values[0], v) for v in values[1:]) else None

    info = {name: join([part.info.get(name) for part in parts]) for name in parts[0].info}
    for name, merged in _MERGED.items():
        if values := [part.info[name] for part in parts if name in part.info]:
            info[name] = merged(values)
    info = {name: value for name, value in info.items() if value is not None}
    return Result(join([part.codes for part in parts]), info)


_MERGED = {"array": solve_error.merged, "filter": filter.merged, "masked": masking.merged}
"""Further results that are neither arrays by frame nor alike in all parts."""


def _run_part(part: Plan, version: str, options: dict[str, Any]) -> Result:
    """Run one part in a worker."""
    same_version(version)
    return engines.run(part, **options)


def same_version(version: str) -> None:
    """Refuse work from another version of dermis with a SimulatorError."""
    if fingerprint() != version:
        node = os.uname().nodename
        raise SimulatorError(f"a worker on {node} has another version of dermis than this machine")


@functools.cache
def fingerprint(package: Path = PACKAGE, root: Path = ROOT) -> str:
    """Hash every file that decides about codes: package, design values, Verilog and circuits."""
    text = hashlib.sha256()
    for place, patterns in ((package, _PACKAGE_FILES), (root, _DATA_FILES)):
        for file in sorted({file for pattern in patterns for file in place.glob(pattern) if file.is_file()}):
            data = file.read_bytes()
            text.update(f"{file.relative_to(place)}\0{len(data)}\0".encode() + data)
    return text.hexdigest()


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int, Callable[[], None]]]:
    """Connect to a Dask scheduler: yield its executor, the number of workers, and a check that some
    are alive.
    """
    allowed = f"the address of a Dask scheduler that answers within {CONNECT_S} s, such as tcp://host:8786"
    if not re.fullmatch(_ADDRESS, address):  # Dask takes 20 s and a traceback over it
        raise InputError("command line", "--scheduler", address, allowed)
    distributed = optional("distributed", "cluster")
    CommClosedError = distributed.comm.CommClosedError

    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        allowed += f" ({type(error).__name__})"
        raise InputError("command line", "--scheduler", address, allowed) from None

    @contextmanager
    def asked(silence: str) -> Iterator[None]:
        try:
            yield
        except TimeoutError:  # an OSError, too
            raise SimulatorError(f"the scheduler {address} {silence}") from None
        except (OSError, CommClosedError):  # it went while it was asked
            raise SimulatorError(f"the scheduler {address} is gone") from None

    # Dask logs tracebacks for a lost cluster, until the client is closed; the run reports it in one line.
    logging.disable(logging.CRITICAL)
    with ExitStack() as stack:
        stack.callback(logging.disable, logging.NOTSET)
        stack.enter_context(client)
        with asked(f"has no worker after {WORKER_S} s"):
            client.wait_for_workers(1, timeout=WORKER_S)
            workers = sum(client.nthreads().values())
        executor = client.get_executor(pure=False, retries=0)
        timeout = children.Timeout(WORKER_S)

        def look() -> None:
            if client.status != "running":
                raise SimulatorError(f"the scheduler {address} is gone")
            with asked(f"has not answered for {WORKER_S} s"):  # the client itself only knows the last message
                client.sync(client.scheduler.identity, callback_timeout=WORKER_S)
            there = len(client.scheduler_info()["workers"])
            # A number that changes while there are workers, so that it counts only the time without any.
            if timeout.over(time.monotonic() if there else 0):
                raise SimulatorError(f"the scheduler {address} has had no worker for {WORKER_S} s")

        try:
            yield executor, workers, look
        except (distributed.KilledWorker, CancelledError, CommClosedError) as error:
            executor.shutdown(wait=False)
            said = one_line(str(error), 200) or type(error).__name__
            raise SimulatorError(f"the cluster of {address} lost a part of the run: {said}") from None
        except BaseException:
            executor.shutdown(wait=False)
            raise
        executor.shutdown()
