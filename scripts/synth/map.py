# SPDX-License-Identifier: Apache-2.0
"""Mapping of rtl/ to the cells of a library with Yosys, and the contents of the netlist."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from dermis.chip.sources import read_verilog, rtl_include_dirs, rtl_sources
from dermis.chip.spi_protocol import SPECIAL_SLOTS, frame_bytes
from dermis.errors import SimulatorError
from dermis.files import locked
from dermis.processes.children import output_of, run_logged
from dermis.scene.design import ROOT
from scripts import templates
from scripts.judged import digest, tool
from scripts.synth import cells as synth_cells
from scripts.synth.cells import Cell, Technology, areas, cells, for_cells, mapping_liberty

TOP = "dermis_top"
RAM = "dermis_tech_ram"
YOSYS_LIMIT_S = 900.0
# Target delay of ABC in ps, short for a meaningful highest clock; the area at 5 MHz hardly changes.
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
        return {name.upper(): int(value) for name, value in asdict(self).items()}

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
        """Bits of the frame memory, a latch each."""
        return 2 * self.bank_bytes * 8

    @property
    def memory_flops(self) -> int:
        """Flops at the write ports of the frame memory: enable, address and byte; without reset like it."""
        return 2 * (1 + max(1, (self.bank_bytes - 1).bit_length()) + 8)


@dataclass
class Netlist:
    """A mapped netlist and its contents."""

    technology: Technology
    directory: Path
    verilog: Path
    json: Path
    kinds: Counter[str] = field(default_factory=Counter)  # instances of each cell type
    area_um2: float = 0.0
    cells: int = 0
    flops: int = 0
    latches: int = 0
    unreset: int = 0  # flops without an asynchronous pin
    inferred_latches: int = 0  # from the Verilog
    unmapped: dict[str, int] = field(default_factory=dict)  # instances that are not of the library
    fanout: tuple[int, str] = (0, "")  # largest, other than of clock and reset, and its net
    blocks: dict[str, Counter[str]] = field(default_factory=dict)  # totals of each module's instances

    @property
    def counts(self) -> Path:
        """File with the number of latches that Yosys inferred."""
        return self.json.with_name(f"{self.json.stem}_latches.txt")


def run_yosys(script: Sequence[str], directory: Path, name: str, limit_s: float = YOSYS_LIMIT_S) -> str:
    """Run a Yosys script; return its output. SimulatorError if it failed, timed out or warned."""
    file, log = directory / f"{name}.ys", directory / f"{name}.log"
    # Paths from the root, where Yosys runs: its lines have no word with a space, which the root may have.
    file.write_text("\n".join(script).replace(f"{ROOT}/", "") + "\n")
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


def elaborate(size: Mapping[str, int], top: str = TOP) -> list[str]:
    """Return the Yosys lines that set parameters and convert processes to cells."""
    parameters = " ".join(f"-chparam {key} {value}" for key, value in size.items())
    return [f"hierarchy -check -top {top} {parameters}", "proc", "check -assert"]


# Undriven bits, such as words past the end of a memory, are 0 on both sides of the proof. The check for undriven
# wires comes before; in another order an open enable of a read port would become 0 too.
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
) -> Netlist:
    """Synthesise module `top` and map it; write the netlist and logs to `directory`.

    Parameters
    ----------
    hierarchical : keep the modules, for the area of each
    sources : Verilog files; default rtl/files.f
    black_box_memory : leave dermis_tech_ram out, like a memory macro
    """
    directory.mkdir(parents=True, exist_ok=True)
    choice, library = mapping_liberty(technology, directory / "map.lib"), cells(technology.typical)
    constraint = directory / "abc.constr"
    constraint.write_text(f"set_driving_cell {technology.driver}\nset_load {technology.load_ff:g}\n")
    name = "hierarchical" if hierarchical else "netlist"
    netlist = Netlist(technology, directory, directory / f"{name}.v", directory / f"{name}.json")
    made = netlist.counts, netlist.verilog, netlist.json
    for stale in made:
        stale.unlink(missing_ok=True)
    script = templates.text(
        "map.ys",
        liberty=technology.typical,
        choice=choice,
        library=library,
        technology=technology,
        read=read_verilog(sources=for_cells(rtl_sources() if sources is None else sources, technology)),
        elaborate=elaborate(parameters, top),
        words_to_flops=WORDS_TO_FLOPS,
        black_box_memory=black_box_memory,
        hierarchical=hierarchical,
        constraint=constraint,
        delay_ps=DELAY_PS,
        netlist=netlist,
    ).splitlines()
    run_yosys(script, directory, name)
    if not all(path.is_file() for path in made):
        raise SimulatorError("Yosys wrote no netlist", directory / f"{name}.log")
    read_netlist(netlist, top, library)
    return netlist


@cache
def _tools() -> str:
    """Return a hash of ABC, which has no version, and of the version of Yosys."""
    return digest([Path(tool("berkeley-abc"))], output_of([tool("yosys"), "-V"], 20.0)[1])


def _key(technology: Technology, parameters: Mapping[str, int]) -> str:
    """Return a hash of everything that a netlist depends on."""
    headers = [h for d in rtl_include_dirs() for h in sorted(d.glob("*.vh"))]
    own = [Path(__file__), Path(synth_cells.__file__), templates.path("map.ys")]
    files = [*for_cells(rtl_sources(), technology), *headers, *own, technology.typical]
    return digest(files, technology, sorted(parameters.items()), _tools())


def map_once(
    technology: Technology, parameters: Mapping[str, int], directory: Path, *, fresh: bool = False
) -> Netlist:
    """Return the netlist in `directory`, mapped if its inputs have changed or `fresh`; a second process waits."""
    directory.mkdir(parents=True, exist_ok=True)
    netlist = Netlist(technology, directory, directory / "netlist.v", directory / "netlist.json")
    mark, key, made = directory / "made_from", _key(technology, parameters), (netlist.verilog, netlist.json)

    with locked(directory / "lock"):
        there = all(path.is_file() for path in (mark, *made))
        if there and not fresh and mark.read_text() == digest(made, key):
            read_netlist(netlist, TOP, cells(technology.typical))
            return netlist
        mark.unlink(missing_ok=True)
        netlist = map_design(technology, parameters, directory)
        mark.write_text(digest(made, key))
        return netlist


def _module_name(name: str) -> str:
    """Return the Verilog name of a module that Yosys renamed for its parameters."""
    return re.sub(r"^\$paramod(\$[0-9a-f]+)?\\", "", name).split("\\", 1)[0]


def read_netlist(netlist: Netlist, top: str, library: Mapping[str, Cell]) -> None:
    """Count the contents of a netlist's JSON into the record."""
    modules = json.loads(netlist.json.read_text())["modules"]
    own = {name: m for name, m in modules.items() if not int(m["attributes"].get("blackbox", "0"), 2)}
    area = areas(netlist.technology, library)
    roots = [name for name in own if _module_name(name) == top]
    if len(roots) != 1:
        raise SimulatorError(f"the netlist holds {len(roots)} modules {top}", netlist.json)
    if not (inferred := re.fullmatch(r"(\d+) objects\.\s*", netlist.counts.read_text())):
        raise SimulatorError("Yosys did not count latches", netlist.counts)
    netlist.inferred_latches = int(inferred[1])

    def visit(name: str) -> Counter[str]:
        """Count one instance of a module and all below it."""
        kinds: Counter[str] = Counter()
        for cell in own[name]["cells"].values():
            kinds.update(visit(cell["type"]) if cell["type"] in own else [cell["type"]])
        block = netlist.blocks.setdefault(_module_name(name), Counter())
        known = {kind: n for kind, n in kinds.items() if kind in library}
        block.update(
            instances=1,
            cells=sum(known.values()),
            area_um2=sum(n * area[kind] for kind, n in known.items()),
            flops=sum(n for kind, n in known.items() if library[kind].flop),
            latches=sum(n for kind, n in known.items() if library[kind].latch),
        )
        for cell, pins in ((library.get(c["type"]), c["connections"]) for c in own[name]["cells"].values()):
            if cell and cell.flop:
                bits = (bit for pin in cell.asynchronous for bit in pins.get(pin, []))
                netlist.unreset += not any(isinstance(bit, int) for bit in bits)
        netlist.fanout = max(netlist.fanout, _largest_fanout(own[name], library))
        return kinds

    netlist.kinds = visit(roots[0])
    for name in ("cells", "area_um2", "flops", "latches"):
        setattr(netlist, name, netlist.blocks[top][name])
    known = {*library, *(kind for kind in netlist.kinds if _module_name(kind) == RAM)}
    netlist.unmapped = {kind: n for kind, n in netlist.kinds.items() if kind not in known}


def _largest_fanout(module: Mapping[str, Any], library: Mapping[str, Cell]) -> tuple[int, str]:
    """Return the largest number of inputs on a net other than clock and reset, and that net."""
    sinks: Counter[int] = Counter()
    ideal: set[int] = set()
    for cell in module["cells"].values():
        known = library.get(cell["type"])
        for pin in known.inputs & cell["connections"].keys() if known else ():
            bits = [bit for bit in cell["connections"][pin] if isinstance(bit, int)]
            sinks.update(bits)
            if pin in known.asynchronous or pin in known.clocks:
                ideal.update(bits)
    number, bit = max(((n, bit) for bit, n in sinks.items() if bit not in ideal), default=(0, 0))
    names = [name for name, net in module["netnames"].items() if bit in net["bits"]]
    return number, min(names, key=len, default="")
