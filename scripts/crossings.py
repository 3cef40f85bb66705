# SPDX-License-Identifier: Apache-2.0
"""Crossings of clocks and resets of the digital core, found in its structure by Yosys.

A flop may be reached by flops and pins of its own clock alone. Everything else goes through `dermis_tech_sync`, and a
reset through `dermis_reset_sync`, or is an exception with its reason in rtl/lint/crossings.toml.
"""

import json
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from dermis.chip.sources import TOP, read_verilog
from dermis.errors import SimulatorError
from dermis.processes.children import output_of
from dermis.report.verdict import Row
from dermis.scene.design import ROOT
from scripts.judged import none, tool

SYNC, RESET = "dermis_tech_sync", "dermis_reset_sync"
FLOPS = ("$_DFF", "$_DLATCH", "$_SDFF", "$_ALDFF", "$_SR")
RESETS = ("R", "S", "L")
CLOCKS = ("C", "E", "CLK", "clk_i")
"""Pins of cells that clock them."""
TIME_LIMIT_S = 60.0

Place = tuple[str, str]
"""Name of a net and the clock that moves it; empty for a pin that moves at any time."""
Source = tuple[str, Any, Mapping[str, Any] | None]
"""Kind, which is pin, flop, sync or memory, net, and cell."""


def _rules(root: Path) -> dict[str, Any]:
    return tomllib.loads((root / "rtl" / "lint" / "crossings.toml").read_text(encoding="utf-8"))


class Netlist:
    """The core as gates, its synchronizers whole."""

    def __init__(self, root: Path, latch: bool) -> None:
        self.rules = _rules(root)
        size = f"-chparam ROWS 3 -chparam COLS 2 -chparam SYNC_LATCH {int(latch)}"  # no row is a column
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "top.json"
            script = f"{read_verilog(root)}; hierarchy -check -top {TOP} {size}; proc; "
            script += f"setattr -mod -set keep_hierarchy 1 {SYNC} {RESET}; flatten; opt_clean; simplemap; "
            command = [tool("yosys"), "-Q", "-T", "-p", f"{script}write_json {out}"]
            said = output_of(command, TIME_LIMIT_S, root)[1]
            if not out.is_file():
                raise SimulatorError(f"yosys: no netlist: {(said.strip().splitlines() or ['no output'])[-1]}")
            self.modules = json.loads(out.read_text(encoding="utf-8"))["modules"]
        self.top = self.modules[TOP]
        # A register is called what its module calls it, a word without the number of its bit.
        nets = self.top["netnames"]
        self.names: dict[int, str] = {}
        for name in sorted(nets, key=lambda name: (not name.endswith("_q"), name.count("."))):
            net = nets[name]
            for bit in () if net["hide_name"] else net["bits"]:
                self.names.setdefault(bit, re.sub(r"\[\d+\]", "", name))
        cells = self.top["cells"].values()
        self.drivers = {
            bit: cell
            for cell in cells
            for pin, bits in cell["connections"].items()
            if cell["port_directions"].get(pin) == "output"
            for bit in bits
        }
        self.writers = {c["parameters"]["MEMID"]: c for c in cells if c["type"].startswith("$memwr")}
        inputs = {name: p["bits"] for name, p in self.top["ports"].items() if p["direction"] == "input"}
        self.pins = {bit: name for name, bits in inputs.items() for bit in bits}

    def name(self, bit: Any) -> str:
        """Return the name of a net; of one without a name, the gate that drives it."""
        return self.names.get(bit) or self.driver(bit)

    def driver(self, bit: Any) -> str:
        """Return the type of the cell that drives a net."""
        return self.drivers[bit]["type"] if bit in self.drivers else f"the constant {bit}"

    def sources(self, bit: Any, seen: set[Any] | None = None) -> Iterator[Source]:
        """Yield what a net comes from through gates."""
        seen = set() if seen is None else seen
        if bit in seen or not isinstance(bit, int):
            return
        seen.add(bit)
        if bit in self.pins:
            yield "pin", bit, None
            return
        cell = self.drivers.get(bit)
        if cell is None:  # nothing drives it, as the linters say
            return
        kind = cell["type"]
        if kind.startswith(FLOPS):
            yield "flop", bit, cell
        elif kind in (SYNC, RESET):
            yield "sync", bit, cell
        else:
            if kind.startswith("$memrd"):
                yield "memory", bit, self.writers[cell["parameters"]["MEMID"]]
            for pin, bits in cell["connections"].items():
                for each in bits if cell["port_directions"].get(pin) == "input" else ():
                    yield from self.sources(each, seen)

    def clock(self, bit: int) -> str:
        """Return what a clock comes from: one pin, unless something gates it."""
        found = {self.pins.get(at) or self.name(at) for kind, at, _ in self.sources(bit) if kind != "sync"}
        return " ".join(sorted(found))

    def place(self, kind: str, bit: int, cell: Mapping[str, Any] | None) -> Place:
        if kind == "pin":
            return self.pins[bit], self.rules["pins"].get(self.pins[bit], "")
        clock = next(cell["connections"][pin][0] for pin in CLOCKS if pin in cell["connections"])
        return "memory" if kind == "memory" else self.name(bit), self.clock(clock)

    def resets(self, cell: Mapping[str, Any] | None) -> set[str]:
        """Return the pins that reset a flop at any time; but for that of the whole chip."""
        pins = cell["connections"] if cell and cell["type"].startswith(FLOPS) else {}
        found = (s for pin in RESETS if pin in pins for s in self.sources(pins[pin][0]))
        return {self.pins[bit] for kind, bit, _ in found if kind == "pin"} - {"rst_ni"}

    @cached_property
    def paths(self) -> list[tuple[str, Place, Place]]:
        """Every kind (data, a reset, or what is wrong with it or with a synchronizer), source and target."""
        found = []
        for cell in self.top["cells"].values():
            kind, pins = cell["type"], cell["connections"]
            if kind.startswith(FLOPS):
                target = self.place("flop", pins["Q"][0], cell)
                data, resets = [pins["D"][0]], [pins[pin][0] for pin in RESETS if pin in pins]
            elif kind.startswith("$memwr"):
                target = self.place("memory", 0, cell)
                data, resets = [bit for pin in ("DATA", "ADDR", "EN") for bit in pins[pin]], []
            elif kind in (SYNC, RESET):
                target = self.place("sync", pins["q_o" if kind == SYNC else "rst_no"][0], cell)
                data, resets = [], [pins["rst_ni"][0]]
                # It takes a flop or a pin, for what a gate makes of two edges is a third one.
                taken = pins["d_i"][0] if kind == SYNC else None
                if taken and taken not in self.pins and not self.driver(taken).startswith(FLOPS):
                    found.append(("gates before", (self.name(taken), ""), target))
            else:
                continue
            # Every reset of the core is low; a constant never is, or always.
            for bit in resets:
                if not isinstance(bit, int) or (kind.startswith("$_DFF_") and kind[-3] != "N"):
                    found.append(("not reset", (self.name(bit), ""), target))
            for what, bits in (("data", data), ("reset", resets)):
                for source in (source for bit in bits for source in self.sources(bit)):
                    through = what == "data" or (source[2] or {}).get("type") == RESET
                    before = self.place(*source)
                    # A flop that a pin resets moves with that pin too, at no edge of its clock.
                    if self.resets(source[2]) - self.resets(cell):
                        before = before[0], ""
                    found.append((what if through else "raw reset", before, target))
        return found

    def findings(self) -> list[str]:
        """Name every path between two clocks, every raw reset and every synchronizer that is none."""
        found = {
            f"{what}: {source} ({before or 'any time'}) -> {target} ({after})"
            for what, (source, before), (target, after) in self.paths
            if what not in ("data", "reset") or before != after
        }
        allowed = [
            f"{rule['what']}: (?:{rule['from']}) \\(.*\\) -> (?:{rule['to']}) \\(.*\\)"
            for rule in self.rules["allowed"]
        ]
        left = sorted(said for said in found if not any(re.fullmatch(rule, said) for rule in allowed))
        unused = [rule for rule in allowed if not any(re.fullmatch(rule, said) for said in found)]
        # A synchronizer is two flops in a row on one edge of its clock, from pin to pin.
        for name, first, last in ((SYNC, "d_i", "q_o"), (RESET, None, "rst_no")):
            ports = {port: p["bits"][0] for port, p in self.modules.get(name, {"ports": {}})["ports"].items()}
            cells = self.modules.get(name, {"cells": {}})["cells"].values()
            flops = {cell["connections"]["Q"][0]: cell for cell in cells if cell["type"] == "$_DFF_PN0_"}
            at, count = ports.get(last), 0
            while at in flops and flops[at]["connections"]["C"][0] == ports["clk_i"] and count < len(flops):
                at, count = flops[at]["connections"]["D"][0], count + 1
            if count < 2 or count < len(cells) or at != (ports[first] if first else "1"):
                left.append(f"{name}: not two flops in a row on one edge of clk_i")
        return left + [f"no path for the exception {rule}" for rule in unused]


