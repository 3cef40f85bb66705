# SPDX-License-Identifier: Apache-2.0
"""A hard case, and the engines that must find its exact answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

LIMIT_S = 120.0
"""Time limit of a run; the slowest build, of Verilator, takes 20 s on an idle core."""


@dataclass(frozen=True)
class Measured:
    """Distance from the expected answer, in the unit of the case, and a remark.

    NaN, an infinite number or None makes an ERROR row.
    """

    error: float | None
    note: str = ""


@dataclass(frozen=True)
class Case:
    """A hard case.

    Parameters
    ----------
    name : str
        Its difficulty in lower snake case, such as ``between_two_codes``.
    group : str
        array or converter.
    runs : mapping
        Engine -> a module-level function, or a functools.partial of one, for a worker process.
    limit, unit : float, str
        |error| <= limit passes; the unit of both.
    limit_s : float
        Time limit of a run.
    short : bool
        Part of the short set, which `make test` runs; well under a second each.
    refused : mapping
        Engine -> reason why it cannot express the case.
    """

    name: str
    group: str
    runs: Mapping[str, Callable[[], Measured]]
    limit: float = 0.0
    unit: str = "lsb"
    limit_s: float = LIMIT_S
    short: bool = False
    refused: Mapping[str, str] = field(default_factory=dict)
