# SPDX-License-Identifier: Apache-2.0
"""The synchronized voltage-to-frequency converter: charge balance as a formula, and its exact slow twin.

Charge is counted in packets (one packet = i0 / f_clk). w is the stored charge, x = iD / i0 what one
clock adds, and

    w at clock n already includes x ;  q[n] = (w >= threshold) and not q[n-1] ;  then w -= packet * q[n]

starting from w0 = -1/2 when the preset is released (docs/scenes.md, "Converter convention").
"""

import dataclasses
import functools
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.ndarrays import Floats

W_PRESET = -0.5
# Clocks of the longest gate that the chip can be told (16 bits). N x in a double rounds by 7e-12 packet at most there,
# and so does a charge that is summed up clock by clock.
LONGEST_GATE = 1 << 16
# Floor of the slow mirror's output (Converter.q_mirror_c), in packets a clock: leakage that lets it wake up.
Y_MIN = 1e-6
# A short gives an infinite current. At this duty any converter saturates, and sums of it stay finite.
X_MAX = 1e12
# Packets a clock of an infinite current among the coefficients of functions of time: so far out that no
# current of numbers is cut short, which would bend the course it takes; sums and products of it stay finite.
X_INFINITE = 1e100
_SWING_PACKETS = 1.5  # the stored charge stays within -1 .. 1 below x = 1/2

# Structural: they say what converter it is, not how it departs from the ideal one.
_STRUCTURE = frozenset({"k", "i0_a", "c_int_f", "f_clk_hz", "v_sign"})


@dataclass(frozen=True, eq=False)
class Converter:
    """The converters of one row of columns; every field but f_clk_hz is an array [cols].

    The defaults are the ideal converter. Volts are counted in the direction of the stored charge:
    plus means that more charge is needed (thresholds) or is there (preset), whatever the sign of
    the topology. `v_sign` turns that into the voltage of the integrator: v_int = v_sign * w *
    packet_v().
    """

    k: Floats
    i0_a: Floats
    c_int_f: Floats
    f_clk_hz: float
    v_sign: float = -1.0
    gain: ArrayLike = 1.0  # of iD
    i_offset_a: ArrayLike = 0.0  # adds to iD, after the mirror
    inv_gain_dc: ArrayLike = 0.0  # 1 / open-loop gain of the integrator
    g_in_s: ArrayLike = 0.0  # conductance across the integrator's input
    v_int_max_v: ArrayLike = np.inf  # range of the integrator's output; charge beyond it is lost
    v_int_min_v: ArrayLike = -np.inf
    packet_error: ArrayLike = 0.0  # relative
    preset_error_v: ArrayLike = 0.0
    v_comp_offset_v: ArrayLike = 0.0
    v_hysteresis_v: ArrayLike = 0.0  # full width of the window
    t_comp_delay_s: ArrayLike = 0.0
    inv_i_range_a: ArrayLike = 0.0  # 1/A: the column current i becomes i / (1 + |i| inv_i_range_a)
    q_mirror_c: ArrayLike = (
        0.0  # mirror output y follows its settled value x: dy/dt = y (x - y) i0 / q_mirror
    )
    t_gbw_s: ArrayLike = 0.0  # 1 / (2 pi gain-bandwidth product) of the integrator
    v_comp_noise_v: ArrayLike = 0.0  # rms, every decision anew
    t_meta_s: ArrayLike = 0.0  # samples this close to the level, in time, are decided by a coin
    t_jitter_s: ArrayLike = 0.0  # rms, every clock edge anew
    kt_noise_j: ArrayLike = 0.0  # k_B T of the noise of the conductances on a column, times a factor
    q_shot_c: ArrayLike = 0.0  # charge quantum of shot noise, of the input and of the packets
    v_preset_noise_v: ArrayLike = 0.0  # rms, every slot anew
    packet_flicker: ArrayLike = 0.0  # relative rms of the packet, every slot anew

    def __post_init__(self) -> None:
        cols = np.size(self.k)
        ideal, given = _ideal(type(self), cols), vars(self)
        for name, default in _arrays(type(self)).items():
            value = given[name]
            if value is default:
                # Most fields of most converters: one array for all that are alike.
                array = ideal[name]
            elif _fixed(value, cols):
                array = value
            else:
                array = np.empty(cols)
                array[:] = value
                array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def cols(self) -> int:
        """Number of columns."""
        return self.k.shape[0]

    @property
    def t_clk_s(self) -> float:
        """Clock period in seconds."""
        return 1.0 / self.f_clk_hz

    def packet_v(self) -> Floats:
        """One ideal packet as a voltage on c_int_f, [cols]."""
        return self.i0_a / self.f_clk_hz / self.c_int_f

    def range_v(self) -> Floats:
        """Lower and upper end of the charge as a voltage on c_int_f, [2, cols]: the output's, by the sign of charge."""
        ends = self.v_sign * self.v_int_min_v, self.v_sign * self.v_int_max_v
        return np.array([np.minimum(*ends), np.maximum(*ends)])

    def range_clips(self) -> bool:
        """Return True if the range of an integrator is so small that it loses charge in normal use."""
        room = np.minimum(self.v_int_max_v, -self.v_int_min_v)
        # A range of exactly _SWING_PACKETS, up to rounding, is enough.
        return bool(np.any(room < _SWING_PACKETS * self.packet_v() * (1.0 - 1e-9)))

    def saturating_duty(self) -> Floats:
        """Return the duty [cols] beyond which every code is saturated."""
        return X_MAX * np.maximum(1.0 + self.packet_error, 1.0)

    def duty(self, i_column_a: ArrayLike) -> Floats:
        """x = (gain * i / k + i_offset) / i0 of column currents [..., cols] in ampere, i compressed first."""
        i_column = np.asarray(i_column_a, dtype=float)
        if self.inv_i_range_a.any():
            # 1 / (1/|i| + a) is |i| / (1 + |i| a) and has a limit for a short, and for what is next to nothing.
            with np.errstate(divide="ignore", over="ignore"):
                i_column = np.copysign(
                    np.divide(1.0, np.divide(1.0, np.abs(i_column)) + self.inv_i_range_a), i_column
                )
        with np.errstate(over="ignore"):  # a short may drive it to inf
            return (self.gain * i_column + self.k * self.i_offset_a) / (self.k * self.i0_a)

    def active_fields(self) -> frozenset[str]:
        """Return the names of the fields that are away from the ideal."""
        ideal, given = _ideal(type(self), self.cols), vars(self)
        active = {
            name
            for name, default in _arrays(type(self)).items()
            if name not in _STRUCTURE
            and given[name] is not ideal[name]
            and (given[name][0] != default or (given[name] != default).any())
        }
        if "inv_gain_dc" not in active and "t_gbw_s" not in active:
            active.discard("g_in_s")  # no voltage across it, no current in it
        return frozenset(active)


