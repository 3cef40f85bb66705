# SPDX-License-Identifier: Apache-2.0
"""Curves of `dermis sweep`: frequency against resistance from Verilog and ngspice, and both laws."""

import math
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from dermis import effects, engines, plan
from dermis.array import array
from dermis.chip import netlist, spice_batch
from dermis.converter import vfc
from dermis.engines import batch, cosim, event
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.ndarrays import Bools, Floats
from dermis.records import Plan
from dermis.report import comparison, verdict
from dermis.scene.design import ROOT, Design, exact
from dermis.scene.design import load as load_design
from scripts import cosims, judged
from scripts.characterise import runs
from scripts.checkpoint import Checkpoint

Ints = NDArray[np.int64]

BENCH = ROOT / "spice" / "bench" / "vfc__tran.sp"
BENCH_LIMIT_S = 120

ROWS = COLS = 16
PHYSICAL_SHARE, PHYSICAL_POINTS_MIN = 4, 16
"""A quarter of the points, at least 16, are also read through physical blocks: one taxel at a time
takes sixteen times as long."""

LEFT_OFF = {
    "lateral": "needs a neighbour; a point of the sweep is a single taxel",
    "integrator_range": "never reached: up to x = 1/2 the charge stays within a packet",
    "trace": "depends on the position of a taxel, which a point of the sweep does not have",
    "line_capacitance": "the other rows float here and would keep their charge",
    "motion": "nothing moves",
    "return": "the other rows float here, so no current returns",
    "pad": "a series resistance like those of row_driver and column_input, which are in the sweep",
    **{e.name: "random; ngspice draws no numbers" for e in effects.EFFECTS.values() if e.random},
    **{n: "changes the resistance that is swept" for n in effects.EFFECTS if n.startswith("sensor_")},
}
"""Effects that the physical sweep leaves off, with reasons."""


