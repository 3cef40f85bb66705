# SPDX-License-Identifier: Apache-2.0
"""The resistor array between row drivers and column inputs: column currents for each driven row."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dermis.array import solve_error, star_mesh
from dermis.array.network import LIMITED, Network, ends
from dermis.errors import SimulatorError
from dermis.ndarrays import Bools, Floats

# Conductances of a short. A taxel of 0 ohm is the limit of small equal resistances, which decides
# how a current splits between two of them; a series resistance of 0 ohm is harder than any taxel. The
# eliminations below never subtract them, and products of any two of them and of conductances down to 1e-60 S
# stay far from where doubles end.
_G_TAXEL_SHORT_S = 1e40
_G_SERIES_SHORT_S = 1e60
_CONDUCTANCE_MIN_S = 1e-60

# Taxels solved at once: 128 frames of 16x16 keep the elimination inside a 1 MB cache.
_VALUES_AT_ONCE = 1 << 15

# Below any electron that ever flowed, above where products of doubles lose their digits to underflow.
_CURRENT_FLOOR_A = 1e-100


# Alone these change no current: between ideal columns laterals carry none, capacitances no direct one.
_IDLE = frozenset({"r_return_ohm", *LIMITED["lateral conductances"], *LIMITED["capacitances"]})


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
    docs/array.md has what is solved and how exactly ("Reductions"), docs/array_proofs.md the derivation.

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


def column_currents_by_source(
    network: Network, g_frames_s: ArrayLike | None = None
) -> tuple[Floats, Floats | None]:
    """Split the currents of `column_currents`: those that follow v_bias_v, and those of offsets and
    leaks.

    The second part is None where there are neither.
    """
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    if g.ndim != 3 or g.shape[1:] != network.g_taxel_s.shape:
        raise ValueError(f"g_frames_s must be [frames, {network.rows}, {network.cols}]")
    if not g.min(initial=0.0) >= 0:  # what is no number is neither
        raise ValueError("g_frames_s must be 0 or above")
    record, rest = solve_error.current(), None
    record.solves += len(g)
    if network.active_fields() <= _IDLE:
        with np.errstate(over="ignore"):
            driven = network.v_bias_v * g
        # A taxel's conductance and a product with the bias, a rounding each.
        record.take(bound=2 * solve_error.U)
        record.check(driven, None, 2 * solve_error.U, None)
    else:
        refuse_loops(network, g)
        network = in_range(network)
        driven, rest = np.empty_like(g), np.empty_like(g) if _held(network) else None
        step = max(1, _VALUES_AT_ONCE // network.g_taxel_s.size)
        for first in range(0, len(g), step):
            part = slice(first, first + step)
            with _one_thread(network.cols):
                driven[part], found, *errors = _solve(
                    network, np.minimum(g[part], _G_TAXEL_SHORT_S, order="C")
                )
            record.check(driven[part], found, *errors)
            if rest is not None:
                rest[part] = found
    if g_frames_s is None:
        return driven[0], None if rest is None else rest[0]
    return driven, rest


def between_columns(network: Network, g_frames_s: Floats) -> Floats:
    """Return the conductance matrix between the sources of the columns, [frames, rows or 1, cols, cols] in siemens.

    Element [c, d] is the current into the array at column c for 1 V at d, all else at 0 V; rows are driven one after
    the other (one matrix for all where driven and grounded rows have the same resistance).
    """
    # Sources that are not 0 V: what they send each other is asked for.
    network = in_range(dataclasses.replace(network, v_column_offset_v=1.0))
    driven, ground = (_conductance(r) for r in (network.r_row_driven_ohm, network.r_row_grounded_ohm))
    own = np.arange(network.cols)
    out = np.empty((len(g_frames_s), 1 if driven == ground else network.rows, network.cols, network.cols))
    with _one_thread(network.cols):
        lines = _row_lines(network, np.minimum(g_frames_s, _G_TAXEL_SHORT_S, order="C"))
        for row in range(out.shape[1]):
            grounded = np.full(network.rows, ground)
            grounded[row] = driven
            mesh = _respond(network, lines, grounded).mesh
            assert mesh is not None
            out[:, row] = -mesh[0]
            out[:, row, own, own] = mesh[0].sum(axis=2) + mesh[1]
    return out


# Columns from which products of matrices are large enough for BLAS to share among threads.
_SHARED_COLS = 24


def _one_thread(cols: int) -> AbstractContextManager[Any]:
    """Keep BLAS to one thread: on small matrices its threads wait for each other, up to thirty times as long."""
    return _blas().limit(limits=1, user_api="blas") if cols >= _SHARED_COLS else nullcontext()


@functools.cache
def _blas() -> Any:
    import scipy.linalg.cython_blas  # noqa: F401 - that of compiled loops, which else is loaded behind the limit's back
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


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


def _joined(short: Bools, column: int) -> tuple[Bools, Bools]:
    """Return the rows and columns that shorts [rows, cols] join with one column."""
    from scipy.sparse.csgraph import connected_components

    rows = len(short)
    lines = np.zeros((sum(short.shape),) * 2, dtype=bool)
    lines[:rows, rows:] = short
    part = connected_components(lines, directed=False)[1]
    return part[:rows] == part[rows + column], part[rows:] == part[rows + column]


def in_range(network: Network) -> Network:
    """Limit extreme values so that their products stay finite."""
    change = {}
    for name in ("r_row_grounded_ohm", *itertools.chain(*LIMITED.values())):
        # A resistance that lets nothing through, 1e-60 A a volt, and a capacitance that never charges.
        value, most = getattr(network, name), 1e30 if name.startswith("c_") else 1 / _CONDUCTANCE_MIN_S
        if most < ends(value)[1] < np.inf:
            change[name] = np.minimum(value, most)
    return dataclasses.replace(network, **change) if change else network


def _conductance(resistance_ohm: ArrayLike) -> Floats:
    with np.errstate(divide="ignore", over="ignore"):
        return np.minimum(np.divide(1.0, resistance_ohm), _G_SERIES_SHORT_S)


def _ratio(above: Floats, below: Floats) -> Floats:
    """Return above / below, 0 where below is 0 (a row line without any conductance)."""
    if below.min() > 0:
        return above / below
    return np.divide(above, below, out=np.zeros(np.broadcast(above, below).shape), where=below > 0)


@dataclass
class _Response:
    """Response of the array with all rows grounded to a current into row r.

    The current into the driver's node of row r is the one that would hold it at 1 V were all column
    lines grounded. `delivered` [frames, rows, cols] then leaves through the columns, the node (of
    conductance `node`) is at 1 + `lift`, and `away` goes to any ground but its own row's, all [frames, rows].
    `roundings` counts those in any voltage behind these (solve_error.one_matrix). `part` bounds the
    relative error of `delivered`, one number or one each, and `scale_error` [frames, rows] the error of
    1 + lift + r_row_driven_ohm away where it is not the same part. `held` are the currents that offsets and
    leaks drive with every row on ground and a bound of their error in ampere, [frames, cols] each,
    `mesh` the conductances from source to source (`_held_currents`) and from each to ground.
    """

    delivered: Floats
    node: Floats
    lift: Floats
    away: Floats
    roundings: float
    part: Floats | float
    scale_error: Floats | None = None
    held: tuple[Floats, Floats] | None = None
    mesh: tuple[Floats, Floats] | None = None


# Currents [frames, rows, cols] that follow v_bias_v and those of offsets and leaks, and the bounds of their
# errors: of the former relative, of the latter in ampere.
_Solution = tuple[Floats, Floats | None, Floats | float, Floats | None]


def _solve(network: Network, g: Floats) -> _Solution:
    """Solve a batch of frames and record its figures."""
    rest, error_rest, lines = None, None, _row_lines(network, g)
    g_ground = np.full(network.rows, _conductance(network.r_row_grounded_ohm))
    found = _respond(network, lines, g_ground)
    into, out = lines.to_driver.sum(axis=2), found.away + g_ground * found.lift
    _check(into, out, "in the slot of a row", solve_error.balance(found.roundings))
    scale = network.r_row_driven_ohm * found.away + (1.0 + found.lift)
    driven = (network.v_bias_v / scale)[:, :, np.newaxis] * found.delivered
    scale_part = found.part
    if found.scale_error is not None:
        error = found.scale_error / scale
        # Of a quotient; a divisor that is in doubt by half of itself says nothing.
        scale_part = np.where(error < 0.5, error / (1.0 - np.minimum(error, 0.5)), np.inf)
        scale_part = np.minimum(scale_part, solve_error.part(found.roundings, *g.shape[1:]))[:, :, np.newaxis]
    part = found.part + scale_part
    with np.errstate(over="ignore", invalid="ignore"):
        solve_error.current().take(bound=_bound(part, driven))
        # From all rows grounded to one driven: the part of its conductance to ground that a row loses, and what that
        # takes off the voltage of its driver's node.
        ohm = np.maximum([network.r_row_driven_ohm, network.r_row_grounded_ohm], _CONDUCTANCE_MIN_S)
        lost = 1.0 if ohm[1] == np.inf else (ohm[1] - ohm[0]) / ohm[1]
        change = _ratio(lost, found.node * scale)
        if found.held is not None:
            rest, error_rest = _rest(network, g, found, change, part)
            if not np.isfinite(rest).all():
                raise SimulatorError("array solve: current of offsets and leaks overflows; use smaller ones")
        if network.r_return_ohm:
            grounded = driven, rest, part, error_rest
            driven, rest, part, error_rest = _lift(network, found, scale, change, grounded)
            solve_error.current().take(bound=_bound(part, driven, error_rest))
    return driven, rest, part, error_rest


def _bound(part: Floats | float, driven: Floats, error: Floats | None = None) -> float:
    """Largest error of a slot, of its largest current."""
    if isinstance(part, float):
        return part
    size = np.abs(driven)
    off = solve_error.of(part, size) + (0.0 if error is None else error)
    return float(_ratio(off, size.max(axis=2, keepdims=True)).max())


def _lift(
    network: Network, response: _Response, scale: Floats, change: Floats, grounded: _Solution
) -> _Solution:
    """Add the currents of the shared return, which `grounded` holds at 0 V.

    In the slot of row r the other rows' drivers end at one node, at v ohm r_return to ground. By
    superposition it adds v times `seen`, the column currents a volt of that node: those of all
    other rows driven at 1 V. By reciprocity it is also the current that a column source of 1 V
    sends into the node. Every quantity is a sum of positive terms where driven and grounded rows
    have the same resistance.
    """
    driven, rest, part, error_rest = grounded
    # Floating rows have nodes of no conductance where no taxel is; here an open is one.
    g_ground = max(float(_conductance(network.r_row_grounded_ohm)), _CONDUCTANCE_MIN_S)
    node = np.maximum(response.node, g_ground)
    # Each row driven at 1 V with every row grounded, then row r's own driver.
    others = star_mesh.sum_of_others((g_ground / node)[:, :, np.newaxis] * response.delivered)
    to_rows = np.maximum(response.away - response.delivered.sum(axis=2), 0.0)
    own = (change * to_rows)[:, :, np.newaxis] * response.delivered
    sent, seen = to_rows / scale, np.maximum(others - own, 0.0)
    share = network.r_return_ohm / (1.0 + network.r_return_ohm * (seen.sum(axis=2) + sent))
    volt = (network.v_bias_v * share * sent)[:, :, np.newaxis]
    # Errors: of `sent`, a difference, and of `seen`; the factor counts the products and quotients of both.
    each = 8.0 * float(np.max(part)) + (2 * network.rows + 2 * network.cols + 32) * solve_error.U
    doubt = solve_error.of(each, others + np.abs(own))
    sent_v = (network.v_bias_v * share * solve_error.of(each, response.away / scale))[:, :, np.newaxis]
    error = solve_error.of(part, driven) + volt * doubt + sent_v * (seen + doubt)
    driven = driven + volt * seen
    if rest is not None and error_rest is not None:
        source = network.v_column_offset_v + network.r_column_ohm * network.i_leak_a
        lifted = share * (seen * source).sum(axis=2)
        size = share * ((seen + doubt) * np.abs(source)).sum(axis=2)
        rest = rest + lifted[:, :, np.newaxis] * seen
        error_rest = error_rest + size[:, :, np.newaxis] * (2.0 * doubt + solve_error.of(each, seen))
    relative = _ratio(error, driven)
    return driven, rest, np.where(np.isnan(relative), np.inf, relative), error_rest


def _rest(
    network: Network, g: Floats, response: _Response, change: Floats, part: Floats | float
) -> tuple[Floats, Floats]:
    """Currents that offsets and leaks drive and a bound of their error in ampere, [frames, rows, cols]
    or [frames, 1, cols].

    With all rows grounded each is a sum over pairs of sources of a conductance times a difference
    of voltages, which loses nothing but what cancels by nature. The driven row is a change at one
    node, and that may cancel on top: such slots are solved by themselves.
    """
    assert response.held is not None
    held, error_held = (of[:, np.newaxis] for of in response.held)
    offset, pushed = network.v_column_offset_v, network.r_column_ohm * network.i_leak_a
    if not change.any():
        return held, error_held
    delivered, record = response.delivered, solve_error.current()
    lifted = change[:, :, np.newaxis] * delivered
    rest = held - lifted * np.matmul(delivered, offset + pushed)[:, :, np.newaxis]
    size, lifted = (np.abs(offset) + np.abs(pushed))[:, np.newaxis], np.abs(lifted)
    doubt = np.matmul(solve_error.of(response.part, delivered), size) + part * np.matmul(delivered, size)
    error = solve_error.of(doubt, lifted) + error_held
    doubtful = ((lifted > 0) & ~(error <= record.tolerance_a(network.cols))).any(axis=2)
    record.take(slots_alone=int(doubtful.sum()))
    for row in np.flatnonzero(doubtful.any(axis=0)):
        frames = np.flatnonzero(doubtful[:, row])
        grounded = np.full(network.rows, _conductance(network.r_row_grounded_ohm))
        grounded[row] = _conductance(network.r_row_driven_ohm)
        alone = _respond(network, _row_lines(network, g[frames]), grounded).held
        assert alone is not None
        rest[frames, row], error[frames, row] = alone
    return rest, error


def _held_currents(
    network: Network,
    between: Floats,
    ground: Floats,
    own: Floats,
    between_part: Floats | float,
    ground_part: Floats | float,
    most: float,
) -> tuple[Floats, Floats]:
    """Column currents that offsets and leaks drive with every row on ground, and a bound of their
    error in ampere, [frames, cols] each.

    `between` [frames, cols, cols] are the conductances from source to source after elimination of all
    nodes, changed here to a diagonal of 0, `ground` [frames, cols] those to ground, `own` [frames, cols]
    the voltages of the columns' last nodes under their own source of 1 V. A source at 1 V: what it sends
    to others and to ground, through its own resistance, leaves the rest of 1 V; and what it sends to
    another is what that one would send to it.
    """
    offset, leak, at = network.v_column_offset_v, network.i_leak_a, np.arange(network.cols)
    between[:, at, at] = 0.0
    sent = between.sum(axis=1) + ground
    behind = network.r_trace_column_ohm + network.r_column_ohm
    _check(behind * sent + own, np.ones_like(own), "from the source of a column", most)
    _check(between, between.transpose(0, 2, 1), "from one column to another", most)
    # A leak enters in front of the last segment: what it sees there is that and the array behind it.
    own = own + network.r_trace_column_ohm * sent
    apart, pushed = offset - offset[:, np.newaxis], network.r_column_ohm * leak
    held = (between * (apart + pushed)).sum(axis=2) - ground * offset + own * leak
    # The differences and the sums of these few terms round as well.
    rounding = (2 * network.cols + 8) * solve_error.U
    with np.errstate(over="ignore", invalid="ignore"):
        error = solve_error.of(between_part + rounding, between * (np.abs(apart) + np.abs(pushed))).sum(
            axis=2
        )
        error += solve_error.of(ground_part + rounding, ground * np.abs(offset))
        error += solve_error.of(np.max(between_part) + rounding, own * np.abs(leak))
    return held, error


def _held(network: Network) -> bool:
    return bool(network.v_column_offset_v.any() or network.i_leak_a.any())


def _row_lines(network: Network, g: Floats) -> star_mesh.Lines:
    if not network.r_trace_row_ohm:
        return star_mesh.Lines(g, g, g, g, False)
    lines = star_mesh.Lines(g, *np.empty((3, *g.shape)), True)
    star_mesh.ladder(g, float(_conductance(network.r_trace_row_ohm)), *lines[1:4])
    return lines


def _respond(network: Network, lines: star_mesh.Lines, g_ground: Floats) -> _Response:
    """Return the response to all drives with rows on ground through `g_ground` [rows]."""
    return (_respond_chain if network.r_trace_column_ohm else _respond_columns)(network, lines, g_ground)


def _respond_columns(network: Network, lines: star_mesh.Lines, g_ground: Floats) -> _Response:
    """Every column line is one node."""
    rows, cols = network.rows, network.cols
    g, g_column = lines.to_driver, _conductance(network.r_column_ohm)

    # Star-mesh of every driver's node. link[c, d] joins two columns, leak[c] goes to ground.
    node = g.sum(axis=2) + g_ground
    share = _ratio(g, node[:, :, np.newaxis])
    link = np.matmul(share.transpose(0, 2, 1), g)
    if lines.bent:
        star_mesh.add_between(link, lines)
    if network.g_lateral_row_s:
        link += rows * network.g_lateral_row_s * (np.eye(cols, k=1) + np.eye(cols, k=-1))
    own = np.arange(cols)
    link[:, own, own] = 0.0
    leaks = g_ground[:, np.newaxis] * share
    leak = leaks.sum(axis=1)

    # One right-hand side a row; and, for offsets and leaks, one a column: its source at 1 V.
    drive, sources = g.transpose(0, 2, 1), cols if _held(network) else 0
    roundings = solve_error.elements(rows, cols, lines.bent)
    if network.r_column_ohm.any():
        if sources:
            drive = np.concatenate([drive, np.broadcast_to(np.diag(g_column), link.shape)], axis=2)
        roundings = solve_error.one_matrix(cols, roundings)
        v = _eliminate(link, leak + g_column, drive, solve_error.balance(roundings), sources)
        delivered = g_column[:, np.newaxis] * v
    else:
        v, delivered = np.zeros_like(drive), drive
        if sources:
            v = np.concatenate([v, np.broadcast_to(np.eye(cols), link.shape)], axis=2)
            delivered = np.concatenate([drive, link], axis=2)
    moved, delivered_rows = (of[:, :, :rows].transpose(0, 2, 1) for of in (v, delivered))
    away = delivered_rows.sum(axis=2)
    away += np.einsum("frc,frc->fr", star_mesh.sum_of_others(leaks), moved)
    lift = _ratio(np.einsum("frc,frc->fr", g, moved), node)
    part = solve_error.part(roundings, rows, cols)
    response = _Response(np.ascontiguousarray(delivered_rows), node, lift, away, roundings, part)
    if sources:
        between, across = delivered[:, :, rows:], v[:, :, rows:]
        ground = (leak[:, :, np.newaxis] * across).sum(axis=1)
        most, response.mesh = solve_error.balance(roundings), (between, ground)
        response.held = _held_currents(network, between, ground, across[:, own, own], part, part, most)
    return response


# A bound from counted roundings up to this, 5e-4 LSB, is good enough for any code, and so is an error of the currents
# of offsets and leaks of this many times what needs no slower solve, 1e-4 LSB. Beyond either the residuals of every
# drive at every node are worth their time.
_COUNTED_ENOUGH = 1e-6
_HELD_ENOUGH = 100


def _respond_chain(
    network: Network, lines: star_mesh.Lines, g_ground: Floats, every: bool = False
) -> _Response:
    """Every column line is a chain of one node a row: all drives walk down through the inverses of
    blocks of one row, and if `every`, or if that is needed, up again, for bounds from residuals.
    """
    if network.cols > star_mesh.COLUMNS:
        raise ValueError(
            f"with traces along the columns at most {star_mesh.COLUMNS} columns, not {network.cols}"
        )
    g_end = _conductance(network.r_trace_column_ohm + network.r_column_ohm)
    step = float(_conductance(network.r_trace_column_ohm)) + network.g_lateral_column_s
    rows, cols, sources = network.rows, network.cols, network.cols if _held(network) else 0
    roundings = solve_error.chain(rows, cols, solve_error.elements(rows, cols, lines.bent))
    # A lift is a sum of products of two currents each.
    part, most = solve_error.part(2 * roundings, rows, cols), solve_error.balance(roundings)
    # Two reasons to know what leaves through other rows than the own one: a return, and a slot that may cancel.
    unlike = network.r_row_driven_ohm - network.r_row_grounded_ohm
    every = (
        every or part > _COUNTED_ENOUGH or network.r_return_ohm > 0 or unlike > 0 or (sources > 0 > unlike)
    )
    found = star_mesh.chain(
        lines, g_ground, float(network.g_lateral_row_s), step, g_end, sources, every, _CURRENT_FLOOR_A / most
    )
    # |inverse| |matrix| 1 is at most twice the voltages under what each node would pass on at 1 V.
    solve_error.current().take(condition=float(2.0 * found.largest.max()))
    _accept(found.missed, "at a node", most)
    of_rows, of_sources = slice(star_mesh.ROWS, star_mesh.ROWS + rows), slice(star_mesh.ROWS + rows, None)
    last, to_ground = found.last, found.away[:, star_mesh.MEASURE, np.newaxis]
    response = _Response(
        g_end * last[:, of_rows], found.node, found.lift, found.away[:, of_rows].copy(), roundings, part
    )
    across, ground = last[:, of_sources].transpose(0, 2, 1), found.away[:, of_sources]
    between_part = ground_part = part
    if found.volt.size:
        # Residuals bound voltages: by what a drive misses, times what `largest` stands for.
        with np.errstate(over="ignore", invalid="ignore"):
            off = found.volt[:, :, np.newaxis] * last[:, np.newaxis, star_mesh.MEASURE]
            parts = np.fmin(_ratio(off, last), part)
            off = found.volt * to_ground
            ground_part = np.fmin(_ratio(off[:, of_sources], ground), part) if sources else part
            # An ideal driver divides by nothing that is in doubt, however much what leaves its row is.
            response.scale_error = solve_error.of(off[:, of_rows], np.float64(network.r_row_driven_ohm))
            response.scale_error += found.volt[:, of_rows] * found.largest[:, np.newaxis]
        response.part, between_part = parts[:, of_rows], parts[:, of_sources].transpose(0, 2, 1)
    if sources:
        between = g_end[:, np.newaxis] * across
        own, response.mesh = np.diagonal(across, axis1=1, axis2=2), (between, ground)
        response.held = _held_currents(network, between, ground, own, between_part, ground_part, most)
        if not every and (response.held[1] > _HELD_ENOUGH * solve_error.current().tolerance_a(cols)).any():
            return _respond_chain(network, lines, g_ground, every=True)
    return response


# Columns eliminated one by one before a product of matrices takes their effect to the rest. Up to 64 the steps
# alone are faster.
_PANEL = 64


def _eliminate(link: Floats, leak: Floats, drive: Floats, most: float, own: int = 0) -> Floats:
    """Solve (leak + sum of links) v - link v = drive for v, [frames, n, m], by star-mesh steps.

    Steps go in panels, so that the bulk is a product of matrices, still of sums only. The last
    `own` drives, n or none, go into one node each. A solution that misses Kirchhoff's law by more
    than `most` is refused.
    """
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
    _check_kirchhoff(link, leak, drive, v, most)
    return v


def _check_kirchhoff(link: Floats, leak: Floats, drive: Floats, v: Floats, most: float) -> None:
    """Check Kirchhoff's law at every node for all drives together, each at unit strength.

    Drives and voltages are 0 or above. Records 2 max(out / leak) as a bound of the condition: the
    inverse turns leaks into 1 V everywhere, so no row of |inverse| |matrix| sums to more.
    """
    weight = 1.0 / np.maximum(drive.sum(axis=1), _CURRENT_FLOOR_A)[:, :, np.newaxis]
    node_v = np.matmul(v, weight)
    out = leak + link.sum(axis=2)
    came = np.matmul(drive, weight) + np.matmul(link, node_v)
    _check(out[:, :, np.newaxis] * node_v, came, "at a node", most)
    with np.errstate(over="ignore", divide="ignore"):
        solve_error.current().take(condition=2.0 * float((out / leak).max()))


def _check(left: Floats, right: Floats, where: str, most: float) -> None:
    """Compare sums of currents or voltages that are 0 or above."""
    _accept(float(star_mesh.miss(left.ravel(), right.ravel(), _CURRENT_FLOOR_A / most)), where, most)


def _accept(worst: float, where: str, most: float) -> None:
    solve_error.current().take(residual=worst)
    if not worst <= most:
        raise SimulatorError(
            f"array solve: Kirchhoff's current law is missed by {worst:.1e} of the current {where}"
        )
