# SPDX-License-Identifier: Apache-2.0
"""A sensor layer for robot simulators: forces to codes and codes to forces, in compiled loops."""

import contextlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dermis import effects as effect_registry
from dermis import engines, machine_code, plan
from dermis.array.array import column_currents
from dermis.converter.vfc import code_type
from dermis.decode import crosstalk
from dermis.decode.calibration import OVERLOAD, Calibration, sheet_factor
from dermis.decode.calibration import load as load_calibration
from dermis.decode.decoder import Decoder, Forces, Threaded, numbers, times
from dermis.decode.force import start_of
from dermis.decode.memory import check_out
from dermis.decode.sheets import Sheets, apply_sheet
from dermis.engines import closed
from dermis.errors import InputError
from dermis.machine_code import argument
from dermis.ndarrays import Floats, unmasked
from dermis.records import Plan, random_of, setting_of
from dermis.scene import scene as scenes
from dermis.scene.sensor import InverseSensor, SensorState

LEAST_INPUT_OHM = 1e-3
"""Input resistance of a column from which on the compiled solve takes it: a smaller one leaves it no digits."""


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
def _currents(g, out, network, total, volt):
    """Fill `out` with the column currents of `g` [rows, cols], where every column is at its offset.

    Only the driven row changes from slot to slot. `total` and `volt` [rows] are scratch.
    """
    v_bias, r_driven, g_ground, _, v_offset, i_leak, g_lateral = network
    rows, cols = g.shape
    for c in range(cols):
        out[0, c] = 0.0
        if c > 0:
            out[0, c] += g_lateral * (v_offset[c - 1] - v_offset[c])
        if c + 1 < cols:
            out[0, c] += g_lateral * (v_offset[c + 1] - v_offset[c])
        out[0, c] += i_leak[c]
    for r in range(rows):
        total[r], drawn = g[r].sum(), 0.0
        for c in range(cols):
            drawn += g[r, c] * v_offset[c]
        volt[r] = drawn / (total[r] + g_ground) if total[r] + g_ground > 0.0 else 0.0
        for c in range(cols):
            out[0, c] += g[r, c] * (volt[r] - v_offset[c])
    # The last row first: row 0 holds the values that all rows share.
    for r in range(rows - 1, -1, -1):
        drawn = 0.0
        for c in range(cols):
            drawn += g[r, c] * v_offset[c]
        p = (v_bias + r_driven * drawn) / (1.0 + r_driven * total[r])
        for c in range(cols):
            out[r, c] = out[0, c] + g[r, c] * (p - volt[r])


@njit(cache=True, nogil=True, error_model="numpy")
def _currents_through_inputs(g, out, network, total, a, w):
    """Fill `out` as `_currents` does, where every column has an input resistance above 0.

    The nodes are the columns; row lines are eliminated. The matrix without a driven row is factored once (Cholesky,
    into `a` [cols, cols]); the driven row is a change of rank one (Sherman and Morrison). `total` [rows] and
    `w` [2, cols] are scratch.
    """
    v_bias, r_driven, g_ground, r_column, v_offset, i_leak, g_lateral = network
    rows, cols = g.shape
    a[:], rest = 0.0, w[1]
    for r in range(rows):
        total[r] = g[r].sum()
        part = 1.0 / (total[r] + g_ground) if total[r] + g_ground > 0.0 else 0.0
        for c in range(cols):
            a[c, c] += g[r, c]
            for d in range(c + 1):
                a[c, d] -= g[r, c] * g[r, d] * part
    for c in range(cols):
        a[c, c] += 1.0 / r_column[c] + g_lateral * ((c > 0) + (c + 1 < cols))
        if c > 0:
            a[c, c - 1] -= g_lateral
        rest[c] = v_offset[c] / r_column[c] + i_leak[c]
    for c in range(cols):
        for d in range(c + 1):
            value = a[c, d]
            for k in range(d):
                value -= a[c, k] * a[d, k]
            a[c, d] = value / a[d, d] if d < c else np.sqrt(value)
    _solve_factored(a, rest)
    for r in range(rows):
        part = 1.0 / (total[r] + g_ground) if total[r] + g_ground > 0.0 else 0.0
        change = r_driven / (1.0 + r_driven * total[r]) - part
        for c in range(cols):  # numba compiles an assignment of arrays for two seconds
            w[0, c] = g[r, c]
        _solve_factored(a, w[0])
        inner, known = 0.0, 0.0
        for c in range(cols):
            inner += g[r, c] * w[0, c]
            known += g[r, c] * rest[c]
        drive = v_bias / (1.0 + r_driven * total[r])
        scale = drive + change * (known + inner * drive) / (1.0 - change * inner)
        for c in range(cols):
            out[r, c] = (rest[c] + scale * w[0, c] - v_offset[c]) / r_column[c]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_factored(a, x):
    """Solve with the Cholesky factor `a` in place."""
    for c in range(x.size):
        for d in range(c):
            x[c] -= a[c, d] * x[d]
        x[c] /= a[c, c]
    for c in range(x.size - 1, -1, -1):
        x[c] /= a[c, c]
        for d in range(c):
            x[d] -= a[c, d] * x[c]


