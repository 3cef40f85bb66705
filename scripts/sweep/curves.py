# SPDX-License-Identifier: Apache-2.0
"""Curves of `dermis sweep`: frequency against resistance from Verilog and ngspice, with both laws
of the converter.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dermis import effects, engines, plan
from dermis.array import array
from dermis.chip import spice_batch
from dermis.converter import vfc
from dermis.engines import cosim, event
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from dermis.records import Plan
from dermis.report import comparison, figures, progress, verdict
from dermis.report.verdict import Row
from dermis.scene.design import ROOT, Design, exact
from dermis.scene.design import load as load_design

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

OUT = ROOT / "build" / "sweep"
BENCH = ROOT / "spice" / "bench" / "vfc__tran.sp"
BENCH_LIMIT_S = 120

FILES = ("sweep.csv", "sweep_frequency.png", "sweep_code.png")

POINTS_MAX = 4096
ROWS = 16
COLS = 16
PHYSICAL_SHARE = 4
PHYSICAL_POINTS_MIN = 16
"""A quarter of the points, at least this number, are also read through physical blocks: one taxel
at a time takes sixteen times as long."""

LEFT_OFF = {
    "lateral": "needs a neighbour; a point of the sweep is a single taxel",
    "integrator_range": "never reached: up to x = 1/2 the charge stays within a packet",
    "trace": "depends on the position of a taxel, which a point of the sweep does not have",
    "line_capacitance": "the other rows float here and would keep their charge",
    "motion": "nothing moves",
    "return": "the other rows float here, so no current returns",
    "pad": "a series resistance like those of row_driver and column_input, which are in the sweep",
    **{e.name: "random; ngspice draws no numbers" for e in effects.EFFECTS.values() if e.random},
    **{
        name: "changes the resistance that is swept" for name in effects.EFFECTS if name.startswith("sensor_")
    },
}
"""Effects that the physical sweep leaves off, with reasons."""


# ---- resistances ---------------------------------------------------------------------------------------------


def resistances(points: int, design: Design) -> Floats:
    """Choose the resistances of a sweep, rising, from r_min_ohm to r_max_ohm.

    Parameters
    ----------
    points : int
        Number of resistances, 8 or more.
    design : Design

    Returns
    -------
    ndarray
        [points] in ohm: the two ends; up to a quarter where x = c / gate_clocks, without
        rounding; an eighth at multiples of V_b / (k i0), where the two laws agree; an eighth within half of
        r_min_ohm above it, densest at its foot, where they differ most; the rest spread over the logarithm.
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
    """Return at most `most` of some rising whole numbers, about evenly over their logarithm, ends
    included.
    """
    wanted = np.round(np.geomspace(values[0], values[-1], max(most, 2))).astype(np.int64)
    return np.unique(np.clip(wanted, values[0], values[-1]))


def in_frames(resistance_ohm: Floats, rows: int, cols: int) -> Floats:
    """Arrange resistances as frames [frames, rows + 1, cols], row by row; the rest is open.

    The last row of every frame is open: the packets of a row's last decisions fall into the next
    slot, and that slot must be recorded.
    """
    rows = min(rows, math.ceil(resistance_ohm.size / cols))
    frames = math.ceil(resistance_ohm.size / (rows * cols))
    laid = np.full((frames, rows + 1, cols), np.inf)
    full = np.full(frames * rows * cols, np.inf)
    full[: resistance_ohm.size] = resistance_ohm
    laid[:, :rows] = full.reshape(frames, rows, cols)
    return laid


def out_of_frames(values: NDArray[Any], points: int) -> NDArray[Any]:
    """Undo `in_frames` for anything [frames, rows + 1, cols]."""
    return values[:, :-1].ravel()[:points]


def physical_effects(topology: str, design: Design) -> dict[str, Any]:
    """Return the [effects] of a taxel with physical blocks: every effect with a default, except
    LEFT_OFF.
    """
    named: dict[str, Any] = {
        e.name: True for e in effects.EFFECTS.values() if topology in e.topologies and e.name not in LEFT_OFF
    }
    # Unread rows float, so that each point is alone on its column.
    named["row_driver"] = {"r_ohm": design.row_driver.r_on_ohm, "grounded_r_ohm": math.inf}
    if topology == "direct":
        del named["column_input"]  # no block between column and integrator, so no default
    return named


