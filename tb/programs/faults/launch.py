# SPDX-License-Identifier: Apache-2.0
"""Run the command line with changes: `python -m tb.programs.faults.launch CHANGE... -- WORDS`.

A CHANGE is `module:NAME=number`, a value of a module, or `module:NAME!n=FAULT`: the n-th call of a
function becomes `kill`, `term` or the name of an errno such as `ENOSPC`.
"""

from __future__ import annotations

import errno
import importlib
import itertools
import os
import signal
import sys
from typing import Any


def _fault_at(function: Any, number: int, fault: str) -> Any:
    calls = itertools.count(1)

    def call(*arguments: Any, **options: Any) -> Any:
        if next(calls) == number:
            if fault in ("kill", "term"):
                os.kill(os.getpid(), signal.Signals[f"SIG{fault.upper()}"])
            else:
                code = getattr(errno, fault)
                raise OSError(code, os.strerror(code), str(arguments[-1]))
        return function(*arguments, **options)

    return call


if __name__ == "__main__":
    split = sys.argv.index("--")
    for word in sys.argv[1:split]:
        name, _, value = word.partition("=")
        module, _, name = name.partition(":")
        name, _, number = name.partition("!")
        place = importlib.import_module(module)
        changed = _fault_at(getattr(place, name), int(number), value) if number else float(value)
        setattr(place, name, changed)
    sys.argv[1:] = sys.argv[split + 1 :]
    from dermis.__main__ import main

    main()
