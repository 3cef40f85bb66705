# SPDX-License-Identifier: Apache-2.0
"""Progress of a long command: done, rate, time left; a bar on a terminal, lines elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

QUIET_S = 10.0


class Tell(Protocol):
    """Receives the number of units done and the name of the current step."""

    def __call__(self, done: int, doing: str = "") -> None: ...


def rate(done: int, seconds: float, unit: str) -> str:
    """Return a rate in words: per second, or per minute or hour where that is less than one."""
    if done <= 0 or seconds <= 0:
        return ""
    shorter = (each for each in ((1, "s"), (60, "min")) if done / seconds * each[0] >= 1)
    length, name = next(shorter, (3600, "h"))
    return f"{done / seconds * length:.3g} {unit}/{name}"


def duration(seconds: float) -> str:
    """Return a duration in words, in seconds below two minutes."""
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def line(what: str, done: int, total: int, unit: str, seconds: float, doing: str = "") -> str:
    """Return one line of progress after `seconds`."""
    left = f"{duration(seconds / done * (total - done))} left" if 0 < done < total else ""
    parts = (f"{what}: {done} of {total} {unit}", rate(done, seconds, unit), left, doing and f"now {doing}")
    return ", ".join(part for part in parts if part)


@contextmanager
def slots(what: str, total: int, unit: str = "row slots") -> Iterator[Tell]:
    """Yield a function that takes the number of units done of `total` and the current step."""
    begin = said = time.monotonic()

    def words(now: float, done: int, doing: str = "") -> str:
        return line(what, done, total, unit, now - begin, doing)

    if not sys.stderr.isatty():

        def tell(done: int, doing: str = "") -> None:
            nonlocal said
            if (now := time.monotonic()) - said > QUIET_S:
                said = now
                print(words(now, done, doing), file=sys.stderr, flush=True)

        yield tell
        return
    columns = BarColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(words(begin, 0), total=total)

        def show(done: int, doing: str = "") -> None:
            bar.update(task, completed=done, description=words(time.monotonic(), done, doing))

        yield show
