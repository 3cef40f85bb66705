# SPDX-License-Identifier: Apache-2.0
"""The law of a sheet for decoding: force as a function of conductance, known or fitted."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from dermis.machine_code import argument
from dermis.ndarrays import Floats
from dermis.scene.sensor import InverseSensor, PowerSensor

_BISECTIONS = 200
CONTRADICTION = 0.2
"""Part of the largest force by which a table may differ from its loads to be monotone."""
POINTS = 16
"""Most points of a table."""
PARAMETERS = {"linear": 1, "power": 2, "cubic": 3, "table": POINTS}
"""Laws that can be fitted, with their number of parameters."""
ENOUGH = {"power": 6, "cubic": 9, "table": 2 * POINTS}
"""Different forces from which on a taxel may have its own law; a linear one is the taxel's factor."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Force over conductance as a piecewise cubic, in linear or in logarithmic coordinates.

    kind : "linear", "power", "cubic" or "table", for reports.
    logarithmic : whether knots and values are natural logarithms.
    knots : [n] conductance in siemens, or its logarithm, rising. The ends continue.
    coefficients : [n, 4] of 1, t, t^2, t^3 with t the distance from the knot; force in newtons, or its logarithm.
    g_open_s : at or below this conductance the force is 0.
    force_on_n : least force above g_open_s.
    """

    kind: str
    logarithmic: bool
    knots: Floats
    coefficients: Floats
    g_open_s: float = 0.0
    force_on_n: float = 0.0

    def __post_init__(self) -> None:
        knots = argument(self.knots, "knots", (None,))
        if not knots.size or not (np.diff(knots) > 0).all():
            raise ValueError("knots must rise, and be at least one")
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "coefficients", argument(self.coefficients, "coefficients", (knots.size, 4)))

    def force_n(self, conductance_s: ArrayLike) -> Floats:
        """Force in newtons of conductances in siemens, any shape."""
        g = np.array(conductance_s, dtype=float, order="C")
        out = np.empty(g.size)
        law = self.logarithmic, self.knots, self.coefficients, self.g_open_s, self.force_on_n
        _forces(g.ravel(), out, *law)
        out[np.isnan(g.ravel())] = np.nan
        return out.reshape(g.shape)

    def conductance_s(self, force_n: ArrayLike) -> Floats:
        """Least conductance in siemens that makes at least this force in newtons, any shape; found by bisection."""
        force = np.asarray(force_n, dtype=float)
        low, high = np.full(force.shape, -700.0), np.full(force.shape, 700.0)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            enough = self.force_n(np.exp(middle)) >= force
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        return np.where(force <= 0, 0.0, np.exp(high))


@njit(cache=True, nogil=True, error_model="numpy")
def force_of(g, logarithmic, knots, coefficients, g_open, force_on):
    """Force in newtons of one conductance in siemens."""
    if not g > g_open or g <= 0.0:
        return 0.0
    if g == np.inf:
        return np.inf
    s = np.log(g) if logarithmic else g
    n = 0
    while n + 1 < knots.size and s >= knots[n + 1]:
        n += 1
    t = s - knots[n]
    a = coefficients[n]
    value = a[0] + t * (a[1] + t * (a[2] + t * a[3]))
    if logarithmic:
        value = np.exp(value) if value < 690.0 else np.inf
    return max(value, force_on, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _forces(g, out, logarithmic, knots, coefficients, g_open, force_on):
    for n in range(g.size):
        out[n] = force_of(g[n], logarithmic, knots, coefficients, g_open, force_on)


def of_sensor(sensor: InverseSensor | PowerSensor) -> Curve:
    """Return the curve of a scene's law."""
    if isinstance(sensor, InverseSensor):
        return _polynomial("linear", [sensor.k_force_n_ohm])
    knots = -np.log(sensor.r_points_ohm)
    coefficients = np.zeros((knots.size, 4))
    coefficients[:, 0] = np.log(sensor.force_points_n)
    coefficients[:, 1] = 1.0 / sensor.exponents()
    return Curve("power", True, knots, coefficients, 1.0 / sensor.r_open_ohm, sensor.force_on_n)


