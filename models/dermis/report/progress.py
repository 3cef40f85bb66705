# SPDX-License-Identifier: Apache-2.0
"""A progress bar on a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

QUIET_S = 10.0


@contextmanager
def slots(what: str, total: int, unit: str = "row slots") -> Iterator[Callable[[int], None]]:
    """Give a function to call with the number of row slots (or other units) done, of `total`."""
    if not sys.stderr.isatty():
        said = time.monotonic()

        def line(done: int) -> None:
            nonlocal said
            if time.monotonic() - said > QUIET_S:
                said = time.monotonic()
                print(f"{what}: {done} of {total} {unit}", file=sys.stderr, flush=True)

        yield line
        return
    from rich.console import Console

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
