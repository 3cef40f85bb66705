# SPDX-License-Identifier: Apache-2.0
"""From codes back to duty, resistance and force, with the step each code stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.array.array import column_currents_by_source
from dermis.records import Plan

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Decoded:
    """What codes mean to an ideal read-out; every array is shaped as the codes, [..., rows, cols].

    Attributes
    ----------
    x : ndarray
        Duty c / N, the middle of what reads as this code.
    resistance_ohm, force_n : ndarray
        At x; code 0 decodes to inf and 0. Of a law so flat that no force makes the resistance the
        force is inf.
    force_low_n, force_high_n : ndarray
        What reads as this code ideally: x from (c - 1/2) / N, included, to (c + 1/2) / N, excluded. The
        highest code has no upper end (inf).
    d_force_n, d_resistance_ohm : ndarray
        Force from one end of the code to the other (from 0 to the first threshold for code 0; inf where the upper end
        is), and the slope R / c of the resistance per code, R^2 / (N V_b / (k i0)) (inf at code 0).
    zero, saturated : ndarray of bool
        No pulse at all; full scale or anything above it.
    """

    x: Floats
    resistance_ohm: Floats
    force_n: Floats
    force_low_n: Floats
    force_high_n: Floats
    d_force_n: Floats
    d_resistance_ohm: Floats
    zero: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


def decode(plan: Plan, codes: ArrayLike, corrected: bool = False) -> Decoded:
    """Decode codes [..., rows, cols] as the ideal read-out of a plan would have made them.

    `corrected` puts back what the plan's network takes: see `taxels_alone`.

    Raises
    ------
    ValueError
        Codes outside 0..code_max, or a wrong shape.
    """
    codes = np.asarray(codes)
    if codes.dtype.kind not in "iu" or codes.shape[-2:] != (plan.rows, plan.cols):
        raise ValueError(f"codes must be integers [..., {plan.rows}, {plan.cols}]")
    code_max, gate = plan.timing.code_max, plan.timing.gate_clocks
    if codes.size and (codes.min() < 0 or codes.max() > code_max):
        raise ValueError(f"codes must be 0..{code_max}")
    steps = codes.astype(float)
    x = steps / gate
    # Half a code more or less goes through the network as the code itself.
    scale = np.ones_like(x)
    if corrected:
        alone = taxels_alone(plan, x)
        scale, x = np.divide(alone, x, out=scale, where=x > 0), alone
    resistance = plan.ohm_of_duty(x)
    low = plan.force_of_duty(scale * np.maximum(steps - 0.5, 0.0) / gate)
    high = plan.force_of_duty(scale * (steps + 0.5) / gate)
    with np.errstate(divide="ignore"):
        per_code = np.divide(1.0, steps)
    with np.errstate(invalid="ignore"):
        d_resistance = np.where(steps > 0, resistance * per_code, np.inf)
    return Decoded(
        x=x,
        resistance_ohm=resistance,
        force_n=plan.sensor.force_n(resistance),
        force_low_n=low,
        force_high_n=np.where(codes == code_max, np.inf, high),
        d_force_n=np.subtract(high, low, out=np.full(x.shape, np.inf), where=np.isfinite(high)),
        d_resistance_ohm=d_resistance,
        zero=codes == 0,
        saturated=codes == code_max,
    )


SWEEPS = 8
"""How often `taxels_alone` goes through the array: with a tenth of a current lost, each leaves a tenth of the error."""


def taxels_alone(plan: Plan, x: Floats, sweeps: int = SWEEPS) -> Floats:
    """Duties of the taxels as if nothing stood between them and ideal drivers and inputs, of measured duties x.

    All codes of a row are of one instant, so what a driver's resistance takes from them is known:
    G = I / (V_b - R_on sum I). With real columns and traces the rows meet, and each sweep corrects every conductance by
    what the modelled current misses. The network is that of the plan, as a calibration would have found it; offsets
    and leaks are taken off first.

    Parameters
    ----------
    plan : Plan
    x : ndarray
        [..., rows, cols] packets a clock.
    sweeps : int
        Corrections; each costs a solve of the array.
    """
    network = plan.network(0)
    if not network.active_fields():
        return x
    shape = x.shape
    x = np.asarray(x, dtype=float).reshape(-1, *shape[-2:])
    to_siemens = plan.converter.k * plan.converter.i0_a / plan.v_bias_v
    g = x * to_siemens
    for _ in range(sweeps):
        follows, rest = column_currents_by_source(network, g)
        missing = plan.v_bias_v * to_siemens * x - follows - (0.0 if rest is None else rest)
        # Siemens an ampere: those of the taxel as it is seen, or without loss where its neighbours make its current.
        each = np.divide(g, follows, out=np.zeros_like(g), where=follows > 0)
        g = np.maximum(g + missing * np.maximum(each, 1.0 / plan.v_bias_v), 0.0)
    return (g / to_siemens).reshape(shape)
