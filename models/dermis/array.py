# SPDX-License-Identifier: Apache-2.0
"""The resistor array between row drivers and column inputs: column currents for each driven row."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import mpmath
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.errors import SimulatorError

Floats = NDArray[np.float64]

# Conductances that stand for a short. A taxel of 0 ohm is the limit of small equal resistances, which decides
# how a current splits between two of them; a series resistance of 0 ohm is harder than any taxel. Both are
# far beyond what double precision can tell from a true short next to 1 microohm, and the elimination below
# never subtracts them.
_G_TAXEL_SHORT_S = 1e16
_G_SERIES_SHORT_S = 1e30

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
    Nothing on: i = V_b G, no solve. Otherwise the rows are eliminated on paper (they meet only through
    columns), which leaves one symmetric matrix of the columns for all rows. Whether the driven row hangs on
    the same resistance as the others enters afterwards as a change of one element (a rank-1 change in closed
    form), so there is always one factorisation a frame. Rows and columns are eliminated as star-mesh
    transformations (Grassmann-Taksar-Heyman): diagonals are never formed by subtraction, hence shorts next to
    megaohms lose no digit.

    Raises
    ------
    SimulatorError
        The solution misses Kirchhoff's current law.
    """
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    if g.ndim != 3 or g.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"g_frames_s must be [frames, {network.rows}, {network.cols}]")
    if not network.active_fields() & _ACTS:
        with np.errstate(over="ignore"):
            current = network.v_bias_v * g
    else:
        if network.active_fields() & _TRACES:
            raise NotImplementedError("trace resistance")
        current = _solve(network, np.minimum(g, _G_TAXEL_SHORT_S))
    return current[0] if g_frames_s is None else current


_TRACES = frozenset({"r_trace_row_ohm", "r_trace_column_ohm"})
_ACTS = _TRACES | {"r_row_driven_ohm", "r_row_grounded_ohm", "r_column_ohm", "v_column_offset_v", "i_leak_a"}


def _conductance(resistance_ohm: ArrayLike) -> Floats:
    with np.errstate(divide="ignore", over="ignore"):
        return np.minimum(np.divide(1.0, np.asarray(resistance_ohm, dtype=float)), _G_SERIES_SHORT_S)


def _solve(network: Network, g: Floats) -> Floats:
    offset = network.v_column_offset_v
    g_ground = float(_conductance(network.r_row_grounded_ohm))
    g_column = _conductance(network.r_column_ohm)

    # All rows grounded: star-mesh of every row node. link[c, d] joins two columns, leak[c] goes to ground.
    node = g.sum(axis=2) + g_ground
    share = np.divide(g, node[:, :, np.newaxis], out=np.zeros_like(g), where=node[:, :, np.newaxis] > 0)
    link = np.matmul(share.transpose(0, 2, 1), g)
    if network.g_lateral_row_s and network.cols > 1:
        neighbours = np.arange(network.cols - 1)
        link[:, neighbours, neighbours + 1] += network.rows * network.g_lateral_row_s
        link[:, neighbours + 1, neighbours] += network.rows * network.g_lateral_row_s
    link[:, np.arange(network.cols), np.arange(network.cols)] = 0.0
    leak = g_ground * share.sum(axis=1)

    # One right-hand side a row: a current into row r that would hold it at 1 V were all columns grounded; and
    # one for offsets and leaks. Columns that are held hard count their voltage from there, or the little they move
    # would drown in it; the others count from ground, or what two of them share through shorts would.
    drive = g.transpose(0, 2, 1)
    held = bool(offset.any() or network.i_leak_a.any())
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

    rows = network.rows
    reach = np.matmul(g, u[:, :rows].transpose(0, 2, 1))  # [frames, other row, driven row]
    own = np.arange(rows)
    at_row = 1.0 + np.divide(reach[:, own, own], node, out=np.zeros_like(node), where=node > 0)
    to_ground = g_ground * np.divide(reach, node[:, :, np.newaxis], out=np.zeros_like(reach), where=reach > 0)
    to_ground[:, own, own] = 0.0
    into_row = delivered[:, :rows].sum(axis=2) + to_ground.sum(axis=1)
    scale = network.r_row_driven_ohm * into_row + at_row
    source = np.full_like(scale, network.v_bias_v)
    if held:
        lifted = (share * (u[:, rows:] + origin)).sum(axis=2)
        delivered[:, rows:] -= g_column * (offset - origin)
        source -= (1.0 - g_ground * network.r_row_driven_ohm) * lifted
        return (source / scale)[:, :, np.newaxis] * delivered[:, :rows] + delivered[:, rows:]
    return (source / scale)[:, :, np.newaxis] * delivered[:, :rows]


