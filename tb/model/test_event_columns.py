# SPDX-License-Identifier: Apache-2.0
"""Columns of the direct interface that move each other, beside their common equation."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_plans import made, ohms

from dermis import records
from dermis.array.array import Network, column_currents
from dermis.converter.coupling import seen_from_grounds
from dermis.engines import event, rtl
from dermis.errors import InputError
from tb.reference import columns_reference


def coupled(seed: int) -> dict[str, object]:
    rng = np.random.default_rng(seed)
    return {
        "integrator_gain": {"gain_dc": float(10 ** rng.uniform(3.3, 5)), "r_in_ohm": 1e9},
        "lateral": {"r_ohm": float(10 ** rng.uniform(3, 4))},
        "row_driver": {"r_ohm": float(rng.uniform(0, 20)), "grounded_r_ohm": float(rng.uniform(0, 20))},
        "column_input": {"r_ohm": float(rng.uniform(0, 10))},
    }


def drawn_by_offsets(plan: records.Plan) -> np.ndarray:
    """Conductances [driven row, column, column of the offset] from currents of the array with an offset at a column."""
    network, drawn = plan.network(0), []
    for d in range(plan.cols):
        surrounding = plan.surrounding | {"v_column_offset_v": 1e-3 * np.eye(plan.cols)[d]}
        drawn.append(-column_currents(Network(network.g_taxel_s, 0.0, **surrounding)) / 1e-3)
    return np.stack(drawn, axis=-1)


TRACES = {"trace": {"r_row_ohm": 1.0, "r_column_ohm": 100.0}, "integrator_gain": {"gain_dc": 60.0}}


@pytest.mark.parametrize("on", [*map(coupled, range(4)), TRACES])
def test_conductances_between_virtual_grounds_are_what_an_offset_draws(tmp_path: Path, on: dict) -> None:
    plan = made(tmp_path, ohms(20, 1, 3, 4), on, "direct")
    drawn = drawn_by_offsets(plan)
    found = np.broadcast_to(seen_from_grounds(plan.network(0), plan.conductance_s())[0], drawn.shape)
    # A millivolt beside half a volt of bias, in a solve to 1e-12; 1e-15 S where columns do not touch.
    assert found == pytest.approx(drawn, rel=1e-9, abs=1e-15)


def close_columns(rng: np.random.Generator, tmp_path: Path) -> records.Plan:
    """Two frames with whatever the common equation can follow, a third of them near simple ratios, a third near 1/2."""
    shape = (2, int(rng.integers(1, 3)), int(rng.integers(2, 5)))
    x = [
        0.6 * 200.0 ** -rng.random(shape),
        rng.integers(1, 7, shape) / rng.integers(2, 13, shape) * rng.normal(1, 10 ** rng.uniform(-6, -2), shape),
        np.where(rng.random(shape) < 0.5, 0.5 * (1.0 + rng.normal(0, 2e-3, shape)), rng.uniform(0.01, 1.5, shape)),
    ][rng.integers(3)]  # fmt: skip

    def about(low: float, high: float) -> float:
        return float(10 ** rng.uniform(low, high))

    gain = {"integrator_gain": {"gain_dc": about(1.5, 4), "r_in_ohm": 1e9}}
    swift = {"integrator_bandwidth": {"gbw_hz": about(6, 9)}}
    on = {"lateral": {"r_ohm": about(2, 5)}} | (gain if rng.random() < 0.8 else swift)
    grounded = np.inf if rng.random() < 0.2 else about(-1, 1)
    others = {
        "row_driver": {"r_ohm": about(-1, 1), "grounded_r_ohm": grounded},
        "column_input": {"r_ohm": about(-1, 1)},
        "supply_ripple": {
            "relative": about(-3, -0.2),
            "frequency_hz": about(1, 5),
            "phase_deg": about(0, 2.5),
        },
        "motion": {},
        "comparator_hysteresis": {"v_v": about(-3, -0.2)},
        "comparator_delay": {"t_s": about(-10, -7)},
        "charge_packet": {"packet_error": float(rng.uniform(-0.3, 0.5))},
        "preset_error": {"v_v": float(rng.normal() * 10 ** rng.uniform(-2, 1))},
        "column_offset": {"v_v": rng.normal(0, 1e-3, shape[2]).tolist()},
        "offset_current": {"i_a": float(rng.normal() * 10 ** rng.uniform(-8, -5))},
        "comparator_offset": {"v_v": float(0.1 * rng.normal())},
    }
    on |= {name: value for name, value in others.items() if rng.random() < 0.2}
    return made(tmp_path, 250.0 / np.maximum(x, 1e-4), on, "direct")


@pytest.mark.paper
# The reference takes the exponential of a matrix a column: minutes on a busy machine.
@pytest.mark.timeout(900)
@pytest.mark.parametrize("scenes", [10, pytest.param(600, marks=pytest.mark.long)])
def test_close_columns_count_as_their_common_equation_whatever_is_on(tmp_path: Path, scenes: int) -> None:
    plans = map(close_columns, [np.random.default_rng(25)] * scenes, [tmp_path] * scenes)
    off = []
    for plan in plans:
        with contextlib.suppress(InputError):  # strongly coupled in some frame
            off.append(event.run(plan).codes[0] - columns_reference.codes(plan))
    assert len(off) > 0.8 * scenes
    apart = np.abs(np.concatenate([codes.ravel() for codes in off]))
    assert apart.max() <= 1
    assert (apart > 0).mean() < 0.02


def close(r_ohm: float, gain: float) -> dict[str, Any]:
    return {"lateral": {"r_ohm": r_ohm}, "integrator_gain": {"gain_dc": gain, "r_in_ohm": 1e9}}


SIMPLE_RATIOS = [[500.38881092718583, 498.2946922238924, 753.031053559841, 500.6804472479357]]


@pytest.mark.paper
@pytest.mark.parametrize(
    ("ohm", "on", "cosim"),
    [
        ([[600.0, 2000.0]],
         close(1e3, 1e3) | {"supply_ripple": {"relative": 0.5, "frequency_hz": 1e2, "phase_deg": 90.0}}, [[255, 102]]),
        ([[250 / 3, 250 / 0.9]], close(1e3, 1e3) | {"charge_packet": {"packet_error": [0.0, 2.0]}}, [[255, 176]]),
        ([[51758.4, 1002.55, 1503.44]], close(642.0, 92.434) | {"comparator_hysteresis": {"v_v": 0.5}}, [[3, 128, 84]]),
        ([[620.0, 2000.0]], close(1e3, 300.0) | {"preset_error": {"v_v": [50.0, 0.0]}}, [[231, 73]]),
        ([[[1e5] * 2, [x, 2e3]] for x in (1e6, 250.0 / 0.82, 1e6)], close(1e3, 1e3) | {"motion": {}},
         [[[1, 1], [255, 74]], [[1, 1], [85, 64]], [[1, 1], [0, 64]]]),
        ([[1143.9, 3932.8], [847.3, 23428.0]], close(212.0, 866.0) | {
            "integrator_range": {"v_max_v": 0.889, "v_min_v": -0.672},
            "row_driver": {"r_ohm": 0.014, "grounded_r_ohm": 0.011}}, [[111, 33], [149, 7]]),
        ([[2017.0, 50.0, 2385.0, 5000.0]], dict.fromkeys(["lateral", "integrator_bandwidth", "integrator_range"], True),
         [[63, 255, 53, 25]]),
    ],
    ids=["ripple", "large packet", "window", "preset", "motion", "range", "range and lag"],
)  # fmt: skip
def test_close_columns_count_as_in_ngspice(tmp_path: Path, ohm: Any, on: dict[str, Any], cosim: Any) -> None:
    taxels, expected = np.array(ohm, dtype=float), np.array(cosim)
    codes = event.run(made(tmp_path, taxels.reshape(-1, *taxels.shape[-2:]), on, "direct")).codes
    # What the walk of coupled columns is certain to.
    assert np.abs(codes - expected.reshape(codes.shape)).max() <= 1


def test_with_motion_a_column_leaks_as_in_the_middle_of_its_gate(tmp_path: Path) -> None:
    taxels = np.stack([np.full((16, 2), 2e4), np.full((16, 2), 600.0)])
    plan = made(tmp_path, taxels, {"integrator_gain": {"gain_dc": 300.0}, "motion": {}}, "direct")
    assert np.array_equal(event.run(plan).codes[0], columns_reference.codes(plan))


def test_strong_coupling_is_refused(tmp_path: Path) -> None:
    swift = {"integrator_bandwidth": {"gbw_hz": 1e6}, "lateral": {"r_ohm": 1000.0}}
    plan = made(tmp_path, np.array([SIMPLE_RATIOS]), close(369.8144, 32.53386), "direct")
    for strong in (plan, made(tmp_path, ohms(0, 1, 4, 4), swift, "direct")):
        with pytest.raises(InputError, match=r"integrator_.*lateral.*certain to 1 LSB.*use engine cosim"):
            event.run(strong)
    event.run(made(tmp_path, ohms(0, 1, 4, 4), swift | {"integrator_bandwidth": True}, "direct"))


@pytest.mark.parametrize(("seed", "sync_latch"), [(5, False), (11, True)])
def test_verilog_columns_give_each_other_the_same(tmp_path: Path, seed: int, sync_latch: bool) -> None:
    """Scenes in which that moves codes by 5 and 7."""
    plan = close_columns(np.random.default_rng(seed), tmp_path)
    late = replace(plan, timing=replace(plan.timing, charge_delay_clocks=0.5 if sync_latch else 1.0))
    codes = rtl.run(plan, simulator="icarus", sync_latch=sync_latch).codes
    assert np.array_equal(codes, event.run(late).codes)
