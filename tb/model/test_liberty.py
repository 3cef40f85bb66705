# SPDX-License-Identifier: Apache-2.0
"""The Liberty files: well formed, true to the cells' Verilog, to ngspice and to the foundry's own numbers."""

import re
import subprocess

import numpy as np
import pytest

from dermis.errors import InputError
from scripts import liberty

CORNERS = tuple(liberty.CORNERS)
LIMIT_S = 60


def path_of(corner):
    return liberty.CORNERS[corner].file


@pytest.fixture(scope="module")
def libraries():
    return {corner: liberty.read(path_of(corner)) for corner in CORNERS}


def arcs(library, kind=""):
    """Every arc whose type begins with `kind`, by cell, pin, related pin and number."""
    return {
        (cell.name, pin.name, timing.attributes["related_pin"].strip('"'), number): timing
        for cell in library.of("cell")
        for pin in cell.of("pin")
        for number, timing in enumerate(pin.of("timing"))
        if timing.attributes["timing_type"].startswith(kind)
    }


def delays(library):
    """Every delay and transition table as an array, by its place."""
    return {
        (*place, table.kind): np.array(table.table())
        for place, timing in arcs(library).items()
        for table in timing.groups
        if table.name == "delay"
    }


def test_a_heavier_load_is_slower_and_a_slower_corner_too(libraries):
    tables = {corner: delays(library) for corner, library in libraries.items()}
    assert tables["ss"].keys() == tables["tt"].keys() == tables["ff"].keys()
    assert len(tables["tt"]) > 300
    for place, typical in tables["tt"].items():
        slow, fast = tables["ss"][place], tables["ff"][place]
        for table in (slow, typical, fast):
            assert np.all(np.diff(table, axis=1) > 0), place
            if place[-1].endswith("transition"):
                # Not strictly: in a stack a slow input lets inner nodes move first (xor2_1 loses a tenth).
                assert table.min() > 0, place
                assert np.all(np.diff(table, axis=0) > -0.15 * table[:-1]), place
        # Slow inputs aside: there a delay is a difference of two thresholds.
        assert np.all(slow[:2] > typical[:2]), place
        assert np.all(typical[:2] > fast[:2]), place


def test_conditions_are_those_of_the_corner_and_setup_comes_before_hold(libraries):
    for corner, library in libraries.items():
        at = liberty.CORNERS[corner]
        assert float(library.attributes["nom_voltage"]) == at.voltage_v
        assert float(library.attributes["nom_temperature"]) == at.temperature_c
        holds = arcs(library, "hold")
        assert len(holds) == 5
        for place, setup in arcs(library, "setup").items():
            hold = next(timing for other, timing in holds.items() if other[:2] == place[:2])
            for edge in ("rise_constraint", "fall_constraint"):
                # An edge of D before the setup time is seen, one after the hold time is not.
                assert np.all(np.array(setup.one(edge).table()) + hold.one(edge).table() > 0), place


@pytest.mark.parametrize("name", ["inv_1", "dfxtp_1"])
def test_ngspice_measures_the_file_and_a_table_scaled_by_two_is_caught(libraries, name, tmp_path):
    at = liberty.CORNERS["tt"]
    assert liberty.sample_error(libraries["tt"], at, name, tmp_path) < 0.04
    library = liberty.read(path_of("tt"))
    sample = liberty.SAMPLES[name]
    table = arcs(library)[liberty.PREFIX + name, sample.output, sample.pin, 0].one("cell_rise")
    table.attributes["values"] = f"({' '.join(str(2 * value) for value in table.numbers('values'))})"
    assert liberty.sample_error(library, at, name, tmp_path) > 0.3


