# SPDX-License-Identifier: Apache-2.0
"""A column from parts on a board: exact with ideal parts, within its limit with real ones, and faults show."""

import json
import math
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from dermis.converter import vfc
from dermis.errors import SimulatorError
from dermis.report import verdict
from dermis.scene.design import Design
from scripts import board

IDEAL = {"gbw_hz": 1e9, "slew_v_per_s": 1e10, "gain_dc": 1e9, "t_delay_s": 1e-10}
IDEAL |= {"c_input_f": 1e-15, "c_pin_f": 1e-15, "c_injection_f": 1e-18}
IDEAL |= {"r_output_ohm": 1e-2, "r_pin_ohm": 0.1, "r_reset_ohm": 1e-2, "r_switch_ohm": 1e-3}


@pytest.mark.parametrize("code", [3, 100, 254])
def test_ideal_parts_count_like_charge_balance(tmp_path: Path, design: Design, code: int) -> None:
    # A quarter of a code from the middle of a step, so that one count more or less is an error.
    x = (code + 0.25) / design.timing.gate_clocks
    found = board.conversion(design.resistance_full_scale_ohm / 2 / x, IDEAL, tmp_path)
    assert round(found["pulses"], 2) == vfc.count(x, design.timing.gate_clocks) == code
    # The start is exact, but the switch and the pin have an edge of 2 ns.
    assert found["packets"] == pytest.approx(code + 0.25, abs=0.05)


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, "PASS"),
        ({"r_switch_ohm": 50.0}, "FAIL"),
        ({"t_delay_s": 5e-6}, "FAIL"),
        ({"other_column": 1, "v_undriven_v": 0.0}, "FAIL"),
    ],
)
def test_a_board_is_within_its_limit_or_faulty(tmp_path: Path, changes: board.Changes, status: str) -> None:
    found = board.column_error(changes, 3, tmp_path)
    assert verdict.judge("board.column_error_lsb", *found)["status"] == status


def test_an_unknown_parameter_and_an_unmeasured_count_are_errors(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="no_such"):
        board.conversion(1e3, {"no_such": 1.0}, tmp_path)
    with pytest.raises(SimulatorError, match="did not measure"):
        board.conversion(1e3, {"t_delay_s": math.nan}, tmp_path)


def test_a_failed_simulator_is_an_error_of_its_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(changes: board.Changes, points: int, work: Path) -> tuple[float, str]:
        if changes == board.FIT["full_row"]:
            raise SimulatorError("it broke", work)
        return (0.5, "") if changes in board.FIT.values() else (1.5, "")

    monkeypatch.setattr(board, "column_error", fail)
    monkeypatch.setattr(verdict, "BUILD", tmp_path)
    done = CliRunner().invoke(board.board_command, [], standalone_mode=False, catch_exceptions=False)
    assert done.return_value == SimulatorError.exit_code
    rows = json.loads((tmp_path / "board.json").read_text())
    assert {row["name"].rpartition(".")[2] for row in rows if row["status"] != "PASS"} == {"full_row"}
    assert len(rows) == len(board.FIT) + len(board.UNFIT)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_every_board_is_judged_as_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "BUILD", tmp_path)
    monkeypatch.setattr(board, "BUILD", tmp_path)
    done = CliRunner().invoke(board.board_command, [], standalone_mode=False, catch_exceptions=False)
    assert done.return_value == 0, done.output
    found = {row["name"]: row["value"] for row in json.loads((tmp_path / "board.json").read_text())}
    page = (board.ROOT / "docs" / "board.md").read_text(encoding="utf-8")
    shown = {name: float(value) for name, value in re.findall(r"\| `(board\.\S+)` \| ([\d.]+) \|", page)}
    # A count more or less at a rounding step, as another version of ngspice may have it.
    assert found == pytest.approx(shown, abs=0.3)
