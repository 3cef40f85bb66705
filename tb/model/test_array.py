# SPDX-License-Identifier: Apache-2.0
"""The array solve against the full nodal matrix, against published tables, and at its edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dermis.array import array as array_module
from dermis.array.array import Network, column_currents
from dermis.errors import SimulatorError
from tb.reference import nodal

# Hidalgo-Lopez et al., J. Sensors 2018, 9735741, Table 2(a): error of V/I in % of one taxel in an 8x8 array
# of 5 kohm, every row and column behind Rs. Rows: Rs. Columns: the taxel.
TAXEL_OHM = (100, 500, 2000, 5000, 7500, 10000)
TABLE_2A = {
    1: (2.28, 0.68, 0.37, 0.29, 0.26, 0.24),
    2: (4.57, 1.36, 0.75, 0.61, 0.57, 0.54),
    4: (9.17, 2.73, 1.51, 1.25, 1.18, 1.13),
    6: (13.79, 4.10, 2.27, 1.89, 1.79, 1.73),
    9: (20.76, 6.17, 3.42, 2.85, 2.70, 2.62),
    15: (34.86, 10.35, 5.73, 4.77, 4.52, 4.38),
    20: (46.77, 13.87, 7.67, 6.36, 6.03, 5.84),
    25: (58.82, 17.42, 9.61, 7.96, 7.54, 7.29),
}

# Independently computed: counts of 256 left behind a series resistance, all 256 taxels at 500 ohm, or one
# with the others at the 10 Mohm of an unloaded FSR.
SERIES_TABLE = {
    0.05: (255.59, 255.97),
    0.5: (251.97, 255.74),
    1: (248.06, 255.49),
    5: (220.69, 253.46),
    50: (98.46, 232.71),
}

series_ohm = st.sampled_from([0.0, 0.0, 0.05, 0.5, 1.0, 5.0, 50.0, 1e4])
offset_v = st.sampled_from([0.0, 0.0, 1e-3, -2e-3, 0.3])


@st.composite
def networks(draw: st.DrawFn, shorts: bool = True) -> Network:
    """Random networks: any size, opens and shorts, every field on or off."""
    rows, cols = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e7), (rows, cols)))
    g[rng.random((rows, cols)) < draw(st.sampled_from([0, 0.3]))] = 0.0
    driven = draw(series_ohm)
    r_column = np.array([draw(series_ohm) for _ in range(cols)])
    offset = np.array([draw(offset_v) for _ in range(cols)])
    if shorts and driven > 0 and (r_column > 0).all():
        g[rng.random((rows, cols)) < 0.2] = np.inf
    grounded = draw(st.one_of(series_ohm, st.just(np.inf)))
    if not np.isfinite(g).all() and grounded == 0.0:
        grounded = 2.0  # a short between two fixed voltages has no answer
    return Network(g, 0.5, driven, grounded, r_column, offset, draw(st.sampled_from([0.0, 1e-3, 1.0])))


def assert_same(fast: NDArray[np.float64], slow: NDArray[np.float64], network: Network) -> None:
    # What is lost is counted against the currents that add up in a column: offsets cancel by nature.
    size = np.abs(slow) + np.abs(network.v_column_offset_v).max() * np.minimum(network.g_taxel_s, 1e3).sum()
    with np.errstate(divide="ignore"):
        g_column = np.where(network.r_column_ohm > 0, 1 / network.r_column_ohm, 0.0)
    g_size = network.rows * network.g_lateral_row_s + g_column.max()
    size = size + np.abs(network.v_column_offset_v).max() * g_size
    # 1e-12 of the currents is what the solver promises (docs/array.md); 1e-30 A where all of them are 0.
    assert (np.abs(fast - slow) <= 1e-12 * size + 1e-30).all(), (fast, slow)


@settings(max_examples=100, deadline=None)
@given(network=networks())
def test_solve_is_the_full_nodal_matrix_to_1e_12(network: Network) -> None:
    assert_same(column_currents(network), nodal.column_currents(network), network)


def test_solve_is_the_full_nodal_matrix_on_16x16_with_everything_on() -> None:
    rng = np.random.default_rng(3)
    g = 1 / rng.uniform(500, 64250, (16, 16))
    r_column = rng.uniform(0.1, 5, 16)
    for offset, elementwise in ((0.0, True), (1e-3 * rng.standard_normal(16), False)):
        network = Network(g, 0.5, 1.0, 3.0, r_column, offset, 1e-3, 1e-3)
        reference = nodal.column_currents(network, digits=30)
        size = np.abs(reference) if elementwise else np.abs(reference).max()
        # What the solver promises (docs/array.md).
        assert (np.abs(column_currents(network) - reference) / size).max() < 1e-12


def test_published_table_2a_is_met() -> None:
    for rs, published in TABLE_2A.items():
        for r_ohm, percent in zip(TAXEL_OHM, published, strict=True):
            g = np.full((8, 8), 1 / 5000)
            g[3, 4] = 1 / r_ohm
            current = column_currents(Network(g, 1.0, rs, rs, rs))[3, 4]
            # The limit of array.table2a_error_pp: the authors' amplifier takes up to 0.06 at 10 kohm.
            assert abs((1 / current / r_ohm - 1) * 100 - percent) < 0.08


@pytest.mark.parametrize("place", ["row_driver", "column_input"])
@pytest.mark.parametrize("r_ohm", SERIES_TABLE)
def test_series_resistance_costs_the_counts_computed_elsewhere(r_ohm: float, place: str) -> None:
    series = (
        {"r_row_driven_ohm": r_ohm, "r_row_grounded_ohm": r_ohm}
        if place == "row_driver"
        else {"r_column_ohm": r_ohm}
    )
    one = np.full((16, 16), 1e-7)
    one[5, 9] = 1 / 500
    for g, counts in zip((np.full((16, 16), 1 / 500), one), SERIES_TABLE[r_ohm], strict=True):
        current = column_currents(Network(g, 1.0, **series))[5, 9]
        # The table has two decimals: half a unit of the last, and rounding.
        assert abs(256 * 500 * current - counts) <= 0.0051


def test_lateral_resistors_alone_change_nothing_and_are_not_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    g = 1 / np.random.default_rng(0).uniform(500, 64250, (6, 7))
    monkeypatch.setattr(array_module, "_solve", lambda *_: pytest.fail("there was a solve"))
    alone = Network(g, 0.5, g_lateral_row_s=1e-3, g_lateral_column_s=1e-3)
    assert (column_currents(alone) == 0.5 * g).all()
    assert alone.active_fields() == {"g_lateral_row_s", "g_lateral_column_s"}


def test_lateral_resistors_spread_a_touch_once_columns_are_real() -> None:
    g = np.zeros((16, 16))
    g[5, 8] = 1 / 500
    currents = column_currents(Network(g, 0.5, r_column_ohm=5.0, g_lateral_row_s=1e-3))
    lsb = 0.5 / 250 / 510
    # One resistor between two columns makes 1.2 LSB; here every one of 16 rows has one.
    assert currents[5, 7] / lsb > 10 * currents[5, 6] / lsb > 0
    assert currents[5, 7] == pytest.approx(currents[5, 9], rel=1e-12)
    one_row = column_currents(Network(g[5:6], 0.5, r_column_ohm=5.0, g_lateral_row_s=1e-3))
    # 1.2 LSB by an independent solver: one decimal, and the neighbour's own loss.
    assert one_row[0, 7] / lsb == pytest.approx(1.2, abs=0.1)


def test_unequal_row_drivers_cost_no_second_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    eliminate = array_module._eliminate
    monkeypatch.setattr(array_module, "_eliminate", lambda *a: calls.append(1) or eliminate(*a))
    g = 1 / np.random.default_rng(0).uniform(500, 64250, (16, 16))
    column_currents(Network(g, 0.5, 1.0, 50.0, 0.5))
    assert len(calls) == 1


def test_offset_of_a_column_adds_its_share_of_all_rows() -> None:
    g = 1 / np.random.default_rng(0).uniform(500, 64250, (16, 4))
    v = np.array([1e-3, 0, -2e-3, 5e-4])
    with_offset = column_currents(Network(g, 0.5, v_column_offset_v=v))
    # The bias cancels: what is left is 1e-4 of it, so 1e-9 are some hundred roundings; 1e-18 A where no
    # offset is.
    assert with_offset - 0.5 * g == pytest.approx(np.tile(-v * g.sum(axis=0), (16, 1)), rel=1e-9, abs=1e-18)
    # 1 mV on a fully pressed column of 16 is 8 codes
    pressed = column_currents(Network(np.full((16, 1), 1 / 500), 0.5, v_column_offset_v=-1e-3))
    assert (pressed[0, 0] - 1e-3) / (0.5 / 250 / 510) == pytest.approx(8.16, abs=0.01)  # the last digit


def test_floating_rows_ghost_only_where_columns_are_real() -> None:
    g = np.zeros((2, 2))
    g[0, 0] = g[0, 1] = g[1, 1] = 1e-3  # three corners of a square: the fourth is the ghost
    for r_column, ghost in ((0.0, False), (50.0, True)):
        floating = column_currents(Network(g, 0.5, 0.0, np.inf, r_column))
        grounded = column_currents(Network(g, 0.5, 0.0, 0.0, r_column))
        # An open taxel beside grounded rows: nothing flows; 1e-18 A is a rounding of the 0.5 mA beside it.
        assert grounded[1, 0] == pytest.approx(0.0, abs=1e-18)
        assert (floating[1, 0] > 1e-6) == ghost


def test_shorts_and_opens_have_answers() -> None:
    g = np.array([[np.inf, 1e-3], [0.0, np.inf]])
    assert (column_currents(Network(g, 0.5)) == 0.5 * g).all()
    series = column_currents(Network(g, 0.5, 1.0, 1.0, 1.0))
    assert np.isfinite(series).all()
    alone = column_currents(Network(np.array([[np.inf]]), 0.5, 1.0, 1.0, 1.0))
    # What the solver promises (docs/array.md).
    assert alone[0, 0] == pytest.approx(0.25, rel=1e-12)
    assert column_currents(Network(np.zeros((3, 2)), 0.5, 1.0, np.inf, 0.5)) == pytest.approx(
        np.zeros((3, 2))
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 16)])
def test_single_rows_and_columns_solve(shape: tuple[int, int]) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, shape)
    network = Network(g, 0.5, 2.0, 1.0, 0.7, 1e-4, 1e-3)
    assert_same(column_currents(network), nodal.column_currents(network), network)


def test_frames_together_are_frames_one_by_one() -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (5, 4, 6))
    kind = {"r_row_driven_ohm": 1.0, "r_row_grounded_ohm": 2.0, "r_column_ohm": 0.5, "g_lateral_row_s": 1e-3}
    together = column_currents(Network(g[0], 0.5, **kind), g)
    for frame in range(5):
        # The same operations in another order of frames: a few dozen roundings.
        assert together[frame] == pytest.approx(column_currents(Network(g[frame], 0.5, **kind)), rel=1e-14)


def test_a_wrong_solution_is_caught_by_kirchhoff() -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (1, 3, 4))
    link, leak, drive = np.zeros((1, 4, 4)), np.ones((1, 4)), g.transpose(0, 2, 1)
    array_module._check_kirchhoff(link, leak, drive, drive, 1e-12)
    with pytest.raises(SimulatorError, match="Kirchhoff"):
        array_module._check_kirchhoff(link, leak, drive, drive * (1 + 1e-6), 1e-12)


@pytest.mark.parametrize(
    "kind",
    [
        {"r_column_ohm": -1.0},
        {"r_row_driven_ohm": np.inf},
        {"r_row_driven_ohm": -1.0},
        {"r_row_grounded_ohm": -1.0},
        {"g_lateral_row_s": np.inf},
    ],
)
def test_impossible_networks_are_refused(kind: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        Network(np.ones((2, 2)), 0.5, **kind)
