# SPDX-License-Identifier: Apache-2.0
"""Mapping of rtl/ to the cells of a library with Yosys, and the contents of the netlist."""

from __future__ import annotations

import fcntl
import hashlib
import json
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from dermis.chip.sources import rtl_include_dirs, rtl_sources
from dermis.chip.spi_protocol import SPECIAL_SLOTS, frame_bytes
from dermis.errors import InputError, SimulatorError
from dermis.processes.children import run_logged
from dermis.scene.design import ROOT
from scripts.synth import cells as synth_cells
from scripts.synth.cells import Cell, Technology, areas, cells, mapping_liberty

TOP = "dermis_top"
RAM = "dermis_tech_ram"
YOSYS_LIMIT_S = 900.0
# Target delay of ABC in ps: short, for a meaningful highest clock; it hardly changes the area at 5
# MHz.
DELAY_PS = 5000

_MESSAGE = re.compile(r"^(?:\S+:\d+: )?(?:Warning|ERROR): .*$", re.MULTILINE)
# Warnings about intended constructs.
_EXPECTED = re.compile(r"Warning: (?:Found unsupported expression|Shell command|Resizing cell port)")


@dataclass(frozen=True)
class Size:
    """Parameters of the synthesised top level."""

    rows: int
    cols: int
    code_bits: int = 8
    sync_latch: bool = False

    @property
    def name(self) -> str:
        bits = "" if self.code_bits == 8 else f"_{self.code_bits}bit"
        return f"{self.rows}x{self.cols}{bits}{'_latch' if self.sync_latch else ''}"

    @property
    def parameters(self) -> dict[str, int]:
        return {
            "ROWS": self.rows,
            "COLS": self.cols,
            "CODE_BITS": self.code_bits,
            "SYNC_LATCH": int(self.sync_latch),
        }

    @property
    def latches(self) -> int:
        """Number of latches: one per column in the flip-flop + latch form."""
        return self.cols if self.sync_latch else 0

    @property
    def bank_bytes(self) -> int:
        """Bytes of one bank of the frame memory: a frame with all rows and special slots."""
        return frame_bytes(self.rows + len(SPECIAL_SLOTS), self.cols, self.code_bits)

    @property
    def memory_bits(self) -> int:
        return 2 * self.bank_bytes * 8


@dataclass
class Netlist:
    """A mapped netlist and its contents.

    Parameters
    ----------
    kinds : instances of each cell type below the top level
    area_um2, flops, latches, unreset : totals
    inferred_latches : latches inferred from the Verilog
    unmapped : instances that are not cells of the library
    fanout : largest number of inputs on a net other than clock and reset, and that net
    blocks : module name -> totals of all its instances; hierarchical runs only
    """

    technology: Technology
    directory: Path
    verilog: Path
    json: Path
    kinds: Counter[str] = field(default_factory=Counter)
    area_um2: float = 0.0
    cells: int = 0
    flops: int = 0
    latches: int = 0
    unreset: int = 0
    inferred_latches: int = 0
    unmapped: dict[str, int] = field(default_factory=dict)
    fanout: tuple[int, str] = (0, "")
    blocks: dict[str, dict[str, float]] = field(default_factory=dict)


def tool(name: str, package: str | None = None) -> str:
    """Return the path of a program.

    Raises
    ------
    InputError
        It is not installed.
    """
    found = shutil.which(name)
    if found is None:
        allowed = f"Debian package {package or name} (make setup installs it)"
        raise InputError("environment", name, "not found", allowed)
    return found


def run_yosys(script: Sequence[str], directory: Path, name: str, limit_s: float = YOSYS_LIMIT_S) -> str:
    """Run a Yosys script; return its output.

    Raises
    ------
    SimulatorError
        It failed, timed out or warned; the message has the first line of that.
    """
    file, log = directory / f"{name}.ys", directory / f"{name}.log"
    file.write_text("\n".join(script) + "\n")
    log.unlink(missing_ok=True)
    try:
        run_logged([tool("yosys"), "-Q", "-T", "-s", str(file)], ROOT, log, limit_s, "Yosys")
    except SimulatorError as error:
        said = _MESSAGE.findall(log.read_text(errors="replace")) if log.exists() else []
        raise SimulatorError(f"{said[-1]}; {error.what}" if said else error.what, log) from None
    output = log.read_text(errors="replace")
    warned = [line for line in _MESSAGE.findall(output) if not _EXPECTED.search(line)]
    if warned:
        raise SimulatorError(f"Yosys: {' '.join(warned[0].split())}", log)
    return output


