# SPDX-License-Identifier: Apache-2.0
"""Runs with one fault each, in a module that worker processes can import."""

import math
import os
import signal
import subprocess
import sys
import time

from dermis.errors import SimulatorError
from tb.programs.hard.case import Measured

SLEEP = "DERMIS_SEEDED_SLEEP"
"""Environment variable with the seconds that a left process sleeps; unique to a test, so that it finds its own."""


def long_s() -> str:
    return os.environ[SLEEP]


def right() -> Measured:
    return Measured(0.0, "as it should be")


def off_by_one() -> Measured:
    return Measured(-1.0, "one too few")


def hang() -> Measured:
    time.sleep(float(long_s()))
    return Measured(0.0)


def hang_with_child() -> Measured:
    """Never end, after starting a program in a session of its own."""
    subprocess.Popen(["sleep", long_s()], start_new_session=True)
    return hang()


def deaf() -> Measured:
    """Never end, and ignore SIGTERM."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return hang()


def too_slow() -> Measured:
    time.sleep(1.5)
    return Measured(0.0)


def crash() -> Measured:
    """Crash as compiled code does."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return Measured(0.0)


def leave() -> Measured:
    sys.exit(0)


def fail() -> Measured:
    raise ValueError("nobody expects this")


def simulator() -> Measured:
    """Fail as a simulator."""
    raise SimulatorError("ngspice stopped at 3 us, node v_int", "ngspice.log")


def not_a_number() -> Measured:
    return Measured(math.nan)


def nothing() -> None:
    """Give no answer."""


def orphan() -> Measured:
    """Give a right answer and leave a process."""
    subprocess.Popen(["sh", "-c", f"setsid sleep {long_s()} & exit 0"]).wait()
    return Measured(0.0)


def forked() -> Measured:
    """Give a right answer and leave a copy of the process in its own session."""
    if os.fork() == 0:
        os.setsid()
        time.sleep(float(long_s()))
        os._exit(0)
    return Measured(0.0)
