# SPDX-License-Identifier: Apache-2.0
"""Machine code of the compiled loops, which numba keeps beside their sources."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

_IMPORT = re.compile(r"^from ([\w.]+) import (\([^)]*\)|[\w, ]+)", re.MULTILINE)


def drop_stale(package: Path) -> None:
    """Delete machine code that is older than a source with compiled loops, or than what these import.

    Numba compares a loop only with its own file, so it would go on with old machine code after a
    change in a function that the loop calls, or in a constant that it imports.
    """
    folders = [package, *(path for path in package.iterdir() if path.is_dir())]
    # An index is named after module, function and line.
    kept = {
        index: index.name.split(".")[0] for folder in folders for index in folder.glob("__pycache__/*.nbi")
    }
    sources = {index.parent.parent / f"{module}.py" for index, module in kept.items()}
    with contextlib.suppress(OSError):  # another process may be first, or the folder read-only
        for source in filter(Path.is_file, [*sources]):
            for module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
                place = package.parent.joinpath(*module.split("."))
                sources |= {place.with_suffix(".py"), *(place / f"{n}.py" for n in re.findall(r"\w+", names))}
        changed = max((path.stat().st_mtime for path in sources if path.is_file()), default=0.0)
        for index in kept:
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)
