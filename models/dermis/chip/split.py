# SPDX-License-Identifier: Apache-2.0
"""Several ngspice circuits as one analog half: a process each, all advanced from clock edge to clock edge.

ngspice keeps its circuit in global variables, and a circuit steps wherever any of its columns has
to; columns apart step by themselves, on as many cores as there are. They meet at every clock edge,
as the whole circuit would. Row drivers in transistors are a circuit too, whose rows the others have
as sources.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import wait
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.errors import SimulatorError
from dermis.lockstep.ngspice import Deck, Edge, NgspiceHalf
from dermis.processes import pool


class Workers(list[pool.Workers]):
    """Processes that solve a circuit each, one after another; they start when first asked for."""

    def first(self, count: int) -> list[pool.Workers]:
        """Return the first `count` workers."""
        self += [pool.Workers(1, pool.ONE_THREAD) for _ in range(len(self), count)]
        return self[:count]

    def close(self) -> None:
        """End all workers."""
        for worker in self:
            worker.shutdown(cancel_futures=True)
        self.clear()


# Smaller changes of a row's voltage do not reach the columns: 2e-6 of the bias, 1e-3 of a code at full scale.
STILL_V = 1e-6


class SplitHalf:
    """The circuits of some decks as one analog half (see dermis.lockstep.clock_loop.AnalogHalf).

    Parameters
    ----------
    decks : by the columns that each has; together all columns, each once. Without columns: the row drivers, whose
        probes are the rows; the rows of the others are then sources of these voltages
    rows : rows of the array; sources of every deck are rows, preset, and the charge switches of its columns
    workers : where they are solved
    log : of ngspice; each worker has its own, with its number in the name
    options : of NgspiceHalf

    Errors are those of NgspiceHalf, of several the first.
    """

    def __init__(
        self, decks: Mapping[tuple[int, ...], Deck], rows: int, workers: Workers, log: Path, **options: Any
    ) -> None:
        self._columns = [part for part in decks if part]
        self._shared = rows + 1
        # which circuit has a column's charge switch, and as which of its sources
        places = ((i, k, c) for i, part in enumerate(self._columns) for k, c in enumerate(part))
        self._place = {column: (i, self._shared + k) for i, k, column in places}
        all_ = workers.first(len(decks))
        self._workers, self._driver = all_[: len(self._columns)], all_[len(self._columns) :]
        self._sample = np.zeros(len(self._place))
        self._folder = log.parent
        self._now = self._driven = 0.0
        self._still = False
        self._row_v: list[float] = []

        def opening(index: int, deck: Deck) -> tuple[Any, ...]:
            return _open, deck, {**options, "log": log.with_name(f"{log.stem}_{index}{log.suffix}")}

        if self._driver:
            (self._row_v,) = self._ask(self._driver, [opening(len(self._columns), decks[()])])
            at = {part: (*self._row_v, *deck.levels[rows:]) for part, deck in decks.items()}
            decks = {part: replace(deck, levels=at[part]) for part, deck in decks.items()}
        self._ask(self._workers, [opening(i, decks[part]) for i, part in enumerate(self._columns)])

    def _ask(self, workers: Sequence[pool.Workers], calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Make a call in each process, and return the answers once all have come."""
        tasks = [worker.submit(*call) for worker, call in zip(workers, calls, strict=True)]
        wait(tasks)
        try:
            return [task.result() for task in tasks]
        except pool.WorkerLost as error:
            raise SimulatorError(f"of the analog side {error.what}", self._folder) from None

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to time `to` in seconds; return the comparators there, in volt, by column.

        As with NgspiceHalf it is a view that the next call overwrites.
        """
        mine: list[list[Edge]] = [[] for _ in self._workers]
        if self._driver:
            edges = [*self._drive(to, edges), *(edge for edge in edges if edge[1] >= self._shared - 1)]
        for time, source, level in edges:
            if source < self._shared:
                for some in mine:
                    some.append((time, source, level))
            else:
                part, index = self._place[source - self._shared]
                mine[part].append((time, index, level))
        samples = self._ask(self._workers, [(_do, "advance", to, some) for some in mine])
        for columns, sample in zip(self._columns, samples, strict=True):
            self._sample[list(columns)] = sample[: len(columns)]
        self._now = to
        return self._sample

    def _drive(self, to: float, edges: Sequence[Edge]) -> list[Edge]:
        """Solve the row drivers up to `to`; return the changes of their rows, from the last call's time on.

        Rows change during the preset, a hundred clocks before a gate, and settle in nanoseconds. So a ramp in place of
        their course does not change codes, and drivers at rest are not solved until a row is switched.
        """
        switched = [edge for edge in edges if edge[1] < self._shared - 1]
        if self._still and not switched:
            return []
        (row_v,) = self._ask(self._driver, [(_do, "advance", to, switched)])
        pairs = enumerate(zip(self._row_v, row_v, strict=True))
        moved = [(self._now, row, new) for row, (old, new) in pairs if abs(new - old) > STILL_V]
        for _, row, new in moved:
            self._row_v[row] = new
        self._driven, self._still = to, not moved and not switched
        return moved

    @property
    def statistics(self) -> dict[str, int]:
        """Sum of those of NgspiceHalf over all circuits."""
        children = [*self._workers, *self._driver]
        found = self._ask(children, [(_do, "statistics")] * len(children))
        return {name: sum(some[name] for some in found) for name in found[0]}

    def waveform(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Every circuit's record on the time points of all: straight lines between its own."""
        found = self._ask(self._workers, [(_do, "waveform")] * len(self._workers))
        time = np.unique(np.concatenate([t for t, _ in found]))
        return time, {name: np.interp(time, t, values) for t, some in found for name, values in some.items()}

    def close(self) -> None:
        """Release the circuits of this frame."""
        if self._driver and self._driven < self._now:
            self._ask(self._driver, [(_do, "advance", self._now, [])])
        children = [*self._workers, *self._driver]
        self._ask(children, [(_do, "close")] * len(children))


_half: NgspiceHalf
"""Circuit of this process; only workers have one."""


def _open(deck: Deck, options: Mapping[str, Any]) -> NDArray[np.float64]:
    global _half
    _half = NgspiceHalf(deck, **options)
    return _half.advance(0.0, [])


def _do(name: str, *arguments: Any) -> Any:
    """Call a method of the circuit, or read its attribute."""
    found = getattr(_half, name)
    return found(*arguments) if callable(found) else found
