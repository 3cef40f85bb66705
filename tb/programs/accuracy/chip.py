# SPDX-License-Identifier: Apache-2.0
"""Resolution of the chip against conversion time: bits and newtons against gate length, clock and
frame rate.

Every resolution is simulated: engine event reads random forces clock by clock with effects and
seeded noise, a straight line removes gain and offset as a calibration would, and the rest is
compared with that of an ideal quantiser, a step / sqrt(12). Formulas are drawn next to the
simulation.
"""

from __future__ import annotations

import itertools
import math
import operator
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import plan as planning
from dermis.converter.vfc import LONGEST_GATE, count
from dermis.decode.force import taxels_alone
from dermis.engines import closed, event
from dermis.records import Plan
from dermis.report import verdict
from dermis.scene import design as design_module
from dermis.scene import scene
from dermis.scene.design import Design

Floats = NDArray[np.float64]

HALF = 0.5
"""Duty at full force."""
SETTLE_S = 23e-6
"""Settling time of the paper's slot: 115 clocks at 5 MHz."""
PAPER_BITS, PAPER_HZ = 8, 5e6
BITS = range(3, 16)
"""Bits of a code, for gates of 2 (2^n - 1) clocks, 14 to 65534."""
CLOCKS_HZ = (1e6, 2e6, 5e6, 10e6, 20e6, 50e6)
SIZES = (8, 16, 32, 64)
SEEDS = (1, 2, 3)
# Forces lie in this part of the range: errors of gain and pedestals must not saturate a code.
RANGE = (0.002, 0.9)


def _on(*names: str) -> dict[str, Any]:
    return dict.fromkeys(names, True)


NOISE = _on("comparator_noise", "metastability", "clock_jitter", "thermal_noise", "shot_noise", "ktc_noise")
DRIFT = _on("flicker_noise")
BENDS = _on("integrator_gain", "integrator_bandwidth", "comparator_offset", "comparator_hysteresis")
BENDS |= _on("comparator_delay", "charge_packet", "preset_error", "mirror_ratio", "mirror_output")
QUANTISED, SLOW_NOISE = "quantisation", "+ slow noise of the reference"
STRAIGHT, SETTLED = "+ non-linearity of the converter", "+ settling of the mirror"
FULL = "+ range switch"
"""The curve with all effects."""
_ADDED = {
    QUANTISED: {},
    "+ noise": NOISE,
    SLOW_NOISE: DRIFT,
    STRAIGHT: BENDS,
    SETTLED: _on("mirror_lag"),
    FULL: _on("range_switch"),
}
STEPS = dict(zip(_ADDED, itertools.accumulate(_ADDED.values(), operator.or_), strict=True))
"""Effects of each curve; each adds to the one before."""
SLOTS_S = {"500 frames/s": 125e-6, "1000 frames/s": 62.5e-6, "2000 frames/s": 31.25e-6}
"""Row slots of 16 rows: the paper's, and two for robots."""


def bits_of(error: float) -> float:
    """Return the bits of the ideal quantiser with a root mean square error over full scale."""
    return -math.log2(math.sqrt(12.0) * error) if error > 0 else math.inf


@dataclass(frozen=True)
class Point:
    """One line of the csv: a point of a curve, with its resolution and the spread over seeds."""

    curve: str
    engine: str
    f_clk_hz: float
    gate_clocks: int
    settle_s: float
    bits: float
    bits_least: float
    bits_most: float

    @property
    def slot_s(self) -> float:
        """Time of one row."""
        return self.settle_s + self.gate_clocks / self.f_clk_hz

    @property
    def newtons(self) -> float:
        """Step of the ideal quantiser in newtons."""
        return design_module.load().sensor.force_max_n / 2.0**self.bits


def gate_of(bits: int) -> int:
    """Return the clocks in which full scale counts to the highest code of `bits`, whatever the
    phase.
    """
    return 2 * (2**bits - 1)


def design_at(f_clk_hz: float) -> Design:
    """Return the design at another clock; the capacitor keeps a packet at its voltage, as in
    `dermis calc`.
    """
    base = design_module.load()
    slot_s = base.timing.slot_clocks / f_clk_hz
    return base.replace(
        converter={"f_clk_hz": f_clk_hz, "c_int_f": base.converter.i0_a / f_clk_hz / base.converter.packet_v},
        timing={"frame_s": base.array.rows * slot_s},
    )


