# SPDX-License-Identifier: Apache-2.0
"""What a hard case is: why it is hard, what its answer is and from where, and who has to find it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Measured:
    """What a run found.

    Parameters
    ----------
    error : float
        Distance from the expected answer, in the unit of the case. NaN, infinite or None makes an ERROR row.
    note : str
        What is worth knowing beyond it.
    seconds : float, optional
        Of the engine alone, where the run also works out what to compare with; default all of the run's.
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
        Lower snake case: what is hard, such as ``one_half_exactly``.
    group : str
        converter, array, circuit or stiff.
    why : str
        One sentence: why it is hard.
    expected : str
        The expected answer, in words or numbers.
    source : str
        The independent exact or high-precision source of it.
    tolerance : str
        The argument for `limit`.
    limit : float
        |error| <= limit passes.
    unit : str
        Of error and limit: lsb, 1, V, packets ...
    runs : mapping
        Engine or solver name -> a module-level function, or a functools.partial of one, so that a worker process can
        be given it. It returns Measured. An expected typed error is an answer as well: the run catches it and returns
        Measured(0.0), or 1.0 where it does not come or does not name its cause.
    limit_s : float
        Every run ends by then. Cases at transistor level may say more than 10 s.
    short : bool
        In the short set, which `make test` runs; well under a second each.
    refused : mapping
        Engine -> why it cannot express the case: a SKIP row.
    """

    name: str
    group: str
    why: str
    expected: str
    source: str
    tolerance: str
    limit: float
    unit: str
    runs: Mapping[str, Callable[[], Measured]]
    limit_s: float = 10.0
    short: bool = False
    refused: Mapping[str, str] = field(default_factory=dict)