@njit(cache=True, nogil=True, error_model="numpy")
def _taxels(force, g, e, dt_s, law, sheet):
    """Fill in the conductances `g` [rows, cols] of sheet `e` under forces [rows, cols]; return True with a short."""
    k, points, conductances, exponents, force_on, g_open = law
    factor, stuck, remembers, state, memory_law = sheet
    rows, cols = g.shape
    for r in range(rows):
        for c in range(cols):
            g[r, c] = _conductance(force[r, c], k, points, conductances, exponents, force_on, g_open)
    if remembers:
        apply_sheet(g.reshape(-1), state, memory_law, e, dt_s)
    own, short = e if factor.shape[0] > 1 else 0, False
    for r in range(rows):
        for c in range(cols):
            g[r, c] *= factor[own, r, c]
            if stuck.size and stuck[own, r, c] > 0.0:
                g[r, c] = stuck[own, r, c]
            short = short or g[r, c] > crosstalk.SHORT_S
    return short


@njit(cache=True, nogil=True, error_model="numpy")
def _read_frames(forces, envs, begin, stop, dt_s, law, sheet, network, chip, work, codes):
    """Read frames begin .. stop - 1, frame n of sheet n modulo `envs`, until one has a short; return its number.

    The conductances of that frame are left in the first array of `work`.
    """
    code_max, falling, step, start, inv_range = chip
    g, current, total, volt, a, w = work
    rows, cols = g.shape
    for n in range(begin, stop):
        if _taxels(forces[n], g, n % envs, dt_s[n], law, sheet):
            return n
        if a.size:
            _currents_through_inputs(g, current, network, total, a, w)
        else:
            _currents(g, current, network, total, volt)
        for r in range(rows):
            for c in range(cols):
                seen_a = current[r, c] / (1.0 + abs(current[r, c]) * inv_range[c])
                code = np.floor(seen_a / step[c] + start[c] + 0.5)
                code = min(max(code, 0.0), code_max)
                codes[n, r, c] = code_max - code if falling else code
    return stop


