# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: what it leaves out, what it leaves no trace of, and that its certified codes hold."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import auto, bounds, engines, records
from dermis import plan as planning
from dermis.effects import EFFECTS, AutoTable
from dermis.engines import certificate
from dermis.errors import InputError
from dermis.report.plan_table import print_plan
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from tb.programs import auto_check

TOUCH = {"kind": "indenter", "shape": "spherical", "force_n": [2.0, 12.0], "width": 5, "length": 5}


def made(effects: dict[str, Any], engine: str | None = None, **more: Any) -> records.Plan:
    data = {"stimulus": TOUCH, "effects": effects} | more
    return planning.make(scene.from_data(data, Path("made.toml")), engine)


def certified(plan: records.Plan) -> engines.Result:
    return certificate.certify(plan, engines.run(plan))


def on(plan: records.Plan) -> set[str]:
    return {e.name for e in plan.effects if e.on}


# --- the table -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("auto = { budget_lsb = -0.1 }", "effects.auto.budget_lsb"),
        ("auto = { budget_lsb = inf }", "effects.auto.budget_lsb"),
        ("auto = { sigma = 0.0 }", "effects.auto.sigma"),
        ("auto = { budget = 0.25 }", "effects.auto.budget"),
        ("auto = true", "effects.auto"),
    ],
)
def test_wrong_settings_are_one_line(text: str, key: str) -> None:
    data = tomllib.loads(f'[stimulus]\nkind = "uniform"\ncode = 1\n[effects]\n{text}\n')
    with pytest.raises(InputError) as caught:
        scene.from_data(data, Path("made.toml"))
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_candidates_are_what_has_defaults_and_what_is_named(topology: str) -> None:
    interface = {"topology": topology}
    world = made({"auto": {}}, interface=interface).scene
    there = {e.name for e in EFFECTS.values() if topology in e.topologies}
    special = {"motion", *(n for n in EFFECTS if n.startswith("sensor_"))}
    missing = {"column_input"} if topology == "direct" else set()  # the direct interface has no conveyor
    assert set(world.effects) == there - special - missing
    assert set(auto.candidates(made({}, interface=interface).scene)) == set(world.effects)
    named = made({"auto": {}, "motion": {}, "trace": False}, interface=interface).scene
    assert set(named.effects) == set(world.effects) - {"trace"} | {"motion"}


def test_every_effect_has_its_line_and_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    plan = made({"auto": {}, "trace": False})
    assert [e.name for e in plan.effects] == list(EFFECTS)
    assert all(e.reason for e in plan.effects)
    assert {e.name for e in plan.effects if e.bound_lsb is not None} == set(plan.scene.effects)
    print_plan(plan)
    shown = capsys.readouterr().out
    assert all(name in shown for name in EFFECTS)
    assert "trace (switched off)" in shown


# --- the choice ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("budget", [0.0, 0.05, 0.25, 2.0, 1000.0])
def test_what_is_left_out_stays_within_the_budget(budget: float) -> None:
    plan = made({"auto": {"budget_lsb": budget}})
    assert plan.left_out_lsb <= budget
    out = set(plan.scene.effects) - on(plan)
    weighing = auto._Weighing(planning.whole(plan.scene, None), AutoTable(budget_lsb=budget))
    assert plan.left_out_lsb == weighing.off(out) >= weighing.margin(out).max()
    for name in on(plan):  # not one more would fit
        assert not weighing.fits(out | {name}, budget)
    if budget == 0.0:
        assert all(e.bound_lsb == 0.0 for e in plan.effects if e.name in out)


def test_every_process_plans_alike() -> None:
    """To the last digit: sets come in another order in every process, and a sum of floats follows its order."""
    code = (
        "from pathlib import Path; from dermis import plan; from dermis.scene import scene;"
        f"p = plan.make(scene.from_data({{'stimulus': {TOUCH!r}, 'effects': {{'auto': {{}}}}}}, Path('made.toml')));"
        "print(repr(p.left_out_lsb), list(map(float, p.margin_lsb)), p.effects)"
    )
    seeds = [{**os.environ, "PYTHONHASHSEED": str(seed)} for seed in range(4)]
    command = [sys.executable, "-c", code]
    told = {subprocess.run(command, env=e, capture_output=True, check=True, timeout=60).stdout for e in seeds}
    assert len(told) == 1


def test_the_sum_of_the_bounds_is_what_counts_not_each_alone() -> None:
    plan = made({"auto": {"budget_lsb": 0.25}})
    inside = [e for e in plan.effects if e.on and e.bound_lsb is not None and e.bound_lsb < 0.25]
    assert inside, "nothing here fits alone but not together"


