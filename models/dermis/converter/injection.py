# SPDX-License-Identifier: Apache-2.0
"""Charge that capacitances bring into converters: upper bounds, not a simulation."""

import math
from typing import Any

import numpy as np

from dermis.array import settling
from dermis.converter.vfc import W_PRESET, Y_MIN
from dermis.errors import InputError
from dermis.ndarrays import Floats

CAPACITANCES = frozenset({"c_row_f", "c_column_f", "c_taxel_f"})
# Packets in a whole gate that lines may bring after they have settled: far below any bound of a level.
LEFT_OUT = 1e-6


def check_lines(plan: Any, frames: slice = slice(None)) -> None:
    """Refuse lines that have not settled when a gate opens: InputError.

    They may bring at most `LEFT_OUT` packets in a gate.
    """
    if not plan.active_fields() & CAPACITANCES:
        return
    network, g = plan.network(0), plan.conductance_s(frames)
    per_c = np.abs(plan.converter.gain / (plan.converter.k * plan.converter.i0_a)) * plan.timing.f_clk_hz
    left = float((settling.bound_c(network, g, plan.timing) * per_c).max())
    if not left <= LEFT_OUT:
        said = f"not settled when the gate opens (up to {left:.2g} LSB)"
        allowed = f"lines that settle to {LEFT_OUT:g} LSB, or engine cosim"
        raise InputError(plan.scene.path, "effects.line_capacitance", said, allowed)


def counts(plan: Any) -> dict[str, Floats]:
    """Return upper bounds of the injected charge in LSB, [cols], by field.

    `ripple`: a bias that ripples pushes C dV through the taxel of the driven row.

    `inv_gain_dc`, `t_gbw_s`: in the direct interface the column, with its taxels to rows that stand still, is across
    the input of the integrator. C u' joins the balance c_int (u + v)' of the summing node's u and the output v, and
    u = v / A + t v' is the amplifier: of a charge w, C / c_int / (1 + A) stands there, and t grows by C / c_int. The
    output moves by no more than a packet a clock.

    `q_mirror_c`: a row that is driven pushes C V through a taxel into a slow mirror, and lines hold back the charge of
    a time constant until they have settled. The mirror, y' = y (x - y) / q, adds at most what came; and at most what
    waking it up takes, q ln(y / y_min) with y = q / (e settle), plus q ln(1 + gate / settle) from however far above.

    Where a range bites, each further packet may lose as much again as the first was off. Lines are
    taken without resistance, where all but the last is largest.
    """
    converter, drive, timing, found = plan.converter, plan.drive, plan.timing, {}
    taxel_f, column_f = (float(plan.surrounding.get(name, 0.0)) for name in ("c_taxel_f", "c_column_f"))
    packet_c = converter.k * converter.i0_a / converter.f_clk_hz
    if drive.ripple and taxel_f:
        angle = 2.0 * math.pi * drive.f_ripple_hz * timing.gate_clocks / converter.f_clk_hz
        swing_v = abs(drive.ripple) * plan.v_bias_v * min(angle, 2.0)
        found["ripple"] = np.abs(converter.gain) * taxel_f * swing_v / packet_c
    across_f = column_f + plan.rows * taxel_f
    if plan.topology == "direct" and across_f:
        levels_v = (
            np.abs(converter.preset_error_v) + np.abs(converter.v_comp_offset_v) + converter.v_hysteresis_v
        )
        reach = 1.0 - W_PRESET + levels_v / converter.packet_v()
        share = converter.inv_gain_dc / (1.0 + converter.inv_gain_dc)
        found["inv_gain_dc"] = share * across_f / converter.c_int_f * reach
        found["t_gbw_s"] = converter.t_gbw_s * converter.f_clk_hz * across_f / converter.c_int_f
    slow_mirror = bool(converter.q_mirror_c.any())
    late = (
        settling.slowest_s(plan.network(0), plan.conductance_s()) * converter.f_clk_hz if slow_mirror else 0.0
    )
    late = late if late > settling.FAST_CLOCKS else 0.0
    if slow_mirror and (taxel_f or late):
        jump = np.abs(converter.gain) * taxel_f * plan.v_bias_v * (1.0 + abs(drive.ripple)) / packet_c
        slow = converter.q_mirror_c * converter.f_clk_hz / converter.i0_a
        settle = max(timing.settle_clocks - timing.break_clocks, 1)
        woken = np.log1p(slow / (math.e * settle * Y_MIN))
        most = slow * (woken + math.log1p(timing.gate_clocks / settle))
        # A packet a clock is twice full scale; a mirror forgets from how far above it falls.
        found["q_mirror_c"] = np.minimum(jump + late, most)
    if converter.range_clips():
        found = {name: counts * (1.0 + (timing.gate_clocks + 1) / 2) for name, counts in found.items()}
    return found
