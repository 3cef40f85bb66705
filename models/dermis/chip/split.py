# SPDX-License-Identifier: Apache-2.0
"""Several ngspice circuits as one analog half: a process each, all advanced from clock edge to
clock edge.

ngspice keeps its circuit in global variables, and a circuit steps wherever any of its columns has
to; columns apart step by themselves, on as many cores as there are. They meet at every clock edge,
as the whole circuit would. A worker is `python -m dermis.chip.split`: it takes pickled calls on its
standard input and ends with its caller.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
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
        Where what they print goes: `log` with their number in its name. A worker that ends leaves its reason there.
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


class SplitHalf:
    """The circuits of some decks as one analog half (see dermis.chip.analog.AnalogHalf).

    Parameters
    ----------
    decks : by the columns that each has; together all columns, each once
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
        self._columns = list(decks)
        self._shared = rows + 1
        # which circuit has a column's charge switch, and as which of its sources
        self._place = {
            column: (i, self._shared + k) for i, part in enumerate(decks) for k, column in enumerate(part)
        }
        self._workers = workers.first(len(decks))
        self._sample = np.zeros(len(self._place))
        self._log = workers.log_of(0)
        self._ask(
            [("open", deck, {**options, "log": workers.log_of(i)}) for i, deck in enumerate(decks.values())]
        )

    def _ask(self, messages: Sequence[Any]) -> list[Any]:
        """Send each circuit its message, and return the answers once all have come."""
        try:
            for child, message in zip(self._workers, messages, strict=True):
                send(child.stdin, message)
            answers = [receive(child.stdout) for child in self._workers]
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
        for time, source, level in edges:
            if source < self._shared:
                for some in mine:
                    some.append((time, source, level))
            else:
                part, index = self._place[source - self._shared]
                mine[part].append((time, index, level))
        samples = self._ask([("advance", to, some) for some in mine])
        for columns, sample in zip(self._columns, samples, strict=True):
            self._sample[list(columns)] = sample[: len(columns)]
        return self._sample

    @property
    def statistics(self) -> dict[str, int]:
        """Sum of those of NgspiceHalf over all circuits."""
        found = self._ask([("statistics",)] * len(self._workers))
        return {name: sum(some[name] for some in found) for name in found[0]}

    def waveform(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Every circuit's record on the time points of all: straight lines between its own."""
        found = self._ask([("waveform",)] * len(self._workers))
        time = np.unique(np.concatenate([t for t, _ in found]))
        return time, {name: np.interp(time, t, values) for t, some in found for name, values in some.items()}

    def close(self) -> None:
        """Release the circuits of this frame."""
        self._ask([("close",)] * len(self._workers))


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
                half.advance(0.0, [])
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
    # ngspice prints some words past its callbacks: they must not get between the answers.
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as to_caller:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        _serve(sys.stdin.buffer, to_caller)