def test_what_is_left_out_leaves_no_trace_in_the_records() -> None:
    plan = made({"auto": {"budget_lsb": 0.25}})
    fields = {name: auto.fields_of(planning.whole(plan.scene, None), name) for name in plan.scene.effects}
    kept = frozenset().union(*(fields[name] for name in on(plan)))
    assert plan.active_fields() <= kept
    named = made({name: plan.scene.effects[name].model_dump() for name in on(plan)})
    assert plan.active_fields() == named.active_fields()
    assert (engines.run(plan).codes == engines.run(named).codes).all()


def test_what_is_not_considered_says_why() -> None:
    plan = made({"auto": {}, "lateral": False}, interface={"topology": "direct"})
    why = {e.name: e.reason for e in plan.effects}
    assert why["lateral"] == "switched off"
    assert why["column_input"] == "no default for this topology"
    assert why["mirror_lag"] == "topology direct has none"
    assert why["motion"] == "not named, and not considered unless it is"


@pytest.mark.paper
def test_the_cheapest_engine_that_can_is_chosen() -> None:
    assert made({"auto": {}}).engine == "closed"
    assert made({"auto": {}, "comparator_hysteresis": {"v_v": 0.9}}).engine == "event"
    assert made({}).engine == "closed"
    assert made({"mirror_lag": True}).engine == made({"lateral": True, "shot_noise": True}).engine == "event"
    assert made({"mirror_lag": True}, engine="closed").engine == "closed"
    assert made({"mirror_lag": True}, run={"engine": "rtl"}).engine == "rtl"
    assert made({"auto": {}}, engine="event").engine == "event"
    assert made({"auto": {}}, run={"engine": "event"}).engine == "event"


@pytest.mark.paper
def test_an_engine_asked_for_that_cannot_is_refused_by_name() -> None:
    plan = made({"auto": {}, "comparator_hysteresis": {"v_v": 0.9}}, engine="closed")
    with pytest.raises(InputError, match="not possible with engine closed"):
        engines.check(plan)


def test_what_an_engine_would_refuse_by_value_is_refused_before_the_run() -> None:
    effects = {"integrator_gain": {"gain_dc": 5}, "row_driver": {"r_ohm": 300}, "lateral": True}
    sheet = {"interface": {"topology": "direct"}, "stimulus": {"kind": "uniform", "code": 100}}
    for engine in ("event", "rtl"):
        with pytest.raises(InputError, match=r"here .*; engine cosim takes any"):
            engines.check(made(effects, engine, **sheet))
    with pytest.raises(InputError, match=r"engine cosim$"):
        engines.check(made(effects, "closed", **sheet))
    assert made(effects, **sheet).engine == "cosim"
    weak = {"integrator_gain": True, "row_driver": True}
    with pytest.raises(InputError, match=r"engine event or rtl or cosim$"):
        engines.check(made(weak, "closed", **sheet))
    engines.check(made(weak, **sheet))


def test_a_range_is_kept_where_motion_piles_charge_up_against_it() -> None:
    # Above 1/2 for part of a gate the charge runs away and is spent later, unless the range cuts it off.
    stimulus = {"kind": "uniform", "r_ohm": [420.0, 800.0, 420.0]}
    small = {"array": {"rows": 2, "cols": 2}, "stimulus": stimulus}
    assert "integrator_range" not in on(made({"auto": {}}, **small))
    plan = made({"auto": {}, "motion": {}}, **small)
    assert "integrator_range" in on(plan)
    result = certified(plan)
    every = planning.whole(plan.scene, "event")
    codes = engines.runner("event")(every).codes
    assert ((result.low <= codes) & (codes <= result.high)).all()
    lost = engines.runner("event")(
        replace(every, converter=replace(every.converter, v_int_max_v=np.inf, v_int_min_v=-np.inf))
    )
    assert np.abs(lost.codes.astype(int) - codes).max() > 1, "the range does nothing here"


def test_a_bare_network_is_solved_only_where_it_matters() -> None:
    light = {"kind": "uniform", "r_ohm": 1e6}
    weak = {
        "auto": {"budget_lsb": 0.5},
        "row_driver": {"r_ohm": 0.1},
        "column_offset": {"v_v": 1e-6},
        "trace": False,
    }
    weak |= {"column_input": {"r_ohm": 0.1}, "lateral": {"r_ohm": 1e5}}
    plan = made(weak, stimulus=light)
    assert not plan.network(0).active_fields()


