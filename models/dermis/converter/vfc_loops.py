# SPDX-License-Identifier: Apache-2.0
"""The count of `vfc.count`, compiled."""

import numba
import numpy as np


@numba.njit(cache=True, error_model="numpy")
def count_one(x, clocks, start, packet):  # type: ignore
    """Count of `count` for one cell, compiled; `start` is the threshold less w0."""
    every_second = (clocks + 1) // 2
    if 2.0 * x > packet:
        first = min(max(np.ceil(start / x), 1.0), clocks + 1.0)
        if first * x < start and first <= clocks:
            first += 1.0
        elif first > 1.0 and (first - 1.0) * x >= start:
            first -= 1.0
        return 0 if first > clocks else (clocks - int(first)) // 2 + 1
    # Ones that are paid for: division and difference may round either way.
    if x < 0.0:
        if x < start:
            return 0
        last = min(max(np.floor((x - start) / (packet - 2.0 * x)), -1.0), 1.0 * every_second)
        if (2.0 * last + 3.0) * x >= start + (last + 1.0) * packet:
            last += 1.0
        elif (2.0 * last + 1.0) * x < start + last * packet:
            last -= 1.0
        return int(min(max(last + 1.0, 0.0), 1.0 * every_second))
    ones = min(max(np.floor((clocks * x - start) / packet), -1.0), 1.0 * clocks)
    if clocks * x >= start + (ones + 1.0) * packet:
        ones += 1.0
    elif clocks * x < start + ones * packet:
        ones -= 1.0
    return int(min(max(ones + 1.0, 0.0), 1.0 * every_second))


@numba.njit(cache=True, error_model="numpy")
def count_all(x, clocks, start, packet, found):  # type: ignore
    for i in range(x.size):
        found[i] = count_one(x[i], clocks, start[i], packet[i])
