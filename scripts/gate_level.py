# SPDX-License-Identifier: Apache-2.0
"""Gate-level simulation: the tests of the top on the mapped netlist, with its cells in Icarus."""

import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

import dermis
from dermis.errors import InputError, SimulatorError, one_line
from dermis.files import text_of
from dermis.processes import children
from dermis.report import progress, verdict
from dermis.scene.design import ROOT
from scripts import liberty, markdown
from scripts.cocotb_run import run_bench
from scripts.judged import attempt, finish
from scripts.liberty import PREFIX, view
from scripts.lint import Parameters, header_values
from scripts.synth import power
from scripts.synth.cells import TECHNOLOGIES, Technology, osu035
from scripts.synth.command import place, size_options, write_docs
from scripts.synth.map import TOP, Netlist, Size, map_once

BENCHES = ROOT / "tb" / "rtl"
PIN_BENCH = "bench_gate_level"
TOP_BENCH = "bench_top"
# Five times the longest on an idle machine.
RUN_LIMIT_S = 600.0
WHOLE_LIMIT_S = 1800.0
# A gate of 16 clocks instead of 510: the counters still count, and Icarus takes seconds.
SCENARIO = {"seed": 1, "settle": 6, "gate": 16, "frames": 4, "limit": 4000}


def included(path: Path, seen: set[Path]) -> str:
    """Return a Verilog file with the files that it includes in place, each once."""
    if path in seen:
        return ""
    seen.add(path)
    text = text_of(path, "a model of a cell")
    include = re.compile(r'^\s*`include "([^"]+)"', re.MULTILINE)
    return include.sub(lambda found: included((path.parent / found[1]).resolve(), seen), text)


def cell_models(technology: Technology, kinds: Iterable[str], target: Path) -> Path:
    """Write one Verilog file with the functional models of some cells; InputError if one is missing.

    Flip-flop outputs have a delay, of 1 ns in sky130 and of 0.52 ns in osu035, as its `specify` says:
    without one, their new level would race with the gates of the latches that shut at the same edge.
    """
    if technology.name == "osu035":
        text = osu035("osu035_stdcells.v").read_text()
        text, flops = re.subn(r"(\budp_dff \(\w+, D.*?\bbuf) \(Q,", r"\1 #0.52 (Q,", text, flags=re.DOTALL)
        if not flops:
            allowed = "flops with a buf behind them"
            raise InputError(osu035("osu035_stdcells.v"), "udp_dff", "not there", allowed)
        # Its resolution of 10 ps is too coarse for some tests.
        target.write_text(re.sub(r"`timescale\s+1ns\s*/\s*\w+", "`timescale 1ns/1ps", text))
        return target
    seen: set[Path] = set()
    views = (view(kind.removeprefix(PREFIX), "functional.v") for kind in sorted(kinds))
    target.write_text("\n".join(["`define UNIT_DELAY #1", *(included(path, seen) for path in views)]))
    return target


@dataclass(frozen=True)
class Design:
    """Design under test: files (None: rtl/files.f) and parameters of dermis_top."""

    name: str
    sources: tuple[Path, ...] | None
    parameters: Parameters


def netlist_design(netlist: Netlist) -> Design:
    """Return the design of a netlist with its cells; its parameters are fixed."""
    cells = cell_models(netlist.technology, netlist.kinds, netlist.directory / "cells.v")
    return Design(f"the netlist in {netlist.technology.name}", (cells, netlist.verilog), {})


def run(
    design: Design,
    module: str,
    testcase: str,
    scenario: Mapping[str, Any],
    limit_s: float = RUN_LIMIT_S,
    start: Callable[..., object] | None = None,
) -> Any:
    """Run one cocotb test on Icarus and return its report; SimulatorError if there is none."""
    # The simulator gets the path of this process.
    folders = (str(d) for d in (BENCHES, *sorted(BENCHES.iterdir())) if d.is_dir())
    sys.path += [folder for folder in folders if folder not in sys.path]
    given = {"parameters": design.parameters, "sources": design.sources, "limit_s": limit_s, "run": start}
    try:
        return run_bench("icarus", TOP, module, testcase, scenario, where="gl", **given)
    except SimulatorError as error:
        raise SimulatorError(f"{error.what}, {design.name}", error.log) from None


