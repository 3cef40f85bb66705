# SPDX-License-Identifier: Apache-2.0
"""The array solved backwards: exact against the forward solve, and within its bound."""

import numpy as np
import pytest

from dermis.array.array import Network, column_currents
from dermis.decode import crosstalk
from tb.reference import nodal

SHAPES = [(1, 1), (1, 5), (6, 1), (4, 4), (7, 12), (16, 16)]


def network(rows: int, cols: int, **fields: object) -> Network:
    given = {"r_row_driven_ohm": 25.0, "r_row_grounded_ohm": 25.0, "r_column_ohm": 5.0}
    given["g_lateral_row_s"] = 1e-3
    return Network(np.zeros((rows, cols)), 0.5, **(given | fields))


def random_sheet(rng: np.random.Generator, frames: int, rows: int, cols: int) -> np.ndarray:
    """100 kohm to 500 ohm, a tenth of the taxels open."""
    g = 10 ** rng.uniform(-5, np.log10(2e-3), (frames, rows, cols))
    return np.where(rng.random(g.shape) < 0.1, 0.0, g)


def worst_relative(found: np.ndarray, g: np.ndarray) -> float:
    return float((np.abs(found - g) / np.maximum(g, 1e-6 * g.max(initial=1e-9))).max())


SOURCES = {"v_column_offset_v": 1e-3, "i_leak_a": 1e-6}
FIELDS = [
    {}, {"r_column_ohm": 0.0}, {"r_row_driven_ohm": 0.0, "r_row_grounded_ohm": 0.0}, {"r_row_grounded_ohm": np.inf},
    {"r_column_ohm": 50.0, "r_row_grounded_ohm": 3.0}, SOURCES,
]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fields", FIELDS)
def test_conductances_come_back_from_exact_currents(shape: tuple[int, int], fields: dict) -> None:
    rng = np.random.default_rng(1)
    g = random_sheet(rng, 3, *shape)
    net = network(*shape, **fields)
    solved = crosstalk.solve(net, column_currents(net, g))
    assert solved.converged.all()
    # The limit of decode.noise_free_error; 4e-14 is usual.
    assert worst_relative(solved.conductance_s, g) <= 1e-8


@pytest.mark.parametrize("shape", SHAPES)
def test_traces_are_taken_out_too(shape: tuple[int, int]) -> None:
    g = random_sheet(np.random.default_rng(2), 2, *shape)
    net = network(*shape, r_trace_row_ohm=0.2, r_trace_column_ohm=0.2, g_lateral_column_s=1e-3, **SOURCES)
    solved = crosstalk.solve(net, column_currents(net, g))
    assert solved.converged.all()
    # The stop test is relative to the largest current of a frame, 200 times that of the smallest taxel here.
    assert worst_relative(solved.conductance_s[g > 0], g[g > 0]) <= 1e-8
    assert np.abs(solved.conductance_s - g).max() <= 1e-11 * g.max()


def test_traces_are_taken_out_of_rounded_readings() -> None:
    """Rounding asks open taxels for less than nothing; the solve neither stops there nor winds up."""
    # Weights on column 4 as 8-bit codes, with the offsets that a fit of their sheet tried.
    read = np.tile([-3.6e-7, -2.7e-7, 1.07e-6, 3.23e-6, 0.0, 3.65e-6, -2.5e-7, -1.4e-19], (8, 1))
    read[:, 4] = [-8.8e-7, 3.2e-4, 3.8e-4, 5.4e-4, 3.6e-4, 5.0e-4, 5.3e-4, -8.8e-7]
    read[[0, 7], 3:6] = -7e-7, -8.8e-7, -1.7e-7
    read[3, [3, 5]] = 7.2e-6, 7.5e-6
    fields = {"r_row_driven_ohm": 0.0, "r_row_grounded_ohm": 0.0, "r_column_ohm": 1.66}
    fields |= {"g_lateral_row_s": 1.26e-3, "r_trace_row_ohm": 1e-3, "r_trace_column_ohm": 0.39}
    net = network(8, 8, **fields, v_column_offset_v=np.array([0, 0, 0, -3.2e-4, 2e-5, -3.2e-4, 0, 0]))
    assert crosstalk.solve(net, read[None]).converged.all()


