# SPDX-License-Identifier: Apache-2.0
"""Several ngspice circuits as one analog half: a process each, all advanced from clock edge to
clock edge.

ngspice keeps its circuit in global variables, and a circuit steps wherever any of its columns has
to; columns apart step by themselves, on as many cores as there are. They meet at every clock edge,
as the whole circuit would. Row drivers in transistors are a circuit too, whose rows the others have
as sources. A worker is `python -m dermis.chip.split`: it takes pickled calls on its
standard input and ends with its caller.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip import ladder
from dermis.chip.analog import Edge
from dermis.chip.ngspice import Deck, NgspiceHalf
from dermis.errors import SimulatorError
from dermis.processes.children import Child
from dermis.processes.pool import ONE_THREAD, receive, send


class Workers:
    """Processes that solve a circuit each, one after another; they start when first asked for.

    Parameters
    ----------
    log : Path
        File of their output, with their number in its name; a worker that ends leaves its reason there.
    """

    def __init__(self, log: Path) -> None:
        self._log = log
        self._running: list[Child] = []

    def log_of(self, index: int) -> Path:
        """Return the log of ngspice in a worker."""
        return self._log.with_name(f"{self._log.stem}_{index}{self._log.suffix}")

    def first(self, count: int) -> list[Child]:
        """Return the first `count` workers; start the missing ones."""
        while len(self._running) < count:
            console = self.log_of(len(self._running)).with_suffix(".console")
            with console.open("wb") as stream:
                child = Child(
                    [sys.executable, "-m", "dermis.chip.split"],
                    ONE_THREAD,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=stream,
                )
            self._running.append(child)
        return self._running[:count]

    def close(self) -> None:
        """End all workers."""
        for child in self._running:
            child.end()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    pipe.close()
        self._running.clear()


# Smaller changes of a row's voltage do not reach the columns: 2e-6 of the bias, 1e-3 of a code at full scale.
STILL_V = 1e-6


class SplitHalf:
    """The circuits of some decks as one analog half (see dermis.chip.analog.AnalogHalf).

    Parameters
    ----------
    decks : by the columns that each has; together all columns, each once. Without columns: the row drivers, whose
        probes are the rows; the rows of the others are then sources of these voltages
    rows : rows of the array; sources of every deck are rows, preset, and the charge switches of its columns
    workers : where they are solved
    options : of NgspiceHalf, but for its log

    Raises
    ------
    SimulatorError, ladder.Abort
        As NgspiceHalf; of several the first.
    """

    def __init__(
        self, decks: Mapping[tuple[int, ...], Deck], rows: int, workers: Workers, **options: Any
    ) -> None:
        self._columns = [part for part in decks if part]
        self._shared = rows + 1
        # which circuit has a column's charge switch, and as which of its sources
        self._place = {
            column: (i, self._shared + k)
            for i, part in enumerate(self._columns)
            for k, column in enumerate(part)
        }
        all_ = workers.first(len(decks))
        self._workers, self._driver = all_[: len(self._columns)], all_[len(self._columns) :]
        self._sample = np.zeros(len(self._place))
        self._log = workers.log_of(0)
        self._now = self._driven = 0.0
        self._still = False
        self._row_v: list[float] = []

        def opening(index: int, deck: Deck) -> Any:
            return "open", deck, {**options, "log": workers.log_of(index)}

        if self._driver:
            (self._row_v,) = self._ask(self._driver, [opening(len(self._columns), decks[()])])
            decks = {
                part: replace(deck, levels=(*self._row_v, *deck.levels[rows:]))
                for part, deck in decks.items()
                if part
            }
        self._ask(self._workers, [opening(i, decks[part]) for i, part in enumerate(self._columns)])

    def _ask(self, children: Sequence[Child], messages: Sequence[Any]) -> list[Any]:
        """Send each circuit its message, and return the answers once all have come."""
        try:
            for child, message in zip(children, messages, strict=True):
                send(child.stdin, message)
            answers = [receive(child.stdout) for child in children]
        except (OSError, EOFError):
            raise SimulatorError("a process of the analog side ended", self._log.parent) from None
        for answer in answers:
            if isinstance(answer, Exception):
                raise answer
        return answers

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
        samples = self._ask(self._workers, [("advance", to, some) for some in mine])
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
        (row_v,) = self._ask(self._driver, [("advance", to, switched)])
        moved = [
            (self._now, row, new)
            for row, (old, new) in enumerate(zip(self._row_v, row_v, strict=True))
            if abs(new - old) > STILL_V
        ]
        for _, row, new in moved:
            self._row_v[row] = new
        self._driven, self._still = to, not moved and not switched
        return moved

    @property
    def statistics(self) -> dict[str, int]:
        """Sum of those of NgspiceHalf over all circuits."""
        children = [*self._workers, *self._driver]
        found = self._ask(children, [("statistics",)] * len(children))
        return {name: sum(some[name] for some in found) for name in found[0]}

    def waveform(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Every circuit's record on the time points of all: straight lines between its own."""
        found = self._ask(self._workers, [("waveform",)] * len(self._workers))
        time = np.unique(np.concatenate([t for t, _ in found]))
        return time, {name: np.interp(time, t, values) for t, some in found for name, values in some.items()}

    def close(self) -> None:
        """Release the circuits of this frame."""
        if self._driver and self._driven < self._now:
            self._ask(self._driver, [("advance", self._now, [])])
        children = [*self._workers, *self._driver]
        self._ask(children, [("close",)] * len(children))


def _serve(calls: IO[bytes], answers: IO[bytes]) -> None:
    """Answer the calls of a SplitHalf until it ends."""
    half: NgspiceHalf | None = None
    while True:
        try:
            call, *arguments = receive(calls)
        except EOFError:
            return
        try:
            answer: Any = None
            if call == "open":
                deck, options = arguments
                half = NgspiceHalf(deck, **options)
                answer = half.advance(0.0, []).tolist()
            elif half is None:
                raise SimulatorError(f"{call} without a circuit")
            elif call == "advance":
                answer = half.advance(*arguments).tolist()
            elif call == "statistics":
                answer = half.statistics
            elif call == "waveform":
                answer = half.waveform()
            else:
                half.close()
                half = None
        except (SimulatorError, ladder.Abort) as error:
            answer = error
        send(answers, answer)


if __name__ == "__main__":
    # ngspice prints some lines itself: they must not mix with the answers.
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as to_caller:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        _serve(sys.stdin.buffer, to_caller)