def plan_at(
    duty: Floats,
    effects: Mapping[str, Any],
    f_clk_hz: float = PAPER_HZ,
    gate_clocks: int = 510,
    settle_s: float = SETTLE_S,
    seed: int = 0,
) -> Plan:
    """Return a plan that reads ideal duties [frames, rows, cols] with any gate and any time to
    settle.

    Raises
    ------
    ValueError
        A gate beyond the 16 bits of the chip's register.
    """
    if not 1 <= gate_clocks <= LONGEST_GATE:
        raise ValueError(f"a gate of {gate_clocks} clocks, allowed 1..{LONGEST_GATE}")
    rows, cols = duty.shape[-2:]
    data = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "uniform", "code": [1]},
        "effects": dict(effects),
        "run": {"seed": seed},
    }
    made = planning.whole(scene.from_data(data, Path("chip.toml"), design_at(f_clk_hz)), "event")
    settle_clocks = max(2, round(settle_s * f_clk_hz))
    timing = replace(
        made.timing,
        gate_clocks=gate_clocks,
        settle_clocks=settle_clocks,
        slot_clocks=settle_clocks + gate_clocks,
        code_max=LONGEST_GATE - 1,
    )
    return replace(made, timing=timing, resistance_ohm=made.ohm_of_duty(duty), force_n=None)


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
    curve: str,
    effects: Mapping[str, Any],
    gate_clocks: int,
    f_clk_hz: float = PAPER_HZ,
    settle_s: float = SETTLE_S,
    seeds: Sequence[int] = SEEDS,
    read: Callable[[Plan], Floats] = counts,
    duty_of: Callable[[int], Floats] = random_duty,
) -> Point:
    """Return one point of a curve: the median over seeds, each with its own forces and noise."""
    found = []
    for seed in seeds:
        duty = duty_of(seed)
        made = plan_at(duty, effects, f_clk_hz, gate_clocks, settle_s, seed)
        found.append(judge(duty, read(made)))
    spread = (statistics.median(found), min(found), max(found))
    engine = "closed" if read in EXACT_READERS else "event"
    return Point(curve, engine, f_clk_hz, gate_clocks, settle_s, *spread)


def formula(f_clk_hz: float, gate_clocks: int) -> float:
    """Return the bits that quantisation, white noise and slow noise of the reference leave, added as
    powers.

    In counts: quantisation 1/12; at a count m, jitter 2 j^2 m, shot noise 2 q (gate x + m) /
    packet, the comparator at the last decision, and the reference r m.
    """
    d = design_at(f_clk_hz)
    m = np.linspace(*(HALF * r * gate_clocks for r in RANGE), 200)
    jitter = d.converter.t_jitter_s * f_clk_hz
    shot = 1.602176634e-19 / d.converter.packet_c
    comparator = d.comparator.v_noise_v / d.converter.packet_v
    preset_v2 = 1.380649e-23 * d.ambient.temperature_k / d.converter.c_int_f
    power = 1 / 12 + (2 * jitter**2 + 2 * shot) * m + comparator**2
    power = power + preset_v2 / d.converter.packet_v**2 + (d.charge.flicker * m) ** 2
    return bits_of(float(np.sqrt(np.mean(power))) / gate_clocks / HALF)


def drifted(delta_k: float) -> float:
    """Return the bits of a reference that was calibrated `delta_k` kelvin away, by formula."""
    share = np.linspace(*RANGE, 200)
    return bits_of(design_module.load().charge.tc_per_k * delta_k * float(np.sqrt(np.mean(share**2))))


# --- accuracy without time ---------------------------------------------------------------------------------


def with_residue(bits: int) -> Callable[[Plan], Floats]:
    """Return a reader that also measures the charge left in the integrator, to 2^-bits of a packet.

    After the gate the input is off and the current packet is completed, so the residue lies within
    one packet below the threshold: N x = ones + residue - start. The chip knows the current packet
    from its last two bits; here these are the ones that a gate two clocks shorter, with the same
    noise, does not count. A ramp takes 2^bits clocks.
    """

    def read(made: Plan) -> Floats:
        found, gate = event.run(made), made.timing.gate_clocks
        before = event.run(replace(made, timing=replace(made.timing, gate_clocks=gate - 2)))
        under_way = found.codes.astype(int) - before.codes
        step = 2.0**-bits
        residue = (np.floor((np.asarray(found.info["w_end"]) - under_way) / step) + 0.5) * step
        return (found.codes + residue + HALF) / gate

    return read


