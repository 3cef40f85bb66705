# SPDX-License-Identifier: Apache-2.0
"""What an input may do to the software: be refused in one printable line or be taken, within memory, time and OUT."""

from __future__ import annotations

import builtins
import os
import re
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dermis.errors import DermisError, InputError

CPU_S = 4.0
"""Processor time of one input: the slowest legal one within the sizes of `small_limits` takes a tenth of it."""

WALL_S = 60.0
"""Time of one input by the clock, for what waits instead of working, such as a FIFO; cores are shared."""

ADDRESS_BYTES = 192 << 20
"""Memory that an input may reserve beyond what the process has: 90 times the largest array of `small_limits`."""

RESIDENT_BYTES = 96 << 20
"""Memory that one input may touch: what is reserved and never touched shows in ADDRESS_BYTES instead."""

LINE_MAX = 2000
"""Characters of a refusal: file, key, value and what is allowed are each cut (dermis.errors), and this is their sum."""


class Finding(Exception):
    """Something that no input may bring about.

    Parameters
    ----------
    kind : str
        Which oracle saw it, one of `KINDS`.
    place : str
        Where in the package, by module and function: the same in every clone and on every line number.
    text : str
        What was seen.
    """

    def __init__(self, kind: str, place: str, text: str) -> None:
        super().__init__(kind, place, text)
        self.kind, self.place, self.text = kind, place, text

    @property
    def signature(self) -> str:
        """What two findings of one defect have in common."""
        return f"{self.kind} {self.place}"

    def __str__(self) -> str:
        return f"{self.kind} in {self.place}: {self.text}"


KINDS = {
    "escape": "an exception other than the typed ones",
    "line": "a refusal that is not one printable line with file, key, value and what is allowed",
    "write": "a path outside OUT is written, or anything before a run begins",
    "process": "a process, a connection or a library is opened",
    "memory": "more memory than the sizes allow",
    "time": "more time than the sizes allow",
    "deck": "a line of a deck that is none of the allowed forms",
    "value": "what was taken is not finite, not in range, or not of its shape",
    "again": "what is written out does not read back to the same",
    "model": "the Verilog and its reference model answer differently",
    "exit": "an exit code that the command line has not, or a code without its line",
    "crash": "the process ended",
}


class Stop(BaseException):
    """Ends an input from inside; no `except Exception` of the package can take it for a wrong value."""


class Taken(Stop):
    """The input was taken as far as it may be followed: the next step would start a simulator or write results."""


class OverTime(Stop):
    """An input took longer than its limit."""


class Violation(Stop):
    """A file or process that an input may not touch was about to be."""


# ---- files and processes ----------------------------------------------------------------------------------------

_STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty")
_CONNECTS = ("socket.connect", "socket.bind", "socket.sendto", "ctypes.dlopen")
_UNPICKLED = ("numba", "llvmlite", "numpy", "dermis", "copyreg", "_codecs", "collections", "types")
"""Packages whose classes numba's own cache of compiled loops holds; a pickle of an input names another one."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# event -> which of its arguments are paths that change, and which hold the directory they are relative to
_CHANGES: dict[str, tuple[tuple[int, int | None], ...]] = {
    "os.mkdir": ((0, 2),),
    "os.rmdir": ((0, 1),),
    "os.remove": ((0, 1),),
    "os.rename": ((0, 2), (1, 3)),
    "os.link": ((1, 3),),
    "os.symlink": ((1, 2),),
    "os.chmod": ((0, 2),),
    "os.chown": ((0, 3),),
    "os.truncate": ((0, None),),
    "os.utime": ((0, 3),),
    "os.setxattr": ((0, None),),
    "os.removexattr": ((0, None),),
}


def _harmless(module: str, name: str) -> bool:
    return module.split(".")[0] in _UNPICKLED or (
        module == "builtins" and isinstance(getattr(builtins, name), type)
    )


Policy = Callable[[Path], bool]
"""Says whether a path may be written; it may raise Taken."""


class Watch:
    """Sees every file that is opened to be written and every process that is started, by Python's audit events."""

    def __init__(self) -> None:
        self._policy: Policy | None = None
        self._follow = False
        self.seen: list[tuple[str, str]] = []
        sys.addaudithook(self._hook)

    @contextmanager
    def only(self, policy: Policy, follow: bool = False) -> Iterator[None]:
        """Let nothing be written meanwhile but what the policy lets; `follow`: a process that starts is Taken."""
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
        if event == "open":
            path, _, flags = args
            if isinstance(flags, int) and flags & _WRITES and not isinstance(path, int):
                self._ask(policy, path, None, followed=True)
        elif event in _CHANGES:
            for at, base in _CHANGES[event]:
                self._ask(policy, args[at], None if base is None else args[base], followed=False)

    def _ask(self, policy: Policy, path: Any, base: Any, followed: bool) -> None:
        if path is None or isinstance(path, int):
            return
        name = os.fsdecode(path)
        if isinstance(base, int) and base >= 0:
            name = os.path.join(os.readlink(f"/proc/self/fd/{base}"), name)
        head, tail = os.path.split(os.path.abspath(name))
        # What is moved or removed is the name itself; what is opened is what a link there leads to.
        real = os.path.realpath(name) if followed else os.path.join(os.path.realpath(head), tail)
        before, self._policy = self._policy, None  # a policy may look at files
        try:
            # What Python keeps of a module that is loaded meanwhile is no output, and its place no input's choice.
            allowed = real == os.devnull or "__pycache__" in real.split(os.sep) or policy(Path(real))
        finally:
            self._policy = before
        if not allowed:
            self._violated("write", name)

    def _violated(self, kind: str, text: str) -> None:
        # Told even where the package catches what is raised here.
        self.seen.append((kind, text))
        raise Violation(text)


