# SPDX-License-Identifier: Apache-2.0
"""Worker processes of this machine as an executor: a worker takes calls from a pipe and ends with its caller.

A worker is a child as any other (dermis.processes.children): marked, watched, and ended with all
its descendants. The pools of multiprocessing cannot end a worker that is busy in compiled code,
wait for ever for one that was stopped, and import the caller's main module in every worker.
"""

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import IO, Any

from dermis.errors import SimulatorError
from dermis.processes import watchdog
from dermis.processes.children import Child, Timeout, ended

ONE_THREAD = dict.fromkeys(
    "OPENBLAS_NUM_THREADS OMP_NUM_THREADS OMP_THREAD_LIMIT MKL_NUM_THREADS NUMBA_NUM_THREADS".split(), "1"
)
"""A worker has one core: more threads of linear algebra would compete for it; ngspice takes OMP_THREAD_LIMIT alone."""

STALL_S = 900.0
"""Longest time without any processor time of a worker and its children; a build may take 600 s."""
LOOK_S = 2.0  # between two checks of a worker

_Call = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class WorkerLost(SimulatorError):
    """A worker ended, or was ended, in the middle of a call, with exit code `code` (negative for a signal).

    `left` are the commands of the other processes of its tree, which were ended as well.
    """

    def __init__(self, what: str, code: int = 0, left: Sequence[str] = ()) -> None:
        super().__init__(what)
        self.code, self.left = code, left


class LimitReached(WorkerLost):
    """A call took longer than its limit; its worker was ended."""


class Workers(Executor):
    """An executor whose workers are child processes."""

    def __init__(self, processes: int, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)
        self._threads = ThreadPoolExecutor(processes)
        self._pipes = ThreadPoolExecutor(processes)
        self._own = threading.local()
        self._lock = threading.Lock()
        self._workers: set[Child] = set()
        self._ended = False

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        return self._threads.submit(self._call, (function, arguments, options))

    def limited(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], limit_s: float, fresh: bool = False
    ) -> Future[tuple[Any, list[str]]]:
        """Submit a call with a time limit; its result is the value and the commands that it left running.

        These are ended. With `fresh` its worker takes no other call.
        """
        return self._threads.submit(self._limited, (function, arguments, {}), limit_s, fresh)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers once they are idle, or at once with `cancel_futures`."""
        if cancel_futures:
            with self._lock:
                self._ended = True
                workers = list(self._workers)
            for worker in workers:
                worker.end()
        self._threads.shutdown(wait=True, cancel_futures=cancel_futures)
        self._pipes.shutdown()
        for worker in list(self._workers):
            self._drop(worker)

    def _worker(self) -> Child:
        """Return the worker of this thread; it is started by the first call after it was dropped."""
        worker: Child | None = getattr(self._own, "worker", None)
        if worker is None:
            with self._lock:
                if self._ended:
                    raise WorkerLost("the run was ended")
                command = [sys.executable, "-m", "dermis.processes.pool"]
                worker = Child(command, self._environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
                self._workers.add(worker)
            self._own.worker = worker
            pickle.dump([path or os.getcwd() for path in sys.path], worker.stdin)
        return worker

    def _drop(self, worker: Child) -> list[str]:
        """End a worker and its children; return the commands of its children."""
        left = worker.end_others()
        worker.end()
        for pipe in (worker.stdin, worker.stdout):
            with contextlib.suppress(OSError):  # unread data for a dead worker
                pipe.close()
        with self._lock:
            self._workers.discard(worker)
        if getattr(self._own, "worker", None) is worker:
            self._own.worker = None
        return left

    def _call(self, call: _Call, limit_s: float = math.inf) -> Any:
        data, worker = pickle.dumps(call, pickle.HIGHEST_PROTOCOL), self._worker()
        try:
            self._watched(worker, lambda: _send(worker.stdin, data))
            done, value = self._watched(worker, lambda: _answer_of(worker))  # it is read, with its imports
            if done:
                done, value = self._watched(worker, lambda: _answer_of(worker), limit_s)
        except (OSError, EOFError, pickle.UnpicklingError):
            left = self._drop(worker)
            said = f"a worker process died ({ended(worker.returncode)})"
            raise WorkerLost(said, worker.returncode, left) from None
        if not done:
            raise value
        return value

    def _limited(self, call: _Call, limit_s: float, fresh: bool) -> tuple[Any, list[str]]:
        value, worker = self._call(call, limit_s), self._worker()
        return value, self._drop(worker) if fresh else worker.end_others()

    def _watched(self, worker: Child, work: Callable[[], Any], limit_s: float = math.inf) -> Any:
        """Do what blocks at a pipe of a worker; end that at the limit, or if it makes no progress."""
        doing, until, timeout = self._pipes.submit(work), time.monotonic() + limit_s, Timeout(STALL_S)
        while not wait([doing], max(0.0, min(LOOK_S, until - time.monotonic()))).done:
            if time.monotonic() >= until:
                raise LimitReached("a call took longer than its limit", left=self._drop(worker))
            # Processor time of the worker and its descendants, in ticks.
            used = sum(sum(map(int, watchdog.status(pid)[11:15])) for pid, _ in worker.processes())
            if timeout.over(used):
                said = f"a worker process used no processor for {STALL_S:g} s and was ended"
                raise WorkerLost(said, left=self._drop(worker))
        return doing.result()


def _send(pipe: IO[bytes], data: bytes) -> None:
    """Write a pickle into a pipe as bytes: it is read whole, also where it cannot be unpickled."""
    pickle.dump(data, pipe, pickle.HIGHEST_PROTOCOL)
    pipe.flush()


def _answer_of(worker: Child) -> Any:
    return pickle.loads(pickle.load(worker.stdout))


@contextmanager
def workers(processes: int, environment: Mapping[str, str] = ONE_THREAD) -> Iterator[Workers]:
    """Give an executor of at most so many workers, each started by a call; none is left after the block.

    `environment` is added to the variables of this process.
    """
    pool = Workers(processes, environment)
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _answers(data: bytes) -> Iterator[tuple[bool, Any]]:
    """Yield that a call is read, and then its value; or False and the error."""
    try:
        function, arguments, options = pickle.loads(data)
    except Exception as error:  # a function that is not to be found here
        yield False, RuntimeError(f"{type(error).__name__}: {error}")
        return
    yield True, None
    try:
        yield True, function(*arguments, **options)
    except Exception as error:  # any error belongs to the caller
        yield False, error


def _packed(done: bool, value: Any) -> bytes:
    """Pickle an answer; one that cannot be pickled is replaced by its type and message."""
    try:
        data = pickle.dumps((done, value), pickle.HIGHEST_PROTOCOL)
        if not done:
            pickle.loads(data)
        return data
    except MemoryError:
        raise
    except Exception as error:  # pickle raises whatever an object's own methods raise
        said = value if not done else error
        return pickle.dumps((False, RuntimeError(f"{type(said).__name__}: {said}")))


def main() -> None:
    """Take calls until there are no more."""
    # Ctrl-C reaches every process of a terminal; the caller decides how to end its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Input and output of the work must not mix with the calls.
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.path[:] = pickle.load(calls)
    with contextlib.suppress(EOFError):  # there are no more
        while True:
            for answer in _answers(pickle.load(calls)):
                _send(answers, _packed(*answer))


if __name__ == "__main__":
    main()
