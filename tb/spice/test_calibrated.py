# SPDX-License-Identifier: Apache-2.0
"""Columns with mismatch after calibration: its arithmetic on made lines, and a fault that the bench must find."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from dermis.scene.design import Design
from dermis.scene.extracted import CIRCUIT
from scripts.characterise.benches import Condition
from scripts.markdown import filled
from tb.programs import calibrated
from tb.programs.calibrated import DARK, KNOWN, NEAR_FULL, SETTLING, Load
from tb.programs.equivalence.columns import Slot, records
from tb.programs.equivalence.gate import Line


def made(design: Design, gain: float, zero: float, bend: float = 0.0) -> dict[Load, Line]:
    """Lines of a column of a gain, a zero in codes, and a bend in codes in the middle of its range."""
    found = {}
    for load in dict.fromkeys((*calibrated.CALIBRATION, *calibrated.DRIFT)):
        ampere = design.calibration.i_test_a if load.test else design.interface.v_bias_v / load.ohm
        duty = ampere / (design.interface.k * design.converter.i0_a)
        duty += bend * 4 * duty * (0.5 - duty) * 4 / 510
        shift = calibrated.SHIFT_A / design.converter.i0_a if load.shifted else 0.0
        found[load] = Line(-0.5, gain * (duty - shift) + zero / 510)
    return found


@pytest.mark.parametrize(("gain", "zero"), [(1.0, 4.0), (1.06, 1.2), (0.93, 6.5)])
def test_gain_and_zero_are_known_as_well_as_16_gates_resolve(
    gain: float, zero: float, design: Design
) -> None:
    lines = made(design, gain, zero)
    values = calibrated.calibrate(lines, design.calibration.i_test_a, design)
    # 1/32 code of the zero and 0.12 of the gain (docs/howto_calibrate.md).
    assert max(map(abs, calibrated.errors_lsb(lines, values, design).values())) < 0.16
    assert max(map(abs, calibrated.drift_lsb(lines, values, design).values())) < 0.16
    assert calibrated.test_current_a(lines, design) == pytest.approx(design.calibration.i_test_a)


def test_a_bend_stays_and_is_in_the_middle(design: Design) -> None:
    lines = made(design, 1.0, 4.0, bend=1.0)
    values = calibrated.calibrate(lines, design.calibration.i_test_a, design)
    errors = calibrated.errors_lsb(lines, values, design)
    assert max(errors, key=lambda ohm: abs(errors[ohm])) == KNOWN.ohm
    assert abs(errors[KNOWN.ohm]) > 0.5


def slots_of(lines: dict[Load, Line], loads: tuple[Load, ...]) -> list[Slot]:
    """Records of an ideal converter whose charge runs along these lines, one volt a packet."""
    slots = []
    for load in loads:
        line, bits = lines[load], np.zeros(calibrated.CLOCKS, dtype=bool)
        stored = np.zeros(calibrated.CLOCKS + 1)
        high = bits.copy()
        for n in range(1, len(stored)):
            taken = bits[: max(n - 2, 0)].sum()
            stored[n] = line.start + line.slope * n - taken
            pending = bits[max(n - 2, 0) : n - 1].sum()
            high[n - 1] = stored[n] > 0
            bits[n - 1] = stored[n] - pending > 0 and not bits[n - 2 : n - 1].any()
        slots.append(Slot(high, bits, stored))
    return slots


def test_verdicts_name_the_worst_draw_and_miss_no_negative_zero(design: Design) -> None:
    loads, drift = calibrated.CALIBRATION, calibrated.DRIFT
    shown = {Condition(): slots_of(made(design, 1.0, 4.0), loads)}
    shown[Condition(sample=1)] = slots_of(made(design, 1.03, 3.0), loads)
    shown[Condition(sample=2)] = slots_of(made(design, 0.97, 0.2), loads)
    for at in calibrated.EXTREMES:
        moved = 1.03 * (1.01 if at.celsius > 100 else 1.0)
        shown[Condition(at.corner, at.celsius, at.supply, 1)] = slots_of(made(design, moved, 3.0), drift)
    rows, _ = calibrated.rows_of(shown, design)
    assert [row["status"] for row in rows] == ["FAIL", "PASS", "FAIL"]
    # Within what a level between 32 samples resolves.
    assert rows[0]["value"] == pytest.approx(0.2, abs=0.1)
    assert "sample 2" in rows[0]["note"]
    # 1 % of 255 codes.
    assert rows[2]["value"] == pytest.approx(2.55, abs=0.3)
    assert "tt,125" in rows[2]["note"]
    shown[Condition(sample=2)] = "time limit"
    rows, _ = calibrated.rows_of(shown, design)
    assert [row["status"] for row in rows] == ["ERROR", "ERROR", "FAIL"]
    assert "time limit" in rows[0]["note"]


PEDESTAL = "xpedestal col ibias vdd vss pedestal\n"


# 16 uA by 80 and 25 uA, of 510.
@pytest.mark.parametrize("sound", [pytest.param(True, marks=pytest.mark.long), False], ids=["sound", "fault"])
def test_a_column_without_its_pedestal_is_found(sound: bool, tmp_path: Path) -> None:
    blocks = shutil.copytree(CIRCUIT, tmp_path / "blocks")
    if not sound:
        column = blocks / "column.sp"
        column.write_text(filled(column.read_text(encoding="utf-8"), {PEDESTAL: ""}, column.name))
    loads = (DARK,) * SETTLING + (DARK, NEAR_FULL)
    (slots,) = records([calibrated.column_of(loads, Condition(), blocks)], 1, work=tmp_path)
    assert not isinstance(slots, str), slots
    # Below half a code.
    assert calibrated.code(calibrated.lines_of(loads, slots)[DARK], 510) == pytest.approx(
        4.0 * sound, abs=0.3
    )
