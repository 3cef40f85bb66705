# SPDX-License-Identifier: Apache-2.0
"""What is generated from design.toml: up to date in the tree, right in content, and every drift caught."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis.chip import spice_text
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design as dd
from scripts import generate

GENERATED = (
    "rtl/dermis_design.vh",
    "spice/design.inc",
    "spice/array/array.sp",
    "spice/sky130/dermis_analog_front_end.sp",
    "rtl/dermis_registers.v",
    "rtl/dermis_registers.h",
    "models/dermis/chip/register_map.py",
    "rtl/synth/dermis.sdc",
    "rtl/harden/config.json",
    "docs/numbers.md",
    "docs/effects.md",
    "docs/registers.md",
    "docs/scenes.md",
)
READ = ("models/design.toml", "models/spec.toml", "rtl/dermis_registers.rdl")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Copy what generation reads and writes into a tree of its own."""
    for name in (*GENERATED, *READ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(dd.ROOT / name, tmp_path / name)
    return tmp_path


def test_the_tree_is_up_to_date() -> None:
    assert generate.drift() == {}
    assert tuple(generate.generate_all()) == GENERATED


@pytest.mark.long
@pytest.mark.paper
@pytest.mark.parametrize(
    ("path", "old", "new"),
    [
        ("rtl/dermis_design.vh", "DERMIS_GATE_CLOCKS   510", "DERMIS_GATE_CLOCKS   512"),
        ("rtl/synth/dermis.sdc", "set clk_period 200.0", "set clk_period 250.0"),
        ("rtl/harden/config.json", '"CLOCK_PERIOD": 200.0', '"CLOCK_PERIOD": 100.0'),
        ("spice/design.inc", "converter_i0_a = 2.5e-05", "converter_i0_a = 2.6e-05"),
        ("spice/array/array.sp", "rtaxel_r3c4 r3 c4", "rtaxel_r3c4 r4 c3"),
        ("docs/numbers.md", "| `timing.settle_clocks` | 115 |", "| `timing.settle_clocks` | 113 |"),
        ("docs/numbers.md", "| 500 | 15 | 0.5 | 2.5e+06 | 255 |", "| 500 | 15 | 0.5 | 2.5e+06 | 256 |"),
        ("docs/effects.md", "`Network.r_column_ohm`", "`Network.r_row_ohm`"),
        ("docs/scenes.md", "In series with every grounded row", "In series with every other row"),
        ("docs/registers.md", "| 04 | `SETTLE` |", "| 05 | `SETTLE` |"),
        ("rtl/dermis_registers.v", "address_i == 8'h05", "address_i == 8'h06"),
        ("models/dermis/chip/register_map.py", "GATE = 0x05", "GATE = 0x06"),
    ],
)
def test_a_seeded_drift_is_caught_shown_and_repaired(tree: Path, path: str, old: str, new: str) -> None:
    text = (tree / path).read_text()
    assert old in text
    (tree / path).write_text(text.replace(old, new, 1))
    found = generate.drift(tree)
    assert list(found) == [path]
    difference = found[path].splitlines()
    assert any(line.startswith("-") and new in line for line in difference)
    assert any(line.startswith("+") and old in line for line in difference)
    rows = generate.check(tree)
    assert [row["name"] for row in rows if row["status"] == "FAIL"] == [
        "generate.drift_files." + path.replace("/", "_").replace(".", "_")
    ]
    assert verdict.exit_code(rows) == 1
    assert generate.write(tree) == [path]
    assert (tree / path).read_text() == text
    assert generate.drift(tree) == {}


@pytest.mark.paper
def test_a_changed_value_makes_every_file_that_holds_it_drift(tree: Path) -> None:
    """All but docs/scenes.md, which has keys and no values, and the registers in Verilog, which have parameters."""
    toml = tree / "models" / "design.toml"
    text = toml.read_text()
    for old, new in (
        ("rows = 16", "rows = 8"),
        ("frame_s = 2e-3", "frame_s = 1e-3"),
        ("f_clk_hz = 5e6", "f_clk_hz = 1e7"),
    ):
        text = text.replace(old, new, 1)
    toml.write_text(text)
    assert set(generate.drift(tree)) == set(GENERATED) - {
        "docs/scenes.md",
        "rtl/dermis_registers.v",
    }


def test_a_missing_generated_file_is_a_drift(tree: Path) -> None:
    (tree / "spice/design.inc").unlink()
    assert generate.drift(tree) == {"spice/design.inc": "missing"}


def test_changed_line_ends_are_a_drift(tree: Path) -> None:
    path = tree / "spice/design.inc"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert list(generate.drift(tree)) == ["spice/design.inc"]


def test_text_outside_the_tables_of_a_doc_is_left_alone(tree: Path) -> None:
    path = tree / "docs/numbers.md"
    path.write_text("# A word first\n" + path.read_text())
    assert generate.drift(tree) == {}


def test_a_doc_that_lost_the_mark_of_a_table_is_refused(tree: Path) -> None:
    path = tree / "docs/numbers.md"
    path.write_text(path.read_text().replace("<!-- end: design -->", ""))
    with pytest.raises(InputError, match="table design"):
        generate.generate_all(tree)


@pytest.mark.paper
def test_the_command_fails_on_drift_and_writes_only_without_check(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for function in ("write", "check", "drift"):
        monkeypatch.setattr(generate, function, _rooted(getattr(generate, function), tree))
    monkeypatch.setattr(verdict, "BUILD", tree / "build")
    path = tree / "rtl/dermis_design.vh"
    good = path.read_text()
    path.write_text(good.replace("510", "512"))
    bad = path.read_text()
    run = CliRunner().invoke(generate.generate_command, ["--check"])
    assert run.exit_code == 1
    assert path.read_text() == bad
    assert "DERMIS_GATE_CLOCKS" in run.output
    assert (tree / "build" / "gen-check.json").exists()
    run = CliRunner().invoke(generate.generate_command, [])
    assert (run.exit_code, path.read_text()) == (0, good)
    assert "written: rtl/dermis_design.vh" in run.output
    assert CliRunner().invoke(generate.generate_command, ["--check"]).exit_code == 0


def _rooted(function: Callable[..., Any], root: Path) -> Callable[..., Any]:
    """Let a function work in another tree unless it is told where."""
    return lambda *where: function(*(where or (root,)))


def test_the_header_is_legal_verilog_with_the_design_values(tmp_path: Path) -> None:
    bench = tmp_path / "t.v"
    names = ("ROWS", "COLS", "CODE_BITS", "GATE_CLOCKS", "SETTLE_CLOCKS", "SLOT_CLOCKS", "T_CLK_PS")
    show = "".join(f'$display("%0d", `DERMIS_{name}); ' for name in names)
    bench.write_text(f'`include "dermis_design.vh"\nmodule t; initial begin {show}end endmodule\n')
    out = tmp_path / "t.vvp"
    subprocess.run(["iverilog", "-I", dd.ROOT / "rtl", "-o", out, bench], check=True)
    said = subprocess.run(["vvp", "-n", out], check=True, capture_output=True, text=True).stdout.split()
    array, timing = dd.load().array, dd.load().timing
    clocks = (timing.gate_clocks, timing.settle_clocks, timing.slot_clocks)
    period_ps = round(1e12 / dd.load().converter.f_clk_hz)
    assert said == [str(v) for v in (array.rows, array.cols, timing.code_bits, *clocks, period_ps)]


def spice_op(tmp_path: Path, deck: str, *vectors: str) -> dict[str, float]:
    """Run an operating point and return what ngspice prints, by name; each vector must be there."""
    path = tmp_path / "deck.sp"
    path.write_text(f"* t\n{deck}\n.control\nset numdgt=15\nop\nprint {' '.join(vectors)}\n.endc\n.end\n")
    out = subprocess.run(["ngspice", "-b", path], capture_output=True, text=True, timeout=60)
    found = dict(re.findall(r"^(\S+) = (\S+)$", out.stdout, flags=re.MULTILINE))
    assert set(vectors) <= set(found), out.stdout + out.stderr
    return {name: float(found[name]) for name in vectors}


def test_ngspice_reads_every_parameter_as_design_toml_has_it(tmp_path: Path) -> None:
    design = dd.load()
    want: dict[str, float] = {}
    for key, value in (design.stored() | design.derived()).items():
        name = key.replace(".", "_")
        if isinstance(value, list):
            want |= {f"{name.removesuffix('_options')}_{i}": v for i, v in enumerate(value)}
        elif not isinstance(value, str):
            want[name] = value
    lines = [f".include {dd.ROOT / 'spice/design.inc'}"]
    # as a voltage: a number of any size comes back to 15 digits
    lines += [f"v{i} n{i} 0 {{{name}}}" for i, name in enumerate(want)]
    got = spice_op(tmp_path, "\n".join(lines), *(f"v(n{i})" for i in range(len(want))))
    assert len(want) > 50
    for i, (name, value) in enumerate(want.items()):
        # ngspice prints 15 digits and its parser makes a few roundings of them.
        assert got[f"v(n{i})"] == pytest.approx(value, rel=1e-12, abs=0), name


def array_deck(
    include: str, subckt: str, parameters: str, cols: int = 16, rows: int = 16, driven: int = 3
) -> str:
    """Drive one row at 1 V, ground the others, hold each column at 0 V through a current probe."""
    pins = [f"row{r}" if r == driven else "0" for r in range(rows)] + [f"col{c}" for c in range(cols)]
    lines = [include, "xarray"]
    lines += ["+ " + " ".join(pins[i : i + 16]) for i in range(0, len(pins), 16)]
    lines += [f"+ {subckt} {parameters}", f"vrow row{driven} 0 1"]
    lines += [f"vc{c} col{c} 0 0" for c in range(cols)]
    return "\n".join(lines)


@pytest.mark.paper
@pytest.mark.parametrize("subckt", ["array", "array_lateral"])
def test_each_taxel_of_the_array_file_is_its_own_parameter(tmp_path: Path, subckt: str) -> None:
    include = f".include {dd.ROOT / 'spice/array/array.sp'}"
    deck = array_deck(include, subckt, "r_r3c4_ohm=500 r_r4c3_ohm=700")
    got = spice_op(tmp_path, deck, *(f"i(vc{c})" for c in range(16)))
    # ideal columns: lateral resistors and other rows carry nothing
    for c in range(16):
        # gmin, 1e-12 S beside 1.6e-5 S of the smallest taxel, at a node of at most 1 uV.
        assert got[f"i(vc{c})"] == pytest.approx(1 / 500 if c == 4 else 1 / 64250, rel=1e-9), c


@pytest.mark.paper
@pytest.mark.parametrize(("subckt", "coupled"), [("array", False), ("array_lateral", True)])
def test_lateral_resistors_join_neighbouring_columns_of_every_row(
    tmp_path: Path, subckt: str, coupled: bool
) -> None:
    lift = " ".join(f"r_r{r}c{c}_ohm=1e15" for r in range(16) for c in range(16))
    pins = " ".join(["0"] * 16 + [f"col{c}" for c in range(16)])
    lateral = " r_lateral_ohm=1600" if coupled else ""
    lines = [f".include {dd.ROOT / 'spice/array/array.sp'}", f"xarray {pins} {subckt} {lift}{lateral}"]
    lines += ["vdrive col0 0 1", "vend col15 0 0"]
    got = spice_op(tmp_path, "\n".join(lines), "i(vend)", "v(col6)")
    # 16 rows of 1600 ohm in parallel are 100 ohm a step, 15 steps from end to end
    assert got["i(vend)"] == pytest.approx(1 / 1500 if coupled else 0.0, rel=1e-6, abs=1e-9)
    if coupled:
        # gmin at 16 nodes beside resistors of 1e15 ohm and 100 ohm a step: parts in 1e9; ngspice's reltol
        # 1e-6 bounds it.
        assert got["v(col6)"] == pytest.approx(1 - 6 / 15, rel=1e-6)


def test_an_array_of_real_resistances_solves_with_opens_and_shorts(tmp_path: Path) -> None:
    resistance = np.full((3, 4), 1000.0)
    resistance[1] = [np.inf, 250.0, 0.0, 1e4]
    text = spice_text.array_subckt(3, 4, resistance, lateral_ohm=np.inf)
    deck = array_deck(text, "array", "", cols=4, rows=3, driven=1)
    got = spice_op(tmp_path, deck, *(f"i(vc{c})" for c in range(4)))
    # gmin, 1e-12 S, at the 1 V across an open taxel; the others as in the array above.
    assert got["i(vc0)"] == pytest.approx(0.0, abs=1e-11)
    assert got["i(vc1)"] == pytest.approx(1 / 250, rel=1e-9)
    assert got["i(vc2)"] == pytest.approx(1 / dd.load().array.r_floor_ohm, rel=1e-9)
    assert got["i(vc3)"] == pytest.approx(1e-4, rel=1e-9)
    assert "rtaxel_r1c0" not in text
    assert "rlat" not in text


def test_elements_are_named_and_placed_by_row_and_column() -> None:
    text = spice_text.array_subckt(
        2, 3, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], lateral_ohm=[[7.0, 8.0], [9.0, np.inf]]
    )
    assert text.splitlines() == [
        ".subckt array",
        "+ r0 r1 c0 c1 c2",
        "rtaxel_r0c0 r0 c0 1.0",
        "rtaxel_r0c1 r0 c1 2.0",
        "rtaxel_r0c2 r0 c2 3.0",
        "rtaxel_r1c0 r1 c0 4.0",
        "rtaxel_r1c1 r1 c1 5.0",
        "rtaxel_r1c2 r1 c2 6.0",
        "rlat_r0c0 c0 c1 7.0",
        "rlat_r0c1 c1 c2 8.0",
        "rlat_r1c0 c0 c1 9.0",
        ".ends array",
    ]


@settings(deadline=None)
@given(st.lists(st.floats(min_value=0, allow_infinity=True, allow_nan=False), min_size=6, max_size=6))
def test_every_resistance_reads_back_exactly_and_no_other_text_gets_in(values: list[float]) -> None:
    text = spice_text.array_subckt(2, 3, np.reshape(values, (2, 3)))
    floor = dd.load().array.r_floor_ohm
    want = {f"rtaxel_r{i // 3}c{i % 3}": max(v, floor) for i, v in enumerate(values) if np.isfinite(v)}
    lines = text.splitlines()[2:-1]
    assert {line.split()[0]: float(line.split()[3]) for line in lines} == want
    assert all(re.fullmatch(r"rtaxel_r\dc\d r\d c\d [0-9.e+-]+", line) for line in lines)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"resistance_ohm": np.full((2, 2), np.nan)}, "resistance_ohm[0, 0] = nan"),
        ({"resistance_ohm": [[1.0, 2.0], [3.0, -4.0]]}, "resistance_ohm[1, 1] = -4.0"),
        ({"resistance_ohm": [[1.0, 2.0]]}, "shape (1, 2): shape (2, 2)"),
        ({"resistance_ohm": [[1.0, "1\n.control\nshell id"], [3.0, 4.0]]}, "(not numeric)"),
        ({"lateral_ohm": "{x}\nshell id"}, "lateral_ohm = "),
        ({"lateral_ohm": -1.0}, "lateral_ohm[0, 0] = -1.0"),
        ({"name": "a\n.control"}, "name = "),
        ({"rows": 0}, "at least 1 each"),
    ],
)
def test_an_array_that_cannot_stand_in_a_deck_is_refused(arguments: dict, said: str) -> None:
    with pytest.raises(InputError) as caught:
        spice_text.array_subckt(**{"rows": 2, "cols": 2, **arguments})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_no_number_that_is_none_reaches_a_deck(value: float) -> None:
    with pytest.raises(ValueError, match="deck"):
        spice_text.spice_number(value)


def test_numpy_numbers_are_written_as_plain_numbers() -> None:
    assert spice_text.spice_number(np.float64(0.1)) == "0.1"
    assert spice_text.spice_number(16) == "16"
