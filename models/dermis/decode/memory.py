# SPDX-License-Identifier: Apache-2.0
"""Hysteresis and creep of a sheet as a stream: put in, and taken back frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import DTypeLike, NDArray

from dermis.errors import InputError
from dermis.files import atomic
from dermis.machine_code import argument
from dermis.ndarrays import Floats
from dermis.scene.sensor import creep_rates
from dermis.scene.sensor_loops import advance_creep

LOG_OPEN = -80.0
"""Logarithm of the conductance of an open taxel: 1e-35 S."""
ROUNDING = 1e-9
"""Relative conductance that is not a movement: rounding of the creep factor and of logarithms."""
HISTORY = 256
"""Frames that are kept to guess a return: returns that take up to 128 frames."""
SLOW = 8
"""A force that came through less than a flat piece in this many frames is slow."""
GAP_S = 0.1
"""A load that is out of sight for no longer, below half a code, may have stayed there."""
LONGEST_S = 1e7
"""Time over which creep is followed; a load of four months adds 1 part in 1e4 of a decade after that."""


@dataclass(frozen=True, eq=False)
class MemoryLaw:
    """Hysteresis and creep of a sheet.

    Hysteresis is a Prandtl-Ishlinskii operator on x, the logarithm of the conductance by the law: a mean of play
    operators, z = clip(z, x - radius, x + radius), with weights that sum to 1. It is shifted so that a first rise
    follows the law. One radius of -log(1 - h) / 2 is `sensor.play` of the width h. Creep is that of
    `sensor.creep_decades`: conductance times 1 + creep_per_decade * decades under load.

    radius, weight : [n]; n = 0 is no hysteresis.
    creep_per_decade : relative.
    creep_start_s : time at which the first decade starts.
    """

    radius: Floats
    weight: Floats
    creep_per_decade: float = 0.0
    creep_start_s: float = 10e-3

    def __post_init__(self) -> None:
        radius = argument(self.radius, "radius", (None,), 0.0)
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "weight", argument(self.weight, "weight", radius.shape, 0.0))
        argument(self.creep_per_decade, "creep_per_decade", (), 0.0)
        if not argument(self.creep_start_s, "creep_start_s", ()) > 0:
            raise ValueError("creep_start_s must be above 0")

    @classmethod
    def of_effects(cls, hysteresis: float, creep_per_decade: float, creep_start_s: float) -> MemoryLaw:
        """Return the law of a scene's effects; hysteresis is the width of the loop, relative to the resistance."""
        size = 1 if hysteresis else 0
        return cls(np.full(size, -np.log1p(-hysteresis) / 2), np.ones(size), creep_per_decade, creep_start_s)

    @property
    def active(self) -> bool:
        """Return True if the sheet has hysteresis or creep."""
        return bool(self.radius.size or self.creep_per_decade)


def check_out(out: object, shape: tuple[int, ...], kind: DTypeLike, name: str) -> NDArray:
    """Return `out`; ValueError unless a compiled loop may write an array of this shape and type into it."""
    fits = isinstance(out, np.ndarray) and out.shape == shape and out.dtype == kind
    if not (fits and out.flags.c_contiguous and out.flags.writeable):
        wanted = f"a writable, contiguous {np.dtype(kind)} array of shape {list(shape)}"
        got = f"{out.dtype} {list(out.shape)}" if isinstance(out, np.ndarray) else type(out).__name__
        raise ValueError(f"{name} must be {wanted}, not {got}")
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _value(x, z, radius, weight):
    """Mean of play operators at x in the states z [n], less the shift of a first rise."""
    y = 0.0
    for k in range(radius.size):
        y += weight[k] * (min(max(z[k], x - radius[k]), x + radius[k]) + radius[k])
    return y


