# SPDX-License-Identifier: Apache-2.0
"""Programs that a command starts: each in a session of its own, with a limit, and ended with all that it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from dermis.errors import SimulatorError

_running: set[subprocess.Popen[bytes]] = set()
_stopped = threading.Event()
_lock = threading.Lock()


def run_child(
    command: Sequence[str | Path],
    directory: Path,
    log: Path,
    limit_s: float,
    environment: Mapping[str, str] | None = None,
) -> int | None:
    """Run a command in a session of its own and return its exit code, None if it was ended at its limit.

    Parameters
    ----------
    command, directory : what is run, and where
    log : file that its output is added to
    limit_s : seconds until it is ended with all that it started
    environment : variables beside those of this process

    Raises
    ------
    SimulatorError
        `threads` is ending: nothing new is started, and no answer of what was ended counts.
    """
    with _lock, log.open("ab") as out:
        if _stopped.is_set():
            raise SimulatorError("interrupted", log)
        child = subprocess.Popen(
            command,
            cwd=directory,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        _running.add(child)
    code = None
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = child.wait(limit_s)
    finally:
        end_tree(child)
        with _lock:
            _running.discard(child)
    if _stopped.is_set():
        raise SimulatorError("interrupted", log)
    return code


def run_logged(
    command: Sequence[str | Path],
    directory: Path,
    log: Path,
    limit_s: float,
    what: str,
    environment: Mapping[str, str] | None = None,
) -> None:
    """Run a command that must succeed, as `run_child` does.

    Raises
    ------
    SimulatorError
        It failed, or ran longer than its limit.
    """
    code = run_child(command, directory, log, limit_s, environment)
    if code is None:
        raise SimulatorError(f"{what} took more than {limit_s:g} s", log)
    if code != 0:
        raise SimulatorError(f"{what} failed with exit code {code}", log)


def end_session(child: subprocess.Popen[bytes]) -> None:
    """End a child and what it started, if it still runs: it leads its session, so nothing else is hit."""
    if child.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()


def tree(root: int) -> set[int]:
    """A process, those of its session, and what they started, also in sessions of their own."""
    parents: dict[int, tuple[int, int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text(errors="replace").rpartition(")")[2].split()
            parents[int(stat.parent.name)] = int(fields[1]), int(fields[3])
    found = {pid for pid, (_, session) in parents.items() if session == root}
    while more := {pid for pid, (parent, _) in parents.items() if parent in found} - found:
        found |= more
    return found


def end_tree(child: subprocess.Popen[bytes]) -> None:
    """End a child that leads its session, and all that it started: sby's solvers have process groups of their own."""
    if child.poll() is None:
        found: set[int] = set()
        # Stopped first, so that none of them starts another one meanwhile.
        while new := tree(child.pid) - found:
            found |= new
            for pid in new:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGSTOP)
        for pid in found:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    end_session(child)


@contextlib.contextmanager
def ending() -> Iterator[None]:
    """Let SIGTERM be an exception meanwhile (exit 143), so that what runs is ended on the way out."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextlib.contextmanager
def threads(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Threads for `run_child`: Ctrl-C, SIGTERM or an error ends what they run at once, and then them."""
    pool = ThreadPoolExecutor(workers)
    with ending():
        try:
            yield pool
        except BaseException:
            _stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            with _lock:
                running = list(_running)
            for child in running:
                end_tree(child)
            raise
        finally:
            pool.shutdown()
            _stopped.clear()
