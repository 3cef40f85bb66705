# SPDX-License-Identifier: Apache-2.0
"""Design, limits and verdicts: the paper's values, what follows from them, wrong files refused."""

import json
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_plans import refused

from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design as dd

TEXT = dd.DESIGN_FILE.read_text(encoding="utf-8")


def load_changed(tmp_path: Path, old: str, new: str) -> dd.Design:
    """Load design.toml with one piece of text replaced."""
    assert TEXT.count(old) == 1, f"{old!r} stands {TEXT.count(old)} times in design.toml"
    path = tmp_path / "design.toml"
    path.write_text(TEXT.replace(old, new), encoding="utf-8")
    return dd.load(path)


@pytest.mark.paper
def test_the_paper_gives_its_own_derived_values() -> None:
    design = dd.load()
    found = design.derived()
    exact = {
        "sensor.k_force_n_ohm": 7500.0,
        **{"converter.t_clk_s": 2e-7, "converter.packet_c": 5e-12, "converter.packet_v": 1.0},
        **{"converter.f_max_hz": 2.5e6, "converter.i0_direct_a": 2e-3, "converter.c_direct_f": 400e-12},
        **{"timing.slot_clocks": 625, "timing.settle_clocks": 115, "timing.code_max": 255},
        **{"timing.slot_s": 125e-6, "timing.gate_s": 102e-6, "timing.settle_s": 23e-6},
        **{"integrator.v_preset_v": 0.5, "converter.swing_v": 1.5},
    }
    assert {key: found[key] for key in exact} == exact
    rest = {"integrator.t_gbw_s": 3.1831e-9, "conveyor.t_pole_s": 7.9577e-9, "mirror.t_pole_s": 7.9577e-9}
    rest["sensor.force_min_n"] = 0.11673
    # Five digits worked out by hand: 1 / (2 pi f), and 7500 N.ohm over 64250 ohm.
    assert {key: found[key] for key in found.keys() - exact} == pytest.approx(rest, rel=1e-4)
    assert design.resistance_full_scale_ohm == 500.0
    assert design.duty(500.0) == 0.5
    assert design.duty(0.0) == math.inf
    assert design.duty(math.inf) == 0.0


def test_every_stored_value_has_a_marked_reason_and_nothing_else_has() -> None:
    reasons = dd.reasons()
    assert set(reasons) == set(dd.load().stored())
    bare = [key for key, reason in reasons.items() if not reason.mark or len(reason.text) < 10]
    assert bare == []


