# SPDX-License-Identifier: Apache-2.0
"""A sensor layer for robot simulators: forces to codes and codes to forces, in compiled loops."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dermis import engines, plan
from dermis.array.array import column_currents
from dermis.converter.vfc import W_PRESET
from dermis.decode import crosstalk
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Decoder, Forces, check_out, numbers, times
from dermis.decode.memory import SheetMemory, advance_creep, apply_frame
from dermis.engines import closed
from dermis.records import Plan
from dermis.scene import scene as scenes
from dermis.scene.sensor import InverseSensor

Floats = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def _conductance(force, k, points, conductances, exponents, force_on, g_open):
    """Conductance by the law: force / k, or the power law between points where k is 0."""
    if k > 0.0:
        return force / k
    if force < force_on:
        return g_open
    n = 0
    while n + 1 < points.size and force >= points[n + 1]:
        n += 1
    g = conductances[n] * (force / points[n]) ** exponents[n] if force > 0.0 else 0.0
    return max(g, g_open)


@njit(cache=True, nogil=True, error_model="numpy")
def _lateral(u, c, g_lateral):
    """Current from both neighbours into column c, in ampere."""
    came = 0.0
    if c > 0:
        came += g_lateral * (u[c - 1] - u[c])
    if c + 1 < u.size:
        came += g_lateral * (u[c + 1] - u[c])
    return came


@njit(cache=True, nogil=True, error_model="numpy")
def _row_voltages(g, u, driven, v_bias, r_driven, g_ground, total, volt):
    """Voltages `volt` [rows] of the row lines for column voltages `u`; no row is driven if `driven`
    is -1.
    """
    for i in range(volt.size):
        drawn = 0.0
        for c in range(u.size):
            drawn += g[i, c] * u[c]
        if i == driven:
            volt[i] = (v_bias + r_driven * drawn) / (1.0 + r_driven * total[i])
        else:
            volt[i] = drawn / (total[i] + g_ground) if total[i] + g_ground > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _currents(g, out, network, total, volt):
    """Fill `out` with the column currents of `g` [rows, cols], where every column is at its offset.

    Only the driven row changes from slot to slot. `total` and `volt` [rows] are scratch.
    """
    v_bias, r_driven, g_ground, _, v_offset, i_leak, g_lateral = network
    rows, cols = g.shape
    for r in range(rows):
        total[r] = g[r].sum()
    _row_voltages(g, v_offset, -1, v_bias, r_driven, g_ground, total, volt)
    for c in range(cols):
        out[0, c] = _lateral(v_offset, c, g_lateral) + i_leak[c]
    for i in range(rows):
        for c in range(cols):
            out[0, c] += g[i, c] * (volt[i] - v_offset[c])
    # The last row first: row 0 holds the values that all rows share.
    for r in range(rows - 1, -1, -1):
        drawn = 0.0
        for c in range(cols):
            drawn += g[r, c] * v_offset[c]
        p = (v_bias + r_driven * drawn) / (1.0 + r_driven * total[r])
        for c in range(cols):
            out[r, c] = out[0, c] + g[r, c] * (p - volt[r])


@njit(cache=True, nogil=True, error_model="numpy")
def _read_frames(forces, dt_s, law, factor, network, chip, memory, memory_law, work, codes):
    """Read frames into `codes` until one has a short; return how many were read.

    The conductances of that frame are left in the first array of `work`.
    """
    k, points, conductances, exponents, force_on, g_open = law
    code_max, step, start, inv_range = chip
    z, creep, loaded, fresh, rate, rate_weight, g_loaded = memory
    radius, weight, per_decade = memory_law
    g, current, total, volt = work
    frames, rows, cols = forces.shape
    remembers = radius.size > 0 or per_decade != 0.0
    for n in range(frames):
        for r in range(rows):
            for c in range(cols):
                g[r, c] = _conductance(forces[n, r, c], k, points, conductances, exponents, force_on, g_open)
        if remembers:
            if per_decade != 0.0 and not fresh:
                advance_creep(creep, loaded, rate, rate_weight, dt_s[n])
            flat, seen = g.reshape(-1), current.reshape(-1)
            apply_frame(flat, seen, z, creep, loaded, fresh, radius, weight, per_decade)
            for t in range(flat.size):
                loaded[t] = flat[t] > g_loaded
                flat[t] = seen[t]
            fresh = False
        short = False
        for r in range(rows):
            for c in range(cols):
                g[r, c] *= factor[r, c]
                short = short or g[r, c] > crosstalk.SHORT_S
        if short:
            return n
        _currents(g, current, network, total, volt)
        for r in range(rows):
            for c in range(cols):
                seen_a = current[r, c] / (1.0 + abs(current[r, c]) * inv_range[c])
                code = np.floor(seen_a / step[c] + start[c] + 0.5)
                codes[n, r, c] = min(max(code, 0.0), code_max)
    return frames


class Skin:
    """A sheet and its chip as a robot simulator meets them.

    >>> skin = Skin("single_touch")
    >>> codes = skin.read(np.full((16, 16), 2.0))
    >>> forces = skin.decode(codes)

    Without hysteresis and creep both directions have no state and may be called from several
    threads. With them a skin is one sheet: frames in order of time, and `reset` for a new one.

    Parameters
    ----------
    scene : str, path or Plan
        A scene by name or path; its stimulus does not matter. Only effects of engine closed.
    calibration : Calibration, optional
        What the decoder knows; by default every parameter of the scene.
    threads : int
        Threads for batches of a skin without state.

    Raises
    ------
    InputError
        The scene is wrong, or has an effect that engine closed cannot do.
    """

    def __init__(
        self, scene: str | Path | Plan, calibration: Calibration | None = None, threads: int = 1
    ) -> None:
        self.plan = scene if isinstance(scene, Plan) else plan.load(scenes.find(str(scene)), "closed")
        engines.check(self.plan)
        self.rows, self.cols = self.plan.rows, self.plan.cols
        self.t_frame_s = self.plan.timing.frame_s
        self.threads = threads
        self._true = true = Calibration.of_plan(self.plan)
        known = true if calibration is None else calibration
        known.check(self.rows, self.cols, "calibration")
        self.decoder = Decoder(known, self.t_frame_s)
        self._local, self._lock = threading.local(), threading.Lock()
        self._network, converter = self.plan.network(0), self.plan.converter
        start = -W_PRESET + (converter.v_comp_offset_v - converter.preset_error_v) / converter.packet_v()
        in_order = (start > 0).all() and (true.full_code == true.code_max).all()
        # Elsewhere the engine's own array solve and count formula do it.
        ideal = crosstalk.lumped(self._network) and not self._network.r_column_ohm.any()
        self._compiled = bool(in_order and ideal and np.all(converter.gain > 0))
        sensor = self.plan.sensor
        none = np.zeros(1)
        if isinstance(sensor, InverseSensor):
            self._law = (sensor.k_force_n_ohm, none, none, none, 0.0, 0.0)
            self._loaded_s = 0.0
        else:
            points, ohm = np.array(sensor.force_points_n), np.array(sensor.r_points_ohm)
            open_s = 1.0 / sensor.r_open_ohm
            self._law = (0.0, points, 1.0 / ohm, sensor.exponents(), sensor.force_on_n, open_s)
            self._loaded_s = open_s
        self.reset()

    def reset(self) -> None:
        """Start with a fresh sheet, in both directions."""
        self.memory = SheetMemory(self._true.memory, self.rows * self.cols, self._loaded_s)
        self.decoder.reset()

    def read(
        self, forces_n: ArrayLike, t_frame_s: float | ArrayLike | None = None, out: NDArray | None = None
    ) -> NDArray[np.unsignedinteger]:
        """Read forces with the chip.

        Parameters
        ----------
        forces_n : array_like
            [frames, rows, cols] or [rows, cols] in newtons.
        t_frame_s : float or array_like, optional
            Time in seconds since the frame before, for all frames or each; by default the frame time of the chip.
        out : ndarray, optional
            Codes of the shape of the forces to fill. With ideal columns nothing is allocated then.

        Returns
        -------
        ndarray
            Codes of the shape of the forces.

        Raises
        ------
        ValueError
            A wrong shape, forces or times that are not finite or below 0, or an `out` of another shape or type.
        """
        forces = numbers(forces_n, "forces_n")
        if forces.ndim not in (2, 3) or forces.shape[-2:] != (self.rows, self.cols):
            raise ValueError(f"forces_n must be [frames, {self.rows}, {self.cols}]")
        # A sum is NaN if anything is, and needs no second array.
        if forces.size and not (forces.min() >= 0 and forces.sum() < np.inf):
            raise ValueError("forces_n must be finite and 0 or above")
        kind = engines.code_type(self._true.code_max)
        if out is None:
            out = np.empty(forces.shape, kind)
        check_out(out, forces.shape, kind, "out")
        frames, codes = forces.reshape(-1, self.rows, self.cols), out.reshape(-1, self.rows, self.cols)
        dt = times(self.t_frame_s if t_frame_s is None else t_frame_s, len(frames))
        run = self._read_compiled if self._compiled else self._read_solved
        if self._true.memory.active:
            with self._lock:
                run(frames, dt, codes)
        else:
            self._in_threads(len(frames), lambda part: run(frames[part], dt[part], codes[part]))
        return out

    def decode(
        self, codes: ArrayLike, t_frame_s: float | ArrayLike | None = None, out: Forces | None = None
    ) -> Forces:
        """Decode codes [frames, rows, cols] or [rows, cols] into newtons with intervals; see
        `Decoder.decode`.
        """
        codes = np.asarray(codes)
        if codes.ndim == 2 or self.decoder.calibration.memory.active or self.threads == 1:
            return self.decoder.decode(codes, t_frame_s, out)
        if out is None:
            out = Forces(*(np.empty(codes.shape) for _ in range(3)), np.empty(codes.shape, np.uint8))
        made = out

        def decode_part(part: slice) -> None:
            places = Forces(made.force_n[part], made.low_n[part], made.high_n[part], made.flags[part])
            self.decoder.decode(codes[part], None, places)

        self._in_threads(len(codes), decode_part)
        return out

    def _in_threads(self, frames: int, work: Callable[[slice], Any]) -> None:
        if self.threads == 1 or frames < 2 * self.threads:
            work(slice(0, frames))
            return
        ends = np.linspace(0, frames, self.threads + 1).astype(int)
        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(work, (slice(a, b) for a, b in pairwise(ends))))

    def _read_compiled(self, forces: Floats, dt_s: Floats, codes: NDArray) -> None:
        true, memory = self._true, self.memory
        work = getattr(self._local, "work", None)
        if work is None:
            shape = (self.rows, self.cols)
            work = self._local.work = tuple(np.empty(size) for size in (shape, shape, self.rows, self.rows))
        first = 0
        while first < len(forces):
            z, _, _, _, creep, loaded, _, fresh, rate, weight = memory.arrays()
            read = _read_frames(
                forces[first:],
                dt_s[first:],
                self._law,
                true.factor,
                crosstalk.arguments(self._network),
                (float(true.code_max), true.step_a, true.start_code, true.inv_i_range_a),
                (z, creep, loaded, fresh, rate, weight, self._loaded_s),
                (true.memory.radius, true.memory.weight, float(true.memory.creep_per_decade)),
                work,
                codes[first:],
            )
            stopped = first + read
            if stopped < len(forces):
                # The direct solve of the engine takes over.
                codes[stopped] = self._codes(work[0][np.newaxis])[0]
                read += 1
            memory.passed(read)
            first += read

    def _codes(self, conductance_s: Floats) -> NDArray[np.unsignedinteger]:
        """Return the codes of taxels [frames, rows, cols] by the array solve and the count of engine closed."""
        currents = column_currents(self._network, conductance_s)
        return closed.codes_of(self.plan, self.plan.converter.duty(currents))

    def _read_solved(self, forces: Floats, dt_s: Floats, codes: NDArray) -> None:
        with np.errstate(divide="ignore"):
            g = 1.0 / self.plan.sensor.resistance_ohm(forces)
        if self._true.memory.active:
            for n, frame in enumerate(g):
                g[n] = self.memory.apply(frame.ravel(), dt_s[n]).reshape(frame.shape)
        codes[:] = self._codes(g * self._true.factor)
