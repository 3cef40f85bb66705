# SPDX-License-Identifier: Apache-2.0
"""The array solve against the full nodal matrix, against published tables, and at its edges."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis.array.array import Network, column_currents
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

EVERYTHING: dict[str, Any] = {
    "r_row_driven_ohm": 1.0,
    "r_row_grounded_ohm": 3.0,
    "r_column_ohm": 0.5,
    "g_lateral_row_s": 1e-3,
    "g_lateral_column_s": 2e-3,
    "r_trace_row_ohm": 0.3,
    "r_trace_column_ohm": 0.2,
}

series_ohm = st.sampled_from([0.0, 0.0, 0.05, 1.0, 50.0, 1e4])
trace_ohm = st.sampled_from([0.0, 1e-6, 0.1, 1.0, 100.0, 1e4])


@st.composite
def networks(draw: st.DrawFn, sources: bool) -> Network:
    """Random networks of up to 4x4 with opens and shorts; `sources`: also offsets and leaks."""
    rows, cols = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e7), (rows, cols)))
    g[rng.random((rows, cols)) < draw(st.sampled_from([0, 0.3]))] = 0.0
    driven, grounded = draw(series_ohm), draw(st.one_of(series_ohm, st.just(np.inf)))
    r_column = np.array([draw(series_ohm) for _ in range(cols)])
    trace_row, trace_column = draw(trace_ohm), draw(trace_ohm)
    # a short between two fixed voltages has no answer
    if (min(driven, grounded) + trace_row > 0) and (r_column + trace_column > 0).all():
        g[rng.random((rows, cols)) < draw(st.sampled_from([0, 0.2]))] = np.inf
    return Network(
        g,
        0.5,
        driven,
        grounded,
        r_column,
        rng.choice([0.0, 1e-3, -2e-3], cols) if sources else 0.0,
        draw(st.sampled_from([0.0, 1e-3, 1.0])),
        draw(st.sampled_from([0.0, 1e-3, 1.0])),
        trace_row,
        trace_column,
        rng.choice([0.0, 1e-9, -1e-6], cols) if sources else 0.0,
    )


@settings(max_examples=40, deadline=None)
@given(network=networks(sources=False))
def test_every_current_is_that_of_the_full_nodal_matrix_to_1e_12(network: Network) -> None:
    reference = nodal.column_currents(network)
    # 1e-25 A: what a held row lets through where 1e30 S stand for no resistance
    # 1e-12 is what the solver promises (docs/array.md); 1e-25 A is a rounding where all currents are 0.
    assert (np.abs(column_currents(network) - reference) <= 1e-12 * np.abs(reference) + 1e-25).all()


@settings(max_examples=40, deadline=None)
@given(network=networks(sources=True))
def test_offsets_and_leaks_are_right_to_the_size_of_what_cancels(network: Network) -> None:
    reference = nodal.column_currents(network)
    # Offsets drive currents round through two columns, which cancel where they meet.
    with np.errstate(divide="ignore"):
        g_end = 1 / (network.r_column_ohm + network.r_trace_column_ohm)
    g_loop = np.where(np.isfinite(g_end), g_end, 0.0).max() + network.rows * network.g_lateral_row_s
    g_loop += np.minimum(network.g_taxel_s, 1e3).sum()
    size = np.abs(reference).max() + np.abs(network.v_column_offset_v).max() * g_loop
    # 1e-12 is what the solver promises (docs/array.md); 1e-25 A is a rounding where all currents are 0.
    assert (np.abs(column_currents(network) - reference) <= 1e-12 * size + 1e-25).all()


@pytest.mark.parametrize(
    ("shape", "off"),
    [
        ((8, 8), {}),
        # Wider than a panel, and than a few blocks of eight nodes.
        ((3, 70), {"r_trace_row_ohm": 0.0, "r_trace_column_ohm": 0.0}),
        ((2, 45), {}),
        pytest.param((16, 16), {}, marks=pytest.mark.long),
    ],
)
def test_a_frame_with_everything_is_the_nodal_matrix(shape: tuple[int, int], off: dict[str, float]) -> None:
    network = Network(1 / np.random.default_rng(3).uniform(500, 64250, shape), 0.5, **EVERYTHING | off)
    slot = shape[0] // 2
    reference = nodal.column_currents(network, digits=25, slots=[slot])[0]
    # Thirteen digits are left of the solver's own; nothing cancels here.
    assert column_currents(network)[slot] == pytest.approx(reference, rel=1e-13)


def test_published_table_2a_is_met() -> None:
    for rs, published in TABLE_2A.items():
        for r_ohm, percent in zip(TAXEL_OHM, published, strict=True):
            g = np.full((8, 8), 1 / 5000)
            g[3, 4] = 1 / r_ohm
            current = column_currents(Network(g, 1.0, rs, rs, rs))[3, 4]
            # The limit of array.table2a_error_pp: the authors' amplifier takes up to 0.06 at 10 kohm.
            assert abs((1 / current / r_ohm - 1) * 100 - percent) < 0.08


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


def test_a_row_of_shorts_does_not_underflow() -> None:
    g = np.full((3, 24), np.inf)
    g[1] = 1e-3
    currents = column_currents(Network(g, 0.5, **EVERYTHING))
    assert np.isfinite(currents).all()
    # Two rows of shorts see the same drivers but for a part of the 24 traces: alike, not equal.
    assert currents[0].sum() == pytest.approx(currents[2].sum(), rel=0.2)
    assert currents[0, 0] > 1e3 * currents[0, 23] > 0  # the first column takes it


def test_frames_together_are_frames_one_by_one_with_lines() -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (5, 4, 6))
    network = Network(g[0], 0.5, **EVERYTHING, v_column_offset_v=1e-3)
    together = column_currents(network, g)
    for frame in range(5):
        alone = column_currents(dataclasses.replace(network, g_taxel_s=g[frame]))
        # What the solver promises (docs/array.md): frames share no number.
        assert together[frame] == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize(
    "kind",
    [
        {"r_column_ohm": -1.0},
        {"r_row_driven_ohm": np.inf},
        {"r_row_grounded_ohm": -1.0},
        {"g_lateral_row_s": np.inf},
        {"r_trace_row_ohm": -1.0},
        {"r_trace_column_ohm": np.inf},
        {"i_leak_a": np.nan},
        {"v_column_offset_v": np.inf},
        {"c_taxel_f": -1e-12},
        {"c_row_f": np.inf},
    ],
)
def test_impossible_networks_are_refused(kind: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        Network(np.ones((2, 2)), 0.5, **kind)
    for conductance in (np.nan, -1.0):
        with pytest.raises(ValueError, match="0 or above"):
            column_currents(Network(np.ones((2, 2)), 0.5, 1.0), np.full((1, 2, 2), conductance))