@functools.cache
def _arrays(kind: type[Converter]) -> dict[str, Any]:
    """Fields with a value a column, and their defaults."""
    return {f.name: f.default for f in dataclasses.fields(kind) if f.name not in ("f_clk_hz", "v_sign")}


@functools.lru_cache(maxsize=64)
def _ideal(kind: type[Converter], cols: int) -> dict[str, Floats]:
    """Arrays of the defaults."""
    found = {}
    for name, default in _arrays(kind).items():
        if default is not dataclasses.MISSING:
            found[name] = np.full(cols, default)
            found[name].flags.writeable = False
    return found


def _fixed(value: ArrayLike, cols: int) -> bool:
    """Return True for an array of another converter, which nobody can change."""
    return (
        isinstance(value, np.ndarray)
        and value.base is None
        and not value.flags.writeable
        and value.shape == (cols,)
        and value.dtype == float
    )


def count_exact(
    x: Fraction | int | float,
    clocks: int,
    w0: Fraction | int | float = Fraction(-1, 2),
    packet: Fraction | int | float = 1,
    threshold: Fraction | int | float = 0,
) -> int:
    """Count the ones of `clocks` decisions, walking through them in exact rationals: the slow reference.

    Parameters
    ----------
    x : packets added a clock; a float is taken at its exact binary value
    clocks : number of decisions
    w0 : charge before the first clock, in packets
    packet, threshold : what a one takes away, and the level of the decision, in ideal packets
    """
    x, w, packet, threshold = Fraction(x), Fraction(w0), Fraction(packet), Fraction(threshold)
    ones, last = 0, False
    for _ in range(clocks):
        w += x
        last = w >= threshold and not last
        w -= packet * last
        ones += last
    return ones


def count_rational(
    x: Fraction | float,
    clocks: int,
    w0: Fraction | float = Fraction(-1, 2),
    packet: Fraction | float = 1,
    threshold: Fraction | float = 0,
) -> int:
    """Count by the closed formula in exact rationals; arguments as of `count_exact`, also an infinite x.

    Over N clocks of packets of 1 the count differs from N x <= N / 2 by less than 1, and two windows of equal length
    differ by at most 1.
    """
    every_second = (clocks + 1) // 2
    if math.isinf(x):
        return every_second if x > 0 else 0
    x, p, s = Fraction(x), Fraction(packet), Fraction(threshold) - Fraction(w0)
    if x < 0:
        return min(every_second, max(0, math.floor((x - s) / (p - 2 * x)) + 1)) if x >= s else 0
    if 2 * x <= p:
        return min(every_second, max(0, math.floor((clocks * x - s) / p) + 1))
    first = max(1, math.ceil(s / x))
    return (clocks - first) // 2 + 1 if first <= clocks else 0


