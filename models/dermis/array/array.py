# SPDX-License-Identifier: Apache-2.0
"""The resistor array between row drivers and column inputs: column currents for each driven row."""

from __future__ import annotations

import dataclasses
import functools
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis import fields
from dermis.array import solve_error
from dermis.errors import SimulatorError

Floats = NDArray[np.float64]

# Conductances of a short. A taxel of 0 ohm is the limit of small equal resistances, which decides
# how a current splits between two of them; a series resistance of 0 ohm is harder than any taxel. The
# eliminations below never subtract them, and products of any two of them and of conductances down to 1e-60 S
# stay far from where doubles end.
_G_TAXEL_SHORT_S = 1e40
_G_SERIES_SHORT_S = 1e60
# And a resistance that lets nothing through, 1e-60 A a volt, and a capacitance that never charges.
_R_OPEN_OHM = 1e60
_C_MAX_F = 1e30

# Taxels solved at once: 128 frames of 16x16 keep the elimination inside a 1 MB cache.
_VALUES_AT_ONCE = 1 << 15

# Below any electron that ever flowed, above where products of doubles lose their digits to underflow.
_CURRENT_FLOOR_A = 1e-100


@dataclass(frozen=True, eq=False)
class Network:
    """The resistive network of one frame, everything in ohm, siemens and volt.

    Row r hangs on v_bias_v through r_row_driven_ohm while it is read and on ground through
    r_row_grounded_ohm otherwise (inf: floating); column c is held at v_column_offset_v[c] through
    r_column_ohm[c]. Lateral conductances lie between the inner electrodes of neighbouring taxels:
    `g_lateral_row_s` between columns c and c+1 in each row, `g_lateral_column_s` between rows r and
    r+1 in each column. Without trace resistance both ends of the latter are the same column line,
    so they carry no current and no solve here sees them; a deck still writes them.

    `i_leak_a[c]` flows into column c in front of r_column_ohm and adds to its current. Traces have
    a resistance per taxel pitch: a row line runs driver, segment, taxel 0, segment, taxel 1 ...; a
    column line taxel 0, segment, taxel 1 ... last taxel, segment, column node. Capacitances lie
    from every row line (behind its driver) and every column node to ground and across every taxel;
    they carry no direct current.

    Grounded rows share `r_return_ohm` to ground, the driven row does not. The pads' part of the
    resistances of rows and columns is in r_pad_row_ohm and r_pad_column_ohm as well, for a deck,
    where drivers and inputs may be transistors; no solve reads these two.
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
    r_return_ohm: float = 0.0
    r_pad_row_ohm: float = 0.0
    r_pad_column_ohm: float = 0.0

    def __post_init__(self) -> None:
        g = np.asarray(self.g_taxel_s, dtype=float)
        if g.ndim != 2 or 0 in g.shape or not (g >= 0).all():
            raise ValueError("g_taxel_s must be [rows, cols], 0 or above")
        object.__setattr__(self, "g_taxel_s", g)
        for name in ("r_column_ohm", "v_column_offset_v", "i_leak_a"):
            array = np.empty(g.shape[1])
            array[:] = getattr(self, name)
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
        if not 0 <= self.r_return_ohm < np.inf:
            raise ValueError("r_return_ohm must be finite and 0 or above")
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
        """Return the names of the non-ideal fields; the pads' part of a resistance has its own
        field.
        """
        return self._active

    @functools.cached_property
    def _active(self) -> frozenset[str]:
        active = fields.active(self, _GIVEN)
        pads = {
            "r_row_driven_ohm": self.r_pad_row_ohm,
            "r_row_grounded_ohm": self.r_pad_row_ohm,
            "r_column_ohm": self.r_pad_column_ohm,
        }
        return active - {n for n, pad_ohm in pads.items() if pad_ohm and np.all(getattr(self, n) == pad_ohm)}


# Fields of Network that a scene always sets.
_GIVEN = frozenset({"g_taxel_s", "v_bias_v"})


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
    lose no digit. docs/array_proofs.md has the derivation, docs/array.md the accuracy and the speed.

    Raises
    ------
    NoSolution
        Ideal sources of unlike voltages are joined by taxels of 0 ohm.
    SimulatorError
        The solution misses Kirchhoff's current law, or its error may be more than the record of solve_error.recording
        allows.
    """
    driven, rest = column_currents_by_source(network, g_frames_s)
    return driven if rest is None else driven + rest


