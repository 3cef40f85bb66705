# SPDX-License-Identifier: Apache-2.0
"""The event engine: the charge balance of every taxel clock by clock, exact between clocks, no time step.

Between two clocks the current into the integrator is constant on at most three pieces (the packet begins or
ends, the comparator is sampled a delay before the clock), so the charge is a straight line or, with a leak,
one exponential. Either is monotone on a piece: range limits and hysteresis need to be looked at only where
pieces meet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import mpmath
import numba
import numpy as np
from numpy.typing import NDArray

from dermis.array import column_currents
from dermis.engines import Result
from dermis.errors import InputError
from dermis.plan import Plan
from dermis.vfc import W_PRESET

HONOURS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "v_column_offset_v",
        "g_lateral_row_s",
        "g_lateral_column_s",
        "gain",
        "i_offset_a",
        "inv_gain_dc",
        "g_in_s",
        "v_int_max_v",
        "v_int_min_v",
        "packet_error",
        "preset_error_v",
        "v_comp_offset_v",
        "v_hysteresis_v",
        "t_comp_delay_s",
    }
)

# A short gives an infinite current. At this duty any converter saturates, and sums of it stay finite.
_X_MAX = 1e12
_LEAK_MAX = 1e12

_VALUES_AT_ONCE = 1 << 15


@dataclass(frozen=True, eq=False)
class Cells:
    """Converters in packets and clocks, every field [n]: what the loops below run over.

    `x` packets a clock; `leak` fraction of w lost a clock; `w0` start; `packet`; `rise` and `fall` the levels
    at which the comparator goes high and low; `low` and `high` the range of w; `delay` of the comparator in
    clocks, 0..1.
    """

    x: NDArray[np.float64]
    leak: NDArray[np.float64]
    w0: NDArray[np.float64]
    packet: NDArray[np.float64]
    rise: NDArray[np.float64]
    fall: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    delay: NDArray[np.float64]


def run(plan: Plan, progress: Callable[[int], None] | None = None) -> Result:
    """Run a plan.

    Parameters
    ----------
    plan : Plan
    progress : callable, optional
        Called with the number of row slots done so far.

    Returns
    -------
    Result
        codes uint8 [frames, rows, cols]; info["x"] is the duty behind them, info["w_end"] the charge at
        the end of the gate in packets.

    Raises
    ------
    InputError
        The direct interface with finite gain together with impedances that couple its columns.
    """
    _refuse_coupled(plan)
    shape = plan.resistance_ohm.shape
    codes = np.empty(shape, dtype=np.uint8)
    x_all, w_end = np.empty(shape), np.empty(shape)
    base = plan.network(0)
    step = max(1, _VALUES_AT_ONCE // (plan.rows * plan.cols))
    for first in range(0, plan.frames, step):
        part = slice(first, min(first + step, plan.frames))
        g = plan.conductance_s(part)
        x_all[part] = plan.converter.duty(column_currents(base, g))
        counts, w_end[part] = count_cells(
            cells_of(plan, x_all[part], g), plan.timing.gate_clocks, plan.timing.charge_delay_clocks
        )
        codes[part] = np.minimum(counts, plan.timing.code_max)
        if progress is not None:
            progress(part.stop * plan.rows)
    return Result(codes, {"x": x_all, "w_end": w_end})


def _refuse_coupled(plan: Plan) -> None:
    coupled = {"r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm", "g_lateral_row_s"}
    both = coupled & plan.active_fields()
    if plan.topology == "direct" and "inv_gain_dc" in plan.active_fields() and both:
        names = {name for field in both for name in plan.effects_of_field(field)}
        raise InputError(
            plan.scene.path,
            "effects.integrator_gain",
            "on together with " + ", ".join(sorted(names)),
            "one without the other for topology direct in engine event; engine cosim does both",
        )


def cells_of(plan: Plan, x: NDArray[np.float64], g_taxel_s: NDArray[np.float64]) -> Cells:
    """Turn the converters of a plan into packets and clocks, for x and g [frames, rows, cols]."""
    converter = plan.converter
    packet_v = converter.packet_v()
    amplitude = 1.0 / (
        1.0 + converter.inv_gain_dc
    )  # output of the integrator over the voltage of its capacitor
    leak = np.zeros(x.shape)
    if converter.inv_gain_dc.any():
        across = converter.g_in_s
        if plan.topology == "direct":
            # The whole column hangs on the virtual ground, whichever row is driven.
            across = across + np.minimum(g_taxel_s, _LEAK_MAX).sum(axis=1, keepdims=True)
        per_clock = across * converter.inv_gain_dc * amplitude / converter.c_int_f / converter.f_clk_hz
        leak = np.minimum(np.broadcast_to(per_clock, x.shape), _LEAK_MAX)
    limits = np.sort(
        [converter.v_sign * converter.v_int_min_v, converter.v_sign * converter.v_int_max_v], axis=0
    )
    scale = packet_v * amplitude
    start = W_PRESET + converter.preset_error_v / packet_v
    columns = {
        "w0": np.clip(start, limits[0] / scale, limits[1] / scale),
        "packet": 1.0 + converter.packet_error,
        "rise": (converter.v_comp_offset_v + converter.v_hysteresis_v / 2) / scale,
        "fall": (converter.v_comp_offset_v - converter.v_hysteresis_v / 2) / scale,
        "low": limits[0] / scale,
        "high": limits[1] / scale,
        "delay": converter.t_comp_delay_s * converter.f_clk_hz,
    }
    everywhere = {name: np.broadcast_to(value, x.shape) for name, value in columns.items()}
    return Cells(x=np.clip(x, -_X_MAX, _X_MAX), leak=leak, **everywhere)


def count_cells(
    cells: Cells, clocks: int, charge_delay: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Count the ones of `clocks` decisions and return (counts, charge at the end), shaped as `cells.x`.

    A one decided at clock n takes its packet out between clocks n + D and n + D + 1, D = `charge_delay` in
    0..1. A loop exists for each kind of cell: none of them tests for an effect that is off.
    """
    if not 0 < charge_delay <= 1:
        raise ValueError(f"charge_delay = {charge_delay} is outside 0..1")
    flat = [np.ascontiguousarray(getattr(cells, f.name), dtype=float).ravel() for f in fields(Cells)]
    x, leak, w0, packet, rise, fall, low, high, delay = flat
    counts, w_end = np.empty(x.size, dtype=np.int64), np.empty(x.size)
    if leak.any() or np.isfinite(low).any() or np.isfinite(high).any():
        _count_bent(x, leak, w0, packet, rise, fall, low, high, delay, clocks, charge_delay, counts, w_end)
    elif delay.any() or (rise != fall).any():
        _count_straight(x, w0, packet, rise, fall, delay, clocks, charge_delay, counts, w_end)
    else:
        _count_plain(x, w0, packet, rise, clocks, charge_delay, counts, w_end)
    return counts.reshape(cells.x.shape), w_end.reshape(cells.x.shape)


