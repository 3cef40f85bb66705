# SPDX-License-Identifier: Apache-2.0
"""Hysteresis and creep of many sheets as streams: a few numbers a taxel instead of a state for every rate."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dermis.decode.memory import MemoryLaw

PULSES = 16
"""Loads that a taxel remembers one by one; of more, the two that are hardest to tell apart by now become one."""
LOG10_E = 0.4342944819032518


@njit(cache=True, nogil=True, error_model="numpy")
def _forget(ends, count, now, start):
    """Merge two loads of a full list `ends` [PULSES, 2] into one of the same length and middle; return their number.

    They are those for which that changes the creep least.
    """
    best, least = 0, np.inf
    for k in range(count - 1):
        length = min(ends[k, 1] - ends[k, 0], ends[k + 1, 1] - ends[k + 1, 0])
        age = start + now - ends[k + 1, 1]
        part = length * ((ends[k + 1, 1] - ends[k, 0]) / age) ** 2 / age
        if part < least:
            best, least = k, part
    first, second = ends[best, 1] - ends[best, 0], ends[best + 1, 1] - ends[best + 1, 0]
    both = max(first + second, 1e-300)
    moment = first * (ends[best, 0] + ends[best, 1]) + second * (ends[best + 1, 0] + ends[best + 1, 1])
    middle = moment / (2.0 * both)
    ends[best, 0], ends[best, 1] = middle - both / 2.0, middle + both / 2.0
    for k in range(best + 1, count - 1):
        ends[k, 0], ends[k, 1] = ends[k + 1, 0], ends[k + 1, 1]
    return count - 1


@njit(cache=True, nogil=True, error_model="numpy")
def apply_sheet(g, state, law, e, dt_s):
    """Turn conductances by the law `g` [taxels] of sheet `e` into those of the sheet, in place.

    `state` is that of `Sheets.arrays`. Creep is the sum of log10(1 + t / start) since each load began, less that since
    it ended (`sensor.creep_decades`): one logarithm of a product.
    """
    play, ends, count, loaded, fresh, clock = state
    ratio, per_decade, start, g_open = law
    if not fresh[e]:
        clock[e] += dt_s
    now = clock[e]
    for t in range(g.size):
        by_law = value = g[t]
        if ratio < 1.0:
            # The play operator of `MemoryLaw` with one radius: a fall keeps the conductance up to 1 / ratio times.
            if fresh[e]:
                play[e, t] = value
            play[e, t] = value = min(max(play[e, t], value), value / ratio)
        if per_decade != 0.0:
            n = count[e, t]
            if n > 0 or loaded[e, t]:
                above, below = 1.0, 1.0
                for k in range(n):
                    above *= start + now - ends[e, t, k, 0]
                    below *= start + now - ends[e, t, k, 1]
                if loaded[e, t]:
                    above *= start + now - ends[e, t, n, 0]
                    below *= start
                value *= 1.0 + per_decade * LOG10_E * np.log(above / below)
            if (by_law > g_open) != loaded[e, t]:
                if loaded[e, t]:
                    ends[e, t, n, 1] = now
                    count[e, t] = n + 1
                    if n + 1 == PULSES:
                        count[e, t] = _forget(ends[e, t], n + 1, now, start)
                else:
                    ends[e, t, n, 0] = now
                loaded[e, t] = not loaded[e, t]
        g[t] = value
    fresh[e] = False


class Sheets:
    """Hysteresis and creep of every taxel of many sheets, frame by frame.

    The law has one play operator at most, as that of a scene. A taxel at or below the conductance `g_open_s` by the law
    carries no load.
    """

    def __init__(self, law: MemoryLaw, sheets: int, taxels: int, g_open_s: float = 0.0) -> None:
        if law.radius.size > 1:
            raise ValueError("a sheet has one play operator")
        ratio = float(np.exp(-2.0 * law.radius.sum()))
        self.law = ratio, float(law.creep_per_decade), float(law.creep_start_s), float(g_open_s)
        pulses = PULSES if law.creep_per_decade else 0
        self._play = np.zeros((sheets, taxels if law.radius.size else 0))
        self._ends = np.zeros((sheets, taxels, pulses, 2))
        self._count = np.zeros((sheets, taxels), dtype=np.uint8)
        self._loaded = np.zeros((sheets, taxels), dtype=np.bool_)
        self._fresh = np.ones(sheets, dtype=np.bool_)
        self._clock = np.zeros(sheets)

    def reset(self, which: NDArray) -> None:
        """Make the sheets of an index new."""
        self._fresh[which], self._loaded[which], self._count[which], self._clock[which] = True, False, 0, 0.0

    def arrays(self) -> tuple:
        """Return the state for a compiled loop over sheets."""
        return self._play, self._ends, self._count, self._loaded, self._fresh, self._clock
