# SPDX-License-Identifier: Apache-2.0
"""The reference of the array solve: the full nodal matrix, slot by slot, in many digits.

Nothing is reduced, reused or shared with dermis.array.array but the meaning of Network's fields
(`bounded` runs it): every element is stamped between two named nodes, and Gauss's elimination runs
over mpmath's numbers.
"""

from collections.abc import Sequence
from typing import Any

import mpmath
import numpy as np

from dermis.array import array as forward
from dermis.array import solve_error
from dermis.array.array import Network
from dermis.ndarrays import Floats

Node = tuple[Any, ...]
Element = tuple[Node, Node, Any]

# A taxel of 0 ohm is the limit of small equal resistances. Compared with anything above 1e-23 ohm,
# 1e-80 ohm differs from it by 1e-57, less than a double resolves; that takes _SHORT_DIGITS more digits.
SHORT_S = 10**80
_SHORT_DIGITS = 200


def bounded(network: Network) -> list[tuple[Any, Any]]:
    """Return the solved currents of the bias, and of offsets and leaks (None without either), with bounds.

    All are [rows, cols] in ampere, from `dermis.array.array`.
    """
    bounds: list[tuple[Any, Any]] = []

    class Recording(solve_error.ErrorRecord):
        def check(self, driven: Any, rest: Any, part: Any, rest_error: Any) -> None:
            rest_bound = np.broadcast_to(0.0 if rest is None else rest_error, driven.shape)
            bounds.append((solve_error.of(part, np.abs(driven)), rest_bound))

    token = solve_error._record.set(Recording())
    try:
        parts = forward.column_currents_by_source(network)
    finally:
        solve_error._record.reset(token)
    return [(part, bound[0]) for part, bound in zip(parts, bounds[0], strict=True)]


def column_currents(network: Network, digits: int = 60, slots: Sequence[int] | None = None) -> Floats:
    """Return column currents of some slots (driven rows), by default all, [slots, cols] in ampere."""
    more = _SHORT_DIGITS if np.isinf(network.g_taxel_s).any() or network.r_return_ohm else 0
    with mpmath.workdps(digits + more):
        rows = [slot_currents(network, row) for row in (range(network.rows) if slots is None else slots)]
    return np.array(rows, dtype=float)


def elements(network: Network, driven: int | None) -> tuple[list[Element], dict[Node, Any], dict[Node, Any]]:
    """Return elements (node, node, conductance), voltages of nodes that are held, injected currents."""
    rows, cols, exact = network.rows, network.cols, mpmath.mpf

    # After its driver a row line is ("row", r), before its input a column ("column", c).
    def on_row(r: int, c: int) -> Node:
        return ("on_row", r, c) if network.r_trace_row_ohm else ("row", r)

    def on_column(r: int, c: int) -> Node:
        return ("on_column", r, c) if network.r_trace_column_ohm else ("column", c)

    found: list[Element] = []
    known: dict[Node, Any] = {}
    injected = {("column", c): exact(float(network.i_leak_a[c])) for c in range(cols)}

    def feed(node: Node, resistance_ohm: float, voltage: Any) -> None:
        if resistance_ohm == 0:
            known[node] = voltage
        elif resistance_ohm != np.inf:
            known["source", node] = voltage
            found.append((node, ("source", node), 1 / exact(float(resistance_ohm))))

    def ground(node: Node, resistance_ohm: float) -> None:
        """Connect a grounded row to the return that these rows share."""
        if not network.r_return_ohm:
            feed(node, resistance_ohm, exact(0))
        elif resistance_ohm != np.inf:
            g = 1 / exact(float(resistance_ohm)) if resistance_ohm else exact(SHORT_S)
            found.append((node, ("return",), g))

    if network.r_return_ohm:
        feed(("return",), network.r_return_ohm, exact(0))
    for r in range(rows):
        if r == driven:
            feed(("row", r), network.r_row_driven_ohm, exact(float(network.v_bias_v)))
        else:
            ground(("row", r), network.r_row_grounded_ohm)
        if network.r_trace_row_ohm:
            line = [("row", r), *(on_row(r, c) for c in range(cols))]
            segment = 1 / exact(float(network.r_trace_row_ohm))
            found += [(line[c], line[c + 1], segment) for c in range(cols)]
    for c in range(cols):
        feed(("column", c), network.r_column_ohm[c], exact(float(network.v_column_offset_v[c])))
        if network.r_trace_column_ohm:
            line = [*(on_column(r, c) for r in range(rows)), ("column", c)]
            segment = 1 / exact(float(network.r_trace_column_ohm))
            found += [(line[r], line[r + 1], segment) for r in range(rows)]
    beside, along = exact(float(network.g_lateral_row_s)), exact(float(network.g_lateral_column_s))
    for r in range(rows):
        for c in range(cols):
            g = float(network.g_taxel_s[r, c])
            if g > 0:
                found.append((on_row(r, c), on_column(r, c), exact(SHORT_S if g == np.inf else g)))
            if c + 1 < cols and beside:
                found.append((on_column(r, c), on_column(r, c + 1), beside))
            if r + 1 < rows and along and network.r_trace_column_ohm:
                found.append((on_column(r, c), on_column(r + 1, c), along))
    return found, known, injected