def make_plan(
    directory: Path,
    topology: str,
    laid_ohm: Floats,
    named: dict[str, Any],
    title: str,
    views: str = "behavioural",
) -> Plan:
    """Write a scene and its resistances into `directory`, so that `dermis run` can repeat it, and
    plan it.
    """
    name = f"{topology}{'_physical' if named else ''}"
    lines = [",".join(repr(float(r)) for r in row) for frame in laid_ohm for row in frame]
    write_atomic(directory / f"{name}.csv", "\n".join(lines) + "\n")
    scene = {
        "title": title,
        "array": {"rows": laid_ohm.shape[1], "cols": laid_ohm.shape[2]},
        "stimulus": {"kind": "resistance", "file": f"{name}.csv"},
        "interface": {"topology": topology},
        "effects": named,
        "run": {"engine": "cosim", "views": views},
    }
    write_atomic(directory / f"{name}.toml", tomli_w.dumps(scene))
    made = plan.load(directory / f"{name}.toml")
    engines.check(made)
    return made


# ---- reading ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurements at some resistances, all arrays [points].

    Attributes
    ----------
    pulses : number of closings of the charge switch for decisions of the gate
    code : code of the chip
    period_clocks : mean pulse spacing, from the first and last pulse; NaN below two pulses
    line_clocks : the same as the slope of a straight line through the times of all pulses
    """

    pulses: Ints
    code: Ints
    period_clocks: Floats
    line_clocks: Floats


def read(made: Plan, points: int, on_slots: Callable[[int], None], work: Path) -> Reading:
    """Read a plan through the Verilog and ngspice in lock-step, and find the pulses in the recorded
    trace.
    """
    result = cosim.run(made, on_slots, record=True, work=work)
    charge = [frame for part in result.info["records"] for frame in charge_frames(part, made)]
    pulses, period, line = find_pulses(np.stack(charge), made)
    return Reading(
        out_of_frames(pulses, points),
        out_of_frames(result.codes.astype(np.int64), points),
        out_of_frames(period, points),
        out_of_frames(line, points),
    )


def charge_frames(record: dict[str, Any], made: Plan) -> list[NDArray[np.bool_]]:
    """Return the charge switches of a recorded process, one array [clocks, cols] per frame; entry n
    follows clock edge n + 1.
    """
    frames, timing = len(record["codes"]) // made.rows, made.timing
    words = [int(word, 16) for word in record["trace_charge"]]
    bits = np.array([[word >> c & 1 for c in range(made.cols)] for word in words], dtype=bool)
    # Between two frames there are clocks without a row, which belong to neither.
    begins = [round(float(record[f"wave{frame}_begin_s"]) * timing.f_clk_hz) for frame in range(frames)]
    length = made.rows * timing.slot_clocks - timing.break_clocks
    return [bits[begin : begin + length] for begin in begins]


def find_pulses(charge: NDArray[np.bool_], made: Plan) -> tuple[Ints, Floats, Floats]:
    """Count pulses and measure their spacing in the gate of every row slot.

    Parameters
    ----------
    charge : bool [frames, clocks, cols]
    made : Plan
        Its last row is not measured: see `in_frames`.

    Returns
    -------
    pulses, period_clocks, line_clocks : [frames, rows, cols], the last row 0 and NaN
    """
    timing = made.timing
    shape = (charge.shape[0], made.rows, made.cols)
    count, period, line = np.zeros(shape, np.int64), np.full(shape, np.nan), np.full(shape, np.nan)
    rises = charge.copy()
    rises[:, 1:] &= ~charge[:, :-1]
    for row in range(made.rows - 1):
        # The switch follows the second flip-flop, one clock after the decision; entry 0 is the
        # clock after the first driven row, which comes with the end of the break.
        first = row * timing.slot_clocks + timing.settle_clocks - timing.break_clocks + 1
        gate = rises[:, first : first + timing.gate_clocks]
        if gate.shape[1] != timing.gate_clocks:
            raise SimulatorError(
                f"the trace ends {timing.gate_clocks - gate.shape[1]} clocks before row {row} does"
            )
        for frame in range(shape[0]):
            for column in range(made.cols):
                at = np.flatnonzero(gate[frame, :, column])
                count[frame, row, column] = at.size
                if at.size > 1:
                    period[frame, row, column] = (at[-1] - at[0]) / (at.size - 1)
                    line[frame, row, column] = np.polyfit(np.arange(at.size), at, 1)[0]
    return count, period, line


# ---- comparison ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Curve:
    """One interface over the sweep, arrays [points] by rising resistance.

    Attributes
    ----------
    f_clk_hz, gate, code_max : clock, clocks of a gate, full-scale code
    x : duty, V_b / (k i0 R)
    on_code : x is c / gate, so there is no rounding
    pulses_charge_balance : exact count of charge balance
    pulses_eq3, period_eq3_clocks : the paper's eq. (3)
    ideal : through ideal blocks
    physical, physical_at : through physical blocks, and the indices of these points; None if not read
    physical_x : duty of `physical` by the array solve and the converter's gains
    event_code : codes of engine event for `physical`; None if it refuses the plan
    """

    topology: str
    f_clk_hz: float
    gate: int
    code_max: int
    resistance_ohm: Floats
    x: Floats
    on_code: NDArray[np.bool_]
    pulses_charge_balance: Ints
    pulses_eq3: Ints
    period_eq3_clocks: Floats
    ideal: Reading
    physical: Reading | None = None
    physical_at: Ints | None = None
    physical_x: Floats | None = None
    event_code: Ints | None = None


def make_curve(made: Plan, resistance_ohm: Floats, ideal: Reading, **physical: Any) -> Curve:
    """Return a reading with the two laws."""
    interface, gate = made.scene.table.interface, made.timing.gate_clocks
    unit = exact(interface.v_bias_v) / (interface.k * exact(interface.i0_a))
    points = resistance_ohm.size
    x = out_of_frames(made.duty_ideal(), points)
    balance = [vfc.count_rational(unit / Fraction(float(r)), gate) for r in resistance_ohm]
    clocks = 1 << 40  # long enough to make the rounding of the count negligible in the period
    return Curve(
        topology=made.topology,
        f_clk_hz=made.timing.f_clk_hz,
        gate=gate,
        code_max=made.timing.code_max,
        resistance_ohm=resistance_ohm,
        x=x,
        on_code=out_of_frames(comparison.on_code(made), points),
        pulses_charge_balance=np.array(balance, dtype=np.int64),
        pulses_eq3=vfc.count_restarting(x, gate),
        period_eq3_clocks=np.round(clocks / vfc.count_restarting(x, clocks)),
        ideal=ideal,
        **physical,
    )


def physical_duty(made: Plan, points: int) -> Floats:
    """Return packets per clock with the effects of a plan except leaks: array currents times
    converter gains.
    """
    currents = array.column_currents(made.network(0), made.conductance_s())
    return out_of_frames(made.converter.duty(currents) / (1.0 + made.converter.packet_error), points)


def event_codes(made: Plan, points: int) -> Ints | None:
    """Return the codes of the event engine, or None if it refuses the plan."""
    try:
        return out_of_frames(event.run(made).codes.astype(np.int64), points)
    except InputError:
        return None


# ---- verdicts ------------------------------------------------------------------------------------------------


def judge(curve: Curve) -> list[Row]:
    """Return the verdict rows of one interface."""
    name, ohm, ideal = curve.topology, curve.resistance_ohm, curve.ideal
    rows = []
    error = np.abs(ideal.pulses - curve.pulses_charge_balance)
    off = np.flatnonzero(error)
    # At a rounding step the exact answer is a half: a point this near may fall on either side.
    steps = curve.gate * curve.x[off] + 0.5
    near = np.abs(steps - np.round(steps))
    miscounted = int((ideal.code != np.minimum(ideal.pulses, curve.code_max)).sum())
    note = f"{off.size} of {ohm.size} resistances differ"
    if off.size:
        note += f", each within {near.max():.2g} of a rounding step"
    if miscounted:
        rows.append(verdict.error(f"sweep.rate_error_lsb.{name}", f"{miscounted} codes are not their pulses"))
    else:
        rows.append(verdict.judge(f"sweep.rate_error_lsb.{name}", int(error.max()), note))
    on_code = curve.on_code
    if on_code.any():
        note = f"{int(on_code.sum())} resistances where x = c/{curve.gate}"
        rows.append(verdict.judge(f"sweep.rate_error_exact_lsb.{name}", int(error[on_code].max()), note))
    else:
        rows.append(verdict.skip(f"sweep.rate_error_exact_lsb.{name}", "no such resistance in the sweep"))
    measured = np.isfinite(ideal.line_clocks)
    by_period = np.abs(curve.gate / ideal.period_clocks - curve.gate * curve.x)[measured]
    note = f"f from first and last pulse against charge balance, in counts of {curve.gate} clocks"
    rows.append(verdict.report(f"sweep.period_error_lsb.{name}", _largest(by_period), "lsb", note))
    fit = straight_line(curve, ideal)
    note = "f from all pulse times against 1/R: largest residual of a straight line"
    rows.append(verdict.report(f"sweep.frequency_linearity_lsb.{name}", fit and fit[2], "lsb", note))
    if curve.physical is not None and curve.physical_at is not None:
        rows += _judge_physical(curve, curve.physical, curve.physical_at)
    return rows


def _judge_physical(curve: Curve, reading: Reading, at: Ints) -> list[Row]:
    name = curve.topology
    fit = straight_line(curve, reading, at)
    shift = np.abs(curve.gate / reading.line_clocks - curve.gate * curve.x[at])
    note = f"physical blocks, {at.size} resistances, one taxel at a time"
    line = "straight line of f against 1/R"
    rows = [
        verdict.report(f"sweep.physical_shift_lsb.{name}", _largest(shift[np.isfinite(shift)]), "lsb", note),
        verdict.report(f"sweep.physical_gain_error_percent.{name}", fit and 100 * (fit[0] - 1), "%", line),
        verdict.report(f"sweep.physical_offset_lsb.{name}", fit and fit[1], "lsb", line),
        verdict.report(
            f"sweep.physical_linearity_lsb.{name}", fit and fit[2], "lsb", f"residual of the {line}"
        ),
    ]
    key = f"sweep.physical_event_difference_lsb.{name}"
    if curve.event_code is None:
        rows.append(verdict.skip(key, "engine event refuses this interface with these effects", "lsb"))
    else:
        worst = int(np.abs(reading.code - curve.event_code).max())
        rows.append(verdict.report(key, worst, "lsb", "ngspice and Verilog against the event engine"))
    return rows


def _largest(values: Floats) -> float | None:
    return float(values.max()) if values.size else None


def straight_line(
    curve: Curve, reading: Reading, at: Ints | None = None
) -> tuple[float, float, float] | None:
    """Fit gate f / f_clk = gain (gate x) + offset; return gain, offset and largest residual, or
    None below three.
    """
    x = curve.gate * (curve.x if at is None else curve.x[at])
    counts = curve.gate / reading.line_clocks
    good = np.isfinite(counts)
    if np.unique(x[good]).size < 3:
        return None
    gain, offset = np.polyfit(x[good], counts[good], 1)
    return float(gain), float(offset), float(np.abs(counts - gain * x - offset)[good].max())


def judge_laws(curves: Sequence[Curve]) -> Row:
    """Judge the separation of the two laws by the interface with the smallest one."""
    name = "sweep.eq3_difference_lsb"
    if not curves:
        return verdict.error(name, "no interface was read")
    found = []
    for curve in curves:
        gap = np.abs(curve.ideal.pulses - curve.pulses_eq3)
        found.append((int(gap.max()), curve.topology, float(curve.resistance_ohm[np.argmax(gap)])))
    gap, topology, ohm = min(found)
    return verdict.judge(name, gap, f"pulses read less eq. (3) in one gate, {topology} at {ohm:.6g} ohm")


def plain_ngspice(work: Path) -> list[Row]:
    """Run a peer without Verilog and lock-step: a batch transient of ngspice, in `work`, with an
    XSPICE flip-flop.
    """
    name, judged = "sweep.plain_ngspice_pulses_510", "sweep.rate_error_lsb.plain_ngspice"
    if shutil.which("ngspice") is None:
        reason = "no ngspice on the path"
        return [verdict.skip(name, reason, "pulses"), verdict.skip(judged, reason)]
    text = BENCH.read_text()
    given = {
        key: re.search(rf"^\.param {key} = (\d+)$", text, re.MULTILINE) for key in ("r_taxel", "n_clocks")
    }
    if given["r_taxel"] is None or given["n_clocks"] is None:
        reason = f"{BENCH.name} has no r_taxel or no n_clocks"
        return [verdict.error(name, reason, "pulses"), verdict.error(judged, reason)]
    # A copy, because the runner writes next to the deck, and `.include` is relative to it.
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(ROOT / "spice", work)
    try:
        measured = spice_batch.run(Path(shutil.copy(BENCH, work / "bench")), BENCH_LIMIT_S)
        pulses = measured.values["pulses"]
    except SimulatorError as error:
        return [verdict.error(name, str(error), "pulses"), verdict.error(judged, str(error))]
    retried = "".join(f"; {retry}" for retry in measured.retries)
    ohm, clocks = int(given["r_taxel"][1]), int(given["n_clocks"][1])
    design = load_design()
    x = design.duty(ohm)
    balance = vfc.count_rational(exact(design.resistance_full_scale_ohm) / 2 / ohm, clocks)
    eq3 = int(vfc.count_restarting(x, clocks))
    laws = f"{ohm} ohm, {clocks} clocks: charge balance {balance}, eq. (3) {eq3}"
    return [
        verdict.report(name, round(pulses), "pulses", f"{laws}; batch ngspice with its own flip-flop"),
        verdict.judge(
            judged,
            abs(pulses - balance),
            f"measured {pulses:.6g}, the last pulse cut off by the end{retried}",
        ),
    ]


# ---- table and figures ---------------------------------------------------------------------------------------

COLUMNS = (
    "topology",
    "r_ohm",
    "x",
    "pulses",
    "code",
    "f_count_hz",
    "f_period_hz",
    "f_line_hz",
    "f_charge_balance_hz",
    "pulses_charge_balance",
    "f_eq3_hz",
    "pulses_eq3",
    "physical_pulses",
    "physical_code",
    "physical_f_count_hz",
    "physical_f_period_hz",
    "physical_f_line_hz",
)


def table(curves: Sequence[Curve]) -> str:
    """Return the sweep as csv, one line per resistance and interface; empty if not measured."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for curve in curves:
        f_clk, gate = curve.f_clk_hz, curve.gate
        where = {} if curve.physical_at is None else {int(p): i for i, p in enumerate(curve.physical_at)}
        for i, ohm in enumerate(curve.resistance_ohm):
            laws = [f_clk * curve.x[i], int(curve.pulses_charge_balance[i])]
            laws += [f_clk / curve.period_eq3_clocks[i], int(curve.pulses_eq3[i])]
            physical = ["", "", "", "", ""]
            if curve.physical is not None and i in where:
                physical = _measured(curve.physical, where[i], f_clk, gate)
            cells = [curve.topology, float(ohm), float(curve.x[i]), *_measured(curve.ideal, i, f_clk, gate)]
            writer.writerow([_cell(c) for c in (*cells, *laws, *physical)])
    return text.getvalue()


