# SPDX-License-Identifier: Apache-2.0
"""Bound of the RC transients that are left of a row slot when its gate opens."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dermis.array.array import Network, in_range
from dermis.ndarrays import Floats
from dermis.timing import Timing

# A taxel below 0.1 milliohm counts as that: the bound grows with its root.
_G_MAX_S = 1e4
# Time constants of smaller conductances exceed any simulated time.
_G_MIN_S = 1e-60
# Time constant in clocks up to which settling before the gate is negligible: the charge that lines hold back is less
# than this part of the charge of a clock.
FAST_CLOCKS = 0.05


def _frames(network: Network, g_frames_s: ArrayLike | None) -> Floats:
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    return np.minimum(g, _G_MAX_S)


def _paths(network: Network, g: Floats, row_users: int, column_users: int) -> tuple[Floats, Floats]:
    """Resistance from the far end of every row and column line to a source, if as many share each
    line.
    """
    to_column = column_users * (network.r_column_ohm + network.rows * network.r_trace_column_ohm)
    to_row = np.full(network.rows, row_users * max(network.r_row_driven_ohm, network.r_row_grounded_ohm))
    if not np.isfinite(network.r_row_grounded_ohm):
        with np.errstate(divide="ignore"):
            path = np.where(g > 0, row_users / np.maximum(g, _G_MIN_S), np.inf)
        path = (path + to_column).min(axis=2)
        path = np.where(np.isfinite(path), path, to_column.max()).max(axis=0)
        to_row = np.maximum(row_users * network.r_row_driven_ohm, path)
    return to_row + row_users * network.cols * network.r_trace_row_ohm, to_column


def _tau_by_sum(network: Network, to_row: Floats, to_column: Floats) -> float:
    """Sum of all time constants, bounded: each capacitance with its own path to a source."""
    tau = network.c_row_f * to_row.sum() + network.c_column_f * network.r_column_ohm.sum()
    return float(tau + network.c_taxel_f * (to_row[:, np.newaxis] + to_column).sum())


def _tau_by_share(network: Network, g: Floats) -> float:
    """Bound the largest ratio of y C y to y G y: the paths of all nodes split the conductances they
    share.

    Across a taxel (u - v)^2 <= 2 u^2 + 2 v^2, so its capacitance counts twice at either end.
    """
    rows, cols = network.rows, network.cols
    row_line, column_line = network.r_trace_row_ohm > 0, network.r_trace_column_ohm > 0
    row_users = cols + 1 if row_line else 1
    column_users = rows + 1 if column_line else 1
    if not np.isfinite(network.r_row_grounded_ohm):
        column_users *= rows * row_users + 1
    to_row, to_column = _paths(network, g, row_users, column_users)
    at_row = network.c_row_f + 2 * network.c_taxel_f * (1 if row_line else cols)
    at_column = network.c_column_f + 2 * network.c_taxel_f * (1 if column_line else rows)
    return float(max(at_row * to_row.max(), at_column * to_column.max()))


def slowest_s(network: Network, g_frames_s: ArrayLike | None = None) -> float:
    """Bound the slowest time constant that settles a slot in seconds; see bound_c."""
    if not (network.c_row_f or network.c_column_f or network.c_taxel_f):
        return 0.0
    network = in_range(network)
    g = _frames(network, g_frames_s)
    return min(_tau_by_sum(network, *_paths(network, g, 1, 1)), _tau_by_share(network, g))


def bound_c(network: Network, g_frames_s: ArrayLike | None, timing: Timing) -> Floats:
    """Bound the magnitude of the extra charge of a whole gate, [cols], in coulomb; inf if there is
    no bound.

    Notes
    -----
    With y the distance of all node voltages from their settled values x, C y' = -G y. The eigenvalues tau of
    C phi = tau G phi are the time constants. None is above their sum, trace(G^-1 C), which is the sum over
    all capacitors of capacitance times the resistance seen there, and that is at most the one of any path to
    a source (Rayleigh); nor above the largest ratio of y C y to y G y. The norm |y|, |y|^2 = y C y, falls at
    least as exp(-t / tau). Where a slot begins, the charges of the nodes that hang on resistances stay, so
    |y| becomes at most |y_end + x_old - x_new|; all settled voltages lie within the sources, +-A, so
    |x_old - x_new| <= 2 A sqrt(sum C), with the difference, thus twice as much, across taxels. Over any
    number of slots of length T

        |y| <= 2 A sqrt(sum C) / (1 - exp(-T / tau)) = sqrt(E)   when a slot begins

    With a break of length B the state is moved twice a slot, where a row is let go and where the
    next is driven, and where that is driven |y| <= 2 A sqrt(sum C) (1 + exp(-B / tau)) / (1 -
    exp(-T / tau)). From there on t counts, and the power in all resistors, y G y, is at most E /
    tau exp(-2 t / tau) as long as tau <= 2 t. The current in a conductance g is at most sqrt(g
    power). Into a column that has no input resistance all its conductances bring current, and its
    taxel capacitances what their rows still move. A floating row without a taxel that conducts
    keeps its charge and follows the columns through capacitances: it lies within 3 A.
    """
    network = in_range(network)
    g = _frames(network, g_frames_s)
    rows, cols = network.rows, network.cols
    t_slot, t_break = (n / timing.f_clk_hz for n in (timing.slot_clocks, timing.break_clocks))
    t_start = (timing.settle_clocks - timing.break_clocks) / timing.f_clk_hz
    amplitude = abs(network.v_bias_v) + np.abs(network.v_column_offset_v).max()
    amplitude += (np.abs(network.i_leak_a) * network.r_column_ohm).sum()
    if not np.isfinite(network.r_row_grounded_ohm) and (g.sum(axis=2) == 0).any():
        amplitude *= 2
    to_row, _ = _paths(network, g, 1, 1)
    tau = slowest_s(network, g)
    if tau == 0.0:
        return np.zeros(cols)
    if tau > 2 * t_start:
        return np.full(cols, np.inf)
    capacitance = rows * network.c_row_f + cols * network.c_column_f + 4 * rows * cols * network.c_taxel_f
    norm = 2 * amplitude * np.sqrt(capacitance) / -np.expm1(-t_slot / tau)
    if t_break:
        norm *= 1 + np.exp(-t_break / tau)
    root_power = norm / np.sqrt(tau) * np.exp(-t_start / tau)  # when the gate opens
    through = np.where(network.r_column_ohm > 0, network.r_column_ohm, network.r_trace_column_ohm)
    around = g.sum(axis=1).max(axis=0) + 2 * rows * network.g_lateral_row_s
    with np.errstate(divide="ignore"):
        conductance = np.where(through > 0, 1.0 / through, around)
    moved = network.c_taxel_f * 2 * np.sqrt(to_row).sum()
    return root_power * (tau * np.sqrt(conductance) + np.where(through > 0, 0.0, moved))