# ns and pF, tt: from the foundry's own Liberty (google/skywater-pdk-libs-sky130_fd_sc_hd, Apache-2.0).
FOUNDRY = [
    ("inv_1", "Y", "A", "cell_rise", 0.0531329, 0.00356533, 0.0566328),
    ("inv_1", "Y", "A", "cell_fall", 0.0531329, 0.00356533, 0.0410519),
    ("inv_1", "Y", "A", "rise_transition", 0.122474, 0.0254232, 0.216158),
    ("nand2_1", "Y", "A", "cell_rise", 0.0531329, 0.00912787, 0.0970882),
    ("nand2_1", "Y", "A", "cell_fall", 0.122474, 0.0240345, 0.1794323),
    ("dfrtp_1", "Q", "CLK", "cell_fall", 0.0531329, 0.00935082, 0.392217),
]


def test_the_foundry_measured_much_the_same(libraries):
    for name, pin, related, kind, slew, load, foundry in FOUNDRY:
        group = arcs(libraries["tt"])[liberty.PREFIX + name, pin, related, 0].one(kind)
        by_load = [np.interp(load, group.numbers("index_2"), row) for row in group.table()]
        # The foundry's extracted netlist has wires that ours has not: 1 to 13 % at these points.
        assert np.interp(slew, group.numbers("index_1"), by_load) == pytest.approx(foundry, rel=0.15), name


def test_functions_are_those_of_the_cells_verilog(libraries, tmp_path):
    """Operators of Liberty are operators of Verilog, so one bench compares all cells."""
    lines, views = [], []
    for cell in libraries["tt"].of("cell"):
        inputs = [pin.name for pin in cell.of("pin") if "input" in pin.attributes["direction"]]
        if cell.of("ff") or cell.of("latch") or not inputs:
            continue
        views.append(liberty.view(cell.name.removeprefix(liberty.PREFIX), "functional.v"))
        ports = "".join(f".{pin}(v[{k}]), " for k, pin in enumerate(inputs))
        for pin in cell.of("pin"):
            if function := pin.attributes.get("function", "").strip('"'):
                said = re.sub(r"[A-Z]\w*", lambda m, pins=inputs: f"v[{pins.index(m[0])}]", function)
                net = f"{cell.name}_{pin.name}"
                lines += [f"  wire {net};", f"  {cell.name} u_{net} ({ports}.{pin.name}({net}));"]
                lines.append(f'  always @(go) if ({net} !== {said}) $display("{net} %b", v);')
    assert len(views) > 40
    bench = ["`timescale 1ns/1ps", "module bench;", "  reg [5:0] v; reg go; integer k;", *lines]
    bench += ["  initial for (k = 0; k < 64; k = k + 1) begin v = k; #1 go = k[0]; #1; end", "endmodule"]
    (tmp_path / "bench.v").write_text("\n".join(bench))
    include = [f"-I{path.parent}" for path in views]
    command = ["iverilog", "-g2005", "-s", "bench", *include, "-o", "bench.vvp", "bench.v", *views]
    subprocess.run(command, check=True, timeout=LIMIT_S, cwd=tmp_path)
    run = ["vvp", "-n", "bench.vvp"]
    done = subprocess.run(run, check=True, timeout=LIMIT_S, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == ""


def test_a_pdk_comes_first_and_a_wrong_one_is_refused(monkeypatch, tmp_path):
    monkeypatch.delenv("PDK_ROOT", raising=False)
    assert liberty.liberty_file("tt") == path_of("tt")
    monkeypatch.setenv("PDK_ROOT", str(tmp_path))
    with pytest.raises(InputError, match="PDK_ROOT"):
        liberty.liberty_file("tt")
    there = tmp_path / "sky130A" / "libs.ref" / "sky130_fd_sc_hd" / "lib" / path_of("tt").name
    there.parent.mkdir(parents=True)
    there.write_text("library (x) {}\n")
    assert liberty.liberty_file("tt") == there


def test_a_group_knows_its_text_and_a_broken_library_is_refused(libraries):
    text = path_of("tt").read_text()
    for cell in libraries["tt"].of("cell"):
        assert liberty.parse(text[cell.start : cell.end]).groups
        assert text[cell.start : cell.end].count("cell (") == 1
    for broken in ("library (x) { cell (y) { area : 1; ", "", "library x", "library (x) { area : }", "}"):
        with pytest.raises(InputError):
            liberty.parse(broken)
