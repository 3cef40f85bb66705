# SPDX-License-Identifier: Apache-2.0
"""Put the markers of a list of wanted packages ("NAME; MARKER") back on the lines that `pip freeze` pins.

A package with a marker that was not installed here has no version to pin, and is an error: its line would be lost.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path


def _name(line: str) -> str:
    """The name of a package as all its spellings are compared."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s;=<>!~\[]", line.strip(), maxsplit=1)[0]).lower()


def kept(frozen: list[str], wanted: list[str]) -> list[str]:
    """Frozen lines with the markers of the wanted ones.

    Raises
    ------
    ValueError
        A package that is wanted with a marker is not among them.
    """
    markers = {_name(line): line.split(";", 1)[1].strip() for line in wanted if ";" in line}
    if lost := markers.keys() - {_name(line) for line in frozen}:
        raise ValueError(f"not installed by this Python on this machine: {', '.join(sorted(lost))}")
    return [f"{line}; {markers[_name(line)]}" if _name(line) in markers else line for line in frozen]


def main() -> int:
    """Filter standard input."""
    try:
        lines = kept(
            sys.stdin.read().splitlines(), Path(sys.argv[1]).read_text(encoding="utf-8").splitlines()
        )
    except ValueError as error:
        print(f"keep_markers: {error}", file=sys.stderr)
        return 2
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
