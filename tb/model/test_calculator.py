# SPDX-License-Identifier: Apache-2.0
"""The calculator: the paper's targets gives the paper's design, feasible targets hold, others say why not."""

import json
import math
import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dermis.converter import vfc
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design as dd
from scripts import calculator
from scripts.calculator import make_targets, solve

# What the paper states; nothing of the answer is in it.
PAPER_TARGETS = {"rows": 16, "cols": 16, "frame_s": 2e-3, "bits": 8, "settle_fraction": 0.184}
PAPER_TARGETS |= {"force_max_n": 15.0, "k_force_n_ohm": 7500.0, "r_max_ohm": 64250.0, "i_sensor_a": 1e-3}
PAPER_TARGETS |= {"c_int_f": 5e-12, "packet_v": 1.0, "topology": "conveyor_mirror"}


@pytest.mark.paper
@pytest.mark.parametrize("targets", [{}, PAPER_TARGETS])
def test_the_papers_targets_give_exactly_the_papers_design(targets: dict[str, Any]) -> None:
    answer = solve(make_targets(**targets))
    assert answer.feasible
    assert (answer.slot_clocks, answer.gate_clocks, answer.settle_clocks) == (625, 510, 115)
    assert (answer.f_clk_hz, answer.i0_a, answer.c_int_f) == (5_000_000, Fraction("25e-6"), Fraction("5e-12"))
    assert (answer.k, answer.packet_v, answer.r_unit_ohm) == (80, 1, 250)
    assert answer.design() == dd.load()


@pytest.fixture(autouse=True)
def build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place of the test's own for verdicts."""
    monkeypatch.setattr(verdict, "BUILD", tmp_path)
    return tmp_path


targets = st.fixed_dictionaries(
    {
        "rows": st.integers(1, 128),
        "cols": st.integers(1, 128),
        "bits": st.integers(2, 10),
        "frame_s": st.floats(1e-4, 1.0),
        "settle_fraction": st.floats(0.0, 0.9),
        "r_min_ohm": st.floats(50.0, 1e5),
        "c_int_f": st.one_of(st.none(), st.floats(0.2e-12, 50e-12)),
        "packet_v": st.one_of(st.none(), st.floats(0.05, 1.5)),
        "k": st.one_of(st.none(), st.sampled_from(dd.load().interface.k_options)),
        "topology": st.sampled_from(dd.TOPOLOGIES),
    }
)


def in_range(targets: dict[str, Any]) -> dict[str, Any]:
    """Add a range that the bits resolve."""
    return targets | {"r_max_ohm": targets["r_min_ohm"] * 2 ** targets["bits"] * 0.9}


@settings(deadline=None, max_examples=100, derandomize=True)
@given(targets)
def test_feasible_targets_become_a_design_that_meets_them(targets: dict[str, Any]) -> None:
    answer = solve(make_targets(**in_range(targets)))
    assume(answer.feasible)
    # The loader accepts it and derives the same clocks.
    design = answer.design()
    assert design.timing.slot_clocks == answer.slot_clocks
    assert design.timing.settle_clocks == answer.settle_clocks >= design.timing.break_clocks + 2
    # Clocks are whole: a millionth of one is the rounding of the product.
    assert answer.settle_clocks >= targets["settle_fraction"] * answer.slot_clocks - 1e-6
    assert design.timing.frame_s == targets["frame_s"]
    # The targets went through a decimal of 12 digits.
    assert design.converter.packet_v <= min(targets["packet_v"] or 1.5, design.swing_v) * (1 + 1e-12)
    # The converter of that design, walked through clock by clock, has the bits and the range.
    code_max = 2 ** targets["bits"] - 1
    gate = design.timing.gate_clocks
    at_full = dd.exact(design.interface.v_bias_v) / (design.interface.k * dd.exact(design.converter.i0_a))
    x, low = (at_full / dd.exact(r) for r in (design.sensor.r_min_ohm, design.sensor.r_max_ohm))
    # doubles of the design carry x = 1/2 to 1e-12
    assert abs(x - Fraction(1, 2)) < Fraction(1, 10**12)
    assert design.interface.v_bias_v / design.sensor.r_min_ohm <= 1e-3 * (1 + 1e-12)
    asked = (Fraction(1, 2), x, Fraction(code_max - 1, gate))
    assert [vfc.count_exact(at, gate) for at in asked] == [code_max, code_max, code_max - 1]
    assert vfc.count_exact(low, gate) >= 1
    # The same targets change nothing in it.
    again = solve(make_targets(**in_range(targets)), design)
    assert (again.k, again.gate_clocks, again.slot_clocks) == (answer.k, gate, answer.slot_clocks)
    assert math.isclose(again.c_int_f, answer.c_int_f, rel_tol=1e-12)
    judged = solve(None, design)
    assert (judged.feasible, judged.slot_clocks) == (True, answer.slot_clocks)