@pytest.mark.paper
def test_the_resolved_scene_gives_the_same_plan() -> None:
    for effects in (
        {"auto": {}},
        {"auto": {"budget_lsb": 0.6, "sigma": 4.0}, "motion": {}, "trace": False},
        {"auto": {}, "comparator_hysteresis": {"v_v": 0.9}, "mirror_ratio": {"spread": 0.01}},
    ):
        plan = made(effects)
        again = planning.make(scene.from_data(tomllib.loads(plan.resolved_toml()), Path("made.toml")))
        assert again.effects == plan.effects
        assert again.engine == plan.engine
        assert (again.margin_lsb == plan.margin_lsb).all()
        assert again.converter.active_fields() == plan.converter.active_fields()
        assert (again.converter.gain == plan.converter.gain).all()


def test_planning_does_not_grow_with_the_frames() -> None:
    codes = [3, 200] * 100
    plan = made({"auto": {}}, stimulus={"kind": "uniform", "code": codes})
    assert bounds.Extent(plan, 6.0).g.shape[0] == bounds.BLOCKS_MAX


SMALL_PACKETS = {
    "array": {"rows": 1, "cols": 2},
    "stimulus": {"kind": "uniform", "code": [10, 20]},
    "interface": {"topology": "direct"},
}


@pytest.mark.parametrize("packet_error", [0.0, -0.9])
def test_a_budget_is_in_codes_whatever_the_size_of_a_packet(packet_error: float) -> None:
    """A tenth of a packet's charge makes ten times as many codes of what is left out."""
    off = dict.fromkeys(EFFECTS, False) | {"charge_packet": {"packet_error": packet_error}}
    ideal = made(off, **SMALL_PACKETS)
    one_a = float(ideal.converter.i0_a[0]) / ideal.timing.gate_clocks  # for a whole gate: one packet
    offset = {"offset_current": {"i_a": 0.95 * 0.25 * one_a}}
    plan = made(off | offset | {"auto": {"budget_lsb": 0.25}}, **SMALL_PACKETS)
    assert ("offset_current" in on(plan)) == (packet_error < 0.0)
    moved = engines.run(made(off | offset, **SMALL_PACKETS)).codes.astype(int) - engines.run(ideal).codes
    assert (np.abs(moved).max() > 1) == (packet_error < 0.0)
    assert plan.left_out_lsb <= 0.25
    bound = next(e.bound_lsb for e in plan.effects if e.name == "offset_current")
    # The same product in another order: 1e-9 is far above its rounding.
    assert bound == pytest.approx(0.95 * 0.25 / (1.0 + packet_error), rel=1e-9)


def test_a_bound_at_the_end_of_doubles_is_infinite_in_small_packets_without_an_overflow() -> None:
    off = dict.fromkeys(EFFECTS, False) | {"charge_packet": {"packet_error": -0.9}}
    plan = made(off | {"offset_current": {"i_a": 1e-9}}, **SMALL_PACKETS)
    weighing = auto._Weighing(planning.whole(plan.scene, None), AutoTable())
    weighing.lsb["offset_current"] = np.full_like(weighing.lsb["offset_current"], 1e308)
    assert weighing.alone("offset_current", set()) == np.inf


@pytest.mark.paper
def test_what_couples_columns_need_not_be_kept_where_virtual_grounds_stand_still() -> None:
    """What makes them give way is left out by a bound that holds all that comes of it."""
    weak = {"gain_dc": 1e7, "r_in_ohm": 1e9}
    data = {
        "array": {"rows": 1, "cols": 2},
        "stimulus": {"kind": "uniform", "code": [200]},
        "interface": {"topology": "direct"},
    }
    off = dict.fromkeys(EFFECTS, False) | {"auto": {"budget_lsb": 0.05}, "lateral": {"r_ohm": 5.0}}
    plan = made(off | {"integrator_gain": weak}, **data)
    assert not on(plan)
    weighing = auto._Weighing(planning.whole(plan.scene, None), AutoTable())
    alone = weighing.off({"lateral"})
    assert 0.0 < alone < weighing.off({"integrator_gain"}) == plan.left_out_lsb
    assert "lateral" in on(made(off | {"integrator_gain": weak | {"gain_dc": 300.0}}, **data))


# --- certified codes -----------------------------------------------------------------------------------------------


def test_codes_are_certain_where_nothing_is_left_out_and_nothing_is_random() -> None:
    result = certified(made({"row_driver": True, "mirror_ratio": True}))
    assert (result.low == result.codes).all()
    assert (result.high == result.codes).all()


