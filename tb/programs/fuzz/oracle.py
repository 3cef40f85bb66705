# SPDX-License-Identifier: Apache-2.0
"""Rules for any input: refused in one printable line, or taken within memory, time and OUT."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dermis.errors import DermisError, InputError

CPU_S = 4.0
"""Processor time of one input, ten times that of the slowest legal one."""

WALL_S = 60.0
"""Wall clock time of one input, for inputs that wait, such as a FIFO."""

ADDRESS_BYTES, RESIDENT_BYTES = 192 << 20, 96 << 20
"""Memory that an input may reserve and touch; its largest array has 2 MB."""

LINE_MAX = 2000
"""Characters of a refusal; dermis.errors cuts each of its parts."""


class Finding(Exception):
    """A violation: the oracle that saw it, its place in the package as module and function, and a
    text.

    Oracles: `escape` an exception other than the typed ones; `line` a refusal other than one
    printable line; `write` a path outside OUT; `process` a process, connection or library;
    `memory`; `time`; `deck` a line of a deck of an unknown form; `value` a result out of range;
    `again` a resolved file that reads differently; `model` Verilog and model differ; `exit` an
    unknown exit code; `crash` the process ended.
    """

    def __init__(self, kind: str, place: str, text: str) -> None:
        super().__init__(f"{kind} in {place}: {text[:300]}")
        self.kind = kind
        self.signature = f"{kind} {place}"  # equal for two findings of one defect


class Stop(BaseException):
    """Ends an input from inside; no `except Exception` of the package catches it."""


class Taken(Stop):
    """The input was accepted: the next step would start a simulator or write results."""


class OverTime(Stop):
    """The input took longer than its limit."""


class Violation(Stop):
    """The input was about to touch a forbidden file or process."""


Policy = Callable[[Path], bool]
"""Returns True if a path may be written; may raise Taken."""

_STARTS = frozenset(
    ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty",
     "socket.connect", "socket.bind", "socket.sendto", "ctypes.dlopen")
)  # fmt: skip
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# Audit event -> (argument that is a changed path, argument with its directory).
_CHANGES: dict[str, tuple[tuple[int, int | None], ...]] = {
    "open": ((0, None),), "os.mkdir": ((0, 2),), "os.rmdir": ((0, 1),), "os.remove": ((0, 1),),
    "os.rename": ((0, 2), (1, 3)), "os.link": ((1, 3),), "os.symlink": ((1, 2),), "os.chmod": ((0, 2),),
    "os.chown": ((0, 3),), "os.truncate": ((0, None),), "os.utime": ((0, 3),), "os.setxattr": ((0, None),),
    "os.removexattr": ((0, None),),
}  # fmt: skip


class _Watch:
    """Watches files that are written and processes that are started, by Python's audit events."""

    policy: Policy | None = None
    follow = False
    seen: tuple[str, str] | None = None

    def hook(self, event: str, args: tuple[Any, ...]) -> None:
        """Raise Violation for an event that the policy forbids."""
        if self.policy is None:
            return
        if event in _STARTS:
            if self.follow:
                raise Taken
            self._violated("process", f"{event} {args[:2]!r}")
        if event == "open" and not (isinstance(args[2], int) and args[2] & _WRITES):
            return
        for at, base in _CHANGES.get(event, ()):
            if args[at] is None or isinstance(args[at], int):
                continue
            name = os.fsdecode(args[at])
            if base is not None and isinstance(args[base], int) and args[base] >= 0:
                name = os.path.join(os.readlink(f"/proc/self/fd/{args[base]}"), name)
            head, tail = os.path.split(os.path.abspath(name))
            # Moving or removing changes the name itself, opening changes the target of a link.
            real = os.path.realpath(name) if event == "open" else os.path.join(os.path.realpath(head), tail)
            # Python caches modules that are loaded meanwhile.
            if real != os.devnull and "__pycache__" not in real.split(os.sep) and not self.policy(Path(real)):
                self._violated("write", name)

    def _violated(self, kind: str, text: str) -> None:
        self.seen = self.seen or (kind, text)  # reported even if the package catches the exception
        raise Violation(text)