@njit(cache=True, nogil=True, error_model="numpy")
def _end(y, z, radius, weight, side):
    """Highest (side 1) or lowest (side -1) x whose value is y; the value rises with x along straight pieces."""
    best, at, last = -side * np.inf, 0.0, side * np.inf
    for k in range(radius.size):
        for edge in (-1.0, 1.0):
            b = z[k] + edge * radius[k]
            value = _value(b, z, radius, weight)
            if side * (b - last) < 0.0:
                last = b
            if side * (y - value) >= 0.0 and side * (b - best) > 0.0:
                best, at = b, value
    if np.isinf(best):
        return last + (y - _value(last, z, radius, weight))
    slope = 0.0
    for k in range(radius.size):
        below, above = z[k] - radius[k], z[k] + radius[k]
        # The piece that goes on to that side.
        if best < below or best > above or best == (above if side > 0.0 else below):
            slope += weight[k]
    return best + (y - at) / max(slope, 1e-6)


@njit(cache=True, nogil=True, error_model="numpy")
def _move(x, z, radius):
    for k in range(radius.size):
        z[k] = min(max(z[k], x - radius[k]), x + radius[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _log(g):
    # exp(LOG_OPEN): below it a taxel conducts nothing.
    return np.log(g) if g > 1.9e-35 else LOG_OPEN


@njit(cache=True, nogil=True, error_model="numpy")
def apply_frame(g, out, z, creep, loaded, fresh, radius, weight, per_decade):
    """Turn conductances by the law `g` [taxels] into those of the sheet."""
    for t in range(g.size):
        value = g[t]
        if radius.size and value < np.inf:
            x = _log(g[t])
            if fresh:
                for k in range(radius.size):
                    z[0, t, k] = x - radius[k]
            y = _value(x, z[0, t], radius, weight)
            _move(x, z[0, t], radius)
            value = np.exp(y) if y > LOG_OPEN + 1.0 else 0.0
        if per_decade:
            value *= 1.0 + per_decade * creep[0, t].sum()
        out[t] = value


@njit(cache=True, nogil=True, error_model="numpy")
def undo_frame(ends, near, state, frame, dt_s, gained, fresh, g_open, law):
    """Turn conductances of the sheet [taxels] and their ends into those by the law, in place.

    `ends` are the low end, the estimate and the high end, `near` the ends for the errors that change from frame to
    frame, quantisation and noise: they decide if a taxel has moved. They are scratch afterwards.

    `state` is that of `SheetMemory.arrays`: `past` [taxels, HISTORY] holds the last estimates, `moved` [taxels, 2] the
    frame of the last movement and the frames between the last two, `band` [taxels, 2] the values that explain all
    readings since. `creep` [2, taxels, rates] is that of certain loads, seen in two frames in a row, and of all that
    are possible: those whose interval begins at 0, those that may have stayed in gaps of up to GAP_S, any behind an end
    of infinity, and a touch from the frame before it on. `gained` [rates] is what load adds between two frames,
    `loaded` [2, taxels] is if there is such load from now on, `gone` [taxels] the time since one was in sight.
    """
    low, g, high = ends
    near_low, near_high = near
    z, past, moved, band, creep, loaded, gone = state
    radius, weight, per_decade = law
    # A taxel without load conducts at most so much, after any load.
    open_most = g_open * np.exp(2.0 * (weight * radius).sum())
    for t in range(g.size):
        if per_decade:
            least, most = creep[0, t].sum(), creep[1, t].sum() + (0.0 if loaded[1, t] else gained.sum())
            factor = 1.0 / (1.0 + per_decade * 0.5 * (least + most))
            low[t] /= 1.0 + per_decade * most
            g[t] *= factor
            high[t] /= 1.0 + per_decade * least
            near_low[t] *= factor
            near_high[t] *= factor
        read = g[t] > open_most
        if radius.size and g[t] < np.inf:
            y = _log(g[t])
            y_low, y_high = min(_log(low[t]), y - ROUNDING), max(_log(min(high[t], 1e300)), y + ROUNDING)
            b_low, b_high = min(_log(near_low[t]), y - ROUNDING), max(_log(near_high[t]), y + ROUNDING)
            if fresh:
                for k in range(radius.size):
                    z[0, t, k], z[1, t, k], z[2, t, k] = y - radius[k], y_low - radius[k], y_high - radius[k]
                past[t, :] = y
                moved[t, 0], moved[t, 1] = frame, 1
                band[t, 0], band[t, 1] = b_low, b_high
            # Two sheets that started lower and higher stay lower and higher: play operators keep the order.
            x_low = _end(y_low, z[2, t], radius, weight, -1.0)
            x_high = _end(y_high, z[1, t], radius, weight, 1.0)
            last = moved[t, 0]
            still = frame - last
            x = past[t, last % HISTORY]
            returning = 2 * still > 3 * moved[t, 1]
            # A moving taxel whose next code just overlaps moves on; one that rests may drift over a threshold.
            room = 0.0 if returning else 0.2 * (b_high - b_low)
            if max(b_low, band[t, 0]) + room <= min(b_high, band[t, 1]):
                # One constant value explains all readings since the last movement.
                band[t, 0], band[t, 1] = max(b_low, band[t, 0]), min(b_high, band[t, 1])
                # A slow force that turned goes back as it came; one that is not seen in twice that time rests. A fast
                # one leaves the flat piece at once.
                if returning and 2 * still < HISTORY:
                    late = past[t, (last - still // 2) % HISTORY]
                    slow = past[t, (last - SLOW) % HISTORY]
                    if x_low < late < x_high and x_low < slow < x_high:
                        x = past[t, (last - still) % HISTORY]
            else:
                # The states that are certain to be behind the movement put the taxel on a steep piece.
                if b_low + b_high > band[t, 0] + band[t, 1]:
                    x = _end(y, z[1, t], radius, weight, 1.0)
                else:
                    x = _end(y, z[2, t], radius, weight, -1.0)
                moved[t, 0], moved[t, 1] = frame, min(still, HISTORY)
                band[t, 0], band[t, 1] = b_low, b_high
            x = min(max(x, x_low), x_high)
            _move(x, z[0, t], radius)
            _move(x_low, z[1, t], radius)
            _move(x_high, z[2, t], radius)
            if radius.size == 1:
                # The state of a single play is read directly.
                z[1, t, 0] = max(z[1, t, 0], y_low - radius[0])
                z[2, t, 0] = min(z[2, t, 0], y_high - radius[0])
            past[t, frame % HISTORY] = x
            g[t] = np.exp(x) if x > LOG_OPEN + 1.0 else 0.0
            low[t] = np.exp(x_low) if x_low > LOG_OPEN + 1.0 else 0.0
            if high[t] < np.inf:
                high[t] = np.exp(x_high) if x_high > LOG_OPEN + 1.0 else high[t]
        certain, seen = low[t] > g_open, read or g[t] > g_open or high[t] == np.inf
        for k in range(gained.size):
            creep[0, t, k] -= gained[k] if loaded[0, t] and not certain else 0.0
            creep[1, t, k] += gained[k] if seen and not loaded[1, t] else 0.0
        loaded[0, t] = certain
        gone[t] = 0.0 if seen else gone[t] + dt_s
        loaded[1, t] = gone[t] <= GAP_S


_STATE = ("z", "past", "moved", "band", "creep", "loaded", "gone", "frame", "fresh")


class SheetMemory:
    """Hysteresis and creep of every taxel of one sheet, frame by frame, as one stream in one direction.

    The state can be saved and loaded, so that a stream goes on in another process. A taxel at or below the conductance
    `g_open_s` by the law carries no load.
    """

    def __init__(self, law: MemoryLaw, taxels: int, g_open_s: float = 0.0) -> None:
        self.law = law
        self._g_open_s = g_open_s
        self._rate, self._weight = creep_rates(law.creep_start_s, LONGEST_S)
        if not law.creep_per_decade:
            self._rate = self._weight = np.empty(0)
        self._z = np.zeros((3, taxels, law.radius.size))
        self._past = np.zeros((taxels, HISTORY))
        self._moved = np.zeros((taxels, 2), dtype=np.int64)
        self._band = np.zeros((taxels, 2))
        self._frame = 0
        self._creep = np.zeros((2, taxels, self._rate.size))
        self._loaded = np.zeros((2, taxels), dtype=np.bool_)
        self._gone = np.full(taxels, np.inf)
        self._fresh = True

    def _step(self, dt_s: float, states: int) -> Floats:
        if not 0 <= dt_s < np.inf:
            raise ValueError(f"time runs backwards: a step of {dt_s} s")
        gained = np.zeros(self._rate.size)
        if self._rate.size and not self._fresh:
            for k in range(states):
                gained = advance_creep(self._creep[k], self._loaded[k], self._rate, self._weight, dt_s)
        return gained

    def apply(self, conductance_s: Floats, dt_s: float) -> Floats:
        """Return the sheet's conductances for those by the law, [taxels], dt_s after the frame before."""
        g = argument(conductance_s, "conductance_s", self._gone.shape, 0.0)
        out = np.empty_like(g)
        self._step(dt_s, 1)  # which loads there are is certain
        memory = self._z, self._creep, self._loaded, self._fresh
        apply_frame(g, out, *memory, self.law.radius, self.law.weight, self.law.creep_per_decade)
        self._loaded[:] = g > self._g_open_s
        self._fresh = False
        return out

    def undo(self, low_s: Floats, conductance_s: Floats, high_s: Floats, dt_s: float) -> None:
        """Turn the sheet's conductances and their ends [taxels] into those by the law, in place.

        Where the loop has a flat piece no reading tells where on it a taxel is. The ends cover the piece. The estimate
        is a force that goes back as it came, and then one that rests where it was last seen to move.
        """
        ends = low_s, conductance_s, high_s
        for name, array in zip(("low_s", "conductance_s", "high_s"), ends, strict=True):
            if not (check_out(array, self._gone.shape, float, name) >= 0).all():
                raise ValueError(f"{name} must be 0 or above")
        gained = self._step(dt_s, 2)
        state, law = self.arrays()[:7], (self.law.radius, self.law.weight, self.law.creep_per_decade)
        near = low_s.copy(), high_s.copy()
        undo_frame(ends, near, state, self._frame, dt_s, gained, self._fresh, self._g_open_s, law)
        self.passed(1)

    def arrays(self) -> tuple:
        """Return the state and the creep kernel for a compiled loop over frames; `passed` follows it."""
        state = self._z, self._past, self._moved, self._band, self._creep, self._loaded, self._gone
        return (*state, self._frame, self._fresh, self._rate, self._weight)

    def passed(self, frames: int) -> None:
        """Note that a compiled loop has gone through some frames."""
        self._frame += frames
        self._fresh = self._fresh and frames == 0

    def save(self, path: Path) -> None:
        """Write the state to an npz file, whole or not at all."""
        with atomic(path) as file:
            np.savez(file, **self._state())

    def load(self, path: Path) -> None:
        """Go on from a state that was saved; InputError if it is not of this law and this number of taxels."""
        try:
            with np.load(path, allow_pickle=False) as data:
                given = {name: data[name] for name in self._state()}
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise InputError(path, "file", str(error), "a state that SheetMemory.save wrote") from None
        for name, mine in self._state().items():
            same = given[name].shape == mine.shape and given[name].dtype == mine.dtype
            if not same or (name == "law" and (given[name] != mine).any()):
                allowed = "the state of the same sheet and calibration"
                raise InputError(path, name, f"of shape {given[name].shape}", allowed)
        for name in _STATE:
            setattr(self, f"_{name}", given[name])
        self._fresh, self._frame = bool(given["fresh"]), int(given["frame"])

    def _state(self) -> dict[str, NDArray]:
        law = self.law
        state = {name: getattr(self, f"_{name}") for name in _STATE}
        said = np.array([*law.radius, *law.weight, law.creep_per_decade, law.creep_start_s])
        return {"law": said} | {name: np.asarray(value) for name, value in state.items()}