@pytest.mark.parametrize("effects", [{"auto": {}}, {"comparator_noise": {"v_v": 0.02}, "clock_jitter": True}])
def test_certified_codes_hold_the_codes_of_every_seed(effects: dict[str, Any]) -> None:
    stimulus = {"kind": "ramp", "force_n": [0.0, 16.0], "frames": 40}
    result = certified(made(effects, stimulus=stimulus, run={} if "auto" in effects else {"engine": "event"}))
    assert (result.low < result.high).any()
    every = {n: p.model_dump() for n, p in made(effects).scene.effects.items()}
    for seed in range(5):
        codes = engines.run(made(every, stimulus=stimulus, run={"seed": seed, "engine": "event"})).codes
        assert ((result.low <= codes) & (codes <= result.high)).all()


@pytest.mark.paper
def test_certified_codes_are_those_of_thresholds_moved_by_the_margin() -> None:
    plan = made({"auto": {}}, stimulus={"kind": "ramp", "force_n": [0.0, 16.0], "frames": 20})
    result = certified(plan)
    for sign, codes in ((1.0, result.low), (-1.0, result.high)):
        moved = plan.converter.v_comp_offset_v + sign * plan.margin_lsb * plan.converter.packet_v()
        converter = replace(plan.converter, v_comp_offset_v=moved)
        for engine in ("closed", "event"):
            run = engines.runner(engine)(replace(plan, converter=converter))
            assert (run.codes == codes).all()


@pytest.mark.paper
def test_certified_codes_from_the_duty_of_a_run_are_those_of_whole_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    effects = {"auto": {}, "comparator_hysteresis": {"v_v": 0.9}}
    plan = made(effects, stimulus={"kind": "ramp", "force_n": [0.0, 16.0], "frames": 12})
    assert plan.engine == "event"
    result = engines.run(plan)
    quick = certificate.certified(plan, result)
    monkeypatch.setattr(certificate, "_steady", lambda _: False)
    slow = certificate.certified(plan, result)
    assert (quick[0] == slow[0]).all()
    assert (quick[1] == slow[1]).all()
    assert (quick[0] < quick[1]).any()


def test_parts_of_a_plan_have_the_certified_codes_of_the_whole() -> None:
    plan = made({"auto": {}}, stimulus={"kind": "ramp", "force_n": [0.0, 16.0], "frames": 8})
    whole, part = certified(plan), certified(plan.part(3, 6))
    assert (part.low == whole.low[3:6]).all()
    assert (part.high == whole.high[3:6]).all()


# --- random scenes -------------------------------------------------------------------------------------------------


def short_campaign(tmp_path: Path, count: int) -> list[auto_check.Outcome]:
    """Small scenes of the interfaces with a mirror, without motion: few loops have to be compiled."""
    outcomes = []
    for number in range(1000):
        rng = np.random.default_rng([11, number])
        data = auto_check.random_scene(rng, tmp_path, 4)
        if data["interface"]["topology"] == "direct" or "motion" in data["effects"]:
            continue
        outcomes.append(auto_check.compare(data, tmp_path / "scene.toml"))
        if len(outcomes) == count:
            return outcomes
    raise AssertionError("too few scenes")


def test_auto_and_everything_on_agree_within_the_budget_and_the_certificate(tmp_path: Path) -> None:
    outcomes = short_campaign(tmp_path, 40)
    rows = {r["name"]: r for r in auto_check.rows(outcomes)}
    for name in ("auto.conversions", "auto.over_budget", "auto.outside_certified", "auto.median_width_lsb"):
        assert rows[name]["status"] == "PASS", rows[name]
    assert sum(o.differ for o in outcomes) > 0
    assert {o.engine for o in outcomes} == {"closed", "event"}


@pytest.mark.paper
@pytest.mark.parametrize("name", ["row_driver", "charge_packet", "trace"])
def test_a_bound_a_hundred_times_too_small_is_caught(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = EFFECTS[name]

    def small(p: Any, extent: bounds.Extent) -> bounds.Bound:
        found = effect.bound(p, extent)
        return replace(found, lsb=0.01 * np.asarray(found.lsb))

    monkeypatch.setitem(EFFECTS, name, replace(effect, bound=small))
    rows = {r["name"]: r["status"] for r in auto_check.rows(short_campaign(tmp_path, 8))}
    assert rows["auto.outside_certified"] == "FAIL"


def test_random_scenes_are_the_same_for_the_same_seed_and_cover_every_kind(tmp_path: Path) -> None:
    def draw(number: int) -> dict[str, Any]:
        return auto_check.random_scene(np.random.default_rng([0, number]), tmp_path, 3)

    assert draw(5) == draw(5) != draw(6)
    many = [draw(n) for n in range(150)]
    assert {d["stimulus"]["kind"] for d in many} == set(auto_check.KINDS)
    assert {d["interface"]["topology"] for d in many} == set(TOPOLOGIES)
    named = {name for d in many for name, value in d["effects"].items() if isinstance(value, dict)}
    assert named >= set(EFFECTS)
