# SPDX-License-Identifier: Apache-2.0
"""Build and run a cocotb bench on Icarus or Verilator, with builds cached by content."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dermis.chip import hdl
from dermis.chip.sources import rtl_sources
from dermis.errors import SimulatorError
from dermis.scene.design import ROOT
from scripts.cocotb_run import run_bench

TRAPS = Path(__file__).resolve().parent / "traps"
# Not moved with ROOT by scripts/mutate_plugin.py: a seeded fault is one of the right module.
RTL = ROOT / "rtl"


def _build(
    simulator: str,
    toplevel: str,
    parameters: Mapping[str, int],
    trap: str | Path | None,
    around: Sequence[Path],
) -> Path:
    """Directory of the build, with a trap in the place of the module it names.

    DERMIS_NETLIST (paths with colons between) takes the place of rtl/ for dermis_top: its tests run
    on mapped gates.
    """
    if toplevel == "dermis_top" and (netlist := os.environ.get("DERMIS_NETLIST")):
        gates = [Path(name) for name in netlist.split(os.pathsep)]
        return hdl.build(simulator, toplevel, {}, sources=gates, optimise=False, where="rtl")
    sources = [*rtl_sources(), *around]
    if trap is not None:
        trap = trap if isinstance(trap, Path) else TRAPS / f"{trap}.v"
        module = trap.read_text().split("module ", 1)[1].split(None, 1)[0].rstrip("(;")
        assert module in {source.stem for source in sources}, f"{trap.name} replaces no module"
        sources = [trap if source.stem == module else source for source in sources]
    # No optimisation of the C++: the compiler, not the simulation, takes the time here.
    return hdl.build(simulator, toplevel, parameters, sources=sources, optimise=False, where="rtl")


def simulate(
    simulator: str,
    bench: str,
    toplevel: str,
    testcase: str,
    parameters: Mapping[str, int] | None = None,
    scenario: Mapping[str, Any] | None = None,
    trap: str | Path | None = None,
    around: Sequence[Path] = (),
) -> Any:
    """Run one cocotb test and return what it reported.

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
    trap : str or Path, optional
        Name of a file in traps/, or a path, whose module takes the place of the right one.
    around : sequence of Path
        Verilog files of the bench, e.g. of a toplevel that joins several modules.

    Raises
    ------
    AssertionError
        The build failed, the test failed or did not run; with the end of the log.
    """
    build = _build(simulator, toplevel, parameters or {}, trap, around)
    try:
        return run_bench(simulator, build, toplevel, bench, testcase, scenario or {}, ROOT / "build" / "rtl")
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
    """Drive the inputs of a module clock by clock from a reset; return its outputs behind each
    rising and each falling edge.
    """
    ports = list(steps[0])
    scenario = {"ports": ports, "outputs": outputs, "steps": [[step[p] for p in ports] for step in steps]}
    seen = simulate(simulator, "bench_unit", module, "play", parameters, scenario, trap=trap)
    return [tuple(dict(zip(outputs, values, strict=True)) for values in edges) for edges in seen]


def changed(tmp_path: Path, module: str, *changes: tuple[str, str], more: str = "") -> Path:
    """Return a copy of a module with seeded faults, each a text that occurs once and its
    replacement; `more` is put behind it.
    """
    # Without the comments at its head: the first "module" has to be the keyword.
    lines = (RTL / f"{module}.v").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("//"))
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = tmp_path / f"wrong_{module}.v"
    path.write_text(f"{text}\n{more}")
    return path
