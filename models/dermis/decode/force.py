# SPDX-License-Identifier: Apache-2.0
"""Decode codes into duty, resistance and force, with the step of each code."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dermis.converter.vfc import W_PRESET, Converter
from dermis.ndarrays import Bools, Floats, unmasked
from dermis.records import Plan


@dataclass(frozen=True, eq=False)
class Decoded:
    """Codes as an ideal read-out understands them; every array is shaped as the codes, [..., rows, cols].

    x : duty c / N, the middle of what reads as this code.
    resistance_ohm, force_n : at x; code 0 decodes to inf and 0. The force is inf where the law is so flat that no force
        makes the resistance.
    force_low_n, force_high_n : ends of the forces that read as this code ideally: x from (c - 1/2) / N, included, to (c
        + 1/2) / N, excluded. The highest code has no upper end (inf).
    d_force_n, d_resistance_ohm : force between the two ends (inf where the upper end is), and the slope R / c of the
        resistance per code, R^2 / (N V_b / (k i0)) (inf at code 0).
    zero, saturated : no pulse at all; full scale or anything above it.
    """

    x: Floats
    resistance_ohm: Floats
    force_n: Floats
    force_low_n: Floats
    force_high_n: Floats
    d_force_n: Floats
    d_resistance_ohm: Floats
    zero: Bools
    saturated: Bools


def decode(plan: Plan, codes: ArrayLike, corrected: bool = False) -> Decoded:
    """Decode codes [..., rows, cols] as the ideal read-out of a plan would have made them.

    `corrected` takes out what the plan's converters and network do: see `currents_of_counts` and `taxels_alone`.

    Raises
    ------
    ValueError
        Codes outside 0..code_max, or a wrong shape.
    """
    codes = unmasked(codes, "codes")
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
        seen = x
        if plan.converter.active_fields():
            seen = currents_of_counts(plan, steps) / (plan.converter.k * plan.converter.i0_a)
        alone = taxels_alone(plan, seen)
        scale, x = np.divide(alone, x, out=scale, where=x > 0), alone
    resistance = plan.ohm_of_duty(x)
    low = plan.force_of_duty(scale * np.maximum(steps - 0.5, 0.0) / gate)
    high = plan.force_of_duty(scale * (steps + 0.5) / gate)
    with np.errstate(divide="ignore", invalid="ignore"):
        d_resistance = np.where(steps > 0, resistance * np.divide(1.0, steps), np.inf)
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


def start_of(c: Converter) -> tuple[Floats, Floats]:
    """Return the charge packet [cols], relative to the ideal one, and what is missing to it at the start of a gate."""
    return 1.0 + c.packet_error, -W_PRESET + (c.v_comp_offset_v - c.preset_error_v) / c.packet_v()


def currents_of_counts(plan: Plan, counts: ArrayLike) -> Floats:
    """Column currents in ampere that a plan's converters read as counts [..., rows, cols], which may be fractions.

    Undoes offset, gain, packet, preset, decision level and compression; a count c stands for the middle of its code.
    """
    c = plan.converter
    packet, start = start_of(c)
    x = (start + (np.asarray(counts, dtype=float) - 0.5) * packet) / plan.timing.gate_clocks
    current = c.k * (x * c.i0_a - c.i_offset_a) / c.gain
    # Beyond the range of the mirror no current makes this duty.
    return current / np.maximum(1.0 - np.abs(current) * c.inv_i_range_a, 1e-9)


def taxels_alone(plan: Plan, x: Floats) -> Floats:
    """Duties that taxels of the duties x [..., rows, cols], in packets a clock, would have between ideal lines.

    Network, offsets and leaks of the plan are taken out; see `crosstalk.solve`. inf for a short, NaN in a frame whose
    solution did not converge.
    """
    network = plan.network(0)
    if not network.active_fields():
        return x
    unit_a = plan.converter.k * plan.converter.i0_a
    currents = (np.asarray(x, dtype=float) * unit_a).reshape(-1, *x.shape[-2:])
    from dermis.decode import crosstalk  # compiled

    solved = crosstalk.solve(network, currents)
    found = np.where(solved.converged[:, None, None], solved.conductance_s, np.nan)
    return (found * (plan.v_bias_v / unit_a)).reshape(x.shape)
