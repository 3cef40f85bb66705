# SPDX-License-Identifier: Apache-2.0
"""Build and run a cocotb bench on Icarus or Verilator, with builds cached by content."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dermis.chip.sources import rtl_sources
from dermis.errors import SimulatorError
from dermis.scene.design import ROOT
from scripts.cocotb_run import run_bench


def _sources(trap: Path | None, around: Sequence[Path]) -> list[Path]:
    """Return the Verilog files, with a trap in the place of its module."""
    sources = [*rtl_sources(), *around]
    if trap is None:
        return sources
    (module,) = re.findall(r"^module (\w+)", trap.read_text(), re.MULTILINE)[:1]
    assert module in {source.stem for source in sources}, f"{trap.name} replaces no module"
    return [trap if source.stem == module else source for source in sources]


def simulate(
    simulator: str,
    bench: str,
    toplevel: str,
    testcase: str,
    parameters: Mapping[str, int] | None = None,
    scenario: Mapping[str, Any] | None = None,
    trap: Path | None = None,
    around: Sequence[Path] = (),
) -> Any:
    """Run one cocotb test and return what it reported.

    DERMIS_NETLIST (paths with colons between) takes the place of rtl/ for dermis_top: its tests run
    on mapped gates.

    Parameters
    ----------
    simulator : "icarus" or "verilator"
    bench : str
        Python module with the cocotb tests.
    toplevel, testcase : str
        Verilog module, and the one cocotb test to run on it.
    parameters : mapping
        Verilog parameters away from default.
    scenario : mapping
        Handed to the bench as JSON.
    trap : Path, optional
        File whose first module takes the place of the right one.
    around : sequence of Path
        Verilog files of the bench, e.g. of a toplevel that joins several modules.

    Raises
    ------
    AssertionError
        The build failed, the test failed or did not run; with the end of the log.
    """
    parameters, sources = parameters or {}, _sources(trap, around)
    if toplevel == "dermis_top" and (netlist := os.environ.get("DERMIS_NETLIST")):
        parameters, sources = {}, [Path(name) for name in netlist.split(os.pathsep)]
    design = {"parameters": parameters, "sources": sources, "where": "rtl"}
    try:
        return run_bench(simulator, toplevel, bench, testcase, scenario or {}, **design)
    except SimulatorError as error:
        log = Path(error.log) if error.log else None
        end = log.read_text()[-6000:] if log and log.exists() else "no log"
        raise AssertionError(f"{error}\n{end}") from None


def play(
    simulator: str,
    module: str,
    steps: Sequence[Mapping[str, int]],
    outputs: Sequence[str],
    parameters: Mapping[str, int] | None = None,
    trap: Path | None = None,
) -> list[tuple[dict[str, int], dict[str, int]]]:
    """Drive a module clock by clock from a reset; return its outputs behind each rising and each falling edge."""
    ports = list(steps[0])
    scenario = {"ports": ports, "outputs": outputs, "steps": [[step[p] for p in ports] for step in steps]}
    seen = simulate(simulator, "rtl_bench", module, "play", parameters, scenario, trap=trap)
    return [tuple(dict(zip(outputs, values, strict=True)) for values in edges) for edges in seen]


def changed(tmp_path: Path, module: str | Path, *changes: tuple[str, str], more: str = "") -> Path:
    """Copy a module of rtl/, or a file, with changes (text that occurs once, replacement) and `more` at its end."""
    path = ROOT / "rtl" / f"{module}.v" if isinstance(module, str) else module
    text = path.read_text()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    copy = tmp_path / f"wrong_{path.name}"
    copy.write_text(f"{text}\n{more}")
    return copy


def sync_random(tmp_path: Path) -> Path:
    """Return the synchronizer with random metastability."""
    return changed(
        tmp_path,
        "dermis_tech_sync",
        ("`default_nettype none", "`define DERMIS_SYNC_RANDOM\n`default_nettype none"),
    )