_watch: Watch | None = None


def watch() -> Watch:
    """The watch of this process; audit hooks stay for ever, so there is one."""
    global _watch
    _watch = _watch or Watch()
    return _watch


def inside(directory: Path) -> Policy:
    """The policy that lets a directory be written and nothing else."""
    root = Path(os.path.realpath(directory))
    return lambda path: root == path or root in path.parents


# ---- memory and time --------------------------------------------------------------------------------------------


def status_bytes(key: str) -> int:
    """A size out of /proc/self/status, e.g. VmSize, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{key}:"):
            return int(line.split()[1]) << 10
    raise KeyError(key)


def limit_memory(more: int = ADDRESS_BYTES) -> None:
    """Let this process reserve so many bytes beyond what it has; for a worker, as it holds to its end."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (status_bytes("VmSize") + more, hard))


def small_limits() -> int:
    """Make the package's largest array small (2^18 values, 2 MB), so that what is taken too early shows early."""
    from dermis.scene import stimulus

    stimulus.VALUES_MAX = 1 << 18
    return stimulus.VALUES_MAX


def _over(signal_number: int, frame: Any) -> None:
    raise OverTime


@contextmanager
def timed(cpu_s: float = CPU_S, wall_s: float = WALL_S) -> Iterator[None]:
    """Raise OverTime in this thread when the limits are over; of a thread other than the main one nothing is asked."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [signal.signal(s, _over) for s in (signal.SIGPROF, signal.SIGALRM)]
    # Again and again, should the first one be swallowed in a destructor.
    signal.setitimer(signal.ITIMER_PROF, cpu_s, 1.0)
    signal.setitimer(signal.ITIMER_REAL, wall_s, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, old in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, old)


# ---- one input ---------------------------------------------------------------------------------------------------


def place_of(error: BaseException) -> str:
    """Module and function of the innermost frame inside the package and outside of this part of it."""
    here, place = error.__traceback__, ""
    while here is not None:
        name = here.tb_frame.f_globals.get("__name__", "")
        if name.startswith("dermis.") and not name.startswith("tb.programs.fuzz"):
            place = f"{name.removeprefix('dermis.')}.{here.tb_frame.f_code.co_name}"
        here = here.tb_next
    return place or "the package"


_REFUSAL = re.compile(r".+: .+ = .+: .+")


def check_line(error: InputError) -> None:
    """Hold the text of a refusal against the contract: one printable line "FILE: KEY = VALUE: ALLOWED".

    Raises
    ------
    Finding
        It is not.
    """
    text, place = str(error), place_of(error)
    wrong = None
    if not text.isprintable():
        wrong = "characters that are not printable"
    elif not _REFUSAL.fullmatch(text) or not error.allowed.strip():
        wrong = "file, key, value or what is allowed is missing"
    elif len(text) > LINE_MAX:
        wrong = f"{len(text)} characters"
    if wrong:
        raise Finding("line", place, f"{wrong}: {text[:300]!r}")


def _hidden_memory_error(error: BaseException) -> bool:
    """Whether a refusal hides that memory ran out: a file is not wrong because of that."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, MemoryError):
            return True
        seen = seen.__context__
    return False


def judge(
    call: Callable[[], object],
    policy: Policy,
    *,
    typed: type[DermisError] = InputError,
    follow: bool = False,
    cpu_s: float = CPU_S,
) -> str:
    """Run what one input leads to and return "refused" or "taken".

    Parameters
    ----------
    call : what is done with the input
    policy : which paths it may write
    typed : the error that a refusal is
    follow : whether starting a process is the end of what is looked at, else it is a finding
    cpu_s : processor time it may take

    Raises
    ------
    Finding
        An oracle saw something; the first one of them.
    """
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    outcome, found = "taken", None
    try:
        # A NaN, an overflow or a division by zero that nobody meant is an exception here.
        with (
            watch().only(policy, follow),
            timed(cpu_s),
            np.errstate(divide="raise", over="raise", invalid="raise"),
        ):
            call()
    except typed as error:
        outcome = "refused"
        if _hidden_memory_error(error):
            found = Finding("memory", place_of(error), f"told as a wrong value: {str(error)[:200]}")
        elif isinstance(error, InputError):
            check_line(error)
        elif not str(error).isprintable() or not str(error):
            found = Finding("line", place_of(error), repr(str(error)[:200]))
    except Taken:  # the end of what is looked at
        pass
    except Finding:
        raise
    except OverTime as error:
        found = Finding("time", place_of(error), f"over {cpu_s:g} s of processor time or {WALL_S:g} s")
    except Violation as error:
        found = Finding(*_first_seen(error))
    except MemoryError as error:
        found = Finding("memory", place_of(error), f"over {ADDRESS_BYTES >> 20} MB")
    except SystemExit as error:  # a parser may not end the process
        found = Finding("exit", place_of(error), f"SystemExit {error.code!r}")
    # Whatever is not typed is what is looked for.
    except (Exception, KeyboardInterrupt) as error:
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


def _first_seen(error: Violation) -> tuple[str, str, str]:
    kind, text = watch().seen[0] if watch().seen else ("write", str(error))
    return kind, place_of(error), text[:200]