# The loops below are compiled: plain arrays in, results in counts and w_end.


@numba.njit(cache=True)
def _count_plain(x, w0, packet, rise, clocks, charge_delay, counts, w_end):  # type: ignore
    # n * x is rounded once and never summed up, so that this is the closed formula to the last bit. Whenever
    # a decision is open, every packet before it is complete, so the delay of the charge does not enter.
    for i in range(x.size):
        start = rise[i] - w0[i]
        level = start
        ones = 0
        last = False
        before = False
        for n in range(1, clocks + 1):
            before = last
            last = not last and n * x[i] >= level
            if last:
                ones += 1
                level = start + ones * packet[i]
        counts[i] = ones
        gone = ones - last - before * charge_delay
        w_end[i] = w0[i] + (clocks * x[i] - gone * packet[i])


@numba.njit(cache=True)
def _count_straight(x, w0, packet, rise, fall, delay, clocks, charge_delay, counts, w_end):  # type: ignore
    for i in range(x.size):
        sample = 1.0 - delay[i]
        first, second = min(sample, charge_delay), max(sample, charge_delay)
        state = w0[i] >= rise[i]
        old = 0  # ones before q[n-2]
        before = False  # q[n-2]
        last = False  # q[n-1]
        for n in range(1, clocks + 1):
            seen = state
            for point in (first, second, 1.0):
                gone = (
                    old
                    + before * min(point + 1.0 - charge_delay, 1.0)
                    + last * max(point - charge_delay, 0.0)
                )
                w = w0[i] + ((n - 1 + point) * x[i] - gone * packet[i])
                if w >= rise[i]:
                    state = True
                elif w < fall[i]:
                    state = False
                if point == sample:
                    seen = state
            one = seen and not last
            old += before
            before = last
            last = one
        counts[i] = old + before + last
        w_end[i] = w0[i] + (clocks * x[i] - (old + before * (1.0 - charge_delay)) * packet[i])