def _measured(reading: Reading, i: int, f_clk: float, gate: int) -> list[Any]:
    pulses = int(reading.pulses[i])
    periods = [f_clk / reading.period_clocks[i], f_clk / reading.line_clocks[i]]
    return [pulses, int(reading.code[i]), f_clk * pulses / gate, *periods]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return (
            ""
            if math.isnan(value)
            else repr(round(float(value), 3))
            if value > 10_000
            else repr(float(value))
        )
    return str(value)


LABELS = {
    "direct": "direct (Fig. 3)",
    "conveyor_mirror": "conveyor + mirror (Fig. 5a)",
    "conveyor_mirror_inverted": "conveyor + mirror, inverted (Fig. 5b)",
    "multi_output_conveyor": "multiple-output conveyor (Fig. 6)",
}
LOOKS = {
    "direct": (figures.BLUE, "o"),
    "conveyor_mirror": (figures.ORANGE, "s"),
    "conveyor_mirror_inverted": (figures.GREEN, "^"),
    "multi_output_conveyor": ("#CC79A7", "D"),
}
BALANCE = {"color": "black", "lw": 1.3, "label": "charge balance: f = f_clk x"}
EQ3 = {"color": figures.RED, "lw": 1.3, "ls": (0, (5, 2)), "label": "eq. (3): f = f_clk / ceil(1/x)"}


