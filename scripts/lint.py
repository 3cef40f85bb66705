# SPDX-License-Identifier: Apache-2.0
"""Lint of the Verilog: Icarus, Verilator and Yosys on one file list; every message is counted."""

import json
import re
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import click

from dermis.chip.sources import FILE_LIST, TOP, read_verilog, rtl_sources, verilator_root
from dermis.processes.children import output_of
from dermis.report import verdict
from dermis.scene.design import ROOT
from scripts import crossings
from scripts.judged import finish, none, tool
from scripts.synth.map import Size, elaborate

WAIVERS = "rtl/lint/verilator_waiver.vlt"
# The slowest run, Yosys at 128 x 128, takes 10 s.
TIME_LIMIT_S = 180.0

_LISTED = tomllib.loads((ROOT / "rtl" / "lint" / "configurations.toml").read_text())
Parameters = Mapping[str, int]
CONFIGURATIONS: Mapping[str, Parameters] = _LISTED["rtl"]
WRAPPER = ("rtl/harden/dermis_analog_front_end.v", "rtl/harden/user_analog_project_wrapper.v")

MODELS_FILE_LIST = "models/verilog/files.f"
MODELS_WAIVERS = "models/verilog/verilator_waiver.vlt"

_VERILATOR_MESSAGE = re.compile(r"^%(?:Warning|Error)(?!: Exiting due to)\S*.*$", re.MULTILINE)
_VERILATOR_DONE = re.compile(r"Verilator: Built from \S+ MB sources in [1-9]\d* modules")
_YOSYS_MESSAGE = re.compile(r"^(?:\S+:\d+: )?(?:Warning|ERROR): .*$", re.MULTILINE)


def _row(name: str, code: int | None, output: str, messages: Sequence[str], finished: bool) -> verdict.Row:
    """Return PASS for no message, exit 0 and evidence of the work; without evidence ERROR."""
    count: int | None = len(messages)
    note = " ".join(messages[0].split()) if messages else ""
    if not messages and (code != 0 or not finished):
        last = (output.strip().splitlines() or ["no output"])[-1]
        note = f"no result within {TIME_LIMIT_S:g} s" if code is None else f"exit {code}, no result: {last}"
        count = None
    return verdict.within(name, count, "messages", None, 0, note)


def _icarus(
    name: str, root: Path, top: str, parameters: Parameters, *arguments: str, standard: str = "-g2005"
) -> verdict.Row:
    values = (f"-P{top}.{key}={value}" for key, value in parameters.items())
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "design.vvp"
        command = [tool("iverilog"), standard, "-Wall", "-o", str(out), "-s", top, *values, *arguments]
        code, output = output_of(command, TIME_LIMIT_S, root)
        finished = out.is_file() and f'"{top}"' in out.read_text()
    # Icarus prints only warnings and errors, so every line counts.
    messages = [line for line in output.splitlines() if line.strip()]
    return _row(f"lint.icarus.{name}", code, output, messages, finished)


def _verilator(name: str, root: Path, top: str, parameters: Parameters, *arguments: str) -> verdict.Row:
    place, values = verilator_root(), (f"-G{key}={value}" for key, value in parameters.items())
    command = [str(place / "bin" / "verilator_bin"), "--lint-only", "-Wall", "--top-module", top]
    command += [*values, WAIVERS, *arguments]
    code, output = output_of(command, TIME_LIMIT_S, root, {"VERILATOR_ROOT": str(place)})
    messages = _VERILATOR_MESSAGE.findall(output)
    return _row(f"lint.verilator.{name}", code, output, messages, bool(_VERILATOR_DONE.search(output)))


def _yosys(
    name: str, root: Path, read: str, top: str, parameters: Parameters, latches: int | None = None
) -> tuple[verdict.Row, int | None, dict[str, int] | None]:
    """Return the row; with `latches` also bits of memory, and cells by type of the flat design."""
    with tempfile.TemporaryDirectory() as scratch:
        cells, memories = Path(scratch) / "cells.json", Path(scratch) / "memories.json"
        script = [read_verilog(root, read), *elaborate(parameters, top)]
        # Before `memory`, whose write ports would count as flops; then the words stay together as $mem.
        flat = ["flatten", "check -assert", f"tee -q -o {memories} stat -json", "memory -nomap", "opt_clean"]
        script += [*([] if latches is None else flat), f"tee -q -o {cells} stat -json"]
        if latches is not None:
            script.append(f"select -assert-count {latches} t:$dlatch t:$adlatch t:$dlatchsr")
        command = [tool("yosys"), "-Q", "-T", "-p", "; ".join(script)]
        code, output = output_of(command, TIME_LIMIT_S, root)
        finished = cells.is_file()
        bits = types = None
        if finished and latches is not None:
            bits = json.loads(memories.read_text())["design"]["num_memory_bits"]
            types = json.loads(cells.read_text())["design"]["num_cells_by_type"]
    messages = list(dict.fromkeys(_YOSYS_MESSAGE.findall(output)))
    return _row(f"lint.yosys.{name}", code, output, messages, finished), bits, types


