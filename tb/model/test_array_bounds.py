# SPDX-License-Identifier: Apache-2.0
"""The bound of the array solve's error against 120 digits, its checks against seeded faults, and what is refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dermis import engines, plan, records
from dermis.array import array as array_module
from dermis.array import solve_error, star_mesh
from dermis.array.array import Network, column_currents
from dermis.errors import InputError, SimulatorError
from tb.reference import nodal

Floats = NDArray[np.float64]

# What a source of no resistance, 1e60 S, lets through of volts across siemens, and more: a current of 0 may come out
# as that. The smallest current that moves a code is 1e30 times as large.
STAND_IN_A = 1e-45


def wild_network(rng: np.random.Generator) -> Network:
    """Draw a small network of any kind of line, its resistances up to 28 decades apart, with opens and shorts."""
    rows, cols = rng.integers(1, 5, 2)
    decades = rng.choice([1, 4, 9, 14])
    low, high = (-3, 15) if decades > 4 else (2, 7)
    reach = min(decades, 9)
    g = 10 ** -rng.uniform(low, high, (rows, cols))
    g[rng.random((rows, cols)) < rng.choice([0, 0.3])] = 0.0

    def series() -> float:
        return rng.choice([0.0, 10 ** rng.uniform(-reach, reach), 10 ** rng.uniform(0, 3)])

    driven = series()
    grounded = rng.choice([driven, series(), np.inf])
    r_column = np.array([series() for _ in range(cols)])
    traces = [rng.choice([0.0, 0.0, 10 ** rng.uniform(-min(2 * decades, 23), reach)]) for _ in range(2)]
    if min(driven, grounded) + traces[0] > 0 and (r_column + traces[1] > 0).all():
        g[rng.random((rows, cols)) < rng.choice([0, 0.2])] = np.inf
    lateral = [rng.choice([0.0, 10 ** rng.uniform(-9, 9)]) for _ in range(2)]
    offset = rng.choice([0, 1, -1, 2], cols) * 10 ** rng.uniform(-20, 3) * rng.choice([0, 1])
    leak = rng.choice([0, 1, -1], cols) * 10 ** rng.uniform(-15, -3) * rng.choice([0, 1])
    return Network(g, 0.5, driven, grounded, r_column, offset, *lateral, *traces, leak)


def fraction_used(network: Network) -> float:
    """Largest part of its bound that the error of a current, and of each part of it, takes against 120 digits."""
    used, without = [0.0], ({"v_column_offset_v": 0.0, "i_leak_a": 0.0}, {"v_bias_v": 0.0})
    for (part, bound), kept in zip(nodal.bounded(network), without, strict=True):
        if part is not None:
            error = np.abs(part - nodal.column_currents(replace(network, **kept), 120))
            used.append(float((error / (bound + STAND_IN_A)).max()))
    return max(used)


# Inputs that let nothing through and rows that hang on nothing: what offsets drive all but cancels.
NEARLY_OPEN = Network(
    1 / np.array([[2e3, 7e4], [5e2, 1e6], [3e4, 8e3], [6e2, 4e3]]), 0.5, 12.0, 1e21, 1e15, -4.7e-5, 1e-3, 1e-3, 1e-6,
    1.0, np.array([5.7e-9, 2.1e-9]),
)  # fmt: skip
# Rows held hard while grounded and left nearly open while driven: all that a slot's own row took must go again.
CANCELS = Network(np.array([[1e12, 1e3], [1e-3, 2e-3]]), 0.5, 1e6, 0.0, 1e-12, [1e-3, 0.0])


@pytest.mark.parametrize("draws", [60, pytest.param(3000, marks=pytest.mark.long)])
def test_no_current_is_further_from_the_nodal_matrix_than_its_bound(draws: int) -> None:
    rng = np.random.default_rng(7)
    networks = (NEARLY_OPEN, CANCELS, *(wild_network(rng) for _ in range(draws)))
    used = max(map(fraction_used, networks))
    assert used <= 1.0, "the bound is derived, not fitted"
    assert used > 1e-3, "a bound a thousand times too wide says little"


def test_bounds_of_residuals_hold_where_counted_roundings_say_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(array_module, "_COUNTED_ENOUGH", 0.0)
    # As in an array so large that counting says nothing.
    monkeypatch.setattr(solve_error, "part", lambda *_: np.inf)
    rng = np.random.default_rng(8)
    lines = [replace(wild_network(rng), r_trace_column_ohm=10 ** rng.uniform(-3, 3)) for _ in range(30)]
    assert 1e-6 < max(map(fraction_used, lines)) <= 1.0, "a bound by condition is wide; a millionth is some"


@pytest.mark.parametrize("grounded_ohm", [50.0, 80.0, 20.0])
@pytest.mark.parametrize("offset_v", [0.0, 1e-3])
def test_slots_that_only_walk_down_agree_with_all_of_the_array(
    monkeypatch: pytest.MonkeyPatch, grounded_ohm: float, offset_v: float
) -> None:
    rng = np.random.default_rng(11)
    g = 1 / np.exp(rng.uniform(np.log(500), np.log(1e6), (2, 37, 29)))
    network = Network(
        g[0], 0.5, 50.0, grounded_ohm, 20.0, g_lateral_row_s=1e-5, r_trace_row_ohm=1.0, r_trace_column_ohm=2.0,
        v_column_offset_v=offset_v * rng.uniform(-1, 1, 29),
    )  # fmt: skip
    asked, chain = [], star_mesh.chain
    monkeypatch.setattr(star_mesh, "chain", lambda *a: asked.append(a[-2]) or chain(*a))
    fast = column_currents(network, g)
    monkeypatch.setattr(array_module, "_COUNTED_ENOUGH", 0.0)
    slow = column_currents(network, g)
    assert asked[0] == (grounded_ohm < 50.0 or (offset_v > 0.0 and grounded_ohm > 50.0))
    assert asked[-1]
    # Both are sums of positive terms; 2e-14 was seen at 64x64.
    np.testing.assert_allclose(fast, slow, rtol=1e-12, atol=1e-12 * np.abs(slow).max())


def test_more_columns_than_the_compiled_loops_take_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 256 columns, not 257"):
        column_currents(Network(np.ones((1, 257)), 0.5, r_trace_column_ohm=1.0))


# --- seeded faults: each is far below what a code shows, and is noticed -----------------------------------------------

EVERYTHING: dict[str, Any] = {
    "r_row_driven_ohm": 1.0,
    "r_row_grounded_ohm": 3.0,
    "r_column_ohm": 0.5,
    "g_lateral_row_s": 1e-3,
    "r_trace_row_ohm": 0.3,
    "v_column_offset_v": 1e-3,
}


@pytest.mark.parametrize("fault", ["pivot", "element", "current", "source"])
def test_a_fault_in_the_elimination_is_noticed(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (2, 6, 5))
    down, up = star_mesh.down, star_mesh.up

    def broken_down(work: Floats, pivot: Floats, *which: int) -> None:
        if fault == "element":  # a link that the elimination does not see
            work[1, 0, 3] = 0.0
        down(work, pivot, *which)
        if fault == "pivot":
            pivot[0, 2] *= 1 + 1e-9

    def broken_up(work: Floats, *rest: Any) -> None:
        up(work, *rest)
        if fault == "current":
            work[1, 3, 5 + 1 + 4] *= 1 + 1e-9
        if fault == "source":
            work[0, 2, -1] *= 1 + 1e-9

    monkeypatch.setattr(star_mesh, "down", broken_down)
    monkeypatch.setattr(star_mesh, "up", broken_up)
    with pytest.raises(SimulatorError, match=r"Kirchhoff's current law is missed by .* of the current"):
        column_currents(Network(g[0], 0.5, **EVERYTHING), g)


def test_a_fault_in_what_columns_give_each_other_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    g = 1 / np.random.default_rng(1).uniform(500, 64250, (3, 4))
    chain = star_mesh.chain

    def broken(*arguments: Any) -> star_mesh.Chain:
        found = chain(*arguments)
        # the voltage of a column under its own source
        found.last[0, star_mesh.ROWS + 3 + 1, 1] *= 1 + 1e-7
        return found

    monkeypatch.setattr(star_mesh, "chain", broken)
    with pytest.raises(SimulatorError, match="from the source of a column"):
        column_currents(Network(g, 0.5, **EVERYTHING, r_trace_column_ohm=0.2))


# --- what is reported, and what is refused ----------------------------------------------------------------------------

SCENE = """
[array]
rows = 2
cols = 3
[stimulus]
kind = "resistance"
file = "r.csv"
[effects]
{effects}
"""


def made(write_scene: Callable[..., Path], effects: str, ohm: str) -> records.Plan:
    return plan.load(write_scene(SCENE.format(effects=effects), r__csv=ohm), "closed")


OHM = "1e3,2e3,3e3\n4e3,5e3,6e3\n"


def test_every_engine_reports_its_solves(write_scene: Callable[..., Path]) -> None:
    effects = "column_offset = { v_v = 1e-3 }\ncolumn_input = { r_ohm = 0.5 }\nlateral = { r_ohm = 1e3 }"
    world = made(write_scene, effects, OHM)
    for engine in ("closed", "event"):
        report = engines.run(replace(world, engine=engine)).info["array"]
        assert report["solves"] == 1
        # A few roundings; a bound above what it bounds and far below what a code bears; the lateral resistors, two
        # rows of 1 mS, beside inputs of 2 S.
        assert 0 <= report["residual"] < 1e-14
        assert 1e-16 < report["bound"] < 1e-11
        assert 0 < report["bound_lsb"] < 1e-6
        assert 2.0 < report["condition"] < 2.01
        assert report["refinement_steps"] == 0
        json.dumps(report, allow_nan=False)


@pytest.mark.paper
def test_a_code_that_rounding_may_move_is_refused_by_name(write_scene: Callable[..., Path]) -> None:
    # 1 V from column to column through 1e-12 ohm: 1e12 A into the middle one and out of it again, where 2 uA are a
    # code.
    lateral = "lateral = { r_ohm = 1e-12 }\n"
    world = made(write_scene, lateral + "column_offset = { v_v = [1.0, 0.0, -1.0] }", OHM)
    said = r"row \d, column 1 is uncertain by .* LSB .* use resistances closer"
    for engine in ("closed", "event"):
        with pytest.raises(SimulatorError, match=said):
            engines.run(replace(world, engine=engine))
    # 1e12 A one way are a code of 0 or 255 whatever their last digits.
    codes = engines.run(made(write_scene, lateral + "column_offset = { v_v = [1.0, 0.0, 0.0] }", OHM)).codes
    assert codes[0, :, 0].tolist() == [0, 0]
    assert codes[0, :, 1].tolist() == [255, 255]


def test_shorts_across_ideal_sources_are_refused_by_name(write_scene: Callable[..., Path]) -> None:
    world = made(write_scene, "column_offset = { v_v = [0.0, 1e-3, 0.0] }", "1e3,2e3,3e3\n4e3,0,6e3\n")
    for engine in ("closed", "event", "rtl", "cosim"):
        with pytest.raises(InputError, match=r"taxel at row 1, column 1 in frame 0 = 0 ohm: above 0") as said:
            engines.run(replace(world, engine=engine))
        assert "column_offset" in str(said.value)
    # Each of these gives the current an end.
    for more in (
        "row_driver = { r_ohm = 1.0 }",
        "column_input = { r_ohm = 0.5 }",
        "trace = { r_row_ohm = 0.1 }",
    ):
        effects = f"column_offset = {{ v_v = [0.0, 1e-3, 0.0] }}\n{more}"
        engines.run(made(write_scene, effects, "1e3,2e3,3e3\n4e3,0,6e3\n"))
