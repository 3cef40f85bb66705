# SPDX-License-Identifier: Apache-2.0
"""Writes files whole or not at all, so that nothing half-written stays behind."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from dermis.errors import InputError


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write a file beside its target and move it there; text gets LF line ends on every system."""
    data = content.encode("utf-8") if isinstance(content, str) else content
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        # mkstemp makes files private; a result is as readable as any other file of this user.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_between(path: Path, begin: str, end: str, content: str) -> None:
    """Put text between two marks of a file, each on a line of its own.

    Raises
    ------
    InputError
        The marks are not there, once each and in this order.
    """
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise InputError(path, "table", "(its marks)", f"once each, in this order: {begin} {end}")
    head, rest = text.split(begin)
    write_atomic(path, f"{head}{begin}\n{content}\n{end}{rest.split(end)[1]}")