def _laws(curve: Curve, low_ohm: float, high_ohm: float) -> tuple[Floats, Floats, Floats]:
    """Return resistances, and frequencies of both laws in Hz, dense enough to show the steps."""
    unit = float(curve.x[0] * curve.resistance_ohm[0])
    ohm = np.geomspace(low_ohm, high_ohm, 20_001)
    clocks = 1 << 40
    return (
        ohm,
        curve.f_clk_hz * unit / ohm,
        curve.f_clk_hz * vfc.count_restarting(unit / ohm, clocks) / clocks,
    )


def _ticks(axes: Any, low: float, high: float) -> None:
    """Put readable resistances on a logarithmic axis."""
    marks = [m * 10**e for e in range(8) for m in (1, 2, 5) if low <= m * 10**e <= high]
    axes.set_xticks(marks, [f"{m / 1000:g} k" if m >= 1000 else f"{m:g}" for m in marks])
    axes.set_xticks([], minor=True)


def _shares(across: Floats, among: int, most: int, scale: Callable[[Any], Any]) -> list[Ints]:
    """Divide points evenly along an axis among some curves, which would hide each other."""
    place = scale(across)
    wanted = np.linspace(place.min(), place.max(), most)
    picks = np.unique([int(np.argmin(np.abs(place - w))) for w in wanted])
    return [picks[i::among] for i in range(among)]


