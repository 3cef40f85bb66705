# SPDX-License-Identifier: Apache-2.0
"""Decoding: codes come back as the force that made them, within the step each code stands for."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis import engines, records
from dermis import plan as planning
from dermis.decode.force import decode, taxels_alone
from dermis.engines import closed
from dermis.report import comparison, figures, output
from dermis.scene import scene


def made(stimulus: dict[str, object], **tables: object) -> records.Plan:
    data = {"array": {"rows": 1, "cols": 1}, "stimulus": {"kind": "uniform", **stimulus}, **tables}
    return planning.make(scene.from_data(data, Path("made.toml")))


EVERY = {"code": list(range(256))}


@settings(max_examples=200, deadline=None)
@given(force=st.just(0.0) | st.floats(1e-30, 30), k=st.sampled_from([20, 80, 160]), bias_v=st.floats(0.1, 2))
def test_the_true_force_lies_in_the_interval_of_its_code(force: float, k: int, bias_v: float) -> None:
    plan = made({"force_n": force}, interface={"k": k, "v_bias_v": bias_v})
    decoded = decode(plan, closed.run(plan).codes)
    slack = 1e-14 * force
    assert decoded.force_low_n[0, 0, 0] <= force + slack
    assert force - slack <= decoded.force_high_n[0, 0, 0]
    if not decoded.saturated.any():
        assert abs(decoded.force_n[0, 0, 0] - force) <= decoded.d_force_n[0, 0, 0]


@pytest.mark.paper
def test_intervals_tile_the_whole_range_without_gap_or_overlap() -> None:
    plan = made(EVERY)
    decoded = decode(plan, np.arange(256).reshape(-1, 1, 1))
    assert decoded.force_low_n[0] == 0
    assert (decoded.force_low_n[1:] == decoded.force_high_n[:-1]).all()
    assert np.isinf(decoded.force_high_n[-1]).all()


@pytest.mark.paper
def test_resolution_of_the_paper_sensor() -> None:
    # dR = R^2 / (510 * 250 ohm): 1.96 ohm at 500 ohm and about 32 kohm at 64 kohm; one code is 15 N / 255 everywhere
    plan = made(EVERY)
    decoded = decode(plan, np.array([255, 128, 2, 1]).reshape(-1, 1, 1))
    r = decoded.resistance_ohm.ravel()
    assert decoded.d_resistance_ohm.ravel() == pytest.approx(r**2 / 127500)
    # 500^2 / 127500 = 1.96 ohm: half a unit of the last digit.
    assert decoded.d_resistance_ohm.ravel()[0] == pytest.approx(1.96, abs=0.005)
    assert decoded.d_resistance_ohm.ravel()[2] == pytest.approx(31875)
    assert decoded.d_force_n.ravel()[1:] == pytest.approx([15 / 255] * 3)


@pytest.mark.paper
@pytest.mark.parametrize(
    "codes", [np.full((1, 1, 1), 256), np.full((1, 1, 1), -1), np.zeros((1, 2, 1), int), np.zeros((1, 1, 1))]
)
def test_codes_that_no_counter_holds_are_refused(codes: np.ndarray) -> None:
    with pytest.raises(ValueError, match="codes must be"):
        decode(made(EVERY), codes)


WORN = {
    "row_driver": {"effects": {"row_driver": {"r_ohm": 4.0}}, "limit": 0.55},
    "columns too": {
        "effects": {"row_driver": {"r_ohm": 4.0, "grounded_r_ohm": 7.0}, "column_input": {"r_ohm": 2.0}},
        "limit": 0.6,
    },
    "traces and sources": {
        "effects": {
            "row_driver": True, "column_input": True, "trace": {"r_row_ohm": 0.2, "r_column_ohm": 0.2},
            "lateral": True, "column_offset": {"v_v": 5e-4}, "mux_leakage": {"i_a": 1e-6},
        },
        "limit": 0.6,
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", WORN)
def test_what_the_network_takes_is_put_back(kind: str) -> None:
    """Half a code is rounding, and of the halves of fifteen others each passes a hundredth on: the limits above."""
    codes = np.random.default_rng(4).integers(0, 240, (2, 16, 16))
    plan = made({"code": [1]}, array={"rows": 16, "cols": 16}, effects=WORN[kind]["effects"])
    plan = dataclasses.replace(plan, resistance_ohm=plan.ohm_of_duty(codes / 510))
    read = closed.run(plan).codes
    plain, corrected = decode(plan, read), decode(plan, read, corrected=True)
    assert np.abs(plain.x * 510 - codes).max() > 10
    assert np.abs(corrected.x * 510 - codes).max() < WORN[kind]["limit"]
    ends = (corrected.force_low_n <= corrected.force_n) & (corrected.force_n <= corrected.force_high_n)
    assert ends.all()


def test_exact_duties_come_back_exactly() -> None:
    effects = WORN["traces and sources"]["effects"]
    plan = made({"code": [1]}, array={"rows": 16, "cols": 16}, effects=effects)
    x = np.random.default_rng(4).uniform(0, 0.47, (1, 16, 16))
    plan = dataclasses.replace(plan, resistance_ohm=plan.ohm_of_duty(x))
    seen = closed.run(plan).info["x"]
    # The solver stops at 1e-13 of the largest current; of 256 duties below 0.5 some add up.
    assert np.abs(taxels_alone(plan, seen) - x).max() < 1e-11
    assert np.abs(seen - x).max() > 0.01


@pytest.mark.paper
def test_converter_errors_that_are_known_are_taken_out() -> None:
    effects = {
        "mirror_ratio": {"ratio_error": 0.02}, "charge_packet": {"packet_error": -0.01},
        "offset_current": {"i_a": 5e-8}, "comparator_offset": {"v_v": 0.1}, "preset_error": {"v_v": 0.05},
    }  # fmt: skip
    plan = made(EVERY, effects=effects)
    read = closed.run(plan).codes
    middle = np.arange(3, 240)
    plain, corrected = decode(plan, read), decode(plan, read, corrected=True)
    assert np.abs(plain.x.ravel()[middle] * 510 - middle).max() > 5
    # Half a code of rounding, and the code is up to 3 % of another size.
    assert np.abs(corrected.x.ravel()[middle] * 510 - middle).max() < 0.52


FLAT = {"law": "power", "force_points_n": [1.0, 1e9], "r_points_ohm": [1000.0, 998.0]}


def total_forces(folder: Path, plan: records.Plan, result: engines.Result) -> list[float | None]:
    """Return what a run writes of the total force of every frame; its figure is drawn as well."""
    output.write(folder, plan, result, [])
    fit = comparison.fit_residual(plan, result.codes)
    figures.frame_figure(plan, result.codes, fit, folder / "frame.png")
    return json.loads((folder / "summary.json").read_text())["decoded"]["total_force_n"]


@pytest.mark.filterwarnings("error")
def test_a_law_so_flat_that_no_force_reaches_a_resistance_decodes_to_inf(tmp_path: Path) -> None:
    """Slope 1e-4: 600 ohm would take 1e2285 N. The codes are what they are, and a run writes null for such a force."""
    plan = made({"r_ohm": [600.0, 1000.0, 999.0, 0.0]}, sensor=FLAT)
    result = closed.run(plan)
    decoded = decode(plan, result.codes)
    assert np.isinf(decoded.force_n[[0, 3]]).all()
    assert np.isfinite(decoded.force_n[1:3]).all()
    for every in dataclasses.fields(decoded):
        assert not np.isnan(getattr(decoded, every.name)).any(), every.name
    assert np.isinf(decoded.d_force_n[[0, 3]]).all()
    codes = np.arange(256).reshape(-1, 1, 1)
    assert not np.isnan(decode(plan, codes).d_force_n).any()
    total_n = total_forces(tmp_path / "out", plan, result)
    assert total_n == [None, *decoded.force_n[1:3].ravel(), None]


@pytest.mark.filterwarnings("error")
def test_forces_at_the_end_of_numbers_run_to_their_end(tmp_path: Path) -> None:
    """Nine orders of magnitude are one percent of resistance: up to 1e308 N a taxel, of which 1e300 are a force."""
    ohm = 127500.0 / 212
    for decades, finite in ((308.0, False), (299.9, True)):
        law = {**FLAT, "r_points_ohm": [1000.0, 1000.0 * (ohm / 1000.0) ** (9 / decades)]}
        plan = made({"r_ohm": [ohm, 1.05 * ohm, 1.5 * ohm]}, array={"rows": 3, "cols": 1}, sensor=law)
        result = closed.run(plan)
        force_n = decode(plan, result.codes).force_n
        assert np.isfinite(force_n[0]).all() == finite
        assert force_n.max() > 1e299
        total_n = total_forces(tmp_path / "out", plan, result)
        assert total_n == [f if np.isfinite(f) else None for f in force_n.sum(axis=(1, 2))]
