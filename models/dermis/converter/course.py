# SPDX-License-Identifier: Apache-2.0
"""Input charge of the converters clock by clock, if it changes inside a gate: ripple, motion, slow mirror.

Ripple and motion make a column current a sum of six functions of time with one coefficient each a cell; the
mean of such a function over a clock is known in closed form, so nothing is sampled. A plan without any of these
effects never comes here.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents_by_source
from dermis.converter import injection, ripple
from dermis.converter.coupling import couples, coupling
from dermis.converter.vfc import X_INFINITE, Y_MIN
from dermis.errors import InputError, SimulatorError
from dermis.ndarrays import Floats
from dermis.records import Drive, Plan

FIELDS = frozenset({"ripple", "motion", "q_mirror_c"})
"""Fields that make the charge of a clock change within a gate."""

# Cells of a row that `charges` takes at once.
WIDEST = 128
# Difference over sum of two outputs of the mirror up to which the logarithm of their ratio is a short series.
FAR = 0.03
# Up to here the series of 1 - exp(-t) with eight terms is exact.
_NEAR = 0.05
# Conductance of a short that changes to another value; as in dermis.array.array.
_G_SHORT_S = 1e40
# A driver that is not there; as in dermis.array.array.
_OPEN_OHM = 1e30
# Packets a clock by which a polynomial of the current over a frame may miss the points that the next one takes
# in. The next one is used, and such polynomials square their error when their points double: 1e-7, 5e-5 count
# in a gate.
_COURSE_MISS = 1e-4
# Digits that the current of a short has not.
_ROUNDING = 1e-12
# Integral over the first quarter, half and three quarters of a gate of a polynomial of fourth degree that is 0 at both
# ends and has given values at the first quarter, in the middle and at the third quarter.
_PARTS = np.array([[646, -264, 106], [992, 192, 32], [-106, 264, -646]]) / 2880.0


def currents(network: Network, g: Floats) -> Floats:
    """Return column currents of frames, the part proportional to the bias and that of offsets and leaks, [2, ...]."""
    follows, rest = column_currents_by_source(network, g)
    return np.stack([follows, np.zeros_like(follows) if rest is None else rest])


def solve_gate(
    plan: Plan, part: slice, idle: bool = False, frames: NDArray[np.intp] | slice = slice(None)
) -> Floats:
    """Solve some frames of a plan; with motion at the beginning, in the middle and at the end of each row's gate.

    `idle` asks for what the second part would be if no row were driven. With `frames`, numbers within `part`, only
    these are solved.

    Returns column currents in ampere, [2, instants, frames, rows, cols]: the part that goes with the bias and the rest,
    where a gate begins; with motion also where it ends; where that does not go straight also how far the parabola with
    the same integral over the gate is above the mean of both in the middle.

    InputError where the waveform of a ripple or of motion may move a code by more than 1 LSB.
    """
    network, g = plan.network(0), plan.conductance_s(part)[frames]
    if idle:
        network = dataclasses.replace(network, r_row_driven_ohm=min(network.r_row_grounded_ohm, _OPEN_OHM))
    if plan.drive.motion:
        found = _moving(plan, network, g, plan.next_conductance_s(part)[frames], not idle)
    else:
        found = currents(network, g)[:, np.newaxis]
    if plan.drive.ripple and not idle:
        ripple.check(plan, found)
    return found


def _moving(plan: Plan, network: Network, now: Floats, then: Floats, check: bool) -> Floats:
    """Return `solve_gate` of taxels that move from conductances `now` to `then`, [frames, rows, cols]."""
    at = plan.gate_shares()
    now, then = np.minimum(now, _G_SHORT_S), np.minimum(then, _G_SHORT_S)
    if not network.active_fields():
        follows = plan.v_bias_v * _between(now, then, at[:2].reshape(2, 1, plan.rows, 1))
        return np.stack([follows, np.zeros_like(follows)])
    unit_a = float((plan.converter.k * plan.converter.i0_a).min())
    points = _through_frame(network, now, then, at.ravel(), _COURSE_MISS * unit_a)
    begin, end, middle, early, late = points.swapaxes(0, 1)
    # Boole's rule; a parabola has two thirds of its bend for a mean.
    mean = (7.0 * (begin + end) + 32.0 * (early + late) + 12.0 * middle) / 90.0
    found = np.stack([begin, end, 1.5 * mean - 0.75 * (begin + end)], axis=1)
    if check:
        _check_bend(plan, points, found)
    return found


def _check_bend(plan: Plan, points: Floats, found: Floats) -> None:
    """Raise InputError where a parabola for the currents of a gate may move a code by more than 1 LSB.

    `points` [2, 5, ...] are the currents at the instants of `Plan.gate_shares`, `found` the parabolas as `solve_gate`
    returns them. Their integral is off by less than Boole's and Simpson's rule differ, two thirds of what they miss in
    the middle. Where charge is lost on the way (a packet in every other clock is not enough, a range, compression) or
    a count is not taken back (current below 0), what they miss until then counts as well.
    """
    c = plan.converter
    per_a, _, _, squeeze, *_ = _columns(plan, np.arange(plan.cols))
    (begin, end, bend), duty = found.sum(axis=0) * per_a, points.sum(axis=0) * per_a
    share = np.array([0.25, 0.5, 0.75]).reshape(3, 1, 1, 1)
    inside = duty[[3, 2, 4]] - _between(begin, end, share) - 4.0 * share * (1.0 - share) * bend
    low, high, size = duty.min(axis=0), duty.max(axis=0), np.abs(duty).max(axis=0)
    even = (low >= 0.0) & (high * (1.0 + plan.drive.ripple) <= 0.5 * (1.0 + c.packet_error))
    if c.range_clips() or squeeze is not None:
        even = np.zeros_like(even)
    lost = np.abs(np.tensordot(_PARTS, inside, 1)).max(axis=0)
    missed = np.maximum(np.abs(inside[1]) / 1.5, np.where(even, 0.0, lost)) - _ROUNDING * size
    least = np.abs(duty).min(axis=0)
    if squeeze is not None:
        least /= 1.0 + least * squeeze
    full = least >= ripple.FULL * (1.0 + np.abs(c.packet_error))
    counts = np.where(full, 0.0, missed * plan.timing.gate_clocks)
    if not (counts <= ripple.BENT).all():
        fields = plan.network(0).active_fields()
        beside = [name for name in plan.on if any(name in plan.effects_of_field(field) for field in fields)]
        raise plan.unsure("motion", beside, "a current that bends within a gate", ripple.BENT, counts.max())


def idle_currents(
    plan: Plan, part: slice, gate_currents: Floats, frames: NDArray[np.intp] | slice = slice(None)
) -> Floats:
    """Return what `gate_currents` of `part` would be if no row were driven, in some of its frames; 0 in others."""
    network, found = plan.network(0), np.zeros_like(gate_currents)
    same = network.r_row_driven_ohm == network.r_row_grounded_ohm
    alone = gate_currents[:, :, frames] if same else solve_gate(plan, part, idle=True, frames=frames)
    found[1][:, frames] = alone[1]
    return found


def _through_frame(network: Network, now: Floats, then: Floats, at: Floats, error_a: float) -> Floats:
    """Currents of each row at its own instants, [2, instants, frames, rows, cols], by a polynomial in time through
    as few solved networks as it takes.

    Row r alone is read at its instant, so solving whole frames for each row would cost rows times as much. The
    currents are smooth in time: a polynomial through 3, 5, 9 Chebyshev points is compared with the one before
    at its new points. What does not meet the error is solved row by row. Every frame has the polynomial that it
    would have alone: what runs beside it does not move a digit.
    """
    frames, rows = now.shape[:2]
    out = np.empty((2, at.size // rows, *now.shape))
    waiting = np.arange(frames)
    solved: dict[float, Floats] = {}

    def solve(share: float) -> Floats:
        if share not in solved:
            here, there = now[waiting], then[waiting]
            if share == 1.0 and 0.0 in solved and (here[1:] == there[:-1]).all():
                # A frame ends where the next one begins.
                last = currents(network, there[-1:])
                solved[share] = np.concatenate([solved[0.0][:, 1:], last], axis=1)
            else:
                solved[share] = currents(network, _between(here, there, share))
        return solved[share]

    for count in (3, 5, 9):
        coarse, finer = _instants(count), _instants(2 * count - 1)[1::2]
        weight = _polynomial(count, finer)
        miss = np.zeros(waiting.size)
        for k, p in enumerate(finer):
            guess = sum(w * np.add(*solve(q)) for w, q in zip(weight[k], coarse, strict=True))
            miss = np.maximum(miss, np.abs(guess - np.add(*solve(p))).max(axis=(1, 2)))
        met = miss <= error_a
        if met.any():
            fine = _instants(2 * count - 1)
            weight = _polynomial(2 * count - 1, at).reshape(-1, 1, rows, 1, fine.size)
            found = (weight[..., k] * solve(p)[:, np.newaxis, met] for k, p in enumerate(fine))
            out[:, :, waiting[met]] = sum(found)
        waiting = waiting[~met]
        if not waiting.size:
            return out
        solved = {share: found[:, ~met] for share, found in solved.items()}
    for k, share in enumerate(at):
        found = currents(network, _between(now[waiting], then[waiting], share))
        out[:, k // rows, waiting, k % rows] = found[:, :, k % rows]
    return out


def _between(now: Floats, then: Floats, share: float | Floats) -> Floats:
    """Interpolate conductances; at a share of 0 or 1 the other end does not enter, not even if infinite."""
    return (1.0 - share) * now + share * then


def _instants(count: int) -> Floats:
    """Chebyshev points of 0..1, both ends among them."""
    return np.round(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)), 15)


def _polynomial(count: int, where: Floats) -> Floats:
    """Weight of every one of `count` instants in the polynomial through them, [where, count]."""
    nodes = _instants(count)
    weight = np.ones((where.size, count))
    for k in range(count):
        others = np.delete(nodes, k)
        weight[:, k] = np.prod((where[:, None] - others) / (nodes[k] - others), axis=1)
    return weight


def _terms(drive: Drive, gate_currents: Floats, phase: Floats, limit_a: Floats, per_a: Floats) -> Floats:
    """Coefficients of `_basis` in packets a clock, [rows, terms, ...], of currents [2, instants, rows, ...]."""
    finite = np.clip(gate_currents, -limit_a, limit_a)
    begin, end, bend = finite[:, :1], finite[:, 1:2], finite[:, 2:]
    sine, cosine = drive.ripple * np.sin(phase), drive.ripple * np.cos(phase)
    terms = []
    for follows, rest in np.concatenate([begin, end - begin, 4.0 * bend], axis=1).swapaxes(0, 1):
        terms += [follows + rest, follows * sine, follows * cosine] if drive.ripple else [follows + rest]
    # The loops would be compiled again for another order in memory.
    return np.ascontiguousarray(np.stack(terms, axis=1) * per_a)


def phases(plan: Plan, part: slice) -> Floats:
    """Phase of the ripple where every slot begins, [frames, rows] in radian; 0 without one."""
    timing, drive = plan.timing, plan.drive
    if not drive.ripple:
        return np.zeros((part.stop - part.start, plan.rows))
    begins = range(0, plan.rows * timing.slot_clocks, timing.slot_clocks)
    frames = range(plan.first_frame + part.start, plan.first_frame + part.stop)
    turns = drive.turns_at(frames, begins, timing.f_clk_hz)
    return 2.0 * math.pi * turns + drive.phase_ripple_rad


class Basis(NamedTuple):
    """Functions of time: `mean` over every clock of a slot [clocks, terms], value where its row is driven (`begin`
    [terms]), `pause` clocks into the slot; the gate begins at `settle`.
    """

    mean: Floats
    begin: Floats
    pause: int
    settle: int


def _columns(plan: Plan, col: NDArray[np.intp]) -> tuple[Any, ...]:
    """Return for cells in these columns [n]: packets a clock for 1 A, largest current in ampere, offset current in
    packets a clock, and `squeeze`, `lag` and `most` of `charges`, [n] each.
    """
    c = plan.converter
    unit_a = c.k * c.i0_a
    squeeze = lag = None
    if c.inv_i_range_a.any() and c.gain.all():
        squeeze = (c.inv_i_range_a * np.abs(unit_a / c.gain))[col]
    if c.q_mirror_c.any():
        lag = np.maximum(c.q_mirror_c / (c.i0_a / plan.timing.f_clk_hz), 1e-15)[col]
    always = c.gain / unit_a, X_INFINITE * unit_a, c.i_offset_a / c.i0_a, c.saturating_duty()
    per_a, limit_a, offset, most = (values[col] for values in always)
    return per_a, limit_a, offset, squeeze, lag, most


def _blocks(
    basis: Basis,
    terms: Floats,
    idle: Floats | None,
    offset: Floats,
    columns: tuple[Floats | None, Floats | None, Floats],
    slow: Floats | None,
    first_row: int = 0,
    width: int = WIDEST,
) -> Iterator[tuple[int, slice, Floats, Floats]]:
    """(row, its cells, charge [clocks, cells], mean) by `charges`, row after row of every `width` cells; the arrays
    are used again. `columns` are `squeeze`, `lag` and `most`.
    """
    rows, _, cells = terms.shape
    squeeze, lag, most = columns
    scratch, mean = np.empty((len(basis.mean), min(width, cells))), np.empty(cells)
    for first in range(0, cells, width):
        block = slice(first, min(first + width, cells))
        out = scratch[:, : block.stop - first]
        if out.shape[1] != scratch.shape[1]:
            out = np.empty(out.shape)
        for row in range(first_row, rows):
            charge = charges(row, first, basis, terms, squeeze, lag, slow, idle, offset, most, out, mean)
            yield row, block, charge, mean[block]


def charges_of(
    plan: Plan,
    gate_currents: Floats,
    idle: Floats | None,
    phase: Floats,
    output: Floats | None,
    cells: tuple[NDArray[np.intp], ...],
    depth: NDArray[np.intp],
) -> Iterator[tuple[slice, Floats, Floats]]:
    """Charge a clock of chosen cells alone, as `Slots.blocks` gives it.

    Parameters
    ----------
    plan : without coupled columns
    gate_currents, idle : of `solve_gate` and `idle_currents`
        Of the frames that `cells` counts in; `idle` where a slow mirror sees a current while no row is driven.
    phase : [frames, rows] of the ripple
    output : [frames, rows, cols] output of slow mirrors at the end of each slot, or None
    cells : frame, row and column of each, [n]. Those that `depth` treats alike are fastest side by side.
    depth : [n] rows before its own that are walked as well, for the mirror

    Yields
    ------
    slice of `cells`, charge [clocks, cells], mean [cells]; the arrays are used again.
    """
    basis = _basis_of(plan, gate_currents)
    per_a, limit_a, offset, *columns = _columns(plan, cells[2])
    lag = columns[1]
    kinds = 2 * depth + ((depth == cells[1]) | (lag is None))  # begins with the frame, or remembers nothing
    edges = [0, *(np.flatnonzero(kinds[1:] != kinds[:-1]) + 1).tolist(), kinds.size]
    for begins, ends in itertools.pairwise(edges):
        deep, from_start = divmod(int(kinds[begins]), 2)
        f, row, c = (index[begins:ends] for index in cells)
        r = np.maximum(row + np.arange(-deep if from_start else -deep - 1, 1)[:, None], 0)
        waves = phase[f, r], limit_a[begins:ends], per_a[begins:ends]
        terms, resting = (
            None if currents is None else _terms(plan.drive, currents[:, :, f, r, c], *waves)
            for currents in (gate_currents, idle)
        )
        slow = None
        if lag is not None:
            slow = np.zeros(c.size) if from_start else output[f, r[0], c]
        own = tuple(None if of is None else of[begins:ends] for of in columns)
        offsets = np.full(r.shape, offset[begins:ends])
        blocks = _blocks(basis, terms, resting, offsets, own, slow, 1 - from_start)
        for k, block, charge, mean in blocks:
            if k == len(r) - 1:
                yield slice(begins + block.start, begins + block.stop), charge, mean


def has_idle_current(plan: Plan) -> bool:
    """Return True if a slow mirror has an input current while no row is driven."""
    active = plan.active_fields()
    sources = active & {"v_column_offset_v", "i_leak_a"}
    return bool(plan.timing.break_clocks and "q_mirror_c" in active and sources)


def refuses(plan: Plan) -> InputError | None:
    """Return the error of `injection.check_lines`, or of `coupling` or `solve_gate` for the frames with the most
    conductance and the most change, or None.
    """
    try:
        injection.check_lines(plan)
        if couples(plan):
            coupling(plan, _one(plan.fullest_frame()))
        if plan.drive.motion and plan.network(0).active_fields():
            solve_gate(plan, _one(plan.most_changing_frame()))
        if ripple.may_bend(plan):
            solve_gate(plan, _one(plan.fullest_frame()))
    except InputError as error:
        return error
    return None


def _one(frame: int) -> slice:
    return slice(frame, frame + 1)


class Slots:
    """Charge a clock of every cell of some frames, row after row.

    Parameters
    ----------
    part : frames

    Attributes
    ----------
    basis : Basis
    terms : ndarray
        Their coefficients in packets a clock, [rows, terms, frames * cols], in front of compression, slow mirror
        and offset current.
    idle : such coefficients while no row is driven, where that matters and is not nothing, or None
    offset : added behind compression and mirror, packets a clock, [rows, frames * cols]
    """

    def __init__(self, plan: Plan, part: slice) -> None:
        drive, gate_currents = plan.drive, solve_gate(plan, part)
        self.frames, self.rows, self.cols = gate_currents.shape[2:]
        self.basis = _basis_of(plan, gate_currents)
        phase, each = phases(plan, part).T[:, :, np.newaxis], (self.frames, self.cols)
        columns = np.tile(np.arange(self.cols), self.frames)
        per_a, limit_a, offset, *self._columns = _columns(plan, columns)

        def terms_of(currents: Floats) -> Floats:
            by_row = currents.swapaxes(2, 3)
            terms = _terms(drive, by_row, phase, limit_a.reshape(each), per_a.reshape(each))
            return terms.reshape(self.rows, -1, columns.size)

        self.terms, self.offset = terms_of(gate_currents), np.tile(offset, (self.rows, 1))
        self.idle = None
        if has_idle_current(plan):
            self.idle = terms_of(idle_currents(plan, part, gate_currents))

    def blocks(self) -> Iterator[tuple[slice, Floats, Floats]]:
        """(cells, charge [clocks, cells], mean [cells]), cells counted row after row; the arrays are used again."""
        cells = self.frames * self.cols
        slow = None if self._columns[1] is None else np.zeros(cells)
        # Columns that are coupled are walked together.
        width = WIDEST // self.cols * self.cols or WIDEST
        given = self.basis, self.terms, self.idle, self.offset, self._columns, slow
        for row, block, charge, mean in _blocks(*given, width=width):
            # `charges` divides by currents and clips: a clip keeps NaN, so the mean shows every NaN.
            if not np.isfinite(mean).all():
                raise SimulatorError(f"the input charge of row {row} is not a finite number")
            yield slice(row * cells + block.start, row * cells + block.stop), charge, mean


def _basis_of(plan: Plan, gate_currents: Floats) -> Basis:
    timing, drive = plan.timing, plan.drive
    omega = 2.0 * math.pi * drive.f_ripple_hz / timing.f_clk_hz if drive.ripple else 0.0
    clocks = timing.break_clocks, timing.settle_clocks, timing.gate_clocks
    return _basis(*clocks, omega, bool(drive.ripple), gate_currents.shape[1])


@functools.lru_cache(maxsize=8)
def _basis(pause: int, settle: int, gate: int, omega: float, ripple: bool, instants: int) -> Basis:
    """Return the functions of time of a slot.

    1, cos, sin, t, t cos, t sin, b, b cos, b sin, as far as they are on, b = t (1 - t); omega in radian a
    clock, t runs from 0 to 1 over the gate.
    """
    middle = np.arange(settle + gate) + 0.5
    ramp, ramp_begin = (middle - settle) / gate, (pause - settle) / gate
    half = 0.5 * omega
    mean = math.sin(half) / half if half else 1.0  # of a cosine over one clock, relative to its middle
    # integral of u sin(omega u) over -1/2..1/2, small omega without the difference of two near equals
    tilt = 2.0 * (math.sin(half) - half * math.cos(half)) / omega**2 if omega > 1e-3 else omega / 12.0
    cosine, sine = np.cos(omega * middle), np.sin(omega * middle)
    # Mean over a clock, slope there, value where the row is driven.
    # t = m + u: b is m (1 - m) + (1 - 2 m) u - u^2, and u^2 has a mean of 1 / 12 over a clock
    bend = ramp * (1.0 - ramp) - 1.0 / (12.0 * gate**2)
    shapes = [
        (np.ones_like(middle), 0.0, 1.0),
        (ramp, 1.0 / gate, ramp_begin),
        (bend, (1.0 - 2.0 * ramp) / gate, ramp_begin * (1.0 - ramp_begin)),
    ]
    terms, begin = [], []
    for level, slope, at_begin in shapes[:instants]:
        terms.append(level)
        begin.append(at_begin)
        if ripple:
            terms += [
                level * cosine * mean - slope * sine * tilt,
                level * sine * mean + slope * cosine * tilt,
            ]
            begin += [at_begin * math.cos(omega * pause), at_begin * math.sin(omega * pause)]
    found = Basis(np.stack(terms, axis=1), np.array(begin), pause, settle)
    for values in found[:2]:
        values.flags.writeable = False
    return found


# A loop over cells with a call in it becomes no vector instructions.
_formula = numba.njit(cache=True, error_model="numpy", fastmath={"contract"}, forceinline=True)


@_formula
def _exp_of_minus(t):  # type: ignore
    """exp(-t) for t >= 0 to some 1e-13 relative, 0 beyond 64: a polynomial and ten squarings make vector code."""
    u = (t if t < 64.0 else 64.0) * (-1.0 / 1024.0)
    p = 1.0 + u * (
        1.0 + u * (1 / 2 + u * (1 / 6 + u * (1 / 24 + u * (1 / 120 + u * (1 / 720 + u * (1 / 5040))))))
    )
    for _ in range(10):
        p *= p
    return p


@_formula
def approach(x, y, t):  # type: ignore
    """y + (x - y) exp(-t) for x, y and t >= 0, every digit of it where y is far below x and where x is far below y."""
    u = t if t < _NEAR else _NEAR
    lost = u * (
        1.0
        - u
        * (
            1 / 2
            - u * (1 / 6 - u * (1 / 24 - u * (1 / 120 - u * (1 / 720 - u * (1 / 5040 - u * (1 / 40320))))))
        )
    )
    kept = _exp_of_minus(t)
    lost = lost if t < _NEAR else 1.0 - kept
    kept = 1.0 - lost if t < _NEAR else kept
    return y * lost + x * kept


@_formula
def log_of(s):  # type: ignore
    """ln((1 + s) / (1 - s)) for s within FAR: the next term is below 1e-19."""
    s2 = s * s
    return 2.0 * s * (1 + s2 * (1 / 3 + s2 * (1 / 5 + s2 * (1 / 7 + s2 * (1 / 9 + s2 * (1 / 11))))))


# Places of the working array of `charges`, WIDEST cells each: input of the clock, what is added, the sum over the gate,
# most; compression; of slow mirrors the output, time constant and its inverse, and of a clock in the gate the
# difference over the sum of input and the mean output of 1 / u, these two themselves.
(ROW, ADDED, SUM, LIMIT, HARD, OUTPUT, INERT, SWIFT, RATIO, ASKED, MET, PLACES) = range(
    0, 12 * WIDEST, WIDEST
)

# A part of `charges`; numba puts it in before it looks at types, so that what is None falls away there as well.
_part = numba.njit(inline="always", error_model="numpy")


@_part
def _compressed(x, own, c, squeeze):  # type: ignore
    if squeeze is not None:
        x = x / (1.0 + abs(x) * own[HARD + c])
    return x


@_part
def _asked(x, own, c):  # type: ignore
    """Input of a slow mirror: not below its leakage, nor above what drowns any packet."""
    limit = own[LIMIT + c]
    x = Y_MIN if x < Y_MIN else x
    x = limit if x > limit else x
    return x


@_part
def _follow(x, own, c):  # type: ignore
    """Let the output of a slow mirror follow input x for a clock."""
    x = _asked(x, own, c)
    y = own[OUTPUT + c]
    own[OUTPUT + c] = x * y / approach(x, y, x * own[SWIFT + c])


@_part
def _begin_mirrors(own, cells, row, first, basis, factors, squeeze, lag, slow, idle):  # type: ignore
    """Load slow mirrors: settled where a frame begins, else as the row before left them, with the pause behind it."""
    times, begin = basis.mean, basis.begin
    for c in range(cells):
        own[INERT + c], own[SWIFT + c] = lag[first + c], 1.0 / lag[first + c]
        own[OUTPUT + c] = slow[first + c]
        if row == 0:
            x = 0.0
            for k in range(begin.size):
                x += begin[k] * factors[k, c]
            own[OUTPUT + c] = _asked(_compressed(x, own, c, squeeze), own, c)
    if row > 0:
        for n in range(basis.pause):
            for c in range(cells):
                x = 0.0
                if idle is not None:
                    for k in range(begin.size):
                        x += times[n, k] * idle[row, k, first + c]
                _follow(_compressed(x, own, c, squeeze), own, c)


@_part
def _input(own, cells, weights, factors, squeeze):  # type: ignore
    """Sum the functions of time of a clock, and compress."""
    factor, of = weights[0], factors[0]
    for c in range(cells):
        own[ROW + c] = factor * of[c]
    for k in range(1, weights.size):
        factor, of = weights[k], factors[k]
        for c in range(cells):
            own[ROW + c] += factor * of[c]
    if squeeze is not None:
        for c in range(cells):
            own[ROW + c] = _compressed(own[ROW + c], own, c, squeeze)


@_part
def _through_mirrors(own, cells):  # type: ignore
    """Replace the input of a clock in the gate by the charge that slow mirrors pass on.

    dy/dn = y (x - y) / lag: 1/y is an exponential, and the charge is the integral of x less lag times the growth of
    ln y, which is ln(x / below).
    """
    far = 0.0
    for c in range(cells):
        x, y = _asked(own[ROW + c], own, c), own[OUTPUT + c]
        below = approach(x, y, x * own[SWIFT + c])
        both = 1.0 / (below * (x + below))
        own[OUTPUT + c] = x * y * (x + below) * both
        apart = (below - x) * below * both
        own[ROW + c] = x + own[INERT + c] * log_of(apart)
        own[RATIO + c], own[ASKED + c], own[MET + c] = apart, x, below
    for c in range(cells):
        far = far if abs(own[RATIO + c]) < FAR else 1.0
    if far > 0.0:
        for c in range(cells):
            if abs(own[RATIO + c]) >= FAR:
                # Of the two themselves: far apart their difference over their sum has no digit beside 1.
                own[ROW + c] = own[ASKED + c] + own[INERT + c] * math.log(own[MET + c] / own[ASKED + c])


# A product may go into its sum unrounded: the terms of the exponential and of the logarithm are half the time.
@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def charges(  # type: ignore
    row, first, basis, terms, squeeze, lag, slow, idle, offset, most, out, mean
):
    """Charge a clock of the cells first .. first + out.shape[1] of a row; returns the part of `out` that is the gate.

    Parameters
    ----------
    basis : the first row of a frame is settled where it is driven
    terms : [rows, terms, cells], coefficients of its functions, packets a clock
    squeeze : [cells] or None, compression: x becomes x / (1 + |x| squeeze)
    lag, slow : [cells] or None
        Time constant times output of the mirror in packets, and its output, which is carried on.
    idle : [rows, terms, cells] or None, coefficients in the pause, where no row is driven; None is no current
    offset : [rows, cells], added behind the mirror
    most : [cells], duty that drowns any packet: more, in front of the mirror and behind it, is that
    out, mean : [clocks of the slot, cells], [cells], results
    """
    clocks, count = basis.mean.shape
    # With its limit in sight the compiler knows that no place below wraps around.
    cells, settle = min(out.shape[1], WIDEST), basis.settle
    # One array for what the loops over cells touch, so that they become vector instructions (see walk_loops.walk).
    own, factors = np.zeros(PLACES), np.empty((count, WIDEST))
    for k in range(count):
        for c in range(cells):
            factors[k, c] = terms[row, k, first + c]
    for c in range(cells):
        own[ADDED + c], own[LIMIT + c] = offset[row, first + c], most[first + c]
        if squeeze is not None:
            own[HARD + c] = squeeze[first + c]
    start = settle
    if lag is not None:
        start = basis.pause
        _begin_mirrors(own, cells, row, first, basis, factors, squeeze, lag, slow, idle)
    for n in range(start, clocks):
        _input(own, cells, basis.mean[n], factors, squeeze)
        if lag is not None:
            if n < settle:
                for c in range(cells):
                    _follow(own[ROW + c], own, c)
            else:
                _through_mirrors(own, cells)
        if n >= settle:
            into = out[n]
            for c in range(cells):
                x = own[ROW + c] + own[ADDED + c]
                x = own[LIMIT + c] if x > own[LIMIT + c] else x
                x = -own[LIMIT + c] if x < -own[LIMIT + c] else x
                own[SUM + c] += x
                own[ROW + c] = x
            for c in range(cells):
                into[c] = own[ROW + c]
    for c in range(cells):
        mean[first + c] = own[SUM + c] / (clocks - settle)
        if lag is not None:
            slow[first + c] = own[OUTPUT + c]
    return out[settle:]
