# SPDX-License-Identifier: Apache-2.0
"""Targets of hostile input: each draws inputs as bytes and runs one of them under the oracles."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis.strategies import SearchStrategy

_MODULES = {
    "scene": "scene",
    "frames": "frames",
    "spi": "spi",
    "registers": "spi",
    "design": "scene",
    "command": "commands",
}
NAMES = tuple(_MODULES)


@dataclass(frozen=True)
class Target:
    """A reader of outside input.

    Attributes
    ----------
    inputs : callable
        () -> strategy of bytes.
    prepare : callable
        Called once in a process with the directory of its inputs, before memory is limited.
    run : callable
        (data, directory) -> "taken" or "refused"; raises Finding.
    modules : tuple of str
        Modules whose covered lines are reported.
    end : callable
        Called at the end of the process.
    """

    inputs: Callable[[], SearchStrategy[bytes]]
    prepare: Callable[[Path], None]
    run: Callable[[bytes, Path], str]
    modules: tuple[str, ...]
    end: Callable[[], None] = lambda: None


def load(name: str) -> Target:
    """Import a target by name."""
    found: Target = importlib.import_module(f"tb.programs.fuzz.{_MODULES[name]}").TARGETS[name]
    return found
