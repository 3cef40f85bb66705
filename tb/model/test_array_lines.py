# SPDX-License-Identifier: Apache-2.0
"""The array solve with resistance along the lines and leaks, and on arrays too large for many digits."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from dermis.array import array as array_module
from dermis.array import star_mesh
from dermis.array.array import Network, column_currents
from dermis.errors import SimulatorError
from tb.reference import nodal

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


@pytest.mark.parametrize("left_out", ["", "r_trace_row_ohm", "r_trace_column_ohm"])
def test_one_slot_of_6x6_with_everything_on_is_the_full_nodal_matrix(left_out: str) -> None:
    g = 1 / np.random.default_rng(3).uniform(500, 64250, (6, 6))
    network = Network(g, 0.5, **{k: v for k, v in EVERYTHING.items() if k != left_out})
    reference = nodal.column_currents(network, digits=25, slots=[5])[0]
    # Thirteen digits are left of the solver's own; nothing cancels here.
    assert column_currents(network)[5] == pytest.approx(reference, rel=1e-13)


def sparse_currents(network: Network, driven: int) -> NDArray[np.float64]:
    """One slot from the nodal matrix of the reference, in double precision; column inputs must be real."""
    elements, known, injected = nodal.elements(network, driven, float)
    nodes = sorted({n for a, b, _ in elements for n in (a, b) if n not in known}, key=str)
    place = {n: i for i, n in enumerate(nodes)}
    right = np.zeros(len(nodes))
    for n, current in injected.items():
        right[place[n]] += float(current)
    row, column, value = [], [], []
    for a, b, exact in elements:
        g = float(exact)
        for here, there in ((a, b), (b, a)):
            if here in place:
                row.append(place[here]), column.append(place[here]), value.append(g)
                if there in place:
                    row.append(place[here]), column.append(place[there]), value.append(-g)
                else:
                    right[place[here]] += g * float(known[there])
    matrix = sparse.csc_matrix((value, (row, column)), shape=(len(nodes), len(nodes)))
    solver = splu(matrix)
    voltage = solver.solve(right)
    voltage += solver.solve(right - matrix @ voltage)
    at_input = np.array([voltage[place["column", c]] for c in range(network.cols)])
    return (at_input - network.v_column_offset_v) / network.r_column_ohm


@pytest.mark.parametrize("lines", [True, False])
def test_arrays_wider_than_a_panel_are_the_sparse_nodal_matrix(lines: bool) -> None:
    rng = np.random.default_rng(4)
    kind = EVERYTHING | {"v_column_offset_v": 1e-4 * rng.standard_normal(140), "i_leak_a": 1e-8}
    if not lines:
        kind |= {"r_trace_row_ohm": 0.0, "r_trace_column_ohm": 0.0}
    network = Network(1 / rng.uniform(500, 64250, (20, 140)), 0.5, **kind)
    assert network.cols > 2 * array_module._PANEL
    currents = column_currents(network)
    for driven in (0, 8, 19):
        # The peer in doubles, refined once: 1e-14 A are 1e-11 of the largest current, its own rounding times
        # the condition.
        assert np.abs(currents[driven] - sparse_currents(network, driven)).max() < 1e-14


def test_lines_of_little_resistance_are_nodes() -> None:
    g = 1 / np.random.default_rng(5).uniform(500, 64250, (6, 5))
    nodes = EVERYTHING | {"r_trace_row_ohm": 0.0, "r_trace_column_ohm": 0.0}
    ideal = column_currents(Network(g, 0.5, **nodes))
    for row, column in ((1e-12, 0.0), (0.0, 1e-12), (1e-12, 1e-12)):
        lines = nodes | {"r_trace_row_ohm": row, "r_trace_column_ohm": column}
        # 24 elements of 1e-12 ohm beside 500 ohm change a current by 1e-13; twelve of them in a line, both
        # ways.
        assert column_currents(Network(g, 0.5, **lines)) == pytest.approx(ideal, rel=1e-11)


def test_steep_and_mild_row_lines_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    g = 1 / np.random.default_rng(5).uniform(500, 64250, (2, 6, 9))
    network = Network(g[0], 0.5, **EVERYTHING | {"r_trace_column_ohm": 0.0})
    mild = column_currents(network, g)
    monkeypatch.setattr(array_module, "_PRODUCT_MIN", np.inf)
    monkeypatch.setattr(array_module._RowLines, "_between_steep", spy := Spy(array_module._RowLines))
    # The same sums grouped in another way: a few dozen roundings.
    assert column_currents(network, g) == pytest.approx(mild, rel=1e-14)
    assert spy.calls


class Spy:
    """Counts the calls of the stepwise method and lets them through."""

    def __init__(self, owner: type) -> None:
        self.method, self.calls = owner._between_steep, 0  # type: ignore[attr-defined]

    def __get__(self, instance: Any, owner: type) -> Any:
        self.calls += 1
        return self.method.__get__(instance, owner)


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


def test_a_leak_into_an_ideal_column_only_adds() -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (3, 4))
    leak = np.array([1e-9, 0.0, -1e-6, 3e-9])
    # One sum: a few roundings of 1.1e-16.
    assert column_currents(Network(g, 0.5, i_leak_a=leak)) == pytest.approx(0.5 * g + leak, rel=1e-15)


@pytest.mark.parametrize("left_out", ["", "r_trace_column_ohm"])
def test_currents_by_source_are_those_without_bias_and_without_the_rest(left_out: str) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (2, 3, 4))
    kind = {k: v for k, v in EVERYTHING.items() if k != left_out}
    sources = {"v_column_offset_v": np.array([1e-3, 0, -2e-3, 1e-4]), "i_leak_a": 1e-7}
    driven, rest = array_module.column_currents_by_source(Network(g[0], 0.5, **kind, **sources), g)
    # Superposition in doubles: two solves, each to its own rounding.
    assert driven == pytest.approx(column_currents(Network(g[0], 0.5, **kind), g), rel=1e-13)
    assert rest == pytest.approx(column_currents(Network(g[0], 0.0, **kind, **sources), g), rel=1e-13)
    assert array_module.column_currents_by_source(Network(g[0], 0.5, **kind), g)[1] is None


def test_traces_cost_the_far_taxel_more() -> None:
    g = np.full((16, 16), 1 / 500)
    currents = column_currents(Network(g, 0.5, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1))
    # the shortest way is from the last row (next to the inputs) through the first column (next to the drivers)
    assert currents[15, 0] == currents.max()
    assert currents[0, 15] == currents.min()
    one = column_currents(Network(np.array([[1e-3]]), 0.5, r_trace_row_ohm=100.0, r_trace_column_ohm=200.0))
    # One division: a few roundings of 1.1e-16.
    assert one[0, 0] == pytest.approx(0.5 / 1300, rel=1e-15)


@pytest.mark.parametrize("fault", ["one node", "one drive"])
def test_a_wrong_elimination_is_caught(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (2, 6, 5))
    check = array_module._check_kirchhoff

    def broken(link: Any, leak: Any, drive: Any, v: Any, most: float) -> Any:
        if fault == "one node":
            v[0, 2] *= 1 + 1e-7
        else:
            v[1, :, 3] *= 1 + 1e-7
        return check(link, leak, drive, v, most)

    monkeypatch.setattr(array_module, "_check_kirchhoff", broken)
    with pytest.raises(SimulatorError, match="Kirchhoff"):
        column_currents(Network(g[0], 0.5, **EVERYTHING | {"r_trace_column_ohm": 0.0}), g)


@pytest.mark.parametrize("fault", ["one element", "every second", "none"])
def test_a_wrong_block_of_the_chain_is_caught(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (2, 6, 5))
    invert, calls = star_mesh._invert.py_func, []

    def broken(work: Any, pivot: Any, weights: Any, out: Any) -> None:
        calls.append(1)
        invert(work, pivot, weights, out)
        if fault == "one element" and len(calls) == 9:
            out[3, 3] *= 1 + 1e-6
        elif fault == "every second" and len(calls) % 2:
            out *= 1 + 1e-7

    # the compiled steps run as plain Python here
    monkeypatch.setattr(star_mesh, "_invert", broken)
    monkeypatch.setattr(star_mesh, "chain", star_mesh.chain.py_func)
    network = Network(g[0], 0.5, **EVERYTHING)
    if fault == "none":
        column_currents(network, g)
    else:
        with pytest.raises(SimulatorError, match="Kirchhoff"):
            column_currents(network, g)
    assert len(calls) == 12


@pytest.mark.parametrize("place", ["lift", "away", "no number"])
def test_a_wrong_slot_is_caught(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (2, 6, 5))
    chain = star_mesh.chain

    def broken(*arguments: Any) -> float:
        miss = chain(*arguments)
        lift, away = arguments[10:12]
        # the lift of a driver's node counts little beside the bias
        if place == "lift":
            lift[1, 4] *= 1.01
        else:
            away[1, 4] *= np.nan if place == "no number" else 1 + 1e-7
        return miss

    monkeypatch.setattr(star_mesh, "chain", broken)
    with pytest.raises(SimulatorError, match="slot of a row"):
        column_currents(Network(g[0], 0.5, **EVERYTHING), g)


@pytest.mark.parametrize("shape", [(1, 4), (4, 1), (6, 5), (16, 16)])
def test_rows_above_a_driven_one_need_no_solution(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]
) -> None:
    g = 1 / np.random.default_rng(2).uniform(500, 64250, (3, *shape))
    network = Network(g[0], 0.5, **EVERYTHING | {"v_column_offset_v": 1e-3, "i_leak_a": 1e-9})
    short = array_module.column_currents_by_source(network, g)
    # Every slot is solved in all rows where residuals are asked for.
    monkeypatch.setattr(array_module, "_COUNTED_ENOUGH", 0.0)
    whole = array_module.column_currents_by_source(network, g)
    for part, other in zip(short, whole, strict=True):
        # Roundings of either way: solve_error.chain counts 1.5e-12 at 16x16, currents of offsets cancel by nature.
        np.testing.assert_allclose(part, other, rtol=1e-12, atol=1e-12 * np.abs(whole[1]).max())


def test_absurd_values_have_finite_currents_without_overflow() -> None:
    rng = np.random.default_rng(3)
    values = [0, 1e-300, 1e-30, 1e-6, 1, 1e4, 1e30, 1e300]
    conductances = [0, 1e-300, 1e-30, 1e-9, 1e-3, 1, 1e9, 1e30, 1e300, np.inf]
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for _ in range(400):
            rows, cols = rng.integers(1, 4, 2)
            network = Network(
                rng.choice(conductances, (rows, cols)),
                0.5,
                rng.choice(values),
                rng.choice([*values, np.inf]),
                1e-3 + rng.choice(values, cols),
                rng.choice([0, 1e-3, -1e3], cols),
                *rng.choice(values, 4),
                rng.choice([0, 1e-9, 1e-3], cols),
            )
            assert np.isfinite(column_currents(network)).all()


@pytest.mark.parametrize(
    "kind",
    [
        {"r_trace_row_ohm": -1.0},
        {"r_trace_column_ohm": np.inf},
        {"i_leak_a": np.nan},
        {"v_column_offset_v": np.inf},
        {"c_taxel_f": -1e-12},
        {"c_row_f": np.inf},
    ],
)
def test_impossible_lines_are_refused(kind: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        Network(np.ones((2, 2)), 0.5, **kind)
