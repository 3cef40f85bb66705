# SPDX-License-Identifier: Apache-2.0
"""Writes files whole or not at all."""

import contextlib
import errno
import fcntl
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from dermis.errors import InputError
from dermis.places import BUILD

_NO_LOCKS = (errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOTSUP)
"""Error codes of network file systems, some of them for directories alone."""


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file that becomes `path` at the end of the block; after an error it is gone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    # The system takes the user's mask off: to ask for that mask is to set it, for every thread of the process.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)  # a write does not say where
        raise


def check_place(path: Path, option: str) -> None:
    """Raise InputError if the file of an option is a directory, or its directory is not there or cannot be written."""
    with contextlib.suppress(OSError), tempfile.TemporaryFile(dir=path.parent):  # it is refused below
        if not path.is_dir():
            return
    allowed = "a file in a directory that is there and can be written"
    raise InputError("command line", option, str(path), allowed)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all; text gets LF line ends on every system."""
    with atomic(path) as file:
        file.write(content.encode("utf-8") if isinstance(content, str) else content)


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[int | None]:
    """Hold a file, or a directory, for this process alone; give its handle, or None if another one has it.

    The lock ends with the process, however that ends. A file that is not there is made. On a file
    system without locks everybody has it at once.
    """
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT
    handle = os.open(path, flags | os.O_CLOEXEC, 0o666)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError as error:
            if error.errno == errno.EWOULDBLOCK:
                yield None
                return
            if error.errno not in _NO_LOCKS:
                raise
        yield handle
    finally:
        os.close(handle)


def text_of(path: Path, allowed: str) -> str:
    """Read a text file that somebody else made; raise InputError if it is not there, cannot be read or is no text."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(path, "file", error.strerror or str(error), allowed) from None
    except UnicodeDecodeError as error:
        raise InputError(path, f"byte {error.start}", "no text", allowed) from None


def write_between(path: Path, begin: str, end: str, content: str) -> None:
    """Put text between two marks of a file, each on a line of its own; a file of build/ gets its marks here.

    Raises InputError as `between` does.
    """
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    if path.is_relative_to(BUILD) and begin not in text and end not in text:
        text += f"{begin}\n{end}\n"
    write_atomic(path, between(text, begin, end, content, path, "table"))


def between(text: str, begin: str, end: str, content: str, file: Path | str, key: str) -> str:
    """Return a text with other content between two marks, each on a line of its own.

    Raises InputError with `file` and `key` if the marks are not there, once each and in this order.
    """
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise InputError(file, key, "(its marks)", f"once each, in this order: {begin} {end}")
    head, rest = text.split(begin)
    return f"{head}{begin}\n{content}\n{end}{rest.split(end)[1]}"
