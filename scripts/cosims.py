# SPDX-License-Identifier: Apache-2.0
"""Co-simulations in parallel: one progress line; the failure of one leaves the others alone."""

from collections.abc import Callable, Mapping
from typing import Any

from dermis.errors import SimulatorError
from dermis.processes import children
from dermis.report import progress

Task = Callable[[Callable[[int], None]], Any]
"""Reads something, and calls its argument with the number of row slots done."""


def run(label: str, tasks: Mapping[str, tuple[int, Task]], at_once: int | None = None) -> dict[str, Any]:
    """Run tasks, each with its row slots; return the result or SimulatorError of each. Another error ends all."""
    done = dict.fromkeys(tasks, 0)
    total = sum(slots for slots, _ in tasks.values())
    with progress.slots(label, total) as show, children.threads(at_once or len(tasks)) as pool:

        def one(name: str) -> Any:
            def on_slots(slots: int) -> None:
                done[name] = slots
                show(sum(done.values()), ", ".join(n for n in tasks if done[n] < tasks[n][0]))

            try:
                return tasks[name][1](on_slots)
            except SimulatorError as error:
                return error

        return dict(zip(tasks, pool.map(one, tasks), strict=True))
