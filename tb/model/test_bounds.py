# SPDX-License-Identifier: Apache-2.0
"""The bounds of the filter: codes of every effect are those of engine event, and without a bound they are not."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import bounds, engines, records
from dermis import plan as planning
from dermis.effects import EFFECTS
from dermis.engines import event
from dermis.scene import scene

BOUNDED = [name for name, effect in EFFECTS.items() if effect.bound is not bounds.honoured]
RAMP = {"kind": "uniform", "r_ohm": np.geomspace(505.0, 3e4, 300).tolist()}


def filtered(effects: dict[str, Any], **more: Any) -> records.Plan:
    """A plan with these effects alone, open cells walked alone."""
    data = {"array": {"rows": 1, "cols": 2}, "stimulus": RAMP, "effects": effects} | more
    made = planning.whole(scene.from_data(data, Path("made.toml")), "event")
    return replace(made, filtered=True)


def wrong(plan: records.Plan, codes: np.ndarray | None = None) -> int:
    """Codes of the filter that are not those of engine event."""
    return int((engines.run(plan).codes != (event.run(plan).codes if codes is None else codes)).sum())


def strengths(name: str) -> list[dict[str, Any]]:
    """The example of an effect, its least parameters, and two draws between them."""
    effect, rng = EFFECTS[name], np.random.default_rng(3)
    least = {key: effect.signs(key)[0] * low for key, (low, _) in effect.range().items()}
    return [
        {**effect.needs, name: value}
        for value in (effect.example(), least, effect.draw(rng), effect.draw(rng))
    ]


@cache
def runs(name: str) -> list[tuple[records.Plan, np.ndarray]]:
    """Plans of an effect's strengths that engine event takes, and its codes."""
    plans = [filtered(on) for on in strengths(name)]
    return [(plan, event.run(plan).codes) for plan in plans if not engines.refuses(plan, "event")]


def test_every_effect_has_a_bound_or_is_honoured_by_engine_closed() -> None:
    for effect in EFFECTS.values():
        assert effect.bound in (bounds.honoured, getattr(bounds, effect.name, None))


@pytest.mark.parametrize("name", BOUNDED)
def test_codes_of_an_effect_are_those_of_engine_event(name: str) -> None:
    assert runs(name)
    for plan, codes in runs(name):
        assert wrong(plan, codes) == 0


def test_an_effect_without_a_bound_keeps_every_cell_open(monkeypatch: pytest.MonkeyPatch) -> None:
    name = BOUNDED[0]
    monkeypatch.setitem(EFFECTS, name, replace(EFFECTS[name], bound=bounds.unknown))
    plan = filtered({name: True})
    assert engines.run(plan).info["filter"]["everything"] == plan.resistance_ohm.size
    assert wrong(plan) == 0


@pytest.mark.parametrize(
    "much",
    [
        {"preset_error": {"v_v": 100.0}},
        {"comparator_offset": {"v_v": -60.0}},
        {"comparator_offset": {"v_v": -20.0}, "integrator_gain": {"gain_dc": 20.0, "r_in_ohm": 1e4}},
        {"charge_packet": {"packet_error": 2.0}, "offset_current": {"i_a": 1e-5}},
        {"charge_packet": {"packet_error": 1.0}, "integrator_range": {"v_max_v": 1.2, "v_min_v": -0.2}},
    ],
)
def test_flicker_is_bounded_by_all_packets_of_a_slot(much: dict[str, Any]) -> None:
    """Taxels that give next to nothing, so that most packets come of the preset, the offset or a current."""
    stimulus = {"kind": "uniform", "r_ohm": np.geomspace(1e3, 1e6, 500).tolist()}
    plan = filtered(much | {"flicker_noise": {"relative": 1e-3}}, stimulus=stimulus)
    codes = event.run(plan).codes
    assert codes.max() > 20, "too weak to test anything"
    assert wrong(plan, codes) == 0


RANDOM: dict[str, Any] = {
    "thermal_noise": True,
    "shot_noise": True,
    "clock_jitter": {"t_s": 1e-10},
    "comparator_noise": {"v_v": 2e-3},
    "ktc_noise": True,
    "flicker_noise": True,
}
LATE: dict[str, Any] = {
    "comparator_hysteresis": {"v_v": 0.02},
    "comparator_delay": {"t_s": 8e-9},
    "integrator_bandwidth": {"gbw_hz": 2e7},
    # Never reached: a walk that others compile, in 4 s.
    "integrator_range": {"v_max_v": 3.0, "v_min_v": -3.0},
}
STEPS = np.array([12.5, 20.5, 100.5, 150.5])[:, None] + np.linspace(-0.02, 0.02, 200)


@pytest.mark.parametrize(
    ("effects", "codes", "walked_at_most"),
    [
        # Duties around steps between codes: noise of the slot decides nearly all of them.
        (RANDOM, STEPS, 0.1),
        (RANDOM | {"comparator_hysteresis": {"v_v": 1e-3}}, STEPS, 0.1),
        (RANDOM | {"comparator_hysteresis": {"v_v": 0.02}}, STEPS, 0.1),
        # Duties of 0.4, where what is late is known, and of 0.47 and a third, where it is not.
        (LATE, 205.5 + np.linspace(-0.2, 0.2, 1000), 0.02),
        (LATE | {"flicker_noise": {"relative": 2e-3}}, 240.5 + np.linspace(-0.2, 0.2, 1000), 0.4),
        (LATE | {"shot_noise": True, "clock_jitter": {"t_s": 1e-10}}, 170.5 + np.linspace(-0.2, 0.2, 1000), 0.4),
    ],
    ids=["noise", "window", "wide window", "late", "late flicker", "late noise"],
)  # fmt: skip
def test_few_cells_are_walked_and_codes_are_right(
    effects: dict[str, Any], codes: np.ndarray, walked_at_most: float
) -> None:
    plan = filtered(effects, stimulus={"kind": "uniform", "r_ohm": (500.0 * 255.0 / codes.ravel()).tolist()})
    assert engines.run(plan).info["filter"]["everything"] <= walked_at_most * plan.resistance_ohm.size
    assert wrong(plan) == 0


def test_noise_that_is_left_out_at_the_last_decision_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    codes = np.linspace(20.48, 20.52, 1000)
    plan = filtered(RANDOM, stimulus={"kind": "uniform", "r_ohm": (500.0 * 255.0 / codes).tolist()})
    columns = bounds.columns

    def without(c: Any) -> Any:
        table = columns(c)
        table[bounds.NOISE] = 0.0
        return table

    monkeypatch.setattr(bounds, "columns", without)
    assert wrong(plan) > 0


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"row_driver": {"r_ohm": 20.0}},
        {"mirror_lag": True, "supply_ripple": True, "range_switch": True},
        {name: True for name in BOUNDED if name != "line_capacitance"}
        | {"range_switch": True, "column_offset": True, "mux_leakage": True, "row_driver": {"r_ohm": 5.0}},
    ],
    ids=["motion", "row driver", "mirror", "everything"],
)
def test_motion_is_followed(tmp_path: Path, more: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    np.save(tmp_path / "r.npy", 10 ** rng.uniform(2.8, 4.5, (12, 5, 4)))
    stimulus = {"kind": "resistance", "file": str(tmp_path / "r.npy")}
    assert wrong(filtered({"motion": {}} | more, stimulus=stimulus, array={"rows": 5, "cols": 4})) == 0