def without_preset(made: Plan) -> Floats:
    """Read with an integrator that continues from slot to slot: it starts anywhere in its
    packet.
    """
    x = made.duty_ideal()
    start = np.random.default_rng([made.seed, 9]).uniform(x - 1.0, x)
    return count(x, made.timing.gate_clocks, w0=start) / made.timing.gate_clocks


def exact_counts(made: Plan) -> Floats:
    """Return readings of engine closed as duties."""
    return closed.run(made).codes / made.timing.gate_clocks


def corrected_counts(made: Plan) -> Floats:
    """Return these readings with the droop of the rows corrected."""
    return taxels_alone(made, exact_counts(made))


EXACT_READERS = (without_preset, exact_counts, corrected_counts)
"""Readers by the count formula: engines carry no state from slot to slot."""

Curves = dict[str, tuple[dict[str, Any], Callable[[Plan], Floats]]]
"""Effects and reader by curve."""

READINGS: Curves = {
    "counter, preset (adopted)": ({}, counts),
    "counter, preset, with noise": (NOISE | DRIFT, counts),
    "counter without preset": ({}, without_preset),
    **{f"counter + residue of {bits} bits": ({}, with_residue(bits)) for bits in (2, 4, 6)},
    "counter + residue of 4 bits, with noise": (NOISE | DRIFT, with_residue(4)),
}
"""The plain counter, and readers with a higher resolution in the same gate."""

LOSSES = _on("row_driver", "column_input")
DROOP: Curves = {
    "no series resistance": ({}, exact_counts),
    "as read": (LOSSES, exact_counts),
    "row droop corrected": (LOSSES, corrected_counts),
}
"""16x16 frames with the design's drivers and inputs."""


def frame_duty(seed: int) -> Floats:
    """Return the duties of 16x16 frames."""
    return random_duty(seed, frames=4, rows=16, cols=16)


def read_points(
    curves: Curves, gates: Sequence[int], duty_of: Callable[[int], Floats] = random_duty
) -> list[Point]:
    """Return all curves at the paper's clock."""
    return [
        measured(name, on, gate, read=read, duty_of=duty_of)
        for gate in gates
        for name, (on, read) in curves.items()
    ]


# --- frame rates -----------------------------------------------------------------------------------------------------


def frame_hz(rows: int, slot_s: float) -> float:
    """Return frames a second of an array of `rows`."""
    return 1.0 / (rows * slot_s)


def split() -> Iterator[Point]:
    """Yield the slots of `SLOTS_S` divided between settling and gate, at three clocks, with two
    mirrors.
    """
    for (name, q_c), (rate, slot_s), f_clk_hz in itertools.product(
        (("fast mirror", 50e-15), ("slow mirror", 500e-15)), SLOTS_S.items(), (5e6, 20e6, 50e6)
    ):
        effects = STEPS[STRAIGHT] | {"mirror_lag": {"q_c": q_c}}
        curve = f"{rate}, {1e-6 * f_clk_hz:g} MHz, {name}"
        # From two clocks to a slot with a gate of 14.
        for settle_s in np.geomspace(4 / f_clk_hz, slot_s - gate_of(3) / f_clk_hz, 9):
            gate = int((slot_s - settle_s) * f_clk_hz)
            yield measured(curve, effects, gate, f_clk_hz, float(settle_s), seeds=SEEDS[:1])


# --- energy ----------------------------------------------------------------------------------------------------------


SUPPLY_BENCH = "supply_conveyor_mirror"
SUPPLY_QUANTITY = "supply_channel_a.conveyor_mirror"


@dataclass(frozen=True)
class ChannelCurrent:
    """Supply current in A of one channel of spice/sky130 without a signal, and its extremes over
    corners.
    """

    typical: float
    least: float
    most: float


