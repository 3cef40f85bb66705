# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of long runs: finished pieces in a file from which a killed run continues."""

import contextlib
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dermis.engines import batch
from dermis.files import write_atomic
from scripts import judged, workers

# Work that a kill may lose, in s: many pieces end in a second, and writing them takes milliseconds.
_SAVE_S = 5.0


def stamp(*folders: Path) -> str:
    """Return a hash of all sources that affect codes, and of the Python files below some folders."""
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    return judged.digest(files, batch.fingerprint())


class Checkpoint:
    """Pieces by name, each a value that JSON can hold, in a file that is never half written.

    A file with another `stamp`, the hash of everything that the pieces depend on, is ignored, as is
    any with `fresh`.
    """

    def __init__(self, path: Path, stamp: str, *, fresh: bool = False) -> None:
        self.path, self.stamp = path, stamp
        self.pieces: dict[str, Any] = {}
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # missing, or of another version
            stored = json.loads(path.read_text(encoding="utf-8"))
            if stored["stamp"] == stamp and not fresh:
                self.pieces = dict(stored["pieces"])
        self._saved = time.monotonic()

    def put(self, name: str, piece: Any, *, now: bool = True) -> None:
        """Add a piece and write the file, now or with others within seconds (the last ones: `save`)."""
        self.pieces[name] = piece
        if now or time.monotonic() - self._saved > _SAVE_S:
            self.save()

    def save(self) -> None:
        write_atomic(self.path, json.dumps({"stamp": self.stamp, "pieces": self.pieces}))
        self._saved = time.monotonic()

    def run(
        self,
        tasks: Mapping[str, workers.Task],
        processes: int,
        tell: Callable[[int, str], None] = lambda done, name: None,
        *,
        fresh: bool = False,
    ) -> dict[str, str]:
        """Run the tasks that have no piece yet in worker processes and store their values.

        `tell` is called with the number of tasks that have ended and the name of the last one; `fresh` gives
        each a new process. Returns name -> fault of each task that failed; it has no piece.
        """
        todo = [name for name in tasks if name not in self.pieces]
        faults = {}
        try:
            ended = workers.run((tasks[name] for name in todo), processes, fresh=fresh)
            for done, (number, outcome) in enumerate(ended, len(tasks) - len(todo) + 1):
                if outcome.fault:
                    faults[todo[number]] = outcome.fault
                else:
                    self.put(todo[number], outcome.value, now=False)
                tell(done, todo[number])
        finally:
            if todo:
                self.save()
        return faults