@numba.njit(cache=True)
def _count_bent(  # type: ignore
    x, leak, w0, packet, rise, fall, low, high, delay, clocks, charge_delay, counts, w_end
):
    for i in range(x.size):
        sample = 1.0 - delay[i]
        first, second = min(sample, charge_delay), max(sample, charge_delay)
        # w after a piece of length h with current c: keep * w + gain * c, with keep = exp(-leak h).
        length = (first, second - first, 1.0 - second)
        keep = (
            math.exp(-leak[i] * length[0]),
            math.exp(-leak[i] * length[1]),
            math.exp(-leak[i] * length[2]),
        )
        if leak[i] > 0:
            gain = (
                -math.expm1(-leak[i] * length[0]) / leak[i],
                -math.expm1(-leak[i] * length[1]) / leak[i],
                -math.expm1(-leak[i] * length[2]) / leak[i],
            )
        else:
            gain = length
        w = w0[i]
        state = w >= rise[i]
        before = False  # q[n-2]
        last = False  # q[n-1]
        ones = 0
        for _ in range(clocks):
            seen = state
            for piece in range(3):
                point = first if piece == 0 else (second if piece == 1 else 1.0)
                charging = before if point <= charge_delay else last
                w = keep[piece] * w + gain[piece] * (x[i] - charging * packet[i])
                w = min(max(w, low[i]), high[i])
                if w >= rise[i]:
                    state = True
                elif w < fall[i]:
                    state = False
                if point == sample:
                    seen = state
            one = seen and not last
            before = last
            last = one
            ones += one
        counts[i] = ones
        w_end[i] = w


def walk_reference(
    cell: dict[str, float], clocks: int, charge_delay: float, digits: int = 50
) -> tuple[list[bool], list[mpmath.mpf]]:
    """Bits and the charge at every clock of one cell in `digits` decimal digits: the slow reference.

    `cell` has the keys of `Cells`. The packets are kept as a list of intervals, and the walk stops at every
    instant where anything can change; nothing is shared with the loops above.
    """
    with mpmath.workdps(digits):
        one, zero = mpmath.mpf(1), mpmath.mpf(0)
        c = {name: mpmath.mpf(value) for name, value in cell.items()}
        late = mpmath.mpf(charge_delay)
        now, w = zero, c["w0"]
        is_high = w >= c["rise"]
        packets: list[tuple[mpmath.mpf, mpmath.mpf]] = []
        bits: list[bool] = []
        charge: list[mpmath.mpf] = []
        for n in range(1, clocks + 1):
            sample = n - c["delay"]
            edges = {t for begin, end in packets[-2:] for t in (begin, end) if now < t < n}
            seen = is_high
            for until in sorted(edges | {sample, mpmath.mpf(n)}):
                middle = (now + until) / 2
                current = c["x"]
                current -= sum((c["packet"] for begin, end in packets[-2:] if begin < middle < end), zero)
                if c["leak"] > 0:
                    rest = current / c["leak"]
                    w = rest + (w - rest) * mpmath.exp(-c["leak"] * (until - now))
                else:
                    w += current * (until - now)
                w = min(max(w, c["low"]), c["high"])
                if w >= c["rise"]:
                    is_high = True
                elif w < c["fall"]:
                    is_high = False
                if until == sample:
                    seen = is_high
                now = until
            bits.append(bool(seen and not (bits and bits[-1])))
            if bits[-1]:
                packets.append((n + late, n + late + one))
            charge.append(w)
        return bits, charge