def channel_current() -> ChannelCurrent:
    """Measure the supply current of a channel by the bench of `dermis characterise`, in ngspice.

    Raises
    ------
    SimulatorError
        The measurement in ngspice failed.
    InputError
        The transistor models are not installed.
    """
    from scripts.characterise import benches, runs

    bench = benches.BENCHES[SUPPLY_BENCH]
    corners = (benches.Condition(), benches.Condition("ss", -40.0, 0.9), benches.Condition("ff", 125.0, 1.1))
    found = [bench.values(runs.measured(bench.body, corner))[SUPPLY_QUANTITY] for corner in corners]
    return ChannelCurrent(found[0], min(found), max(found))


def energy_j(slot_s: float, channel_a: float | None = None, duty: float = 0.25) -> float:
    """Return the energy of one conversion in joule, delivered by both supplies through a slot.

    It adds the sensor's current, its copy through the mirror and the reference i0 of the charge
    source, as design.toml declares them, and `channel_a`, the current of a channel from vdd without
    a signal. Without that it is a lower bound.
    """
    d = design_module.load()
    i_taxel = duty * d.interface.k * d.converter.i0_a
    current = i_taxel + i_taxel / d.interface.k + d.converter.i0_a + (channel_a or 0.0)
    return (d.supply.vdd_v - d.supply.vss_v) * current * slot_s


def energy_rows(points: Sequence[Point], current: ChannelCurrent | None, reason: str) -> list[verdict.Row]:
    """Return the energy of a conversion and of a bit at the paper's point."""
    name = "accuracy_chip.energy"
    if current is None:
        return [verdict.skip(f"{name}{end}", reason, "nJ") for end in ("_nj", "_per_bit_nj")]
    paper = at(points, FULL, gate_of(PAPER_BITS))
    whole, least, most = (
        1e9 * energy_j(paper.slot_s, amps) for amps in (current.typical, current.least, current.most)
    )
    d = design_module.load()
    sensor = 0.25 * d.interface.k * d.converter.i0_a * (d.supply.vdd_v - d.supply.vss_v) * paper.slot_s
    note = "one conversion of 125 us at a quarter of the clock rate; "
    note += f"{1e11 * sensor / whole:.0f} % of it for the sensor; {SUPPLY_QUANTITY}"
    note += f" {1e6 * current.typical:.0f} uA (ngspice, SKY130; ss -40 C to ff 125 C"
    note += f" {1e6 * current.least:.0f} .. {1e6 * current.most:.0f} uA: {least:.0f} .. {most:.0f} nJ)"
    each = f"the same over its {paper.bits:.2f} bits"
    return [
        verdict.report(f"{name}_nj", whole, "nJ", note),
        verdict.report(f"{name}_per_bit_nj", whole / paper.bits, "nJ", each),
    ]


def cells(point: Point, channel_a: float | None) -> dict[str, Any]:
    """Return the cells of the csv by heading; `energy_j` is empty where no supply current was
    measured.
    """
    p = point
    head = {
        "curve": p.curve, "engine": p.engine, "f_clk_hz": f"{p.f_clk_hz:g}", "gate_clocks": p.gate_clocks,
        "settle_s": f"{p.settle_s:.6g}", "slot_s": f"{p.slot_s:.6g}", "bits": f"{p.bits:.3f}",
        "bits_least": f"{p.bits_least:.3f}", "bits_most": f"{p.bits_most:.3f}", "step_n": f"{p.newtons:.4g}",
        "energy_floor_j": f"{energy_j(p.slot_s):.4g}",
        "energy_j": "" if channel_a is None else f"{energy_j(p.slot_s, channel_a):.4g}",
    }  # fmt: skip
    return head | {f"frames_per_s_{n}x{n}": f"{frame_hz(n, p.slot_s):.5g}" for n in SIZES}


# --- the study -------------------------------------------------------------------------------------------------------


def gate_points(bits: Sequence[int] = BITS) -> list[Point]:
    """Return resolution against gate length: each step at the paper's clock, all effects at the
    others.
    """
    found = [measured(name, on, gate_of(n)) for name, on in STEPS.items() for n in bits]
    others = [f for f in CLOCKS_HZ if f != PAPER_HZ]
    return found + [measured(FULL, STEPS[FULL], gate_of(n), f, seeds=SEEDS[:1]) for f in others for n in bits]