def _eliminate(link: Floats, leak: Floats, drive: Floats) -> Floats:
    """Solve (leak + sum of links) v - link v = drive for v, [frames, n, m], by star-mesh steps."""
    n = leak.shape[1]
    mesh, ground, v = link.copy(), leak.copy(), drive.copy()
    pivot = np.empty_like(leak)
    for k in range(n):
        rest = slice(k + 1, n)
        pivot[:, k] = ground[:, k] + mesh[:, k, rest].sum(axis=1)
        weight = mesh[:, rest, k] / pivot[:, k, np.newaxis]
        ground[:, rest] += weight * ground[:, k, np.newaxis]
        v[:, rest] += weight[:, :, np.newaxis] * v[:, k, np.newaxis, :]
        # The diagonal collects a meaningless loop here; no step reads it.
        mesh[:, rest, rest] += weight[:, :, np.newaxis] * mesh[:, k, np.newaxis, rest]
    for k in reversed(range(n)):
        v[:, k] += np.matmul(mesh[:, k, np.newaxis, k + 1 :], v[:, k + 1 :])[:, 0]
        v[:, k] /= pivot[:, k, np.newaxis]
    _check_kirchhoff(link, leak, drive, v)
    return v


def _check_kirchhoff(link: Floats, leak: Floats, drive: Floats, v: Floats) -> None:
    out = (leak + link.sum(axis=2))[:, :, np.newaxis] * v
    across = np.matmul(link, v)
    size = np.abs(out) + np.matmul(link, np.abs(v)) + np.abs(drive)
    miss = np.abs(out - across - drive)
    if not (miss <= _RESIDUAL_MAX * size + _CURRENT_FLOOR_A).all():
        worst = np.nanmax(np.divide(miss, size, out=np.zeros_like(size), where=size > 0))
        raise SimulatorError(
            f"array solve: Kirchhoff's current law is missed by {worst:.1e} of the current at a node"
        )


def column_currents_reference(network: Network, digits: int = 60) -> Floats:
    """The same currents from the full nodal matrix, row after row, in `digits` decimal digits.

    Slow and obvious: series resistances of 0 fix their node, the driven row is stamped as it is, nothing is
    reused. Only a taxel of 0 ohm between two free nodes is taken as 1e-30 ohm.
    """
    with mpmath.workdps(digits):
        out = np.empty((network.rows, network.cols))
        for row in range(network.rows):
            out[row] = [float(i) for i in _reference_row(network, row)]
        return out


def _reference_row(network: Network, driven: int) -> list[mpmath.mpf]:
    rows, cols = network.rows, network.cols
    zero, one = mpmath.mpf(0), mpmath.mpf(1)

    # Every element as (node a, node b, conductance); nodes are rows, then columns, then numbered sources.
    elements: list[tuple[int, int, mpmath.mpf]] = []
    known: dict[int, mpmath.mpf] = {}
    feeds: list[tuple[int, float, mpmath.mpf]] = []
    for r in range(rows):
        resistance = network.r_row_driven_ohm if r == driven else network.r_row_grounded_ohm
        feeds.append((r, resistance, mpmath.mpf(network.v_bias_v) if r == driven else zero))
    for c in range(cols):
        feeds.append(
            (rows + c, float(network.r_column_ohm[c]), mpmath.mpf(float(network.v_column_offset_v[c])))
        )
    source = rows + cols
    for node, resistance, voltage in feeds:
        if resistance == 0:
            known[node] = voltage
        elif resistance != np.inf:
            known[source] = voltage
            elements.append((node, source, one / mpmath.mpf(resistance)))
            source += 1
    for r in range(rows):
        for c in range(cols):
            g = float(network.g_taxel_s[r, c])
            if g > 0:
                elements.append((r, rows + c, mpmath.mpf("1e30") if g == np.inf else mpmath.mpf(g)))
            if c + 1 < cols and network.g_lateral_row_s:
                elements.append((rows + c, rows + c + 1, mpmath.mpf(network.g_lateral_row_s)))

    touched = {n for a, b, _ in elements for n in (a, b)}
    free = sorted(n for n in touched if n not in known)
    # A floating row without a live taxel is alone and at no voltage; it is not touched and drops out.
    place = {n: i for i, n in enumerate(free)}
    voltage = dict(known)
    if free:
        matrix, right = mpmath.zeros(len(free)), mpmath.zeros(len(free), 1)
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
    for c in range(cols):
        node, total = rows + c, zero
        if node in known:  # all that flows in from the array
            for a, b, g in elements:
                if node in (a, b):
                    other = b if a == node else a
                    total += g * (voltage[other] - voltage[node])
        else:
            total = (voltage[node] - mpmath.mpf(float(network.v_column_offset_v[c]))) / mpmath.mpf(
                float(network.r_column_ohm[c])
            )
        currents.append(total)
    return currents
