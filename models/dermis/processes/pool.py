# SPDX-License-Identifier: Apache-2.0
"""Processes of this machine as an executor: each takes calls from a pipe, and ends with the process that gives them.

multiprocessing's own pools leave the end to signals that a busy worker need not see, wait for ever for one that was
stopped, start a helper whose death is a traceback, and import the caller's main module once more. Here a worker is a
child as any other (dermis.processes.children): marked, watched, and ended with all that it started.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from dermis.errors import SimulatorError
from dermis.processes.children import Child, Patience, ended

ONE_THREAD = dict.fromkeys(
    (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OMP_THREAD_LIMIT",  # ngspice sets the number itself
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
    ),
    "1",
)
"""Each worker has one core; linear algebra that starts a thread a core in each of them would only fight for it."""

STALL_S = 900.0
"""How long a worker and all that it started may use no processor at all: it may wait for a build, which has 600 s."""

LOOK_S = 2.0
"""Between two looks at whether a worker moves."""

_LENGTH = struct.Struct(">Q")


class WorkerLost(SimulatorError):
    """A worker ended, or stopped moving, in the middle of a call."""


class _Workers(Executor):
    def __init__(self, processes: int, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)
        self._threads = ThreadPoolExecutor(processes)
        self._own = threading.local()
        self._lock = threading.Lock()
        self._workers: list[Child] = []
        self._ended = False

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        return self._threads.submit(self._call, function, arguments, options)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the workers go once they are idle; with `cancel_futures` end them at once."""
        if cancel_futures:
            with self._lock:
                self._ended = True
                workers = list(self._workers)
            for worker in workers:
                worker.end()
        self._threads.shutdown(wait=True, cancel_futures=cancel_futures)
        for worker in self._workers:
            worker.end()  # idle, or ended already: nothing is lost
            for pipe in (worker.stdin, worker.stdout):
                with contextlib.suppress(OSError):  # what a dead worker no longer read
                    pipe.close()

    def _worker(self) -> Child:
        """The worker of this thread, started by its first call and again once it was lost."""
        if (worker := getattr(self._own, "worker", None)) is None:
            with self._lock:
                if self._ended:
                    raise WorkerLost("the run was ended")
                command = [sys.executable, "-m", "dermis.processes.pool"]
                pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
                worker = Child(command, self._environment, **pipes)
                self._workers.append(worker)
            self._put(worker, _packed([path or os.getcwd() for path in sys.path]))
            self._own.worker = worker
        return worker

    def _call(self, function: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        worker = self._worker()
        try:
            self._put(worker, _packed((function, arguments, options)))
            done, value = pickle.loads(self._get(worker, _LENGTH.unpack(self._get(worker, _LENGTH.size))[0]))
        except (OSError, EOFError):
            worker.end()
            self._own.worker = None
            raise WorkerLost(f"a worker process died ({ended(worker.returncode)})") from None
        if not done:
            raise value
        return value

    def _put(self, worker: Child, data: bytes) -> None:
        assert worker.stdin is not None
        pipe, left = worker.stdin.fileno(), memoryview(data)
        os.set_blocking(pipe, False)
        while left:
            self._wait(worker, pipe, select.POLLOUT)
            left = left[os.write(pipe, left) :]

    def _get(self, worker: Child, size: int) -> bytes:
        assert worker.stdout is not None
        pipe, data = worker.stdout.fileno(), bytearray()
        while len(data) < size:
            self._wait(worker, pipe, select.POLLIN)
            data += (part := os.read(pipe, size - len(data)))
            if not part:
                raise EOFError
        return bytes(data)

    def _wait(self, worker: Child, pipe: int, event: int) -> None:
        """Wait until a pipe takes or gives something: one that stands still may do so at any byte."""
        ready, patience = select.poll(), Patience(STALL_S)
        ready.register(pipe, event)
        while not ready.poll(1000 * LOOK_S):
            if patience.over(_used(worker)):
                worker.end()
                self._own.worker = None
                raise WorkerLost(f"a worker process did not move for {STALL_S:g} s and was ended")


def _used(worker: Child) -> int:
    """Ticks of processor time that a worker and all it started have had."""
    ticks = 0
    for pid, _ in worker.processes():
        try:
            fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        except OSError:  # gone meanwhile
            continue
        ticks += sum(map(int, fields[11:15]))
    return ticks


def _packed(value: Any) -> bytes:
    data = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    return _LENGTH.pack(len(data)) + data


def send(pipe: IO[bytes], value: Any) -> None:
    """Write a value to a pipe, pickled behind its length."""
    pipe.write(_packed(value))
    pipe.flush()


def receive(pipe: IO[bytes]) -> Any:
    """Read what `send` wrote; EOFError where the other side is gone, in the middle of a value as well."""
    head = pipe.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    data = pipe.read(_LENGTH.unpack(head)[0])
    if len(data) < _LENGTH.unpack(head)[0]:
        raise EOFError
    return pickle.loads(data)


@contextmanager
def workers(processes: int, environment: Mapping[str, str]) -> Iterator[Executor]:
    """So many workers, all of them gone at the end, whatever the end is.

    Parameters
    ----------
    processes : at most so many, each started when there is a call for it
    environment : variables that they have beside those of this process
    """
    pool = _Workers(processes, environment)
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _answer(
    function: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]
) -> tuple[bool, Any]:
    try:
        return True, function(*arguments, **options)
    except Exception as error:  # whatever it is, it is the caller's
        return False, error


def _reply(pipe: IO[bytes], done: bool, value: Any) -> None:
    """Send an answer; of one that cannot be sent or read again its kind and words are all there is."""
    try:
        if not done:
            pickle.loads(pickle.dumps(value))
        send(pipe, (done, value))
    except (BrokenPipeError, MemoryError):
        raise
    except Exception as error:  # pickle raises whatever an object's own methods raise
        said = value if not done else error
        send(pipe, (False, RuntimeError(f"{type(said).__name__}: {said}")))


def main() -> None:
    """Take calls until there are no more."""
    # Ctrl-C reaches every process of a terminal; the one that gives the work decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What work prints, or reads, must not fall among the calls.
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.path[:] = receive(calls)
    while True:
        try:
            call = receive(calls)
        except EOFError:
            return
        except Exception as error:  # a function that is not to be found here
            _reply(answers, False, RuntimeError(f"{type(error).__name__}: {error}"))
            continue
        _reply(answers, *_answer(*call))


if __name__ == "__main__":
    main()