def curve_of(points: Sequence[Point], curve: str, f_clk_hz: float = PAPER_HZ) -> list[Point]:
    """Return the points of a curve at a clock, the shortest gate first."""
    own = [p for p in points if (p.curve, p.f_clk_hz) == (curve, f_clk_hz)]
    return sorted(own, key=lambda p: p.gate_clocks)


def waiting_ends(points: Sequence[Point], f_clk_hz: float) -> Point:
    """Return the longest gate with all effects whose last doubling still gained a quarter of a
    bit.
    """
    curve = curve_of(points, FULL, f_clk_hz)
    short = (a for a, b in itertools.pairwise(curve) if b.bits < a.bits + 0.25)
    return next(short, curve[-1])


def gate_for(points: Sequence[Point], curve: str, bits: float) -> float | None:
    """Return the clocks in which a curve reaches `bits`, interpolated in the logarithm; None if
    never.
    """
    for before, here in itertools.pairwise(curve_of(points, curve)):
        if before.bits <= bits <= here.bits:
            share = (bits - before.bits) / (here.bits - before.bits)
            return before.gate_clocks * (here.gate_clocks / before.gate_clocks) ** share
    return None


def bits_at(points: Sequence[Point], curve: str, gate_clocks: float) -> float:
    """Return the bits of a curve at a gate between its points."""
    own = curve_of(points, curve)
    gates = np.log([p.gate_clocks for p in own])
    return float(np.interp(math.log(gate_clocks), gates, [p.bits for p in own]))


def at(points: Sequence[Point], curve: str, gate_clocks: int, f_clk_hz: float = PAPER_HZ) -> Point:
    """Return one point of a curve."""
    return next(p for p in points if (p.curve, p.gate_clocks, p.f_clk_hz) == (curve, gate_clocks, f_clk_hz))


def rows_of(gates: Sequence[Point], reading: Sequence[Point], drooping: Sequence[Point]) -> list[verdict.Row]:
    """Return the results of the study, and its checks."""
    paper, name = gate_of(PAPER_BITS), "accuracy_chip."
    white = curve_of(gates, SLOW_NOISE)
    apart = max(abs(p.bits - formula(p.f_clk_hz, p.gate_clocks)) for p in white)

    def bits(points: Sequence[Point], curve: str) -> float:
        return at(points, curve, paper).bits

    whole = bits(drooping, "no series resistance")
    residue = bits(reading, "counter + residue of 4 bits, with noise")
    # The limits: 512 random forces give their mean square to 4 %, 0.03 bit; the formula leaves out
    # that flicker and quantisation are not independent at 16 counts; and the other fifteen codes of
    # a row are rounded too, so that each contributes its share of the droop, some per cent.
    rows = [
        verdict.within(f"{name}paper_point_bits.ideal", bits(gates, QUANTISED), "bits", 7.9, 8.1,
                       "510 clocks at 5 MHz, quantisation alone"),
        verdict.report(f"{name}paper_point_bits.all", bits(gates, FULL), "bits", "everything on"),
        verdict.within(f"{name}formula_difference_bits", apart, "bits", None, 0.3,
                       "quantisation and noise: simulation against formula, largest over 2^4 .. 2^16 clocks"),
        verdict.within(f"{name}droop_left_bits", whole - bits(drooping, "row droop corrected"), "bits", None, 0.25,
                       "16x16 behind 1 and 0.5 ohm, 510 clocks: bits lost with the correction of decode"),
        verdict.report(f"{name}droop_cost_bits", whole - bits(drooping, "as read"), "bits", "the same without it"),
        verdict.report(f"{name}residue_gain_bits", residue - bits(reading, "counter, preset, with noise"), "bits",
                       "510 clocks, noise on: gain of a ramp of 16 clocks"),
    ]  # fmt: skip
    for f in CLOCKS_HZ:
        end, clock = waiting_ends(gates, f), f"{1e-6 * f:g}mhz"
        note = f"{end.bits:.2f} bits; twice as long gains less than a quarter of a bit"
        rows.append(verdict.report(f"{name}waiting_ends_clocks.{clock}", end.gate_clocks, "clocks", note))
    return rows
