# SPDX-License-Identifier: Apache-2.0
"""Machine code of the compiled loops, which numba keeps beside their sources."""

import contextlib
import functools
import re
import sys
import threading
import time
from pathlib import Path
from typing import Any

_IMPORT = re.compile(r"^from ([\w.]+) import (\([^)]*\)|[\w, ]+)", re.MULTILINE)


QUIET_S = 2.0
"""Compilation that takes less says nothing, unless standard error is a terminal."""
AGAIN_S = 10.0


def argument(values: Any, name: str, shape: tuple[int | None, ...], least: float | None = None) -> Any:
    """Return values as an array that a compiled loop may read: contiguous, finite doubles of a shape; None is any size.

    Raises ValueError for another shape, no real numbers, not finite, or below `least`.
    """
    import numpy as np

    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be real numbers, not {array.dtype}")
    if len(shape) != array.ndim or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} must be [{wanted}], not {list(array.shape)}")
    array = np.ascontiguousarray(array, dtype=float)
    if not np.isfinite(array).all() or (least is not None and array.size and array.min() < least):
        raise ValueError(f"{name} must be finite" + ("" if least is None else f" and {least:g} or above"))
    return array


def announce() -> None:
    """Say on standard error that numba compiles loops, if it has to, and how far it is.

    Machine code that numba kept from an earlier run is loaded without a word.
    """
    # multiprocessing is loaded only where there are workers; those say nothing.
    workers = sys.modules.get("multiprocessing.process")
    if "numba" in sys.modules and (workers is None or workers.parent_process() is None):
        _listen()


@functools.cache
def _listen() -> None:
    from numba.core import event

    class Progress(event.Listener):
        loops, open, begin, next_s = 0, 0, 0.0, 0.0 if sys.stderr.isatty() else QUIET_S
        lock = threading.Lock()

        def on_start(self, _: Any) -> None:
            self.open += 1
            if not self.begin:
                self.begin = time.monotonic()
                # A single loop may take longer than that on a busy machine.
                timer = threading.Timer(QUIET_S, lambda: self.open and self.say())
                timer.daemon = True
                timer.start()
            self.say()

        def on_end(self, _: Any) -> None:
            self.open -= 1
            self.loops += 1
            self.say()

        def say(self) -> None:
            with self.lock:
                if (spent := time.monotonic() - self.begin) < self.next_s:
                    return
                words = f"{self.loops} loops in {spent:.0f} s"
                if self.next_s < AGAIN_S:  # the first line
                    # Measured on a core of an AMD EPYC: simulate 9 s, Skin 16 s, noise and moving currents 48 s.
                    words = "about 10 to 50 s, by the effects"
                print(f"compiling once for this processor: {words}", file=sys.stderr, flush=True)
                self.next_s = spent + AGAIN_S

    event.register("numba:compile", Progress())


def drop_stale(package: Path) -> None:
    """Delete machine code that is older than a source with compiled loops, or than what these import.

    Numba compares a loop only with its own file, so it would go on with old machine code after a
    change in a function that the loop calls, or in a constant that it imports.
    """
    folders = [package, *(path for path in package.iterdir() if path.is_dir())]
    # An index is named after module, function and line.
    kept = [index for folder in folders for index in folder.glob("__pycache__/*.nbi")]
    sources = {index.parent.parent / f"{index.name.split('.')[0]}.py" for index in kept}
    with contextlib.suppress(OSError):  # another process may be first, or the folder read-only
        for source in filter(Path.is_file, [*sources]):
            for module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
                place = package.parent.joinpath(*module.split("."))
                sources |= {place.with_suffix(".py"), *(place / f"{n}.py" for n in re.findall(r"\w+", names))}
        changed = max((path.stat().st_mtime for path in sources if path.is_file()), default=0.0)
        for index in kept:
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)
