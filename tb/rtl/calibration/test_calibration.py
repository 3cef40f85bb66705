# SPDX-License-Identifier: Apache-2.0
"""Calibration over SPI with the real Verilog: mismatched columns read the current of their taxels."""

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
ROWS, GOOD, COLS = 2, 8, 12
# From 560 ohm: a channel with 7 % more gain then stays below half a packet a clock.
OHM = np.pad(
    np.geomspace(560.0, 64e3, ROWS * GOOD).reshape(ROWS, GOOD),
    ((0, 0), (0, COLS - GOOD)),
    constant_values=1e3,
)


def mismatched(tmp_path: Path) -> Plan:
    """Return a plan with gain errors of 2.5 % and zeros of 0.7 LSB, rms, drawn once; none in the last columns."""
    drawn = np.random.default_rng(4).standard_normal((2, GOOD))
    zero, gain = np.pad(drawn, ((0, 0), (0, COLS - GOOD)))
    np.savetxt(tmp_path / "ohm.csv", OHM, delimiter=",")
    data: dict[str, Any] = {
        "array": {"rows": ROWS, "cols": COLS},
        "stimulus": {"kind": "resistance", "file": str(tmp_path / "ohm.csv")},
    }
    ideal = plan.make(scene.from_data(data, tmp_path / "made.toml"), "closed")
    design = ideal.scene.design
    lsb_a = design.converter.i0_a / design.timing.gate_clocks
    zero_a = 0.7 * lsb_a * zero + design.calibration.i_pedestal_a / design.interface.k
    data["effects"] = {
        "offset_current": {"i_a": zero_a.tolist()},
        "charge_packet": {"packet_error": (0.025 * gain).tolist()},
    }
    return plan.make(scene.from_data(data, tmp_path / "made.toml"), "closed")


def calibrated(chip: Plan) -> tuple[dict[str, Any], Columns]:
    """Calibrate over SPI; the columns from GOOD on are broken.

    Column 8 has no test current, 9 a dark current of 20 codes, 10 no pedestal, 11 a gain 15 % low.
    """
    converter, i_test_a = chip.converter, chip.scene.design.calibration.i_test_a
    dark = converter.duty(np.zeros((1, COLS)))[0]
    full = converter.duty(np.full((1, COLS), i_test_a))[0]
    full[8] = dark[8]
    full[9], dark[9] = full[9] - dark[9] + 20 / 510, 20 / 510
    full[10], dark[10] = full[10] - dark[10], -1e-3
    full[11] = dark[11] + 0.85 * 0.45
    scenario = {
        "duty": converter.duty(column_currents(chip.network(0))).tolist(),
        "dark": dark.tolist(),
        "full": full.tolist(),
        "packet": (1.0 + converter.packet_error).tolist(),
    }
    parameters = {"ROWS": ROWS, "COLS": COLS}
    seen = simulate("icarus", "bench_calibration", "dermis_top", "calibrate", parameters, scenario)
    dark, full = np.array(seen["dark"]), np.array(seen["full"])
    return seen, Columns(dark, full, tuple(seen["verdict"]), chip.timing.gate_clocks, i_test_a)


@pytest.mark.long
def test_mismatched_columns_are_calibrated_to_parts_of_an_lsb_and_broken_ones_named(tmp_path: Path) -> None:
    chip = mismatched(tmp_path)
    seen, made = calibrated(chip)
    assert made.verdict == (*("ok",) * GOOD, "full", "dark", "pedestal", "gain")
    exact = Calibration.of_plan(chip)
    # 0.12 LSB of the test current's duty, 1/32 of the dark one; full scale is 255/230 of the test current.
    gain = np.abs(made.step_a / exact.step_a - 1)[..., :GOOD].max() * 255
    assert gain < 0.18
    missed = 0.5 * np.abs(chip.converter.packet_error)[:GOOD] * 1.1
    # 1/32 LSB, and the preset is half a nominal packet, which no dark count resolves.
    zero = np.abs(made.start_code - exact.start_code)[..., :GOOD]
    assert (zero < 1 / 32 + missed).all()

    codes = np.array(seen["codes"])
    assert codes[..., :GOOD].min() >= 1, "a code below the pedestal is lost"
    step_a = np.where(np.array(made.verdict) == "ok", made.step_a, exact.step_a)
    own = replace(exact, step_a=step_a, start_code=made.start_code)
    nominal = Calibration.of_plan(plan.make(without_mismatch(chip), "closed"))
    lsb_a = nominal.step_a
    want = column_currents(chip.network(0))
    error = (np.abs(own.step_a * (codes - own.start_code) - want) / lsb_a)[..., :GOOD]
    # Half a code of quantisation at a step up to 6 % larger, and the above.
    assert error.max() < 0.5 * 1.06 + 0.2
    without = (np.abs(nominal.step_a * (codes - nominal.start_code) - want) / lsb_a)[..., :GOOD]
    assert without.max() > 4


def without_mismatch(chip: Plan) -> Any:
    """Return the scene of a chip without mismatch."""
    data = {"array": {"rows": ROWS, "cols": COLS}, "stimulus": {"kind": "uniform", "r_ohm": 500.0}}
    return scene.from_data(data, chip.scene.path)