def test_the_error_stays_within_the_proven_bound() -> None:
    rng = np.random.default_rng(3)
    for r_column in (0.0, 0.5, 5.0, 25.0):
        net = network(8, 8, r_column_ohm=r_column, **(SOURCES if r_column else {}))
        g = random_sheet(rng, 20, 8, 8)
        solved = crosstalk.solve(net, column_currents(net, g))
        error = np.abs(solved.conductance_s - g).sum(axis=(1, 2))
        assert np.isfinite(solved.error_s).all()
        assert (error <= solved.error_s).all()
        # The stop test leaves TOLERANCE, 1e-13 of the sum; the bound is within a hundred times that.
        assert (solved.error_s <= 1e-11 * g.sum(axis=(1, 2))).all()


def test_a_fully_pressed_array_converges_where_the_proof_ends() -> None:
    """All 256 at 500 ohm behind 100 ohm inputs: three times as much as the column's own taxels leave."""
    g = np.full((1, 16, 16), 1 / 500)
    net = network(16, 16, r_row_driven_ohm=1.0, r_row_grounded_ohm=1.0, r_column_ohm=100.0)
    solved = crosstalk.solve(net, column_currents(net, g))
    assert solved.converged.all()
    assert np.isinf(solved.error_s).all()
    # Without a bound the sweeps stop at TOLERANCE, 1e-13; the array stretches it by less than 1000.
    assert worst_relative(solved.conductance_s, g) <= 1e-10


def test_currents_of_the_nodal_reference_come_back() -> None:
    """The oracle in 60 digits shares nothing with the solver."""
    g = random_sheet(np.random.default_rng(6), 1, 3, 4)
    inputs_ohm = np.array([1.0, 2.0, 5.0, 0.0])
    net = Network(g[0], 0.5, 25.0, 10.0, inputs_ohm, 1e-3, g_lateral_row_s=1e-3, i_leak_a=1e-6)
    solved = crosstalk.solve(net, nodal.column_currents(net)[np.newaxis])
    # The forward and the nodal solve agree to 1e-12; the inverse stretches that by less than 100.
    assert worst_relative(solved.conductance_s, g) <= 1e-10


def test_shorts_and_open_taxels_have_defined_answers() -> None:
    g = np.full((1, 4, 4), 1e-3)
    g[0, 1, 2], g[0, 3, 0] = np.inf, 0.0
    net = network(4, 4, r_column_ohm=1.0)
    solved = crosstalk.solve(net, column_currents(net, g))
    assert np.isinf(solved.conductance_s[0, 1, 2])
    # Rounding of a column current: 1e-16 of 0.5 A through the short, over 0.5 V, a few hundred times.
    assert solved.conductance_s[0, 3, 0] == pytest.approx(0, abs=1e-13)
    others = np.isfinite(solved.conductance_s) & (g > 0)
    assert others.sum() == 14
    # Rounding of 0.5 A beside 0.5 mA, and SHORT_S for infinity: five digits of 1e-3 S.
    assert np.abs(solved.conductance_s[others] - 1e-3).max() < 1e-8


def test_currents_that_no_driver_delivers_are_a_short_and_noise_below_zero_is_open() -> None:
    net = network(2, 2)
    found = crosstalk.solve(net, np.array([[[0.03, 1e-4], [-1e-6, 1e-4]]])).conductance_s[0]
    assert np.isinf(found[0, 0])
    assert found[1, 0] == 0


def test_wrong_shapes_and_numbers_are_refused() -> None:
    net = network(2, 2)
    with pytest.raises(ValueError, match=r"\[frames, 2, 2\]"):
        crosstalk.solve(net, np.zeros((2, 2)))
    with pytest.raises(ValueError, match="finite"):
        crosstalk.solve(net, np.full((1, 2, 2), np.nan))
