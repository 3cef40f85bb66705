# SPDX-License-Identifier: Apache-2.0
"""Ends the children of a killed command: a separate process that sees the end of the command by a pipe.

Every child of a command carries a mark in its environment, which its own children inherit. The mark
finds processes whose parent is dead, and sessions of their own, which neither a process group nor
PR_SET_PDEATHSIG reaches. Standard library alone, so that it runs within milliseconds: `python -I -S
watchdog.py MARK`.
"""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable

VARIABLE = "DERMIS_MARK"
"""Marks are paths: command /a starts /a/1, which starts /a/1/b/2; all of its tree has /a/1."""

END_LIMIT_S = 10.0  # longest wait for killed processes, which the kernel may hold in a system call
EXEC_LIMIT_S = 0.2  # longest wait for a process that is becoming another program
ARGUMENTS_ALONE = 4  # looks that find arguments and no environment until there is none
NO_PROGRAM = 0x200004  # a kernel thread or an exiting process: PF_KTHREAD, PF_EXITING in the kernel's sched.h

Process = tuple[int, int]
"""Process id and the time it was started at, in ticks since boot: ids are used again."""


def read(pid: int, name: str) -> bytes:
    """Return a file of /proc/PID; nothing for a process that is gone, or for another user's."""
    try:
        with open(f"/proc/{pid}/{name}", "rb") as file:
            return file.read()
    except OSError:
        return b""


def status(pid: int) -> list[bytes]:
    """Return the fields of /proc/PID/stat from the state on; none for a process that is gone."""
    return read(pid, "stat").rpartition(b")")[2].split()


def identity(pid: int) -> Process | None:
    """Return a live process by its id, None if it has ended."""
    fields = status(pid)
    return None if not fields or fields[0] in (b"Z", b"X") else (pid, int(fields[19]))


def _environment(pid: int) -> bytes:
    """Return the environment of a process; each entry has a zero before it.

    During execve a process has neither environment nor arguments: it is looked at again. With arguments alone it has
    no environment, or is another user's, or becomes one program after another: that is looked at a few times.
    """
    last, arguments_alone = time.monotonic() + EXEC_LIMIT_S, 0
    while True:
        found = read(pid, "environ")
        if found or arguments_alone == ARGUMENTS_ALONE or time.monotonic() > last:
            return b"\0" + found
        if read(pid, "cmdline"):
            arguments_alone += 1
            continue
        fields = status(pid)
        if not fields or int(fields[6]) & NO_PROGRAM:
            return b""
        time.sleep(0.0005)


def marked(mark: str) -> set[Process]:
    """Return the live processes that carry a mark, or one below it, except this one."""
    entry = f"\0{VARIABLE}={mark}".encode()
    found = set()
    for name in os.listdir("/proc"):
        if not name.isdigit() or int(name) == os.getpid():
            continue
        process, environment = identity(int(name)), _environment(int(name))
        place = environment.find(entry)
        if process and place >= 0 and environment[place + len(entry) :][:1] in (b"/", b"\0", b""):
            found.add(process)
    return found


def end(find: Callable[[], set[Process]]) -> None:
    """Kill the processes that `find()` returns, until it returns no more or END_LIMIT_S is over."""
    stopped: set[Process] = set()
    # Stopped first, so that none of them starts another one meanwhile.
    while new := find() - stopped:
        stopped |= new
        _send(new, signal.SIGSTOP)
    last = time.monotonic() + END_LIMIT_S
    while stopped and (found := find()) and time.monotonic() < last:
        _send(found, signal.SIGKILL)
        time.sleep(0.002)


def _send(processes: set[Process], number: signal.Signals) -> None:
    for process in processes:
        if identity(process[0]) == process:
            with contextlib.suppress(OSError):  # gone meanwhile
                os.kill(process[0], number)


def main(mark: str) -> None:
    """Wait until standard input is closed; then end all processes with the mark."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    while os.read(0, 1):
        pass
    end(lambda: marked(mark))


if __name__ == "__main__":
    main(sys.argv[1])