def count(
    x: ArrayLike,
    clocks: int = 510,
    w0: ArrayLike = W_PRESET,
    packet: ArrayLike = 1.0,
    threshold: ArrayLike = 0.0,
) -> NDArray[np.int64]:
    """Count of the closed formula in doubles, any shape.

    Parameters
    ----------
    x : packets a clock; -inf..inf, no NaN
    clocks : decisions in the gate, N
    w0, packet, threshold : as in `count_exact`; packet > 0

    Notes
    -----
    Let s = threshold - w0 be what must be gathered before the first one, p the packet. Decision n sees n x against
    s + m p after m ones.

    - 0 <= x <= p/2: F = floor((N x - s) / p) + 1 ones are paid for by clock N. Levels s + m p are then met at least
      two clocks apart, so the gating by the last one acts only on a start above the threshold: ones at clocks
      1, 3, 5 ... until the first odd clock where the charge does not suffice; from there on F is met again. In
      both stretches the count is min(F, ceil(N / 2)), or 0 where F is negative.
    - x > p/2: two clocks bring more than a one takes, so after the first, at the lowest n with n x >= s, every
      second clock has a one.
    - x < 0: the charge only falls. Ones come at clocks 1, 3 ... 2 k + 1 as long as (2 k + 1) x >= s + k p, that is
      for k <= (x - s) / (p - 2 x), and never again.

    N x is rounded once, so the float version may differ from `count_exact` only where N x - s lies within
    ulp(N x) / 2 of a multiple of p, i.e. the force within 1.2e-16 relative of a decision threshold. With w0 = -1/2,
    x = c / N is half a count away from any. Gates beyond LONGEST_GATE are reckoned in integers, number by number: no
    length of time erodes them.
    """
    x, w0, packet, threshold = np.broadcast_arrays(
        *(np.asarray(a, dtype=float) for a in (x, w0, packet, threshold))
    )
    if np.isnan(x).any():
        raise ValueError("x is not a number")
    if not (packet > 0).all():
        raise ValueError("packet must be above 0")
    if clocks > LONGEST_GATE:
        each = np.vectorize(lambda x, *start: count_rational(x, clocks, *start), otypes=[np.int64])
        return each(x, w0, packet, threshold)
    found = np.empty(x.size, dtype=np.int64)
    from dermis.converter.vfc_loops import count_all  # numba takes 0.4 s to load

    count_all(x.ravel(), clocks, (threshold - w0).ravel(), packet.flatten(), found)
    return found.reshape(x.shape)


def code(x: ArrayLike, clocks: int = 510, code_max: int = 255, **start: ArrayLike) -> NDArray[np.int64]:
    """Return min(code_max, count), the state of the saturating counter at the end of the gate."""
    return np.minimum(count(x, clocks, **start), code_max)


def code_type(code_max: int) -> type[np.unsignedinteger]:
    """Type that holds the codes: bytes, or two of them where the design has more than 8 bits."""
    return np.uint8 if code_max < 256 else np.uint16


def count_restarting(x: ArrayLike, clocks: int = 512) -> NDArray[np.int64]:
    """Count of the paper's eq. (3): every cycle restarts at the threshold and lasts ceil(1/x) whole clocks.

    A different machine from charge balance, kept to show both. Over N clocks it gives ceil(N /
    ceil(1/x)) pulses with the first at clock 0; x = 0 gives 0 and no cycle is shorter than two
    clocks.

    1/x within 1e-12 relative of an integer is taken as that integer: R = n * 250 ohm is meant to be
    on the step.
    """
    x = np.asarray(x, dtype=float)
    if not (x >= 0).all():
        raise ValueError("x must be 0 or above")
    with np.errstate(divide="ignore", over="ignore"):
        period = np.divide(1.0, x)
    whole = np.round(np.where(np.isfinite(period), period, 0.0))
    # See the notes: one division has rounded.
    near = np.abs(period - whole) <= 1e-12 * whole
    period = np.maximum(np.where(near, whole, np.ceil(period)), 2.0)
    return np.ceil(clocks / period).astype(np.int64)