def read_rtl(technology: Technology | None, sources: Sequence[Path] | None = None) -> str:
    """Return the read_verilog line of rtl/files.f, with the latch cell of a technology."""
    files = list(rtl_sources() if sources is None else sources)
    if technology is not None:
        own = technology.latch_source()
        files = [own if path.name == own.name else path for path in files]
    includes = " ".join(f"-I{d}" for d in rtl_include_dirs())
    return f"read_verilog {includes} {' '.join(str(f) for f in files)}"


def elaborate(size: Mapping[str, int], top: str = TOP) -> list[str]:
    """Return the Yosys lines that set parameters and convert processes to cells."""
    parameters = " ".join(f"-chparam {key} {value}" for key, value in size.items())
    return [f"hierarchy -check -top {top} {parameters}", "proc", "check -assert"]


# Undriven bits, such as words past the end of a memory, are 0 on both sides of the proof. The order
# matters: an open enable of a read port would become 0 too. The check for undriven wires comes
# before.
WORDS_TO_FLOPS = ["memory -nomap", "opt_clean", "memory_map", "setundef -undriven -zero", "opt_clean"]


def map_design(
    technology: Technology,
    parameters: Mapping[str, int],
    directory: Path,
    *,
    top: str = TOP,
    hierarchical: bool = False,
    sources: Sequence[Path] | None = None,
    black_box_memory: bool = False,
    limit_s: float = YOSYS_LIMIT_S,
) -> Netlist:
    """Synthesise and map; write the netlist and logs to `directory`.

    Parameters
    ----------
    technology : the library
    parameters : of the top level
    directory : output, created if missing
    top : module to synthesise
    hierarchical : keep the modules, for the area of each
    sources : Verilog files; default rtl/files.f
    black_box_memory : leave dermis_tech_ram out, like a memory macro
    limit_s : time limit of Yosys

    Raises
    ------
    SimulatorError
        Yosys failed.
    """
    directory.mkdir(parents=True, exist_ok=True)
    liberty = technology.liberty(technology.corners[0])
    choice = mapping_liberty(technology, liberty, directory / "map.lib")
    library = cells(liberty)
    constraint = directory / "abc.constr"
    constraint.write_text(f"set_driving_cell {technology.driver}\nset_load {technology.load_ff:g}\n")
    name = "hierarchical" if hierarchical else "netlist"
    counts = directory / f"{name}_latches.txt"
    netlist = Netlist(technology, directory, directory / f"{name}.v", directory / f"{name}.json")
    for stale in (counts, netlist.verilog, netlist.json):
        stale.unlink(missing_ok=True)
    abc = (
        "strash;ifraig;scorr;dc2;strash;&get,-n;&dch,-f;&nf;&put;"
        f"buffer,-p,-N,{technology.fanout};upsize,{{D}};dnsize,{{D}};stime,-p"
    )
    script = [f"read_liberty -lib {liberty}", read_rtl(technology, sources)]
    if black_box_memory:
        script.append(f"blackbox {RAM}")
    script += elaborate(parameters, top)
    script += [] if hierarchical else ["flatten", "opt_clean", "check -assert"]
    script += [
        *WORDS_TO_FLOPS,
        f"tee -q -o {counts} select -count t:$dlatch t:$adlatch t:$dlatchsr",
        "opt -nodffe -nosdff",
        "wreduce",
        "peepopt",
        "opt_clean",
        "alumacc",
        "share",
        "opt -nodffe -nosdff",
        "techmap",
        "opt -nodffe -nosdff",
        f"dfflibmap -liberty {choice}",
        "opt -nodffe -nosdff",
        f"abc -liberty {choice} -constr {constraint} -D {DELAY_PS} -script +{abc}",
        "opt_clean",
    ]
    if technology.tie_high and technology.tie_low and technology.tie_high[0] in library:
        (high, high_pin), (low, low_pin) = technology.tie_high, technology.tie_low
        script.append(f"hilomap -singleton -hicell {high} {high_pin} -locell {low} {low_pin}")
    storing = " ".join(f"t:{name}" for name, cell in library.items() if cell.flop or cell.latch)
    script += [
        "opt_clean",
        "check -assert",
        f"rename -wire -suffix _reg {storing}",
        f"write_json {netlist.json}",
    ]
    if black_box_memory:
        # OpenSTA has no parameters.
        script.append(f"setparam -unset WORDS t:{RAM}")
    script += ["opt_clean -purge", f"write_verilog -noattr -noexpr -nohex {netlist.verilog}"]
    run_yosys(script, directory, name, limit_s)
    if not netlist.json.is_file() or not netlist.verilog.is_file() or not counts.is_file():
        raise SimulatorError("Yosys wrote no netlist", directory / f"{name}.log")
    inferred = re.fullmatch(r"(\d+) objects\.\s*", counts.read_text())
    if not inferred:
        raise SimulatorError("Yosys did not count latches", directory / f"{name}.log")
    netlist.inferred_latches = int(inferred.group(1))
    read_netlist(netlist, top, library)
    return netlist


