# SPDX-License-Identifier: Apache-2.0
"""The table of the chip: transitions against every code of a fine ramp, and known curves."""

import dataclasses
import math

import numpy as np
import pytest

from dermis import engines
from dermis.scene.extracted import CIRCUIT
from scripts import chip_table
from scripts.characterise.runs import TYPICAL
from scripts.schematics.command import parse, written

IDEAL = np.arange(255) + 0.5


def test_an_ideal_converter_has_its_bits_and_no_error() -> None:
    inl, dnl, bits = chip_table.static(IDEAL, 0.0)
    # Sums of 255 numbers of size 255 in doubles.
    assert (inl, dnl, bits) == pytest.approx((0.0, 0.0, 8.0), abs=1e-12)
    gain, offset = chip_table.line(IDEAL / 1.01 + 0.2)
    # The same sums.
    assert (gain, offset) == pytest.approx((1.01, -0.202), abs=1e-12)
    assert chip_table.static(IDEAL, 1.0 / math.sqrt(12.0))[2] == pytest.approx(7.5)


def test_a_bow_and_a_wide_code_are_found() -> None:
    bow = 0.4 * (1.0 - ((IDEAL - 127.5) / 127.0) ** 2)
    # Half a code on either side of the middle, where the bow is 6e-6 lower.
    assert chip_table.static(IDEAL + bow, 0.0)[0] == pytest.approx(0.4, abs=1e-4)
    wide = IDEAL + np.where(IDEAL > 100.0, 0.3, 0.0)
    # Less the gain that it makes, 0.3 / 254.
    assert chip_table.static(wide, 0.0)[1] == pytest.approx(0.3, abs=2e-3)


@pytest.mark.parametrize(("k", "cols"), [(80, 1), (160, 16)])
def test_transitions_are_those_of_a_fine_ramp(k: int, cols: int) -> None:
    """Every code of a ramp of 8 192 conductances lies between its own transitions, but close to one of them.

    A late comparator lets a code go back by one within a seventh of a step, so which of its edges bisection finds is
    open (docs/datasheet.md).
    """
    made = chip_table.chip(TYPICAL, k, cols)
    at = chip_table.transitions(made, k)
    ramp = np.linspace(0.5, 250.0, 8192) * chip_table.step_s(k)
    ohm = np.broadcast_to((1.0 / ramp)[:, None, None], (ramp.size, 1, cols))
    codes = engines.run(dataclasses.replace(made, resistance_ohm=ohm)).codes[:, 0, 0]
    apart = codes.astype(int) - np.searchsorted(at, ramp, side="right")
    assert np.isfinite(at).all()
    # Back by one, no more, next to its own transition.
    assert np.abs(apart).max() <= 1
    away = np.abs(ramp[:, None] - at).min(axis=1) / chip_table.step_s(k)
    assert away[apart != 0].max() < 0.15


def test_decoding_takes_out_what_a_row_does_and_nothing_else() -> None:
    made = chip_table.chip(TYPICAL, 80, 16)
    one = chip_table.transitions(chip_table.chip(TYPICAL, 80, 1), 80) / chip_table.step_s(80)
    row = chip_table.transitions(made, 80) / chip_table.step_s(80)
    raw, after = (chip_table.static(at, 0.0)[0] for at in (row, chip_table.decoded(made, 80, row, one)))
    assert raw > 1.0
    assert after < 0.2
    # With the network of one taxel nothing of the row is taken out.
    alone = chip_table.chip(TYPICAL, 80, 1)
    assert chip_table.static(chip_table.decoded(alone, 80, row, one), 0.0)[0] > 1.0


def test_an_area_is_the_sum_of_what_is_drawn() -> None:
    text = written() | parse(
        ".subckt twice a b vdd vss params: n=2\n"
        "xn a b vss vss nmos w=3 l=2 k={n}\n"
        "xr a b vss sky130_fd_pr__res_xhigh_po w=0.69 l=10 m=4 mult=4\n"
        "xs a b vdd vss vss inverter k={n*2}\n.ends twice\n",
        CIRCUIT,
    )
    # The inverter has 2 x 0.5 and 4 x 0.5 um, four times.
    assert chip_table.area_um2(text, "twice", {"n": 5}) == pytest.approx(3 * 2 * 5 + 0.69 * 10 * 4 + 10 * 3.0)