def _mark(axes: Any, curve: Curve, across: Floats, up: Floats, **extra: Any) -> None:
    colour, marker = LOOKS[curve.topology]
    axes.plot(across, up, marker, color=colour, mfc="none", ms=5.5, mew=1.2, zorder=3, **extra)


def _log_scales(axes: Any, low: float, high: float) -> None:
    """Set both axes to logarithmic: ohm across, kHz up."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    _ticks(axes, low, high)
    marks = [20, 50, 100, 200, 500, 1000, 2000]
    axes.set_yticks(marks, [str(m) for m in marks])
    axes.set_yticks([], minor=True)


def draw_law(axes: Any, curve: Curve, low: float, high: float) -> None:
    """Draw the law of charge balance over logarithmic axes, ohm and kHz."""
    line, balance, _ = _laws(curve, low, high)
    axes.plot(line, balance / 1e3, **BALANCE)
    _log_scales(axes, low, high)


def frequency_figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw frequency against resistance and, the paper's Fig. 8, against force, with both laws."""
    figure = Figure(figsize=(10, 4.9), layout="constrained")
    whole, forces = figure.subplots(1, 2)
    ohm = curves[0].resistance_ohm
    low, high = float(ohm[0]), float(ohm[-1])
    k_force = load_design().sensor.k_force_n_ohm
    line, balance, eq3 = _laws(curves[0], low, high)
    for axes, at_line, at_ohm, unit, scale in (
        (whole, line, ohm, 1e3, np.log),
        (forces, k_force / line, k_force / ohm, 1e6, np.asarray),
    ):
        axes.plot(at_line, balance / unit, **BALANCE)
        axes.plot(at_line, eq3 / unit, **EQ3)
        for curve, share in zip(curves, _shares(at_ohm, len(curves), 40, scale), strict=True):
            f = curve.f_clk_hz / curve.ideal.period_clocks[share]
            _mark(axes, curve, at_ohm[share], f / unit, label=LABELS[curve.topology])
        axes.grid(alpha=0.3, which="both")
    _log_scales(whole, low, high)
    whole.set_xlabel("resistance of the taxel R / ohm")
    whole.set_ylabel("pulse frequency f / kHz")
    whole.set_title("Frequency against resistance", fontsize=10)
    whole.legend(frameon=False, fontsize=8.5, loc="lower left")
    forces.set_xlabel("force on the taxel F = K_f / R / N")
    forces.set_ylabel("pulse frequency f / MHz")
    forces.set_title("Frequency against force", fontsize=10)
    figures.save(figure, path)


