# SPDX-License-Identifier: Apache-2.0
"""Processor time of work: less disturbed by other jobs of the machine than wall time."""

import resource
from collections.abc import Callable

# Shorter runs are repeated: processor time is resolved to about 10 us.
_AT_LEAST_S = 0.02


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the processor time of one call, children included: the mean over enough calls."""
    calls = 0
    begin = cpu_used_s()
    while calls == 0 or cpu_used_s() - begin < _AT_LEAST_S:
        work()
        calls += 1
    return (cpu_used_s() - begin) / calls


def cpu_used_s() -> float:
    """Return the processor time of this process and its ended children so far, in seconds."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)
