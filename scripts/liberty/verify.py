# SPDX-License-Identifier: Apache-2.0
"""Compare a Liberty file with ngspice: measure entries of its tables again, and whole paths against
OpenSTA.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dermis.errors import SimulatorError
from dermis.processes.children import run_logged
from scripts.liberty import cells, measure
from scripts.liberty.cells import PREFIX
from scripts.liberty.measure import Bench, Corner, Limit, Points
from scripts.liberty.syntax import Group, Table

SAMPLES = ("nand2_1", "dfxtp_1")
# A table may cross zero; an error is relative to the value or to this, whichever is larger. A
# constraint comes from a bisection to 3 ps.
SMALLEST_NS = {"setup": 0.1, "delay": 0.02}
STA_LIMIT_S = 60.0


def timing(library: Group, name: str, pin: str, related: str, kind: str = "", sense: str = "") -> Group:
    """Return the timing group of a cell's pin from another; the first of a type and sense if
    given.
    """
    for group in library.one("cell", PREFIX + name).one("pin", pin).of("timing"):
        words = {key: value.strip('"') for key, value in group.attributes.items()}
        if (
            words["related_pin"] == related
            and words["timing_type"].startswith(kind)
            and words.get("timing_sense", "").startswith(sense)
        ):
            return group
    raise KeyError(f"{name} has no {kind} timing from {related} to {pin}")


def _picked(table: Table, rows: Sequence[int], columns: Sequence[int]) -> Table:
    return [[table[i][j] for j in columns] for i in rows]


def _largest(ours: Mapping[str, Table], group: Group, rows: Sequence[int], columns: Sequence[int]) -> float:
    smallest = SMALLEST_NS["setup" if group.attributes["timing_type"].startswith("setup") else "delay"]
    worst = 0.0
    for kind, table in ours.items():
        told = _picked(group.one(kind).table(), rows, columns)
        for line, line_told in zip(table, told, strict=True):
            for value, value_told in zip(line, line_told, strict=True):
                worst = max(worst, abs(value - value_told) / max(abs(value), smallest))
    return worst


def sample_error(library: Group, corner: Corner, name: str, directory: Path) -> float:
    """Return the largest relative error of a cell's entries at a few points measured again.

    A flop also has one setup time measured again.
    """
    bench = Bench(cells.cell(name), corner, directory)
    how, every = bench.cell.sequential, measure.points_of(bench.cell)
    rows, columns = (1, 2), (1, 3)
    points = Points(tuple(every.slews[i] for i in rows), tuple(every.loads[j] for j in columns))
    if how is None:
        ((output, function),) = bench.cell.functions.items()
        pin = bench.cell.inputs[0]
        side, same = next(cells.sensitised(function, bench.cell.inputs, pin))
        tables = measure.through(bench, pin, output, side, same, points)
        return _largest(tables, timing(library, name, output, pin), rows, columns)
    tables = measure.clocked(bench, points)
    worst = _largest(tables, timing(library, name, "Q", how.control), rows, columns)
    fast = measure.CONSTRAINT_SLEWS_NS[:1]
    setup = {"rise_constraint": measure.constraint(bench, Limit("setup", True), fast)}
    return max(worst, _largest(setup, timing(library, name, "D", how.control, "setup"), [0], [0]))


@dataclass(frozen=True)
class Step:
    """A cell of a path: its input pin and the values of the others."""

    name: str
    pin: str
    side: Mapping[str, bool]


_S = Step
PATHS: Mapping[str, tuple[Step, ...]] = {
    "inverters": tuple(_S("inv_1", "A", {}) for _ in range(12)),
    "mixed": (
        _S("inv_2", "A", {}),
        _S("nand2_1", "A", {"B": True}),
        _S("nor2_1", "B", {"A": False}),
        _S("a21oi_1", "A1", {"A2": True, "B1": False}),
        _S("buf_2", "A", {}),
        _S("nand3_1", "B", {"A": True, "C": True}),
        _S("o21ai_1", "B1", {"A1": True, "A2": False}),
        _S("nor3_1", "C", {"A": False, "B": False}),
        _S("and2_1", "A", {"B": True}),
        _S("or2_1", "B", {"A": False}),
        _S("nand4_1", "D", {"A": True, "B": True, "C": True}),
        _S("inv_1", "A", {}),
    ),
}
"""Chains from an input to an output."""
BETWEEN_FLOPS = PATHS["mixed"][:6]
FLOP = "dfrtp_1"
SLEW_NS = 0.1
LOAD_PF = 0.01


def _output(name: str) -> str:
    return next(iter(cells.cell(name).functions))


def _constant(value: bool) -> str:
    return f"1'b{int(value)}"


def _joined(steps: Sequence[Step], k: int, first: str, last: str) -> dict[str, str]:
    step = steps[k]
    return {
        step.pin: first if k == 0 else f"n{k}",
        _output(step.name): last if k == len(steps) - 1 else f"n{k + 1}",
    }


def _verilog(steps: Sequence[Step], first: str, last: str) -> list[str]:
    """Return the instances of a chain from net `first` to net `last`."""
    lines = []
    for k, step in enumerate(steps):
        nets = {
            step.pin: first if k == 0 else f"n{k}",
            _output(step.name): last if k == len(steps) - 1 else f"n{k + 1}",
        }
        nets |= {pin: _constant(value) for pin, value in step.side.items()}
        joined = ", ".join(f".{pin}({net})" for pin, net in nets.items())
        lines.append(f"  {PREFIX}{step.name} u{k} ({joined});")
    return lines


def _sta(library: Path, directory: Path, netlist: Sequence[str], commands: Sequence[str]) -> str:
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "path.v").write_text("\n".join(netlist) + "\n")
    script = [f"read_liberty {library}", "read_verilog path.v", "link_design path", *commands, "exit"]
    (directory / "path.tcl").write_text("\n".join(script) + "\n")
    log = directory / "sta.log"
    log.unlink(missing_ok=True)
    run_logged(["sta", "-no_splash", "-exit", "path.tcl"], directory, log, STA_LIMIT_S, "OpenSTA")
    said = log.read_text(errors="replace")
    if re.search(r"^(Error|Warning)", said, re.MULTILINE):
        raise SimulatorError("OpenSTA complained", log)
    return said


def _found(pattern: str, said: str, directory: Path) -> float:
    found = re.search(pattern, said, re.MULTILINE)
    if found is None:
        raise SimulatorError("OpenSTA reported no path", directory / "sta.log")
    return float(found[1])


def _chain(bench: Bench, steps: Sequence[Step], first: str, last: str) -> tuple[list[str], list[str]]:
    """Return the SPICE of a chain: subcircuits of its cells and instances."""
    lines, seen = [], {bench.cell.name}
    calls = []
    for k, step in enumerate(steps):
        ports, inside = measure.subcircuit(step.name)
        if step.name not in seen:
            seen.add(step.name)
            lines += [f".subckt {PREFIX}{step.name} {' '.join(ports)}", *inside, ".ends"]
        nets = {
            step.pin: first if k == 0 else f"n{k}",
            _output(step.name): last if k == len(steps) - 1 else f"n{k + 1}",
        }
        nets |= {pin: "vdd" if value else "0" for pin, value in step.side.items()}
        joined = " ".join(cells.SUPPLIES.get(p) or nets[p] for p in ports)
        calls.append(f"xstep{k} {joined} {PREFIX}{step.name}")
    return lines, calls


def _inverts(steps: Sequence[Step]) -> bool:
    odd = False
    for step in steps:
        function = cells.cell(step.name).functions[_output(step.name)]
        odd ^= cells.evaluate(function, {**step.side, step.pin: False})
    return odd


def chain_delays(
    library: Path, corner: Corner, label: str, directory: Path
) -> dict[str, tuple[float, float]]:
    """Return the delays in ns of a chain for a rising and a falling input: ngspice's and
    OpenSTA's.
    """
    steps = PATHS[label]
    netlist = ["module path (a, y);", "  input a;", "  output y;"]
    netlist += [f"  wire n{k + 1};" for k in range(len(steps) - 1)]
    netlist += [*_verilog(steps, "a", "y"), "endmodule"]
    commands = [
        "create_clock -name c -period 100",
        "set_input_delay 0 -clock c a",
        "set_output_delay 0 -clock c y",
    ]
    commands += [f"set_input_transition {SLEW_NS} a", f"set_load {LOAD_PF} y"]
    commands += [f"report_checks -{edge}_from a -digits 4" for edge in ("rise", "fall")]
    said = _sta(library, directory, netlist, commands).split("Startpoint:")[1:]
    told = [_found(r"([\d.]+)\s+data arrival time", part, directory) for part in said]

    bench = Bench(cells.cell(steps[0].name), corner, directory)
    lines, calls = _chain(bench, steps, "a", "y")
    start, wide = 1.0, 10.0 if corner.process == "ss" else 5.0
    same = not _inverts(steps)
    body = [*lines, bench.source("a", False, [(start, SLEW_NS), (start + wide, SLEW_NS)]), *calls]
    body += [f"cload y 0 {LOAD_PF}p"]
    for k, rises in enumerate((same, not same)):
        word = "rise" if rises else "fall"
        body.append(f".meas tran m{k} when v(y)={bench.half:g} td={start + k * wide:g}n {word}=1")
    values = bench.run(bench.deck(body, ["v(y)"], start + 2 * wide, 0.02), ["m0", "m1"])
    delays: dict[str, tuple[float, float]] = {}
    for k, edge in enumerate(("rise", "fall")):
        value = values[f"m{k}"]
        if value is None:
            raise SimulatorError(f"the output of path {label} does not change", bench.log)
        delays[edge] = (value * 1e9 - start - k * wide, told[k])
    return delays


def shortest_period(library: Path, corner: Corner, directory: Path) -> tuple[float, float]:
    """Return the shortest clock period in ns of two flops with gates between them: ngspice's, by
    bisection, and OpenSTA's.
    """
    steps = BETWEEN_FLOPS
    flop = f"{PREFIX}{FLOP}"
    netlist = ["module path (clk, d, q);", "  input clk, d;", "  output q;", "  wire launched, caught;"]
    netlist += [f"  wire n{k + 1};" for k in range(len(steps) - 1)]
    netlist += [f"  {flop} u_from (.CLK(clk), .D(d), .RESET_B(1'b1), .Q(launched));"]
    netlist += [f"  {flop} u_to (.CLK(clk), .D(caught), .RESET_B(1'b1), .Q(q));"]
    netlist += [*_verilog(steps, "launched", "caught"), "endmodule"]
    period = 20.0
    commands = [f"create_clock -name c -period {period} clk", f"set_input_transition {SLEW_NS} clk"]
    commands += [f"set_clock_transition {SLEW_NS} c", f"set_load {LOAD_PF} q"]
    commands += ["report_checks -rise_through u_from/Q -to u_to/D -digits 4"]
    told = period - _found(r"([\d.]+)\s+slack", _sta(library, directory, netlist, commands), directory)

    bench = Bench(cells.cell(FLOP), corner, directory)
    lines, calls = _chain(bench, steps, "launched", "caught")
    caught = not _inverts(steps)  # value for the second flop after a rise of the first
    first = 12.0
    low, high = 0.0, 2 * told
    for _ in range(10):
        middle = (low + high) / 2
        # Each flop has a clock, so that no other edge disturbs the two that count.
        body = [*lines, bench.source("d", False, [(8.0, 0.05)]), *calls]
        for name, time in (("early", first), ("late", first + middle)):
            body.append(bench.source(name, False, [(2.0, SLEW_NS), (6.0, SLEW_NS), (time, SLEW_NS)]))
        body += [bench.instance(0, {"CLK": "early", "D": "d", "RESET_B": "vdd", "Q": "launched"})]
        body += [bench.instance(1, {"CLK": "late", "D": "caught", "RESET_B": "vdd", "Q": "q"})]
        stop = first + middle + 4.0
        body += [f"cload q 0 {LOAD_PF}p", f".meas tran e find v(q) at={stop - 0.02:.6g}n"]
        end = bench.run(bench.deck(body, ["v(q)"], stop, 0.05, fine=False), ["e"])["e"]
        if end is None:
            raise SimulatorError("the second flop was not measured", bench.log)
        if (end > bench.half) == caught:
            high = middle
        else:
            low = middle
    return high, told


def path_errors(library: Path, corner: Corner, directory: Path) -> list[tuple[str, float, str]]:
    """Return the relative errors of OpenSTA with a library against ngspice: row name, error, and a
    note with both values.
    """
    found = {
        f"path_error.{corner.process}_{label}_{edge}": both
        for label in PATHS
        for edge, both in chain_delays(library, corner, label, directory).items()
    }
    found[f"period_error.{corner.process}"] = shortest_period(library, corner, directory)
    return [
        (name, (sta - spice) / spice, f"ngspice {spice:.4f} ns, OpenSTA {sta:.4f} ns")
        for name, (spice, sta) in found.items()
    ]
