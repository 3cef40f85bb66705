# SPDX-License-Identifier: Apache-2.0
"""Equivalence of a mapped netlist and the Verilog: every state bit and output, for all inputs and
states.

Both sides become combinational networks: each flop, latch and memory word is cut, its output an
input of the network, and its data, clock with edge, set and clear become outputs. ABC then proves
the networks equal, output by output. With equal reset states this is an induction over time.
Another clock, edge or reset is a difference. State bits are paired by name. If optimisation merged
bits, both names are compared with the remaining bit; a bit that it replaced by a constant is
compared as that constant. A bit without a partner is free, so the proof holds for both its values.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dermis.errors import SimulatorError
from dermis.processes.children import run_logged
from dermis.scene.design import ROOT
from scripts.synth.cells import Technology
from scripts.synth.map import TOP, WORDS_TO_FLOPS, elaborate, read_rtl, run_yosys, tool

PROOF_LIMIT_S = 900.0
_TO_GATES = ["techmap", "opt_clean", "dffunmap", "aigmap", "opt_clean"]

Bit = int | str


@dataclass(frozen=True)
class Proof:
    """Outcome of a proof: `proved` is None if ABC did not finish.

    Parameters
    ----------
    proved : True equal, False a difference was found, None not decided
    state_bits : flops and latches compared
    unpaired : state bits of the Verilog that the netlist does not have, left free
    outputs : outputs of the networks compared
    said : output of ABC
    """

    proved: bool | None
    state_bits: int
    unpaired: int
    outputs: int
    said: str


@dataclass(frozen=True)
class _State:
    """A state element at a cut, with bits of the netlist; True is active high or rising edge."""

    kind: str  # "flop" or "latch"
    q: int
    d: Bit
    clock: Bit
    clock_high: bool
    set: tuple[Bit, bool] | None
    clear: tuple[Bit, bool] | None


def _state(kind: str, pins: Mapping[str, Sequence[Bit]]) -> _State | None:
    """Return the state element of a Yosys gate-level cell, None for logic."""

    def pin(name: str, high: bool) -> tuple[Bit, bool]:
        return pins[name][0], high

    if match := re.fullmatch(r"\$_DFF_([NP])_", kind):
        return _State("flop", int(pins["Q"][0]), pins["D"][0], pins["C"][0], match[1] == "P", None, None)
    if match := re.fullmatch(r"\$_DFF_([NP])([NP])([01])_", kind):
        reset = pin("R", match[2] == "P")
        to_set, to_clear = (reset, None) if match[3] == "1" else (None, reset)
        return _State(
            "flop", int(pins["Q"][0]), pins["D"][0], pins["C"][0], match[1] == "P", to_set, to_clear
        )
    if match := re.fullmatch(r"\$_DFFSR_([NP])([NP])([NP])_", kind):
        to_set, to_clear = pin("S", match[2] == "P"), pin("R", match[3] == "P")
        return _State(
            "flop", int(pins["Q"][0]), pins["D"][0], pins["C"][0], match[1] == "P", to_set, to_clear
        )
    if match := re.fullmatch(r"\$_DLATCH_([NP])_", kind):
        return _State("latch", int(pins["Q"][0]), pins["D"][0], pins["E"][0], match[1] == "P", None, None)
    if match := re.fullmatch(r"\$_DLATCH_([NP])([NP])([01])_", kind):
        reset = pin("R", match[2] == "P")
        to_set, to_clear = (reset, None) if match[3] == "1" else (None, reset)
        return _State(
            "latch", int(pins["Q"][0]), pins["D"][0], pins["E"][0], match[1] == "P", to_set, to_clear
        )
    return None


class _Side:
    """One of the two designs: its gates, its states by name, its ports."""

    def __init__(self, path: Path) -> None:
        modules = json.loads(path.read_text())["modules"]
        tops = [m for m in modules.values() if int(m["attributes"].get("top", "0"), 2)]
        if len(tops) != 1:
            raise SimulatorError(f"{len(tops)} top levels to compare", path)
        module = tops[0]
        self.gates: list[tuple[str, Mapping[str, Sequence[Bit]]]] = []
        self.states: list[_State] = []
        for cell in module["cells"].values():
            kind, pins = cell["type"], cell["connections"]
            if kind in ("$_AND_", "$_NOT_"):
                self.gates.append((kind, pins))
                continue
            state = _state(kind, pins)
            if state is None:
                raise SimulatorError(f"cannot compare a cell {kind}", path)
            self.states.append(state)
        self.inputs = self._ports(module, "input")
        self.outputs = self._ports(module, "output")
        self.names: dict[str, Bit] = {}
        for name, net in module["netnames"].items():
            if not net.get("hide_name"):
                first = net.get("offset", 0)
                for place, bit in enumerate(net["bits"]):
                    self.names[_flat(name, first + place)] = bit

    @staticmethod
    def _ports(module: Mapping[str, Any], direction: str) -> dict[str, Bit]:
        return {
            f"{name}[{place}]": bit
            for name, port in module["ports"].items()
            if port["direction"] == direction
            for place, bit in enumerate(port["bits"])
        }


def _flat(name: str, place: int) -> str:
    return f"{name}[{place}]"


class _Network:
    """Writes one side as BLIF, with states cut."""

    def __init__(self, side: _Side, free: str) -> None:
        self.side = side
        self.lines: list[str] = []
        self.free = free
        self.inputs: list[str] = []
        self.of_bit: dict[Bit, str] = {"0": "const0", "1": "const1", "x": "const0", "z": "const0"}
        self.lines += [".names const0", ".names const1", "1"]
        self.number = 0

    def input(self, name: str, bit: Bit | None = None) -> str:
        self.inputs.append(name)
        if bit is not None:
            self.of_bit[bit] = name
        return name

    def net(self, bit: Bit) -> str:
        return self.of_bit.get(bit, f"n{bit}")

    def gate(self, function: str, *inputs: str) -> str:
        self.number += 1
        made = f"g{self.number}"
        self.name_gate(function, made, *inputs)
        return made

    def name_gate(self, function: str, made: str, *inputs: str) -> None:
        rows = {"and": ["11 1"], "not": ["0 1"], "buf": ["1 1"], "andn": ["10 1"]}[function]
        self.lines += [f".names {' '.join(inputs)} {made}", *rows]

    def level(self, pin: tuple[Bit, bool] | None) -> str:
        if pin is None:
            return "const0"
        bit, high = pin
        return self.net(bit) if high else self.gate("not", self.net(bit))

    def drive(self, key: str, state: _State | None, constant: str) -> list[str]:
        """Return outputs that describe a state bit completely; a constant is a bit that never
        changes.
        """
        outputs = [f"{key}.{part}" for part in ("data", "clock", "set", "clear")]
        if state is None:
            for name in outputs:
                self.name_gate("buf", name, constant)
            return outputs
        set_, clear = self.level(state.set), self.level(state.clear)
        clock = self.level((state.clock, state.clock_high))
        data = self.net(state.d)
        # Set and clear win: with either on, the data do not matter, and a set under a clear does
        # not either.
        calm = self.gate("andn", self.gate("not", set_), clear)
        real_set = self.gate("andn", set_, clear)
        if state.kind == "latch":
            # An opened latch with data is a set or a clear: whether a library's latch has its reset
            # inside or in front of it is then the same.
            opened = self.gate("and", clock, calm)
            up = self.gate("and", opened, data)
            down = self.gate("andn", opened, data)
            self.name_gate("buf", outputs[0], "const0")
            self.name_gate("buf", outputs[1], "const0")
            self._either(outputs[2], real_set, up)
            self._either(outputs[3], clear, down)
            return outputs
        self.name_gate("and", outputs[0], data, calm)
        self.name_gate("buf", outputs[1], clock)
        self.name_gate("buf", outputs[2], real_set)
        self.name_gate("buf", outputs[3], clear)
        return outputs

    def _either(self, made: str, first: str, second: str) -> None:
        self.lines += [f".names {first} {second} {made}", "1- 1", "-1 1"]

    def write(self, path: Path, outputs: Sequence[str], inputs: Sequence[str]) -> None:
        body: list[str] = []
        for kind, pins in self.side.gates:
            made = f"n{pins['Y'][0]}"
            if kind == "$_AND_":
                body += [f".names {self.net(pins['A'][0])} {self.net(pins['B'][0])} {made}", "11 1"]
            else:
                body += [f".names {self.net(pins['A'][0])} {made}", "0 1"]
        head = [".model design", f".inputs {' '.join(inputs)}", f".outputs {' '.join(outputs)}"]
        path.write_text("\n".join([*head, *self.lines, *body, ".end", ""]))


def compare(gold: Path, gate: Path, aliases: Path | None, directory: Path, limit_s: float) -> Proof:
    """Prove two gate-level JSON netlists equal.

    Parameters
    ----------
    gold, gate : netlists of $_AND_, $_NOT_, flops and latches
    aliases : JSON with further names of the gate side's state bits, from mapping
    directory : directory for the networks and ABC's log

    Raises
    ------
    SimulatorError
        The ports differ, or ABC failed.
    """
    left, right = _Side(gold), _Side(gate)
    if left.inputs.keys() != right.inputs.keys() or left.outputs.keys() != right.outputs.keys():
        odd = sorted(
            (left.inputs.keys() ^ right.inputs.keys()) | (left.outputs.keys() ^ right.outputs.keys())
        )
        raise SimulatorError(f"the ports of the netlist differ from those of the Verilog: {odd[0]}", gate)
    same_name = _aliases(aliases) if aliases is not None else {}

    by_bit = {state.q: state for state in right.states}
    by_gold_bit: dict[Bit, list[str]] = {}
    for name, bit in left.names.items():
        by_gold_bit.setdefault(bit, []).append(name)
    a, b = _Network(left, "gold"), _Network(right, "gate")
    inputs: list[str] = []
    for place, (name, bit) in enumerate(sorted(left.inputs.items())):
        key = f"in{place}"
        inputs.append(key)
        a.of_bit[bit] = key
        b.of_bit[right.inputs[name]] = key

    pairs: list[tuple[str, _State, _State | None, str]] = []
    keys: dict[int, str] = {}
    unpaired = 0
    for place, state in enumerate(left.states):
        candidates = by_gold_bit.get(state.q, [])
        found: Bit | None = None
        for name in candidates:
            for other in (name, *same_name.get(name, ())):
                bit = right.names.get(other)
                if bit in ("0", "1") or (isinstance(bit, int) and bit in by_bit):
                    found = bit
                    break
            if found is not None:
                break
        if found is None:
            unpaired += 1
            inputs.append(f"free_gold{place}")
            a.of_bit[state.q] = f"free_gold{place}"
        elif isinstance(found, str):
            a.of_bit[state.q] = f"const{found}"
            pairs.append((f"s{place}", state, None, f"const{found}"))
        else:
            if found not in keys:
                keys[found] = f"q{found}"
                inputs.append(f"q{found}")
                b.of_bit[found] = f"q{found}"
            a.of_bit[state.q] = keys[found]
            pairs.append((f"s{place}", state, by_bit[found], ""))
    for state in right.states:
        if state.q not in keys:
            inputs.append(f"free_gate{state.q}")
            b.of_bit[state.q] = f"free_gate{state.q}"

    outputs: list[str] = []
    for key, mine, theirs, constant in pairs:
        if theirs is None:
            outputs += _stays(a, b, key, mine, constant)
        else:
            outputs += a.drive(key, mine, constant)
            b.drive(key, theirs, constant)
    for place, name in enumerate(sorted(left.outputs)):
        outputs.append(f"out{place}")
        a.name_gate("buf", f"out{place}", a.net(left.outputs[name]))
        b.name_gate("buf", f"out{place}", b.net(right.outputs[name]))
    a.write(directory / "gold.blif", outputs, inputs)
    b.write(directory / "gate.blif", outputs, inputs)
    return _prove(directory, len(pairs), unpaired, len(outputs), limit_s)


def _stays(a: _Network, b: _Network, key: str, state: _State, constant: str) -> list[str]:
    """Return outputs that are 0 if a state bit of the Verilog never leaves its constant in the
    netlist.
    """
    high = constant == "const1"
    set_, clear = a.level(state.set), a.level(state.clear)
    data = a.net(state.d)
    calm = a.gate("andn", a.gate("not", set_), clear)
    leaves = a.gate("and", calm, a.gate("not", data) if high else data)
    wrong = clear if high else a.gate("andn", set_, clear)
    for network, signals in ((a, (leaves, wrong)), (b, ("const0", "const0"))):
        for part, signal in zip(("leaves", "forced"), signals, strict=True):
            network.name_gate("buf", f"{key}.{part}", signal)
    return [f"{key}.leaves", f"{key}.forced"]


def _aliases(path: Path) -> dict[str, tuple[str, ...]]:
    """Return all names of each net, from the netlist with every name."""
    modules = json.loads(path.read_text())["modules"]
    groups: dict[int, list[str]] = {}
    for module in modules.values():
        if int(module["attributes"].get("blackbox", "0"), 2):
            continue
        for name, net in module["netnames"].items():
            if net.get("hide_name"):
                continue
            for place, bit in enumerate(net["bits"]):
                groups.setdefault(bit, []).append(_flat(name, net.get("offset", 0) + place))
    made: dict[str, tuple[str, ...]] = {}
    for bit, names in groups.items():
        if isinstance(bit, int) and len(names) > 1:
            made.update((name, tuple(names)) for name in names)
    return made


def _prove(directory: Path, states: int, unpaired: int, outputs: int, limit_s: float) -> Proof:
    log = directory / "cec.log"
    log.unlink(missing_ok=True)
    # AIGER keeps the order of inputs and outputs, which is equal on both sides, and has no names.
    # `&cec` takes 2 s where `cec` was not done in 10 minutes: 16x16 in sky130.
    made = [directory / name for name in ("gold", "gate")]
    steps = [f"read_blif {path}.blif; strash; write_aiger {path}.aig" for path in made]
    steps.append(f"&cec -C 100000 -T {int(limit_s)} {made[0]}.aig {made[1]}.aig")
    for path in made:
        path.with_suffix(".aig").unlink(missing_ok=True)
    run_logged([tool("berkeley-abc"), "-q", "; ".join(steps)], ROOT, log, limit_s + 60.0, "ABC")
    said = log.read_text(errors="replace")
    proved: bool | None = None
    if re.search(r"Networks are equivalent", said):
        proved = True
    if re.search(r"NOT EQUIVALENT", said):
        proved = False
    lines = [line for line in said.splitlines() if line.strip()]
    return Proof(proved, states, unpaired, outputs, " ".join(" ".join(lines).split())[-300:])


def prove(
    technology: Technology,
    parameters: Mapping[str, int],
    netlist: Path,
    aliases: Path | None,
    directory: Path,
    *,
    top: str = TOP,
    sources: Sequence[Path] | None = None,
    limit_s: float = PROOF_LIMIT_S,
) -> Proof:
    """Prove a Verilog netlist equal to the Verilog it was made from.

    Parameters
    ----------
    technology : library of the netlist; Liberty gives the functions of its cells
    parameters : of the top level
    netlist : flat Verilog
    aliases : JSON of the same netlist with all its names, None for none
    directory : directory for both sides and the logs
    top, sources : as for mapping

    Raises
    ------
    SimulatorError
        Yosys or ABC failed.
    """
    directory.mkdir(parents=True, exist_ok=True)
    gold, gate = directory / "gold.json", directory / "gate.json"
    script = [
        read_rtl(None, sources),
        *elaborate(parameters, top),
        "flatten",
        "opt_clean",
        *WORDS_TO_FLOPS,
        *_TO_GATES,
        f"write_json {gold}",
    ]
    run_yosys(script, directory, "gold", limit_s)
    script = [
        f"read_liberty -ignore_miss_func {technology.liberty(technology.corners[0])}",
        *(f"read_verilog -overwrite {model}" for model in technology.functions()),
        f"read_verilog {netlist}",
        f"hierarchy -check -top {top}",
        "flatten",
        "proc",
        "opt_clean",
        *_TO_GATES,
        f"write_json {gate}",
    ]
    run_yosys(script, directory, "gate", limit_s)
    return compare(gold, gate, aliases, directory, limit_s)