@functools.cache
def _watch() -> _Watch:
    """Return the watch of this process; an audit hook cannot be removed, so there is one."""
    watch = _Watch()
    sys.addaudithook(watch.hook)
    return watch


def _over(signal_number: int, frame: Any) -> None:
    raise OverTime


@contextlib.contextmanager
def _limited(policy: Policy, follow: bool, cpu_s: float) -> Iterator[_Watch]:
    """Limit files, processes, time and memory; signals reach the main thread only."""
    watch, memory = _watch(), resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    timers = (signal.SIGPROF, signal.ITIMER_PROF, cpu_s), (signal.SIGALRM, signal.ITIMER_REAL, WALL_S)
    before = [signal.signal(number, _over) for number, _, _ in timers]
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_BYTES, memory[1]))
    for _, timer, seconds in timers:  # repeated, in case a destructor swallows the first signal
        signal.setitimer(timer, seconds, 1.0)
    watch.policy, watch.follow, watch.seen = policy, follow, None
    try:
        # An unintended NaN, overflow or division by zero is an exception here.
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield watch
    finally:
        watch.policy = None
        for (number, timer, _), old in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, old)
        resource.setrlimit(resource.RLIMIT_AS, memory)


def place_of(error: BaseException) -> str:
    """Return module and function of the innermost frame of the package."""
    here, place = error.__traceback__, ""
    while here is not None:
        name = here.tb_frame.f_globals.get("__name__", "")
        if name.startswith(("dermis.", "scripts.")):
            place = f"{name.removeprefix('dermis.')}.{here.tb_frame.f_code.co_name}"
        here = here.tb_next
    return place or "the package"


def _check_refusal(error: DermisError) -> None:
    """Raise Finding unless a refusal is one printable line "FILE: KEY = VALUE: ALLOWED"."""
    text, wrong, cause = str(error), "", error.__context__
    while cause is not None:
        if isinstance(cause, MemoryError):
            raise Finding("memory", place_of(error), f"reported as a wrong value: {text}")
        cause = cause.__context__
    if not text or not text.isprintable():
        wrong = "characters that are not printable"
    elif isinstance(error, InputError) and not (
        re.fullmatch(r".+: .+ = .+: .+", text) and error.allowed.strip()
    ):
        wrong = "file, key, value or the allowed values are missing"
    elif len(text) > LINE_MAX:
        wrong = f"{len(text)} characters"
    if wrong:
        raise Finding("line", place_of(error), f"{wrong}: {text!r}")


_KINDS = {OverTime: "time", MemoryError: "memory", SystemExit: "exit", BaseException: "escape"}


def judge(
    call: Callable[[], object],
    policy: Policy = lambda path: False,
    *,
    typed: type[DermisError] = InputError,
    follow: bool = False,
    cpu_s: float = CPU_S,
) -> str:
    """Run a call for one input and return "refused" or "taken", or raise the first Finding.

    Parameters
    ----------
    call : uses the input
    policy : paths that it may write
    typed : error of a refusal
    follow : a process that starts ends the call; otherwise it is a finding
    cpu_s : processor time that it may take
    """
    resident, stopped = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, None
    watch = _watch()
    try:
        with _limited(policy, follow, cpu_s):
            call()
    except Taken:  # the input reached a command that the target replaces
        pass
    except Finding:
        raise
    except BaseException as error:  # judged below
        stopped = error
    if watch.seen is not None:
        kind, text = watch.seen
        caught = "" if isinstance(stopped, Violation) else ", and it was caught"
        raise Finding(kind, place_of(stopped) if stopped else "the package", text + caught)
    if isinstance(stopped, typed):
        _check_refusal(stopped)
    elif stopped is not None:
        kind = next(kind for of, kind in _KINDS.items() if isinstance(stopped, of))
        raise Finding(kind, place_of(stopped), f"{type(stopped).__name__}: {stopped!s:.200}") from None
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident) << 10
    if grown > RESIDENT_BYTES:
        raise Finding("memory", "the package", f"{grown >> 20} MB touched")
    return "refused" if stopped else "taken"
