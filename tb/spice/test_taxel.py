# SPDX-License-Identifier: Apache-2.0
"""The taxel cell against a nodal solve written out by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dermis.scene.design import Design


def nodal(design: Design, lateral_ohm: float) -> dict[str, float]:
    """Solve the circuit of taxel__dc: nodes are the inner electrodes 00, 01, 10, 11."""
    matrix, right = np.zeros((4, 4)), np.zeros(4)

    def join(a: int, b: int | None, ohm: float, volt: float = 0.0) -> None:
        g = 1 / ohm
        matrix[a, a] += g
        if b is None:
            right[a] += g * volt
        else:
            matrix[b, b] += g
            matrix[a, b] -= g
            matrix[b, a] -= g

    for node, ohm, volt in (
        (0, 500, 0.5),
        (1, 2000, 0.5),
        (2, 1000, 0.0),
        (3, design.array.r_floor_ohm, 0.0),
    ):
        join(node, None, ohm, volt)
    for a, b in ((0, 2), (1, 3)):
        join(a, b, 10.0)
    for a, b in ((0, 1), (2, 3), (0, 2), (1, 3)):
        join(a, b, lateral_ohm)
    for node in (2, 3):
        join(node, None, 5.0)
    v = np.linalg.solve(matrix, right)
    return {
        "i_col_0": v[2] / 5,
        "i_col_1": v[3] / 5,
        "v_inner_00": v[0],
        "v_inner_01": v[1],
        "v_inner_10": v[2],
    }


@pytest.mark.parametrize("lateral_ohm", [None, 100.0, 1e18])
def test_four_cells_make_the_array_of_a_nodal_solve(
    measure: Callable[..., dict[str, float]], design: Design, lateral_ohm: float | None
) -> None:
    got = measure("taxel__dc", dut={} if lateral_ohm is None else {"r_lateral_ohm": lateral_ohm})
    want = nodal(design, design.array.r_lateral_ohm if lateral_ohm is None else lateral_ohm)
    for name, value in want.items():
        # A linear deck with reltol 1e-9; 1e18 ohm of lateral beside gmin costs two digits more.
        assert got[name] == pytest.approx(value, rel=1e-7, abs=0), name