class NoSolution(ValueError):
    """Taxels of 0 ohm join ideal sources of different voltages; `place` is the frame, row and
    column of one of them.
    """

    def __init__(self, frame: int, row: int, column: int) -> None:
        self.place = (frame, row, column)
        super().__init__(
            f"frame {frame}: the taxel of 0 ohm at row {row}, column {column} joins ideal sources of unlike voltages"
        )

    def __reduce__(self) -> tuple[type[NoSolution], tuple[int, int, int]]:
        # An exception is rebuilt from its message alone, which would be one argument of three.
        return type(self), self.place


@dataclass
class Currents:
    """Column currents in ampere, [rows, cols] or [frames, rows, cols], and a bound of the error of
    each.

    `driven` follows v_bias_v, `rest` is what offsets and leaks make, None where there are neither;
    `driven_error` and `rest_error` belong to them.
    """

    driven: Floats
    rest: Floats | None
    driven_error: Floats
    rest_error: Floats | None


def column_currents_by_source(
    network: Network, g_frames_s: ArrayLike | None = None
) -> tuple[Floats, Floats | None]:
    """Split the currents of `column_currents`: those that follow v_bias_v, and those of offsets and
    leaks.

    The second part is None where there are neither.
    """
    found = _by_source(network, g_frames_s, bounded=False)
    return found.driven, found.rest


def column_currents_with_bounds(network: Network, g_frames_s: ArrayLike | None = None) -> Currents:
    """Return the currents of `column_currents_by_source` with their error bounds.

    A bound is that of docs/array_proofs.md, "Count of roundings", for any conductances. Where
    it is below `solve_error.ErrorRecord.tolerance_a` nothing is done to make it smaller.
    """
    return _by_source(network, g_frames_s, bounded=True)


