# SPDX-License-Identifier: Apache-2.0
"""The bounds of the filter: the two lemmas they rest on, in exact numbers, and that none is too small."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from dermis import bounds, engines, records
from dermis import plan as planning
from dermis.converter import course
from dermis.converter.vfc import count, count_one
from dermis.effects import EFFECTS
from dermis.engines import event, filter
from dermis.scene import scene

N = 510


def filtered(effects: dict[str, Any], **more: Any) -> records.Plan:
    """A plan with these effects alone, open cells walked alone."""
    ramp = {"kind": "uniform", "r_ohm": [float(r) for r in np.geomspace(505.0, 3e4, 4000)]}
    data = {"array": {"rows": 1, "cols": 2}, "stimulus": ramp, "effects": effects} | more
    made = planning.whole(scene.from_data(data, Path("made.toml")), "event")
    return replace(made, filtered=True)


def wrong(plan: records.Plan) -> int:
    """Codes of the filter that are not those of engine event."""
    return int((engines.run(plan).codes != event.run(plan).codes).sum())


def test_every_effect_has_a_bound_or_is_honoured_by_engine_closed() -> None:
    for effect in EFFECTS.values():
        assert effect.bound in (bounds.honoured, getattr(bounds, effect.name, None))


def test_an_effect_without_a_bound_keeps_every_cell_open(monkeypatch: pytest.MonkeyPatch) -> None:
    effect = EFFECTS["comparator_delay"]
    monkeypatch.setitem(EFFECTS, effect.name, replace(effect, bound=bounds.unknown))
    plan = filtered({"comparator_delay": True})
    assert engines.run(plan).info["filter"]["everything"] == plan.resistance_ohm.size
    assert wrong(plan) == 0


# --- the lemma -----------------------------------------------------------------------------------------------------


def machine(
    x: np.ndarray, theta: np.ndarray, e: np.ndarray, leak: float, low: float, high: float
) -> np.ndarray:
    """Ones of N decisions with level w + e[n] >= theta, packets out one clock after their decision; [cases]."""
    w, q1, q2 = np.full(x.shape, -0.5), np.zeros(x.shape), np.zeros(x.shape)
    ones = np.zeros(x.shape, dtype=int)
    for n in range(N):
        w = np.clip(w * (1.0 - leak) + x - q2, low, high)
        q = (w + e[n] >= theta) & (q1 == 0)
        q2, q1 = q1, q.astype(float)
        ones += q
    return ones


@pytest.mark.parametrize("leak", [0.0, 0.01])
@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-1.1, 0.9), (-0.7, 0.4)])
def test_errors_within_e_stay_between_thresholds_moved_by_e(leak: float, limits: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    x, margin = rng.uniform(-0.01, 0.8, 2000), rng.uniform(0, 0.4, 2000)
    kind = rng.integers(3, size=2000)
    shape = np.stack([rng.uniform(-1, 1, (N, 2000)), np.sign(rng.uniform(-1, 1, (N, 2000))),
                      np.cumsum(rng.uniform(-0.05, 0.05, (N, 2000)), axis=0).clip(-1, 1)])  # fmt: skip
    e = margin * np.choose(kind, shape)
    zero = np.zeros((N, 1))
    true = machine(x, np.zeros(2000), e, leak, *limits)
    least = machine(x, margin, zero, leak, *limits)
    most = machine(x, -margin, zero, leak, *limits)
    assert ((least <= true) & (true <= most)).all()
    assert ((least < true) | (true < most)).any()
    assert not (
        (machine(x, margin / 2, zero, leak, *limits) <= true) | (margin == 0)
    ).all()  # half is too little


# --- the last decision -----------------------------------------------------------------------------------------------


def walked(charge: list[Fraction], start: Fraction, packet: Fraction, error: list[Fraction]) -> int:
    """Ones of a machine at level 0 that gathers `charge` clock by clock, its levels off by `error`."""
    w, ones, last = start, 0, False
    for came, off in zip(charge, error, strict=True):
        w += came
        last = not last and w + off >= 0
        ones += last
        w -= packet * last
    return ones


def cases(count: int) -> Iterator[tuple[list[Fraction], Fraction, Fraction]]:
    """Charges of 0 to half a packet in every clock, of any course; a start within a packet below the level."""
    rng = Random(3)
    for _ in range(count):
        packet = Fraction(rng.randint(50, 150), 100)
        most = rng.randint(0, 1000)
        charge = [packet * Fraction(rng.randint(0, most), 2000) for _ in range(rng.randint(1, 60))]
        yield charge, -packet * Fraction(rng.randint(1, 1000), 1000), packet


def test_the_count_is_that_of_the_charge_up_to_the_last_decision() -> None:
    for charge, start, packet in cases(3000):
        nothing = [Fraction(0)] * len(charge)
        assert walked(charge, start, packet, nothing) == math.floor((start + sum(charge)) / packet) + 1


def test_errors_of_levels_count_where_the_level_is_highest() -> None:
    """The count is that of the highest level, so an error counts at the end, or as far as it outruns the charge."""
    rng = Random(4)
    before_the_end = 0
    for charge, start, packet in cases(3000):
        charge = [c / 3 for c in charge]
        error = [packet * Fraction(rng.randint(-100, 100), 1000) for _ in charge]
        if rng.random() < 0.5:  # a drift goes far; from one decision to the next but one it does not
            error = list(accumulate(error))
            start -= packet / 2
        level, so_far = start, []
        for came, off in zip(charge, error, strict=True):
            level += came
            so_far.append(level + off)
        count = max(0, math.floor(max(so_far) / packet) + 1)
        assert walked(charge, start, packet, error) == count
        before_the_end += count != max(0, math.floor(so_far[-1] / packet) + 1)
    assert before_the_end > 0, "the last decision alone is not enough where errors move"


def test_late_packets_count_as_errors_of_the_decisions_that_see_them() -> None:
    """Up to half a packet in two clocks: the count lies between those without and with all that is late."""
    rng = Random(5)
    late = 0
    for charge, start, packet in cases(3000):
        loose, left = (
            packet * Fraction(rng.randint(0, 100), 1000),
            packet * Fraction(rng.randint(0, 300), 1000),
        )
        charge = [
            c * (1 - 2 * loose / packet) for c in charge
        ]  # two clocks and twice `loose` are a packet at most
        off = [loose * Fraction(rng.randint(-100, 100), 100) for _ in charge]
        w, ones, last = start, 0, False
        level, so_far, most = start, [], []
        for came, e in zip(charge, off, strict=True):
            w, level = w + came, level + came
            so_far.append(level + e)
            most.append(level + e + left)
            last = not last and w + e + left * Fraction(rng.randint(0, 10), 10) >= 0
            ones += last
            w -= packet * last
        counts = [max(0, math.floor(max(seen) / packet) + 1) for seen in (so_far, most)]
        assert counts[0] <= ones <= counts[1]
        late += ones > counts[0]
    assert late > 0, "what is late must bring some packet early"


def test_late_packets_are_known_where_the_third_clock_decides_in_any_case() -> None:
    """Clocks of a third to half a packet: all that is late two clocks after a packet counts, all the time."""
    rng = Random(6)
    late = 0
    for _ in range(3000):
        packet = Fraction(rng.randint(50, 150), 100)
        left, loose = (packet * Fraction(rng.randint(0, most), 1000) for most in (190, 10))
        least, most = (packet + left + 2 * loose) / 3, (packet - left - 2 * loose) / 2
        span = most - least
        if span <= 0:
            continue
        charge = [least + span * Fraction(rng.randint(1, 999), 1000) for _ in range(rng.randint(1, 60))]
        error = [loose * Fraction(rng.randint(-100, 100), 100) for _ in charge]
        window = left * Fraction(rng.randint(0, 10), 10)
        start = -packet / 2
        w, ones, ago, up = start, 0, 9, False
        level, so_far = start, []
        for came, off in zip(charge, error, strict=True):
            w, level, ago = w + came, level + came, ago + 1
            so_far.append(level + off)
            seen = w + off + {1: packet, 2: left - window}.get(ago, 0)
            up = seen >= (-window if up else 0)
            if up and ago > 1:
                ones, w, ago = ones + 1, w - packet, 0
        first = next((n for n, seen in enumerate(so_far) if seen >= 0), len(so_far))
        highest = max([*so_far[: first + 1], *(seen + left for seen in so_far[first + 2 :])])
        assert ones == max(0, math.floor(highest / packet) + 1)
        late += ones != max(0, math.floor(max(so_far) / packet) + 1)
    assert late > 0, "what is late must bring some packet early"


def test_more_than_half_a_packet_a_clock_or_charge_that_leaves_breaks_it() -> None:
    """The two counterexamples that `Solved.quiet` keeps out."""
    fast = [Fraction(9, 10)] * 3
    assert (
        walked(fast, Fraction(-1, 2), Fraction(1), [Fraction(0)] * 3)
        == 2
        != math.floor(sum(fast) - Fraction(1, 2)) + 1
    )
    leaves = [Fraction(1, 2), Fraction(-1, 2), Fraction(0)]
    assert walked(leaves, Fraction(-1, 4), Fraction(1), [Fraction(0)] * 3) == 1
    assert math.floor(sum(leaves) - Fraction(1, 4)) + 1 == 0


# --- the bounds ------------------------------------------------------------------------------------------------------

STRONG: dict[str, dict[str, Any]] = {
    "comparator_hysteresis": {"comparator_hysteresis": {"v_v": 0.1}},
    "comparator_delay": {"comparator_delay": {"t_s": 1e-8}},
    "integrator_bandwidth": {"integrator_bandwidth": {"gbw_hz": 2e7}},
    "integrator_gain": {"integrator_gain": {"gain_dc": 100.0, "r_in_ohm": 1e6}},
    "supply_ripple": {"supply_ripple": {"relative": 0.1, "frequency_hz": 3.3e4}},
    "mirror_lag": {"mirror_lag": {"q_c": 1e-11}, "supply_ripple": {"relative": 0.02, "frequency_hz": 2e4}},
    "ktc_noise": {"ktc_noise": {"temperature_c": 1e7}},
    "flicker_noise": {"flicker_noise": {"relative": 1e-3}},
    "shot_noise": {"shot_noise": {"factor": 1e3}},
    "thermal_noise": {"thermal_noise": {"temperature_c": 27.0, "factor": 1e3}},
    "clock_jitter": {"clock_jitter": {"t_s": 5e-9}},
    "comparator_noise": {"comparator_noise": {"v_v": 0.02}},
    "metastability": {"metastability": {"t_aperture_s": 5e-8}},
    "integrator_range": {"integrator_range": {"v_max_v": 1.6, "v_min_v": -0.6}},
    "line_capacitance": {
        "line_capacitance": {"c_row_f": 1e-9, "c_column_f": 1e-9},
        "row_driver": {"r_ohm": 3e3},
        "column_input": {"r_ohm": 1e3},
    },
}
SHIFTS = (
    "comparator_hysteresis",
    "comparator_delay",
    "integrator_bandwidth",
    "supply_ripple",
)
"""Effects that move the level at the last decision by a known amount."""


def test_every_bound_is_tried() -> None:
    bounded = {e.name for e in EFFECTS.values() if e.bound is not bounds.honoured}
    assert bounded == {*STRONG, "motion"}


@pytest.mark.parametrize("name", STRONG)
def test_codes_of_a_strong_effect_are_those_of_engine_event(name: str) -> None:
    assert wrong(filtered(STRONG[name])) == 0


@pytest.mark.parametrize(
    "name", [*SHIFTS, "integrator_gain", "ktc_noise", "flicker_noise", "integrator_range"]
)
def test_a_bound_of_nothing_is_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    effect = EFFECTS[name]
    monkeypatch.setitem(EFFECTS, name, replace(effect, bound=bounds.honoured))
    assert wrong(filtered(STRONG[name])) > 0


@pytest.mark.parametrize("name", SHIFTS)
def test_half_a_bound_is_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    effect = EFFECTS[name]
    monkeypatch.setitem(EFFECTS, name, replace(effect, bound=replace(effect.bound, factor=0.5)))
    assert wrong(filtered(STRONG[name])) > 0


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
    stimulus = {"kind": "uniform", "r_ohm": [float(r) for r in np.geomspace(1e3, 1e6, 1000)]}
    plan = filtered(much | {"flicker_noise": {"relative": 1e-3}}, stimulus=stimulus)
    assert event.run(plan).codes.max() > 20, "too weak to test anything"
    assert wrong(plan) == 0


RANDOM: dict[str, Any] = {
    "thermal_noise": True,
    "shot_noise": True,
    "clock_jitter": {"t_s": 1e-10},
    "comparator_noise": {"v_v": 2e-3},
    "ktc_noise": True,
    "flicker_noise": True,
}


def around(codes: np.ndarray) -> dict[str, Any]:
    """Uniform frames of codes that are no whole numbers."""
    return {"kind": "uniform", "r_ohm": [float(r) for r in 500.0 * 255.0 / codes.ravel()]}


@pytest.mark.parametrize("window_v", [None, 1e-3, 0.02])
def test_noise_of_the_last_decision_is_drawn_and_few_cells_are_walked(window_v: float | None) -> None:
    """Duties around steps between codes, within what noise can do: numbers of the slot decide nearly all of them."""
    window = {} if window_v is None else {"comparator_hysteresis": {"v_v": window_v}}
    steps = np.array([12.5, 20.5, 100.5, 150.5])[:, None] + np.linspace(-0.02, 0.02, 500)
    plan = filtered(RANDOM | window, stimulus=around(steps))
    found = engines.run(plan).info["filter"]
    assert found["level_1"] > 500, "too far from the steps to test anything"
    assert found["everything"] < 0.1 * found["level_1"]
    assert wrong(plan) == 0


LATE = {
    "comparator_hysteresis": {"v_v": 0.02},
    "comparator_delay": {"t_s": 8e-9},
    "integrator_bandwidth": {"gbw_hz": 2e7},
}


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"flicker_noise": {"relative": 2e-3}},
        {"comparator_noise": {"v_v": 1e-3}, "metastability": {"t_aperture_s": 2e-9}},
        {"shot_noise": True, "clock_jitter": {"t_s": 1e-10}},
    ],
)
@pytest.mark.parametrize(("step", "walked_at_most"), [(205.5, 0.02), (240.5, 0.4), (170.5, 0.4)])
def test_late_packets_of_fast_converters(more: dict[str, Any], step: float, walked_at_most: float) -> None:
    """Duties of 0.4, where what is late is known, and of 0.47 and a third, where it is not."""
    plan = filtered(LATE | more, stimulus=around(step + np.linspace(-0.2, 0.2, 4000)))
    found = engines.run(plan).info["filter"]
    assert wrong(plan) == 0
    assert found["everything"] <= walked_at_most * plan.resistance_ohm.size


def test_noise_that_is_left_out_at_the_last_decision_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = filtered(RANDOM, stimulus=around(np.linspace(20.48, 20.52, 2000)))
    columns = bounds.columns

    def without(c: Any) -> Any:
        table = columns(c)
        table[bounds.NOISE] = 0.0
        return table

    assert wrong(plan) == 0
    monkeypatch.setattr(bounds, "columns", without)
    assert wrong(plan) > 0


def test_motion_is_followed(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    np.save(tmp_path / "r.npy", 10 ** rng.uniform(2.8, 4.5, (12, 5, 4)))
    stimulus = {"kind": "resistance", "file": str(tmp_path / "r.npy")}
    array = {"rows": 5, "cols": 4}
    for more in (
        {},
        {"row_driver": {"r_ohm": 20.0}},
        {"mirror_lag": True, "supply_ripple": True, "range_switch": True},
    ):
        assert wrong(filtered({"motion": {}} | more, stimulus=stimulus, array=array)) == 0


def test_slow_mirrors_in_closed_form_give_the_charge_of_clocks() -> None:
    plan = filtered({"mirror_lag": {"q_c": 2e-11}})
    found = filter._Part(plan, slice(0, plan.frames), filter.Table(filter.bounding(plan)))
    # A polynomial of an exponential of 1e-13 in each of 625 clocks.
    assert found.s.x == pytest.approx(np.clip(event.run(plan).info["x"], -0.75, 0.75), abs=1e-11)

    def after(u: float, x: float, clocks: float) -> float:
        return course.approach(u, 1.0 / x, x * clocks / 5.0)

    # In two steps as in one, and settled after many.
    whole = after(2.0, 0.3, 20.0)
    # Roundings of exponentials.
    assert after(after(2.0, 0.3, 8.0), 0.3, 12.0) == pytest.approx(whole, rel=1e-12)
    assert after(2.0, 0.3, 1e4) == 1.0 / 0.3
    assert after(2.0, 0.3, 1e-6) == pytest.approx(2.0 + 2e-7 * (1.0 - 0.6), rel=1e-12)


def test_counts_of_one_cell_are_those_of_the_closed_formula() -> None:
    rng = np.random.default_rng(7)
    x = np.concatenate([rng.uniform(-0.1, 1.0, 2000), np.arange(1999) / 1020, [0.0]])
    for clocks in (1, 37, N):
        start, packet = rng.choice([-1.2, -0.5, 0.0, 0.25, 0.5, 1.5], 4000), rng.choice([0.7, 1.0, 1.2], 4000)
        cells = zip(x, start, packet, strict=True)
        alone = [count_one(cell, clocks, level, size) for cell, level, size in cells]
        assert (alone == count(x, clocks, 0.0, packet, start)).all()


EVERYTHING: dict[str, Any] = {name: True for name in STRONG if name not in ("line_capacitance",)} | {
    "range_switch": True,
    "column_offset": True,
    "mux_leakage": True,
    "row_driver": {"r_ohm": 5.0},
}


@pytest.mark.parametrize(
    "effects", [{"comparator_delay": True, "shot_noise": True}, EVERYTHING, EVERYTHING | {"motion": {}}]
)
def test_chosen_cells_are_counted_as_in_a_whole_run(effects: dict[str, Any]) -> None:
    stimulus = {"kind": "ramp", "force_n": [0.0, 12.0, 3.0], "frames": 7}
    plan = filtered(effects, stimulus=stimulus, array={"rows": 6, "cols": 5})
    part = filter._Part(plan, slice(0, plan.frames), filter.Table(filter.bounding(plan)))
    rng = np.random.default_rng(6)
    cells = np.nonzero(rng.random(plan.resistance_ohm.shape) < 0.3)
    counts = np.minimum(part._walk(cells), plan.timing.code_max)
    assert (counts == event.run(plan).codes[cells]).all()
    if "mirror_lag" in effects:
        assert (part._depth(cells) >= 0).all()
        assert course.has_idle_current(plan)