def code_figure(curves: Sequence[Curve], path: Path) -> None:
    """Draw the paper's Fig. 9: code against force, the range near full scale enlarged, and
    residuals.
    """
    figure = Figure(figsize=(10, 7.6), layout="constrained")
    (whole, foot), (ideal, physical) = figure.subplots(2, 2, height_ratios=[1.25, 1])
    first, ohm = curves[0], curves[0].resistance_ohm
    low = float(ohm[0])
    near = min(1.55 * low, float(ohm[-1]))
    force_n = load_design().sensor.k_force_n_ohm
    counts = first.gate / first.f_clk_hz

    line, balance, eq3 = _laws(first, low, float(ohm[-1]))
    whole.plot(force_n / line, balance * counts, **BALANCE)
    whole.plot(force_n / line, eq3 * counts, **EQ3)
    for curve, at in zip(curves, _shares(force_n / ohm, len(curves), 48, np.asarray), strict=True):
        _mark(whole, curve, force_n / ohm[at], curve.ideal.code[at], label=LABELS[curve.topology])
    whole.set_xlabel("force on the taxel F = K_f / R / N")
    whole.set_ylabel(f"code (pulses in {first.gate} clocks)")
    whole.set_title("Code against force", fontsize=10)
    whole.legend(frameon=False, fontsize=8.5, loc="upper left")

    line, balance, eq3 = _laws(first, low, near)
    foot.plot(line, balance * counts, **BALANCE)
    foot.plot(line, eq3 * counts, **EQ3)
    shown = np.flatnonzero(ohm <= near)
    for curve, share in zip(curves, _shares(ohm[shown], len(curves), 40, np.asarray), strict=True):
        _mark(foot, curve, ohm[shown[share]], curve.ideal.code[shown[share]])
    gap = np.abs(first.ideal.pulses - first.pulses_eq3)
    worst = int(np.argmax(gap))
    ends = (first.pulses_eq3[worst], first.ideal.pulses[worst])
    beside = ohm[worst] + 0.006 * low
    arrow = {"arrowstyle": "<->", "color": figures.GREY, "shrinkA": 0, "shrinkB": 0}
    foot.annotate("", xy=(beside, ends[0]), xytext=(beside, ends[1]), arrowprops=arrow)
    foot.text(
        beside + 0.01 * low,
        sum(ends) / 2,
        f"{gap[worst]} counts",
        color=figures.GREY,
        va="center",
        fontsize=9,
    )
    foot.set_xlim(0.985 * low, near)
    foot.set_ylim(0.3 * first.gate, 0.52 * first.gate)
    foot.set_xlabel("resistance of the taxel R / ohm")
    foot.set_ylabel("code")
    foot.set_title(f"Difference of the laws just above {low:g} ohm", fontsize=10)

    steps = first.gate * first.x
    for curve, at in zip(curves, _shares(steps, len(curves), 120, np.asarray), strict=True):
        _mark(ideal, curve, steps[at], curve.ideal.code[at] - steps[at])
    for limit in (-0.5, 0.5):
        ideal.axhline(limit, color=figures.GREY, lw=0.8, ls="--")
    ideal.set_ylim(-1.1, 1.1)
    ideal.set_title("Ideal blocks: code less charge balance (dashed: rounding)", fontsize=10)
    ideal.set_ylabel("residual / LSB")

    drawn = [
        c for c in curves if c.physical is not None and c.physical_at is not None and c.physical_x is not None
    ]
    for i, curve in enumerate(drawn):
        steps = curve.gate * curve.x[curve.physical_at]
        at = _shares(steps, len(drawn), 200, np.asarray)[i]
        rest = curve.gate / curve.physical.line_clocks - steps
        _mark(physical, curve, steps[at], rest[at])
        physical.plot(steps, curve.gate * curve.physical_x - steps, color=LOOKS[curve.topology][0], lw=1)
    physical.set_title("Physical blocks: f from all pulse times less charge balance", fontsize=10)
    physical.set_ylabel("difference / LSB")
    physical.text(0.03, 0.06, "lines: array solve and gains", transform=physical.transAxes, fontsize=8.5)
    physical.set_visible(bool(drawn))
    for axes in (ideal, physical):
        axes.set_xlabel(f"charge balance, {first.gate} x / LSB")
        axes.axhline(0.0, color="black", lw=0.8)
    for axes in (whole, foot, ideal, physical):
        axes.grid(alpha=0.3)
    figures.save(figure, path)


