# SPDX-License-Identifier: Apache-2.0
"""The Liberty files: well formed, true to the cells' Verilog, to ngspice and to the foundry's own numbers."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from click.testing import CliRunner

from dermis.errors import InputError, SimulatorError
from scripts.liberty import cells, measure, syntax, verify
from scripts.liberty import command as liberty
from scripts.liberty.cells import PREFIX

CORNERS = tuple(measure.CORNERS)
LIMIT_S = 60


def path_of(corner):
    return liberty.DIRECTORY / liberty.file_name(measure.CORNERS[corner])


@pytest.fixture(scope="module")
def libraries():
    return {corner: syntax.parse(path_of(corner).read_text()) for corner in CORNERS}


def delays(library):
    """Every delay and transition table: its place, its kind and the group."""
    for cell in library.of("cell"):
        for pin in cell.of("pin"):
            for number, timing in enumerate(pin.of("timing")):
                for table in timing.groups:
                    if not table.kind.endswith("constraint"):
                        place = (cell.name, pin.name, timing.attributes["related_pin"], number, table.kind)
                        yield place, table


def test_the_files_hold_every_cell_with_the_area_of_its_lef(libraries):
    for library in libraries.values():
        assert {cell.name for cell in library.of("cell")} == {PREFIX + name for name in cells.NAMES}
        for name in cells.NAMES:
            width, height = cells.lef_size(name)
            assert float(library.one("cell", PREFIX + name).attributes["area"]) == pytest.approx(
                width * height
            )


def test_units_thresholds_and_conditions_are_stated(libraries):
    for corner, library in libraries.items():
        said, at = library.attributes, measure.CORNERS[corner]
        assert said["time_unit"] == '"1ns"'
        assert said["capacitive_load_unit"] == "(1,pf)"
        assert said["slew_lower_threshold_pct_rise"] == "20"
        assert said["slew_upper_threshold_pct_fall"] == "80"
        assert float(said["nom_voltage"]) == at.voltage_v
        assert float(said["nom_temperature"]) == at.temperature_c


def test_a_heavier_load_is_slower_and_a_table_is_whole(libraries):
    count = 0
    for library in libraries.values():
        for place, group in delays(library):
            table = np.array(group.table())
            assert table.shape == (len(group.numbers("index_1")), len(group.numbers("index_2"))), place
            assert np.all(np.diff(table, axis=1) > 0), place
            count += 1
    assert count > 1000


def test_transitions_are_positive_and_grow_with_the_input(libraries):
    for library in libraries.values():
        for place, group in delays(library):
            if group.kind.endswith("transition"):
                table = np.array(group.table())
                assert table.min() > 0, place
                # Not strictly: in a stack a slow input lets inner nodes move first (xor2_1 loses a tenth).
                assert np.all(np.diff(table, axis=0) > -0.15 * table[:-1]), place


def test_slow_is_slower_than_typical_and_typical_than_fast(libraries):
    tables = {corner: dict(delays(library)) for corner, library in libraries.items()}
    assert tables["ss"].keys() == tables["tt"].keys() == tables["ff"].keys()
    for place, group in tables["tt"].items():
        # Slow inputs aside: there a delay is a difference of two thresholds.
        slow, typical, fast = (np.array(tables[c][place].table())[:2] for c in CORNERS)
        assert np.all(slow > typical), place
        assert np.all(typical > fast), place
        assert group.name == "delay"


def test_a_later_library_is_known_by_its_key(libraries):
    for corner in CORNERS:
        assert liberty.written_key(path_of(corner).read_text()) == liberty.library_key(
            measure.CORNERS[corner]
        )


def test_the_key_follows_the_transistor_models_and_the_settings(monkeypatch):
    at = measure.CORNERS["tt"]
    before = liberty.library_key(at)
    monkeypatch.setattr(measure, "PUSH_OUT", 1.2)
    assert liberty.library_key(at) != before
    monkeypatch.undo()
    monkeypatch.setattr(measure, "models_digest", lambda process: "other")
    assert liberty.library_key(at) != before


def test_ngspice_says_today_what_the_file_says(libraries, tmp_path):
    at = measure.CORNERS["tt"]
    assert verify.sample_error(libraries["tt"], at, "nand2_1", tmp_path) < 0.04


def test_a_table_scaled_by_two_is_caught(libraries, tmp_path):
    at = measure.CORNERS["tt"]
    text = path_of("tt").read_text()
    library = syntax.parse(text)
    table = verify.timing(library, "nand2_1", "Y", "A").one("cell_rise")
    doubled = " ".join(str(2 * value) for value in table.numbers("values"))
    table.attributes["values"] = f"({doubled})"
    assert verify.sample_error(library, at, "nand2_1", tmp_path) > 0.3


@pytest.mark.skipif(shutil.which("sta") is None, reason="OpenSTA (Debian package opensta) is not installed")
def test_opensta_finds_the_delay_of_a_chain_that_ngspice_finds(tmp_path):
    at = measure.CORNERS["tt"]
    for spice, sta in verify.chain_delays(path_of("tt"), at, "inverters", tmp_path).values():
        # The limit of liberty.path_error in models/spec.toml: STA multiplies worst slews, ngspice has the
        # real ones.
        assert sta == pytest.approx(spice, rel=0.1)
    text = path_of("tt").read_text()
    head, cell, rest = re.split(r'(?s)(cell \("sky130_fd_sc_hd__inv_1"\).*?\n  })', text, maxsplit=1)
    twice = re.sub(r"(cell_(?:rise|fall) .*?values )(\(.*?\))", _doubled, cell, flags=re.DOTALL)
    wrong = tmp_path / "wrong.lib"
    wrong.write_text(head + twice + rest)
    for spice, sta in verify.chain_delays(wrong, at, "inverters", tmp_path).values():
        assert sta > 1.5 * spice


def _doubled(found):
    return found[1] + re.sub(r"[-\d.e]+", lambda number: f"{2 * float(number[0]):g}", found[2])


def test_flops_have_every_constraint_and_setup_comes_before_hold(libraries):
    for library in libraries.values():
        for base, how in cells.SEQUENTIAL.items():
            pins = library.one("cell", f"{PREFIX}{base}_1")
            kinds = {t.attributes["timing_type"].split("_")[0]: t for t in pins.one("pin", "D").of("timing")}
            assert set(kinds) == {"setup", "hold"}
            for edge in ("rise", "fall"):
                # An edge of D before the setup time is seen, one after the hold time is not: setup comes first.
                setup = np.array(kinds["setup"].one(f"{edge}_constraint").table())
                hold = np.array(kinds["hold"].one(f"{edge}_constraint").table())
                assert np.all(setup + hold > 0), base
            if how.asynchronous:
                found = {
                    t.attributes["timing_type"].split("_")[0]
                    for t in pins.one("pin", how.asynchronous).of("timing")
                }
                assert found == {"recovery", "removal"}


# ns and pF, tt: from the foundry's own Liberty (google/skywater-pdk-libs-sky130_fd_sc_hd, Apache-2.0).
FOUNDRY = [
    ("inv_1", "Y", "A", "cell_rise", 0.0531329, 0.00356533, 0.0566328),
    ("inv_1", "Y", "A", "cell_fall", 0.0531329, 0.00356533, 0.0410519),
    ("inv_1", "Y", "A", "rise_transition", 0.122474, 0.0254232, 0.216158),
    ("nand2_1", "Y", "A", "cell_rise", 0.0531329, 0.00912787, 0.0970882),
    ("nand2_1", "Y", "A", "cell_fall", 0.122474, 0.0240345, 0.1794323),
    ("dfrtp_1", "Q", "CLK", "cell_fall", 0.0531329, 0.00935082, 0.392217),
]


@pytest.mark.parametrize(("name", "pin", "related", "kind", "slew", "load", "foundry"), FOUNDRY)
def test_the_foundry_measured_much_the_same(libraries, name, pin, related, kind, slew, load, foundry):
    group = verify.timing(libraries["tt"], name, pin, related).one(kind)
    by_load = [np.interp(load, group.numbers("index_2"), row) for row in group.table()]
    # The foundry's extracted netlist has wires that ours has not: 1 to 13 % at these points.
    assert np.interp(slew, group.numbers("index_1"), by_load) == pytest.approx(foundry, rel=0.15)


def test_functions_are_those_of_the_cells_verilog(tmp_path):
    lines, sources = [], {}
    for name in cells.NAMES:
        cell = cells.cell(name)
        if cell.sequential is None and cell.inputs:
            sources[cells.view(name, "functional.v")] = None
            ports = ", ".join([f".{p}(v[{k}])" for k, p in enumerate(cell.inputs)])
            for output in cell.functions:
                lines.append(f"  wire {name}_{output};")
                lines.append(f"  {cell.full_name} u_{name}_{output} ({ports}, .{output}({name}_{output}));")
    shown = " ".join(line.split()[1].rstrip(";") for line in lines if line.startswith("  wire"))
    names = shown.split()
    bench = ["`timescale 1ns/1ps", "module bench;", "  reg [5:0] v; integer k;", *lines, "  initial"]
    bench += ["    for (k = 0; k < 64; k = k + 1) begin v = k; #1;"]
    bench += [f'      $display("%b", {{{", ".join(names)}}});', "    end", "endmodule"]
    (tmp_path / "bench.v").write_text("\n".join(bench))
    # Each view includes its primitives by a path beside it.
    views = [str(path) for path in sources]
    include = [f"-I{path.parent}" for path in sources]
    built = tmp_path / "bench.vvp"
    command = [
        "iverilog",
        "-g2005",
        "-s",
        "bench",
        *include,
        "-o",
        str(built),
        str(tmp_path / "bench.v"),
        *views,
    ]
    subprocess.run(command, check=True, timeout=LIMIT_S, cwd=tmp_path)
    said = subprocess.run(
        ["vvp", "-n", str(built)], check=True, timeout=LIMIT_S, capture_output=True, text=True
    )
    rows = said.stdout.split()
    assert len(rows) == 64
    for k, row in enumerate(rows):
        for name_output, bit in zip(names, row, strict=True):
            name, output = re.fullmatch(r"(.*)_([A-Z]\w*)", name_output).groups()
            cell = cells.cell(name)
            values = {pin: bool(k >> i & 1) for i, pin in enumerate(cell.inputs)}
            assert cells.evaluate(cell.functions[output], values) == (bit == "1"), (name, values)


def test_drains_on_an_output_are_near_what_the_lef_says():
    for name in ("inv_1", "inv_4", "buf_2", "nand2_1", "nor2_1", "dfrtp_1"):
        (output,) = cells.cell(name).functions
        text = cells.view(name, "lef").read_text()
        area = float(re.search(rf"PIN {output}\n\s*ANTENNADIFFAREA\s+([\d.]+)", text)[1])
        # LEF areas are of drawn rectangles, the model's of width times a rule.
        assert measure.output_diffusion(name, output) == pytest.approx(area, rel=0.05)


def test_a_measurement_that_fails_is_an_error_and_not_a_number(tmp_path):
    bench = measure.Bench(cells.cell("inv_1"), measure.CORNERS["tt"], tmp_path)
    body = ["va a 0 0", bench.instance(0, {"A": "a", "Y": "y"}), ".meas tran never when v(y)=0.9 rise=1"]
    deck = bench.deck(body, ["v(y)"], 1.0, 0.1)
    assert bench.run(deck, ["never"]) == {"never": None}
    with pytest.raises(SimulatorError, match="failed"):
        bench._sure(bench.run(deck, ["never"]))


def test_a_pdk_comes_first_and_a_wrong_one_is_refused(monkeypatch, tmp_path):
    monkeypatch.delenv("PDK_ROOT", raising=False)
    assert liberty.liberty_file("tt") == path_of("tt")
    monkeypatch.setenv("PDK_ROOT", str(tmp_path))
    with pytest.raises(InputError, match="PDK_ROOT"):
        liberty.liberty_file("tt")
    there = (
        tmp_path / "sky130A" / "libs.ref" / "sky130_fd_sc_hd" / "lib" / "sky130_fd_sc_hd__tt_025C_1v80.lib"
    )
    there.parent.mkdir(parents=True)
    there.write_text("library (x) {}\n")
    assert liberty.liberty_file("tt") == there
    with pytest.raises(InputError, match="corner"):
        liberty.liberty_file("sf")


def test_broken_liberty_is_refused():
    with pytest.raises(InputError):
        syntax.parse("library (x) { cell (y) { area : 1; ")


def test_what_is_rendered_is_read_back():
    group = syntax.Group("library", '"x"', {"time_unit": '"1ns"', "technology": "(cmos)"})
    group.groups.append(syntax.Group("cell", '"y"', {"area": "1.5"}))
    again = syntax.parse(syntax.render(group, ["a comment"]))
    assert again.name == "x"
    assert again.attributes["technology"] == "(cmos)"
    assert again.one("cell", "y").attributes == {"area": "1.5"}


def test_a_stale_file_is_a_failed_check(monkeypatch):
    monkeypatch.setattr(liberty, "METHOD", -1)
    monkeypatch.setattr(verify, "SAMPLES", ())
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(liberty.verdict, "write_rows", lambda target, rows: None)
    done = CliRunner().invoke(liberty.liberty_command, ["--check", "--corner", "tt"])
    assert done.exit_code == 1
    assert "FAIL" in done.output


NETLIST = """
module design (clk, rst_n, a, b, q);
  input clk, rst_n; input [3:0] a, b; output reg [3:0] q;
  always @(posedge clk or negedge rst_n) if (!rst_n) q <= 4'd0; else q <= q + (a ^ b);
