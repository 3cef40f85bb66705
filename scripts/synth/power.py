# SPDX-License-Identifier: Apache-2.0
"""Power of the netlist from the activity of its nets: every net's charge, and that inside of flops and latches."""

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from dermis.errors import SimulatorError
from scripts import liberty
from scripts.synth.map import Netlist

_VARIABLE = re.compile(r"^\$var \w+ (\d+) (\S+) (\S+)")


def toggles(vcd: Path) -> tuple[dict[str, list[int]], float]:
    """Return how often each bit of each net changes, the lowest first, and the time in ns; from a VCD file."""
    names: dict[str, list[str]] = {}
    counts: dict[str, list[int]] = {}
    last: dict[str, str] = {}
    now, unit_ns = 0, 0.0
    with vcd.open() as lines:
        for line in lines:
            if found := _VARIABLE.match(line):
                names.setdefault(found[2], []).append(found[3].lstrip("\\"))
                counts[found[2]] = [0] * int(found[1])
            elif line[0] == "#":
                now = int(line[1:])
            elif line[0] in "01xzb":
                value, key = line.split() if line[0] == "b" else (line[0], line[1:].strip())
                bits = value.lstrip("b").rjust(len(counts[key]), "0")[::-1]
                for n, (a, b) in enumerate(zip(last.get(key, bits), bits, strict=True)):
                    counts[key][n] += a != b and a + b in ("01", "10")
                last[key] = bits
            elif scale := re.match(r"^\s*(\d+)(ps|ns)\s*$", line):
                unit_ns = int(scale[1]) * {"ps": 1e-3, "ns": 1.0}[scale[2]]
    if not now or not unit_ns:
        raise SimulatorError("the simulator wrote no changes of nets", vcd)
    return {name: counts[key] for key, all_ in names.items() for name in all_}, now * unit_ns


def power_uw(
    netlist: Netlist,
    v_dd: float,
    counts: Mapping[str, list[int]],
    time_ns: float,
    inside_fj: Callable[[str, str], float],
) -> dict[str, float]:
    """Return the power in uW of clock, other nets and inside of flops and latches.

    Half of C V^2 leaves the supply for each change of a net: the inputs on it and the stated capacitance of its wire.
    `inside_fj` is the energy inside of a cell for a change of its clock or gate. Short circuits in gates, leakage
    and the buffers of the clock tree are left out.
    """
    technology = netlist.technology
    modules = json.loads(netlist.json.read_text())["modules"].values()
    top = next(module for module in modules if module["attributes"].get("top"))
    pins = {
        group.name: {pin.name: float(pin.attributes.get("capacitance", 0.0)) * 1e3 for pin in group.of("pin")}
        for group in liberty.read(technology.typical).of("cell")
    }
    changes: dict[int, int] = {}
    for name, net in top["netnames"].items():
        for bit, count in zip(net["bits"], counts.get(name, []), strict=False):
            changes[bit] = max(count, changes.get(bit, 0))
    load: Counter[int] = Counter()
    inside = 0.0
    for cell in top["cells"].values():
        for pin, bits in cell["connections"].items():
            if cell["port_directions"].get(pin, "input") == "output" or not isinstance(bits[0], int):
                continue
            load[bits[0]] += pins[cell["type"]].get(pin, 0.0) + technology.wire_ff_per_sink
            if pin in ("CLK", "CLK_N", "GATE_N"):
                inside += changes.get(bits[0], 0) * inside_fj(cell["type"], pin)
    clock = top["netnames"]["clk_i"]["bits"][0]
    energy = {bit: changes.get(bit, 0) * 0.5 * ff * v_dd**2 for bit, ff in load.items()}
    found = {"clock": energy[clock], "nets": sum(energy.values()) - energy[clock], "cells": inside}
    return {name: fj / time_ns for name, fj in found.items()}
