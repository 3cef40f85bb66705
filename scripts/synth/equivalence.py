# SPDX-License-Identifier: Apache-2.0
"""Equivalence of a mapped netlist and the Verilog: every state bit and output, for all inputs and states.

Yosys cuts both sides at each flop, latch and memory word (rtl/synth/cut_states.v), and ABC proves the combinational
networks between them equal, output by output: an induction over time (docs/synthesis.md). Yosys' own `equiv_induct`
knows neither clocks nor asynchronous resets.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dermis.chip.sources import read_verilog, rtl_sources
from dermis.errors import SimulatorError
from dermis.processes.children import run_logged
from scripts.judged import tool
from scripts.synth.cells import SYNTH, for_cells
from scripts.synth.map import TOP, WORDS_TO_FLOPS, Netlist, elaborate, run_yosys

PROOF_LIMIT_S = 900.0
# In order: gates; every state element as one kind with set and clear, active high; and and not.
_CUT = [
    *("techmap", "opt_clean", "dffunmap"),
    "dfflegalize -cell $_DFFSR_PPP_ 01 -cell $_DLATCHSR_PPP_ 01",
    *(f"techmap -map {SYNTH / 'cut_states.v'}", "techmap", "aigmap", "opt_clean"),
]

Bit = int | str


@dataclass(frozen=True)
class Proof:
    proved: bool | None  # None: not decided
    state_bits: int  # flops and latches compared
    unpaired: int  # state bits of the Verilog that the netlist does not have, left free
    outputs: int  # of the networks
    said: str  # by ABC


class _Side:
    """One of the two designs: gates, cut states by output bit, ports by name, and names of the network's input bits."""

    def __init__(self, path: Path) -> None:
        modules = json.loads(path.read_text())["modules"].values()
        tops = [module for module in modules if int(module["attributes"].get("top", "0"), 2)]
        if len(tops) != 1:
            raise SimulatorError(f"{len(tops)} top levels to compare", path)
        self.names = dict(_names(tops[0]))
        self.gates: list[Mapping[str, Sequence[Bit]]] = []
        self.states: dict[Bit, Mapping[str, Sequence[Bit]]] = {}
        for cell in tops[0]["cells"].values():
            pins = cell["connections"]
            if cell["type"] == "cut_state":
                self.states[pins["q"][0]] = pins
            elif cell["type"] in ("$_AND_", "$_NOT_"):
                self.gates.append(pins)
            else:
                raise SimulatorError(f"cannot compare a cell {cell['type']}", path)
        ports: dict[str, dict[str, Bit]] = {"input": {}, "output": {}}
        for name, port in tops[0]["ports"].items():
            ports[port["direction"]] |= {f"{name}[{n}]": bit for n, bit in enumerate(port["bits"])}
        self.inputs, self.outputs = ports.values()
        self.nets: dict[Bit, str] = {"0": "const0", "1": "const1", "x": "const0", "z": "const0"}

    def net(self, bit: Bit) -> str:
        return self.nets.get(bit, f"n{bit}")

    def write(self, path: Path, inputs: Sequence[str], outputs: Mapping[str, str]) -> None:
        """Write the network as BLIF; `outputs` maps names to nets."""
        lines = [".model design", f".inputs {' '.join(inputs)}", f".outputs {' '.join(outputs)}"]
        lines += [".names const0", ".names const1", "1"]
        for pins in self.gates:
            nets = [self.net(pins[pin][0]) for pin in "AB" if pin in pins]
            lines += [f".names {' '.join(nets)} n{pins['Y'][0]}", "11 1" if len(nets) == 2 else "0 1"]
        for name, net in outputs.items():
            lines += [f".names {net} {name}", "1 1"]
        path.write_text("\n".join([*lines, ".end", ""]))


def _names(module: Mapping[str, Mapping]) -> Iterator[tuple[str, Bit]]:
    """Yield each public name of a bit, with the bit."""
    for name, net in module["netnames"].items():
        if not net.get("hide_name"):
            for place, bit in enumerate(net["bits"], net.get("offset", 0)):
                yield f"{name}[{place}]", bit


def _aliases(path: Path) -> dict[str, list[str]]:
    """Return all names of each bit by name, from the netlist with every name."""
    groups: dict[Bit, list[str]] = {}
    for module in json.loads(path.read_text())["modules"].values():
        if not int(module["attributes"].get("blackbox", "0"), 2):
            for name, bit in _names(module):
                groups.setdefault(bit, []).append(name)
    return {name: names for bit, names in groups.items() if isinstance(bit, int) for name in names}


