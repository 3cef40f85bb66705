# SPDX-License-Identifier: Apache-2.0
"""Creep of a sheet from frame to frame, compiled."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def advance_creep(creep, loaded, rate, weight, dt_s):
    """Move the creep states [taxels, rates] on by a time in which `loaded` [taxels] taxels carried load.

    Returns what load adds to a state in that time, [rates].
    """
    kept, gained = np.empty(rate.size), np.empty(rate.size)
    for m in range(rate.size):
        kept[m] = np.exp(-rate[m] * dt_s)
        gained[m] = (1.0 - kept[m]) * weight[m]
    for t in range(loaded.size):
        on = 1.0 if loaded[t] else 0.0
        for m in range(rate.size):
            creep[t, m] = kept[m] * creep[t, m] + on * gained[m]
    return gained