def _by_source(network: Network, g_frames_s: ArrayLike | None, bounded: bool) -> Currents:
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    if g.ndim != 3 or g.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"g_frames_s must be [frames, {network.rows}, {network.cols}]")
    if not g.min(initial=0.0) >= 0:  # what is no number is neither
        raise ValueError("g_frames_s must be 0 or above")
    record = solve_error.current()
    record.solves += len(g)
    if not network.active_fields() & _ACTS:
        with np.errstate(over="ignore"):
            driven, rest = network.v_bias_v * g, None
            errors = [_PRODUCT.bound * driven if bounded else driven, rest]
        record.take(_PRODUCT)
        record.check(driven, rest, _PRODUCT.bound, None)
    else:
        refuse_loops(network, g)
        network = in_range(network)
        driven, rest = np.empty_like(g), np.empty_like(g) if _held(network) else None
        errors = [np.empty_like(part) if bounded and part is not None else part for part in (driven, rest)]
        step = max(1, _VALUES_AT_ONCE // network.g_taxel_s.size)
        for first in range(0, len(g), step):
            part = slice(first, first + step)
            with _one_thread(network.cols):
                found = _solve(network, np.minimum(g[part], _G_TAXEL_SHORT_S), record)
            record.check(found.driven, found.rest, found.driven_part, found.rest_error)
            driven[part] = found.driven
            if rest is not None:
                rest[part] = found.rest
            if bounded:
                errors[0][part] = _of(found.driven_part, np.abs(found.driven))
            if bounded and rest is not None:
                errors[1][part] = found.rest_error
    parts = driven, rest, *errors
    return Currents(*(p if p is None or g_frames_s is not None else p[0] for p in parts))


def between_columns(network: Network, g_frames_s: Floats) -> Floats:
    """Return the conductance matrix between the sources of the columns, [frames, rows or 1, cols, cols] in siemens.

    Element [c, d] is the current into the array at column c for 1 V at d, all else at 0 V; rows are driven one after
    the other (one matrix for all where driven and grounded rows have the same resistance).
    """
    # Sources that are not 0 V: what they send each other is asked for.
    network = in_range(dataclasses.replace(network, v_column_offset_v=1.0))
    g = np.minimum(g_frames_s, _G_TAXEL_SHORT_S)
    driven, ground = (_conductance(float(r)) for r in (network.r_row_driven_ohm, network.r_row_grounded_ohm))
    own = np.arange(network.cols)
    out = np.empty((len(g), 1 if driven == ground else network.rows, network.cols, network.cols))
    with _one_thread(network.cols):
        lines = _RowLines(network, g)
        for row in range(out.shape[1]):
            grounded = np.full(network.rows, ground)
            grounded[row] = driven
            mesh = _respond(network, lines, grounded).mesh
            assert mesh is not None
            out[:, row] = -mesh.between
            out[:, row, own, own] = mesh.between.sum(axis=2) + mesh.ground
    return out


# Columns from which products of matrices are large enough for BLAS to share among threads.
_SHARED_COLS = 24


def _one_thread(cols: int) -> AbstractContextManager[Any]:
    """Keep BLAS to one thread: on small matrices its threads wait for each other, up to thirty times as long."""
    return _blas().limit(limits=1, user_api="blas") if cols >= _SHARED_COLS else nullcontext()


@functools.cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


# A taxel's conductance and a product with the bias, a rounding each.
_PRODUCT = solve_error.Figures(bound=2 * solve_error.U)


def refuse_loops(network: Network, g: Floats) -> None:
    """Raise NoSolution where shorts join ideal sources: column inputs, and grounded rows on ideal
    drivers.

    The bias of an ideal driven row across a short into an ideal column is no such thing: it has the
    limit of any small resistance, more than full scale.
    """
    if network.r_trace_row_ohm or network.r_trace_column_ohm or not network.v_column_offset_v.any():
        return
    short = np.isinf(g)
    held = network.r_column_ohm == 0
    hard_row = network.r_row_grounded_ohm == 0 or network.r_row_driven_ohm == 0
    for frame, row, column in np.argwhere(short & held & (network.v_column_offset_v != 0)):
        rows, columns = _joined(short[frame], column)
        others = network.v_column_offset_v[columns & held]
        if (hard_row and rows.any()) or (others != network.v_column_offset_v[column]).any():
            raise NoSolution(int(frame), int(row), int(column))


def _joined(short: NDArray[np.bool_], column: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the rows and columns that shorts [rows, cols] join with one column."""
    rows, columns = np.zeros(short.shape[0], dtype=bool), np.zeros(short.shape[1], dtype=bool)
    columns[column], before = True, 0
    while columns.sum() + rows.sum() > before:
        before = int(columns.sum() + rows.sum())
        rows = short[:, columns].any(axis=1)
        columns |= short[rows].any(axis=0)
    return rows, columns


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
        "r_pad_row_ohm",
        "r_pad_column_ohm",
    }
)


def in_range(network: Network) -> Network:
    """Limit extreme values so that their products stay finite."""
    limited = {
        "r_row_driven_ohm": _R_OPEN_OHM,
        "r_column_ohm": _R_OPEN_OHM,
        "r_trace_row_ohm": _R_OPEN_OHM,
        "r_trace_column_ohm": _R_OPEN_OHM,
        "r_return_ohm": _R_OPEN_OHM,
        "g_lateral_row_s": _G_SERIES_SHORT_S,
        "g_lateral_column_s": _G_SERIES_SHORT_S,
        "c_row_f": _C_MAX_F,
        "c_column_f": _C_MAX_F,
        "c_taxel_f": _C_MAX_F,
    }
    change = {}
    for name, most in limited.items():
        above = getattr(network, name) > most
        if above.any() if isinstance(above, np.ndarray) else above:
            change[name] = np.minimum(getattr(network, name), most)
    if _R_OPEN_OHM < network.r_row_grounded_ohm < np.inf:
        change["r_row_grounded_ohm"] = _R_OPEN_OHM
    return dataclasses.replace(network, **change) if change else network


def _conductance(resistance_ohm: ArrayLike) -> Floats | float:
    if isinstance(resistance_ohm, float):
        return min(1.0 / float(resistance_ohm), _G_SERIES_SHORT_S) if resistance_ohm else _G_SERIES_SHORT_S
    with np.errstate(divide="ignore", over="ignore"):
        return np.minimum(np.divide(1.0, np.asarray(resistance_ohm, dtype=float)), _G_SERIES_SHORT_S)


def _ratio(above: Floats, below: Floats) -> Floats:
    """Return above / below, 0 where below is 0 (a row line without any conductance)."""
    if below.min() > 0:
        return above / below
    return np.divide(
        above, below, out=np.zeros(np.broadcast_shapes(above.shape, below.shape)), where=below > 0
    )


# The products along a row line stay away from underflow by as much again.
_PRODUCT_MIN = 1e-150


class _RowLines:
    """Row lines without their drivers, seen from the column lines: [frames, rows, cols].

    Everything of row line r between its driver's node and the column lines is `to_driver[:, r, c]`,
    a conductance from the driver's node to column line c, and `between` gives those from column
    line to column line.
    """

    def __init__(self, network: Network, g: Floats) -> None:
        self.g = g
        self.to_driver = g
        self.bent = network.r_trace_row_ohm > 0
        if not self.bent:
            return
        from dermis.array import star_mesh

        # The line as a ladder: `pass_on` is the part of a current into node c that goes towards the driver, with only
        # the nodes before c connected; `seen` the resistance at node c with the driver's node and all column lines
        # grounded; `through` the product of `pass_on` from the driver on.
        self.pass_on, self.seen, self.through, self.to_driver = found = tuple(np.empty((4, *g.shape)))
        star_mesh.ladder(np.ascontiguousarray(g), float(_conductance(network.r_trace_row_ohm)), *found)

    def between(self) -> Floats:
        """Conductances between column lines through all row lines, [frames, cols, cols]; diagonal
        0.

        From node i to node j > i it is g_i seen_i times all pass_on between them times g_j. As a
        product of one factor of i and one of j it is fast, as long as the products from the driver
        on stay in range.
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


# Relative bounds are one number for all, or an array of the shape of what they belong to.
Part = float | Floats


def _of(part: Part, size: Floats) -> Floats:
    """Return part * size for sizes of 0 or above; 0 for a size of 0, also if the part is
    infinite.
    """
    if isinstance(part, float) and part < np.inf:
        return part * size
    with np.errstate(over="ignore"):
        return np.multiply(
            part, size, out=np.zeros(np.broadcast_shapes(np.shape(part), size.shape)), where=size > 0
        )


def _three(part: Part) -> Floats:
    """Relative bounds with three axes, for compiled loops."""
    return np.array(part, dtype=float, ndmin=3, order="C")


@dataclass
class _Mesh:
    """Conductances between the ideal sources of the columns after elimination of all nodes, each 0
    or above.

    `between` [frames, cols, cols], diagonal 0, and `ground` [frames, cols] are conductances; `own`
    [frames, cols] is the part of a current into a column's node that leaves through its own input.
    The others bound their errors.
    """

    between: Floats
    ground: Floats
    own: Floats
    between_part: Part
    ground_part: Part
    own_part: Part


@dataclass
class _Response:
    """Response of the array with all rows grounded to a current into row r.

    The current into the driver's node of row r is the one that would hold it at 1 V were all column
    lines grounded. `delivered` [frames, rows, cols] then leaves through the columns, the node (of
    conductance `node`) is at 1 + `lift`, and `away` goes to any ground but its own row's, all [frames, rows].
    `mesh` is there for offsets and leaks. `delivered_part` bounds the relative error of
    `delivered`, `away_a` and `lift_v` [frames, rows] those of the others where they are not the
    same number. `voltage` counts the roundings in any voltage behind these
    (solve_error.one_matrix), `missed` is how far Kirchhoff's law was missed, `condition` as in
    solve_error.ErrorRecord.
    """

    delivered: Floats
    node: Floats
    lift: Floats
    away: Floats
    mesh: _Mesh | None
    voltage: float
    missed: float
    condition: float
    delivered_part: Part
    away_a: Floats | None = None
    lift_v: Floats | None = None


@dataclass
class _Solution:
    """Currents [frames, rows, cols] and the bounds of their errors: of `driven` relative, of `rest`
    in ampere.
    """

    driven: Floats
    rest: Floats | None
    driven_part: Part
    rest_error: Floats | None


def _solve(network: Network, g: Floats, record: solve_error.ErrorRecord) -> _Solution:
    from dermis.array import star_mesh

    lines = _RowLines(network, g)
    grounded = np.full(network.rows, _conductance(network.r_row_grounded_ohm))
    response = _respond(network, lines, grounded)
    scale, driven, most = np.empty(g.shape[:2]), np.empty(g.shape), solve_error.balance(response.voltage)
    missed = star_mesh.slots(
        np.ascontiguousarray(lines.to_driver), grounded, response.lift, response.away, response.delivered,
        network.r_row_driven_ohm, network.v_bias_v, _CURRENT_FLOOR_A / most, scale, driven,
    )  # fmt: skip
    _accept(missed, "in the slot of a row", most)
    part = response.delivered_part + _scale_part(network, response, scale)
    bound = part if isinstance(part, float) else _largest_part(_of(part, np.abs(driven)), driven)
    figures = solve_error.Figures(max(missed, response.missed), response.condition, bound)
    rest = error_rest = None
    if response.mesh is not None:
        rest, error_rest, figures.slots_alone = _rest(network, g, response, scale, record)
    if network.r_return_ohm:
        driven, rest, part, error_rest = _lift(
            network, response, scale, _Solution(driven, rest, part, error_rest)
        )
        error = _of(part, driven) + (0.0 if error_rest is None else error_rest)
        figures.bound = max(figures.bound, _largest_part(error, driven))
    record.take(figures)
    return _Solution(driven, rest, part, error_rest)


def _largest_part(error: Floats, driven: Floats) -> float:
    """Largest error of a slot, of its largest current."""
    most = np.abs(driven).max(axis=2, keepdims=True)
    return float(np.divide(error, most, out=np.zeros_like(error), where=most > 0).max())


def _lift(
    network: Network, response: _Response, scale: Floats, grounded: _Solution
) -> tuple[Floats, Floats | None, Floats, Floats | None]:
    """Add the currents of the shared return, which `grounded` holds at 0 V; the fields of a
    solution.

    In the slot of row r the other rows' drivers end at one node, at v ohm r_return to ground. By
    superposition it adds v times `seen`, the column currents a volt of that node: those of all
    other rows driven at 1 V. By reciprocity it is also the current that a column source of 1 V
    sends into the node. Every quantity is a sum of positive terms where driven and grounded rows
    have the same resistance.
    """
    ground = max(min(network.r_row_grounded_ohm, _R_OPEN_OHM), 1.0 / _G_SERIES_SHORT_S)
    change = 0.0 if network.r_row_driven_ohm == ground else (ground - network.r_row_driven_ohm) / ground
    # Floating rows have nodes of no conductance where no taxel is; here an open is one.
    node = np.maximum(response.node, _conductance(ground))
    with np.errstate(over="ignore", invalid="ignore"):
        # Each row driven at 1 V with every row grounded through `ground`, then row r's own driver.
        alone = (_conductance(ground) / node)[:, :, np.newaxis] * response.delivered
        to_rows = np.maximum(response.away - response.delivered.sum(axis=2), 0.0)
        sent = to_rows / scale
        own = (change * sent / node)[:, :, np.newaxis] * response.delivered
        others = _sum_of_others(alone)
        seen = np.maximum(others - own, 0.0)
        share = network.r_return_ohm / (1.0 + network.r_return_ohm * (seen.sum(axis=2) + sent))
        volt = (network.v_bias_v * share * sent)[:, :, np.newaxis]
        driven = grounded.driven + volt * seen
        # Errors: of `sent`, a difference, and of `seen`; the factor counts the products and quotients of both.
        part = (
            8.0 * float(np.max(grounded.driven_part))
            + (2 * network.rows + 2 * network.cols + 32) * solve_error.U
        )
        doubt = _of(part, others + np.abs(own))
        sent_v = (network.v_bias_v * share * _of(part, response.away / scale))[:, :, np.newaxis]
        error = _of(grounded.driven_part, grounded.driven) + volt * doubt + sent_v * (seen + doubt)
        relative = np.divide(error, driven, out=np.zeros_like(driven), where=driven > 0)
        rest, error_rest = grounded.rest, grounded.rest_error
        if rest is not None and error_rest is not None:
            source = network.v_column_offset_v + network.r_column_ohm * network.i_leak_a
            lifted = share * (seen * source).sum(axis=2)
            size = share * ((seen + doubt) * np.abs(source)).sum(axis=2)
            rest = rest + lifted[:, :, np.newaxis] * seen
            error_rest = error_rest + size[:, :, np.newaxis] * (2.0 * doubt + _of(part, seen))
    relative = np.where(np.isnan(relative), np.inf, relative)
    return driven, rest, relative, error_rest


def _scale_part(network: Network, response: _Response, scale: Floats) -> Part:
    """Return the relative error bound of the divisor in the driver of a row."""
    if response.away_a is None or response.lift_v is None:
        return response.delivered_part
    # An ideal driver divides by nothing that is in doubt, however much what leaves its row is.
    driver = network.r_row_driven_ohm * response.away_a if network.r_row_driven_ohm else 0.0
    error = (driver + response.lift_v) / scale
    # Of a quotient; a divisor that is in doubt by half of itself says nothing.
    part = np.where(error < 0.5, error / (1.0 - np.minimum(error, 0.5)), np.inf)
    return np.minimum(part, solve_error.part(response.voltage, network.rows, network.cols))[:, :, np.newaxis]


def _rest(
    network: Network,
    g: Floats,
    response: _Response,
    scale: Floats,
    record: solve_error.ErrorRecord,
) -> tuple[Floats, Floats, int]:
    """Currents that offsets and leaks drive and a bound of their error in ampere, [frames, rows,
    cols], and how many slots were solved by themselves.

    With all rows grounded each is a sum over pairs of sources of a conductance times a difference
    of voltages, which loses nothing but what cancels by nature. The driven row is a change at one
    node, and that may cancel on top: such slots are solved by themselves.
    """
    from dermis.array import star_mesh

    delivered = response.delivered
    pushed = network.r_column_ohm * network.i_leak_a
    source = network.v_column_offset_v + pushed
    ground, driver = network.r_row_grounded_ohm, network.r_row_driven_ohm
    if ground == np.inf:
        change = 1.0
    elif ground == driver:
        change = 0.0
    else:
        ground = max(ground, 1.0 / _G_SERIES_SHORT_S)
        change = (ground - driver) / ground
    held, error_held = _held_currents(network, response.mesh)
    rest, error = np.empty((2, *delivered.shape))
    doubtful = np.empty(delivered.shape[:2], dtype=bool)
    star_mesh.driven_slots(
        held, error_held, delivered, _three(response.delivered_part), source,
        np.abs(network.v_column_offset_v) + np.abs(pushed), response.node, scale, change,
        _three(_scale_part(network, response, scale)), record.tolerance_a(network.cols), rest, error,
        doubtful,
    )  # fmt: skip
    slots = np.argwhere(doubtful)
    for row in set(slots[:, 1].tolist()):
        frames = slots[slots[:, 1] == row, 0]
        grounded = np.full(network.rows, _conductance(ground))
        grounded[row] = _conductance(driver)
        alone = _respond(network, _RowLines(network, g[frames]), grounded)
        rest[frames, row], error[frames, row] = _held_currents(network, alone.mesh)
    if not np.isfinite(rest).all():
        raise SimulatorError("array solve: current of offsets and leaks overflows; use smaller ones")
    return rest, error, len(slots)


def _held_currents(network: Network, mesh: _Mesh | None) -> tuple[Floats, Floats]:
    """Column currents that offsets and leaks drive with every row on ground, and a bound of their
    error in ampere, [frames, cols] each."""
    from dermis.array import star_mesh

    assert mesh is not None
    leak, held, error = network.i_leak_a, np.empty(mesh.ground.shape), np.empty(mesh.ground.shape)
    parts = _three(mesh.between_part), _three(mesh.ground_part), _three(mesh.own_part)
    # The differences and the sums of these few terms round as well.
    rounding = (2 * network.cols + 8) * solve_error.U
    star_mesh.held_currents(
        mesh.between, mesh.ground, mesh.own, parts, rounding, network.v_column_offset_v, leak,
        network.r_column_ohm * leak, held, error,
    )  # fmt: skip
    return held, error


def _held(network: Network) -> bool:
    return bool(network.v_column_offset_v.any() or network.i_leak_a.any())


def _add_neighbours(link: Floats, g: float) -> None:
    at = np.arange(link.shape[1] - 1)
    link[:, at, at + 1] += g
    link[:, at + 1, at] += g


def _respond(network: Network, lines: _RowLines, g_ground: Floats) -> _Response:
    """Return the response to all drives with rows on ground through `g_ground` [rows]."""
    chained = network.r_trace_column_ohm > 0
    return (_respond_chain if chained else _respond_columns)(network, lines, g_ground)


def _respond_columns(network: Network, lines: _RowLines, g_ground: Floats) -> _Response:
    """Every column line is one node."""
    rows, cols = network.rows, network.cols
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
    own = np.arange(cols)
    link[:, own, own] = 0.0
    leaks = g_ground[:, np.newaxis] * share
    leak = leaks.sum(axis=1)

    # One right-hand side a row; and, for offsets and leaks, one a column: its source at 1 V.
    drive = g.transpose(0, 2, 1)
    held, missed, condition = _held(network), 0.0, 1.0
    roundings = solve_error.elements(rows, cols, lines.bent)
    if network.r_column_ohm.any():
        if held:
            sources = np.broadcast_to(np.diag(g_column), link.shape)
            drive = np.concatenate([drive, sources], axis=2)
        roundings = solve_error.one_matrix(cols, roundings)
        u, missed, condition = _eliminate(
            link, leak + g_column, drive, solve_error.balance(roundings), cols if held else 0
        )
        delivered = g_column[:, np.newaxis] * u
    else:
        u = np.zeros_like(drive)
        delivered = drive
    moved, delivered_rows = (v[:, :, :rows].transpose(0, 2, 1) for v in (u, delivered))
    away = delivered_rows.sum(axis=2)
    away += (_sum_of_others(leaks) * moved).sum(axis=2)
    part = solve_error.part(roundings, rows, cols)
    mesh = None
    if held and network.r_column_ohm.any():
        between, across = delivered[:, :, rows:].copy(), u[:, :, rows:]
        between[:, own, own] = 0.0
        ground = (leak[:, :, np.newaxis] * across).sum(axis=1)
        mesh = _Mesh(between, ground, np.ascontiguousarray(across[:, own, own]), part, part, part)
        missed = max(missed, _check_mesh(mesh, network.r_column_ohm, solve_error.balance(roundings)))
    elif held:
        mesh = _Mesh(link, leak, np.ones_like(leak), part, part, part)
    lift = _ratio((g * moved).sum(axis=2), node)
    delivered_rows = np.ascontiguousarray(delivered_rows)
    return _Response(delivered_rows, node, lift, away, mesh, roundings, missed, condition, part)


def _check_mesh(mesh: _Mesh, resistance: Floats, most: float) -> float:
    """A source at 1 V: what it sends to others and to ground, through its own resistance, leaves
    the rest of 1 V; and what it sends to another is what that one would send to it."""
    from dermis.array import star_mesh

    away, apart = star_mesh.mesh_misses(
        mesh.between, mesh.ground, mesh.own, resistance, _CURRENT_FLOOR_A / most
    )
    _accept(away, "from the source of a column", most)
    _accept(apart, "from one column to another", most)
    return float(max(away, apart))


def _sum_of_others(values: Floats) -> Floats:
    """Sum along axis 1 of all elements but the one at each place, without a subtraction."""
    from dermis.array import star_mesh

    others = np.empty(values.shape)
    star_mesh.sum_of_others(np.ascontiguousarray(values), others)
    return others


# A bound from counted roundings up to this is good enough for any code; beyond it the residuals of every drive at
# every node are worth their time.
_COUNTED_ENOUGH = 1e-9


def _respond_chain(network: Network, lines: _RowLines, g_ground: Floats) -> _Response:
    """Every column line is a chain of one node a row: all drives walk up and down through the
    inverses of blocks of one row, which are eliminated from the inputs up.
    """
    from dermis.array import star_mesh

    behind = network.r_trace_column_ohm + network.r_column_ohm
    g_end = _conductance(behind)
    step = float(_conductance(network.r_trace_column_ohm)) + network.g_lateral_column_s
    g = lines.to_driver
    frames, rows, cols = g.shape
    sources = cols if _held(network) else 0
    roundings = solve_error.chain(rows, cols, solve_error.elements(rows, cols, lines.bent))
    part = solve_error.part(roundings, rows, cols)
    first, drives = star_mesh.ROWS + rows, star_mesh.ROWS + rows + sources
    (node, lift), away = np.empty((2, frames, rows)), np.empty((frames, drives))
    last = np.empty((frames, drives, cols))
    largest, volt = np.empty(frames), np.empty((frames, drives) if part > _COUNTED_ENOUGH else (0, 0))
    pass_on, seen = (lines.pass_on, lines.seen) if lines.bent else (g, g)
    missed = star_mesh.chain(
        lines.g, pass_on, seen, lines.bent, g, g_ground, float(network.g_lateral_row_s), step, g_end,
        node, lift, away, last, largest, volt,
    )  # fmt: skip
    _accept(missed, "at a node", solve_error.balance(roundings))
    of_rows = slice(star_mesh.ROWS, first)
    response = _Response(
        g_end * last[:, of_rows],
        node,
        lift,
        np.ascontiguousarray(away[:, of_rows]),
        None,
        roundings,
        missed,
        # |inverse| |matrix| 1 is at most twice the voltages under what each node would pass on at 1 V.
        float(2.0 * largest.max()),
        part,
    )
    found, to_ground = None, away[:, star_mesh.MEASURE]
    if volt.size:
        # Residuals bound voltages: by what a drive misses, times what `largest` stands for.
        with np.errstate(over="ignore", invalid="ignore"):
            off = volt[:, :, np.newaxis] * last[:, np.newaxis, star_mesh.MEASURE]
            found = np.divide(off, last, out=np.zeros_like(off), where=last > 0)
            found = np.fmin(np.where(np.isnan(found), np.inf, found), part)
            response.away_a = volt[:, of_rows] * to_ground[:, np.newaxis]
            response.lift_v = volt[:, of_rows] * largest[:, np.newaxis]
        response.delivered_part = found[:, of_rows]
    if sources:
        own = np.arange(cols)
        across = np.ascontiguousarray(last[:, first:].transpose(0, 2, 1))
        ground = np.ascontiguousarray(away[:, first:])
        between, tau = g_end[:, np.newaxis] * across, np.ascontiguousarray(across[:, own, own])
        between[:, own, own] = 0.0
        sent = between.sum(axis=1) + ground
        # A leak enters in front of the last segment: what it sees there is that and the array behind it.
        response.mesh = mesh = _Mesh(
            between, ground, tau + network.r_trace_column_ohm * sent, part, part, part
        )
        seen_by = _Mesh(between, ground, tau, part, part, part)
        response.missed = max(missed, _check_mesh(seen_by, behind, solve_error.balance(roundings)))
        if found is not None:
            mesh.between_part = found[:, first:].transpose(0, 2, 1)
            with np.errstate(over="ignore", invalid="ignore"):
                off = volt[:, first:] * to_ground[:, np.newaxis]
                mesh.ground_part = np.fmin(
                    np.divide(off, ground, out=np.zeros_like(off), where=ground > 0), part
                )
            mesh.own_part = mesh.between_part.max(axis=(1, 2), keepdims=True)[:, :, 0]
    return response


# Columns eliminated one by one before a product of matrices takes their effect to the rest. Up to 64 the steps
# alone are faster.
_PANEL = 64


def _eliminate(
    link: Floats, leak: Floats, drive: Floats, most: float, own: int = 0
) -> tuple[Floats, float, float]:
    """Solve (leak + sum of links) v - link v = drive for v, [frames, n, m], by star-mesh steps.

    Steps go in panels, so that the bulk is a product of matrices, still of sums only. The last
    `own` drives, n or none, go into one node each. Returns v, how far Kirchhoff's law is missed
    (refused above `most`) and a bound of Skeel's condition number.
    """
    # Loading the compiled steps takes a moment that a scene without a solve does not need to wait.
    from dermis.array import star_mesh

    n = leak.shape[1]
    # Links, ground and drives side by side: an elimination does the same to all of them.
    work = np.concatenate([link, leak[:, :, np.newaxis], drive], axis=2)
    v = work[:, :, n + 1 :]
    pivot = np.empty_like(leak)
    panels = [(first, min(first + _PANEL, n)) for first in range(0, n, _PANEL)]
    for first, last in panels:
        star_mesh.down(work, pivot, first, last, own)
        if last < n:
            weight = work[:, first:last, last:n] / pivot[:, first:last, np.newaxis]
            work[:, last:, last:] += np.matmul(weight.transpose(0, 2, 1), work[:, first:last, last:])
    for first, last in reversed(panels):
        if last < n:
            v[:, first:last] += np.matmul(work[:, first:last, last:n], v[:, last:])
        star_mesh.up(work, pivot, first, last)
    missed, condition = _check_kirchhoff(link, leak, drive, v, most)
    return v, missed, condition


def _check_kirchhoff(
    link: Floats, leak: Floats, drive: Floats, v: Floats, most: float
) -> tuple[float, float]:
    """Check Kirchhoff's law at every node for all drives together, and for every drive over all
    nodes.

    Drives and voltages are 0 or above. Returns the largest miss, and 2 max(out / leak): the inverse
    turns leaks into 1 V everywhere, so no row of |inverse| |matrix| sums to more.
    """
    magnitude = drive.sum(axis=1)
    weight = (1.0 / np.maximum(magnitude, _CURRENT_FLOOR_A))[:, :, np.newaxis]
    node_v = np.matmul(v, weight)
    out = (leak + link.sum(axis=2))[:, :, np.newaxis]
    came = np.matmul(drive, weight) + np.matmul(link, node_v)
    missed = _check_balance(out * node_v, came, "at a node", most)
    across = np.matmul(leak[:, np.newaxis, :], v)[:, 0]
    missed = max(missed, _check_balance(across, magnitude, "from one source", most))
    with np.errstate(over="ignore", divide="ignore"):
        condition = 2.0 * float((out[:, :, 0] / leak).max())
    return missed, condition


def _check_balance(left: Floats, right: Floats, where: str, most: float) -> float:
    """Compare sums of currents that are 0 or above; returns the largest miss, of both."""
    from dermis.array import star_mesh

    worst = float(star_mesh.miss(left.ravel(), right.ravel(), _CURRENT_FLOOR_A / most))
    _accept(worst, where, most)
    return worst


def _accept(worst: float, where: str, most: float) -> None:
    if not worst <= most:
        raise SimulatorError(
            f"array solve: Kirchhoff's current law is missed by {worst:.1e} of the current {where}"
        )