@pytest.mark.paper
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rows = 16", "rows = 16\nrows = 16", "Cannot overwrite a value"),
        ("rows = 16", "rows = 16\nrow_pitch_mm = 5", "row_pitch_mm = 5: unknown key; known here: c_column_f"),
        ("frame_s = 2e-3", "frame_ms = 2", "timing.frame_ms = 2: unknown key"),
        ("frame_s = 2e-3", "frame_s = '2 ms'", 'timing.frame_s = "2 ms": a finite number > 0'),
        ("frame_s = 2e-3", "", "timing.frame_s = nothing: a finite number > 0"),
        ("frame_s = 2e-3", "frame_s = 2e-3\nslot_clocks = 625", "timing.slot_clocks = 625: derived"),
        ("gate_clocks = 510", "gate_clocks = 510.0", "timing.gate_clocks = 510.0: a whole number"),
        ("rows = 16", "rows = 0", "array.rows = 0: a whole number 1..1024"),
        ("[ambient]", "[weather]", "weather = "),
        ("[array]", '"" = 510.0\n[array]', "scene = 510.0: unknown key"),
        ('topology = "conveyor_mirror"', 'topology = "magic"', 'topology = "magic": one of "direct"'),
        # cross-checks
        ("gate_clocks = 510", "gate_clocks = 625", "timing.gate_clocks = 625: at most 622 of the 625 clocks"),
        ("gate_clocks = 510", "gate_clocks = 508", "gate_clocks = 508: at least 510 clocks for 8 bits"),
        ("code_bits = 8", "code_bits = 9", "at least 1022 clocks for 9 bits"),
        ("frame_s = 2e-3", "frame_s = 2.001e-3", "whole clocks, not of 625.3125"),
        ("r_max_ohm = 64250.0", "r_max_ohm = 400.0", "r_max_ohm = 400.0: above sensor.r_min_ohm = 500.0"),
        ("[0.2, 1.0, 10.0, 100.0]", "[0.2, 1.0, 1.0, 100.0]", "force_points_n = [0.2, 1.0, 1.0, 100.0]"),
        ("[30e3, 6e3, 1e3, 250.0]", "[30e3, 6e3, 1e3]", "[30000.0, 6000.0, 1000.0]: 4 resist"),
        ("[30e3, 6e3, 1e3, 250.0]", "[30e3, 6e3, 1e3, 2e3]", "sensor.r_points_ohm = [30000.0"),
        ("r_open_ohm = 1e7", "r_open_ohm = 2e4", "sensor.r_open_ohm = 20000.0: above the first"),
        ("r_min_ohm = 500.0", "r_min_ohm = 499.0", "r_min_ohm = 499.0: at least 2 v_bias_v / (k i0_a)"),
        ("k = 80", "k = 81", "interface.k = 81: one of k_options"),
        ("[20, 40, 80, 160]", "[80, 40, 20, 160]", "four different ratios, rising"),
        ("[20, 40, 80, 160]", "[20, 40, 160]", "k_options = [20, 40, 160]: a list of 4"),
        ("[20, 40, 80, 160]", "[20, 40, 80]", "interface.k_options"),
        ("c_int_f = 5e-12", "c_int_f = 3e-12", "converter.c_int_f = 3e-12: a packet of at most 1.5 V"),
        ("v_out_max_v = 1.5", "v_out_max_v = 1.7", "at most supply.vdd_v"),
        ("v_out_min_v = -1.5", "v_out_min_v = -1.7", "at least supply.vss_v"),
        ("t_edge_s = 1e-9", "t_edge_s = 1e-7", "converter.t_edge_s = 1e-07: below half a clock"),
        ("r_floor_ohm = 1e-3", "r_floor_ohm = 600.0", "array.r_floor_ohm = 600.0: below sensor.r_min_ohm"),
    ],
)
def test_a_wrong_design_file_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    error = refused(load_changed, tmp_path, old, new)
    assert error.file == str(tmp_path / "design.toml")
    assert said in str(error)


@pytest.mark.paper
def test_replace_derives_anew_and_checks() -> None:
    design = dd.load().replace(timing={"frame_s": 4e-3})
    assert (design.timing.slot_clocks, design.timing.settle_clocks) == (1250, 740)
    assert dd.load().timing.slot_clocks == 625
    with pytest.raises(InputError, match=r"timing\.gate_clocks"):
        dd.load().replace(timing={"frame_s": 1.6e-3})
    with pytest.raises(InputError, match=r"nonsense"):
        dd.load().replace(nonsense={"a": 1})


@given(st.floats(min_value=1e-3, max_value=1e9))
def test_duty_is_the_correctly_rounded_quotient(resistance: float) -> None:
    # 250 ohm is V_b / (k i0) as a decimal; a product of doubles would not give the nearest double everywhere.
    assert dd.load().duty(resistance) == float(250 / dd.exact(resistance))


ENTRY = 'max = 1\nunit = "lsb"\ngate = true\nconditions = "c"\ncommand = "make sim"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'["a.b"]\n{ENTRY}["a.b"]\n{ENTRY}', "Cannot declare"),
        (f'["a.b"]\n{ENTRY}typ = 2\n', "a.b.typ = 2: unknown key"),
        (f'["a.b"]\n{ENTRY}'.replace("max = 1", "max = '1'"), 'a.b.max = "1"'),
        (f'["a.b"]\n{ENTRY}'.replace("max = 1\n", ""), "at least one of them"),
        (f'["a.b"]\n{ENTRY}min = 2\n', "a.b.min = 2"),
        (f'["a.b"]\n{ENTRY}'.replace('unit = "lsb"\n', ""), "a.b.unit = nothing"),
        (f"[a]\n{ENTRY}", "a quoted table name"),
        (f"[a.b]\n{ENTRY}", "a quoted table name"),
    ],
)
def test_a_wrong_spec_file_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "spec.toml"
    path.write_text(text, encoding="utf-8")
    assert said in str(refused(dd.load_spec, path))