def kirchhoff(
    found: Sequence[tuple[Any, Any, Any]],
    known: dict[Any, Any],
    injected: dict[Any, Any],
    free: Sequence[Any],
) -> tuple[list[list[Any]], list[Any]]:
    """Return the matrix and the right side of the current laws of free nodes; arguments as `elements` returns them."""
    place = {n: i for i, n in enumerate(free)}
    matrix = [[0] * len(free) for _ in free]
    right = [injected.get(node, 0) for node in free]
    for a, b, g in found:
        for here, there in ((a, b), (b, a)):
            if here in place:
                matrix[place[here]][place[here]] += g
                if there in place:
                    matrix[place[here]][place[there]] -= g
                else:
                    right[place[here]] += g * known[there]
    return matrix, right


def gauss(matrix: list[list[Any]], right: list[Any]) -> list[Any]:
    """Solve matrix x = right, positive definite, by elimination without pivoting."""
    n = len(right)
    for k in range(n):
        for i in range(k + 1, n):
            if matrix[i][k]:
                factor = matrix[i][k] / matrix[k][k]
                for j in range(k, n):
                    if matrix[k][j]:
                        matrix[i][j] -= factor * matrix[k][j]
                right[i] -= factor * right[k]
    x = [right[0]] * n if n else []
    for k in reversed(range(n)):
        total = right[k]
        for j in range(k + 1, n):
            if matrix[k][j]:
                total -= matrix[k][j] * x[j]
        x[k] = total / matrix[k][k]
    return x


def slot_currents(network: Network, driven: int) -> list[Any]:
    """Return column currents while one row is driven."""
    found, known, injected = elements(network, driven)
    voltage = dict(known)
    # Unconnected nodes carry no current: only nodes tied to a source count.
    tied = set(known)
    while more := {n for a, b, _ in found if a in tied or b in tied for n in (a, b)} - tied:
        tied |= more
    free = list(dict.fromkeys(n for a, b, _ in found for n in (a, b) if n in tied and n not in known))
    voltage |= dict(zip(free, gauss(*kirchhoff(found, known, injected, free)), strict=True))

    currents = []
    for c in range(network.cols):
        node: Node = ("column", c)
        if network.r_column_ohm[c] == 0:  # all that flows in from the array
            ends = ((b if a == node else a, g) for a, b, g in found if node in (a, b))
            total = injected[node] + sum(g * (voltage[other] - voltage[node]) for other, g in ends)
        else:
            held = mpmath.mpf(float(network.v_column_offset_v[c]))
            total = (voltage[node] - held) / mpmath.mpf(float(network.r_column_ohm[c]))
        currents.append(total)
    return currents