def _lint_yosys(root: Path, name: str, parameters: Parameters) -> list[verdict.Row]:
    """Return the row of Yosys, and rows that count latches, flops without reset, bits of memory."""
    header = header_values(root)
    rows, columns, bits = (parameters.get(k, header[f"DERMIS_{k}"]) for k in ("ROWS", "COLS", "CODE_BITS"))
    size = Size(rows, columns, bits, bool(parameters.get("SYNC_LATCH")))
    first, memory, cells = _yosys(name, root, "", TOP, parameters, size.latches)

    def count(what: str, unit: str, wanted: int, rule: str, *kinds: str) -> verdict.Row:
        found = memory if not kinds or cells is None else sum(cells.get(kind, 0) for kind in kinds)
        note = "no result" if cells is None else "" if found == wanted else rule
        return verdict.within(f"lint.yosys.{name}.{what}", found, unit, wanted, wanted, note)

    flops = ("$dff", "$dffe", "$sdff", "$sdffe", "$sdffce")
    kinds = ("$dlatch", "$adlatch", "$dlatchsr")
    return [
        first,
        count("latches", "latches", size.latches, "only dermis_tech_latch may hold a latch", *kinds),
        count("flops_without_reset", "flops", 0, "every flop resets asynchronously", *flops),
        count("memory_bits", "bits", size.memory_bits, "only the two banks of the frame buffer are memory"),
    ]


def header_values(root: Path = ROOT) -> dict[str, int]:
    """Return the numbers of the generated header rtl/dermis_design.vh."""
    text = (root / "rtl" / "dermis_design.vh").read_text()
    return {key: int(value) for key, value in re.findall(r"^`define\s+(\w+)\s+(\d+)\b", text, re.MULTILINE)}


def _lint_file_list(root: Path) -> verdict.Row:
    """Judge that each rtl/*.v is in files.f, holds the module of its name, and is used by the top."""
    listed = {path.resolve() for path in rtl_sources(root)}
    found = {path.resolve() for path in (root / "rtl").glob("*.v")}
    text = {path.stem: path.read_text() for path in sorted(found & listed)}
    wrong = [f"{p.name} is not in {FILE_LIST}" for p in sorted(found - listed)]
    wrong += [f"{p.name} is in {FILE_LIST} but missing" for p in sorted(listed) if not p.is_file()]
    for name, source in text.items():
        modules = re.findall(r"^\s*module\s+(\w+)", source, re.MULTILINE)
        if modules != [name]:
            wrong.append(f"{name}.v holds {', '.join(modules) or 'no module'}")
        # The tools silently skip a module without an instance.
        used = (re.search(rf"^\s*{name}\b", other, re.MULTILINE) for n, other in text.items() if n != name)
        if name != TOP and not any(used):
            wrong.append(f"nothing instantiates {name}")
    return none("lint.file_list", wrong, "files")


def run_lint(root: Path = ROOT, configurations: Iterable[str] | None = None) -> list[verdict.Row]:
    """Lint rtl/ with every tool in every configuration, or in some of `CONFIGURATIONS`.

    Rows are PASS, FAIL (the tool complained) or ERROR (no result); InputError if a tool is missing.
    """
    for name in ("iverilog", "yosys"):
        tool(name)
    verilator_root()
    chosen = {name: CONFIGURATIONS[name] for name in configurations or CONFIGURATIONS}
    rows = [_lint_file_list(root)]
    rows += [_icarus(name, root, TOP, values, "-c", FILE_LIST) for name, values in chosen.items()]
    rows += [_verilator(name, root, TOP, values, "-f", FILE_LIST) for name, values in chosen.items()]
    return rows + [row for name, values in chosen.items() for row in _lint_yosys(root, name, values)]


def lint_wrapper(root: Path = ROOT) -> list[verdict.Row]:
    """Lint the Caravan wrapper of rtl/harden with and without power pins; rows as `run_lint`."""
    top = Path(WRAPPER[-1]).stem
    rows = []
    for form, define in (("wrapper", []), ("wrapper_power_pins", ["-DUSE_POWER_PINS"])):
        rows += [
            _icarus(form, root, top, {}, *define, "-c", FILE_LIST, *WRAPPER),
            _verilator(form, root, top, {}, *define, "-f", FILE_LIST, *WRAPPER),
            _yosys(form, root, " ".join([*define, *WRAPPER]), top, {})[0],
        ]
    return rows


def lint_models(root: Path = ROOT) -> list[verdict.Row]:
    """Lint the real-number models in Icarus and Verilator (Yosys has no real numbers)."""
    options = ("--no-timing", MODELS_WAIVERS, "-f", FILE_LIST, "-f", MODELS_FILE_LIST)
    alone = ("-c", FILE_LIST, "-c", MODELS_FILE_LIST, "models/verilog/skin_alone.sv")
    rows = []
    for name, values in _LISTED["models"].items():
        rows.append(_icarus(name, root, "skin_alone", values, *alone, standard="-g2012"))
        rows.append(_verilator(name, root, "skin", values, *options))
    return rows


@click.command()
def lint_command() -> int:
    """Lint the Verilog, its wrapper, the real-number models and the crossings of its clocks."""
    rows = run_lint() + lint_wrapper() + lint_models() + crossings.rows()
    return finish("lint", rows, "Lint of rtl/ and models/verilog/")
