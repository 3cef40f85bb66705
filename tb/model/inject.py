# SPDX-License-Identifier: Apache-2.0
"""Faults from within a process, of a worker or a command's own code."""

import os
import signal
import sys
import time


def die(*_: object) -> None:
    """End this process without a word."""
    os._exit(9)


def stop(*_: object) -> None:
    """Stand still, as under SIGSTOP."""
    os.kill(os.getpid(), signal.SIGSTOP)


def sleep(*_: object) -> None:
    """Say so, and do nothing for a minute."""
    print("at work", file=sys.stderr, flush=True)
    time.sleep(60)


def unsendable(*_: object) -> object:
    """Give an answer that no pipe carries."""
    return lambda: None
