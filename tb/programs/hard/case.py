# SPDX-License-Identifier: Apache-2.0
"""Hard cases: the difficulty of each, its exact answer with source, and the engines that must find
it.

cases.toml has the text of each case by name, the code its runs. Text with computed numbers is in
the code.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Measured:
    """Result of a run.

    Parameters
    ----------
    error : float
        Distance from the expected answer, in the unit of the case. NaN, infinite or None makes an ERROR row.
    note : str
        Remark of the row.
    seconds : float, optional
        Time of the engine alone, if the run also computes its reference; default that of the run.
    """

    error: float
    note: str = ""
    seconds: float | None = None


@dataclass(frozen=True)
class Case:
    """A hard case.

    Parameters
    ----------
    name : str
        Lower snake case, such as ``one_half_exactly``.
    group : str
        converter, array, circuit or stiff.
    runs : mapping
        Engine or solver name -> a module-level function, or a functools.partial of one, for a worker process. It
        returns Measured. An expected error is an answer as well: Measured(0.0), or 1.0 if it does not come
        or does not name its cause.
    why, expected, source, tolerance : str
        Difficulty, answer, its independent exact source, and the reason for `limit`.
    limit, unit : float, str
        |error| <= limit passes; the unit of both.
    limit_s : float
        Time limit of a run.
    short : bool
        Part of the short set, which `make test` runs; well under a second each.
    refused : mapping
        Engine -> reason why it cannot express the case: a SKIP row.
    """

    name: str
    group: str
    runs: Mapping[str, Callable[[], Measured]]
    why: str
    expected: str
    source: str
    tolerance: str
    limit: float = 0.0
    unit: str = "lsb"
    limit_s: float = 10.0
    short: bool = False
    refused: Mapping[str, str] = field(default_factory=dict)


@functools.cache
def texts() -> dict[str, dict[str, str]]:
    """Return the text of each case by name."""
    return tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))


def case(group: str, name: str, runs: Mapping[str, Callable[[], Measured]], **other: Any) -> Case:
    """Return a case with its text from cases.toml; `other` has its other fields, and text that is
    computed.
    """
    return Case(name=name, group=group, runs=runs, **texts().get(name, {}), **other)
