# SPDX-License-Identifier: Apache-2.0
"""The array solve against a solver that others wrote: badcrossbar."""

import logging
import warnings

import numpy as np
import pytest
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents

with warnings.catch_warnings(record=True):
    # It complains, whatever the filters say, that it cannot draw.
    import badcrossbar

logging.getLogger("badcrossbar").setLevel(logging.WARNING)


def badcrossbar_currents(network: Network) -> NDArray[np.float64]:
    """All slots of a network that has nothing but traces, each with one word line at v_bias_v and 0 on the others."""
    with np.errstate(divide="ignore"):
        resistance = 1 / network.g_taxel_s
    solution = badcrossbar.compute(
        network.v_bias_v * np.eye(network.rows),
        resistance,
        r_i_word_line=network.r_trace_row_ohm,
        r_i_bit_line=network.r_trace_column_ohm,
        node_voltages=False,
        all_currents=False,
    )
    return np.asarray(solution.currents.output)


@pytest.mark.parametrize("ohm", [(0.1, 0.1), (2.0, 0.5), (0.0, 1.0), (1.0, 0.0), (50.0, 80.0)])
def test_distributed_lines_are_those_of_badcrossbar_to_1e_12(ohm: tuple[float, float]) -> None:
    rng = np.random.default_rng(11)
    for shape in ((16, 16), (16, 16), (5, 9), (12, 3), (2, 2)):
        g = 1 / np.exp(rng.uniform(np.log(500), np.log(64250), shape))
        g[rng.random(shape) < 0.1] = 0.0
        network = Network(g, 0.5, r_trace_row_ohm=ohm[0], r_trace_column_ohm=ohm[1])
        theirs = badcrossbar_currents(network)
        miss = np.abs(column_currents(network) - theirs)
        # What our solver promises; their LU leaves some 1e-16 of the largest current on the smallest.
        assert (miss <= 1e-12 * np.abs(theirs) + 1e-15 * theirs.max()).all()