@pytest.mark.paper
def test_a_design_edited_by_hand_is_judged_as_it_is() -> None:
    design = dd.load().replace(converter={"c_int_f": 1e-11, "f_clk_hz": 5.2e6})
    assert (answer := solve(base=design)).feasible
    assert answer.design() == design
    loose = design.replace(sensor={"r_min_ohm": 800.0})
    # 510 x 0.5 V / (80 x 25 uA x 800 ohm) + 1/2
    assert judged(solve(base=loose))["full_scale_code_error_lsb"]["value"] == 159 - 255


def judged(answer: calculator.Answer) -> dict[str, verdict.Row]:
    return {row["name"].removeprefix("calculator."): row for row in answer.rows}


IMPOSSIBLE = [
    # limit, targets, a piece of what is said
    ("sensor_current_a", {"i_sensor_a": 2e-3}, "1 V on 500 ohm"),
    ("v_bias_supply", {"v_bias_v": 2.0, "r_min_ohm": 5000.0}, "2 V of 1.65 V"),
    ("k_distance", {"k": 50}, "k = 50, switchable 20, 40, 80, 160"),
    ("k_distance", {"i0_a": 1e-6}, "k = 2000"),
    ("duty_full_scale", {"v_bias_v": 0.5, "k": 80, "i0_a": 20e-6}, "500 ohm"),
    ("full_scale_code_error_lsb", {"gate_clocks": 510, "bits": 9}, "(8 bits), wanted 511"),
    ("full_scale_code_error_lsb", {"gate_clocks": 516}, "count to 258"),
    ("code_at_r_max", {"force_min_n": 0.01}, "750000 ohm"),
    ("beyond_the_chip", {"rows": 200, "cols": 129, "frame_s": 0.01}, "cols = 129: the chip does 1 to 128"),
    ("beyond_the_chip", {"bits": 4, "cols": 128, "rows": 4}, "30: the chip does 160 to 65535 clocks"),
    ("beyond_the_chip", {"bits": 5, "gate_clocks": 62, "cols": 64}, "62: the chip does 88 to"),
    ("beyond_the_chip", {"bits": 16, "frame_s": 0.1}, "131070: the chip does"),
    ("beyond_the_chip", {"settle_fraction": 0.995, "frame_s": 2.0}, "101490: the chip does 3 to"),
    ("beyond_the_chip", {"f_clk_hz": 5e6, "frame_s": 1.0}, "timing.settle_clocks = 311990"),
    ("gate_margin_clocks", {"f_clk_hz": 4e6}, "f_clk_hz = 5e+06 would do, or 7 bits"),
    ("gate_margin_clocks", {"f_clk_hz": 4e6, "frame_rate_hz": 500.0}, "slot 500"),
    ("settle_s", {"frame_rate_hz": 1e4}, "115 clocks"),
    ("settle_s", {"settle_fraction": 0.0}, "3 clocks"),
    ("settle_s", {"f_clk_hz": 5e6, "frame_s": 1.64e-3, "settle_fraction": 0.0}, "2 clocks"),
    ("mirror_settling", {"i_sensor_a": 1e-6, "packet_v": 0.1}, "time constant 0.000129 s"),
    ("comparator_delay_clocks", {"frame_s": 5e-5}, "f_clk up to 1e+08 Hz"),
    ("comparator_delay_clocks", {"f_clk_hz": 2e8}, "f_clk up to 1e+08 Hz"),
    ("core_clock_hz", {"rows": 128}, "before layout"),
    ("core_clock_hz", {"f_clk_hz": 4e7, "frame_s": 1e-3}, "before layout"),
    ("spi_time", {"rows": 64, "cols": 64, "frame_rate_hz": 800.0}, "4682 bytes in 0.00187 s"),
    ("spi_time", {"rows": 128, "cols": 128, "frame_rate_hz": 250.0}, "18570 bytes in 0.00743 s"),
    ("packet_swing", {"c_int_f": 2e-12, "packet_v": 0.5}, "at most 0.5 V"),
    ("c_int_f", {"c_int_f": 5e-14}, "packet 2.5e-12 C"),
    ("leak_plateau_lsb", {"topology": "direct", "gain_dc": 1000.0}, "1.251e-05 s, at least 5.1e-05 s"),
    ("kt_c_lsb", {"packet_v": 1e-5}, "C on a packet of"),
    ("kt_c_lsb", {"c_int_f": 1e-4}, "C on a packet of"),
]