def _polynomial(kind: str, powers: ArrayLike) -> Curve:
    """Return the curve F = a1 G + a2 G^2 + a3 G^3."""
    row = np.zeros((1, 4))
    row[0, 1 : 1 + len(powers)] = powers
    return Curve(kind, False, np.zeros(1), row)


class LawError(ValueError):
    """Loads that no law of the kind fits."""


def fit(kind: str, conductance_s: ArrayLike, force_n: ArrayLike) -> Curve:
    """Fit a law to loads by least squares in force.

    `kind` is "linear" F = a G, "power" F = a G^n or "cubic" F = a G + b G^2 + c G^3, as compared by Brimacombe et al.,
    J. Biomech. Eng. 131 (2009) 034503; or "table", a monotone spline (Fritsch and Carlson) through means of up to
    `POINTS` groups of loads, in logarithms. Loads are in siemens and newtons, in any order; those at 0 do not count.
    LawError for too few loads, or a fit whose force falls with conductance.
    """
    g, force = np.asarray(conductance_s, dtype=float).ravel(), np.asarray(force_n, dtype=float).ravel()
    used = (g > 0) & (force > 0) & np.isfinite(g)
    g, force = g[used], force[used]
    needed = min(PARAMETERS[kind], 3) if kind != "table" else 2
    if np.unique(force).size < needed:
        raise LawError(f"law {kind} needs {needed} loads of different force, {np.unique(force).size} given")
    if kind == "power":
        # Relative errors first, since a logarithm is linear in the unknowns; then errors in newtons.
        slope, level = np.polyfit(np.log(g), np.log(force), 1)
        for _ in range(20):
            made = np.exp(level + slope * np.log(g))
            matrix = made[:, None] * np.stack([np.ones_like(g), np.log(g)], axis=1)
            step = np.linalg.lstsq(matrix, force - made, rcond=None)[0]
            level, slope = level + step[0], slope + step[1]
        if slope <= 0:
            raise LawError("force falls with conductance")
        return Curve("power", True, np.zeros(1), np.array([[level, slope, 0.0, 0.0]]))
    if kind == "table":
        return _table(g, force)
    scale = g.max()
    powers = np.arange(1, 2 if kind == "linear" else 4)
    a = np.linalg.lstsq((g[:, None] / scale) ** powers, force, rcond=None)[0] / scale**powers
    curve = _polynomial(kind, a)
    if (np.diff(curve.force_n(np.linspace(0, scale, 200))) < 0).any():
        raise LawError(f"the {kind} fit falls with conductance within the loads: use law power or table")
    if kind == "cubic":
        # Beyond the loads the tangent: a cubic may turn.
        end = np.polynomial.Polynomial([0.0, *a])
        rows = np.array([[0.0, *a], [end(scale), end.deriv()(scale), 0.0, 0.0]])
        return Curve(kind, False, np.array([0.0, scale]), rows)
    return curve


def _table(g: Floats, force: Floats) -> Curve:
    groups = np.array_split(np.argsort(g), min(POINTS, g.size))
    knots, means = np.array([(np.log(g[group]).mean(), np.log(force[group]).mean()) for group in groups]).T
    values = isotonic_regression(means).x
    if np.abs(np.exp(means) - np.exp(values)).max() > CONTRADICTION * np.exp(values.max()):
        near = np.exp(means.max())
        raise LawError(f"loads contradict each other: force falls with conductance near {near:.4g} N")
    # Knots closer than rounding would divide a difference of values by noise.
    keep = np.concatenate([[True], (np.diff(knots) > 1e-12) & (np.diff(values) > 0)])
    knots, values = knots[keep], values[keep]
    if knots.size < 2:
        raise LawError("force does not rise with conductance")
    spline = PchipInterpolator(knots, values)
    slope = np.diff(values) / np.diff(knots)
    first, last = slope[0], slope[-1]
    # Both ends go on as power laws; force_of continues the first piece below its knot.
    rows = np.vstack([[values[0] - first, first, 0, 0], spline.c[::-1].T, [values[-1], last, 0, 0]])
    return Curve("table", True, np.r_[knots[0] - 1.0, knots], np.ascontiguousarray(rows))
