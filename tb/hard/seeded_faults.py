# SPDX-License-Identifier: Apache-2.0
"""Runs that go wrong on purpose, one way each; in a module of their own, so that worker processes can be given them."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time

from dermis.errors import SimulatorError
from tb.programs.hard import Measured

SLEEP = "DERMIS_SEEDED_SLEEP"
"""Variable with the seconds that a process left behind would sleep: of this test's alone, so that they are its mark."""


def long_s() -> str:
    """Those seconds."""
    return os.environ[SLEEP]


def right() -> Measured:
    """Nothing wrong."""
    return Measured(0.0, "as it should be", seconds=0.25)


def off_by_one() -> Measured:
    """A miss."""
    return Measured(-1.0, "one too few")


def hang() -> Measured:
    """Never ends."""
    time.sleep(float(long_s()))
    return Measured(0.0)


def hang_with_child() -> Measured:
    """Never ends, and has started a program in a session of its own."""
    subprocess.Popen(["sleep", long_s()], start_new_session=True)
    return hang()


def deaf() -> Measured:
    """Never ends, and does not hear that it should."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return hang()


def too_slow() -> Measured:
    """Has an answer, later than it may."""
    time.sleep(1.5)
    return Measured(0.0)


def crash() -> Measured:
    """As a defect in compiled code ends."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return Measured(0.0)


def leave() -> Measured:
    """Takes itself for a command."""
    sys.exit(0)


def fail() -> Measured:
    """An exception that no one expects."""
    raise ValueError("nobody expects this")


def simulator() -> Measured:
    """A simulator that gave up."""
    raise SimulatorError("ngspice stopped at 3 us, node v_int", "ngspice.log")


def not_a_number() -> Measured:
    """Divides nothing by nothing."""
    return Measured(math.nan)


def nothing() -> None:
    """Forgets to say what it found."""


def orphan() -> Measured:
    """Right, but for a process that it started and forgot."""
    subprocess.Popen(["sh", "-c", f"setsid sleep {long_s()} & exit 0"]).wait()
    return Measured(0.0)


def forked() -> Measured:
    """Right, but for a copy of itself in a session of its own."""
    if os.fork() == 0:
        os.setsid()
        time.sleep(float(long_s()))
        os._exit(0)
    return Measured(0.0)
