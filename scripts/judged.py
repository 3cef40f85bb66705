# SPDX-License-Identifier: Apache-2.0
"""Parts of every command that judges: its tools, and the verdict table at its end."""

import contextlib
import hashlib
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from dermis.errors import InputError, SimulatorError, one_line
from dermis.report import verdict

SHOW = {"show_default": True}
"""Settings of the commands."""


def number(name: str, default: int | None, help: str, low: int | None = 0, high: int | None = None) -> Any:
    """Return an option of a command that is a whole number, with its default in the help."""
    return click.option(name, default=default, show_default=True, type=click.IntRange(low, high), help=help)


def tool(name: str, package: str | None = None, remedy: str | None = None) -> str:
    """Return the path of a program, next to this Python or on PATH; InputError if it is not installed."""
    found = shutil.which(Path(sys.executable).with_name(name)) or shutil.which(name)
    if found is None:
        remedy = remedy or f"Debian package {package or name} (make setup installs it)"
        raise InputError("environment", name, "not found", remedy)
    return found


def digest(files: Iterable[Path], *words: object) -> str:
    """Return a hash of files by name and content, and of what else a result depends on."""
    text = hashlib.sha256(repr(words).encode())
    for path in files:
        text.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return text.hexdigest()


@contextlib.contextmanager
def attempt(rows: list[verdict.Row], name: str) -> Iterator[None]:
    """Add an ERROR row for a failure of a tool in the block."""
    try:
        yield
    except SimulatorError as error:
        rows.append(verdict.error(name, one_line(str(error), 300)))


def none(name: str, found: Sequence[str], unit: str) -> verdict.Row:
    """Judge that there are no findings; the first ones are in the note."""
    return verdict.within(name, len(found), unit, None, 0, "; ".join(found[:5]))


def finish(name: str, rows: Sequence[verdict.Row], title: str) -> int:
    """Write the rows to build/<name>.json, print them, and return the exit code."""
    verdict.write_rows(name, rows)
    verdict.print_rows(rows, title)
    return verdict.exit_code(rows)
