# SPDX-License-Identifier: Apache-2.0
"""Run hard duties and converters in each engine, whole gates, against the exact counts of
tb/reference/exact.py.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.chip import hdl
from dermis.converter import vfc, walk
from dermis.engines import closed, cosim, event, rtl
from dermis.records import Plan
from dermis.scene import scene
from tb.programs.hard.case import Measured
from tb.reference import exact

Floats = NDArray[np.float64]

COLS = 8
"""Columns of a chip of one row, so that few builds serve every case; duties fill its frames."""

GATE, FULL = 510, 255

# A decision at clock n depends on n sums, each rounded by half an ulp of a charge below 2.
_SUMS = 2.0**-53
# The coefficients of a clock (exponentials and their integrals) are right to a few ulp each, and a
# whole gate of them to 1e-12 of a packet.
_LOOPS = 1e-12
# spec.toml, cosim.edge_error_v: 1e-6 V where a packet is 0.1 V.
_SPICE = 1e-5


@dataclass(frozen=True)
class World:
    """Duties at the input of one kind of converter.

    Parameters
    ----------
    x : tuple of float
        Packets a clock; their binary values are exact.
    effects, interface : mapping
        As in a scene.
    analog : tuple of float
        Fewer duties for ngspice; default all.
    gate, rows : int
        Clocks; rows of the chip.
    latch : bool
        The flip-flop + latch synchronizer: the packet begins half a clock after its decision.
    exactly : bool
        No margin for rounding: the arithmetic of this case is exact in doubles.
    """

    x: tuple[float, ...]
    effects: Mapping[str, Any] = field(default_factory=dict)
    interface: Mapping[str, Any] = field(default_factory=dict)
    analog: tuple[float, ...] = ()
    gate: int = GATE
    rows: int = 1
    latch: bool = False
    exactly: bool = False

    @property
    def late(self) -> float:
        """Clocks from a decision to its packet."""
        return 0.5 if self.latch else 1.0

    def margin(self, engine: str, x: float) -> float:
        """Return the largest distance of an engine's levels from the exact ones, in packets."""
        if engine == "cosim":
            return _SPICE
        if self.exactly:
            return 0.0
        if self.effects:
            return _LOOPS
        reach = max(1.0, abs(x)) if np.isfinite(x) else 1.0
        # closed: N x and the difference to the start, an ulp of the larger; the loops: a sum a
        # clock.
        return (2.0 * self.gate if engine == "closed" else self.gate) * _SUMS * reach


def make_plan(world: World, engine: str, cols: int = COLS) -> tuple[Plan, Floats]:
    """Return a plan of open taxels, and the duties that replace them, [frames, rows, cols]."""
    frames = -(-len(world.x) // (world.rows * cols))
    data = {
        "array": {"rows": world.rows, "cols": cols},
        "stimulus": {"kind": "uniform", "code": [0] * frames},
        "interface": dict(world.interface),
        "effects": {name: dict(value) for name, value in world.effects.items()},
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), engine)
    timing = dataclasses.replace(
        made.timing,
        gate_clocks=world.gate,
        slot_clocks=made.timing.settle_clocks + world.gate,
        charge_delay_clocks=world.late,
    )
    x = np.zeros(frames * world.rows * cols)
    x[: len(world.x)] = world.x
    return dataclasses.replace(made, timing=timing), x.reshape(frames, world.rows, cols)


# ---- engines -------------------------------------------------------------------------------------------------


def _closed(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "closed")
    return closed.codes_of(made, made.converter.gain * x)


def _event(world: World) -> NDArray[Any]:
    return event.codes_of(*make_plan(world, "event"))


# Parameters of the Verilator build with all effects; an effect that is off has its neutral
# value. (DELAY has none: without it the comparator is sampled at the clock.)
_EVERY = ("PACKET", "W_PRESET", "RISE", "FALL", "W_LOW", "LEAK")


def _rtl(world: World, simulator: str) -> NDArray[Any]:
    made, x = make_plan(world, "rtl")
    bits = rtl.effect_bits(made)
    if bits and simulator == "verilator":
        bits |= sum(1 << rtl.value_places()[name] for name in _EVERY)
    most = made.converter.saturating_duty()
    currents = rtl.Currents(np.clip(x, -most, most)[..., np.newaxis], np.ones((1, 1)))
    with hdl.work_directory("rtl_runs", made, None) as files:
        command = rtl.build(made, bits, currents, simulator, world.latch)
        rtl.write_inputs(made, slice(0, made.frames), files, currents, bits, world.latch)
        return rtl.simulate(made, command, files, made.frames, lambda rows: None)


