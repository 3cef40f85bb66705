# SPDX-License-Identifier: Apache-2.0
"""The contract of an engine (CONTRIBUTING.md): what `engines.run` and every report may rely on."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dermis import engines, plan
from dermis.array.array import Network
from dermis.converter.vfc import Converter
from dermis.engines import closed, event
from dermis.errors import InputError
from dermis.records import Drive, Plan
from dermis.scene import scene
from tb.reference import toy_engine

ENGINES = {"closed": closed, "event": event, "toy": toy_engine}


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Name of an engine, which is found as one of the package."""
    monkeypatch.setitem(sys.modules, f"dermis.engines.{request.param}", ENGINES[request.param])
    return request.param


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
    assert result.codes.dtype == engines.code_type(made.timing.code_max)
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


def test_it_lists_fields_that_there_are(engine: str) -> None:
    fields = {name for record in (Network, Converter, Drive) for name in record.__dataclass_fields__}
    assert engines.honours(engine) <= fields


def test_a_field_that_it_does_not_list_is_refused_by_name(engine: str) -> None:
    strange = varied(engine, {"comparator_noise": True})
    if "v_comp_noise_v" in engines.honours(engine):
        engines.check(strange)
        return
    with pytest.raises(InputError, match=r"effects\.comparator_noise"):
        engines.check(strange)


@pytest.mark.parametrize("fault", ["late", "shape", "claims"])
def test_the_contract_notices_an_engine_that_breaks_it(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = ModuleType("dermis.engines.broken")
    broken.HONOURS = toy_engine.HONOURS | ({"packet_error"} if fault == "claims" else set())  # type: ignore[attr-defined]

    def run(plan: Plan, progress: object = None) -> engines.Result:
        result = toy_engine.run(plan)
        codes = {"late": np.maximum(result.codes, 1) - 1, "shape": result.codes[:, 0]}.get(
            fault, result.codes
        )
        return engines.Result(codes)

    broken.run = run  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "dermis.engines.broken", broken)
    made = varied("broken", {"charge_packet": {"packet_error": 0.05}} if fault == "claims" else DRIVERS)
    expected = closed.run(made).codes
    assert not np.array_equal(engines.run(made).codes, expected)


def test_the_engine_to_copy_from_is_short() -> None:
    lines = Path(toy_engine.__file__).read_text(encoding="utf-8").splitlines()
    assert len(lines) < 80
