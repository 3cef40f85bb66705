# SPDX-License-Identifier: Apache-2.0
"""The output of slow mirrors at the beginning and at the end of every gate, in closed form.

The output y follows its settled value x by y' = y (x - y) / kappa. Its inverse u = 1 / y is linear in time,
kappa u' = 1 - x u, so a constant x takes no steps; and the charge over a time is that of x less kappa ln(y at its end /
y at its beginning).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from dermis.converter.vfc import Y_MIN

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outputs:
    """Outputs of slow mirrors, [3, frames, rows, cols] each: as solved, the lowest and the highest possible.

    `begin` and `end` of the gate; `keeps` and `keeps_begin` [frames, rows, cols] are the parts of a relative error at
    the end of the row before that are left at the end of this one and where its gate begins.
    """

    begin: Floats
    end: Floats
    keeps: Floats
    keeps_begin: Floats


# Time constants from which 1 - exp(-t) loses no digit that counts.
_FAR = 0.01


@numba.njit(cache=True, error_model="numpy", inline="always")
def _after(u, x, clocks, kappa):  # type: ignore
    """1 / y after some clocks at a constant x."""
    t = x * clocks / kappa
    left = math.exp(-t) if t > _FAR else 0.0
    lost = 1.0 - left if t > _FAR else -math.expm1(-t)
    return u * (left if t > _FAR else 1.0 - lost) + lost / x


@numba.njit(cache=True, error_model="numpy")
def _walk(x, apart, dark, kappa, pause, settle, gate, floor, begin, end, keeps, keeps_begin):  # type: ignore
    frames, rows, cols = x.shape
    for f in range(frames):
        for c in range(cols):
            k = max(kappa[c], 1e-15)
            for way in range(3):
                side = (0.0, -1.0, 1.0)[way]
                u = 1.0
                for r in range(rows):
                    here = max(x[f, r, c] + side * apart[f, r, c], floor)
                    if r == 0:
                        u = 1.0 / here
                    before = u
                    if r > 0:
                        gloom = max(dark[f, 0, c] if way == 2 else 0.0, floor)
                        u = _after(u, gloom, pause, k)
                        lost = gloom * pause
                    else:
                        lost = 0.0
                    u = _after(u, here, settle - pause, k)
                    begin[way, f, r, c] = 1.0 / u
                    if way == 0:
                        lost += here * (settle - pause)
                        keeps_begin[f, r, c] = before / u * math.exp(-lost / k)
                    u = _after(u, here, gate, k)
                    end[way, f, r, c] = 1.0 / u
                    if way == 0:
                        lost += here * gate
                        keeps[f, r, c] = before / u * math.exp(-lost / k)


def outputs(
    x: Floats, apart: Floats, dark: Floats, kappa: Floats, pause: int, settle: int, gate: int
) -> Outputs:
    """Work out the outputs of slow mirrors.

    Parameters
    ----------
    x, apart : ndarray
        [frames, rows, cols] settled value in packets a clock, and how far it goes from there at most.
    dark : ndarray
        [frames, 1, cols] most that the settled value is while no row is driven; the least is nothing.
    kappa : ndarray
        [cols] time constant times output in packets.
    pause, settle, gate : int
        Clocks of a slot: without a driven row, up to the gate, and of the gate.
    """
    shape = (3, *x.shape)
    found = Outputs(np.empty(shape), np.empty(shape), np.empty(x.shape), np.empty(x.shape))
    kept = found.keeps, found.keeps_begin
    _walk(x, apart, dark, kappa, pause, settle, gate, Y_MIN, found.begin, found.end, *kept)
    return found
