# SPDX-License-Identifier: Apache-2.0
"""The errors a run may end with, and the exit code of each."""

import importlib
import importlib.metadata
import importlib.util
import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

# A value is quoted to be recognised, not to be read in full: one line must stay one line.
_VALUE_LENGTH = 60
EMPTY = '""'


def one_line(value: Any, length: int = _VALUE_LENGTH) -> str:
    """Show `value` on one line, without control characters, cut to `length`."""
    if isinstance(value, str):
        text = value
    else:
        try:
            text = repr(value)
        except (ValueError, RecursionError):  # an integer too long, a table too deep to print
            text = f"a {type(value).__name__} too large to print"
    # A value may be a whole file: only the part that is shown is examined. The address of an object says nothing.
    text = re.sub(r" at 0x[0-9a-f]+(?=>)", "", text[: 16 * length])
    text = "".join(c if c.isprintable() else " " for c in text)
    text = " ".join(text.split())
    return text if len(text) <= length else text[: length - 3] + "..."


def quoted(value: Any) -> Any:
    """Put text in quotes, as in a TOML file, and return anything else unchanged."""
    return f'"{one_line(value)}"' if isinstance(value, str) else value


def counted(number: int, noun: str, total: int | None = None) -> str:
    """Return a number with its noun: "1 frame", "3 frames", or "3 of 8 frames" for a part of a total."""
    part = "" if total in (None, number) else f"of {total} "
    return f"{number} {part}{noun}{'' if (total or number) == 1 else 's'}"


class DermisError(Exception):
    """A run that ends with a message instead of a result."""

    exit_code = 1


class InputError(DermisError):
    """Something the user wrote is wrong: one line "FILE: KEY = VALUE: ALLOWED".

    The file is "command line" for an option, the key a dotted name or the place in a table ("line 3, value 7").
    Text of a file must be `quoted` first; the last part is the allowed values, or the remedy.
    """

    exit_code = 2

    def __init__(self, file: Path | str, key: str, value: Any, allowed: str) -> None:
        self.file = str(file)
        self.key = key
        self.value = value
        self.allowed = allowed
        # Each part is visible, also a TOML key that is empty or has no printable character.
        parts = (self.file, 400), (key, 200), (value, _VALUE_LENGTH), (allowed, 1000)
        said = (one_line(part, length) or EMPTY for part, length in parts)
        super().__init__("{}: {} = {}: {}".format(*said))

    def __reduce__(self) -> tuple[Any, ...]:
        # An exception is rebuilt from its message alone, which would end the process that gets it from a worker.
        return type(self), (self.file, self.key, self.value, self.allowed)


def optional(module: str, extra: str) -> Any:
    """Import a module that only an extra of the package brings, or raise InputError, which names the extra."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name not in (module, module.partition(".")[0]):  # a defect inside it
            raise
        name = module.partition(".")[0]
        raise InputError("environment", name, "not installed", install_line(extra)) from None


def install_line(extra: str) -> str:
    """Return the command that installs the packages of an extra, by name: dermis itself is in no package index."""
    try:
        asked = importlib.metadata.requires("dermis") or []
    except importlib.metadata.PackageNotFoundError:  # a checkout on PYTHONPATH
        asked = []
    packages = [said.split(";")[0].strip() for said in asked if said.endswith(f"extra == '{extra}'")]
    if not packages:
        return f"install the packages of {extra} in pyproject.toml"
    return shlex.join([sys.executable, "-m", "pip", "install", *packages])


def package_directory(package: str, inside: str, remedy: str) -> Path:
    """Return the directory of an installed package; raise InputError if `inside` is not in it."""
    spec = importlib.util.find_spec(package)
    for place in (spec.submodule_search_locations or []) if spec is not None else []:
        if (Path(place) / inside).exists():
            return Path(place).resolve()  # .venv is a link if its path has a space
    raise InputError("environment", package, "not found", remedy)


def tool_path(name: str, what: str) -> str:
    """Return the path of a program; raise InputError if it is not on PATH."""
    if (found := shutil.which(name)) is None:
        raise InputError("PATH", name, "missing", f"{what}; `make setup` installs it")
    return found


class SimulatorError(DermisError):
    """A simulator failed: the step, with time and node if known, and its log."""

    exit_code = 3

    def __init__(self, what: str, log: Path | str | None = None) -> None:
        self.what = what
        self.log = None if log is None else str(log)
        super().__init__(what if log is None else f"{what} (log: {log})")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.what, self.log)
