# SPDX-License-Identifier: Apache-2.0
"""The charge balance of one converter in fifty digits: the slow reference of engine event."""

from collections.abc import Callable
from typing import NamedTuple

import mpmath
from mpmath import mpf


class Draws(NamedTuple):
    """The noise of one cell in full: nothing is left out because it cannot matter."""

    slow: list[float]  # sigma W(n), n = 1 ..
    sample: list[float]  # shift of the level of sample n alone
    coin: list[bool]
    aperture: float


class Walk(NamedTuple):
    """Bits, the charge at every clock, and the least distance of the output from a level."""

    bits: list[bool]
    charge: list[mpf]
    nearest: float


def walk_reference(
    cell: dict[str, float],
    clocks: int,
    charge_delay: float,
    digits: int = 50,
    draws: Draws | None = None,
) -> Walk:
    """Return bits and the charge at every clock of one cell in `digits` decimal digits.

    `cell` has the keys of `Cells`. The packets are kept as a list of intervals, and the walk stops at
    every instant where anything can change; nothing is shared with the loops.
    """
    with mpmath.workdps(digits):
        one, zero = mpf(1), mpf(0)
        c = {name: mpf(value) for name, value in cell.items()}
        late = mpf(charge_delay)
        now, w, v = zero, c["w0"], c["w0"]
        is_high = v >= c["rise"]
        packets: list[tuple[mpf, mpf]] = []
        bits: list[bool] = []
        charge: list[mpf] = []
        nearest = mpmath.inf
        for n in range(1, clocks + 1):
            slow, alone = (zero, zero) if draws is None else (mpf(d[n - 1]) for d in draws[:2])
            rise, fall = c["rise"] - slow, c["fall"] - slow
            sample = n - c["delay"]
            edges = {t for begin, end in packets[-2:] for t in (begin, end) if now < t < n}
            seen, at_sample, active = is_high, v, fall if is_high else rise
            for until in sorted(edges | {sample, mpf(n)}):
                middle = (now + until) / 2
                current = c["x"] - sum(
                    (c["packet"] for begin, end in packets[-2:] if begin < middle < end), zero
                )
                way = _way(c, w, v, current)
                for time in [*_turns(c, w, v, current, until - now), until - now]:
                    w_then, v_then = way(time)
                    if time == until - now and not c["low"] <= w_then <= c["high"]:
                        limit = c["high"] if w_then > c["high"] else c["low"]
                        w_then, v_then = _stopped(c, way, limit, w, v, until - now)
                    nearest = min(nearest, abs(v_then - rise), abs(v_then - fall))
                    if v_then >= rise:
                        is_high = True
                    elif v_then < fall:
                        is_high = False
                w, v = w_then, v_then
                if until == sample:
                    at_sample = v + alone
                    nearest = min(nearest, abs(at_sample - rise), abs(at_sample - fall))
                    seen = is_high
                    if alone != 0:
                        seen = True if at_sample >= rise else (False if at_sample < fall else is_high)
                now = until
            if draws is not None and abs(at_sample - active) < draws.aperture:
                seen = draws.coin[n - 1]
            bits.append(bool(seen and not (bits and bits[-1])))
            if bits[-1]:
                packets.append((n + late, n + late + one))
            charge.append(w)
        return Walk(bits, charge, float(nearest))


_Way = Callable[[mpf], tuple[mpf, mpf]]


def _way(c: dict[str, mpf], w: mpf, v: mpf, current: mpf) -> _Way:
    """Return (w, v) as a function of time at a constant current, limits aside."""
    if c["lag"] == 0:
        rates, start = [(-c["leak"], current - c["leak"] * w)], w
    else:
        # v'' + v' (1 / lag + across) + v leak / lag = current / lag
        b, d = 1 / c["lag"] + c["across"], c["leak"] / c["lag"]
        root = mpmath.sqrt(b * b - 4 * d)
        fast = (-b - root) / 2
        slow = d / fast
        slope = (w - v) / c["lag"]
        share = (current / c["lag"] - b * slope - d * v - fast * slope) / root
        rates, start = [(slow, share), (fast, slope - share)], v

    def way(t: mpf) -> tuple[mpf, mpf]:
        parts = [(size, rate, mpmath.exp(rate * t)) for rate, size in rates]
        at = start + sum(size * ((e - 1) / rate if rate else t) for size, rate, e in parts)
        return at + c["lag"] * sum(size * e for size, _, e in parts), at

    return way


def _turns(c: dict[str, mpf], w: mpf, v: mpf, current: mpf, length: mpf) -> list[mpf]:
    """Return the times inside a piece at which the output turns: w = v there."""
    if c["lag"] == 0:
        return []
    way = _way(c, w, v, current)

    def apart(t: mpf) -> mpf:
        at = way(t)
        return at[0] - at[1]

    if apart(mpf(0)) * apart(length) >= 0 or not c["low"] <= way(length)[0] <= c["high"]:
        return []
    return [_root(apart, length)]


def _stopped(c: dict[str, mpf], way: _Way, limit: mpf, w: mpf, v: mpf, length: mpf) -> tuple[mpf, mpf]:
    """Return the end of a piece whose charge stops at a limit; the output settles towards it."""
    if c["lag"] == 0:
        return limit, limit
    end = way(length)[0]
    hit = mpf(0)
    if (w - limit) * (end - limit) < 0:
        hit = _root(lambda t: way(t)[0] - limit, length)
        v = way(hit)[1]
    return limit, limit + (v - limit) * mpmath.exp(-(length - hit) / c["lag"])


def _root(f: Callable[[mpf], mpf], length: mpf) -> mpf:
    """Return where f changes its sign between 0 and a length."""
    # 33 digits are far beyond a double.
    return mpmath.findroot(f, (0, length), solver="illinois", tol=1e-33, maxsteps=110, verify=False)
