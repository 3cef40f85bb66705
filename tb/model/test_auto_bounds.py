# SPDX-License-Identifier: Apache-2.0
"""Bounds of the filter hold in scenes of one strong effect, and a bound of half the size does not."""

from __future__ import annotations

import pytest

from tb.programs import auto_bounds

FEW = 8
"""Scenes of an effect."""

LONG = ("comparator_noise", "integrator_gain")
"""Effects whose scenes, or whose search, take longest."""

SEARCHED = [
    pytest.param(name, marks=[pytest.mark.long] * (name in LONG))
    for name in auto_bounds.names()
    if name not in auto_bounds.LOOSE
]

NEVER = ("integrator_gain", *auto_bounds.LOOSE)
"""Bounds that are more than twice the largest error of any scene that was found (docs/auto.md)."""


@pytest.mark.parametrize("name", SEARCHED)
def test_a_bound_holds_where_a_halved_one_does_not(name: str) -> None:
    assert not any(auto_bounds.wrong(name, trial) for trial in range(FEW))
    if name in NEVER:
        return
    trial = auto_bounds.caught(name)
    assert trial is not None
    assert not auto_bounds.wrong(name, trial)


def test_bounds_that_are_never_caught_are_named() -> None:
    assert set(NEVER) <= set(auto_bounds.names())
    assert auto_bounds.caught("line_capacitance", 1) is None