def test_every_make_target_of_a_limit_exists() -> None:
    makefile = (dd.ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, flags=re.MULTILINE))
    wanted = {limit.command.split()[1] for limit in dd.spec().values() if limit.command.startswith("make ")}
    assert wanted
    assert wanted - targets == set()


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("frame.code_error_lsb", 1, "PASS"),
        ("frame.code_error_lsb", 2, "FAIL"),
        ("frame.code_error_lsb", None, "ERROR"),
        ("frame.code_error_lsb", math.nan, "ERROR"),
        ("frame.code_error_lsb", math.inf, "ERROR"),
        ("cosim.edge_error_v.step_10n", 1e-11, "PASS"),
        ("cosim.edge_error_v.step_10n", 1.0001e-11, "FAIL"),
        ("cosim.clocks_per_s.icarus", 5000, "PASS"),
        ("cosim.clocks_per_s.icarus", 4999, "SKIP"),
        ("cosim.frame_s", 61.0, "SKIP"),
        ("calculator.full_scale_code_error_lsb", -1, "FAIL"),
    ],
)
def test_a_value_gets_the_one_status_its_limit_gives(name: str, value: float | None, status: str) -> None:
    row = verdict.judge(name, value, "why")
    assert row["status"] == status
    assert set(row) == {"name", "value", "unit", "min", "max", "status", "note"}
    assert row["name"] == name
    assert row["note"]


def test_a_missed_aim_says_what_it_reached_and_what_was_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    row = verdict.judge("cosim.clocks_per_s.icarus", 4999, "why")
    assert row["note"] == "aim missed: 4999, wanted at least 5000; why"
    assert verdict.judge("cosim.frame_s", 61.0)["note"] == "aim missed: 61, wanted at most 60"
    met, unmeasured = verdict.judge("cosim.frame_s", 1.0), verdict.skip("cosim.frame_s", "no ngspice")
    assert verdict.aims_missed([row, met, unmeasured]) == [row]
    verdict.print_rows([row, met, unmeasured])
    assert "2 SKIP, 1 of them missed aims" in capsys.readouterr().out


def test_a_name_without_a_limit_is_not_judged() -> None:
    with pytest.raises(KeyError, match="no limit"):
        verdict.judge("frame.nonsense", 1)
    assert verdict.report("frame.nonsense", 1.5, "V")["status"] == "PASS"
    assert verdict.report("frame.nonsense", math.nan, "V")["status"] == "ERROR"


GOOD, BAD, LOST = (verdict.judge("frame.code_error_lsb", value, "taxel [3, 4]") for value in (0, 9, None))
SKIP = verdict.skip("frame.code_error_lsb", "no [red] frames")


@pytest.mark.parametrize(("rows", "code"), [([GOOD, SKIP], 0), ([GOOD, BAD], 1), ([GOOD, LOST], 1), ([], 1)])
def test_exit_code_misses_on_fail_on_error_and_on_no_rows(rows: list[verdict.Row], code: int) -> None:
    assert verdict.exit_code(rows) == code


def test_rows_are_written_as_strict_json_and_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "BUILD", tmp_path / "build")
    rows = [verdict.judge("frame.code_error_lsb", math.nan), verdict.judge("frame.code_error_lsb", 1)]
    verdict.write_rows("t", rows)
    text = (tmp_path / "build" / "t.json").read_text()
    assert json.loads(text, parse_constant=lambda name: pytest.fail(name)) == rows
    with pytest.raises(ValueError, match="JSON"):
        verdict.write_rows("t", [rows[1] | {"value": math.inf}])
    assert (tmp_path / "build" / "t.json").read_text() == text
    assert [p.name for p in (tmp_path / "build").iterdir()] == ["t.json"]


def test_the_table_shows_every_status_and_brackets_of_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    verdict.print_rows([GOOD, BAD, LOST, SKIP], "a title [/s]")
    shown = capsys.readouterr().out
    assert "a title [/s]" in shown
    assert "taxel [3, 4]" in shown
    assert "no [red] frames" in shown
    assert "1 PASS, 1 FAIL, 1 ERROR, 1 SKIP" in shown
