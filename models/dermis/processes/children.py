# SPDX-License-Identifier: Apache-2.0
"""Programs that a command starts: each in its own session, with a time limit, ended with all its children.

A watchdog process ends them after a SIGKILL of the command (see dermis.processes.watchdog).
"""

import atexit
import contextlib
import itertools
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FrameType
from typing import Any

from dermis.errors import SimulatorError, one_line
from dermis.processes import watchdog

STARTED_S = 10.0  # longest wait for the end of the watchdog
LOOK_S = 0.05  # between two looks at a program

Command = Sequence[str | Path]
Variables = Mapping[str, str] | None
"""Added to the environment of this process."""
Look = Callable[[], Any] | None
"""Called until a program ends."""

_lock = threading.Lock()
_numbers = itertools.count(1)
_watchdog: subprocess.Popen[bytes] | None = None


def guard() -> str:
    """Return the mark of this process's children; a watchdog ends them once it is gone."""
    global _watchdog
    with _lock:
        if _watchdog is None:
            before = os.environ.get(watchdog.VARIABLE, "")
            mark = f"{before}/{secrets.token_hex(6)}"
            # In its own session, so that Ctrl-C in a terminal does not reach it; it carries the mark of this process.
            options = {"start_new_session": True, "env": {watchdog.VARIABLE: before}}
            options |= {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL}
            _watchdog = subprocess.Popen([sys.executable, "-I", "-S", watchdog.__file__, mark], **options)
            os.environ[watchdog.VARIABLE] = mark
        return os.environ[watchdog.VARIABLE]


@atexit.register
def _leave() -> None:
    """End the watchdog and wait for it, so that a command leaves no process."""
    if _watchdog is not None and _watchdog.stdin is not None:
        _watchdog.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):  # stopped by somebody
            _watchdog.wait(STARTED_S)


def _forked() -> None:
    """Forget the parent's watchdog in a forked copy, which must not keep the pipe open."""
    global _watchdog, _lock
    _lock = threading.Lock()
    if _watchdog is not None and _watchdog.stdin is not None:
        os.close(_watchdog.stdin.fileno())
        _watchdog.returncode = 0  # not ours to wait for
        _watchdog = None


os.register_at_fork(after_in_child=_forked)


class Child(subprocess.Popen[bytes]):
    """A program in its own session with its own mark; `environment` is added to that of this process."""

    def __init__(self, command: Command, environment: Variables = None, **options: Any) -> None:
        self.mark = f"{guard()}/{next(_numbers)}"
        marked = {**os.environ, **(environment or {}), watchdog.VARIABLE: self.mark}
        super().__init__(command, env=marked, start_new_session=True, pass_fds=_own.handles, **options)

    def processes(self) -> set[watchdog.Process]:
        """Return the live processes of its tree, in any session, also after its own end."""
        return watchdog.marked(self.mark)

    def end(self) -> None:
        """End it and all that it started, also in process groups of their own (sby's solvers)."""
        watchdog.end(self.processes)
        self.wait()

    def end_others(self) -> list[str]:
        """End all that it started, but not itself; return their commands."""
        commands: dict[int, str] = {}

        def others() -> set[watchdog.Process]:
            found = set()
            for process in self.processes():
                line = watchdog.read(process[0], "cmdline").replace(b"\0", b" ")
                if process[0] != self.pid and watchdog.__file__.encode() not in line:
                    said = one_line(line.decode(errors="replace"), 60)
                    commands[process[0]] = commands.get(process[0]) or said  # none during execve
                    found.add(process)
            return found

        watchdog.end(others)
        return sorted(commands.values())


class _OfThread(threading.local):
    """Open files that children of a thread inherit, and the events that end these children."""

    handles: tuple[int, ...] = ()
    ends: tuple[threading.Event, ...] = ()

    def stopped(self) -> bool:
        """Return True once one of the events has come."""
        return any(event.is_set() for event in self.ends)


_own = _OfThread()


@contextlib.contextmanager
def holding(handle: int | None) -> Iterator[None]:
    """Let children of the block inherit an open file: its lock lasts until the last one ends."""
    before = _own.handles
    _own.handles = before if handle is None else (*before, handle)
    try:
        yield
    finally:
        _own.handles = before


def run_child(
    command: Command,
    directory: Path,
    log: Path,
    limit_s: float,
    environment: Variables = None,
    progress: Look = None,
) -> int | None:
    """Run a command in its own session; return its exit code, None if it was ended at its time limit.

    Parameters
    ----------
    command, directory : program and arguments, working directory
    log : file that its output is added to
    limit_s : seconds until it is ended with all that it started
    environment : variables added to those of this process
    progress : called until it ends; each change of its answer starts the limit anew (`Timeout`)

    SimulatorError if it cannot be started, or `threads` is ending.
    """
    with log.open("ab") as out:
        return _run(command, limit_s, environment, log, progress, cwd=directory, stdout=out)