# ---- the run -------------------------------------------------------------------------------------------------


def run(
    topologies: Sequence[str], points: int, out: Path, *, physical: bool = True
) -> tuple[list[Curve], list[Row], bool]:
    """Sweep some interfaces.

    Parameters
    ----------
    topologies : names of dermis.scene.design.TOPOLOGIES
    points : resistances in the sweep
    out : directory for scenes, logs and the decks of a failed run
    physical : read some of the points through physical blocks as well

    Returns
    -------
    curves of the interfaces that were read, verdict rows, and whether a simulator failed
    """
    design = load_design()
    ohm = resistances(points, design)
    some = min(points, max(PHYSICAL_POINTS_MIN, points // PHYSICAL_SHARE))
    at = np.round(np.linspace(0, points - 1, some)).astype(np.int64)
    ideal_ohm = in_frames(ohm, ROWS, min(COLS, points))
    plans: dict[tuple[str, bool], Plan] = {}
    for topology in topologies:
        title = f"{points} resistances through {topology}"
        plans[topology, False] = make_plan(out / "scenes", topology, ideal_ohm, {}, title)
        if physical:
            named = physical_effects(topology, design)
            alone = in_frames(ohm[at], ROWS, 1)
            plans[topology, True] = make_plan(out / "scenes", topology, alone, named, f"{title}, physical")
    shutil.rmtree(out / "work", ignore_errors=True)
    done = dict.fromkeys(plans, 0)
    total = sum(made.frames * made.rows for made in plans.values())
    readings: dict[tuple[str, bool], Reading | SimulatorError] = {}
    with progress.slots("sweeping", total) as show, ThreadPoolExecutor(len(plans)) as pool:

        def one(key: tuple[str, bool]) -> Reading:
            def on_slots(slots: int) -> None:
                done[key] = slots
                show(sum(done.values()))

            made, work = plans[key], out / "work" / f"{key[0]}{'_physical' if key[1] else ''}"
            reading = read(made, at.size if key[1] else points, on_slots, work)
            shutil.rmtree(work)  # a successful run can be repeated from its scene
            return reading

        futures: dict[tuple[str, bool], Future[Reading]] = {key: pool.submit(one, key) for key in plans}
        try:
            for key, future in futures.items():
                try:
                    readings[key] = future.result()
                except SimulatorError as error:
                    readings[key] = error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            cosim.end_all()
            raise
    with contextlib.suppress(OSError):  # not empty: a failed run
        (out / "work").rmdir()
    curves: list[Curve] = []
    rows: list[Row] = []
    for topology in topologies:
        ideal, real = readings[topology, False], readings.get((topology, True))
        if isinstance(ideal, SimulatorError):
            rows.append(verdict.error(f"sweep.rate_error_lsb.{topology}", str(ideal)))
            continue
        extra: dict[str, Any] = {}
        if isinstance(real, Reading):
            made = plans[topology, True]
            extra = {"physical": real, "physical_at": at, "physical_x": physical_duty(made, at.size)}
            extra["event_code"] = event_codes(made, at.size)
        curves.append(make_curve(plans[topology, False], ohm, ideal, **extra))
        rows += judge(curves[-1])
        if isinstance(real, SimulatorError):
            rows.append(verdict.error(f"sweep.physical_shift_lsb.{topology}", str(real), "lsb"))
    failed = any(isinstance(r, SimulatorError) for r in readings.values())
    rows.append(judge_laws(curves))
    rows += plain_ngspice(out / "plain_ngspice")
    return curves, rows, failed
