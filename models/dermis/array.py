# SPDX-License-Identifier: Apache-2.0
"""The resistor array between row drivers and column inputs: column currents for each driven row."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis import float_flags
from dermis.errors import SimulatorError

Floats = NDArray[np.float64]
Node = tuple[Any, ...]

# Conductances that stand for a short. A taxel of 0 ohm is the limit of small equal resistances, which decides
# how a current splits between two of them; a series resistance of 0 ohm is harder than any taxel. Both are
# far beyond what double precision can tell from a true short next to 1 microohm, and the eliminations below
# never subtract them.
_G_TAXEL_SHORT_S = 1e22
_G_SERIES_SHORT_S = 1e30
# And a resistance that lets nothing through, 1e-30 A a volt, and a capacitance that never charges.
_R_OPEN_OHM = 1e30
_C_MAX_F = 1e30

# Taxels solved at once: 128 frames of 16x16 keep the elimination inside a 1 MB cache.
_VALUES_AT_ONCE = 1 << 15

# Rounding of n elimination steps without a subtraction stays below about n^2 * 1e-16; a wrong term is of
# order 1.
_RESIDUAL_MAX = 1e-9
# Below any electron that ever flowed, above where products of doubles lose their digits to underflow.
_CURRENT_FLOOR_A = 1e-100


@dataclass(frozen=True, eq=False)
class Network:
    """The resistive network of one frame, everything in ohm, siemens and volt.

    Row r hangs on v_bias_v through r_row_driven_ohm while it is read and on ground through r_row_grounded_ohm
    otherwise (inf: floating); column c is held at v_column_offset_v[c] through r_column_ohm[c]. Lateral
    conductances lie between the inner electrodes of neighbouring taxels: `g_lateral_row_s` between columns c
    and c+1 in each row, `g_lateral_column_s` between rows r and r+1 in each column. Without trace resistance
    both ends of the latter are the same column line, so they carry no current and no solve here sees them; a
    deck still writes them.

    `i_leak_a[c]` flows into column c in front of r_column_ohm and adds to its current. Traces have a resistance
    per taxel pitch: a row line runs driver, segment, taxel 0, segment, taxel 1 ...; a column line taxel 0,
    segment, taxel 1 ... last taxel, segment, column node. Capacitances lie from every row line (behind its
    driver) and every column node to ground and across every taxel; they carry no direct current.
    """

    g_taxel_s: Floats
    v_bias_v: float
    r_row_driven_ohm: float = 0.0
    r_row_grounded_ohm: float = 0.0
    r_column_ohm: Floats = 0.0  # type: ignore[assignment]
    v_column_offset_v: Floats = 0.0  # type: ignore[assignment]
    g_lateral_row_s: float = 0.0
    g_lateral_column_s: float = 0.0
    r_trace_row_ohm: float = 0.0
    r_trace_column_ohm: float = 0.0
    i_leak_a: Floats = 0.0  # type: ignore[assignment]
    c_row_f: float = 0.0
    c_column_f: float = 0.0
    c_taxel_f: float = 0.0

    def __post_init__(self) -> None:
        g = np.asarray(self.g_taxel_s, dtype=float)
        if g.ndim != 2 or 0 in g.shape or not (g >= 0).all():
            raise ValueError("g_taxel_s must be [rows, cols], 0 or above")
        object.__setattr__(self, "g_taxel_s", g)
        for name in ("r_column_ohm", "v_column_offset_v", "i_leak_a"):
            array = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), (g.shape[1],)).copy()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not (np.isfinite(self.r_column_ohm).all() and (self.r_column_ohm >= 0).all()):
            raise ValueError("r_column_ohm must be finite and 0 or above")
        if not 0 <= self.r_row_driven_ohm < np.inf or not self.r_row_grounded_ohm >= 0:
            raise ValueError("row resistances must be 0 or above, the driven one finite")
        if not 0 <= self.g_lateral_row_s < np.inf or not 0 <= self.g_lateral_column_s < np.inf:
            raise ValueError("lateral conductances must be finite and 0 or above")
        if not 0 <= self.r_trace_row_ohm < np.inf or not 0 <= self.r_trace_column_ohm < np.inf:
            raise ValueError("trace resistances must be finite and 0 or above")
        if not (np.isfinite(self.v_column_offset_v).all() and np.isfinite(self.i_leak_a).all()):
            raise ValueError("v_column_offset_v and i_leak_a must be finite")
        if not all(0 <= c < np.inf for c in (self.c_row_f, self.c_column_f, self.c_taxel_f)):
            raise ValueError("capacitances must be finite and 0 or above")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.g_taxel_s.shape[0]

    @property
    def cols(self) -> int:
        """Number of columns."""
        return self.g_taxel_s.shape[1]

    def active_fields(self) -> frozenset[str]:
        """Names of the fields that are away from "not there"."""
        named = (f.name for f in dataclasses.fields(self) if f.name not in ("g_taxel_s", "v_bias_v"))
        return frozenset(n for n in named if bool(np.any(np.asarray(getattr(self, n)) != 0)))


def column_currents(network: Network, g_frames_s: ArrayLike | None = None) -> Floats:
    """Current out of each column into its virtual ground while each row is driven.

    Parameters
    ----------
    network : Network
        What surrounds the taxels.
    g_frames_s : array_like, optional
        Taxel conductances [frames, rows, cols] to be used in place of `network.g_taxel_s`, all at once.

    Returns
    -------
    ndarray
        Ampere, [rows, cols] (or [frames, rows, cols]); element [r, c] is read in the slot of row r.

    Notes
    -----
    Nothing on: i = V_b G, no solve. Otherwise row lines are eliminated on paper (they meet only through
    columns). What is left is one symmetric matrix of the columns, or with resistance along the columns a
    chain of such matrices from row to row, the same for all slots. That the driven row hangs on another
    voltage and perhaps another resistance enters afterwards at one node (a rank-1 change in closed form), so
    there is always one factorisation a frame. Every elimination is a star-mesh transformation
    (Grassmann-Taksar-Heyman): sums only, diagonals never formed by subtraction, hence shorts next to megaohms
    lose no digit. docs/array.md has the derivation, the accuracy and the speed.

    Raises
    ------
    SimulatorError
        The solution misses Kirchhoff's current law.
    """
    driven, rest = column_currents_by_source(network, g_frames_s)
    return driven if rest is None else driven + rest


def column_currents_by_source(
    network: Network, g_frames_s: ArrayLike | None = None
) -> tuple[Floats, Floats | None]:
    """Split the currents of `column_currents`: those that follow v_bias_v, and those of offsets and leaks.

    The second part is None where there are neither.
    """
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    if g.ndim != 3 or g.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"g_frames_s must be [frames, {network.rows}, {network.cols}]")
    if not network.active_fields() & _ACTS:
        with np.errstate(over="ignore"):
            driven, rest = network.v_bias_v * g, None
    else:
        network = in_range(network)
        driven, rest = np.empty_like(g), np.empty_like(g) if _held(network) else None
        step = max(1, _VALUES_AT_ONCE // network.g_taxel_s.size)
        for first in range(0, len(g), step):
            part = slice(first, first + step)
            driven[part], rest_part = _solve(network, np.minimum(g[part], _G_TAXEL_SHORT_S))
            if rest is not None:
                rest[part] = rest_part
    if g_frames_s is None:
        return driven[0], None if rest is None else rest[0]
    return driven, rest


# Capacitances carry no direct current; laterals between ideal columns none at all.
_ACTS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "v_column_offset_v",
        "i_leak_a",
        "r_trace_row_ohm",
        "r_trace_column_ohm",
    }
)


def in_range(network: Network) -> Network:
    """Limit absurd values to where products of them stay finite."""
    limited = {
        "r_row_driven_ohm": _R_OPEN_OHM,
        "r_column_ohm": _R_OPEN_OHM,
        "r_trace_row_ohm": _R_OPEN_OHM,
        "r_trace_column_ohm": _R_OPEN_OHM,
        "g_lateral_row_s": _G_SERIES_SHORT_S,
        "g_lateral_column_s": _G_SERIES_SHORT_S,
        "c_row_f": _C_MAX_F,
        "c_column_f": _C_MAX_F,
        "c_taxel_f": _C_MAX_F,
    }
    change = {
        n: np.minimum(getattr(network, n), most)
        for n, most in limited.items()
        if np.any(np.asarray(getattr(network, n)) > most)
    }
    if _R_OPEN_OHM < network.r_row_grounded_ohm < np.inf:
        change["r_row_grounded_ohm"] = _R_OPEN_OHM
    return dataclasses.replace(network, **change) if change else network


def _conductance(resistance_ohm: ArrayLike) -> Floats:
    with np.errstate(divide="ignore", over="ignore"):
        return np.minimum(np.divide(1.0, np.asarray(resistance_ohm, dtype=float)), _G_SERIES_SHORT_S)


def _ratio(above: Floats, below: Floats) -> Floats:
    """above / below, 0 where there is nothing below (a row line that hangs on nothing)."""
    return np.divide(
        above, below, out=np.zeros(np.broadcast_shapes(above.shape, below.shape)), where=below > 0
    )


# The products along a row line stay away from underflow by as much again.
_PRODUCT_MIN = 1e-150


class _RowLines:
    """Row lines without their drivers, seen from the column lines: [frames, rows, cols].

    Everything of row line r between its driver's node and the column lines is `to_driver[:, r, c]`, a
    conductance from the driver's node to column line c, and `between` gives those from column line to column
    line.
    """

    def __init__(self, network: Network, g: Floats) -> None:
        self.g = g
        self.to_driver = g
        self.bent = network.r_trace_row_ohm > 0
        if not self.bent:
            return
        # The line as a ladder, from its far end: `total` hangs on node c from there on, `pass_on` is the part
        # of a current into node c (nothing but what lies before it connected) that goes towards the driver.
        segment = float(_conductance(network.r_trace_row_ohm))
        total = np.zeros_like(g[:, :, 0])
        pivot = np.empty_like(g)
        for c in reversed(range(network.cols)):
            total = g[:, :, c] + segment * (total / (segment + total))
            pivot[:, :, c] = segment + total
        self.pass_on = segment / pivot
        # `seen` is the resistance at node c with the driver's node and all column lines grounded.
        self.seen = 1.0 / pivot
        for c in range(1, network.cols):
            self.seen[:, :, c] += self.pass_on[:, :, c] ** 2 * self.seen[:, :, c - 1]
        self.through = np.cumprod(self.pass_on, axis=2)
        self.to_driver = g * self.through

    def between(self) -> Floats:
        """Conductances between column lines through all row lines, [frames, cols, cols]; diagonal 0.

        From node i to node j > i it is g_i seen_i times all pass_on between them times g_j. As a product of
        one factor of i and one of j it is fast, as long as the products from the driver on stay in range.
        """
        if (self.through > _PRODUCT_MIN).all():
            left = self.g * self.seen / self.through
            upper = np.matmul(left.transpose(0, 2, 1), self.to_driver)
        else:
            upper = self._between_steep()
        upper = np.triu(upper, 1)
        return upper + upper.transpose(0, 2, 1)

    def _between_steep(self) -> Floats:
        frames, rows, cols = self.g.shape
        after = np.arange(cols)[np.newaxis, :] > np.arange(cols)[:, np.newaxis]
        upper = np.zeros((frames, cols, cols))
        for row in range(rows):
            steps = np.where(after, self.pass_on[:, row, np.newaxis, :], 1.0)
            left, right = self.g[:, row] * self.seen[:, row], self.g[:, row]
            upper += left[:, :, np.newaxis] * np.cumprod(steps, axis=2) * right[:, np.newaxis, :]
        return upper


@dataclass
class _Response:
    """What the array does while all rows are grounded, and row r has the current that `drive` describes.

    The current into the driver's node of row r is the one that would hold it at 1 V were all column lines
    grounded. `delivered` [frames, rows, cols] then leaves through the columns, the node is at 1 + `lift`
    [frames, rows], and `away` [frames, rows] goes to any ground but its own row's. What offsets and leaks do
    by themselves is `held` [frames, cols] at the columns and `lifted` [frames, rows] at the drivers' nodes.
    """

    delivered: Floats
    lift: Floats
    away: Floats
    held: Floats | None = None
    lifted: Floats | None = None


def _solve(network: Network, g: Floats) -> tuple[Floats, Floats | None]:
    lines = _RowLines(network, g)
    respond = _respond_chain if network.r_trace_column_ohm > 0 else _respond_columns
    response = respond(network, lines)
    g_ground = float(_conductance(network.r_row_grounded_ohm))
    _check_balance(
        lines.to_driver.sum(axis=2), response.away + g_ground * response.lift, "in the slot of a row"
    )
    # All rows grounded becomes row r driven: another voltage behind another resistance at one node.
    scale = network.r_row_driven_ohm * response.away + (1.0 + response.lift)
    driven = (network.v_bias_v / scale)[:, :, np.newaxis] * response.delivered
    if response.held is None or response.lifted is None:
        return driven, None
    lift = (1.0 - g_ground * network.r_row_driven_ohm) * response.lifted / scale
    return driven, response.held[:, np.newaxis, :] - lift[:, :, np.newaxis] * response.delivered


def _held(network: Network) -> bool:
    return bool(network.v_column_offset_v.any() or network.i_leak_a.any())


def _add_neighbours(link: Floats, g: float) -> None:
    at = np.arange(link.shape[1] - 1)
    link[:, at, at + 1] += g
    link[:, at + 1, at] += g


def _respond_columns(network: Network, lines: _RowLines) -> _Response:
    """Every column line is one node."""
    rows, cols = network.rows, network.cols
    g_ground = float(_conductance(network.r_row_grounded_ohm))
    g_column = _conductance(network.r_column_ohm)
    g = lines.to_driver

    # Star-mesh of every driver's node. link[c, d] joins two columns, leak[c] goes to ground.
    node = g.sum(axis=2) + g_ground
    share = _ratio(g, node[:, :, np.newaxis])
    link = np.matmul(share.transpose(0, 2, 1), g)
    if lines.bent:
        link += lines.between()
    if network.g_lateral_row_s:
        _add_neighbours(link, rows * network.g_lateral_row_s)
    link[:, np.arange(cols), np.arange(cols)] = 0.0
    leaks = g_ground * share
    leak = leaks.sum(axis=1)

    # One right-hand side a row, and one for offsets and leaks. Columns that are held hard count their voltage
    # from there, or the little they move would drown in it; the others count from ground, or what two of them
    # share through shorts would.
    drive = g.transpose(0, 2, 1)
    offset, held = network.v_column_offset_v, _held(network)
    if held:
        origin = np.where(network.r_column_ohm == 0, offset, 0.0)
        pull = g_column * (offset - origin) - leak * origin + network.i_leak_a
        pull -= (link * (origin[:, np.newaxis] - origin[np.newaxis, :])).sum(axis=2)
        drive = np.concatenate([drive, pull[:, :, np.newaxis]], axis=2)
    if network.r_column_ohm.any():
        u = _eliminate(link, leak + g_column, drive)
        delivered = g_column[:, np.newaxis] * u
    else:
        u = np.zeros_like(drive)
        delivered = drive
    u, delivered = u.transpose(0, 2, 1), delivered.transpose(0, 2, 1)

    moved = u[:, :rows]
    away = delivered[:, :rows].sum(axis=2)
    away += (_sum_of_others(leaks) * moved).sum(axis=2)
    response = _Response(delivered[:, :rows], _ratio((g * moved).sum(axis=2), node), away)
    if held:
        response.held = delivered[:, rows] - g_column * (offset - origin)
        response.lifted = (share * (u[:, rows:] + origin)).sum(axis=2)
    return response


def _sum_of_others(values: Floats) -> Floats:
    """Sum along axis 1 of all elements but the one at each place, without a subtraction."""
    others = np.zeros_like(values)
    np.cumsum(values[:, :-1], axis=1, out=others[:, 1:])
    others[:, :-1] += np.cumsum(values[:, :0:-1], axis=1)[:, ::-1]
    return others


def _respond_chain(network: Network, lines: _RowLines) -> _Response:
    """Every column line is a chain of one node a row: all drives walk up and down through the inverses of blocks
    of one row, which are eliminated from the inputs up.
    """
    from dermis import star_mesh

    g_ground = float(_conductance(network.r_row_grounded_ohm))
    g_end = _conductance(network.r_trace_column_ohm + network.r_column_ohm)
    step = float(_conductance(network.r_trace_column_ohm)) + network.g_lateral_column_s
    g = lines.to_driver
    node = g.sum(axis=2) + g_ground
    share = _ratio(g, node[:, :, np.newaxis])
    leak = g_ground * share
    held = _held(network)
    behind = network.v_column_offset_v + network.i_leak_a * network.r_column_ohm
    pull = g_end * behind
    frames, rows, cols = g.shape
    moved, away, last = np.empty(g.shape), np.empty((frames, rows)), np.empty((frames, cols, rows))
    other = np.empty(g.shape if held else (0, 0, 0))
    pass_on, seen = (lines.pass_on, lines.seen) if lines.bent else (g, g)
    with float_flags.watch("star_mesh.chain"):
        miss = star_mesh.chain(
            lines.g, pass_on, seen, lines.bent, g, share, leak, float(network.g_lateral_row_s), step, g_end,
            pull, moved, away, last, other,
        )  # fmt: skip
    if not miss <= _RESIDUAL_MAX:
        raise SimulatorError(_missed(miss, "at a node"))
    delivered = (g_end[:, np.newaxis] * last).transpose(0, 2, 1)
    response = _Response(delivered, _ratio((g * moved).sum(axis=2), node), away)
    if held:
        end = other[:, -1]
        response.held = g_end * (end - behind) + network.i_leak_a
        response.lifted = (share * other).sum(axis=2)
        lost = (leak * other).sum(axis=(1, 2))
        size = (leak * np.abs(other)).sum(axis=(1, 2)) + np.abs(pull).sum()
        _check_balance((g_end * (behind - end)).sum(axis=1), lost, "between offsets and grounds", size)
    return response


# Columns eliminated one by one before a product of matrices takes their effect to the rest. Up to 64 the steps
# alone are faster.
_PANEL = 64


def _eliminate(link: Floats, leak: Floats, drive: Floats) -> Floats:
    """Solve (leak + sum of links) v - link v = drive for v, [frames, n, m], by star-mesh steps.

    Steps go in panels, so that the bulk is a product of matrices, still of sums only.
    """
    # Loading the compiled steps takes a moment that a scene without a solve does not need to wait.
    from dermis import star_mesh

    n = leak.shape[1]
    # Links, ground and drives side by side: an elimination does the same to all of them.
    work = np.concatenate([link, leak[:, :, np.newaxis], drive], axis=2)
    v = work[:, :, n + 1 :]
    pivot = np.empty_like(leak)
    panels = [(first, min(first + _PANEL, n)) for first in range(0, n, _PANEL)]
    for first, last in panels:
        with float_flags.watch("star_mesh.down"):
            star_mesh.down(work, pivot, first, last)
        if last < n:
            weight = work[:, first:last, last:n] / pivot[:, first:last, np.newaxis]
            work[:, last:, last:] += np.matmul(weight.transpose(0, 2, 1), work[:, first:last, last:])
    for first, last in reversed(panels):
        if last < n:
            v[:, first:last] += np.matmul(work[:, first:last, last:n], v[:, last:])
        with float_flags.watch("star_mesh.up"):
            star_mesh.up(work, pivot, first, last)
    _check_kirchhoff(link, leak, drive, v)
    return v


def _check_kirchhoff(link: Floats, leak: Floats, drive: Floats, v: Floats) -> None:
    """Check every node for all drives together, each at unit strength, and every drive for all nodes together."""
    magnitude = np.abs(drive).sum(axis=1)
    weight = (1.0 / np.maximum(magnitude, _CURRENT_FLOOR_A))[:, :, np.newaxis]
    size_v = np.abs(v) if (v < 0).any() else v
    size_drive = np.abs(drive) if (drive < 0).any() else drive
    node_v, size = np.matmul(v, weight), np.matmul(size_v, weight)
    out = (leak + link.sum(axis=2))[:, :, np.newaxis]
    came = np.matmul(drive, weight) + np.matmul(link, node_v)
    _check_balance(out * node_v, came, "at a node", out * size + np.matmul(size_drive, weight))
    across = np.matmul(leak[:, np.newaxis, :], v)[:, 0]
    size = np.matmul(leak[:, np.newaxis, :], size_v)[:, 0] + magnitude
    _check_balance(across, drive.sum(axis=1), "from one source", size)


def _check_balance(left: Floats, right: Floats, where: str, size: Floats | None = None) -> None:
    size = np.abs(left) + np.abs(right) if size is None else size
    miss = np.abs(left - right)
    if not (miss <= _RESIDUAL_MAX * size + _CURRENT_FLOOR_A).all():
        worst = np.nanmax(np.divide(miss, size, out=np.full_like(miss, np.nan), where=size > 0))
        raise SimulatorError(_missed(float(worst), where))


def _missed(worst: float, where: str) -> str:
    return f"array solve: Kirchhoff's current law is missed by {worst:.1e} of the current {where}"


def column_currents_reference(network: Network, digits: int = 60) -> Floats:
    """The same currents from the full nodal matrix, row after row, in `digits` decimal digits.

    Slow and obvious: series resistances of 0 fix or join their nodes, the driven row is stamped as it is,
    nothing is reused. Only a taxel of 0 ohm between two free nodes is taken as 1e-30 ohm.
    """
    with mpmath.workdps(digits):
        out = np.empty((network.rows, network.cols))
        for row in range(network.rows):
            out[row] = [float(i) for i in _reference_row(network, row)]
        return out


def _reference_elements(
    network: Network, driven: int
) -> tuple[list[tuple[Node, Node, mpmath.mpf]], dict[Node, mpmath.mpf], dict[Node, mpmath.mpf]]:
    """Every element as (node, node, conductance), the nodes whose voltage is known, the injected currents."""
    rows, cols = network.rows, network.cols
    exact = mpmath.mpf
    zero = exact(0)

    # Nodes by name. Behind its driver a row line is ("row", r), in front of its input a column ("column", c).
    def on_row(r: int, c: int) -> Node:
        return ("on_row", r, c) if network.r_trace_row_ohm else ("row", r)

    def on_column(r: int, c: int) -> Node:
        return ("on_column", r, c) if network.r_trace_column_ohm else ("column", c)

    elements: list[tuple[Node, Node, mpmath.mpf]] = []
    known: dict[Node, mpmath.mpf] = {}
    injected = {("column", c): exact(float(network.i_leak_a[c])) for c in range(cols)}

    def feed(node: Node, resistance_ohm: float, voltage: mpmath.mpf) -> None:
        if resistance_ohm == 0:
            known[node] = voltage
        elif resistance_ohm != np.inf:
            known["source", node] = voltage
            elements.append((node, ("source", node), 1 / exact(float(resistance_ohm))))

    for r in range(rows):
        if r == driven:
            feed(("row", r), network.r_row_driven_ohm, exact(network.v_bias_v))
        else:
            feed(("row", r), network.r_row_grounded_ohm, zero)
        if network.r_trace_row_ohm:
            line = [("row", r), *(on_row(r, c) for c in range(cols))]
            segment = 1 / exact(network.r_trace_row_ohm)
            elements += [(line[c], line[c + 1], segment) for c in range(cols)]
    for c in range(cols):
        feed(("column", c), network.r_column_ohm[c], exact(float(network.v_column_offset_v[c])))
        if network.r_trace_column_ohm:
            line = [*(on_column(r, c) for r in range(rows)), ("column", c)]
            segment = 1 / exact(network.r_trace_column_ohm)
            elements += [(line[r], line[r + 1], segment) for r in range(rows)]
    for r in range(rows):
        for c in range(cols):
            g = float(network.g_taxel_s[r, c])
            if g > 0:
                elements.append((on_row(r, c), on_column(r, c), exact("1e30") if g == np.inf else exact(g)))
            if c + 1 < cols and network.g_lateral_row_s:
                elements.append((on_column(r, c), on_column(r, c + 1), exact(network.g_lateral_row_s)))
            if r + 1 < rows and network.g_lateral_column_s and network.r_trace_column_ohm:
                elements.append((on_column(r, c), on_column(r + 1, c), exact(network.g_lateral_column_s)))
    return elements, known, injected


def _reference_row(network: Network, driven: int) -> list[mpmath.mpf]:
    exact = mpmath.mpf
    elements, known, injected = _reference_elements(network, driven)
    voltage = dict(known)
    # Nodes that hang on nothing are at no voltage and carry nothing: only what is tied to a source counts.
    near: dict[Node, list[Node]] = {}
    for a, b, _ in elements:
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    tied, rim = set(known), list(known)
    while rim:
        for other in near.get(rim.pop(), []):
            if other not in tied:
                tied.add(other)
                rim.append(other)
    free = [n for n in near if n in tied and n not in known]
    place = {n: i for i, n in enumerate(free)}
    if free:
        matrix, right = mpmath.zeros(len(free)), mpmath.zeros(len(free), 1)
        for node, current in injected.items():
            if node in place:
                right[place[node]] += current
        for a, b, g in elements:
            for here, there in ((a, b), (b, a)):
                if here in place:
                    matrix[place[here], place[here]] += g
                    if there in place:
                        matrix[place[here], place[there]] -= g
                    else:
                        right[place[here]] += g * known[there]
        solution = mpmath.lu_solve(matrix, right)
        voltage |= {n: solution[place[n]] for n in free}

    currents = []
    for c in range(network.cols):
        node: Node = ("column", c)
        if network.r_column_ohm[c] == 0:  # all that flows in from the array
            total = injected[node]
            for a, b, g in elements:
                if node in (a, b):
                    other = b if a == node else a
                    total += g * (voltage[other] - voltage[node])
        else:
            held = exact(float(network.v_column_offset_v[c]))
            total = (voltage[node] - held) / exact(float(network.r_column_ohm[c]))
        currents.append(total)
    return currents