def _cosim(world: World) -> NDArray[Any]:
    made, x = make_plan(world, "cosim", cols=min(4, len(world.x) // world.rows))
    unit_ohm = made.v_bias_v / float(made.converter.k[0] * made.converter.i0_a[0])
    with np.errstate(divide="ignore", over="ignore"):
        made = dataclasses.replace(made, resistance_ohm=np.divide(unit_ohm, np.abs(x)), force_n=None)
    return cosim.run(made, sync_latch=world.latch).codes


ENGINES: dict[str, Callable[[World], NDArray[Any]]] = {
    "closed": _closed,
    "event": _event,
    "icarus": lambda world: _rtl(world, "icarus"),
    "verilator": lambda world: _rtl(world, "verilator"),
    "cosim": _cosim,
}

# Icarus takes 40 ms for eight duties: of longer lists every fifth, which is prime to the pairs and
# triples in them.
_MANY, _EVERY_SO_MANY = 200, 5


def codes(engine: str, *worlds: World) -> Measured:
    """Return the largest error of an engine in codes outside the interval of the exact walk; ngspice
    takes the first and the last world.
    """
    worst, where, near = 0, "", 0
    for world in (worlds[0], *worlds[1:][-1:]) if engine == "cosim" else worlds:
        if engine == "icarus" and len(world.x) > _MANY:
            world = dataclasses.replace(world, x=world.x[::_EVERY_SO_MANY])
        if engine == "cosim" and world.analog:
            world = dataclasses.replace(world, x=world.analog)
        found = ENGINES[engine](world).reshape(-1)[: len(world.x)].astype(int)
        for x, code in zip(world.x, found, strict=True):
            cell = exact.cell_of(x, world.effects, world.interface)
            low, high = exact.interval(cell, world.gate, world.late)
            if code != min(low, FULL):
                low, high = exact.interval(cell, world.gate, world.late, world.margin(engine, x))
                near += 1
            miss = max(min(low, FULL) - code, code - min(high, FULL), 0)
            if miss > worst:
                worst, where = (
                    miss,
                    f"x = {x!r}: {code}, exactly {low}" + (f" to {high}" if high > low else ""),
                )
    return Measured(float(worst), where or (f"{near} within rounding of a level" if near else ""))


# ---- converters below scenes, long gates -------------------------------------------------------------------------


def loop(cells: Mapping[str, Sequence[float]], clocks: int) -> tuple[NDArray[Any], Floats]:
    """Return counts and charges of cells (fields of walk.Cells; the others ideal) by the loops of
    engine event.
    """
    size = max(len(values) for values in cells.values())
    ideal = {"w0": -0.5, "packet": 1.0, "low": -np.inf, "high": np.inf}
    whole = {
        f.name: np.array(cells.get(f.name, [ideal.get(f.name, 0.0)] * size), dtype=float)
        for f in dataclasses.fields(walk.Cells)
    }
    return walk.count_cells(walk.Cells(**whole), clocks, 1.0)


def cells(fields: Mapping[str, float], duties: Sequence[float]) -> Measured:
    """Compare counts of converters given in packets and clocks with the walk in fifty digits."""
    found, _ = loop({"x": duties, **{name: [value] * len(duties) for name, value in fields.items()}}, GATE)
    expected = [exact.interval({**exact.IDEAL, **fields, "x": Fraction(x)}, GATE)[0] for x in duties]
    return Measured(float(np.abs(found - expected).max()), f"{found.tolist()}, exactly {expected}")


def windows(length: int, times: int) -> Measured:
    """Compare counts of successive windows of one duty with the walk, and with each other."""
    duties = [0.1, 1 / 3, math.sqrt(2) / 3, 123 / 510, 0.4999]
    ends = np.array([loop({"x": duties}, length * n)[0] for n in range(1, times + 1)])
    counts = np.diff(ends, axis=0, prepend=0)
    walk = [np.reshape([*vfc.bits_exact(x, length * times)], (times, length)).sum(axis=1) for x in duties]
    apart = np.abs(counts - np.array(walk, dtype=int).T).max()
    return Measured(
        float(max(apart, np.ptp(counts, axis=0).max() - 1)), f"{times} windows of {length} clocks"
    )


def locking(periods: Sequence[int], keep: Fraction, clocks: int, nudge: float) -> Measured:
    """Compare counts at both edges of every plateau p/q, inside and outside by `nudge`, with fifty
    digits.

    The leak is the double nearest to -log(keep), for the walk as well, so only the loop's
    rounding remains.
    """
    with mpmath.workdps(exact.DIGITS):
        leak = float(-mpmath.log(mpmath.mpf(keep.numerator) / keep.denominator))
        lam = mpmath.exp(-mpmath.mpf(leak))
        rational = Fraction(int(mpmath.floor(lam * 2**160)), 2**160)
        places = [
            (float(edge) * (1 + side * nudge), p, q, side == inward)
            for q in periods
            for p, _ in exact.locked(q)
            for edge, inward in zip(exact.plateau(p, q, rational), (1, -1), strict=True)
            for side in (inward, -inward)
        ]
        duties, same = [place[0] for place in places], [leak] * len(places)
        found, _ = loop({"x": duties, "leak": same, "across": same}, clocks)
        worst, where, outside = 0, "", 0
        for (x, p, q, inside), count in zip(places, found, strict=True):
            bits = exact.leaky_bits(mpmath.mpf(x), lam, clocks, mpmath.mpf(-0.5))
            settled = clocks // 2 // q * q  # whole periods, when the start no longer matters
            locks = sum(bits[-settled:]) == settled // q * p
            if inside and not locks:
                return Measured(math.nan, f"the walk does not lock to {p}/{q} inside its plateau")
            outside += not inside and not locks
            miss = abs(int(count) - sum(bits))
            if miss > worst:
                worst, where = miss, f"x = {x!r}: {count}, exactly {sum(bits)}"
    return Measured(
        float(worst), where or f"{outside} of {len(duties) // 2} outside unlock in {clocks} clocks"
    )


def many_clocks(engine: str, clocks: int, duties: Sequence[float]) -> Measured:
    """Return the largest error of the count, and of the remaining charge, after very many clocks."""
    found, rest = loop({"x": duties}, clocks) if engine == "event" else (vfc.count(duties, clocks), None)
    worst = 0.0
    for i, x in enumerate(duties):
        ones, charge = exact.count_and_rest(x, clocks)
        worst = max(worst, float(abs(int(found[i]) - ones)))
        if rest is not None:
            # The packet of a one in the last two clocks is still in the integrator.
            away = abs(Fraction(float(rest[i])) - charge)
            worst = max(worst, float(min(away, abs(away - 1))))
    return Measured(worst, f"{len(duties)} duties of {clocks:.0e} clocks")


# ---- ripple and jitter -------------------------------------------------------------------------------------------


def ripple(frame: int) -> Measured:
    """Compare the mean duty of two rows under supply ripple in a late frame with fifty digits."""
    relative, hertz, degrees = 0.9, 100003.0, 30.0
    data = {
        "array": {"rows": 2, "cols": 1},
        "stimulus": {"kind": "uniform", "code": [100]},
        "effects": {"supply_ripple": {"relative": relative, "frequency_hz": hertz, "phase_deg": degrees}},
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), "event")
    found = event.run(dataclasses.replace(made, first_frame=frame)).info["x"].ravel()
    timing, worst = made.timing, 0.0
    duty = Fraction(made.v_bias_v) / (80 * Fraction(25e-6) * Fraction(float(made.resistance_ohm[0, 0, 0])))
    turns_a_clock = Fraction(hertz) / Fraction(timing.f_clk_hz)
    with mpmath.workdps(exact.DIGITS):
        for row in range(2):
            clock = (frame * 2 + row) * timing.slot_clocks + timing.settle_clocks
            begin = (clock * turns_a_clock) % 1
            turns = (begin, begin + timing.gate_clocks * turns_a_clock)
            first, last = (
                2 * mpmath.pi * mpmath.mpf(t.numerator) / t.denominator + mpmath.radians(degrees)
                for t in turns
            )
            swing = (mpmath.cos(first) - mpmath.cos(last)) / (last - first)
            mean = mpmath.mpf(duty.numerator) / duty.denominator * (1 + mpmath.mpf(relative) * swing)
            worst = max(worst, abs(float(mean - mpmath.mpf(found[row]))))
    return Measured(worst)


def jitter(t_s: float) -> Measured:
    """Compare mean and spread of codes under jitter with a walk from edge to edge, in standard
    errors.
    """
    frames, duty, unit_ohm = 40, 100.3 / GATE, 250.0
    data = {
        "array": {"rows": 8, "cols": 16},
        "stimulus": {"kind": "uniform", "r_ohm": [unit_ohm / duty] * frames},
        "effects": {"clock_jitter": {"t_s": t_s}},
        "run": {"seed": 11},
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), "event")
    found = event.run(made).codes.ravel().astype(float)
    rng = np.random.default_rng(12)
    edges = np.arange(GATE + 3) + t_s * made.timing.f_clk_hz * rng.standard_normal((found.size, GATE + 3))
    ones, taken = np.zeros(found.size), np.zeros(found.size)
    q = np.zeros((3, found.size))  # of this clock and of the two before
    for n in range(1, GATE + 1):
        # A one of clock n - 2 has its packet from edge n - 1 to this edge; that of n - 1 begins
        # here.
        taken += q[1] * (edges[:, n] - edges[:, n - 1])
        bit = (-0.5 + duty * edges[:, n] - taken >= 0) & (q[0] == 0)
        q = np.stack([bit.astype(float), q[0], q[1]])
        ones += bit
    apart = abs(found.mean() - ones.mean()) / (math.hypot(found.std(), ones.std()) / math.sqrt(found.size))
    # The variance of a variance: 2 v^2 / n for either.
    v = found.var(), ones.var()
    wider = abs(v[0] - v[1]) / math.sqrt(2 * (v[0] ** 2 + v[1] ** 2) / found.size)
    note = f"{found.mean():.3f} +- {found.std():.3f} codes, from edge to edge {ones.mean():.3f} +- {ones.std():.3f}"
    return Measured(float(max(apart, wider)), note)
