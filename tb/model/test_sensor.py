# SPDX-License-Identifier: Apache-2.0
"""The sheet: laws that undo themselves, and hysteresis, creep, temperature and spread as the data sheet has them."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.decode.force import decode
from dermis.engines import closed
from dermis.scene import design as designs
from dermis.scene import sensor
from dermis.scene.sensor import InverseSensor, PowerSensor, SensorState, age, creep_decades, spread_factor

Floats = NDArray[np.float64]
Write = Callable[..., Path]

INVERSE = InverseSensor(7500.0)


def power(**changes: object) -> PowerSensor:
    """The measured curve of models/design.toml."""
    table = sensor.SensorTable(law="power", **changes)
    return sensor.make_sensor(sensor.resolve(table, designs.load().sensor, "made"))


def no_rng(name: str) -> np.random.Generator:
    raise AssertionError(f"{name} drew a random number")


def seeded(name: str) -> np.random.Generator:
    assert name == "sensor_spread"
    return np.random.default_rng(5)


def aged(ohm: Floats, t_frame_s: float = 2e-3, law: sensor.Sensor = INVERSE, **state: float) -> Floats:
    return age(law, ohm, t_frame_s, SensorState(**state), 10e-3, seeded)


def column(values: object) -> Floats:
    """One taxel in time."""
    return np.asarray(values, dtype=float).reshape(-1, 1, 1)


def test_the_measured_curve_goes_through_its_points_with_the_published_exponents() -> None:
    law = power()
    assert law.resistance_ohm([0.2, 1.0, 10.0, 100.0]).tolist() == [30e3, 6e3, 1e3, 250.0]
    assert law.force_n([30e3, 6e3, 1e3, 250.0]).tolist() == [0.2, 1.0, 10.0, 100.0]
    # The exponents have two decimals: half a unit of the last.
    assert law.exponents() == pytest.approx([1.0, 0.78, 0.60, 0.60], abs=0.005)


def test_a_taxel_is_open_below_turn_on_and_its_curve_goes_on_at_both_ends() -> None:
    law = power()
    assert law.resistance_ohm([0.0, -0.0, 0.199, 5e-324]).tolist() == [1e7] * 4
    assert law.resistance_ohm(np.inf) == 0
    # The exponent is written with five digits.
    assert law.resistance_ohm(1000.0) == pytest.approx(250.0 * 10**-0.60206, rel=1e-6)
    # A power of ten and back: some ten roundings of 1.1e-16.
    assert power(force_on_n=0.05).resistance_ohm(0.1) == pytest.approx(60e3, rel=1e-12)
    # without a turn-on the highest resistance there is ends the curve
    assert power(force_on_n=0.0).resistance_ohm([1e-3, 1e-9]) == pytest.approx([6e6, 1e7])
    assert power(force_on_n=0.0, r_open_ohm=math.inf).resistance_ohm([1e-9, 0.0]).tolist() == [6e12, np.inf]


def test_resistances_that_no_force_makes_mean_turn_on_or_nothing() -> None:
    law = power()
    assert law.force_n([0.0, 30.1e3, 9.99e6, 1e7, 1e8, np.inf]).tolist() == [np.inf, 0.2, 0.2, 0, 0, 0]


@pytest.mark.parametrize("law", [INVERSE, power(), power(force_on_n=0.0)])
def test_force_and_resistance_undo_each_other(law: sensor.Sensor) -> None:
    force = np.geomspace(0.2, 1e6, 20001)
    # There and back through logarithm and exponential of |ln F| <= 14: 14 times 1.1e-16, twice.
    assert law.force_n(law.resistance_ohm(force)) == pytest.approx(force, rel=4e-15)
    ohm = np.geomspace(1e-3, 30e3, 20001)
    # As above.
    assert law.resistance_ohm(law.force_n(ohm)) == pytest.approx(ohm, rel=4e-15)


def scene(law: str, forces: str) -> str:
    return f'[array]\nrows = 1\ncols = 1\n[sensor]\nlaw = "{law}"\n[stimulus]\nkind = "uniform"\nforce_n = {forces}\n'


@pytest.mark.paper
def test_decoding_follows_the_law(write_scene: Write) -> None:
    forces = [0.0, 0.1, 0.2, 0.5, 1, 3, 7, 15, 30]
    plan = planning.load(write_scene(scene("power", str(forces))))
    decoded = decode(plan, closed.run(plan).codes)
    # A force that stands exactly on an edge of its code, up to rounding.
    assert (decoded.force_low_n.ravel() <= np.array(forces) * (1 + 1e-12)).all()
    assert (decoded.force_high_n.ravel() >= np.array(forces) * (1 - 1e-12)).all()
    # The loss of sensitivity at 10 N is 40 %: an exponent of 0.6 where K/R has 1.
    codes = decode(plan, np.arange(256).reshape(-1, 1, 1))
    at = int(np.searchsorted(codes.force_n.ravel(), 10.0))
    f, x = codes.force_n.ravel(), codes.x.ravel()
    slope = math.log(x[at + 1] / x[at]) / math.log(f[at + 1] / f[at])
    # A slope between two codes 1 apart at code 40: the curve's own bend.
    assert slope == pytest.approx(0.60, abs=0.01)


def test_true_force_stays_what_it_is_under_a_worn_sheet(write_scene: Write) -> None:
    text = scene("power", "[1, 5, 2]") + "[effects]\nsensor_hysteresis = true\nsensor_spread = true\n"
    plan = planning.load(write_scene(text))
    assert plan.force_n is not None
    assert plan.force_n.ravel().tolist() == [1, 5, 2]
    # Both effects are per cents; the default of a part in 1e5 is as good as any.
    assert not np.allclose(plan.resistance_ohm, plan.sensor.resistance_ohm(plan.force_n))


def test_the_way_back_reads_ten_percent_lower_and_the_way_up_is_the_law() -> None:
    force = np.concatenate([np.linspace(1, 10, 200), np.linspace(10, 1, 200)])
    ohm = INVERSE.resistance_ohm(column(force))
    got = aged(ohm, hysteresis=0.10)
    assert (got[:200] == ohm[:200]).all()
    back = got[230:] / ohm[230:]
    # The stop operator adds and subtracts logarithms up to 9: eight roundings of 1e-15.
    assert back == pytest.approx(0.9, rel=1e-12)  # (R+ - R-)/R+ = 10 %
    # Met with equality, up to the rounding of one product.
    assert ((got <= ohm) & (got >= 0.9 * ohm * (1 - 1e-15))).all()


def test_loops_close_whatever_the_speed_and_a_small_loop_is_forgotten() -> None:
    big = [1, 10, 1]
    slow = np.interp(np.linspace(0, 2, 401), range(3), big)
    inner = [1, 10, 4, 6, 4, 6, 1]
    ohm = lambda f: aged(INVERSE.resistance_ohm(column(f)), hysteresis=0.2).ravel()  # noqa: E731
    assert ohm(slow)[-1] == ohm(big)[-1] == ohm(inner)[-1]
    assert ohm([1, 10, 1, 10, 1])[2] == ohm([1, 10, 1, 10, 1])[4]
    assert ohm([0, 5, 0])[[0, 2]].tolist() == [np.inf, np.inf]  # let go, it is open again


def exact_decades(loaded: NDArray[np.bool_], t: float, start: float) -> list[float]:
    """The slow reference: every interval of load adds its own logarithm."""
    out = []
    for n in range(loaded.size):
        total = 0.0
        for m in range(n):
            if loaded[m]:
                total += math.log10((start + (n - m) * t) / (start + (n - m - 1) * t))
        out.append(total)
    return out


@settings(max_examples=20, deadline=None)
@given(
    loaded=st.lists(st.booleans(), min_size=1, max_size=120),
    t=st.sampled_from([125e-6, 2e-3, 32e-3, 10.0, 1e4]),
    start=st.sampled_from([1e-3, 10e-3, 1.0]),
)
def test_creep_is_the_sum_over_all_loads_before(loaded: list[bool], t: float, start: float) -> None:
    values = np.array(loaded)
    got = creep_decades(values.reshape(-1, 1, 1), t, start).ravel()
    # Time is kept in decades on a grid that is told to 1e-8 (sensor.creep_decades); 1e-9 of a decade at rest.
    assert got == pytest.approx(exact_decades(values, t, start), rel=1e-8, abs=1e-9)


def test_creep_is_forgotten_after_release_and_shows_at_the_next_touch() -> None:
    force = np.concatenate([np.full(500, 5.0), np.zeros(500), [5.0], np.zeros(20000), [5.0]])
    got = aged(INVERSE.resistance_ohm(column(force)), creep_per_decade=0.05).ravel()
    assert np.isinf(got[500:1000]).all()
    soon, late = 1500.0 / got[1000] - 1, 1500.0 / got[-1] - 1
    grown = 1500.0 / got[499] - 1
    # The same two logarithms; a millionth is a thousandth of the smallest effect that it could be confused
    # with.
    assert soon == pytest.approx(0.05 * (math.log10(1 + 2.0 / 0.01) - math.log10(1 + 1.0 / 0.01)), rel=1e-6)
    assert grown > 5 * soon > 5 * late > 0


def test_temperature_is_a_factor_on_every_conductance() -> None:
    ohm = column([0.0, 500.0, np.inf])
    assert aged(ohm, temperature_error=0.176).ravel() == pytest.approx([0.0, 500 / 1.176, np.inf])
    # 60 K above room temperature: 15 % less resistance (Interlink)
    tc = designs.load().sensor.tc_per_k
    # Interlink says 15 %: half a unit of the last digit.
    assert 1 - 1 / (1 + tc * 60) == pytest.approx(0.15, abs=0.005)


@pytest.mark.parametrize("relative", [0.02, 0.06, 0.9])
def test_spread_has_mean_one_and_the_stated_deviation_and_stays_positive(relative: float) -> None:
    draw = np.random.default_rng(1).standard_normal(1_000_000)
    factor = spread_factor(draw, relative)
    assert factor.min() > 0
    # Five standard deviations of the mean of a million, and of their spread the fourth moment of a lognormal
    # at 0.9.
    assert factor.mean() == pytest.approx(1.0, abs=5 * relative / 1000)
    assert factor.std() == pytest.approx(relative, rel=0.02)


def test_all_effects_together_are_the_product_of_each() -> None:
    ohm = INVERSE.resistance_ohm(column([1, 5, 2, 0.5, 8, 3, 0, 4]))
    state = SensorState(hysteresis=0.1, creep_per_decade=0.05, temperature_error=0.1, spread=0.06)
    together = age(INVERSE, ohm, 1.0, state, 10e-3, seeded)
    product = np.ones_like(ohm)
    for name in ("hysteresis", "creep_per_decade", "temperature_error", "spread"):
        alone = replace(SensorState(), **{name: getattr(state, name)})
        with np.errstate(invalid="ignore"):
            part = age(INVERSE, ohm, 1.0, alone, 10e-3, seeded) / ohm
        product *= np.where(np.isfinite(part), part, 1.0)
    # Products in another order: a few dozen roundings of 1.1e-16.
    assert together == pytest.approx(ohm * product, rel=1e-12)
