# SPDX-License-Identifier: Apache-2.0
"""Codes of a frame with effects in 50 digits: the network by elimination, the converter from clock
to clock.

Slow and obvious on purpose; it shares only the records with the engines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from dermis.records import Plan

DIGITS = 50

HONOURS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "gain",
        "i_offset_a",
        "packet_error",
        "preset_error_v",
        "v_comp_offset_v",
        "t_gbw_s",
    }
)
"""Record fields it takes; any other is refused."""


def _column_currents(plan: Plan, frame: int, row: int) -> list[mpf]:
    """Return currents into the virtual grounds while a row is driven: Kirchhoff at every line, by
    LU factors.
    """
    network = plan.network(frame)
    rows, cols = network.rows, network.cols
    g = [[mpf(float(x)) for x in line] for line in network.g_taxel_s]
    r_driven, r_ground = mpf(float(network.r_row_driven_ohm)), mpf(float(network.r_row_grounded_ohm))
    r_column = [mpf(float(r)) for r in np.broadcast_to(network.r_column_ohm, (cols,))]
    if not (r_driven and r_ground and all(r_column)):
        raise ValueError("the reference needs resistance in every driver and column")
    matrix, source = mp.matrix(rows + cols, rows + cols), mp.matrix(rows + cols, 1)
    for r in range(rows):
        driver = 1 / (r_driven if r == row else r_ground)
        matrix[r, r] += driver
        if r == row:
            source[r] = driver * mpf(float(network.v_bias_v))
        for c in range(cols):
            matrix[r, r] += g[r][c]
            matrix[rows + c, rows + c] += g[r][c]
            matrix[r, rows + c] -= g[r][c]
            matrix[rows + c, r] -= g[r][c]
    for c in range(cols):
        matrix[rows + c, rows + c] += 1 / r_column[c]
    solution = mp.lu_solve(matrix, source)
    return [solution[rows + c] / r_column[c] for c in range(cols)]


def count(x: mpf, clocks: int, packet: mpf, start: mpf, level: mpf, lag: mpf) -> tuple[int, mpf]:
    """Count ones in a gate and return the charge at its end; the output v follows the charge w.

    All in packets and clocks, `lag` is the time constant. A one decided at clock n draws its packet
    between the clocks n + 1 and n + 2.
    """
    w = v = start
    decay = mp.exp(-1 / lag) if lag else mpf(0)
    ones, last, before = 0, False, False  # decided at this clock and at the one before
    for _ in range(clocks):
        current = x - (packet if before else 0)
        if lag:
            v = w + current * (1 - lag) + (v - w + current * lag) * decay
        w += current
        if not lag:
            v = w
        before, last = last, bool(v >= level) and not last
        ones += last
    return ones, w


@dataclass(frozen=True)
class Frame:
    """A frame, all [rows, cols]: codes, charge at the end of each gate and input a clock in
    packets.
    """

    codes: NDArray[np.int64]
    w_end: NDArray[np.float64]
    x: NDArray[np.float64]


def codes(plan: Plan, frames: int) -> NDArray[np.int64]:
    """Return codes of the first frames of a plan; raises as `frame` does."""
    return np.array([frame(plan, number).codes for number in range(frames)])


@mp.workdps(DIGITS)
def frame(plan: Plan, number: int = 0) -> Frame:
    """Return one frame of a plan.

    Raises
    ------
    ValueError
        A field of the records that this reference does not model is not ideal.
    """
    if unknown := plan.active_fields() - HONOURS:
        raise ValueError(f"no reference for {', '.join(sorted(unknown))}")
    converter = plan.converter
    shape = (plan.rows, plan.cols)
    found = Frame(np.zeros(shape, dtype=np.int64), np.zeros(shape), np.zeros(shape))
    f_clk = mpf(converter.f_clk_hz)
    for row in range(plan.rows):
        for c, current in enumerate(_column_currents(plan, number, row)):
            k, i0 = mpf(float(converter.k[c])), mpf(float(converter.i0_a[c]))
            packet_v = i0 / f_clk / mpf(float(converter.c_int_f[c]))
            x = (mpf(float(converter.gain[c])) * current / k + mpf(float(converter.i_offset_a[c]))) / i0
            ones, w_end = count(
                x,
                plan.timing.gate_clocks,
                1 + mpf(float(converter.packet_error[c])),
                mpf(-1) / 2 + mpf(float(converter.preset_error_v[c])) / packet_v,
                mpf(float(converter.v_comp_offset_v[c])) / packet_v,
                mpf(float(converter.t_gbw_s[c])) * f_clk,
            )
            found.codes[row, c] = min(ones, plan.timing.code_max)
            found.w_end[row, c], found.x[row, c] = float(w_end), float(x)
    return found