def pin_rows(netlist: Netlist, size: Size, suffix: str) -> list[verdict.Row]:
    """Judge the pins of a netlist against those of the Verilog."""
    designs = (Design("the Verilog", None, size.parameters), netlist_design(netlist))
    wanted, got = (run(design, PIN_BENCH, "reads_frames", SCENARIO) for design in designs)

    def unlike(ours: Sequence[Any], theirs: Sequence[Any]) -> int:
        return abs(len(ours) - len(theirs)) + sum(a != b for a, b in zip(ours, theirs, strict=False))

    frames = zip(got["frames"], wanted["frames"], strict=True)
    codes = sum(unlike(bytes.fromhex(ours), bytes.fromhex(theirs)) for ours, theirs in frames)
    codes += unlike(got["registers"], wanted["registers"])
    pins = unlike(got["pins"], wanted["pins"])
    octets = sum(len(frame) // 2 for frame in got["frames"])
    note = f"{octets} bytes of {len(got['frames']) - 1} frames, and registers"
    return [
        verdict.judge(f"gl.unlike_codes.{suffix}", codes, note),
        verdict.judge(f"gl.unlike_pins.{suffix}", pins, f"all outputs in {got['clocks']} clocks"),
        verdict.judge(f"gl.unknown_pins.{suffix}", got["unknown"], got["first_unknown"]),
    ]


@dataclass(frozen=True)
class TopTest:
    """A test of tb/rtl/top/bench_top.py, which uses pins only and reports results.

    `alike`: the netlist must report the same. False where the report counts wait bytes: the edge
    that samples a crossing level depends on flop delays.
    """

    testcase: str
    scenario: Mapping[str, Any]
    alike: bool = True
    limit_s: float = RUN_LIMIT_S


# A small array with short slots: every test of the top takes seconds.
SMALL = Size(4, 5)
SMALL_SLOTS = {"GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}


def charge_balance(size: Size, limit_s: float = RUN_LIMIT_S) -> TopTest:
    """Return the test with duties c/510: each must read c with a gate of 510 clocks."""
    last = 2**size.code_bits - 1
    x = [[((37 * (r * size.cols + c)) % (last + 1), 510) for c in range(size.cols)] for r in range(size.rows)]
    return TopTest("client", {"x": x, "gate": 510, "sck_hz": 2.5e6, "frames": 1}, limit_s=limit_s)


EACH_LINE = [
    {},
    *({"rows_low": [row]} for row in range(SMALL.rows)),
    *({fault: [n]} for n in range(SMALL.cols) for fault in ("comparators_high", "comparators_low")),
]
RATIOS = [0.02, 0.1, 0.5, 0.8, 1.0, 1.05, 2.0, 5.0, 10.0]
WEIGHTS = [5, 2, 4, 2, 2, 5, 2, 1, 2]
PRESSED = [[(code, 510) for code in (200, 100, 255, 0, 30)]] * SMALL.rows
# The tests of the top, as in tb/rtl/top/test_top.py.
SMALL_TESTS = (
    charge_balance(SMALL),
    TopTest("configuration", {}),
    TopTest("self_test", {"x": PRESSED, "faults": EACH_LINE, "rates": [0x2AAB]}),
    TopTest("off", {"x": PRESSED}, False),
    TopTest("cuts", {"x": PRESSED, "seed": 5, "cuts": 24}),
    TopTest("ratios", {"ratios": RATIOS, "repeats": 3, "frames": 2}, False),
    TopTest("traffic", {"seed": 1, "transactions": 200, "slowest": 0.7, "weights": WEIGHTS}),
)


def compare(design: Design, parameters: Parameters, tests: Sequence[TopTest]) -> tuple[list[str], list[str]]:
    """Run tests of the top on a netlist and on the Verilog; return what failed and what reports differ."""
    failed: list[str] = []
    unlike: list[str] = []
    for test in tests:
        scenario = {"parameters": dict(parameters), **test.scenario}
        both = (Design("the Verilog", None, parameters), design)
        try:
            wanted, got = (run(side, TOP_BENCH, test.testcase, scenario, test.limit_s) for side in both)
        except SimulatorError as error:
            failed.append(str(error))
            continue
        if test.alike and wanted != got:
            unlike.append(f"{test.testcase}: {one_line(str(got), 100)}, not {one_line(str(wanted), 100)}")
    return failed, unlike


def top_rows(
    netlist: Netlist, parameters: Parameters, suffix: str, tests: Sequence[TopTest]
) -> list[verdict.Row]:
    """Judge the tests of the top on the netlist: failures, and reports unlike the Verilog's."""
    failed, unlike = compare(netlist_design(netlist), parameters, tests)
    note = failed[0] if failed else ", ".join(test.testcase for test in tests)
    return [
        verdict.judge(f"gl.failed_tests.{suffix}", len(failed), one_line(note, 300)),
        verdict.judge(f"gl.unlike_results.{suffix}", len(unlike), one_line("; ".join(unlike), 300)),
    ]


def power_rows(netlist: Netlist, size: Size, slots: Parameters, suffix: str) -> list[verdict.Row]:
    """Report the power of the netlist while it measures and sends the frame with the most force of a recording."""
    frames = dermis.simulate("recorded_touch", engine="closed").codes
    most = max(frames, key=np.sum)
    # The recording has 16x16 taxels; a larger array is at rest beyond them.
    x = [[(0, 510)] * size.cols for _ in range(size.rows)]
    for (row, col), code in np.ndenumerate(most[: size.rows, : size.cols]):
        x[row][col] = (int(code), 510)
    vcd = netlist.directory / "toggles.vcd"
    # A copy of the netlist writes the changes of its nets.
    head, end, rest = netlist.verilog.read_text().rpartition("endmodule")
    dump = f'  initial begin $dumpfile("{vcd}"); $dumpvars(1, dermis_top); end\n'
    vcd.with_suffix(".v").write_text(f"{head}{dump}{end}{rest}")
    design = netlist_design(replace(netlist, verilog=vcd.with_suffix(".v")))
    scenario = {"parameters": size.parameters | slots, "x": x, "gate": 510, "sck_hz": 5e6, "frames": 1}

    def with_changes(command: Sequence[str], *rest: Any) -> None:
        # cocotb forbids Icarus to write any.
        children.run_logged(["-vcd" if word == "-none" else word for word in command], *rest)

    run(design, TOP_BENCH, "client", scenario, WHOLE_LIMIT_S, with_changes)
    corner = liberty.CORNERS["tt"]
    counts, time_ns = power.toggles(vcd)
    inside = partial(liberty.inside_fj, corner=corner, directory=ROOT / "build" / "liberty" / "tt")
    parts = power.power_uw(netlist, corner.voltage_v, counts, time_ns, inside)
    vcd.unlink()
    said = ", ".join(f"{name} {part:.0f}" for name, part in parts.items())
    note = f"{said} uW at {corner.name}; reset, settings, a recorded frame and its reading in {time_ns / 1e6:.2f} ms"
    return [verdict.measured(f"gl.power_uw.{suffix}", sum(parts.values()), "uW", note)]


def gate_level(technology: Technology, size: Size) -> list[verdict.Row]:
    """Run all tests of the top on a small netlist; compare pins, codes, registers at full size."""
    rows: list[verdict.Row] = []

    def small(suffix: str) -> list[verdict.Row]:
        parameters = SMALL.parameters | SMALL_SLOTS
        netlist = map_once(technology, parameters, place(technology, SMALL, "_gl"))
        return top_rows(netlist, parameters, suffix, SMALL_TESTS)

    def whole(suffix: str) -> list[verdict.Row]:
        netlist = map_once(technology, size.parameters, place(technology, size))
        made = pin_rows(netlist, size, suffix)
        # The bench needs the default values.
        slots = {name: header_values()[f"DERMIS_{name}"] for name in SMALL_SLOTS}
        # All registers would take Icarus some 100 000 clocks: codes only.
        made += top_rows(netlist, size.parameters | slots, suffix, [charge_balance(size, WHOLE_LIMIT_S)])
        return made + (power_rows(netlist, size, slots, suffix) if technology.name == "sky130" else [])

    for work, array in ((small, SMALL), (whole, size)):
        start, suffix = time.perf_counter(), f"{technology.name}.{array.name}"
        with attempt(rows, f"gl.failed_tests.{suffix}"):
            rows += work(suffix)
        seconds = time.perf_counter() - start
        rows.append(verdict.report(f"gl.seconds.{suffix}", seconds, "s", "both sides, and mapping if needed"))
    return rows


@click.command("gl")
@size_options
@children.ending()
def gl_command(chosen: list[Technology], size: Size, own: bool, docs: bool) -> int:
    """Compare the mapped netlist with the Verilog in the tests of the top; write build/gl.json."""
    if docs and (len(chosen) < len(TECHNOLOGIES) or own):
        raise InputError("command line", "--docs", "with a choice", "a whole run")
    judged: list[verdict.Row] = []
    with progress.slots("gl", len(chosen), "libraries") as tell:
        for done, technology in enumerate(chosen):
            tell(done, f"{size.name} in {technology.name}")
            judged += gate_level(technology, size)
    code = finish("gl", judged, f"Gate level, {size.name}, Icarus")
    if docs and code == 0:
        write_docs("gl", gl=markdown.rows_table(judged))
    return code