def resistances(points: int, design: Design) -> Floats:
    """Return the resistances of a sweep in ohm, rising from r_min_ohm to r_max_ohm, 8 or more.

    They are the two ends; up to a quarter where x = c / gate_clocks, without rounding; an eighth at
    multiples of V_b / (k i0), where the two laws agree; an eighth within half of r_min_ohm above it,
    densest at its foot, where they differ most; the rest spread over the logarithm.
    """
    low, high = design.sensor.r_min_ohm, design.sensor.r_max_ohm
    unit, gate = design.resistance_full_scale_ohm / 2, design.timing.gate_clocks
    codes = np.arange(max(1, math.ceil(gate * unit / high)), math.floor(gate * unit / low) + 1)
    multiples = np.arange(math.ceil(low / unit), math.floor(high / unit) + 1)
    chosen = {low, high}
    chosen |= {gate * unit / float(c) for c in _spread(codes, points // 4)}
    chosen |= {float(n) * unit for n in _spread(multiples, points // 8)}
    chosen |= {low * (1 + float(e)) for e in np.geomspace(2e-4, 0.5, points // 8)}
    chosen = {r for r in chosen if low <= r <= high}
    # Any number of multiples of the golden ratio fills an interval evenly.
    step = 0
    while len(chosen) < points:
        step += 1
        chosen.add(float(low * (high / low) ** (step * 0.5 * (5**0.5 - 1) % 1.0)))
    return np.array(sorted(chosen))


def _spread(values: Ints, most: int) -> Ints:
    """Return at most `most` of rising whole numbers, evenly over their logarithm, with both ends."""
    wanted = np.round(np.geomspace(values[0], values[-1], max(most, 2))).astype(np.int64)
    return np.unique(np.clip(wanted, values[0], values[-1]))


def in_frames(resistance_ohm: Floats, rows: int, cols: int) -> Floats:
    """Arrange resistances as frames [frames, rows + 1, cols], row by row; the rest is open.

    The last row of every frame is open: the packets of a row's last decisions fall into the next
    slot, and that slot must be recorded.
    """
    rows = min(rows, math.ceil(resistance_ohm.size / cols))
    frames = math.ceil(resistance_ohm.size / (rows * cols))
    laid = np.full((frames, rows * cols), np.inf)
    laid.flat[: resistance_ohm.size] = resistance_ohm
    return np.pad(laid.reshape(frames, rows, cols), ((0, 0), (0, 1), (0, 0)), constant_values=np.inf)


def out_of_frames(values: NDArray[Any], points: int) -> NDArray[Any]:
    """Undo `in_frames` for anything [frames, rows + 1, cols]."""
    return values[:, :-1].ravel()[:points]


def physical_effects(topology: str, design: Design) -> dict[str, Any]:
    """Return the [effects] of a taxel with physical blocks: all with a default, except LEFT_OFF."""
    named: dict[str, Any] = {
        e.name: True for e in effects.EFFECTS.values() if topology in e.topologies and e.name not in LEFT_OFF
    }
    # Unread rows float, so that each point is alone on its column.
    named["row_driver"] = {"r_ohm": design.row_driver.r_on_ohm, "grounded_r_ohm": math.inf}
    if topology == "direct":
        del named["column_input"]  # no block between column and integrator, so no default
    return named


def make_plan(
    folder: Path,
    topology: str,
    laid_ohm: Floats,
    named: dict[str, Any],
    title: str,
    views: str = "behavioural",
) -> Plan:
    """Write a scene and its resistances, so that `dermis run` can repeat it, and plan it."""
    name = f"{topology}{'_physical' if named else ''}"
    lines = [",".join(repr(float(r)) for r in row) for frame in laid_ohm for row in frame]
    write_atomic(folder / f"{name}.csv", "\n".join(lines) + "\n")
    scene = {
        "title": title,
        "array": {"rows": laid_ohm.shape[1], "cols": laid_ohm.shape[2]},
        "stimulus": {"kind": "resistance", "file": f"{name}.csv"},
        "interface": {"topology": topology},
        "effects": named,
        "run": {"engine": "cosim", "views": views},
    }
    write_atomic(folder / f"{name}.toml", tomli_w.dumps(scene))
    made = plan.load(folder / f"{name}.toml")
    engines.check(made)
    return made


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurements at some resistances, all arrays [points]."""

    pulses: Ints  # closings of the charge switch for decisions of the gate
    code: Ints  # of the chip
    period_clocks: Floats  # mean pulse spacing, from the first and last pulse; NaN below two
    line_clocks: Floats  # the same as the slope of a straight line through the times of all


def read(made: Plan, points: int, on_slots: Callable[[int], None], work: Path) -> Reading:
    """Read a plan through Verilog and ngspice in lock-step; find the pulses in the trace.

    `work` goes after a successful run, which can be repeated from its scene.
    """
    result = cosim.run(made, on_slots, record=True, work=work)
    timing, charge = made.timing, []
    # Between two frames there are clocks without a row, which belong to neither.
    length = made.rows * timing.slot_clocks - timing.break_clocks
    for record in result.info["records"]:
        words = np.array(record["trace"]["charge"], dtype=object)
        bits = np.array([words >> c & 1 for c in range(made.cols)], dtype=bool).T
        frames = len(record["codes"]) // made.rows
        charge += [bits[begin : begin + length] for begin in record["trace"]["begins"][:frames]]
    pulses, period, line = find_pulses(np.stack(charge), made)
    codes = result.codes.astype(np.int64)
    shutil.rmtree(work)
    return Reading(*(out_of_frames(values, points) for values in (pulses, codes, period, line)))


def find_pulses(charge: Bools, made: Plan) -> tuple[Ints, Floats, Floats]:
    """Return count and spacing in clocks (as in `Reading`) of the pulses in the gate of every row
    slot, [frames, rows, cols], from the charge switches [frames, clocks, cols].

    The last row is not measured, 0 and NaN: see `in_frames`.
    """
    timing = made.timing
    shape = (charge.shape[0], made.rows, made.cols)
    count, period, line = np.zeros(shape, np.int64), np.full(shape, np.nan), np.full(shape, np.nan)
    rises = charge.copy()
    rises[:, 1:] &= ~charge[:, :-1]
    for frame, row, column in np.ndindex(shape[0], made.rows - 1, made.cols):
        # The switch follows the second flip-flop, one clock after the decision; entry 0 is the
        # clock after the first driven row, which comes with the end of the break.
        first = row * timing.slot_clocks + timing.settle_clocks - timing.break_clocks + 1
        gate = rises[frame, first : first + timing.gate_clocks, column]
        if gate.size != timing.gate_clocks:
            missing = timing.gate_clocks - gate.size
            raise SimulatorError(f"the trace ends {missing} clocks before row {row} does")
        at = np.flatnonzero(gate)
        count[frame, row, column] = at.size
        if at.size > 1:
            period[frame, row, column] = (at[-1] - at[0]) / (at.size - 1)
            line[frame, row, column] = np.polyfit(np.arange(at.size), at, 1)[0]
    return count, period, line


@dataclass(eq=False)
class Physical:
    """Some points through physical blocks with the answers of the models, arrays [points]."""

    made: Plan
    at: Ints  # indices of the points in the sweep
    reading: Reading

    def __post_init__(self) -> None:
        made, points = self.made, self.at.size
        currents = array.column_currents(made.network(0), made.conductance_s())
        # Duty by the array solve and the converter's gains.
        self.x = out_of_frames(made.converter.duty(currents) / (1.0 + made.converter.packet_error), points)
        try:
            self.event_code = out_of_frames(event.run(made).codes.astype(np.int64), points)
        except InputError:
            self.event_code = None  # engine event refuses the plan


@dataclass(eq=False)
class Curve:
    """One interface over the sweep with the two laws, arrays [points] by rising resistance."""

    made: Plan
    resistance_ohm: Floats
    ideal: Reading  # through ideal blocks
    physical: Physical | None = None

    def __post_init__(self) -> None:
        interface, timing = self.made.scene.table.interface, self.made.timing
        points = self.resistance_ohm.size
        unit = exact(interface.v_bias_v) / (interface.k * exact(interface.i0_a))
        self.topology, self.f_clk_hz = self.made.topology, timing.f_clk_hz
        self.gate, self.code_max = timing.gate_clocks, timing.code_max
        self.x = out_of_frames(self.made.duty_ideal(), points)  # duty, V_b / (k i0 R)
        # x is c / gate, so there is no rounding.
        self.on_code = out_of_frames(comparison.on_code(self.made), points)
        exactly = [vfc.count_rational(unit / Fraction(float(r)), self.gate) for r in self.resistance_ohm]
        self.pulses_charge_balance = np.array(exactly, dtype=np.int64)
        self.pulses_eq3 = vfc.count_restarting(self.x, self.gate)
        clocks = 1 << 40  # long enough to make the rounding of the count negligible in the period
        self.period_eq3_clocks = np.round(clocks / vfc.count_restarting(self.x, clocks))


def judge(curve: Curve) -> list[verdict.Row]:
    ideal, on_code, gate = curve.ideal, curve.on_code, curve.gate

    def key(name: str) -> str:
        return f"sweep.{name}.{curve.topology}"

    error = np.abs(ideal.pulses - curve.pulses_charge_balance)
    note = f"{np.count_nonzero(error)} of {error.size} resistances differ"
    if error.any():
        # At a rounding step the exact answer is a half: a point this near may fall on either side.
        steps = gate * curve.x[error > 0] + 0.5
        note += f", each within {np.abs(steps - np.round(steps)).max():.2g} of a rounding step"
    rate = verdict.judge(key("rate_error_lsb"), int(error.max()), note)
    if miscounted := int((ideal.code != np.minimum(ideal.pulses, curve.code_max)).sum()):
        rate = verdict.error(rate["name"], f"{miscounted} codes are not their pulses")
    exact_key = key("rate_error_exact_lsb")
    exact_rate = verdict.skip(exact_key, "no such resistance in the sweep")
    if on_code.any():
        note = f"{on_code.sum()} resistances where x = c/{gate}"
        exact_rate = verdict.judge(exact_key, int(error[on_code].max()), note)
    period = _largest(gate / ideal.period_clocks - gate * curve.x)
    *_, residual = straight_line(curve, ideal)
    said = "f from all pulse times: residual of a straight line of 1/R"
    reports = [
        ("period_error_lsb", period, "lsb", f"f from first and last pulse, in counts of {gate} clocks"),
        ("frequency_linearity_lsb", residual, "lsb", said),
    ]
    last: list[verdict.Row] = []
    if (some := curve.physical) is not None:
        gain, offset, residual = straight_line(curve, some.reading, some.at)
        line = "straight line of f against 1/R"
        shift = _largest(gate / some.reading.line_clocks - gate * curve.x[some.at])
        taxels = f"physical blocks, {some.at.size} resistances, one taxel at a time"
        reports += [
            ("physical_shift_lsb", shift, "lsb", taxels),
            ("physical_gain_error_percent", 100 * (gain - 1), "%", line),
            ("physical_offset_lsb", offset, "lsb", line),
            ("physical_linearity_lsb", residual, "lsb", f"residual of the {line}"),
        ]
        name = key("physical_event_difference_lsb")
        if some.event_code is None:
            last = [verdict.skip(name, "engine event refuses this interface with these effects", "lsb")]
        else:
            worst = int(np.abs(some.reading.code - some.event_code).max())
            last = [verdict.report(name, worst, "lsb", "ngspice and Verilog against the event engine")]
    return [rate, exact_rate, *(verdict.report(key(name), *told) for name, *told in reports), *last]


def _largest(values: Floats) -> float:
    """Return the largest size of the values that are numbers."""
    return float(np.abs(values[np.isfinite(values)]).max(initial=-math.inf))


def straight_line(curve: Curve, reading: Reading, at: Ints | None = None) -> tuple[float, float, float]:
    """Fit gate f / f_clk = gain (gate x) + offset; return gain, offset and largest residual, NaN below three points."""
    x = curve.gate * (curve.x if at is None else curve.x[at])
    counts = curve.gate / reading.line_clocks
    good = np.isfinite(counts)
    if np.unique(x[good]).size < 3:
        return math.nan, math.nan, math.nan
    gain, offset = np.polyfit(x[good], counts[good], 1)
    return float(gain), float(offset), float(np.abs(counts - gain * x - offset)[good].max())


def unlimited(reading: Reading) -> Reading:
    """Return the readings without those at f_clk/2, where the synchronizer limits the rate."""
    return replace(reading, line_clocks=np.where(reading.line_clocks > 2.0, reading.line_clocks, np.nan))


def judge_laws(curves: Sequence[Curve]) -> verdict.Row:
    """Judge the separation of the two laws by the interface with the smallest one."""
    name = "sweep.eq3_difference_lsb"
    if not curves:
        return verdict.error(name, "no interface was read")
    found = []
    for curve in curves:
        gap = np.abs(curve.ideal.pulses - curve.pulses_eq3)
        found.append((int(gap.max()), curve.topology, float(curve.resistance_ohm[np.argmax(gap)])))
    gap, topology, ohm = min(found)
    note = f"pulses read less eq. (3) in one gate: {gap}, {topology} at {ohm:.6g} ohm"
    return verdict.judge(name, gap * 255 / load_design().timing.code_max, note)


def plain_ngspice(work: Path) -> list[verdict.Row]:
    """Run a peer without Verilog: a batch transient of ngspice with an XSPICE flip-flop."""
    name, rate = "sweep.plain_ngspice_pulses_510", "sweep.rate_error_lsb.plain_ngspice"
    # A copy, because the runner writes next to the deck, and `.include` is relative to it.
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(ROOT / "spice", work)
    try:
        text = BENCH.read_text()
        given = (re.findall(rf"^\.param {name} = (\d+)$", text, re.M)[0] for name in ("r_taxel", "n_clocks"))
        ohm, clocks = map(int, given)
        measured = spice_batch.run(Path(shutil.copy(BENCH, work / "bench")), BENCH_LIMIT_S)
        pulses = measured.values["pulses"]
    except (IndexError, KeyError, SimulatorError) as error:
        return [verdict.error(name, str(error), "pulses"), verdict.error(rate, str(error))]
    design = load_design()
    balance = vfc.count_rational(exact(design.resistance_full_scale_ohm) / 2 / ohm, clocks)
    eq3 = int(vfc.count_restarting(design.duty(ohm), clocks))
    laws = f"{ohm} ohm, {clocks} clocks: charge balance {balance}, eq. (3) {eq3}"
    cut = f"measured {pulses:.6g}, the last pulse cut off by the end"
    return [
        verdict.report(name, round(pulses), "pulses", f"{laws}; batch ngspice with its own flip-flop"),
        verdict.judge(rate, abs(pulses - balance), "; ".join([cut, *map(str, measured.retries)])),
    ]


def run(
    topologies: Sequence[str], points: int, out: Path, *, with_physical: bool = True
) -> tuple[list[Curve], list[verdict.Row], bool]:
    """Sweep some interfaces; `out` is for scenes, logs and the decks of a failed run.

    Returns the curves of the interfaces that were read, verdict rows, and whether a simulator failed.
    """
    design = load_design()
    ohm = resistances(points, design)
    some = min(points, max(PHYSICAL_POINTS_MIN, points // PHYSICAL_SHARE))
    at = np.round(np.linspace(0, points - 1, some)).astype(np.int64)
    ideal_ohm, alone = in_frames(ohm, ROWS, min(COLS, points)), in_frames(ohm[at], ROWS, 1)
    plans: dict[str, tuple[Plan, int]] = {}
    for topology in topologies:
        title, scenes = f"{points} resistances through {topology}", out / "scenes"
        plans[topology] = make_plan(scenes, topology, ideal_ohm, {}, title), points
        if with_physical:
            named = physical_effects(topology, design)
            made = make_plan(scenes, topology, alone, named, f"{title}, physical")
            plans[f"{topology}_physical"] = made, some
    shutil.rmtree(out / "work", ignore_errors=True)

    def one(name: str, on_slots: Callable[[int], None]) -> Reading:
        return read(*plans[name], on_slots, out / "work" / name)

    tasks = {name: (made.frames * made.rows, partial(one, name)) for name, (made, _) in plans.items()}
    readings = cosims.run("sweeping", tasks)
    curves: list[Curve] = []
    rows: list[verdict.Row] = []
    for topology in topologies:
        ideal, real = readings[topology], readings.get(f"{topology}_physical")
        if isinstance(ideal, SimulatorError):
            rows.append(verdict.error(f"sweep.rate_error_lsb.{topology}", str(ideal)))
            continue
        made = plans[f"{topology}_physical"][0] if isinstance(real, Reading) else None
        curves.append(Curve(plans[topology][0], ohm, ideal, made and Physical(made, at, real)))
        rows += judge(curves[-1])
        if isinstance(real, SimulatorError):
            rows.append(verdict.error(f"sweep.physical_shift_lsb.{topology}", str(real), "lsb"))
    failed = any(isinstance(reading, SimulatorError) for reading in readings.values())
    return curves, [*rows, judge_laws(curves), *plain_ngspice(out / "plain_ngspice")], failed


POINTS_TRANSISTORS = 8
"""A packet costs about 20 ms, so a point at 500 ohm takes as long as all others together."""


def run_transistors(
    topologies: Sequence[str], points: int, out: Path
) -> tuple[list[Curve], list[verdict.Row], bool]:
    """Sweep some interfaces in transistors (tt, 27 C); as `run`.

    Each resistance is a single taxel: one row, one column and one frame, which starts settled.
    Finished interfaces are kept; an interrupted run continues with the others.
    """
    ohm = resistances(points, load_design())
    laid, title = in_frames(ohm, 1, 1), f"{points} resistances in transistors"
    plans = {t: make_plan(out / "scenes", t, laid, {}, title, "sky130") for t in topologies}
    kept = Checkpoint(out / "kept.json", batch.fingerprint())

    def one(topology: str, on_slots: Callable[[int], None]) -> Reading:
        made = plans[topology]
        # The circuits, ngspice and its models, which the hash of the package leaves out.
        levels = [1.0] + [0.0] * (made.rows - 1) + [1.0] + [0.0] * made.cols
        decks = ("\n".join(netlist.frame_deck(made, f, levels).lines) for f in range(made.frames))
        name = f"{topology} {judged.digest((), *(runs.key(runs.resolved(deck)) for deck in decks))[:24]}"
        if name not in kept.pieces:
            reading = read(made, points, on_slots, out / "work" / topology)
            kept.put(name, {what: values.tolist() for what, values in vars(reading).items()})
        return Reading(**{what: np.array(values) for what, values in kept.pieces[name].items()})

    tasks = {topology: (made.frames * made.rows, partial(one, topology)) for topology, made in plans.items()}
    curves: list[Curve] = []
    rows: list[verdict.Row] = []
    for topology, reading in cosims.run("sweeping", tasks, at_once=1).items():
        if isinstance(reading, SimulatorError):
            rows.append(verdict.error(f"sweep.transistor_linearity_lsb.{topology}", str(reading), "lsb"))
        else:
            curves.append(Curve(plans[topology], ohm, reading))
            rows += judge_line(curves[-1])
    return curves, rows, len(curves) < len(plans)


def judge_line(curve: Curve) -> list[verdict.Row]:
    """Return the rows of one interface: gain, offset, and largest distance from a straight line."""
    name, reading = curve.topology, unlimited(curve.ideal)
    key, (gain, offset, residual) = f"sweep.transistor_linearity_lsb.{name}", straight_line(curve, reading)
    if math.isnan(residual):
        return [verdict.error(key, "fewer than three resistances have two pulses", "lsb")]
    below = np.isfinite(reading.line_clocks).sum()
    line = f"straight line of f against 1/R, {below} resistances below f_clk/2"
    return [
        verdict.report(f"sweep.transistor_gain_error_percent.{name}", 100.0 * (gain - 1.0), "%", line),
        verdict.report(f"sweep.transistor_offset_lsb.{name}", offset, "lsb", line),
        verdict.judge(key, residual, line),
    ]