def _run(
    command: Command, limit_s: float, environment: Variables, log: Path | None, progress: Look, **options: Any
) -> int | None:
    if _own.stopped():
        raise SimulatorError("interrupted", log)
    try:
        child = Child(command, environment, stdin=subprocess.DEVNULL, stderr=subprocess.STDOUT, **options)
    except OSError as error:
        said = error.strerror or str(error)
        raise SimulatorError(f"{Path(command[0]).name} cannot be started: {said}", log) from None
    code, late, timeout = None, False, Timeout(limit_s)
    try:
        while code is None and not late and not _own.stopped():
            with contextlib.suppress(subprocess.TimeoutExpired):  # at its limit, the answer is None
                code = child.wait(LOOK_S)
            late = timeout.over(progress() if progress else None)
    finally:
        child.end()
    if _own.stopped():
        raise SimulatorError("interrupted", log)
    return code


def run_logged(
    command: Command, directory: Path, log: Path, limit_s: float, what: str, environment: Variables = None
) -> None:
    """Run a command as `run_child` does; SimulatorError if it failed or ran longer than its limit."""
    code = run_child(command, directory, log, limit_s, environment)
    if code is None:
        raise SimulatorError(f"{what} took more than {limit_s:g} s", log)
    if code != 0:
        raise SimulatorError(f"{what} failed with {ended(code)}", log)


def ended(code: int) -> str:
    """Return the exit code of a program in words, or the signal that ended it."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal has no name
        return f"signal {-code}"


def output_of(
    command: Command, limit_s: float, directory: Path | None = None, environment: Variables = None
) -> tuple[int | None, str]:
    """Run a command; return its exit code, None if it was ended at its limit, and its output.

    SimulatorError if it cannot be started, or there is no room for its output.
    """
    try:
        # A file in place of a pipe: a grandchild that holds a pipe open would be waited for.
        with tempfile.TemporaryFile() as out:
            code = _run(command, limit_s, environment, None, None, cwd=directory, stdout=out)
            out.seek(0)
            return code, out.read().decode(errors="replace")
    except OSError as error:
        raise SimulatorError(f"{Path(command[0]).name}: {error.strerror or error}") from None


class Timeout:
    """Timeout without progress: time in which this process was stopped (Ctrl-Z) counts as at most `LOOK_S`."""

    LOOK_S = 5.0

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._idle_s = 0.0
        self._seen: Any = None
        self._looked = time.monotonic()

    def over(self, seen: Any) -> bool:
        """Return True if `seen`, a measure of progress, is unchanged for longer than the limit."""
        now = time.monotonic()
        self._idle_s = 0.0 if seen != self._seen else self._idle_s + min(now - self._looked, self.LOOK_S)
        self._seen, self._looked = seen, now
        return self._idle_s > self._limit_s


SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
"""Signals that end a command, and its exit code: 128 plus the number, as in a shell."""

GRACE_S = 20.0
"""Longest time in which an interrupted command ends its children and leaves its earlier results."""
TWICE_S = 1.0
"""A further signal within this time is the same one, sent to the process and to its group."""
_asked_at: float | None = None


class Terminated(SystemExit):
    """SIGTERM or SIGHUP came; its code is that of `SIGNALS`."""


def _leave_when_asked(number: int, _: FrameType | None) -> None:
    global _asked_at
    code, now = SIGNALS[signal.Signals(number)], time.monotonic()
    if _asked_at is not None:
        if now - _asked_at > TWICE_S:
            os._exit(code)
        return
    _asked_at = now
    timer = threading.Timer(GRACE_S, lambda: None if _asked_at is None else os._exit(code))
    timer.daemon = True
    timer.start()
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise Terminated(code)


@contextlib.contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle signals that end a command in the block.

    An ignored signal stays ignored: nohup ignores SIGHUP, a shell ignores SIGINT in background jobs.
    """
    before = {number: was for number in SIGNALS if (was := signal.getsignal(number)) is not signal.SIG_IGN}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, was in before.items():
            signal.signal(number, was)


@contextlib.contextmanager
def ending() -> Iterator[None]:
    """Turn signals that end a command into an exception in the block, so that its children are ended.

    SIGINT raises KeyboardInterrupt; SIGTERM and SIGHUP raise Terminated. An exception may be lost,
    in a callback of C code or a destructor: asked again, or after `GRACE_S`, the process ends with
    that code all the same, and the watchdog ends its children.
    """
    global _asked_at
    inner = signal.getsignal(signal.SIGTERM) is _leave_when_asked
    if inner or threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        with _handled(_leave_when_asked):
            yield
    finally:
        _asked_at = None


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Defer signals that end a command to the end of a short block."""
    if threading.current_thread() is not threading.main_thread():
        yield  # the exception is raised in the main thread
        return
    came: list[int] = []
    with _handled(lambda number, _: came.append(number)):
        yield
    for number in came[:1]:
        signal.raise_signal(number)


@contextlib.contextmanager
def stoppable(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Yield threads for `run_child`; an error ends their children at once."""
    ends = (*_own.ends, threading.Event())
    with ThreadPoolExecutor(workers, initializer=setattr, initargs=(_own, "ends", ends)) as pool:
        try:
            yield pool
        except BaseException:
            ends[-1].set()  # each ends its child at its next look
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextlib.contextmanager
def threads(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Yield threads for `run_child`; Ctrl-C, SIGTERM or an error ends their children at once."""
    with ending(), stoppable(workers) as pool:
        yield pool
