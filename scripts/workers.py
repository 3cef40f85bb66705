# SPDX-License-Identifier: Apache-2.0
"""Worker processes for work that may go wrong: what hangs, crashes or leaves processes behind is told apart, and ended.

Built on Pebble's pool, which ends a worker at a limit and puts another in its place. Added here is what a verdict
needs beyond that: the seconds of each task, one BLAS thread a worker, and the search for processes that a task left
behind, which are ended and reported as the task's fault.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import ctypes
import itertools
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pebble

from dermis.errors import DermisError, one_line
from dermis.processes import children
from dermis.processes.pool import ONE_THREAD

# Every process that comes from a pool carries this variable, however it was started and whoever its parent is now: the
# name of the pool, and behind a slash the number of the task once a program was started.
_MARK = "DERMIS_WORKERS"

_PR_SET_CHILD_SUBREAPER = 36

# How long a killed process may take to be gone: the kernel's time on a machine that is busy many times over.
_GONE_S = 10.0


@dataclass(frozen=True)
class Task:
    """A call for a worker: a picklable function, its arguments, and the seconds it may take."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    limit_s: float = 60.0


@dataclass(frozen=True)
class Outcome:
    """What became of a task: its value, or in `fault` what went wrong; the seconds it took."""

    value: Any = None
    fault: str = ""
    seconds: float = 0.0


class _Ended(BaseException):
    """The pool wants this worker to go."""


_busy = False


def run(tasks: Iterable[Task], workers: int, *, fresh: bool = False) -> Iterator[tuple[int, Outcome]]:
    """Run tasks in worker processes and yield (number of the task, outcome) as they end, in any order.

    Parameters
    ----------
    tasks : iterable of Task
        Taken from as workers become free, so it may be endless.
    workers : int
        Processes at a time.
    fresh : bool
        A new process for each task: for libraries that keep what a task has left in them, as ngspice does.

    Notes
    -----
    However the iteration ends (its end, `close`, an exception, Ctrl-C, SIGTERM), no process of it stays.
    """
    children.guard()
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    numbered = enumerate(tasks)
    with _environment(ONE_THREAD | {_MARK: mark}), children.ending():
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        pool = pebble.ProcessPool(workers, int(fresh), initializer=_enter, context=context)
        running: dict[Any, tuple[int, Task]] = {}
        try:
            while True:
                # No more than there are workers: with tasks that wait, Pebble may blame one for what another did.
                for number, task in itertools.islice(numbered, workers - len(running)):
                    future = pool.schedule(
                        _measured, (f"{mark}/{number}", task.function, *task.arguments), timeout=task.limit_s
                    )
                    running[future] = number, task
                if not running:
                    break
                ended = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED).done
                for future in ended:
                    number, task = running.pop(future)
                    yield number, _outcome(future, task, {mark, f"{mark}/{number}"})
        finally:
            pool.stop()
            pool.join()
            _end(lambda: _lost(lambda found: found.partition("/")[0] == mark))


def _outcome(future: concurrent.futures.Future[Outcome], task: Task, marks: set[str]) -> Outcome:
    try:
        found = future.result()
    except concurrent.futures.TimeoutError:
        fault = f"hangs: ended after {task.limit_s:g} s"
        return Outcome(fault=fault + _said(_end(lambda: _lost(marks.__contains__))), seconds=task.limit_s)
    except pebble.ProcessExpired as error:
        code = error.exitcode
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return Outcome(
            fault=f"crashed: its process ended with {how}" + _said(_end(lambda: _lost(marks.__contains__)))
        )
    except Exception as error:  # the task or its value could not be sent: nothing was measured
        return Outcome(fault=f"{type(error).__name__}: {one_line(str(error), 300)}")
    if found.seconds > task.limit_s and not found.fault:
        return Outcome(fault=f"took {found.seconds:.3g} s of {task.limit_s:g} s", seconds=found.seconds)
    return found


def _measured(mark: str, function: Callable[..., Any], *arguments: Any) -> Outcome:
    """Run one task in a worker."""
    global _busy
    os.environ[_MARK] = mark
    value, fault = None, ""
    start = time.perf_counter()
    _busy = True
    try:
        value = function(*arguments)
    except _Ended:
        os._exit(1)  # Pebble would take it for a result and give this process the next task
    except DermisError as error:
        fault = f"{type(error).__name__}: {one_line(str(error), 300)}"
    except BaseException as error:  # SystemExit too: a task that exits has not measured
        fault = f"raised {type(error).__name__}: {one_line(str(error), 300)}"
    _busy = False
    seconds = time.perf_counter() - start
    orphans = _said(_end(_own))
    return Outcome(value, (fault + orphans).removeprefix("; "), seconds)


def _said(left: list[str]) -> str:
    return f"; left processes behind: {', '.join(left)}" if left else ""


def _end(find: Callable[[], set[int]]) -> list[str]:
    """End the processes that `find` sees until it sees none, and say which they were.

    One look is not enough: what is just starting another process may be gone before it is ended, and the other one is
    not among those that were seen.
    """
    names: dict[int, str] = {}
    until = time.monotonic() + _GONE_S
    while (pids := find()) and time.monotonic() < until:
        for pid in pids:
            with contextlib.suppress(OSError):  # it ended meanwhile
                command = (
                    Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                )
                if command:  # else it has ended, and only waits to be collected
                    os.kill(pid, signal.SIGKILL)
                    names[pid] = one_line(command, 60)
        # Only a worker has such children of its own; it adopts theirs, too.
        with contextlib.suppress(ChildProcessError):  # none
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        time.sleep(0.01)
    return sorted(names.values())


def _own() -> set[int]:
    """What this process has started, and what that has."""
    return children.tree(os.getpid()) - {os.getpid()}


def _lost(wanted: Callable[[str], bool]) -> set[int]:
    """Processes with a mark that is wanted and that belong to no worker any more."""
    sign = f"{_MARK}=".encode()
    lost, own = set(), set()
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it ended meanwhile, or is somebody else's
            marks = [v for v in (place / "environ").read_bytes().split(b"\0") if v.startswith(sign)]
            if not marks or not wanted(marks[0][len(sign) :].decode(errors="replace")):
                continue
            parent = (place / "stat").read_text(errors="replace").rpartition(")")[2].split()[1]
            # The workers themselves, also one that is just being started, and multiprocessing's own helper.
            (own if int(parent) == os.getpid() else lost).add(int(place.name))
    for worker in own:
        lost -= children.tree(worker)
    return lost


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Variables for what is started meanwhile: a library reads them once, on import."""
    kept = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in kept.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _enter() -> None:
    # Ctrl-C reaches every process of the terminal; the one that gives the work decides what becomes of it. It ends
    # its workers with SIGTERM, as an exception here, so that they end what they have started in their turn.
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    # What a task starts and forgets becomes a child of this process, where it is found, and not of init.
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave(*_: Any) -> None:
    if _busy:
        raise _Ended
    os._exit(1)


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        _end(_own)
        os._exit(1)
