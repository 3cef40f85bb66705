# SPDX-License-Identifier: Apache-2.0
"""Creep of a sheet from frame to frame, compiled."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def advance_creep(creep, loaded, rate, weight, dt_s):
    """Move the creep states [taxels, rates] on by a time in which `loaded` [taxels] taxels carried load."""
    for m in range(rate.size):
        kept = np.exp(-rate[m] * dt_s)
        gained = (1.0 - kept) * weight[m]
        for t in range(loaded.size):
            creep[t, m] = kept * creep[t, m] + (gained if loaded[t] else 0.0)