class Skin(Threaded):
    """A sheet and its chip, or many of them, as a robot simulator meets them.

    >>> skin = Skin("single_touch")
    >>> codes = skin.read(np.full((16, 16), 2.0))
    >>> forces = skin.decode(codes)
    >>> many = Skin({"array": {"rows": 8, "cols": 8}}, envs=4096, effects={"sensor_spread": True}, stuck=0.01)
    >>> codes = many.read(np.full((4096, 8, 8), 2.0, np.float32))
    >>> many.reset([3, 17])

    Without hysteresis and creep both directions have no state and may be called from several
    threads. With them a skin is one sheet, or `envs` sheets: frames in order of time, and `reset` for
    new ones. A skin can be pickled; a copy has a state of its own.

    Parameters
    ----------
    scene : str, path, dict or Plan, optional
        A scene by name, path or tables; its stimulus does not matter. Effects of engine closed, or a `[front_end]`.
    calibration : Calibration or path, optional
        What the decoder knows; by default every parameter of the scene. Of `envs` sheets with a random spread it is
        the spread, not the draw of each.
    threads : int
        Threads for batches of a skin without state, and for the sheets of one frame.
    envs : int, optional
        Number of sheets; forces and codes are then [envs, rows, cols] or [frames, envs, rows, cols].
    effects : mapping, optional
        Effects that are added to the scene's, by name, or replace them with all their parameters.
    seed : int, optional
        Instead of the scene's. Sheet e has after its n-th reset the random draws of seed + e + n envs.
    dead, stuck : float
        Probability 0..1 of a taxel that does not conduct, and of one whose conductance is constant, up to full scale.
        Drawn for every sheet, with `envs` at every reset.
    **tables
        Further tables of a scene, as `array={"rows": 8, "cols": 8}`.

    Raises
    ------
    InputError
        The scene is wrong, or has an effect that engine closed cannot do.
    """

    def __init__(
        self,
        scene: str | Path | Mapping[str, Any] | Plan | None = None,
        calibration: Calibration | str | Path | None = None,
        threads: int = 1,
        *,
        envs: int | None = None,
        effects: Mapping[str, Any] | None = None,
        seed: int | None = None,
        dead: float = 0.0,
        stuck: float = 0.0,
        **tables: Any,
    ) -> None:
        super().__init__()
        machine_code.announce()
        if isinstance(scene, Plan):
            if effects or tables or seed is not None:
                allowed = "a scene, where effects, seed or tables are given"
                raise InputError("Skin", "scene", "a plan", allowed)
            self.plan = scene
        else:
            self.plan = _planned(scene, effects, seed, tables)
        for name, value, least, most in (("envs", envs, 1, 1 << 24), ("threads", threads, 1, 1024)):
            if value is not None and not (type(value) is int and least <= value <= most):
                raise InputError("Skin", name, value, f"a whole number {least}..{most}")
        if not argument((dead, stuck), "dead, stuck", (2,), 0.0).sum() <= 1:
            raise InputError("Skin", "dead, stuck", (dead, stuck), "probabilities 0..1, together at most 1")
        engines.check(replace(self.plan, front_end=None))
        ratio = self.plan.scene.effects.get("mirror_ratio")
        if envs is not None and ratio is not None and ratio.spread:
            allowed = "0 with envs: one chip reads all sheets; ratio_error takes a list, one a column"
            raise InputError("Skin", "effects.mirror_ratio.spread", ratio.spread, allowed)
        self.rows, self.cols = self.plan.rows, self.plan.cols
        self.t_frame_s = self.plan.timing.frame_s
        self.threads, self.envs = threads, envs
        self._true = true = Calibration.of_plan(self.plan)
        sheet = effect_registry.gather(self.plan.scene.effects, setting_of(self.plan.scene)).sensor
        self._state, self._share = SensorState(**sheet), (dead, stuck)
        if isinstance(calibration, str | Path):
            calibration = load_calibration(calibration)
        known = true if calibration is None else calibration
        if calibration is None and envs is not None and self._state.spread:
            middle = sheet_factor(replace(self._state, spread=0.0), (self.rows, self.cols), random_of(0))
            known = replace(true, factor=middle, factor_part=self._state.spread)
        known.check(self.rows, self.cols, "calibration")
        kinds = [(c.code_max, c.falling, c.divider) for c in (true, known)]
        self._other_read_out = kinds[0] != kinds[1]
        open_rows = [np.isinf(c.network.get("r_row_grounded_ohm", 0.0)) for c in (true, known)]
        # A single divider may be anywhere in its tolerance.
        steps = [np.exp([np.log(c.step_a).mean()]) if c.divider else c.step_a for c in (true, known)]
        boards = [(way, *a, c.v_bias_v) for way, a, c in zip(open_rows, steps, (true, known), strict=True)]
        # Another resistor, reference or supply; test currents move a step by some per cent.
        other = self._other_read_out or not np.allclose(*boards, rtol=0.1, atol=0)
        if other and self.plan.front_end is not None:
            allowed = "a calibration of the board in [front_end] of the scene, or a scene without it"
            raise InputError("Skin", "calibration", "of another board", allowed)
        self.decoder = Decoder(known, self.t_frame_s)
        self._network, converter = self.plan.network(0), self.plan.converter
        self._arguments = crosstalk.arguments(self._network)
        # Elsewhere the engine's own array solve and count formula do it.
        inputs = self._network.r_column_ohm
        good = crosstalk.lumped(self._network) and (not inputs.any() or inputs.min() >= LEAST_INPUT_OHM)
        if self.plan.front_end is None:
            good = good and (start_of(converter)[1] > 0).all() and (true.full_code == true.code_max).all()
            good = good and np.all(converter.gain > 0)
        self._compiled = bool(good)
        sensor = self.plan.sensor
        if isinstance(sensor, InverseSensor):
            self._law = (sensor.k_force_n_ohm, *np.zeros((3, 1)), 0.0, 0.0)
        else:
            points, ohm = np.array(sensor.force_points_n), np.array(sensor.r_points_ohm)
            open_s = 1.0 / sensor.r_open_ohm
            self._law = (0.0, points, 1.0 / ohm, sensor.exponents(), sensor.force_on_n, open_s)
        sheets = envs or 1
        drawn = sheets if envs and (self._state.spread or dead or stuck) else 1
        self._factor = np.broadcast_to(true.factor, (drawn, self.rows, self.cols)).copy()
        self._stuck = np.zeros((drawn if stuck else 0, self.rows, self.cols))
        self._resets = np.full(sheets, -1, dtype=np.int64)
        self._sheets = Sheets(true.memory, sheets, self.rows * self.cols, self._law[-1])
        self._undone: list[Any] = []
        self.reset()

    def _random(self, e: int) -> Callable[[str], np.random.Generator]:
        later = e + int(self._resets[e]) * self.envs if self.envs else 0
        return random_of((self.plan.seed + later) % (1 << 32))

    def reset(self, which: ArrayLike | None = None) -> None:
        """Start with a fresh sheet, in both directions.

        Parameters
        ----------
        which : array_like, optional
            Of a skin with `envs` the numbers of some sheets, or a mask [envs]; by default all. Only these are drawn
            anew.

        Raises
        ------
        ValueError
            No numbers of sheets and no mask.
        """
        sheets = len(self._resets)
        chosen = np.arange(sheets) if which is None else np.asarray(which)
        if chosen.dtype == np.bool_ and chosen.shape == (sheets,):
            chosen = np.flatnonzero(chosen)
        elif chosen.size == 0:
            chosen = np.empty(0, dtype=np.int64)
        elif which is not None and chosen.shape == (sheets,) and sheets > 1 and chosen.max() <= 1:
            said = "a mask or the numbers 0 and 1: use a mask of bool"
            raise ValueError(f"which may be {said}")
        if chosen.dtype.kind not in "iu" or not ((chosen >= 0) & (chosen < sheets)).all():
            raise ValueError(f"which must be numbers of sheets 0..{sheets - 1}, or a mask of {sheets}")
        chosen = np.unique(chosen)
        with self._lock:
            self._sheets.reset(chosen)
            self._resets[chosen] += 1
            dead, stuck = self._share
            if dead or stuck or (self.envs and self._state.spread):
                for e in chosen:
                    self._draw(int(e), dead, stuck)
        if which is None or self.envs is None:
            self.decoder.reset()
            self._undone = []
        elif self._undone:
            for e in chosen:
                self._undone[e] = self.decoder.fresh()

    def _draw(self, e: int, dead: float, stuck: float) -> None:
        rng, shape = self._random(e), (self.rows, self.cols)
        self._factor[e] = sheet_factor(self._state, shape, rng)
        if dead or stuck:
            drawn, level = rng("skin_defects").random((2, *shape))
            self._factor[e][drawn < dead] = 0.0
            if stuck:
                full_s = self._true.g_max_s / OVERLOAD
                self._stuck[e] = np.where((drawn >= dead) & (drawn < dead + stuck), level * full_s, 0.0)

    def _shaped(self, array: NDArray, name: str) -> int:
        """Return the number of sheets' frames of an array; ValueError if it has another shape."""
        inner = (self.rows, self.cols) if self.envs is None else (self.envs, self.rows, self.cols)
        if array.ndim not in (len(inner), len(inner) + 1) or array.shape[-len(inner) :] != inner:
            allowed = ", ".join(map(str, inner))
            raise ValueError(f"{name} must be [{allowed}] or [frames, {allowed}], not {list(array.shape)}")
        return int(np.prod(array.shape[:-2], dtype=np.int64))

    def _times(self, t_frame_s: float | ArrayLike | None, frames: int) -> Floats:
        given = self.t_frame_s if t_frame_s is None else t_frame_s
        return times(given, frames) if self.envs is None else times(given, frames // self.envs, self.envs)

    def read(
        self, forces_n: ArrayLike, t_frame_s: float | ArrayLike | None = None, out: NDArray | None = None
    ) -> NDArray[np.unsignedinteger]:
        """Read forces with the chip.

        Parameters
        ----------
        forces_n : array_like
            [frames, rows, cols] or [rows, cols] in newtons, of any float or integer type; of many sheets
            [frames, envs, rows, cols] or [envs, rows, cols].
        t_frame_s : float or array_like, optional
            Time in seconds since the frame before, for all frames or each; by default the frame time of the chip. Of
            many sheets a number, [envs], a time a sheet for all frames, or [frames, envs].
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
        InputError
            The calibration is of another read-out than the scene.
        """
        forces = numbers(forces_n, "forces_n")
        count = self._shaped(forces, "forces_n")
        # A sum is NaN if anything is, and needs no second array.
        if forces.size and not (forces.min() >= 0 and forces.sum() < np.inf):
            raise ValueError("forces_n must be finite and 0 or above")
        if self._other_read_out:
            allowed = "that of the scene's own read-out: this one decodes codes of another"
            most = self.decoder.calibration.code_max
            raise InputError("Skin", "calibration", f"of codes to {most}", allowed)
        kind = code_type(self._true.code_max)
        if out is None:
            out = np.empty(forces.shape, kind)
        check_out(out, forces.shape, kind, "out")
        frames, codes = forces.reshape(-1, self.rows, self.cols), out.reshape(-1, self.rows, self.cols)
        dt = self._times(t_frame_s, count)
        remembers, sheets = self._true.memory.active, len(self._resets)
        run = self._read_compiled if self._compiled else self._read_solved
        with self._lock if remembers else contextlib.nullcontext():
            if remembers and count != sheets:
                run(frames, dt, codes, slice(0, count))
            else:
                self._in_threads(count, lambda part: run(frames, dt, codes, part))
        return out

    def decode(
        self, codes: ArrayLike, t_frame_s: float | ArrayLike | None = None, out: Forces | None = None
    ) -> Forces:
        """Decode codes, of the shapes of `read`, into newtons with intervals; see `Decoder.decode`.

        Of many sheets with hysteresis or creep each has half a megabyte of state, and its own call.
        """
        codes, remembers = unmasked(codes, "codes"), self.decoder.calibration.memory.active
        if self.envs is None and (codes.ndim == 2 or remembers or self.threads == 1):
            return self.decoder.decode(codes, t_frame_s, out)
        count = self._shaped(codes, "codes")
        dt = self._times(t_frame_s, count)
        out = Forces.empty(codes.shape) if out is None else out
        flat = [array.reshape(-1, self.rows, self.cols) for array in (codes, *out.writable(codes.shape))]

        def decode_part(part: slice) -> None:
            first, *places = (array[part] for array in flat)
            self.decoder.decode(first, dt[part], Forces(*places))

        if not remembers:
            self._in_threads(count, decode_part)
            return out
        with self._lock:
            self._undone = self._undone or [self.decoder.fresh() for _ in self._resets]
            for e in range(len(self._resets)):
                self.decoder.memory = self._undone[e]
                for n in range(e, count, len(self._resets)):
                    decode_part(slice(n, n + 1))
        return out

    def _in_threads(self, frames: int, work: Callable[[slice], Any]) -> None:
        if self.threads == 1 or frames < 2 * self.threads:
            work(slice(0, frames))
            return
        ends = np.linspace(0, frames, self.threads + 1).astype(int)
        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(work, (slice(a, b) for a, b in pairwise(ends))))

    def _sheet(self) -> tuple:
        sheets = self._sheets
        return self._factor, self._stuck, self._true.memory.active, sheets.arrays(), sheets.law

    def _read_compiled(self, forces: Floats, dt_s: Floats, codes: NDArray, part: slice) -> None:
        true, first = self._true, part.start
        work = getattr(self._local, "work", None)
        if work is None:
            shape, size = (self.rows, self.cols), self.cols if self._network.r_column_ohm.any() else 0
            sizes = shape, shape, self.rows, self.rows, (size, size), (2, size)
            work = self._local.work = tuple(np.empty(size) for size in sizes)
        chip = float(true.code_max), true.falling, true.step_a, true.start_code, true.inv_i_range_a
        network, sheet = self._arguments, self._sheet()
        while first < part.stop:
            place = len(self._resets), first, part.stop
            first = _read_frames(forces, *place, dt_s, self._law, sheet, network, chip, work, codes)
            if first < part.stop:
                # The direct solve of the engine takes over.
                codes[first] = self._codes(work[0][np.newaxis])[0]
                first += 1

    def _codes(self, conductance_s: Floats) -> NDArray[np.unsignedinteger]:
        """Return the codes of taxels [frames, rows, cols] by the array solve and the count of engine closed."""
        currents = column_currents(self._network, conductance_s)
        if self.plan.front_end is not None:
            return self._true.codes_of(currents)
        return closed.codes_of(self.plan, self.plan.converter.duty(currents))

    def _read_solved(self, forces: Floats, dt_s: Floats, codes: NDArray, part: slice) -> None:
        g, sheet = np.empty((part.stop - part.start, self.rows, self.cols)), self._sheet()
        for n, frame in enumerate(g, start=part.start):
            _taxels(forces[n], frame, n % len(self._resets), dt_s[n], self._law, sheet)
        codes[part] = self._codes(g)


def _planned(
    scene: str | Path | Mapping[str, Any] | None,
    effects: Mapping[str, Any] | None,
    seed: int | None,
    tables: Mapping[str, Any],
) -> Plan:
    """Plan a scene by name, path or tables for engine closed, with changes; its stimulus is left out."""
    path, data = scenes.tables_of(scene, "Skin", "a path, a name, a dict or a plan")
    data = scenes.changed(data, path, tables, {} if seed is None else {"seed": seed}, effects)
    data["stimulus"] = {"kind": "uniform", "force_n": [0.0]}
    return plan.make(scenes.from_data(data, path), "closed")