@cache
def _tools() -> str:
    """Return the version of Yosys and a hash of its ABC, which has no version."""
    said = subprocess.run(
        [tool("yosys"), "-V"], capture_output=True, text=True, timeout=20, check=False
    ).stdout
    return said + hashlib.sha256(Path(tool("berkeley-abc")).read_bytes()).hexdigest()


def _key(technology: Technology, parameters: Mapping[str, int]) -> str:
    """Return a hash of everything that a netlist depends on."""
    what = [repr(technology), dict(parameters), _tools()]
    digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode())
    headers = [h for d in rtl_include_dirs() for h in sorted(d.glob("*.vh"))]
    own = [Path(__file__), Path(synth_cells.__file__), technology.latch_source()]
    own.append(technology.liberty(technology.corners[0]))
    for path in [*rtl_sources(), *headers, *own]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def map_once(
    technology: Technology,
    parameters: Mapping[str, int],
    directory: Path,
    *,
    fresh: bool = False,
    limit_s: float = YOSYS_LIMIT_S,
) -> Netlist:
    """Return the netlist in `directory` if its inputs are unchanged, else map it; `fresh` always
    maps.

    A second process for the same directory waits for the first.
    """
    directory.mkdir(parents=True, exist_ok=True)
    netlist = Netlist(technology, directory, directory / "netlist.v", directory / "netlist.json")
    mark, key = directory / "made_from", _key(technology, parameters)

    def content() -> str:
        made = (hashlib.sha256(path.read_bytes()).hexdigest() for path in (netlist.verilog, netlist.json))
        return "\n".join([key, *made])

    with (directory / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        there = mark.is_file() and netlist.verilog.is_file() and netlist.json.is_file()
        if there and not fresh and mark.read_text() == content():
            counts = re.match(r"\d+", (directory / "netlist_latches.txt").read_text())
            netlist.inferred_latches = int(counts.group()) if counts else -1
            read_netlist(netlist, TOP, cells(technology.liberty(technology.corners[0])))
            return netlist
        mark.unlink(missing_ok=True)
        netlist = map_design(technology, parameters, directory, limit_s=limit_s)
        mark.write_text(content())
        return netlist


def _module_name(name: str) -> str:
    """Return the Verilog name of a module that Yosys renamed for its parameters."""
    return re.sub(r"^\$paramod(\$[0-9a-f]+)?\\", "", name).split("\\", 1)[0]


def read_netlist(netlist: Netlist, top: str, library: Mapping[str, Cell]) -> None:
    """Count the contents of a netlist's JSON into the record."""
    design = json.loads(netlist.json.read_text())
    own = {
        name: m for name, m in design["modules"].items() if not int(m["attributes"].get("blackbox", "0"), 2)
    }
    area = areas(netlist.technology, library)
    totals: dict[str, Counter[str]] = {}

    def below(name: str) -> Counter[str]:
        if name not in totals:
            counted: Counter[str] = Counter()
            for cell in own[name]["cells"].values():
                kind = cell["type"]
                if kind in own:
                    counted.update(below(kind))
                else:
                    counted[kind] += 1
            totals[name] = counted
        return totals[name]

    roots = [name for name in own if _module_name(name) == top]
    if len(roots) != 1:
        raise SimulatorError(f"the netlist holds {len(roots)} modules {top}", netlist.json)
    kinds = below(roots[0])
    netlist.kinds = kinds
    black = {kind for kind in kinds if _module_name(kind) == RAM}
    netlist.unmapped = {k: n for k, n in kinds.items() if k not in library and k not in black}

    def sums(counted: Mapping[str, int]) -> dict[str, float]:
        known = {k: n for k, n in counted.items() if k in library}
        return {
            "cells": sum(known.values()),
            "area_um2": sum(n * area[k] for k, n in known.items()),
            "flops": sum(n for k, n in known.items() if library[k].flop),
            "latches": sum(n for k, n in known.items() if library[k].latch),
        }

    all_of = sums(kinds)
    netlist.cells, netlist.area_um2 = int(all_of["cells"]), all_of["area_um2"]
    netlist.flops, netlist.latches = int(all_of["flops"]), int(all_of["latches"])
    instances: Counter[str] = Counter({roots[0]: 1})
    for name in _callers_first(own, roots[0]):
        for cell in own[name]["cells"].values():
            if cell["type"] in own:
                instances[cell["type"]] += instances[name]
    netlist.blocks = {}
    for name, number in instances.items():
        block = netlist.blocks.setdefault(
            _module_name(name), {"instances": 0, "cells": 0, "area_um2": 0.0, "flops": 0, "latches": 0}
        )
        block["instances"] += number
        for key, value in sums(below(name)).items():
            block[key] += number * value
    netlist.unreset = 0
    for name, number in instances.items():
        netlist.unreset += number * _without_reset(own[name], library)
    netlist.fanout = max((_largest_fanout(own[name], library) for name in instances), default=(0, ""))


def _callers_first(own: Mapping[str, Any], root: str) -> list[str]:
    order: list[str] = []
    seen: set[str] = set()

    def visit(name: str) -> None:
        if name in seen:
            return
        seen.add(name)
        for cell in own[name]["cells"].values():
            if cell["type"] in own:
                visit(cell["type"])
        order.append(name)

    visit(root)
    return order[::-1]


def _without_reset(module: Mapping[str, Any], library: Mapping[str, Cell]) -> int:
    """Return the number of flops of a module without a connected asynchronous pin."""
    number = 0
    for cell in module["cells"].values():
        known = library.get(cell["type"])
        if known is None or not known.flop:
            continue
        pins = [bit for pin in known.asynchronous for bit in cell["connections"].get(pin, [])]
        number += not any(isinstance(bit, int) for bit in pins)
    return number


def _largest_fanout(module: Mapping[str, Any], library: Mapping[str, Cell]) -> tuple[int, str]:
    sinks: Counter[int] = Counter()
    ideal: set[int] = set()
    for cell in module["cells"].values():
        known = library.get(cell["type"])
        for pin, bits in cell["connections"].items():
            for bit in bits:
                if not isinstance(bit, int) or known is None or pin not in known.inputs:
                    continue
                sinks[bit] += 1
                if pin in known.asynchronous or ((known.flop or known.latch) and pin in known.clocks):
                    ideal.add(bit)
    data = [(number, bit) for bit, number in sinks.items() if bit not in ideal]
    if not data:
        return (0, "")
    number, bit = max(data)
    names = [name for name, net in module["netnames"].items() if bit in net["bits"]]
    return (number, min(names, key=len, default=str(bit)))
