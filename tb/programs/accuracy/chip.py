# SPDX-License-Identifier: Apache-2.0
"""`dermis accuracy-chip`: resolution of the chip against conversion time, and energy of a conversion.

Every resolution is simulated: engine event reads random forces clock by clock with effects and
seeded noise, a straight line removes gain and offset as a calibration would, and the rest is
compared with that of an ideal quantiser, a step / sqrt(12).
"""

import itertools
import math
import operator
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure

from dermis import plan as planning
from dermis.converter.vfc import LONGEST_GATE
from dermis.engines import event
from dermis.errors import DermisError
from dermis.files import write_atomic
from dermis.ndarrays import Floats
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.figures import save
from dermis.scene import design as design_module
from scripts import judged
from tb.programs.accuracy import simulator
from tb.reference import scenes

HALF = 0.5  # duty at full force
SETTLE_S = 23e-6  # settling time of the paper's slot: 115 clocks at 5 MHz
PAPER_BITS, PAPER_HZ = 8, 5e6
BITS = range(3, 16)  # bits of a code, for gates of 2 (2^n - 1) clocks, 14 to 65534
CLOCKS_HZ = (1e6, 2e6, 5e6, 10e6, 20e6, 50e6)
SEEDS = (1, 2, 3)
# Forces lie in this part of the range: errors of gain and pedestals must not saturate a code.
RANGE = (0.002, 0.9)

QUANTISED, FULL = "quantisation", "+ range switch"
"""The curves without an effect and with all of them."""
_ADDED = {
    QUANTISED: "",
    "+ noise": "comparator_noise metastability clock_jitter thermal_noise shot_noise ktc_noise",
    "+ slow noise of the reference": "flicker_noise",
    "+ non-linearity of the converter": "integrator_gain integrator_bandwidth comparator_offset "
    "comparator_hysteresis comparator_delay charge_packet preset_error mirror_ratio mirror_output",
    "+ settling of the mirror": "mirror_lag",
    FULL: "range_switch",
}
_ON = (dict.fromkeys(names.split(), True) for names in _ADDED.values())
STEPS = dict(zip(_ADDED, itertools.accumulate(_ON, operator.or_), strict=True))
"""Effects of each curve; each adds to the one before."""


def bits_of(error: float) -> float:
    """Return the bits of the ideal quantiser with a root mean square error over full scale."""
    return -math.log2(math.sqrt(12.0) * error) if error > 0 else math.inf


def gate_of(bits: int) -> int:
    """Return the clocks in which full scale counts to the highest code of `bits` at any phase."""
    return 2 * (2**bits - 1)


PAPER = gate_of(PAPER_BITS)  # clocks of the paper's gate


@dataclass(frozen=True)
class Point:
    """One line of the csv: the resolution at a point of a curve, the median over seeds."""

    curve: str
    f_clk_hz: float
    gate_clocks: int
    bits: float

    @property
    def slot_s(self) -> float:
        return SETTLE_S + self.gate_clocks / self.f_clk_hz


def plan_at(
    duty: Floats, effects: Mapping[str, Any], gate_clocks: int, f_clk_hz: float = PAPER_HZ, seed: int = 0
) -> Plan:
    """Return a plan that reads ideal duties [frames, rows, cols]; ValueError for a gate beyond 16 bits."""
    if not 1 <= gate_clocks <= LONGEST_GATE:
        raise ValueError(f"a gate of {gate_clocks} clocks, allowed 1..{LONGEST_GATE}")
    base, ohm = design_module.load(), scenes.unit_ohm({}) / duty
    c_int_f = base.converter.i0_a / f_clk_hz / base.converter.packet_v  # keeps the voltage of a packet
    design = base.replace(
        converter={"f_clk_hz": f_clk_hz, "c_int_f": c_int_f},
        timing={"frame_s": base.array.rows * base.timing.slot_clocks / f_clk_hz},
    )
    made = planning.whole(scenes.of_resistances(ohm, dict(effects), design=design), "event")
    settle_clocks = max(2, round(SETTLE_S * f_clk_hz))
    timing = replace(
        made.timing,
        gate_clocks=gate_clocks,
        settle_clocks=settle_clocks,
        slot_clocks=settle_clocks + gate_clocks,
        code_max=LONGEST_GATE - 1,
    )
    return replace(made, timing=timing, seed=seed)


def random_duty(seed: int, frames: int = 2, rows: int = 8, cols: int = 32) -> Floats:
    """Return forces spread evenly over the range, as duties [frames, rows, cols]."""
    return np.random.default_rng([seed, 5]).uniform(*(HALF * r for r in RANGE), (frames, rows, cols))


def judge(duty: Floats, read: Floats) -> float:
    """Return the bits of readings after a straight line has removed gain and offset."""
    slope, offset = np.polyfit(duty.ravel(), read.ravel(), 1)
    miss = (read.ravel() - offset) / slope - duty.ravel()
    return bits_of(float(np.sqrt(np.mean(miss**2))) / HALF)


def counts(made: Plan) -> Floats:
    """Return readings of the plain counter as duties."""
    return event.run(made).codes / made.timing.gate_clocks


def measured(
    effects: Mapping[str, Any], gate_clocks: int, f_clk_hz: float = PAPER_HZ, seeds: Sequence[int] = SEEDS
) -> float:
    """Return bits: the median over seeds, each with its own forces and noise."""
    duties = {seed: random_duty(seed) for seed in seeds}
    return statistics.median(
        judge(duty, counts(plan_at(duty, effects, gate_clocks, f_clk_hz, seed)))
        for seed, duty in duties.items()
    )


SUPPLY_BENCH = "supply_conveyor_mirror"
SUPPLY_QUANTITY = "supply_channel_a.conveyor_mirror"


