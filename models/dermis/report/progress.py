# SPDX-License-Identifier: Apache-2.0
"""Progress of a long command: done, rate, time left; a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

QUIET_S = 10.0


class Tell(Protocol):
    """Receives the number of units done and the name of the current step."""

    def __call__(self, done: int, doing: str = "") -> None: ...


def rate(done: int, seconds: float, unit: str) -> str:
    """Return a rate in words: per second, or per minute or hour where that is less than one."""
    if done <= 0 or seconds <= 0:
        return ""
    for length, name in ((1, "s"), (60, "min"), (3600, "h")):
        if done / seconds * length >= 1 or name == "h":
            return f"{done / seconds * length:.3g} {unit}/{name}"
    return ""


def duration(seconds: float) -> str:
    """Return a duration in words, in seconds below two minutes."""
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def line(what: str, done: int, total: int, unit: str, seconds: float, doing: str = "") -> str:
    """Return one line of progress after `seconds`."""
    parts = [f"{what}: {done} of {total} {unit}"]
    if 0 < done:
        parts.append(rate(done, seconds, unit))
        if done < total:
            parts.append(f"{duration(seconds / done * (total - done))} left")
    if doing:
        parts.append(f"now {doing}")
    return ", ".join(parts)


class _Rate(ProgressColumn):
    """The rate since the beginning."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Any) -> Text:
        return Text(rate(int(task.completed), task.elapsed or 0.0, self._unit), style="progress.data.speed")


@contextmanager
def slots(what: str, total: int, unit: str = "row slots") -> Iterator[Tell]:
    """Yield a function that takes the number of units done of `total` and the current step."""
    if not sys.stderr.isatty():
        begin = said = time.monotonic()

        def tell(done: int, doing: str = "") -> None:
            nonlocal said
            now = time.monotonic()
            if now - said > QUIET_S:
                said = now
                print(line(what, done, total, unit, now - begin, doing), file=sys.stderr, flush=True)

        yield tell
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[doing]}", style="dim"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total, doing="")
        yield lambda done, doing="": bar.update(task, completed=done, doing=doing)
