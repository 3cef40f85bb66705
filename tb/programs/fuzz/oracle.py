# SPDX-License-Identifier: Apache-2.0
"""Rules for any input: refused in one printable line, or taken within memory, time and OUT."""

from __future__ import annotations

import builtins
import contextlib
import functools
import os
import re
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dermis.errors import DermisError, InputError

CPU_S = 4.0
"""Processor time of one input, ten times that of the slowest legal one under `small_limits`."""

WALL_S = 60.0
"""Wall clock time of one input, for inputs that wait, such as a FIFO."""

ADDRESS_BYTES = 192 << 20
"""Memory that an input may reserve: 90 times the largest array of `small_limits`."""

RESIDENT_BYTES = 96 << 20
"""Memory that an input may touch."""

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
        super().__init__(kind, place, text)
        self.kind, self.place, self.text = kind, place, text

    @property
    def signature(self) -> str:
        """Oracle and place, equal for two findings of one defect."""
        return f"{self.kind} {self.place}"

    def __str__(self) -> str:
        return f"{self.kind} in {self.place}: {self.text}"


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

_STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty")
_CONNECTS = ("socket.connect", "socket.bind", "socket.sendto", "ctypes.dlopen")
# Packages whose classes numba's cache of compiled loops holds; a pickle in an input names other
# classes.
_UNPICKLED = ("numba", "llvmlite", "numpy", "dermis", "copyreg", "_codecs", "collections", "types")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# Audit event -> (argument that is a changed path, argument with its directory).
_CHANGES: dict[str, tuple[tuple[int, int | None], ...]] = {
    "os.mkdir": ((0, 2),), "os.rmdir": ((0, 1),), "os.remove": ((0, 1),), "os.rename": ((0, 2), (1, 3)),
    "os.link": ((1, 3),), "os.symlink": ((1, 2),), "os.chmod": ((0, 2),), "os.chown": ((0, 3),),
    "os.truncate": ((0, None),), "os.utime": ((0, 3),), "os.setxattr": ((0, None),),
    "os.removexattr": ((0, None),),
}  # fmt: skip


class Watch:
    """Watches files that are written and processes that are started, by Python's audit events."""

    def __init__(self) -> None:
        self._policy: Policy | None = None
        self._follow = False
        self.seen: list[tuple[str, str]] = []
        sys.addaudithook(self._hook)

    @contextlib.contextmanager
    def only(self, policy: Policy, follow: bool = False) -> Iterator[None]:
        """Allow writing by a policy only; with `follow` a process that starts is Taken."""
        self._policy, self._follow = policy, follow
        self.seen.clear()
        try:
            yield
        finally:
            self._policy = None

    def _hook(self, event: str, args: tuple[Any, ...]) -> None:
        policy = self._policy
        if policy is None:
            return
        unpickled = event == "pickle.find_class" and not _harmless(*args)
        if unpickled or event in _STARTS or event in _CONNECTS:
            if self._follow and not unpickled:
                raise Taken
            self._violated("process", f"{event} {args[:2]!r}")
        if event == "open" and isinstance(args[2], int) and args[2] & _WRITES:
            self._ask(policy, args[0], None, followed=True)
        for at, base in _CHANGES.get(event, ()):
            self._ask(policy, args[at], None if base is None else args[base], followed=False)

    def _ask(self, policy: Policy, path: Any, base: Any, followed: bool) -> None:
        if path is None or isinstance(path, int):
            return
        name = os.fsdecode(path)
        if isinstance(base, int) and base >= 0:
            name = os.path.join(os.readlink(f"/proc/self/fd/{base}"), name)
        head, tail = os.path.split(os.path.abspath(name))
        # Moving or removing changes the name itself, opening changes the target of a link.
        real = os.path.realpath(name) if followed else os.path.join(os.path.realpath(head), tail)
        before, self._policy = self._policy, None  # a policy may look at files
        try:
            # Python caches modules that are loaded meanwhile.
            allowed = real == os.devnull or "__pycache__" in real.split(os.sep) or policy(Path(real))
        finally:
            self._policy = before
        if not allowed:
            self._violated("write", name)

    def _violated(self, kind: str, text: str) -> None:
        self.seen.append((kind, text))  # reported even if the package catches the exception
        raise Violation(text)


def _harmless(module: str, name: str) -> bool:
    known = module == "builtins" and isinstance(getattr(builtins, name), type)
    return known or module.split(".")[0] in _UNPICKLED


@functools.cache
def watch() -> Watch:
    """Return the watch of this process; an audit hook cannot be removed, so there is one."""
    return Watch()


