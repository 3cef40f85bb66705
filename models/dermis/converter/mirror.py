# SPDX-License-Identifier: Apache-2.0
"""The output of a slow mirror in closed form.

The output y follows its settled value x by y' = y (x - y) / kappa. Its inverse u = 1 / y is linear in time,
kappa u' = 1 - x u, so a constant x takes no steps; and the charge over a time is that of x less kappa ln(y at its end /
y at its beginning).
"""

from __future__ import annotations

import math

import numba

# Time constants from which 1 - exp(-t) loses no digit that counts, after which nothing is left, and up to which the
# first two terms of the exponential are all of it.
_FAR, _GONE, _NEAR = 0.01, 50.0, 1e-5


@numba.njit(cache=True, error_model="numpy")
def after(u, x, clocks, kappa):  # type: ignore
    """1 / y after some clocks at a constant x, in packets a clock; kappa is its time constant times x."""
    t = x * clocks / kappa
    if t > _GONE:
        # From a current as small as the floor of the mirror 1e-16 is left.
        return 1.0 / x
    if t < _NEAR:
        lost = t - 0.5 * t * t
        return u * (1.0 - lost) + lost / x
    left = math.exp(-t)
    lost = 1.0 - left if t > _FAR else -math.expm1(-t)
    return u * left + lost / x
