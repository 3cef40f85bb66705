# SPDX-License-Identifier: Apache-2.0
"""Processor time of work, which other jobs on the machine disturb less than the clock on the wall."""

from __future__ import annotations

import resource
from collections.abc import Callable

# Shorter runs are repeated: processor time of a process is not known better than to some 10 us.
_AT_LEAST_S = 0.02


def cpu_seconds(work: Callable[[], object]) -> float:
    """Processor time of one call, in this process and its children, from as many calls as it takes to see it."""
    calls = 0
    begin = cpu_used_s()
    while calls == 0 or cpu_used_s() - begin < _AT_LEAST_S:
        work()
        calls += 1
    return (cpu_used_s() - begin) / calls


def cpu_used_s() -> float:
    """Processor time that this process and its ended children have used so far, in seconds."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)
