# SPDX-License-Identifier: Apache-2.0
"""Rules for any input: refused in one printable line, or taken within memory and time, traceless."""

import contextlib
import os
import re
import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from dermis.errors import InputError

CPU_S = 4.0  # processor time of one input, ten times that of the slowest legal one
WALL_S = 60.0  # wall clock time of one input, for inputs that wait, such as a FIFO
ADDRESS_BYTES, RESIDENT_BYTES = 192 << 20, 96 << 20
"""Memory that an input may reserve and touch; its largest array has 2 MB."""

LINE_MAX = 2000  # characters of a refusal; dermis.errors cuts each of its parts


class Finding(Exception):
    """A violation: the oracle that saw it, its place in the package as module and function, and a text.

    Oracles: `escape` an exception other than the typed ones, `line` a refusal that is not one printable
    line, `write` a file, `memory`, `time`, `deck` a strange line of a deck, `value` a result out of
    range, `again` a resolved file that reads differently, `exit` an unknown exit code.
    """

    def __init__(self, kind: str, place: str, text: str) -> None:
        super().__init__(f"{kind} in {place}: {text[:300]}")
        self.kind = kind
        self.signature = f"{kind} {place}"  # equal for two findings of one defect


class OverTime(BaseException):
    """The input took longer than its limit; no `except Exception` of the package catches it."""


def _over(*_: object) -> None:
    raise OverTime


@contextlib.contextmanager
def _limited(cpu_s: float) -> Iterator[None]:
    """Limit time and memory; signals reach the main thread only."""
    memory = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    timers = (signal.SIGPROF, signal.ITIMER_PROF, cpu_s), (signal.SIGALRM, signal.ITIMER_REAL, WALL_S)
    before = [signal.signal(number, _over) for number, _, _ in timers]
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_BYTES, memory[1]))
    for _, timer, seconds in timers:  # repeated, in case a destructor swallows the first signal
        signal.setitimer(timer, seconds, 1.0)
    try:
        # An unintended NaN, overflow or division by zero is an exception here.
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    finally:
        for (number, timer, _), old in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, old)
        resource.setrlimit(resource.RLIMIT_AS, memory)


def place_of(error: BaseException | None) -> str:
    """Return module and function of the innermost frame of the package."""
    here, place = error.__traceback__ if error else None, ""
    while here is not None:
        name = here.tb_frame.f_globals.get("__name__", "")
        if name.startswith(("dermis.", "scripts.")):
            place = f"{name.removeprefix('dermis.')}.{here.tb_frame.f_code.co_name}"
        here = here.tb_next
    return place or "the package"


def _check_refusal(error: InputError) -> None:
    """Raise Finding unless a refusal is one printable line "FILE: KEY = VALUE: ALLOWED"."""
    text, wrong, cause = str(error), "", error.__context__
    while cause is not None:
        if isinstance(cause, MemoryError):
            raise Finding("memory", place_of(error), f"reported as a wrong value: {text}")
        cause = cause.__context__
    if not text or not text.isprintable():
        wrong = "characters that are not printable"
    elif not (re.fullmatch(r".+: .+ = .+: .+", text) and error.allowed.strip()):
        wrong = "file, key, value or the allowed values are missing"
    elif len(text) > LINE_MAX:
        wrong = f"{len(text)} characters"
    if wrong:
        raise Finding("line", place_of(error), f"{wrong}: {text!r}")


_KINDS = {OverTime: "time", MemoryError: "memory", SystemExit: "exit", BaseException: "escape"}


def judge(call: Callable[[], object], cpu_s: float = CPU_S) -> str:
    """Return "refused" or "taken" for a call with an input, or raise the first Finding.

    It may take `cpu_s` of processor time and leave nothing in the working directory.
    """
    resident, stopped = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, None
    before = set(os.listdir())
    try:
        with _limited(cpu_s):
            call()
    except Finding:
        raise
    except BaseException as error:  # judged below
        stopped = error
    if new := set(os.listdir()) - before:
        raise Finding("write", place_of(stopped), str(new))
    if isinstance(stopped, InputError):
        _check_refusal(stopped)
    elif stopped is not None:
        kind = next(kind for of, kind in _KINDS.items() if isinstance(stopped, of))
        raise Finding(kind, place_of(stopped), f"{type(stopped).__name__}: {stopped!s:.200}") from None
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident) << 10
    if grown > RESIDENT_BYTES:
        raise Finding("memory", "the package", f"{grown >> 20} MB touched")
    return "refused" if stopped else "taken"
