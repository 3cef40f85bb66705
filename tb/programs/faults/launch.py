# SPDX-License-Identifier: Apache-2.0
"""Runs the command line with a changed limit or a fault at a chosen call: `python -m ...launch SET... -- WORDS`.

A SET is `module:NAME=number`, a module's value for this run, or `module:NAME!n=FAULT`: the n-th call of that function
from the package becomes a fault, `kill`, `term` or the name of an errno such as `ENOSPC`.
"""

from __future__ import annotations

import errno
import importlib
import itertools
import os
import re
import signal
import sys
from typing import Any


def _fault_at(function: Any, number: int, fault: str) -> Any:
    calls = itertools.count(1)

    def call(*arguments: Any, **options: Any) -> Any:
        if next(calls) == number:
            if fault == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            elif fault == "term":
                os.kill(os.getpid(), signal.SIGTERM)
            else:
                code = getattr(errno, fault)
                raise OSError(code, os.strerror(code), str(arguments[-1]))
        return function(*arguments, **options)

    return call


def main(words: list[str]) -> None:
    """Change what is asked for, and run the command line."""
    split = words.index("--")
    for word in words[:split]:
        found = re.fullmatch(r"([\w.]+):(\w+)(?:!(\d+))?=([\w.]+)", word)
        if found is None:
            raise SystemExit(f"not a change: {word}")
        module, name, number, value = found.groups()
        place = importlib.import_module(module)
        if number is None:
            setattr(place, name, float(value))
        else:
            setattr(place, name, _fault_at(getattr(place, name), int(number), value))
    sys.argv[1:] = words[split + 1 :]
    from dermis.__main__ import main as command_line

    command_line()


if __name__ == "__main__":
    main(sys.argv[1:])
