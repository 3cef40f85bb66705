# SPDX-License-Identifier: Apache-2.0
"""The errors a run may end with, and the exit code of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# A value is quoted to be recognised, not to be read in full: one line must stay one line.
_VALUE_LENGTH = 60


def one_line(value: Any, length: int = _VALUE_LENGTH) -> str:
    """Show `value` on one line, without control characters, cut to `length`."""
    if isinstance(value, str):
        text = value
    else:
        try:
            text = repr(value)
        except ValueError:  # an integer too long to print
            text = f"a {type(value).__name__} too long to print"
    text = "".join(c if c.isprintable() else " " for c in text)
    text = " ".join(text.split())
    return text if len(text) <= length else text[: length - 3] + "..."


def quoted(value: Any) -> Any:
    """Put text in quotes, as it stands in a TOML file, and leave everything else alone."""
    return f'"{one_line(value)}"' if isinstance(value, str) else value


class DermisError(Exception):
    """A run that ends with a message instead of a result."""

    exit_code = 1


class InputError(DermisError):
    """Something the user wrote is wrong.

    Parameters
    ----------
    file : path or str
        Where it stands; "command line" for an option.
    key : str
        Dotted name, or the place in a table ("line 3, value 7").
    value : object
        What was found there; text is shown as it is, so quote it first where it stands for text in a file.
    allowed : str
        What may stand there.
    """

    exit_code = 2

    def __init__(self, file: Path | str, key: str, value: Any, allowed: str) -> None:
        self.file = str(file)
        self.key = key
        self.value = value
        self.allowed = allowed
        super().__init__(
            f"{one_line(self.file, 400)}: {one_line(key, 200)} = {one_line(value)}: {one_line(allowed, 1000)}"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # An exception is rebuilt from its message alone, which would end the process that gets it from a worker.
        return type(self), (self.file, self.key, self.value, self.allowed)


class SimulatorError(DermisError):
    """A simulator failed.

    Parameters
    ----------
    what : str
        What it was doing, with the time and node where they are known.
    log : path or str, optional
        Where its log is.
    """

    exit_code = 3

    def __init__(self, what: str, log: Path | str | None = None) -> None:
        self.what = what
        self.log = None if log is None else str(log)
        super().__init__(what if log is None else f"{what} (log: {log})")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.what, self.log)