WIRE = "module dermis_wire (input wire clk_i, rst_ni, d_i, output wire q_o); assign q_o = d_i; endmodule\n"


def seeded(root: Path, folder: Path) -> Iterator[tuple[str, Path | None]]:
    """Yield each fault's name and a copy of the Verilog with it; None where the Verilog has no place for it."""
    for name, fault in _rules(root)["seeded"].items():
        copy = folder / name
        shutil.copytree(root / "rtl", copy / "rtl")
        path = copy / "rtl" / fault["file"]
        text = path.read_text(encoding="utf-8")
        start = max(text.find(fault["at"]), 0)
        wrong = text[:start] + text[start:].replace(fault["old"], fault["new"], 1)
        if fault["at"] not in text or wrong == text:
            yield f"{name} ({fault['file']} has no {fault['old']!r} behind {fault['at']!r})", None
            continue
        path.write_text(wrong + (WIRE if "dermis_wire" in fault["new"] else ""), encoding="utf-8")
        yield name, copy


def rows(root: Path = ROOT) -> list[Row]:
    """Judge the crossings of both forms of the comparators' synchronizer, and the share of seeded faults found."""
    judged = [
        none(f"lint.crossings.{form}", Netlist(root, latch).findings(), "findings")
        for form, latch in (("sync_ff", False), ("sync_latch", True))
    ]
    with tempfile.TemporaryDirectory() as folder:
        copies = seeded(root, Path(folder))
        missed = [name for name, copy in copies if not copy or not Netlist(copy, latch=False).findings()]
    return [*judged, none("lint.crossings.seeded_missed", missed, "faults")]