endmodule
"""


@pytest.mark.parametrize("corner", CORNERS)
def test_yosys_and_opensta_take_the_file_without_a_word(corner, tmp_path):
    (tmp_path / "design.v").write_text(NETLIST)
    file = path_of(corner)
    script = (
        f"read_verilog design.v; synth -flatten; dfflibmap -liberty {file}; abc -liberty {file}; opt_clean; "
    )
    script += f"stat -liberty {file}; write_verilog -noattr mapped.v; read_liberty -lib {file}"
    done = subprocess.run(
        ["yosys", "-p", script], cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S, check=True
    )
    said = done.stdout + done.stderr
    assert not re.search(r"^Warning|^ERROR", said, re.MULTILINE)
    assert re.search(r"sky130_fd_sc_hd__dfrtp_1\s+4", said)
    if shutil.which("sta") is None:
        pytest.skip("OpenSTA (Debian package opensta) is not installed")
    commands = [
        f"read_liberty {file}",
        "read_verilog mapped.v",
        "link_design design",
        "create_clock -period 10 clk",
    ]
    commands += ["report_checks", "exit"]
    (tmp_path / "path.tcl").write_text("\n".join(commands) + "\n")
    done = subprocess.run(
        ["sta", "-no_splash", "-exit", "path.tcl"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    assert not re.search(r"Warning|Error", done.stdout + done.stderr)
    assert "data arrival time" in done.stdout
