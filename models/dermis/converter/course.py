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
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents_by_source
from dermis.converter import injection, ripple
from dermis.converter.coupling import Coupling, DutyRange, couples, coupling
from dermis.converter.ripple import GateCurrents
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


def currents(network: Network, g: Floats) -> tuple[Floats, Floats]:
    """Return column currents of frames as (part proportional to the bias, part of offsets and leaks)."""
    follows, rest = column_currents_by_source(network, g)
    return follows, np.zeros_like(follows) if rest is None else rest


def solve_gate(
    plan: Plan, part: slice, idle: bool = False, frames: NDArray[np.intp] | None = None
) -> GateCurrents:
    """Solve some frames of a plan; with motion at the beginning, in the middle and at the end of each row's gate.

    `idle` asks for what `rest` would be if no row were driven. With `frames`, numbers within `part`, only these are
    solved.
    """
    network, g = plan.network(0), plan.conductance_s(part)
    if frames is not None:
        g = g[frames]
    if idle:
        network = dataclasses.replace(network, r_row_driven_ohm=min(network.r_row_grounded_ohm, _OPEN_OHM))
    if not plan.drive.motion:
        follows, rest = currents(network, g)
        return GateCurrents(follows, follows, rest, rest)
    timing = plan.timing
    slot = np.arange(plan.rows) * timing.slot_clocks + timing.settle_clocks
    at = np.concatenate([slot, slot + timing.gate_clocks, slot + timing.gate_clocks / 2])
    clocks = plan.drive.t_frame_s * timing.f_clk_hz
    # The last gate may end with the frame: a rounding of its length there would leave a part of a short over, or less
    # than nothing. A recording may be faster than the chip: then the next frame is reached before the gate is over.
    if abs(clocks - round(clocks)) <= 1e-9 * clocks:
        clocks = float(round(clocks))
    at = np.minimum(at / clocks, 1.0)
    later = plan.next_conductance_s(part)
    now, then = np.minimum(g, _G_SHORT_S), np.minimum(later if frames is None else later[frames], _G_SHORT_S)
    if not network.active_fields():
        share = at.reshape(3, 1, plan.rows, 1)
        follows = plan.v_bias_v * _between(now, then, share)
        return GateCurrents(follows[0], follows[1], np.zeros_like(now), np.zeros_like(now))
    unit_a = float((plan.converter.k * plan.converter.i0_a).min())
    follows, rest = _through_frame(network, now, then, at, _COURSE_MISS * unit_a)
    bends = (part[2] - 0.5 * (part[0] + part[1]) for part in (follows, rest))
    return GateCurrents(follows[0], follows[1], rest[0], rest[1], *bends)


