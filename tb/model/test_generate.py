# SPDX-License-Identifier: Apache-2.0
"""Files generated from design.toml: up to date in the tree, right in content, and every drift caught."""

import functools
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from made_plans import refused

import dermis
from dermis.chip import spice_text
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design as dd
from scripts import first_picture, generate

READ = ("models/design.toml", "models/spec.toml", "rtl/dermis_registers.rdl")


@pytest.fixture(scope="module")
def generated() -> dict[str, str]:
    """Return the generated content of the tree by path."""
    return generate.generate_all()


@pytest.fixture
def tree(tmp_path: Path, generated: dict[str, str]) -> Path:
    """Copy what generation reads and writes into a tree of its own."""
    for name in (*generated, *READ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(dd.ROOT / name, tmp_path / name)
    return tmp_path


def test_the_tree_is_up_to_date(generated: dict[str, str]) -> None:
    assert len(generated) == 14
    assert {path: (dd.ROOT / path).read_text(encoding="utf-8") for path in generated} == generated


@pytest.mark.paper
@pytest.mark.parametrize(
    ("key", "value"), [("cols = 16", "cols = 200"), ("gate_clocks = 510", "gate_clocks = 30")]
)
def test_a_design_that_the_verilog_is_not_made_for_is_refused(tree: Path, key: str, value: str) -> None:
    path = tree / "models/design.toml"
    text = path.read_text()
    assert text.count(key) == 1
    path.write_text(text.replace(key, value).replace("code_bits = 8", "code_bits = 4"))
    with pytest.raises(InputError, match=rf"design\.toml: \w+\.{value}: the chip does"):
        generate.generate_all(tree)


def test_the_first_picture_shows_the_codes_of_the_verilog() -> None:
    codes = [dermis.simulate(first_picture.SCENE, engine=engine).codes for engine in ("closed", "rtl")]
    assert codes[0].any()
    assert (codes[0] == codes[1]).all()


@pytest.mark.long
@pytest.mark.paper
@pytest.mark.parametrize(
    ("path", "old", "new"),
    [
        ("rtl/dermis_design.vh", "DERMIS_GATE_CLOCKS   510", "DERMIS_GATE_CLOCKS   512"),
        ("rtl/synth/dermis.sdc", "set clk_period 200.0", "set clk_period 250.0"),
        ("spice/design.inc", "converter_i0_a = 2.5e-05", "converter_i0_a = 2.6e-05"),
        ("spice/array/array.sp", "rtaxel_r3c4 r3 c4", "rtaxel_r3c4 r4 c3"),
        ("docs/numbers.md", "| `timing.settle_clocks` | 115 |", "| `timing.settle_clocks` | 113 |"),
        ("docs/effects.md", "`Network.r_column_ohm`", "`Network.r_row_ohm`"),
        ("docs/scenes.md", "In series with every grounded row", "In series with every other row"),
        ("docs/figures/fingertip.svg", "at most 0.03 N", "at most 0.00 N"),
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
    assert [name for name, said in found.items() if said] == [path]
    difference = found[path].splitlines()
    assert any(line.startswith("-") and new in line for line in difference)
    assert any(line.startswith("+") and old in line for line in difference)
    rows = generate.check(tree)
    name = "generate.drift_files." + path.replace("/", "_").replace(".", "_")
    assert [row["name"] for row in rows if row["status"] == "FAIL"] == [name]
    assert verdict.exit_code(rows) == 1
    assert generate.write(tree) == [path]
    assert (tree / path).read_text() == text
    assert not any(generate.drift(tree).values())


@pytest.mark.paper
def test_a_changed_value_makes_every_file_that_holds_it_drift(tree: Path) -> None:
    """All but docs/scenes.md, which has keys and no values, and the registers in Verilog, which have parameters."""
    toml = tree / "models" / "design.toml"
    text = toml.read_text()
    for name, old, new in (("rows", "16", "8"), ("frame_s", "2e-3", "1e-3"), ("f_clk_hz", "5e6", "1e7")):
        text = text.replace(f"{name} = {old}", f"{name} = {new}", 1)
    toml.write_text(text)
    others = {"docs/scenes.md", "rtl/dermis_registers.v"}
    drift = generate.drift(tree)
    assert {name for name, said in drift.items() if said} == drift.keys() - others


def test_a_doc_that_lost_the_mark_of_a_table_is_refused(tree: Path) -> None:
    path = tree / "docs/numbers.md"
    path.write_text(path.read_text().replace("<!-- end: design -->", ""))
    with pytest.raises(InputError, match="table design"):
        generate.generate_all(tree)


@pytest.mark.paper
def test_check_fails_on_drift_and_writes_nothing(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("write", "check"):
        function = getattr(generate, name)
        monkeypatch.setattr(generate, name, lambda function=function: function(tree))
    monkeypatch.setattr(verdict, "BUILD", tree / "build")
    path, missing = tree / "rtl/dermis_design.vh", tree / "spice/design.inc"
    good = path.read_text()
    path.write_text(good.replace("510", "512"))
    missing.unlink()
    numbers = tree / "docs/numbers.md"
    numbers.write_text("# A word first\n" + numbers.read_text())  # outside the tables: left alone

    def called(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(generate.generate_command, arguments, standalone_mode=False)
        return done.return_value, done.output

    code, said = called("--check")
    assert (code, missing.exists()) == (1, False)
    assert "DERMIS_GATE_CLOCKS" in said
    assert (tree / "build" / "gen-check.json").exists()
    code, said = called()
    assert (code, path.read_text()) == (0, good)
    assert said == "written: rtl/dermis_design.vh\nwritten: spice/design.inc\n"
    assert called("--check")[0] == 0


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
    lines = [f'.include "{dd.ROOT}/spice/design.inc"']
    # as a voltage: a number of any size comes back to 15 digits
    lines += [f"v{i} n{i} 0 {{{name}}}" for i, name in enumerate(want)]
    got = spice_op(tmp_path, "\n".join(lines), *(f"v(n{i})" for i in range(len(want))))
    assert len(want) > 50
    for i, (name, value) in enumerate(want.items()):
        # ngspice prints 15 digits and its parser makes a few roundings of them.
        assert got[f"v(n{i})"] == pytest.approx(value, rel=1e-12, abs=0), name


@pytest.mark.paper
@pytest.mark.parametrize("subckt", ["array", "array_lateral"])
def test_each_taxel_of_the_array_file_is_its_own_parameter(tmp_path: Path, subckt: str) -> None:
    pins = " ".join(["row3" if r == 3 else "0" for r in range(16)] + [f"col{c}" for c in range(16)])
    lines = [f'.include "{dd.ROOT}/spice/array/array.sp"', "vrow row3 0 1"]
    lines += [f"xarray {pins} {subckt} r_r3c4_ohm=500 r_r4c3_ohm=700"]
    lines += [f"vc{c} col{c} 0 0" for c in range(16)]
    got = spice_op(tmp_path, "\n".join(lines), *(f"i(vc{c})" for c in range(16)))
    # ideal columns: lateral resistors and other rows carry nothing
    for c in range(16):
        # gmin, 1e-12 S beside 1.6e-5 S of the smallest taxel, at a node of at most 1 uV.
        assert got[f"i(vc{c})"] == pytest.approx(1 / 500 if c == 4 else 1 / 64250, rel=1e-9), c


@pytest.mark.paper
def test_lateral_resistors_join_neighbouring_columns_of_every_row(tmp_path: Path) -> None:
    lift = " ".join(f"r_r{r}c{c}_ohm=1e15" for r in range(16) for c in range(16))
    pins = " ".join(["0"] * 16 + [f"col{c}" for c in range(16)])
    lines = [f'.include "{dd.ROOT}/spice/array/array.sp"', "vdrive col0 0 1", "vend col15 0 0"]
    lines += [f"xarray {pins} array_lateral {lift} r_lateral_ohm=1600"]
    got = spice_op(tmp_path, "\n".join(lines), "i(vend)", "v(col6)")
    # 16 rows of 1600 ohm in parallel are 100 ohm a step, 15 steps from end to end; gmin at 16 nodes beside them is
    # parts in 1e9, and ngspice's reltol 1e-6 bounds it.
    assert got == pytest.approx({"i(vend)": 1 / 1500, "v(col6)": 1 - 6 / 15}, rel=1e-6)


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
        ({"resistance_ohm": [[1.0, 2.0]]}, "shape (1, 2): shape (2, 2)"),
        ({"resistance_ohm": [[1.0, "1\n.control\nshell id"], [3.0, 4.0]]}, "(not numeric)"),
        ({"lateral_ohm": "{x}\nshell id"}, "lateral_ohm = "),
    ],
)
def test_an_array_that_cannot_stand_in_a_deck_is_refused(arguments: dict, said: str) -> None:
    call = functools.partial(spice_text.array_subckt, **{"rows": 2, "cols": 2, **arguments})
    assert said in str(refused(call))
