# SPDX-License-Identifier: Apache-2.0
"""Build the Verilog, run one cocotb test with a time limit, and hand back what it reports."""

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cocotb_tools.check_results import get_results

from dermis.chip import hdl
from dermis.errors import SimulatorError

LIMIT_S = 600.0


def run_bench(
    simulator: str,
    toplevel: str,
    bench: str,
    testcase: str,
    scenario: Mapping[str, Any],
    *,
    parameters: Mapping[str, int],
    sources: Sequence[Path] | None,
    where: str,
    limit_s: float = LIMIT_S,
    run: Callable[..., object] | None = None,
) -> Any:
    """Run one cocotb test in a new directory below build/`where`; return what it reported.

    `parameters`, `sources` and `run` are those of hdl.build and hdl.run_cocotb. SimulatorError, and the
    directory stays, if the build or the test failed, or the test did not run or timed out.
    """
    # No optimisation of the C++: the compiler, not the simulation, takes the time here.
    build = hdl.build(simulator, toplevel, parameters, sources=sources, optimise=False, where=where)
    place = hdl.BUILD / where / "runs"
    place.mkdir(parents=True, exist_ok=True)
    # A directory of its own: the same test may run twice at a time in one tree.
    work = Path(tempfile.mkdtemp(prefix=f"{simulator}-{bench}-{testcase}-", dir=place))
    result, log, name = work / "result.json", work / "hdl.log", f"{bench}.{testcase} on {simulator}"
    # A file: a variable holds 128 kB at most.
    (work / "scenario.json").write_text(json.dumps(scenario))
    environment = {"DERMIS_SCENARIO": str(work / "scenario.json"), "DERMIS_RESULT": str(result)}
    # Both simulators apply a write in the time step that it is made in; cocotb's own queue takes a quarter of the time.
    environment["COCOTB_TRUST_INERTIAL_WRITES"] = "1"
    fault, options = "", {"testcase": testcase, "limit_s": limit_s, "run": run}
    try:
        hdl.run_cocotb(simulator, build, toplevel, bench, work, environment, **options)
    except SimulatorError as error:
        raise SimulatorError(f"{name}: {error.what}", log) from None
    except (RuntimeError, SystemExit, OSError) as error:  # cocotb's runner raises these for a failed test too
        fault = f" ({error})"
    try:
        ran, failed = get_results(work / "results.xml")
    except (RuntimeError, OSError):  # nothing was written
        ran = failed = 0
    if ran != 1 or failed:
        raise SimulatorError(f"{name}: {ran} ran, {failed} failed{fault}", log)
    reported = json.loads(result.read_text()) if result.exists() else None
    shutil.rmtree(work)
    return reported