def _through_frame(
    network: Network, now: Floats, then: Floats, at: Floats, error_a: float
) -> tuple[Floats, Floats]:
    """Currents of each row at its own instants, [instants, frames, rows, cols], by a polynomial in time through
    as few solved networks as it takes.

    Row r alone is read at its instant, so solving whole frames for each row would cost rows times as much. The
    currents are smooth in time: a polynomial through 3, 5, 9 Chebyshev points is compared with the one before
    at its new points. What does not meet the error is solved row by row. Every frame has the polynomial that it
    would have alone: what runs beside it does not move a digit.
    """
    frames, rows = now.shape[:2]
    out = np.empty((2, at.size // rows, *now.shape))
    waiting = np.arange(frames)
    solved: dict[float, tuple[Floats, Floats]] = {}

    def solve(share: float) -> tuple[Floats, Floats]:
        if share not in solved:
            here, there = now[waiting], then[waiting]
            if share == 1.0 and 0.0 in solved and (here[1:] == there[:-1]).all():
                # A frame ends where the next one begins.
                last = currents(network, there[-1:])
                both = zip(solved[0.0], last, strict=True)
                solved[share] = tuple(np.concatenate([begin[1:], end]) for begin, end in both)
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
            for part in range(2):
                out[part][:, waiting[met]] = sum(
                    weight[..., k] * solve(p)[part][met] for k, p in enumerate(fine)
                )
        waiting = waiting[~met]
        if not waiting.size:
            return out[0], out[1]
        solved = {share: (follows[~met], rest[~met]) for share, (follows, rest) in solved.items()}
    for k, share in enumerate(at):
        found = currents(network, _between(now[waiting], then[waiting], share))
        for into, values in zip(out, found, strict=True):
            into[k // rows, waiting, k % rows] = values[:, k % rows]
    return out[0], out[1]


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


def _terms(
    drive: Drive, gate_currents: GateCurrents, sine: Floats, cosine: Floats, limit_a: Floats
) -> list[Floats]:
    """Coefficients of `_basis` in ampere, each shaped as the currents."""

    def finite(current: Floats) -> Floats:
        return np.minimum(np.maximum(current, -limit_a), limit_a)

    with np.errstate(over="ignore"):
        follows = finite(gate_currents.follows_begin)
        terms = [follows + finite(gate_currents.rest_begin)]
        if drive.ripple:
            terms += [follows * sine, follows * cosine]
        if drive.motion:
            moves = finite(gate_currents.follows_end) - follows
            terms += [moves + finite(gate_currents.rest_end) - finite(gate_currents.rest_begin)]
            if drive.ripple:
                terms += [moves * sine, moves * cosine]
        if gate_currents.follows_bend is not None:
            bend = 4.0 * finite(gate_currents.follows_bend)
            terms += [bend + 4.0 * finite(gate_currents.rest_bend)]
            if drive.ripple:
                terms += [bend * sine, bend * cosine]
    return terms


def _idle_terms(found: GateCurrents, drive: Drive, limit_a: Floats, count: int) -> list[Floats]:
    """Coefficients of `_basis` while no row is driven."""
    each = 3 if drive.ripple else 1
    idle = [np.zeros(found.rest_begin.shape) for _ in range(count)]
    idle[0] = np.clip(found.rest_begin, -limit_a, limit_a)
    if drive.motion:
        idle[each] = np.clip(found.rest_end, -limit_a, limit_a) - idle[0]
    if found.rest_bend is not None:
        idle[2 * each] = 4.0 * np.clip(found.rest_bend, -limit_a, limit_a)
    return idle


def _at(gate_currents: GateCurrents, *cells: NDArray[np.intp]) -> GateCurrents:
    """The currents of chosen cells."""
    parts = (getattr(gate_currents, part.name) for part in dataclasses.fields(GateCurrents))
    return GateCurrents(*(None if part is None else part[cells] for part in parts))


def phases(plan: Plan, part: slice) -> Floats:
    """Phase of the ripple where every slot begins, [frames, rows] in radian."""
    timing, drive = plan.timing, plan.drive
    begins = range(0, plan.rows * timing.slot_clocks, timing.slot_clocks)
    frames = range(plan.first_frame + part.start, plan.first_frame + part.stop)
    turns = drive.turns_at(frames, begins, timing.f_clk_hz)
    return 2.0 * math.pi * turns + drive.phase_ripple_rad


def _columns(plan: Plan) -> tuple[Floats, Floats, Floats | None, Floats | None]:
    """Packets a clock for 1 A, largest current, `squeeze` and `lag` of `charges`, [cols] each."""
    c = plan.converter
    unit_a = c.k * c.i0_a
    squeeze = lag = None
    if c.inv_i_range_a.any() and c.gain.all():
        squeeze = c.inv_i_range_a * np.abs(unit_a / c.gain)
    if c.q_mirror_c.any():
        lag = np.maximum(c.q_mirror_c / (c.i0_a / plan.timing.f_clk_hz), 1e-15)
    return c.gain / unit_a, X_INFINITE * unit_a, squeeze, lag


def charges_of(
    plan: Plan,
    gate_currents: GateCurrents,
    idle: GateCurrents | None,
    phase: Floats,
    output: Floats | None,
    cells: tuple[NDArray[np.intp], ...],
    depth: NDArray[np.intp],
) -> Iterator[tuple[slice, Floats, Floats]]:
    """Charge a clock of chosen cells alone, as `Slots.blocks` gives it.

    Parameters
    ----------
    plan : without coupled columns
    gate_currents, idle : GateCurrents
        Of the frames that `cells` counts in; `idle` where a slow mirror sees a current while no row is driven.
    phase : [frames, rows] of the ripple
    output : [frames, rows, cols] output of slow mirrors at the end of each slot, or None
    cells : frame, row and column of each, [n]. Those that `depth` treats alike are fastest side by side.
    depth : [n] rows before its own that are walked as well, for the mirror

    Yields
    ------
    slice of `cells`, charge [clocks, cells], mean [cells]; the arrays are used again.
    """
    converter, drive = plan.converter, plan.drive
    basis = _basis_of(plan, gate_currents)
    per_a, limit_a, squeeze, lag = _columns(plan)
    scratch = np.empty((len(basis.mean), WIDEST))
    offset, most = converter.i_offset_a / converter.i0_a, converter.saturating_duty()
    kinds = 2 * depth + ((depth == cells[1]) | (lag is None))  # begins with the frame, or remembers nothing
    edges = [0, *(np.flatnonzero(kinds[1:] != kinds[:-1]) + 1).tolist(), kinds.size]
    for begins, ends in itertools.pairwise(edges):
        deep, from_start = divmod(int(kinds[begins]), 2)
        f, row, c = (index[begins:ends] for index in cells)
        r = np.maximum(row + np.arange(-deep if from_start else -deep - 1, 1)[:, None], 0)
        sine, cosine = drive.ripple * np.sin(phase[f, r]), drive.ripple * np.cos(phase[f, r])
        parts = _terms(drive, _at(gate_currents, f, r, c), sine, cosine, limit_a[c])
        terms = np.empty((r.shape[0], len(parts), c.size))
        for k, part in enumerate(parts):
            terms[:, k] = part * per_a[c]
        resting = slow = None
        if idle is not None:
            parts = _idle_terms(_at(idle, f, r, c), drive, limit_a[c], terms.shape[1])
            resting = np.stack(parts, axis=1) * per_a[c]
        if lag is not None:
            slow = np.zeros(c.size) if from_start else output[f, r[0], c]
        offsets, mean = np.full(r.shape, offset[c]), np.empty(c.size)
        for at in range(0, c.size, WIDEST):
            out = scratch[:, : c.size - at]
            if out.shape[1] != WIDEST:
                out = np.empty(out.shape)
            for k in range(0 if from_start else 1, r.shape[0]):
                charge = charges(
                    k, at, basis, terms, None if squeeze is None else squeeze[c], None if lag is None else lag[c],
                    slow, resting, offsets, most[c], out, mean,
                )  # fmt: skip
            block = slice(begins + at, begins + at + out.shape[1])
            yield block, charge, mean[at : at + out.shape[1]]


def has_idle_current(plan: Plan) -> bool:
    """Return True if a slow mirror has an input current while no row is driven."""
    active = plan.active_fields()
    sources = active & {"v_column_offset_v", "i_leak_a"}
    return bool(plan.timing.break_clocks and "q_mirror_c" in active and sources)


def refuses(plan: Plan) -> InputError | None:
    """Return the error of `injection.check_lines`, or of `Slots` for the frame with the most conductance, or None."""
    try:
        injection.check_lines(plan)
        if couples(plan) or ripple.may_bend(plan):
            first = plan.fullest_frame()
            Slots(plan, slice(first, first + 1))
    except InputError as error:
        return error
    return None


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
    coupling : of the columns of the direct interface, or None
    mean : charge a clock, mean over the gate, [frames, rows, cols] in packets; complete behind the last row
    """

    def __init__(self, plan: Plan, part: slice) -> None:
        converter, drive = plan.converter, plan.drive
        gate_currents = solve_gate(plan, part)
        if drive.ripple:
            ripple.check(plan, gate_currents)
        self.frames, self.rows, self.cols = gate_currents.follows_begin.shape
        self.coupling: Coupling | None = None
        cells = self.frames * self.cols
        self.basis = _basis_of(plan, gate_currents)
        phase = phases(plan, part) if drive.ripple else np.zeros((self.frames, self.rows))
        sine, cosine = drive.ripple * np.sin(phase)[:, :, None], drive.ripple * np.cos(phase)[:, :, None]

        per_a, limit_a, squeeze, lag = _columns(plan)
        terms = _terms(drive, gate_currents, sine, cosine, limit_a)
        # [rows, terms, frames and cols]
        self.terms = np.ascontiguousarray(
            np.stack([t * per_a for t in terms]).transpose(2, 0, 1, 3).reshape(self.rows, len(terms), cells)
        )
        self.offset = np.tile(converter.i_offset_a / converter.i0_a, (self.rows, self.frames))
        if couples(plan):
            behind = plan.next_conductance_s(part) if drive.motion else None
            mean, duty_range = self._duty_range(behind)
            self.coupling = coupling(plan, plan.conductance_s(part), mean, duty_range)
            if self.coupling is not None:
                self.offset = self.offset + self.coupling.x.transpose(1, 0, 2).reshape(self.rows, -1)
        self._most = np.tile(converter.saturating_duty(), self.frames)
        self._squeeze = None if squeeze is None else np.tile(squeeze, self.frames)
        self._lag = self._slow = None
        if lag is not None:
            self._lag, self._slow = np.tile(lag, self.frames), np.zeros(cells)
        self.idle = None
        if has_idle_current(plan):
            network = plan.network(0)
            same = network.r_row_driven_ohm == network.r_row_grounded_ohm
            self.idle = self._idle(
                gate_currents if same else solve_gate(plan, part, idle=True), drive, per_a, limit_a
            )
        self.mean = np.empty((self.frames, self.rows, self.cols))

    def _duty_range(self, g_behind: Floats | None) -> tuple[Floats, DutyRange]:
        """Return the mean duties over the gate, [frames, rows, cols], and their range, before compression."""
        gate = self.basis.mean[self.basis.settle :]
        ends = [self.terms * pick(gate, axis=0)[:, np.newaxis] for pick in (np.min, np.max)]
        means = self.terms * gate.mean(axis=0)[:, np.newaxis]

        def duty(parts: Floats) -> Floats:
            cells = parts.sum(axis=1) + self.offset
            return cells.reshape(self.rows, self.frames, self.cols).transpose(1, 0, 2)

        return duty(means), DutyRange(duty(np.minimum(*ends)), duty(np.maximum(*ends)), g_behind)

    def _idle(self, found: GateCurrents, drive: Drive, per_a: Floats, limit_a: Floats) -> Floats:
        idle = np.stack(_idle_terms(found, drive, limit_a, self.terms.shape[1]))
        cells = self.frames * self.cols
        return np.ascontiguousarray((idle * per_a).transpose(2, 0, 1, 3).reshape(self.rows, -1, cells))

    def blocks(self, size: int) -> Iterator[tuple[int, slice, Floats, Floats]]:
        """(row, its cells, charge [clocks, cells], mean) in the order of time; the array is used again."""
        cells = self.frames * self.cols
        scratch = np.empty((len(self.basis.mean), min(size, cells)))
        mean = np.empty(cells)
        for row in range(self.rows):
            for first in range(0, cells, size):
                block = slice(first, min(first + size, cells))
                out = scratch[:, : block.stop - first]
                if out.shape[1] != scratch.shape[1]:
                    out = np.empty(out.shape)
                charge = charges(
                    row, block.start, self.basis, self.terms, self._squeeze, self._lag, self._slow, self.idle,
                    self.offset, self._most, out, mean,
                )  # fmt: skip
                # `charges` divides by currents and clips: a clip keeps NaN, so the mean shows every NaN.
                if not np.isfinite(mean[block]).all():
                    raise SimulatorError(f"the input charge of row {row} is not a finite number")
                yield row, block, charge, mean[block]
            self.mean[:, row] = mean.reshape(self.frames, self.cols)


class Basis(NamedTuple):
    """Functions of time: `mean` over every clock of a slot [clocks, terms], value where its row is driven (`begin`
    [terms]), `pause` clocks into the slot; the gate begins at `settle`.
    """

    mean: Floats
    begin: Floats
    pause: int
    settle: int


def _basis_of(plan: Plan, gate_currents: GateCurrents) -> Basis:
    timing, drive = plan.timing, plan.drive
    omega = 2.0 * math.pi * drive.f_ripple_hz / timing.f_clk_hz if drive.ripple else 0.0
    clocks = timing.break_clocks, timing.settle_clocks, timing.gate_clocks
    return _basis(*clocks, omega, bool(drive.ripple), drive.motion, gate_currents.follows_bend is not None)


@functools.lru_cache(maxsize=8)
def _basis(
    pause: int, settle: int, gate: int, omega: float, ripple: bool, motion: bool, bends: bool
) -> Basis:
    """Return the functions of time of a slot.

    1, cos, sin, t, t cos, t sin, b, b cos, b sin, as far as they are on, b = t (1 - t); omega in radian a
    clock, t runs from 0 to 1 over the gate.
    """
    middle = np.arange(settle + gate) + 0.5
    ramp, ramp_begin = (middle - settle) / gate, (pause - settle) / gate
    cosine_begin, sine_begin = math.cos(omega * pause), math.sin(omega * pause)
    half = 0.5 * omega
    mean = math.sin(half) / half if half else 1.0  # of a cosine over one clock, relative to its middle
    # integral of u sin(omega u) over -1/2..1/2, small omega without the difference of two near equals
    tilt = 2.0 * (math.sin(half) - half * math.cos(half)) / omega**2 if omega > 1e-3 else omega / 12.0
    cosine, sine = np.cos(omega * middle), np.sin(omega * middle)
    terms, begin = [np.ones_like(middle)], [1.0]
    if ripple:
        terms, begin = [*terms, cosine * mean, sine * mean], [*begin, cosine_begin, sine_begin]
    if motion:
        terms, begin = [*terms, ramp], [*begin, ramp_begin]
        if ripple:
            terms += [ramp * cosine * mean - sine * tilt / gate, ramp * sine * mean + cosine * tilt / gate]
            begin += [ramp_begin * cosine_begin, ramp_begin * sine_begin]
    if bends:
        # t = m + u: b is m (1 - m) + (1 - 2 m) u - u^2, and u^2 has a mean of 1 / 12 over a clock
        middle_bend, tilted, own = ramp * (1.0 - ramp), (1.0 - 2.0 * ramp) / gate, 1.0 / (12.0 * gate**2)
        bend_begin = ramp_begin * (1.0 - ramp_begin)
        terms, begin = [*terms, middle_bend - own], [*begin, bend_begin]
        if ripple:
            terms += [
                (middle_bend - own) * cosine * mean - tilted * sine * tilt,
                (middle_bend - own) * sine * mean + tilted * cosine * tilt,
            ]
            begin += [bend_begin * cosine_begin, bend_begin * sine_begin]
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
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
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
        own[INERT + c], own[SWIFT + c], own[OUTPUT + c] = (
            lag[first + c],
            1.0 / lag[first + c],
            slow[first + c],
        )
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
