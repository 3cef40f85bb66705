# SPDX-License-Identifier: Apache-2.0
"""Exact counts for hard cases: slow, obvious walks in integers, rationals or fifty digits.

Nothing is shared with the loops and formulas of the engines. `converter_walk.walk_reference`, the
walk in fifty digits, is the reference of their own tests.

Charge is counted in packets and time in clocks. A reference is an interval: the counts of the walk
with its levels moved by a margin either way, which is what an engine that rounds by less than the
margin may read. Margin 0 is one count.
"""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import mpmath

from dermis.converter.vfc import count_exact
from tb.reference.converter_walk import walk_reference

DIGITS, F_CLK_HZ = 50, 5_000_000

IDEAL: dict[str, Any] = {
    "x": 0, "leak": 0, "w0": Fraction(-1, 2), "packet": 1, "rise": 0, "fall": 0,
    "low": -mpmath.inf, "high": mpmath.inf, "delay": 0, "lag": 0, "across": 0,
}  # fmt: skip
"""The ideal converter, as a cell of `cell_of`."""

# If all other fields are ideal, the walk needs only rationals.
_RATIONAL = frozenset({"x", "w0", "packet", "rise", "fall"})

_LEVELS = ("rise", "fall")
# Beyond this duty every second clock has a one; infinite duties have no walk.
_X_SURE = 1e15


def interval(cell: Mapping[str, Any], clocks: int, late: float = 1.0, margin: float = 0.0) -> tuple[int, int]:
    """Return the least and largest count of a cell (`cell_of`) with its levels moved by `margin` packets.

    A packet follows its decision by `late` clocks: 1, or 1/2 with the latch.
    """
    moves = {Fraction(margin), -Fraction(margin)}
    counts = [_count({**cell, **{name: cell[name] + by for name in _LEVELS}}, clocks, late) for by in moves]
    return min(counts), max(counts)


def _count(cell: Mapping[str, Any], clocks: int, late: float) -> int:
    x = min(max(cell["x"], -_X_SURE), _X_SURE)
    plain = all(cell[name] == IDEAL[name] for name in IDEAL if name not in _RATIONAL)
    if plain and cell["rise"] == cell["fall"]:
        # The latch takes the packet earlier, but before the next sample that may be a one.
        return count_exact(x, clocks, *(cell[n] for n in ("w0", "packet", "rise")))
    return sum(walk_reference({**cell, "x": x}, clocks, late, DIGITS).bits)


def cell_of(x: float, effects: Mapping[str, Any], interface: Mapping[str, Any]) -> dict[str, Any]:
    """Return the converter of a scene with duty `x` in packets and clocks, derived without the package.

    Effects and interface are as in a scene (conveyor_mirror, where stored charge drives the output down).

    An amplifier of gain A behind a capacitor C with 1/R across its input: the output is A / (1 + A) of the capacitor's
    voltage and the input sees 1 / (1 + A) of it, so the charge decays with R C (1 + A). A gain-bandwidth product g lets
    the output follow in 1 / (2 pi g) A / (1 + A). A level in volt is one of the output.
    """
    i0, c_int = Fraction(interface.get("i0_a", 25e-6)), Fraction(interface.get("c_int_f", 5e-12))
    packet_v = i0 / F_CLK_HZ / c_int

    def value(effect: str, key: str) -> Fraction:
        return Fraction(effects[effect][key]) if effect in effects else Fraction(0)

    gain = effects["integrator_gain"]["gain_dc"] if "integrator_gain" in effects else None
    share = Fraction(1) if gain is None else Fraction(gain) / (1 + Fraction(gain))
    level_v = packet_v * share
    window = value("comparator_hysteresis", "v_v")
    cell = dict(IDEAL)
    cell["x"] = Fraction(x) if math.isfinite(x) else x
    cell["w0"] = Fraction(-1, 2) + value("preset_error", "v_v") / packet_v
    cell["packet"] = 1 + value("charge_packet", "packet_error")
    cell["rise"] = (value("comparator_offset", "v_v") + window / 2) / level_v
    cell["fall"] = (value("comparator_offset", "v_v") - window / 2) / level_v
    cell["delay"] = value("comparator_delay", "t_s") * F_CLK_HZ
    if "integrator_range" in effects:
        cell["low"] = -value("integrator_range", "v_max_v") / level_v
        cell["high"] = -value("integrator_range", "v_min_v") / level_v
        cell["w0"] = min(max(cell["w0"], cell["low"]), cell["high"])
    if gain is not None:
        per_clock = 1 / value("integrator_gain", "r_in_ohm") / c_int / F_CLK_HZ
        cell["across"], cell["leak"] = per_clock, per_clock * (1 - share)
    if "integrator_bandwidth" in effects:
        with mpmath.workdps(DIGITS):
            gbw = mpmath.mpf(value("integrator_bandwidth", "gbw_hz"))
            cell["lag"] = mpmath.mpf(share * F_CLK_HZ) / (2 * mpmath.pi * gbw)
    return cell
