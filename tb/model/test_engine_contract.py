# SPDX-License-Identifier: Apache-2.0
"""The contract of an engine (CONTRIBUTING.md): what `engines.run` and every report may rely on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dermis import engines, plan
from dermis.converter.vfc import code_type
from dermis.engines import closed
from dermis.records import Plan
from dermis.scene import scene

ENGINES = "closed", "event"
pytestmark = pytest.mark.parametrize("engine", ENGINES)


def make(engine: str, effects: dict[str, object] | None = None, **stimulus: object) -> Plan:
    """A plan of three even frames, or of another uniform stimulus."""
    table = {"kind": "uniform", **(stimulus or {"code": [3, 99, 254]})}
    data = {"array": {"rows": 3, "cols": 5}, "stimulus": table, "effects": effects or {}}
    return replace(plan.make(scene.from_data(data, Path("scene")), "closed"), engine=engine)


def varied(engine: str, effects: dict[str, object] | None = None) -> Plan:
    """A plan in which every taxel has a resistance of its own."""
    made = make(engine, effects)
    ohm = np.random.default_rng(5).uniform(450.0, 60e3, made.resistance_ohm.shape)
    return replace(made, resistance_ohm=ohm, force_n=None)


DRIVERS = {"row_driver": {"r_ohm": 30.0}, "column_input": {"r_ohm": 10.0}}


def test_it_returns_codes_of_the_plan(engine: str) -> None:
    made = varied(engine, DRIVERS)
    slots: list[int] = []
    result = engines.run(made, slots.append)
    assert isinstance(result, engines.Result)
    assert result.codes.shape == made.resistance_ohm.shape
    assert result.codes.dtype == code_type(made.timing.code_max)
    assert result.codes.max() <= made.timing.code_max
    assert slots == sorted(slots)
    assert slots[-1] == made.frames * made.rows


def test_it_agrees_with_the_formula(engine: str) -> None:
    for effects in ({}, DRIVERS):
        made = varied(engine, effects)
        expected = closed.run(made).codes
        assert expected.std() > 10
        assert np.array_equal(engines.run(made).codes, expected)


def test_every_code_a_short_and_an_open_taxel(engine: str) -> None:
    made = make(engine, code=list(range(256)))
    assert (engines.run(made).codes == np.arange(256)[:, None, None]).all()
    ends = make(engine, r_ohm=[0.0, float("inf")])
    assert engines.run(ends).codes[:, 0, 0].tolist() == [made.timing.code_max, 0]


def test_a_part_of_a_run_has_its_codes(engine: str) -> None:
    made = varied(engine, DRIVERS)
    whole = engines.run(made).codes
    parts = [engines.run(made.part(n, n + 1)).codes for n in range(made.frames)]
    assert np.array_equal(np.concatenate(parts), whole)


def test_it_changes_nothing_and_repeats(engine: str) -> None:
    made = varied(engine, DRIVERS)
    before = made.resistance_ohm.copy()
    first = engines.run(made)
    assert np.array_equal(engines.run(made).codes, first.codes)
    assert np.array_equal(made.resistance_ohm, before)
