# SPDX-License-Identifier: Apache-2.0
"""Build and run a cocotb bench on Icarus or Verilator, with builds cached by content."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cocotb_tools.check_results import get_results

from dermis.chip import hdl
from dermis.chip.sources import rtl_sources
from dermis.scene.design import ROOT

TRAPS = Path(__file__).resolve().parent / "traps"


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
        sources = hdl.with_modules(sources, [trap if isinstance(trap, Path) else TRAPS / f"{trap}.v"])
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
    runs = ROOT / "build" / "rtl" / "runs"
    runs.mkdir(parents=True, exist_ok=True)
    # A directory of its own: the same test may run twice at a time in one tree. Kept when the test
    # fails.
    work = Path(tempfile.mkdtemp(prefix=f"{simulator}-{bench}-{testcase}-", dir=runs))
    result, log = work / "result.json", work / "hdl.log"
    try:
        environment = {"DERMIS_SCENARIO": json.dumps(scenario or {}), "DERMIS_RESULT": str(result)}
        xml = hdl.run_cocotb(simulator, build, toplevel, bench, work, environment, testcase=testcase)
        ran, failed = get_results(xml)
        ended = "ended"
    except (RuntimeError, SystemExit) as error:
        ran, failed = 0, 0
        ended = f"stopped ({error})"
    if ran != 1 or failed:
        end = log.read_text()[-6000:] if log.exists() else "no log"
        raise AssertionError(
            f"{bench}.{testcase} on {simulator} {ended}: {ran} ran, {failed} failed; {log}\n{end}"
        )
    reported = json.loads(result.read_text()) if result.exists() else None
    shutil.rmtree(work)
    return reported