def channel_current_a() -> float:
    """Measure the supply current of a channel, in ampere, by the bench of `dermis characterise` in ngspice.

    Raises SimulatorError if ngspice fails, InputError without the transistor models.
    """
    from scripts.characterise import benches, runs

    bench = benches.BENCHES[SUPPLY_BENCH]
    return bench.values(runs.measured(bench.body, benches.Condition()))[SUPPLY_QUANTITY]


def energy_j(slot_s: float, channel_a: float, duty: float = 0.25) -> float:
    """Return the energy of one conversion in joule, delivered by both supplies through a slot.

    It adds the sensor's current, its copy through the mirror, the reference i0 of the charge source, and
    `channel_a`, the current of a channel from vdd without a signal.
    """
    d = design_module.load()
    i_taxel = duty * d.interface.k * d.converter.i0_a
    current = i_taxel + i_taxel / d.interface.k + d.converter.i0_a + channel_a
    return (d.supply.vdd_v - d.supply.vss_v) * current * slot_s


def energy_rows(paper: Point) -> list[verdict.Row]:
    """Return the energy of a conversion and of a bit at the paper's point."""
    name = "accuracy_chip.energy"
    try:
        amps = channel_current_a()
    except DermisError as error:
        reason = f"no supply current was measured: {error}"
        return [verdict.skip(f"{name}{end}", reason, "nJ") for end in ("_nj", "_per_bit_nj")]
    whole = 1e9 * energy_j(paper.slot_s, amps)
    note = f"one conversion of 125 us at a quarter of the clock rate; {SUPPLY_QUANTITY} {1e6 * amps:.0f} uA"
    each = f"the same over its {paper.bits:.2f} bits"
    return [
        verdict.report(f"{name}_nj", whole, "nJ", f"{note} (ngspice, SKY130)"),
        verdict.report(f"{name}_per_bit_nj", whole / paper.bits, "nJ", each),
    ]


def gate_points() -> list[Point]:
    """Return resolution by gate length: each step at the paper's clock, all effects at the others."""
    asked = [(name, PAPER_HZ, n) for name in STEPS for n in BITS]
    asked += [(FULL, f, n) for f in CLOCKS_HZ if f != PAPER_HZ for n in BITS]
    return [
        Point(name, f, gate_of(n), measured(STEPS[name], gate_of(n), f, SEEDS[: 3 if f == PAPER_HZ else 1]))
        for name, f, n in asked
    ]


def curve_of(points: Sequence[Point], name: str, f_clk_hz: float) -> list[Point]:
    return [p for p in points if (p.curve, p.f_clk_hz) == (name, f_clk_hz)]


def waiting_ends(points: Sequence[Point], f_clk_hz: float) -> Point:
    """Return the longest gate with all effects whose last doubling gained a quarter of a bit."""
    curve = curve_of(points, FULL, f_clk_hz)
    short = (a for a, b in itertools.pairwise(curve) if b.bits < a.bits + 0.25)
    return next(short, curve[-1])


def rows_of(gates: Sequence[Point]) -> list[verdict.Row]:
    """Return the results of the study, and its checks."""
    name = "accuracy_chip."
    paper = {p.curve: p for p in gates if (p.gate_clocks, p.f_clk_hz) == (PAPER, PAPER_HZ)}
    # 512 random forces give their mean square to 4 %, 0.03 bit.
    rows = [
        verdict.within(f"{name}paper_point_bits.ideal", paper[QUANTISED].bits, "bits", 7.9, 8.1,
                       "510 clocks at 5 MHz, quantisation alone"),
        verdict.report(f"{name}paper_point_bits.all", paper[FULL].bits, "bits", "everything on"),
    ]  # fmt: skip
    for f in CLOCKS_HZ:
        end, clock = waiting_ends(gates, f), f"{1e-6 * f:g}mhz"
        note = f"{end.bits:.2f} bits; twice as long gains less than a quarter of a bit"
        rows.append(verdict.report(f"{name}waiting_ends_clocks.{clock}", end.gate_clocks, "clocks", note))
    return rows + energy_rows(paper[FULL])


def draw(points: Sequence[Point], path: Path) -> None:
    """Draw bits against gate length at the paper's clock by effect, and against row time by clock."""
    figure = Figure(figsize=(15, 5.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for curve in STEPS:
        own = curve_of(points, curve, PAPER_HZ)
        left.plot([p.gate_clocks for p in own], [p.bits for p in own], "o-", ms=3, label=curve)
    left.set_xscale("log", base=2)
    left.set(xlabel="gate / clocks", title="Gate at 5 MHz, engine event, median of three seeds")
    for f in CLOCKS_HZ:
        own, label = curve_of(points, FULL, f), f"{1e-6 * f:g} MHz"
        right.plot([1e6 * p.slot_s for p in own], [p.bits for p in own], "o-", ms=3, label=label)
    x_label = "time of one row / us: 23 us to settle and the gate"
    right.set(xscale="log", title="All effects, by clock", xlabel=x_label)
    for axes, x in ((left, PAPER), (right, 125)):
        axes.plot(x, PAPER_BITS, "*", markersize=15, label="the paper")
        axes.set(ylim=(2.5, 15.5), ylabel="effective resolution / bits")
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8, frameon=False)
    save(figure, path)


@click.command("accuracy-chip")
def accuracy_chip_command() -> int:
    """Measure resolution against conversion time on the chip: rows, csv and figure in build/accuracy."""
    gates = gate_points()
    write_atomic(simulator.OUT / "chip_gate.csv", simulator.points_csv(gates))
    draw(gates, simulator.OUT / "chip_resolution.png")
    rows = rows_of(gates)
    return judged.finish("accuracy_chip", rows, "Conversion time against resolution")
