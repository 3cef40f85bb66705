# SPDX-License-Identifier: Apache-2.0
"""Hard cases, each with an exact answer, a tolerance with its reason, and every engine that can
express it.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from types import ModuleType

from tb.programs.hard.case import Case, Measured

__all__ = ["MODULES", "Case", "Measured", "all_cases", "modules"]

MODULES = ("converter", "networks", "circuits", "stiff")
"""Modules of this package that have cases, in the order of the table.

Each has `cases()`, and, where something has to be compiled before its cases run, `prepare(cases)`.
"""


def modules() -> Iterator[ModuleType]:
    """Yield the modules that have cases."""
    for name in MODULES:
        yield importlib.import_module(f"{__name__}.{name}")


def all_cases() -> list[Case]:
    """Return every case of every module.

    Raises
    ------
    ValueError
        Two cases have the same name.
    """
    found: dict[str, Case] = {}
    for module in modules():
        for case in module.cases():
            if case.name in found:
                raise ValueError(f"two hard cases are named {case.name}")
            found[case.name] = case
    return list(found.values())
