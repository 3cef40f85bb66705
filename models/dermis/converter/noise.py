# SPDX-License-Identifier: Apache-2.0
"""Random numbers that depend on their purpose and place alone (docs/event.md, "Noise").

A number is a hash of (seed, stream, frame, row, column, counter), the output function of SplitMix64 (Steele, Lea &
Flood 2014) over a Weyl sequence that begins at a mixed key; normals come from it by the inverse of the distribution
function (Wichura, AS241), so one draw is one number. There is no state: one that is never needed costs nothing.

Slow noise is a Brownian path a cell, W(0) = 0, of variance 1 a clock. It is drawn by halves: W at the end of the gate,
then in the middle, each with the variance that is left.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

# Streams: the purpose of a number.
PRESET, FLICKER, WALK, LEVEL, EDGE, COIN = range(1, 7)

_WEYL = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_ODD = 2.0**-53


@numba.njit(cache=True, inline="always")
def _mix(z):  # type: ignore
    z = (z ^ (z >> np.uint64(30))) * _MIX1
    z = (z ^ (z >> np.uint64(27))) * _MIX2
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True)
def uniform(key, stream, counter):  # type: ignore
    """(0, 1), never either end: 53 bits and a half."""
    begin = _mix(key ^ (np.uint64(stream) * _MIX2))
    return ((_mix(begin + np.uint64(counter) * _WEYL) >> np.uint64(11)) + 0.5) * _ODD


@numba.njit(cache=True)
def inverse_normal(p):  # type: ignore
    """Return the quantile p of the standard normal distribution: AS241, relative error about 1e-16."""
    q = p - 0.5
    # Where AS241 changes from one polynomial to the next.
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        above = (((((((2.5090809287301226727e3 * r + 3.3430575583588128105e4) * r + 6.7265770927008700853e4) * r
                     + 4.5921953931549871457e4) * r + 1.3731693765509461125e4) * r + 1.9715909503065514427e3) * r
                  + 1.3314166789178437745e2) * r + 3.3871328727963666080e0)  # fmt: skip
        below = (((((((5.2264952788528545610e3 * r + 2.8729085735721942674e4) * r + 3.9307895800092710610e4) * r
                     + 2.1213794301586595867e4) * r + 5.3941960214247511077e3) * r + 6.8718700749205790830e2) * r
                  + 4.2313330701600911252e1) * r + 1.0)  # fmt: skip
        return q * above / below
    r = math.sqrt(-math.log(p if q < 0 else 1.0 - p))
    if r <= 5.0:
        r -= 1.6
        above = (((((((7.74545014278341407640e-4 * r + 2.27238449892691845833e-2) * r + 2.41780725177450611770e-1) * r
                     + 1.27045825245236838258e0) * r + 3.64784832476320460504e0) * r + 5.76949722146069140550e0) * r
                  + 4.63033784615654529590e0) * r + 1.42343711074968357734e0)  # fmt: skip
        below = (((((((1.05075007164441684324e-9 * r + 5.47593808499534494600e-4) * r + 1.51986665636164571966e-2) * r
                     + 1.48103976427480074590e-1) * r + 6.89767334985100004550e-1) * r + 1.67638483018380384940e0) * r
                  + 2.05319162663775882187e0) * r + 1.0)  # fmt: skip
    else:
        r -= 5.0
        above = (((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r + 1.24266094738807843860e-3) * r
                     + 2.65321895265761230930e-2) * r + 2.96560571828504891230e-1) * r + 1.78482653991729133580e0) * r
                  + 5.46378491116411436990e0) * r + 6.65790464350110377720e0)  # fmt: skip
        below = (((((((2.04426310338993978564e-15 * r + 1.42151175831644588870e-7) * r + 1.84631831751005468180e-5) * r
                     + 7.86869131145613259100e-4) * r + 1.48753612908506148525e-2) * r + 1.36929880922735805310e-1) * r
                  + 5.99832206555887937690e-1) * r + 1.0)  # fmt: skip
    value = above / below
    return -value if q < 0 else value


@numba.njit(cache=True)
def normal(key, stream, counter):  # type: ignore
    """One standard normal number."""
    return inverse_normal(uniform(key, stream, counter))


@numba.njit(cache=True)
def row_key(seed, frame, row):  # type: ignore
    """Return the key of one row of cells; `frame` is its number in the whole scene."""
    of_frame = _mix(_mix(np.uint64(seed) * _MIX1 + _WEYL) + np.uint64(frame) * _WEYL)
    return _mix(of_frame + np.uint64(row + 1) * _MIX2)


@numba.njit(cache=True)
def key_in_row(of_row, col):  # type: ignore
    """Return the key of one cell of a row."""
    return _mix(of_row + np.uint64(col + 1) * _WEYL)


@numba.njit(cache=True)
def _keys(seed, first_frame, frame, row, col, out):  # type: ignore
    for i in range(out.size):
        out[i] = key_in_row(row_key(seed, first_frame + frame[i], row[i]), col[i])


def cell_keys(seed: int, first_frame: int, shape: tuple[int, int, int]) -> NDArray[np.uint64]:
    """One key a cell, [frames, rows, cols]; `first_frame` is the number of frame 0 in the whole scene."""
    return chosen_keys(seed, first_frame, tuple(np.indices(shape).reshape(3, -1))).reshape(shape)


def chosen_keys(seed: int, first_frame: int, cells: tuple[NDArray[np.intp], ...]) -> NDArray[np.uint64]:
    """Keys of chosen cells, given by frame, row and column, [n]."""
    if len({cell.shape for cell in cells}) != 1:
        raise ValueError("frames, rows and columns of cells must be as many")
    out = np.empty(cells[0].size, dtype=np.uint64)
    _keys(np.uint64(seed), first_frame, *cells, out)
    return out


@numba.njit(cache=True)
def _normals(keys, stream, counter, out):  # type: ignore
    for i in range(keys.size):
        out[i] = normal(keys[i], stream, counter)


def normals(keys: NDArray[np.uint64], stream: int, counter: int = 0) -> NDArray[np.float64]:
    """One standard normal number a key, of its shape."""
    out = np.empty(keys.size)
    _normals(keys.ravel(), stream, counter, out)
    return out.reshape(keys.shape)


@numba.njit(cache=True)
def span_of(clocks):  # type: ignore
    """Length of the dyadic grid: the power of two that holds `clocks`."""
    span = 1
    while span < clocks:
        span *= 2
    return span


@numba.njit(cache=True)
def walk_grid(key, span, step, out):  # type: ignore
    """W at 0, step, 2 step ... span of one cell into out [span / step + 1]."""
    out[0] = 0.0
    out[span // step] = math.sqrt(span) * normal(key, WALK, span)
    length = span
    while length > step:
        half = length // 2
        spread = 0.5 * math.sqrt(length)
        for left in range(0, span, length):
            middle = left + half
            between = 0.5 * (out[left // step] + out[(left + length) // step])
            out[middle // step] = between + spread * normal(key, WALK, middle)
        length = half


@numba.njit(cache=True)
def walk_between(key, n, left, right, at_left, at_right, scale, low, high):  # type: ignore
    """W at clock n between two neighbours of the grid, or as much of it as decides.

    Goes on halving until n is met, or until scale W(n) is more than 8 standard deviations of what
    is still unknown below `low` or above `high`; then the mean of what is known is returned.
    """
    while True:
        if n == left:
            return at_left
        if n == right:
            return at_right
        length = right - left
        part = (n - left) / length
        mean = at_left + (at_right - at_left) * part
        rest = 8.0 * scale * math.sqrt(length * part * (1.0 - part))
        if scale * mean + rest < low or scale * mean - rest > high:
            return mean
        middle = (left + right) // 2
        at_middle = 0.5 * (at_left + at_right) + 0.5 * math.sqrt(length) * normal(key, WALK, middle)
        if n < middle:
            right, at_right = middle, at_middle
        else:
            left, at_left = middle, at_middle


@numba.njit(cache=True)
def walk_end(key, clocks, scale, fall):  # type: ignore
    """Return scale W(clocks), and how far scale W is above it at most at any clock before, less `fall` a clock.

    Only the numbers on the way to the end are drawn; between them W is at most 8 standard deviations
    above the line from one to the next.
    """
    span = span_of(clocks)
    left, right, at_left, at_right = 0, span, 0.0, math.sqrt(span) * normal(key, WALK, span)
    known, count = np.zeros((2, 64)), 1
    while right - left > 1:
        middle = (left + right) // 2
        spread = 0.5 * math.sqrt(right - left)
        at_middle = 0.5 * (at_left + at_right) + spread * normal(key, WALK, middle)
        if clocks > middle:
            left, at_left = middle, at_middle
            known[0, count], known[1, count] = left, at_left
            count += 1
        else:
            right, at_right = middle, at_middle
    end, above, before = scale * at_right, -np.inf, -np.inf
    for k in range(count):
        here = scale * known[1, k] - end - fall * (clocks - known[0, k])
        length = known[0, k] - known[0, k - 1] if k > 0 else 0.0
        between = 4.0 * scale * math.sqrt(length) if length > 1.0 else 0.0
        above = max(above, max(before, here) + between)
        before = here
    return end, above