def inside(directory: Path) -> Policy:
    """Return a policy that allows a directory and nothing else."""
    root = Path(os.path.realpath(directory))
    return lambda path: root == path or root in path.parents


def limit_memory(more: int = ADDRESS_BYTES) -> None:
    """Limit the memory that this process may reserve in addition to what it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more, hard))


def small_limits() -> None:
    """Make the largest array of the package 2 MB, so that memory that is taken too early shows."""
    from dermis.scene import stimulus

    stimulus.VALUES_MAX = 1 << 18


def _over(signal_number: int, frame: Any) -> None:
    raise OverTime


@contextlib.contextmanager
def timed(cpu_s: float = CPU_S, wall_s: float = WALL_S) -> Iterator[None]:
    """Raise OverTime at the limits; signals reach the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [signal.signal(s, _over) for s in (signal.SIGPROF, signal.SIGALRM)]
    # Repeated, in case a destructor swallows the first one.
    signal.setitimer(signal.ITIMER_PROF, cpu_s, 1.0)
    signal.setitimer(signal.ITIMER_REAL, wall_s, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, old in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, old)


def place_of(error: BaseException) -> str:
    """Return module and function of the innermost frame of the package."""
    here, place = error.__traceback__, ""
    while here is not None:
        name = here.tb_frame.f_globals.get("__name__", "")
        if name.startswith(("dermis.", "scripts.")):
            place = f"{name.removeprefix('dermis.')}.{here.tb_frame.f_code.co_name}"
        here = here.tb_next
    return place or "the package"


def check_line(error: InputError) -> None:
    """Raise Finding unless a refusal is one printable line "FILE: KEY = VALUE: ALLOWED"."""
    text, wrong = str(error), None
    if not text.isprintable():
        wrong = "characters that are not printable"
    elif not re.fullmatch(r".+: .+ = .+: .+", text) or not error.allowed.strip():
        wrong = "file, key, value or the allowed values are missing"
    elif len(text) > LINE_MAX:
        wrong = f"{len(text)} characters"
    if wrong:
        raise Finding("line", place_of(error), f"{wrong}: {text[:300]!r}")


def _hides_memory_error(error: BaseException | None) -> bool:
    """Return True if a refusal was raised because memory ran out."""
    while error is not None and not isinstance(error, MemoryError):
        error = error.__context__
    return error is not None


def judge(
    call: Callable[[], object],
    policy: Policy,
    *,
    typed: type[DermisError] = InputError,
    follow: bool = False,
    cpu_s: float = CPU_S,
) -> str:
    """Run a call for one input and return "refused" or "taken".

    Parameters
    ----------
    call : uses the input
    policy : paths that it may write
    typed : error of a refusal
    follow : a process that starts ends the call; otherwise it is a finding
    cpu_s : processor time that it may take

    Raises
    ------
    Finding
        The first violation.
    """
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcome, found = "taken", None
    try:
        # An unintended NaN, overflow or division by zero is an exception here.
        with (
            watch().only(policy, follow),
            timed(cpu_s),
            np.errstate(divide="raise", over="raise", invalid="raise"),
        ):
            call()
    except typed as error:
        outcome = "refused"
        if _hides_memory_error(error):
            found = Finding("memory", place_of(error), f"reported as a wrong value: {str(error)[:200]}")
        elif isinstance(error, InputError):
            check_line(error)
        elif not str(error).isprintable() or not str(error):
            found = Finding("line", place_of(error), repr(str(error)[:200]))
    # The input reached a command that the target replaces: taken.
    except Taken:
        pass
    except Finding:
        raise
    except OverTime as error:
        found = Finding("time", place_of(error), f"over {cpu_s:g} s of processor time or {WALL_S:g} s")
    except Violation as error:
        kind, text = watch().seen[0]
        found = Finding(kind, place_of(error), text[:200])
    except MemoryError as error:
        found = Finding("memory", place_of(error), f"over {ADDRESS_BYTES >> 20} MB")
    except SystemExit as error:
        found = Finding("exit", place_of(error), f"SystemExit {error.code!r}")
    except (Exception, KeyboardInterrupt) as error:  # any other exception is a finding
        found = Finding("escape", place_of(error), f"{type(error).__name__}: {str(error)[:200]!r}")
    if found is None and watch().seen:
        kind, text = watch().seen[0]
        found = Finding(kind, "the package", f"{text[:200]}, and it was caught")
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident) << 10
    if found is None and grown > RESIDENT_BYTES:
        found = Finding("memory", "the package", f"{grown >> 20} MB touched")
    if found is not None:
        raise found from None
    return outcome
