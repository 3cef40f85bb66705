# SPDX-License-Identifier: Apache-2.0
"""A hard case, and the engines that must find its exact answer."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

LIMIT_S = 120.0  # time limit of a run; the slowest build, of Verilator, takes 20 s on an idle core


@dataclass(frozen=True)
class Measured:
    """Distance from the expected answer, in the unit of the case, and a remark.

    NaN, an infinite number or None makes an ERROR row.
    """

    error: float | None
    note: str = ""


@dataclass(frozen=True)
class Case:
    """A hard case of a group, array or converter, named by its difficulty; |error| <= `limit` passes.

    `runs` has, by engine, a picklable function for a worker process; `refused` the reason why an engine
    cannot express the case. A `short` one, well under a second, is part of the short set of `make test`.
    """

    name: str
    group: str
    runs: Mapping[str, Callable[[], Measured]]
    limit: float = 0.0
    unit: str = "lsb"
    limit_s: float = LIMIT_S
    short: bool = False
    refused: Mapping[str, str] = field(default_factory=dict)
