# SPDX-License-Identifier: Apache-2.0
"""Run tasks with a time limit in worker processes; a hang or a crash is an outcome."""

import itertools
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from typing import Any

from dermis.errors import DermisError, one_line
from dermis.processes import children, pool


@dataclass(frozen=True)
class Task:
    """A call for a worker: a picklable function, its arguments, and the seconds it may take."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    limit_s: float = 60.0


@dataclass(frozen=True)
class Outcome:
    """Outcome of a task: its value or, in `fault`, its failure; the seconds it took."""

    value: Any = None
    fault: str = ""
    seconds: float = 0.0


def busy() -> float:
    """Return the number of processes per core, at least 1: a task takes this factor longer."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def run(tasks: Iterable[Task], workers: int, *, fresh: bool = False) -> Iterator[tuple[int, Outcome]]:
    """Run tasks in worker processes and yield (number of the task, outcome) as they end.

    Tasks are read as workers become free, so they may be endless. `fresh` gives each a new process:
    for libraries that keep state, as ngspice does. No process remains, however the iteration ends
    (its end, `close`, an exception, Ctrl-C, SIGTERM).
    """
    numbered = enumerate(tasks)
    running: dict[Future[Any], tuple[int, Task]] = {}
    with children.ending(), pool.workers(workers) as executor:
        while True:
            for number, task in itertools.islice(numbered, workers - len(running)):
                call = (task.function, task.arguments)
                running[executor.limited(_measured, call, task.limit_s, fresh)] = number, task
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, task = running.pop(future)
                yield number, _outcome(future, task)


def _outcome(future: Future[tuple[Outcome, list[str]]], task: Task) -> Outcome:
    left: Sequence[str] = ()
    try:
        found, left = future.result()
    except pool.LimitReached as error:
        left = error.left
        found = Outcome(fault=f"hangs: ended after {task.limit_s:g} s", seconds=task.limit_s)
    except pool.WorkerLost as error:
        left = error.left
        found = Outcome(fault=f"crashed: its process ended with {children.ended(error.code)}")
    except Exception as error:  # The task or its value could not be pickled: no measurement.
        found = Outcome(fault=f"{type(error).__name__}: {one_line(str(error), 300)}")
    faults = [found.fault] if found.fault else []
    if found.seconds > task.limit_s and not faults:
        faults = [f"took {found.seconds:.3g} s of {task.limit_s:g} s"]
    faults += [f"left processes behind: {', '.join(left)}"] if left else []
    return replace(found, fault="; ".join(faults))


def _measured(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    value, fault = None, ""
    start = time.perf_counter()
    try:
        value = function(*arguments)
    except DermisError as error:
        fault = f"{type(error).__name__}: {one_line(str(error), 300)}"
    except BaseException as error:  # SystemExit too: a task that exits has no measurement.
        fault = f"raised {type(error).__name__}: {one_line(str(error), 300)}"
    return Outcome(value, fault, time.perf_counter() - start)
