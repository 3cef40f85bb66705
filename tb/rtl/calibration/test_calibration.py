# SPDX-License-Identifier: Apache-2.0
"""Calibration over SPI with the real Verilog: mismatched columns read the current of their taxels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rtl_run import simulate

from dermis import plan
from dermis.array.array import column_currents
from dermis.chip.column_calibration import Columns
from dermis.decode.calibration import Calibration
from dermis.records import Plan
from dermis.scene import scene

pytestmark = pytest.mark.timeout(300)
ROWS, COLS = 2, 8
# From 560 ohm: a channel with 7 % more gain then stays below half a packet a clock.
OHM = np.geomspace(560.0, 64e3, ROWS * COLS).reshape(ROWS, COLS)


def mismatched(tmp_path: Path, pedestal: bool = True) -> Plan:
    """Return a plan with gain errors of 2.5 % and zeros of 0.7 LSB, rms, drawn once."""
    rng = np.random.default_rng(4)
    np.savetxt(tmp_path / "ohm.csv", OHM, delimiter=",")
    data: dict[str, Any] = {
        "array": {"rows": ROWS, "cols": COLS},
        "stimulus": {"kind": "resistance", "file": str(tmp_path / "ohm.csv")},
    }
    ideal = plan.make(scene.from_data(data, tmp_path / "made.toml"), "closed")
    design = ideal.scene.design
    lsb_a = design.converter.i0_a / design.timing.gate_clocks
    zero_a = 0.7 * lsb_a * rng.standard_normal(COLS)
    zero_a += pedestal * design.calibration.i_pedestal_a / design.interface.k
    data["effects"] = {
        "offset_current": {"i_a": zero_a.tolist()},
        "charge_packet": {"packet_error": (0.025 * rng.standard_normal(COLS)).tolist()},
    }
    return plan.make(scene.from_data(data, tmp_path / "made.toml"), "closed")


def calibrated(chip: Plan, **change: Any) -> tuple[dict[str, Any], Columns]:
    converter, i_test_a = chip.converter, chip.scene.design.calibration.i_test_a
    scenario = {
        "duty": converter.duty(column_currents(chip.network(0))).tolist(),
        "dark": converter.duty(np.zeros((1, COLS)))[0].tolist(),
        "full": converter.duty(np.full((1, COLS), i_test_a))[0].tolist(),
        "packet": (1.0 + converter.packet_error).tolist(),
    } | change
    parameters = {"ROWS": ROWS, "COLS": COLS}
    seen = simulate("icarus", "bench_calibration", "dermis_top", "calibrate", parameters, scenario)
    dark, full = np.array(seen["dark"]), np.array(seen["full"])
    return seen, Columns(dark, full, tuple(seen["verdict"]), chip.timing.gate_clocks, i_test_a)


def test_mismatched_columns_are_calibrated_to_a_fraction_of_an_lsb(tmp_path: Path) -> None:
    chip = mismatched(tmp_path)
    seen, made = calibrated(chip)
    assert made.verdict == ("ok",) * COLS
    exact = Calibration.of_plan(chip)
    # 0.12 LSB of the test current's duty, 1/32 of the dark one; full scale is 255/230 of the test current.
    assert np.abs(made.step_a / exact.step_a - 1).max() * 255 < 0.18
    missed = 0.5 * np.abs(chip.converter.packet_error) * 1.1
    # 1/32 LSB, and the preset is half a nominal packet, which no dark count resolves.
    assert (np.abs(made.start_code - exact.start_code) < 1 / 32 + missed).all()

    codes = np.array(seen["codes"])
    assert codes.min() >= 1, "a code below the pedestal is lost"
    own = replace(exact, step_a=made.step_a, start_code=made.start_code)
    nominal = Calibration.of_plan(plan.make(without_mismatch(chip), "closed"))
    lsb_a = nominal.step_a
    want = column_currents(chip.network(0))
    error = np.abs(own.step_a * (codes - own.start_code) - want) / lsb_a
    # Half a code of quantisation at a step up to 6 % larger, and the above.
    assert error.max() < 0.5 * 1.06 + 0.2
    without = np.abs(nominal.step_a * (codes - nominal.start_code) - want) / lsb_a
    assert without.max() > 4
    gain = np.abs(made.step_a / exact.step_a - 1).max() * 255
    zero = np.abs(made.start_code - exact.start_code).max()
    print(
        f"\ngain {gain:.2f} LSB, zero {zero:.2f} LSB, codes {error.max():.2f} LSB, {without.max():.1f} without"
    )
    print(f"{seen['transactions']} transactions")


def without_mismatch(chip: Plan) -> Any:
    """Return the scene of a chip without mismatch."""
    data = {"array": {"rows": ROWS, "cols": COLS}, "stimulus": {"kind": "uniform", "r_ohm": 500.0}}
    return scene.from_data(data, chip.scene.path)


def test_a_verdict_names_the_column_that_fails(tmp_path: Path) -> None:
    """Column 1 has no test current, 2 a dark current of 20 codes, 3 no pedestal, 4 a gain 15 % low."""
    chip = mismatched(tmp_path)
    dark = chip.converter.duty(np.zeros((1, COLS)))[0]
    full = chip.converter.duty(np.full((1, COLS), chip.scene.design.calibration.i_test_a))[0]
    full[1] = dark[1]
    full[2], dark[2] = full[2] - dark[2] + 20 / 510, 20 / 510
    full[3], dark[3] = full[3] - dark[3], -1e-3
    full[4] = dark[4] + 0.85 * 0.45 * (1 + chip.converter.packet_error[4])
    _, made = calibrated(chip, dark=dark.tolist(), full=full.tolist())
    assert made.verdict == ("ok", "full", "dark", "pedestal", "gain", "ok", "ok", "ok")