@pytest.mark.paper
@pytest.mark.parametrize(("name", "targets", "said"), IMPOSSIBLE)
def test_impossible_targets_name_a_limit_and_the_nearest_meet_it(name: str, targets: dict, said: str) -> None:
    answer = solve(make_targets(**targets))
    assert not answer.feasible
    row = judged(answer)[name]
    assert row["status"] == "FAIL"
    assert said in row["note"]
    with pytest.raises(InputError, match="impossible"):
        answer.design()
    nearest = answer.nearest[f"calculator.{name}"]
    assert nearest
    assert all(key in row["note"] for key in nearest)
    row = judged(solve(make_targets(**(targets | nearest))))[name]
    assert row["status"] == "PASS", row["note"]


def test_every_limit_of_the_calculator_is_missed_by_some_targets() -> None:
    limits = {name.removeprefix("calculator.") for name in dd.spec() if name.startswith("calculator.")}
    assert {name for name, _, _ in IMPOSSIBLE} == limits == set(judged(solve()))


@settings(deadline=None, max_examples=200, derandomize=True)
@given(
    targets,
    st.sampled_from([{}, {"f_clk_hz": 5e6}, {"gate_clocks": 510}, {"gain_dc": 100.0}, {"v_bias_v": 0.5}]),
)
def test_the_nearest_targets_meet_each_missed_limit(targets: dict[str, Any], more: dict[str, Any]) -> None:
    targets = in_range(targets) | more
    try:
        answer = solve(make_targets(**targets))
    except InputError:
        assume(False)
    assert {r["name"] for r in answer.rows if r["status"] == "FAIL"} == set(answer.nearest)
    for name, nearest in answer.nearest.items():
        row = judged(solve(make_targets(**(targets | nearest))))[name.removeprefix("calculator.")]
        assert row["status"] == "PASS", (name, nearest, row["note"])


