# SPDX-License-Identifier: Apache-2.0
"""Machine code of the compiled loops, which numba keeps beside their sources."""

from __future__ import annotations

import contextlib
from pathlib import Path


def drop_stale(package: Path) -> None:
    """Delete machine code that is older than any source of a package.

    Numba compares a loop only with its own file, so it would go on with old machine code after a
    change in a function that the loop calls, or in a constant that it imports.
    """
    folders = [package, *(path for path in package.iterdir() if path.is_dir())]
    changed = max(path.stat().st_mtime for folder in folders for path in folder.glob("*.py"))
    for folder in folders:
        for index in folder.glob("__pycache__/*.nbi"):
            # Another process may be first, or the folder read-only.
            with contextlib.suppress(OSError):
                if index.stat().st_mtime < changed:
                    index.unlink()
