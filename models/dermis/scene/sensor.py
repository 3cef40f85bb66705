# SPDX-License-Identifier: Apache-2.0
"""The taxel: resistance from force, force from resistance, and the spread of a sheet."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from dermis.ndarrays import Bools, Floats
from dermis.scene import design as designs
from dermis.scene.schema import Strict, entry, filled, refuse

_ForcePoint = Annotated[float, Field(ge=1e-9, le=1e9)]
_OhmPoint = Annotated[float, Field(ge=1e-6, le=1e15)]

# Neighbouring points this close have no slope worth the name, and the logarithm of their ratio would vanish.
_POINT_RATIO = 1.001

# Larger forces are infinite: the law is so flat that no force gives such a resistance. Sums over a sheet stay finite.
_FORCE_MAX_N = 1e300


class SensorTable(Strict):
    """[sensor]: the law between force and resistance."""

    law: Literal["inverse", "power"] = entry(
        "inverse",
        'Force law; "inverse" is Force = K/R, the paper\'s; "power" is the measured curve of an FSR, a power law '
        "between points, open below its turn-on",
    )
    k_force_n_ohm: float | None = entry(
        None,
        "law inverse: K of Force = K/R, in N.ohm",
        default_from="sensor.force_max_n * sensor.r_min_ohm",
        gt=0,
    )
    force_points_n: Annotated[list[_ForcePoint], Field(min_length=2, max_length=1000)] | None = entry(
        None,
        "law power: forces in N, each at least 0.1 % above the one before",
        "a list of at least 2 numbers from 1e-9 to 1e9, rising",
        default_from="sensor.force_points_n",
    )
    r_points_ohm: Annotated[list[_OhmPoint], Field(min_length=2, max_length=1000)] | None = entry(
        None,
        "law power: the resistance at each of them, in ohm; the slopes at both ends go on",
        "a list of at least 2 numbers from 1e-6 to 1e15, falling, one a force point",
        default_from="sensor.r_points_ohm",
    )
    force_on_n: float | None = entry(
        None, "law power: a smaller force leaves the taxel open, in N", default_from="sensor.force_on_n", ge=0
    )
    r_open_ohm: Annotated[float, Field(gt=0, allow_inf_nan=True)] | None = entry(
        None,
        "law power: resistance of an open taxel, in ohm",
        "a number above the first of r_points_ohm (inf is legal)",
        default_from="sensor.r_open_ohm",
    )


_KEYS = {
    "inverse": ("k_force_n_ohm",),
    "power": ("force_points_n", "r_points_ohm", "force_on_n", "r_open_ohm"),
}


@dataclass(frozen=True)
class InverseSensor:
    """Force = K/R."""

    k_force_n_ohm: float  # K

    def resistance_ohm(self, force_n: ArrayLike) -> Floats:
        """R = K/F of a force in newtons, any shape; F = 0 gives inf and F = inf gives 0."""
        # + 0.0 turns -0.0 into 0.0, whose inverse is +inf.
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(self.k_force_n_ohm, np.asarray(force_n, dtype=float) + 0.0)

    def force_n(self, resistance_ohm: ArrayLike) -> Floats:
        """F = K/R of a resistance in ohm, any shape; R = inf gives 0 and R = 0 gives inf."""
        return self.resistance_ohm(resistance_ohm)


@dataclass(frozen=True)
class PowerSensor:
    """R = R_i (F/F_i)^-n between each two measured points, the slopes at both ends continued; open below turn-on.

    The two methods undo each other for every force that turns the taxel on. No force makes a
    resistance between the curve at turn-on and r_open_ohm; such a one means the force of turn-on,
    so that decoding stays monotone.
    """

    force_points_n: tuple[float, ...]  # rising
    r_points_ohm: tuple[float, ...]  # falling
    force_on_n: float  # smaller forces leave the taxel open
    r_open_ohm: float  # of an open taxel, and the highest there is; inf is legal

    def exponents(self) -> Floats:
        """Exponent n of R ~ F^-n after each point; the last equals the one before."""
        force, ohm = np.array(self.force_points_n), np.array(self.r_points_ohm)
        slopes = np.log(ohm[:-1] / ohm[1:]) / np.log(force[1:] / force[:-1])
        return np.append(slopes, slopes[-1])

    def resistance_ohm(self, force_n: ArrayLike) -> Floats:
        """R in ohm of a force in newtons, any shape; r_open_ohm below turn-on, 0 for F = inf."""
        force = np.asarray(force_n, dtype=float)
        points = np.array(self.force_points_n)
        at = np.maximum(np.searchsorted(points, force, side="right") - 1, 0)
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            ohm = np.array(self.r_points_ohm)[at] * np.abs(force / points[at]) ** -self.exponents()[at]
        return np.where(force < self.force_on_n, self.r_open_ohm, np.minimum(ohm, self.r_open_ohm))

    def force_n(self, resistance_ohm: ArrayLike) -> Floats:
        """F in newtons of a resistance; 0 from r_open_ohm on, inf above 1e300 and for R = 0."""
        ohm = np.asarray(resistance_ohm, dtype=float)
        points = np.array(self.r_points_ohm)
        at = np.maximum(np.searchsorted(-points, -ohm, side="right") - 1, 0)
        power = -1.0 / self.exponents()[at]
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            force = np.array(self.force_points_n)[at] * np.abs(ohm / points[at]) ** power
        force = np.where(force > _FORCE_MAX_N, np.inf, force)
        return np.where(ohm >= self.r_open_ohm, 0.0, np.maximum(force, self.force_on_n))


Random = Callable[[str], np.random.Generator]
"""Name of an effect -> its generator."""
Sensor = InverseSensor | PowerSensor
"""A law without memory; `age` adds the memory of a sheet."""


def resolve(table: SensorTable, defaults: designs.Sensor, file: Path | str) -> SensorTable:
    """Fill in the keys of the law; refuse those of another law, and points without a curve."""
    table = filled(table, {key: getattr(defaults, key) for key in _KEYS[table.law]})
    refuse(_wrong(table), table, file, "sensor.")
    return table


def _wrong(table: SensorTable) -> Iterator[tuple[str, str]]:
    for law, keys in _KEYS.items():
        if law != table.law:
            said = f'left out with law "{table.law}"'
            yield from ((key, said) for key in keys if getattr(table, key) is not None)
    if table.law == "power":
        force, ohm = np.array(table.force_points_n), np.array(table.r_points_ohm)
        if (force[1:] < force[:-1] * _POINT_RATIO).any():
            yield "force_points_n", "forces that rise, by 0.1 % at least"
        if ohm.size != force.size or (ohm[1:] * _POINT_RATIO > ohm[:-1]).any():
            yield "r_points_ohm", f"{force.size} resistances, one a force point, that fall by 0.1 % at least"
        if not table.r_open_ohm > ohm[0]:
            yield "r_open_ohm", f"a number above the first of r_points_ohm, {ohm[0]:g} (inf is legal)"


def make_sensor(table: SensorTable) -> Sensor:
    """Make the sensor of a resolved [sensor] table."""
    if table.law == "inverse":
        return InverseSensor(table.k_force_n_ohm)
    points = tuple(table.force_points_n), tuple(table.r_points_ohm)
    return PowerSensor(*points, table.force_on_n, table.r_open_ohm)


@dataclass(frozen=True)
class SensorState:
    """Deviations of a sheet from its law; none by default."""

    hysteresis: float = 0.0  # largest relative decrease of the resistance while the force falls, 0..1
    creep_per_decade: float = 0.0  # relative growth of the conductance, a factor of ten in time under load
    temperature_error: float = 0.0  # relative change of every conductance, above -1
    spread: float = 0.0  # relative standard deviation of the conductance from taxel to taxel


def age(
    sensor: Sensor, by_law: Floats, t_frame_s: float, state: SensorState, creep_start_s: float, rng: Random
) -> Floats:
    """Turn the resistances of a law into those of a sheet in some state; in the default state, return them as given.

    Parameters
    ----------
    sensor : the law; it says which taxels are under load
    by_law : resistances in ohm [frames, rows, cols], 0..inf, one frame each t_frame_s
    creep_start_s : see `creep_decades`
    rng : asked for only where the state has a spread
    """
    resistance_ohm = by_law
    with np.errstate(over="ignore"):
        if state.hysteresis:
            resistance_ohm = play(resistance_ohm, state.hysteresis)
        if state.creep_per_decade:
            decades = creep_decades(sensor.force_n(by_law) > 0, t_frame_s, creep_start_s)
            resistance_ohm = resistance_ohm / (1.0 + state.creep_per_decade * decades)
        if state.temperature_error:
            resistance_ohm = resistance_ohm / (1.0 + state.temperature_error)
        if state.spread:
            draw = rng("sensor_spread").standard_normal(resistance_ohm.shape[1:])
            resistance_ohm = resistance_ohm / spread_factor(draw, state.spread)
    return resistance_ohm


def play(resistance_ohm: Floats, width: float) -> Floats:
    """Hysteresis of resistances along axis 0: the play operator between the law R and (1 - width) R.

    A rising force (falling R) follows the law, a falling one the law times 1 - width; in between
    the resistance stays where it was. That is the play (backlash) operator of Preisach's theory on
    log R, so loops close, do not depend on speed, and forget a small loop inside a larger one. The
    data sheet's +10 % is (R+ - R-)/R+ of a force on the way up and back. It starts on the way up.
    """
    out = np.array(resistance_ohm, dtype=float)
    for n in range(1, out.shape[0]):
        out[n] = np.maximum(np.minimum(out[n - 1], resistance_ohm[n]), resistance_ohm[n] * (1.0 - width))
    return out


# Step of the trapezoid in log rate: its error is exp(-pi^2/h), 2e-11, because the integrand is analytic to +-i pi/2.
_RATE_STEP = 0.4


def creep_decades(loaded: Bools, t_frame_s: float, start_s: float) -> Floats:
    """Decades of time that load has lasted, with memory along axis 0, [frames, ...].

    A step of load at t = 0 gives log10(1 + t/start_s). What it gave is forgotten in the same way:
    released at t1, log10(1 + t/start_s) - log10(1 + (t - t1)/start_s). That is Boltzmann's
    superposition with the kernel 1/(start_s + t), whatever the order of loads. The kernel is the
    integral of exp(-s (start_s + t)) over the rates s, so one state a rate and taxel carries it
    from frame to frame.

    Parameters
    ----------
    loaded : True for a taxel that carries load from frame n to frame n + 1
    t_frame_s, start_s : time from frame to frame, and the time at which the first decade starts
    """
    from dermis.scene.sensor_loops import advance_creep  # numba takes 0.4 s to load

    if not (0 <= t_frame_s < np.inf and 0 < start_s < np.inf):
        raise ValueError("t_frame_s must be finite and 0 or above, start_s above 0")
    touched = loaded.any(axis=0)
    load, out = loaded[:, touched], np.zeros(loaded.shape)
    rate, weight = creep_rates(start_s, len(load) * t_frame_s)
    state = np.zeros((load.shape[1], rate.size))
    for n in range(1, len(load)):
        advance_creep(state, load[n - 1], rate, weight, t_frame_s)
        out[n, touched] = state.sum(axis=1)
    return out


def creep_rates(start_s: float, longest_s: float) -> tuple[Floats, Floats]:
    """Return rates in 1/s and weights in decades of the kernel of `creep_decades`."""
    lowest, highest = 1e-10 / (start_s + longest_s), 45.0 / start_s
    rate = np.exp(np.arange(np.log(lowest), np.log(highest), _RATE_STEP))
    with np.errstate(under="ignore"):
        return rate, _RATE_STEP * np.exp(-rate * start_s) / np.log(10.0)


def spread_factor(draw: Floats, relative: float) -> Floats:
    """Return log-normal factors of mean 1 and deviation `relative` from normal draws."""
    sigma = np.sqrt(np.log1p(relative * relative))
    return np.exp(sigma * draw - sigma * sigma / 2)
