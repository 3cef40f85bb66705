# SPDX-License-Identifier: Apache-2.0
"""Columns of the direct interface by their common equation: the reference of event's mean charges."""

import dataclasses

import numpy as np
from scipy.linalg import expm

from dermis.array.array import Network, column_currents
from dermis.converter import walk
from dermis.converter.coupling import on_columns, seen_from_grounds
from dermis.records import Plan


def codes(plan: Plan, frame: int = 0) -> np.ndarray:
    """Return codes [rows, cols] of a frame without noise or saturation."""
    return np.array([_row(plan, frame, row) for row in range(plan.rows)])


def _row(plan: Plan, frame: int, row: int) -> np.ndarray:
    """Step by matrix exponentials, two a clock with a late comparator, at inputs constant in a clock."""
    converter, timing, drive, cols = plan.converter, plan.timing, plan.drive, plan.cols
    g = plan.conductance_s()
    behind = plan.next_conductance_s() if drive.motion else g
    of = walk.cells_of(plan, np.zeros((1, plan.rows, cols)), on_columns(g[frame : frame + 1]))
    cell = {f.name: np.array(getattr(of, f.name)[0, row], dtype=float) for f in dataclasses.fields(of)}
    slow = bool(cell["lag"].any())
    delay = float(cell["delay"][0])

    def steps(g_now: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        seen = seen_from_grounds(plan.network(0), g_now[np.newaxis])[0]
        own = seen[min(row, len(seen) - 1)] + np.diag(converter.g_in_s)
        pulls = own / (converter.c_int_f * converter.f_clk_hz)[:, np.newaxis]
        share = converter.inv_gain_dc / (1.0 + converter.inv_gain_dc)
        one, none = np.eye(cols), np.zeros((cols, cols))
        rate, drives = -pulls * share, one
        if slow:
            follows = one / cell["lag"]
            rate = np.block([[-pulls, pulls - pulls * share], [follows, -follows]])
            drives = np.vstack([one, none])
        size = len(rate)
        whole = np.zeros((size + cols, size + cols))
        whole[:size] = np.hstack([rate, drives])
        clock = expm(whole)
        made = clock, expm(whole * (1.0 - delay)) if delay else clock
        return [(e[:size, :size], e[:size, size:]) for e in made]

    moves = bool(drive.motion or drive.ripple)
    clocks = np.arange(timing.gate_clocks if moves else 1) + 0.5
    seconds = (row * timing.slot_clocks + timing.settle_clocks + clocks) / timing.f_clk_hz
    share = bool(drive.motion) * np.minimum(seconds / drive.t_frame_s, 1.0)
    taxels = (1.0 - share)[:, None, None] * g[frame] + share[:, None, None] * behind[frame]
    angle = 2.0 * np.pi * drive.f_ripple_hz * (frame * drive.t_frame_s + seconds) + drive.phase_ripple_rad
    # Currents are a straight line in the bias, whatever else drives them.
    once, twice = (
        column_currents(Network(g[frame], bias_v, **plan.surrounding), taxels)[:, row]
        for bias_v in (plan.v_bias_v, 2.0 * plan.v_bias_v)
    )
    duty = converter.duty(once + (drive.ripple * np.sin(angle))[:, None] * (twice - once))
    state = np.concatenate([cell["w0"]] * (2 if slow else 1))
    last, before, count = (np.zeros(cols) for _ in range(3))
    high = (cell["w0"] >= cell["rise"]).astype(float)
    for n in range(timing.gate_clocks):
        if n == 0 or (drive.motion and n % 10 == 0):
            (keep, gain), early = steps(taxels[n])
        x = duty[n if moves else 0]
        charge = x - cell["packet"] * before
        seen = (early[0] @ state + early[1] @ charge)[-cols:]
        state = keep @ state + gain @ charge
        high = np.where(seen >= cell["rise"], 1.0, np.where(seen < cell["fall"], 0.0, high))
        before, last = last, high * (last == 0)
        count += last
    return np.minimum(count, timing.code_max)
