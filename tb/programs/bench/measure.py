# SPDX-License-Identifier: Apache-2.0
"""Time measurement of the benchmarks, and their random frames."""

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dermis import plan
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene.design import load as load_design
from tb.reference import scenes


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process and its children to one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})  # on most machines the first one serves interrupts
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def cpu_once(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return the value of one call and its processor time in seconds, children included."""
    begin = cpu_time.cpu_used_s()
    value = work()
    return value, cpu_time.cpu_used_s() - begin


def busy_row(name: str) -> Row:
    """Return a row with the number of cores that other processes use, measured over one second."""

    def ticks() -> tuple[int, int]:
        numbers = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
        return sum(numbers), numbers[3] + numbers[4]  # idle, and waiting for a disk

    total, idle = ticks()
    time.sleep(1.0)
    after, idle_after = ticks()
    busy = (os.cpu_count() or 1) * (1.0 - (idle_after - idle) / max(1, after - total))
    note = "other work is running: speeds are too low" if busy > 0.2 else "nothing else is running"
    return verdict.report(name, round(busy, 2), "cores", f"in the second before; {note}")


def random_plan(frames: int, engine: str, size: int | None = None, **effects_on: Any) -> Plan:
    """Return frames of resistances even in log R over the sensor's range, always the same ones."""
    design = load_design()
    low, high = math.log(design.sensor.r_min_ohm), math.log(design.sensor.r_max_ohm)
    rows, cols = (size, size) if size else (design.array.rows, design.array.cols)
    ohm = np.exp(np.random.default_rng(2026).uniform(low, high, (frames, rows, cols)))
    return plan.make(scenes.of_resistances(ohm, effects_on, name="random"), engine)
