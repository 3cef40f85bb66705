# SPDX-License-Identifier: Apache-2.0
"""What a long run has finished, piece by piece, in a file that a killed run goes on from."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from dermis.files import write_atomic

_SAVE_S = 5.0
"""What a kill may lose: pieces come many a second, and writing all of them takes some milliseconds."""


class Kept:
    """Pieces by name, each something that JSON can say.

    Parameters
    ----------
    path : Path
        Of the file; another process that reads it sees it whole.
    stamp : str
        Of all that the pieces depend on, such as `batch.fingerprint()`: a file of another stamp counts for nothing.
    fresh : bool
        Do not take up what an earlier run left.

    Attributes
    ----------
    pieces : dict
    """

    def __init__(self, path: Path, stamp: str, *, fresh: bool = False) -> None:
        self.path, self.stamp = path, stamp
        self.pieces: dict[str, Any] = {} if fresh else self._left()
        self._saved = time.monotonic()

    def _left(self) -> dict[str, Any]:
        try:
            told = json.loads(self.path.read_text(encoding="utf-8"))
            return dict(told["pieces"]) if told["stamp"] == self.stamp else {}
        except (OSError, ValueError, KeyError, TypeError):  # none there, or one of another version
            return {}

    def put(self, name: str, piece: Any, *, now: bool = True) -> None:
        """Take a piece; it is in the file at once, or with others within seconds (the last ones: `save`)."""
        self.pieces[name] = piece
        if now or time.monotonic() - self._saved > _SAVE_S:
            self.save()

    def save(self) -> None:
        """Write the file, whole or not at all."""
        write_atomic(self.path, json.dumps({"stamp": self.stamp, "pieces": self.pieces}))
        self._saved = time.monotonic()
