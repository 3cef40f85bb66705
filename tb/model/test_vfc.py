# SPDX-License-Identifier: Apache-2.0
"""Charge balance: the closed formula against exact rationals, and beside the restarting law of eq. (3)."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis.converter.vfc import code, count, count_exact, count_rational, count_restarting

GATE = 510
HALF = Fraction(1, 2)
R_UNIT_OHM = 250  # V_b / (k i0): x = 250 ohm / R

rationals = st.fractions(min_value=0, max_value=HALF, max_denominator=10_000)


def test_every_code_comes_out_of_its_own_fraction_exactly() -> None:
    codes = np.arange(256)
    assert (code(codes / GATE) == codes).all()
    assert [count_exact(Fraction(int(c), GATE), GATE) for c in codes[::15]] == list(codes[::15])


@settings(max_examples=150, deadline=None)
@given(
    x=rationals,
    clocks=st.integers(1, 600),
    start=st.fractions(-1, Fraction(-1, 10**6), max_denominator=10**6),
)
def test_rational_formula_is_the_walk_from_any_start(x: Fraction, clocks: int, start: Fraction) -> None:
    assert count_rational(x, clocks, start) == count_exact(x, clocks, start)


@settings(max_examples=300, deadline=None)
@given(x=st.floats(0, 3, allow_subnormal=False))
def test_float_formula_differs_from_the_walk_only_beside_a_threshold(x: float) -> None:
    exact = count_exact(x, GATE)
    beside = abs((Fraction(GATE) * Fraction(x) + HALF) - round(Fraction(GATE) * Fraction(x) + HALF))
    if beside > Fraction(math.ulp(GATE * x)):
        assert int(count(x)) == exact
    else:
        # A double cannot tell which side of the threshold: one count.
        assert abs(int(count(x)) - exact) <= 1


sixteenths = st.integers(-80, 80).map(lambda n: Fraction(n, 16))


@settings(max_examples=600, deadline=None)
@given(
    x=st.integers(-60, 130).map(lambda n: Fraction(n, 64)),
    clocks=st.integers(1, 40),
    w0=sixteenths,
    packet=st.integers(1, 40).map(lambda n: Fraction(n, 16)),
    threshold=sixteenths,
)
def test_formula_is_the_walk_from_packets_above_and_below_the_threshold(
    x: Fraction, clocks: int, w0: Fraction, packet: Fraction, threshold: Fraction
) -> None:
    # All exact in doubles, ties included: any x, negative and far above half a packet.
    got = count(*(float(v) if v is not clocks else v for v in (x, clocks, w0, packet, threshold)))
    assert int(got) == count_exact(x, clocks, w0, packet, threshold)


def test_shorts_and_negative_infinity_have_a_count_from_any_start() -> None:
    assert (count([np.inf, -np.inf, 0.0, -1e300, 0.0], w0=[-9, 9, 9, 9, -0.5]) == [255, 0, 10, 0, 0]).all()
    assert list(code([0.0, -0.0, -1.0, -np.inf, np.inf, 1e-300])) == [0, 0, 0, 0, 255, 0]
    with pytest.raises(ValueError, match="not a number"):
        count(np.nan)


@pytest.mark.filterwarnings("error")
def test_one_taxel_with_a_packet_of_its_column_is_counted_in_silence() -> None:
    assert count(np.full((1, 1, 1), 0.1), 510, packet=np.ones(1)).tolist() == [[[51]]]


def test_charge_left_over_by_a_short_is_counted_in_the_next_row_unless_preset() -> None:
    x_hard, x_soft = Fraction(R_UNIT_OHM, 312), Fraction(2, GATE)
    left = -HALF + GATE * x_hard - count_exact(x_hard, GATE)
    assert count_exact(x_soft, GATE, w0=left) > 100
    assert count_exact(x_soft, GATE, w0=min(left, HALF)) == 3
    assert count_exact(x_soft, GATE) == 2


def test_512_clocks_overflow_8_bits_and_510_do_not_whatever_the_phase() -> None:
    starts = [Fraction(-i, 64) for i in range(1, 65)]
    assert {count_exact(HALF, 512, w0=w0) for w0 in starts} == {256}
    assert {count_exact(HALF, 510, w0=w0) for w0 in starts} == {255}
    assert {count_exact(HALF, 511, w0=w0) for w0 in starts} == {255, 256}


def test_restarting_law_has_43_codes_and_misses_85_counts_just_above_500_ohm() -> None:
    r_ohm = np.concatenate([np.arange(500.0, 64251.0), np.linspace(500.001, 510.0, 2000)])
    restarting = count_restarting(R_UNIT_OHM / r_ohm, 512)
    balance = count(R_UNIT_OHM / r_ohm, 512)
    assert len(np.unique(np.minimum(restarting, 255))) == 43
    assert len(np.unique(code(R_UNIT_OHM / r_ohm))) > 250
    worst = np.argmax(np.abs(restarting - balance))
    assert abs(int(restarting[worst]) - int(balance[worst])) == 85
    assert 500 < r_ohm[worst] < 503


def test_the_two_laws_agree_where_the_resistance_is_a_multiple_of_250_ohm() -> None:
    for n in range(2, 257):
        from_threshold = count_exact(Fraction(1, n), 512, w0=Fraction(-1, n))
        assert int(count_restarting(R_UNIT_OHM / (250.0 * n), 512)) == from_threshold
