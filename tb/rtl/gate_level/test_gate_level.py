# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis gl`: a small netlist does on its pins what the Verilog does, and a fault in it is seen."""

import dataclasses
import re
from pathlib import Path

import pytest

from dermis.errors import InputError, SimulatorError
from dermis.report import verdict
from scripts import gate_level
from scripts.synth import cells as synth_cells
from scripts.synth.cells import TECHNOLOGIES
from scripts.synth.map import Netlist, Size, map_design

CELLS = synth_cells.OSU035 / "osu035_stdcells.v"
needs_osu035 = pytest.mark.skipif(not CELLS.is_file(), reason="qflow-tech-osu035 of Debian is not installed")
pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]
OSU035 = TECHNOLOGIES["osu035"]
SIZE = Size(2, 2, sync_latch=True)


@pytest.fixture(scope="module")
def netlist(tmp_path_factory: pytest.TempPathFactory) -> Netlist:
    return map_design(OSU035, SIZE.parameters, tmp_path_factory.mktemp("netlist"))


def status(rows: list[verdict.Row]) -> dict[str, str]:
    return {row["name"].split(".")[1]: row["status"] for row in rows}


def changed(netlist: Netlist, directory: Path, pattern: str, new: str) -> Netlist:
    """The netlist with one change."""
    text, number = re.subn(pattern, new, netlist.verilog.read_text(), count=1)
    assert number == 1, pattern
    wrong = directory / "wrong.v"
    wrong.write_text(text)
    return dataclasses.replace(netlist, verilog=wrong)


# An output register's reset pin tied off, and the same register set by reset.
PIN_FAULTS = {
    "unknown_pins": (r"(\.Q\(frame_ready_o\),\s*\.R\()[^)]*\)", r"\g<1>1'h1)"),
    "unlike_pins": (r"(\.Q\(frame_ready_o\),\s*)\.R\(([^)]*)\),(\s*)\.S\(([^)]*)\)", r"\1.R(\4),\3.S(\2)"),
}


@needs_osu035
def test_the_netlist_does_what_the_verilog_does_and_faults_are_seen(netlist: Netlist, tmp_path: Path) -> None:
    rows = gate_level.pin_rows(netlist, SIZE, "x")
    assert status(rows) == {"unlike_codes": "PASS", "unlike_pins": "PASS", "unknown_pins": "PASS"}
    octets, _, _, frames = rows[0]["note"].split()[:4]
    # A frame of two rows, one with a dark slot and a self-test frame are at least this long.
    assert (int(octets) >= 4 * (10 + 2 * 4), frames) == (True, "4")
    for row, (pattern, new) in PIN_FAULTS.items():
        wrong = changed(netlist, tmp_path, pattern, new)
        assert status(gate_level.pin_rows(wrong, SIZE, "x"))[row] == "FAIL"


@needs_osu035
def test_a_test_of_the_top_passes_and_with_a_fault_it_is_counted(netlist: Netlist, tmp_path: Path) -> None:
    # A gate of 510 clocks, so that a frame is read before the next but one.
    x = [[(1, 510), (1, 3)], [(0, 1), (1, 2)]]
    tests = [gate_level.TopTest("client", {"x": x, "gate": 510, "sck_hz": 5e6, "frames": 1})]
    rows = gate_level.top_rows(netlist, SIZE.parameters, "x", tests)
    assert status(rows) == {"failed_tests": "PASS", "unlike_results": "PASS"}
    # CIPO stuck: no answer ever comes.
    wrong = changed(netlist, tmp_path, r"\.D\([^)]*\)(,\s*\.Q\(spi_cipo_o\))", r".D(1'h0)\1")
    rows = gate_level.top_rows(wrong, SIZE.parameters, "x", tests)
    assert status(rows)["failed_tests"] == "FAIL"


@needs_osu035
def test_a_simulation_that_does_not_end_is_an_error(netlist: Netlist) -> None:
    design = gate_level.netlist_design(netlist)
    with pytest.raises(SimulatorError, match="took more than"):
        gate_level.run(design, gate_level.PIN_BENCH, "reads_frames", gate_level.SCENARIO, limit_s=0.1)


def test_models_of_sky130_cells_are_collected_once_each(tmp_path: Path) -> None:
    kinds = ["sky130_fd_sc_hd__dfrtp_1", "sky130_fd_sc_hd__dfrtn_1", "sky130_fd_sc_hd__nand2_1"]
    text = gate_level.cell_models(TECHNOLOGIES["sky130"], kinds, tmp_path / "cells.v").read_text()
    for kind in kinds:
        assert len(re.findall(rf"^module {kind}\b", text, re.MULTILINE)) == 1
    assert len(re.findall(r"^primitive \S*udp_dff\$PR ", text, re.MULTILINE)) == 1
    with pytest.raises(InputError, match="nosuch"):
        gate_level.cell_models(TECHNOLOGIES["sky130"], ["sky130_fd_sc_hd__nosuch_1"], tmp_path / "cells.v")
