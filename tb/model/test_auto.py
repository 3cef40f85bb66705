# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: the codes of everything on from few walked cells, and its table."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import bounds, engines, records
from dermis import plan as planning
from dermis.effects import EFFECTS
from dermis.errors import InputError
from dermis.report.plan_table import print_answer, print_filter, print_plan
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from tb.programs import auto_check

TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": [2.0, 12.0], "width": 5, "length": 5}


def made(effects: dict[str, Any], engine: str | None = None, **more: Any) -> records.Plan:
    data = {"stimulus": TOUCH, "effects": effects} | more
    return planning.make(scene.from_data(data, Path("made.toml")), engine)


# --- the table -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_candidates_are_what_has_defaults_and_what_is_named(topology: str) -> None:
    interface = {"topology": topology}
    world = made({"auto": {}}, interface=interface).scene
    there = {e.name for e in EFFECTS.values() if topology in e.topologies}
    special = {name for name, effect in EFFECTS.items() if not effect.considered}
    assert {"motion", *(n for n in EFFECTS if n.startswith("sensor_"))} <= special
    missing = {"column_input"} if topology == "direct" else set()  # the direct interface has no conveyor
    assert set(world.effects) == there - special - missing
    assert set(scene.with_auto(made({}, interface=interface).scene).effects) == set(world.effects)
    named = made({"auto": {}, "motion": {}, "trace": False}, interface=interface).scene
    assert set(named.effects) == set(world.effects) - {"trace"} | {"motion"}


def test_every_effect_has_its_line_and_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    plan = made({"auto": {}, "trace": False})
    assert [e.name for e in plan.effects] == list(EFFECTS)
    assert all(e.reason for e in plan.effects)
    assert {e.name for e in plan.effects if e.on} == set(plan.scene.effects)
    print_plan(plan)
    print_filter(plan, engines.run(plan).info["filter"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in EFFECTS)
    assert "off (switched off): trace" in shown
    assert "by engine event with everything on" in shown
    assert "charge that the filter and engine event leave out" in shown


def test_plan_says_that_effects_change_codes_together(capsys: pytest.CaptureFixture[str]) -> None:
    on = {"comparator_hysteresis": {"v_v": 0.6}, "preset_error": {"v_v": -0.3}}
    stimulus = {"kind": "uniform", "force_n": 19.7 / 17}  # 0.3 LSB each, of 0.2 + 0.5 to the step below
    print_answer(made(on, array={"rows": 2, "cols": 3}, stimulus=stimulus))
    said = " ".join(capsys.readouterr().out.split())
    assert "change none of them: comparator_hysteresis, preset_error alone, but 6 together" in said
    assert "engine event is enough" in said


# --- the choice ----------------------------------------------------------------------------------------------------


@pytest.mark.paper
def test_the_cheapest_engine_that_can_is_chosen() -> None:
    assert made({"auto": {}}).engine == "event"
    assert made({"auto": {}}).filtered
    only = {e.name: False for e in EFFECTS.values() if e.bound is not bounds.honoured and e.considered}
    assert made({"auto": {}} | only).engine == "closed"
    assert made({}).engine == "closed"
    assert made({"mirror_lag": True}).engine == made({"lateral": True, "shot_noise": True}).engine == "event"
    assert made({"mirror_lag": True}, engine="closed").engine == "closed"
    assert made({"mirror_lag": True}, run={"engine": "rtl"}).engine == "rtl"
    assert made({"auto": {}}, engine="event").engine == "event"
    assert made({"auto": {}}, run={"engine": "event"}).engine == "event"


def test_what_an_engine_would_refuse_by_value_is_refused_before_the_run() -> None:
    effects = {"integrator_gain": {"gain_dc": 5}, "row_driver": {"r_ohm": 300}, "lateral": True}
    sheet = {"interface": {"topology": "direct"}, "stimulus": {"kind": "uniform", "code": 100}}
    for engine in ("event", "rtl"):
        with pytest.raises(InputError, match=r"here .*use engine cosim"):
            engines.check(made(effects, engine, **sheet))
    with pytest.raises(InputError, match=r"engine cosim$"):
        engines.check(made(effects, "closed", **sheet))
    assert made(effects, **sheet).engine == "cosim"
    weak = {"integrator_gain": True, "row_driver": True}
    with pytest.raises(InputError, match=r"engine event or rtl or cosim$"):
        engines.check(made(weak, "closed", **sheet))
    engines.check(made(weak, **sheet))


# --- random scenes -------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each scene runs once: nobody reads the times."""
    monkeypatch.setattr(auto_check, "REPEATS", 1)


def test_random_scenes_have_the_codes_of_everything_on(tmp_path: Path) -> None:
    outcomes, refused = auto_check.campaign(24, 11, 4)
    assert len(outcomes) + len(refused) == 24
    rows = {r["name"]: r for r in auto_check.rows(outcomes, [], refused)}
    assert rows["auto.wrong_codes"]["status"] == "PASS", rows["auto.wrong_codes"]
    assert rows["auto.conversions"]["value"] == sum(o.conversions for o in outcomes) > 10_000
    assert 0 < sum(o.walked for o in outcomes) < 0.3 * rows["auto.conversions"]["value"]


@pytest.mark.parametrize(
    "name", ["quarter_code_fingertip", "nonideal_channel", "two_fingers", "slipping_cylinder"]
)
def test_stored_scenes_have_the_codes_of_everything_on(name: str) -> None:
    world = scene.with_auto(scene.load(scene.find(name)))
    assert auto_check.compare(world, name).wrong == 0


@pytest.mark.parametrize("budget", [0.05, 0.5])
def test_a_budget_moves_codes_by_one_and_walks_less(budget: float) -> None:
    stimulus = {"kind": "ramp", "force_n": [0.0, 12.0], "frames": 30}
    loose = made({"auto": {"budget_lsb": budget}}, stimulus=stimulus)
    exact = made({"auto": {}}, stimulus=stimulus)
    result, everything = engines.run(loose), engines.run(exact)
    # A budget below 1 LSB moves a decision over one threshold at most.
    assert np.abs(result.codes.astype(int) - everything.codes).max() <= 1
    assert result.info["filter"]["everything"] < everything.info["filter"]["everything"]


def test_columns_that_move_each_other_are_walked_and_the_table_says_why() -> None:
    on = {"auto": {}, "lateral": {"r_ohm": 1e6}, "row_driver": False, "trace": False}
    sheet = {"array": {"rows": 2, "cols": 3}, "stimulus": {"kind": "uniform", "r_ohm": 2e3}}
    plan = made(on, interface={"topology": "direct"}, **sheet)
    found = engines.run(plan).info["filter"]
    assert found["everything"] == plan.resistance_ohm.size
    assert "move each other" in found["reason"]


# --- bounds ----------------------------------------------------------------------------------------------------------

SLOW = "comparator_noise"
BOUNDED = [pytest.param(n, marks=[pytest.mark.long] * (n == SLOW)) for n in auto_check.bounded_effects()]


@pytest.mark.parametrize("name", BOUNDED)
def test_a_bound_holds_where_a_halved_one_does_not(name: str) -> None:
    assert not any(auto_check.wrong(name, trial) for trial in range(8))
    trial = auto_check.caught(name)
    assert trial is not None
    assert not auto_check.wrong(name, trial)