def compare(gold: Path, gate: Path, aliases: Path, directory: Path) -> Proof:
    """Prove two JSON netlists of $_AND_, $_NOT_ and cut_state equal, with networks and ABC's log in
    `directory`; SimulatorError if the ports differ or ABC failed.

    `aliases` is a JSON with further names of the gate side's state bits, from mapping.
    """
    left, right = _Side(gold), _Side(gate)
    odd = (left.inputs.keys() ^ right.inputs.keys()) | (left.outputs.keys() ^ right.outputs.keys())
    if odd:
        raise SimulatorError(f"the ports of the netlist differ from those of the Verilog: {min(odd)}", gate)
    further = _aliases(aliases)
    for place, name in enumerate(sorted(left.inputs)):
        left.nets[left.inputs[name]] = right.nets[right.inputs[name]] = f"in{place}"
    right.nets |= {q: f"q{q}" for q in right.states}

    names: dict[Bit, list[str]] = {}
    for name, bit in left.names.items():
        names.setdefault(bit, []).append(name)
    partners: dict[Bit, Bit | None] = {}
    for q in left.states:
        candidates = [right.names.get(n) for name in names.get(q, []) for n in (name, *further.get(name, ()))]
        partners[q] = next((bit for bit in candidates if bit in ("0", "1") or bit in right.states), None)
        # The name of the partner's bit, const0 or const1, or a name of its own.
        left.nets[q] = f"free{q}" if partners[q] is None else right.net(partners[q])

    mine, theirs = (
        {f"out{k}": side.net(side.outputs[name]) for k, name in enumerate(sorted(left.outputs))}
        for side in (left, right)
    )
    for q, partner in partners.items():
        if partner is None:
            continue
        constant = {"0": ("up", "set"), "1": ("down", "clear")}.get(str(partner))
        for pin in constant or ("up", "down", "clock", "set", "clear"):
            mine[f"s{q}.{pin}"] = left.net(left.states[q][pin][0])
            theirs[f"s{q}.{pin}"] = "const0" if constant else right.net(right.states[partner][pin][0])
    inputs = [f"in{place}" for place in range(len(left.inputs))] + [f"q{q}" for q in right.states]
    inputs += [f"free{q}" for q, partner in partners.items() if partner is None]
    left.write(directory / "gold.blif", inputs, mine)
    right.write(directory / "gate.blif", inputs, theirs)
    unpaired, log = list(partners.values()).count(None), directory / "cec.log"
    log.unlink(missing_ok=True)
    # AIGER keeps the order of inputs and outputs, which is equal on both sides, and has no names.
    # `&cec` takes 2 s where `cec` was not done in 10 minutes: 16x16 in sky130.
    for name in ("gold", "gate"):
        (directory / f"{name}.aig").unlink(missing_ok=True)
    # Run where the files are: ABC takes no path with a space.
    steps = [f"read_blif {name}.blif; strash; write_aiger {name}.aig" for name in ("gold", "gate")]
    steps.append(f"&cec -C 100000 -T {int(PROOF_LIMIT_S)} gold.aig gate.aig")
    run_logged([tool("berkeley-abc"), "-q", "; ".join(steps)], directory, log, PROOF_LIMIT_S + 60.0, "ABC")
    said = log.read_text(errors="replace")
    proved = False if "NOT EQUIVALENT" in said else True if "Networks are equivalent" in said else None
    told = re.sub(r"\s+", " ", said).strip()[-300:]
    return Proof(proved, len(partners) - unpaired, unpaired, len(mine), told)


def prove(netlist: Netlist, parameters: Mapping[str, int], directory: Path, *, top: str = TOP) -> Proof:
    """Prove a flat netlist equal to its Verilog; arguments as for mapping. SimulatorError if Yosys or ABC failed."""
    directory.mkdir(parents=True, exist_ok=True)
    read = read_verilog(sources=for_cells(rtl_sources(), None))
    verilog = [read, *elaborate(parameters, top), "flatten", "opt_clean", *WORDS_TO_FLOPS]
    mapped = [
        f"read_liberty -ignore_miss_func {netlist.technology.typical}",
        *(f"read_verilog -overwrite {model}" for model in netlist.technology.functions()),
        f"read_verilog {netlist.verilog}",
        *(f"hierarchy -check -top {top}", "flatten", "proc", "opt_clean"),
    ]
    sides = {"gold": verilog, "gate": mapped}
    for name, script in sides.items():
        run_yosys([*script, *_CUT, f"write_json {directory / name}.json"], directory, name, PROOF_LIMIT_S)
    return compare(directory / "gold.json", directory / "gate.json", netlist.json, directory)
