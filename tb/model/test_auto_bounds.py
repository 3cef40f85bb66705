# SPDX-License-Identifier: Apache-2.0
"""Bounds of the filter hold in scenes of one strong effect, and a bound of half the size does not."""

from __future__ import annotations

import pytest

from tb.programs import auto_bounds

FEW = 8
"""Scenes of an effect."""

LONG = ("comparator_noise",)
"""Effects whose scenes, or whose search, take longest."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in auto_bounds.names()]
)
def test_a_bound_holds_where_a_halved_one_does_not(name: str) -> None:
    assert not any(auto_bounds.wrong(name, trial) for trial in range(FEW))
    trial = auto_bounds.caught(name)
    assert trial is not None
    assert not auto_bounds.wrong(name, trial)