@pytest.mark.paper
def test_leak_and_noise_are_those_of_their_formulas() -> None:
    rows = judged(solve(make_targets(topology="direct")))
    # Second plateau of the leaky integrator, the widest; tau is that of 400 pF at 31.25 ohm beside 1 Gohm, gain 1e4.
    lam = math.exp(-200e-9 / ((1e4 + 1) / (1 / 31.25 + 1e-9) * 400e-12))
    # 1 - lam loses five digits where lam is 1 - 1e-5; ten are left.
    assert rows["leak_plateau_lsb"]["value"] == pytest.approx(510 * (1 - lam) ** 2 / (1 - lam**2), rel=1e-9)
    # sqrt(kT/C) / 1 V has three digits here and the temperature one; direct has k = 80 times the charge.
    assert rows["kt_c_lsb"]["value"] == pytest.approx(2.88e-5 / math.sqrt(80), rel=1e-2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--frame-s", "nan"], "frame_s = nan"),
        (["--settle-fraction", "1"], "settle_fraction = 1.0"),
        (["--bits", "17"], "bits = 17"),
        (["--frame-s", "1e-3", "--frame-rate-hz", "1000"], "frame_rate_hz = 1000.0: no value"),
        (["--r-min-ohm", "500", "--force-max-n", "15", "--k-force-n-ohm", "7000"], "k_force_n_ohm = 7000.0"),
        (["--r-min-ohm", "500", "--r-max-ohm", "400"], "r_max_ohm = 400.0: above the 500 ohm"),
        (["--force-min-n", "20"], "force_min_n = 20.0: below the full force"),
        (["--f-clk-hz", "100", "--frame-s", "1e-3"], "f_clk_hz = 100.0: at least one clock"),
        pytest.param(
            "--write --bits 9 --f-clk-hz 4e6".split(), "gate_margin_clocks", marks=pytest.mark.paper
        ),
    ],
)
def test_wrong_targets_are_refused_in_one_line(arguments: list[str], said: str) -> None:
    before = dd.DESIGN_FILE.read_bytes()
    run = CliRunner().invoke(calculator.calc_command, arguments)
    assert isinstance(run.exception, InputError)
    assert run.exception.exit_code == 2
    assert said in str(run.exception)
    assert "\n" not in str(run.exception)
    assert dd.DESIGN_FILE.read_bytes() == before


@pytest.mark.parametrize(("arguments", "code"), [([], 0), (["--k", "50"], 1)])
def test_the_command_prints_the_design_and_its_verdict(arguments: list[str], code: int, build: Path) -> None:
    run = CliRunner().invoke(calculator.calc_command, arguments)
    assert run.exit_code == code
    for word in ("f_clk_hz", "gate_clocks", "i0_a", "v_bias_v", "c_int_f", "code by eq. (3)", "kt_c_lsb"):
        assert word in run.output
    rows = json.loads((build / "calc.json").read_text())
    assert [row["status"] for row in rows].count("FAIL") == code


@pytest.mark.paper
def test_write_changes_values_and_keeps_every_comment(tmp_path: Path) -> None:
    path = tmp_path / "design.toml"
    shutil.copy(dd.DESIGN_FILE, path)
    targets = {"rows": 32, "cols": 32, "bits": 10, "f_clk_hz": 1e7, "frame_s": 8e-3, "settle_fraction": 0.18}
    answer = solve(make_targets(**targets))
    changed = calculator.write_design(answer, path)
    assert dd.load(path) == answer.design()
    assert {"array.rows", "timing.code_bits", "converter.f_clk_hz", "timing.frame_s"} <= set(changed)
    assert dd.reasons(path) == dd.reasons()
    before, after = dd.DESIGN_FILE.read_text().splitlines(), path.read_text().splitlines()
    assert len(before) == len(after)
    assert len(changed) == sum(a != b for a, b in zip(before, after, strict=True))
    # A second write keeps the note of the first, which names the value that the reason belongs to.
    again = solve(make_targets(rows=64, frame_s=16e-3), dd.load(path))
    calculator.write_design(again, path)
    assert "rows = 64 # dermis calc; the reason above is that of 16\n" in path.read_text()
    assert calculator.write_design(solve(base=dd.load(path)), path) == []


@pytest.mark.paper
@pytest.mark.parametrize(("options", "warned"), [("--rows 8 --frame-s 0.001", False), ("--k 40", True)])
def test_write_says_that_transistors_are_sized_for_another_design(
    options: str, warned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calculator, "write_atomic", lambda path, text: None)
    run = CliRunner().invoke(calculator.calc_command, ["--write", *options.split()])
    assert run.exception is None, run.exception
    assert "written: " in run.output
    assert ("the transistors of spice/sky130 are sized for" in run.output) == warned, run.output


def test_the_sensor_keeps_its_k_force_when_one_end_is_named() -> None:
    assert solve(make_targets(r_min_ohm=1000.0)).values()["force_max_n"] == 7.5
    assert solve(make_targets(force_max_n=7.5)).r_min_ohm == 1000
    assert solve(make_targets(r_min_ohm=1000.0, force_max_n=15.0)).k_force_n_ohm == 15_000
    assert solve(make_targets(force_min_n=0.25)).r_max_ohm == 30_000
