# SPDX-License-Identifier: Apache-2.0
"""Unsettled RC transients of a row slot after the gate opens: extra column charge in every
clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis.array.array import Network, in_range
from dermis.errors import SimulatorError
from dermis.timing import Timing

Floats = NDArray[np.float64]

# A taxel below 0.1 milliohm counts as that, a driver or input as none: the voltage across it is a difference that has
# lost the digits of so small a current, and no slow time constant comes from so little.
_G_MAX_S = 1e4
# A lateral resistor carries no current that is read, and is eliminated without a subtraction.
_G_LATERAL_MAX_S = 1e15
# Time constants of smaller conductances exceed any simulated time.
_G_MIN_S = 1e-60
# Time constant in clocks up to which settling before the gate is negligible: the charge that lines hold back is less
# than this part of the charge of a clock.
FAST_CLOCKS = 0.05


class Unsupported(ValueError):
    """A transient that lasts into the gate and that only a circuit simulator can follow.

    `what` it hangs on, as line_capacitance would say it, and what there may be `instead`.
    """

    def __init__(self, what: str, instead: str) -> None:
        self.what, self.instead = what, instead
        super().__init__(f"line_capacitance {what}; {instead}")

    def __reduce__(self) -> tuple[type[Unsupported], tuple[str, str]]:
        # An exception is rebuilt from its message alone, which is one argument short.
        return type(self), (self.what, self.instead)


@dataclass(frozen=True, eq=False)
class Transients:
    """Exponentials that are left in the gate.

    During clock n of the gate (n = 0 ends with the first decision) the column input receives
    `(charge_c * decay[:, :, None] ** n).sum(-1)` coulomb more than its settled current brings.

    Attributes
    ----------
    charge_c : ndarray
        [frames, rows, cols, modes].
    decay : ndarray
        [frames, rows, modes], the factor from one clock to the next.
    driven_c : ndarray or None
        [frames, rows, cols, modes], if asked for: as `charge_c`, in the first clock in which the row is driven.
    break_c, break_decay : ndarray or None
        [frames, rows, cols, modes] and [frames, rows, modes], if asked for: the same of the break in front of each
        row, from its first clock on.
    """

    charge_c: Floats
    decay: Floats
    driven_c: Floats | None = None
    break_c: Floats | None = None
    break_decay: Floats | None = None

    def per_clock(self, clocks: int) -> Floats:
        """Extra charge in every clock, [frames, rows, cols, clocks], in coulomb."""
        factor = self.decay[..., np.newaxis] ** np.arange(clocks)
        return np.matmul(self.charge_c, factor)


def _frames(network: Network, g_frames_s: ArrayLike | None) -> Floats:
    g = network.g_taxel_s[np.newaxis] if g_frames_s is None else np.asarray(g_frames_s, dtype=float)
    return np.minimum(g, _G_MAX_S)


def _paths(network: Network, g: Floats, row_users: int, column_users: int) -> tuple[Floats, Floats]:
    """Resistance from the far end of every row and column line to a source, if as many share each
    line.
    """
    to_column = column_users * (network.r_column_ohm + network.rows * network.r_trace_column_ohm)
    to_row = np.full(network.rows, row_users * max(network.r_row_driven_ohm, network.r_row_grounded_ohm))
    if not np.isfinite(network.r_row_grounded_ohm):
        with np.errstate(divide="ignore"):
            path = np.where(g > 0, row_users / np.maximum(g, _G_MIN_S), np.inf)
        path = (path + to_column).min(axis=2)
        path = np.where(np.isfinite(path), path, to_column.max()).max(axis=0)
        to_row = np.maximum(row_users * network.r_row_driven_ohm, path)
    return to_row + row_users * network.cols * network.r_trace_row_ohm, to_column


def _tau_by_sum(network: Network, to_row: Floats, to_column: Floats) -> float:
    """Sum of all time constants, bounded: each capacitance with its own path to a source."""
    tau = network.c_row_f * to_row.sum() + network.c_column_f * network.r_column_ohm.sum()
    return float(tau + network.c_taxel_f * (to_row[:, np.newaxis] + to_column).sum())


def _tau_by_share(network: Network, g: Floats) -> float:
    """Bound the largest ratio of y C y to y G y: the paths of all nodes split the conductances they
    share.

    Across a taxel (u - v)^2 <= 2 u^2 + 2 v^2, so its capacitance counts twice at either end.
    """
    rows, cols = network.rows, network.cols
    row_line, column_line = network.r_trace_row_ohm > 0, network.r_trace_column_ohm > 0
    row_users = cols + 1 if row_line else 1
    column_users = rows + 1 if column_line else 1
    if not np.isfinite(network.r_row_grounded_ohm):
        column_users *= rows * row_users + 1
    to_row, to_column = _paths(network, g, row_users, column_users)
    at_row = network.c_row_f + 2 * network.c_taxel_f * (1 if row_line else cols)
    at_column = network.c_column_f + 2 * network.c_taxel_f * (1 if column_line else rows)
    return float(max(at_row * to_row.max(), at_column * to_column.max()))


def slowest_s(network: Network, g_frames_s: ArrayLike | None = None) -> float:
    """Bound the slowest time constant that settles a slot in seconds; see bound_c."""
    if not (network.c_row_f or network.c_column_f or network.c_taxel_f):
        return 0.0
    network = in_range(network)
    g = _frames(network, g_frames_s)
    return min(_tau_by_sum(network, *_paths(network, g, 1, 1)), _tau_by_share(network, g))


def bound_c(network: Network, g_frames_s: ArrayLike | None, timing: Timing) -> Floats:
    """Bound the magnitude of the extra charge of a whole gate, [cols], in coulomb; inf if there is
    no bound.

    Notes
    -----
    With y the distance of all node voltages from their settled values x, C y' = -G y. The eigenvalues tau of
    C phi = tau G phi are the time constants. None is above their sum, trace(G^-1 C), which is the sum over
    all capacitors of capacitance times the resistance seen there, and that is at most the one of any path to
    a source (Rayleigh); nor above the largest ratio of y C y to y G y. The norm |y|, |y|^2 = y C y, falls at
    least as exp(-t / tau). Where a slot begins, the charges of the nodes that hang on resistances stay, so
    |y| becomes at most |y_end + x_old - x_new|; all settled voltages lie within the sources, +-A, so
    |x_old - x_new| <= 2 A sqrt(sum C), with the difference, thus twice as much, across taxels. Over any
    number of slots of length T

        |y| <= 2 A sqrt(sum C) / (1 - exp(-T / tau)) = sqrt(E)   when a slot begins

    With a break of length B the state is moved twice a slot, where a row is let go and where the
    next is driven, and where that is driven |y| <= 2 A sqrt(sum C) (1 + exp(-B / tau)) / (1 -
    exp(-T / tau)). From there on t counts, and the power in all resistors, y G y, is at most E /
    tau exp(-2 t / tau) as long as tau <= 2 t. The current in a conductance g is at most sqrt(g
    power). Into a column that has no input resistance all its conductances bring current, and its
    taxel capacitances what their rows still move. A floating row without a taxel that conducts
    keeps its charge and follows the columns through capacitances: it lies within 3 A.
    """
    if not (network.c_row_f or network.c_column_f or network.c_taxel_f):
        return np.zeros(network.cols)
    network = in_range(network)
    g = _frames(network, g_frames_s)
    rows, cols = network.rows, network.cols
    t_slot, t_break = (n / timing.f_clk_hz for n in (timing.slot_clocks, timing.break_clocks))
    t_start = (timing.settle_clocks - timing.break_clocks) / timing.f_clk_hz
    amplitude = abs(network.v_bias_v) + np.abs(network.v_column_offset_v).max()
    amplitude += (np.abs(network.i_leak_a) * network.r_column_ohm).sum()
    if not np.isfinite(network.r_row_grounded_ohm) and (g.sum(axis=2) == 0).any():
        amplitude *= 2
    to_row, _ = _paths(network, g, 1, 1)
    tau = slowest_s(network, g)
    if tau == 0.0:
        return np.zeros(cols)
    if tau > 2 * t_start:
        return np.full(cols, np.inf)
    capacitance = rows * network.c_row_f + cols * network.c_column_f + 4 * rows * cols * network.c_taxel_f
    norm = 2 * amplitude * np.sqrt(capacitance) / -np.expm1(-t_slot / tau)
    if t_break:
        norm *= 1 + np.exp(-t_break / tau)
    root_power = norm / np.sqrt(tau) * np.exp(-t_start / tau)  # when the gate opens
    through = np.where(network.r_column_ohm > 0, network.r_column_ohm, network.r_trace_column_ohm)
    around = g.sum(axis=1).max(axis=0) + 2 * rows * network.g_lateral_row_s
    with np.errstate(divide="ignore"):
        conductance = np.where(through > 0, 1.0 / through, around)
    moved = network.c_taxel_f * 2 * np.sqrt(to_row).sum()
    return root_power * (tau * np.sqrt(conductance) + np.where(through > 0, 0.0, moved))


def transients(
    network: Network,
    g_frames_s: ArrayLike | None,
    timing: Timing,
    negligible_c: float,
    before_c: float | None = None,
    bearable_c: float = np.inf,
) -> Transients | None:
    """Find the exponentials that are left when the gate opens.

    Parameters
    ----------
    network : Network
    g_frames_s : array_like
        Taxel conductances [frames, rows, cols].
    timing : Timing
        Of the slot. The first row of each frame starts settled; each other one from where the one before
        ended, after a break in which no row is driven.
    negligible_c : float
        Extra charge in a whole gate that counts as nothing, in coulomb.
    before_c : float, optional
        What flows before the gate is asked for as well, and this much of it counts as nothing. It is left out where
        it cannot be followed and has settled when the gate opens.
    bearable_c : float
        Rounding of the charge of a whole gate, in coulomb, above which the transient counts as not to be followed.

    Returns
    -------
    Transients or None
        None: there is nothing above `negligible_c`, and where a bound shows it nothing was solved.

    Raises
    ------
    Unsupported
        The bound does not exclude a transient, and trace resistance is on (every node of every line would
        be a state) or a floating row hangs on capacitances alone.
    """
    settled = not (bound_c(network, g_frames_s, timing) > negligible_c).any()
    if settled and before_c is None:
        return None
    try:
        return _follow(network, g_frames_s, timing, negligible_c, before_c, bearable_c)
    except Unsupported:
        if settled:
            return None
        raise


def _follow(
    network: Network,
    g_frames_s: ArrayLike | None,
    timing: Timing,
    negligible_c: float,
    before_c: float | None,
    bearable_c: float,
) -> Transients | None:
    if network.r_trace_row_ohm or network.r_trace_column_ohm:
        raise Unsupported(
            "on together with trace, and not settled when the gate opens",
            "lines that settle before the gate, or engine cosim",
        )
    g = _frames(network, g_frames_s)
    if not np.isfinite(network.r_row_grounded_ohm) and network.c_taxel_f and (g.sum(axis=2) == 0).any():
        raise Unsupported(
            "on with a floating row on which no taxel conducts",
            "grounded rows, lines that settle before the gate, or engine cosim",
        )
    try:
        slots = _Slots(in_range(network), g, timing)
        found = slots.transients(negligible_c, before_c)
    except np.linalg.LinAlgError:
        raise Unsupported(
            "on between conductances that are too far apart to solve",
            "lines that settle before the gate, or engine cosim",
        ) from None
    if not slots.rounding_c <= bearable_c:
        raise Unsupported(
            f"on with charges too large for double precision (rounding error {slots.rounding_c:.1e} C)",
            "smaller capacitances, leaks or column resistances, lines that settle before the gate, or engine cosim",
        )
    return found


class _Slots:
    """One frame's slots, all frames at once. Nodes: rows after their drivers, then columns."""

    def __init__(self, network: Network, g: Floats, timing: Timing) -> None:
        self.network, self.g, self.timing = network, g, timing
        self.capacitance = _Capacitance(network.rows, network.cols, network)
        # Bound of the rounding error of a whole gate's charge, set once transients are found.
        self.rounding_c = 0.0

    def _phase(self, driven: int | None, modes: _Modes | None) -> _Phase:
        """The network while a row is driven, or none; `modes` where they are known."""
        to_source, source, link = self._system(driven)
        free = np.flatnonzero(np.isfinite(to_source))
        fixed = np.flatnonzero(np.isinf(to_source))
        inside = link[:, free[:, np.newaxis], free]
        outside = link[:, free[:, np.newaxis], fixed]
        leak = to_source[free] + outside.sum(axis=2)
        if modes is None:
            rate = self.timing.f_clk_hz / self.timing.slot_clocks
            modes = _Modes(inside, leak, self.capacitance, free, rate)
        rest = np.broadcast_to(source, (self.g.shape[0], source.size)).copy()
        push = to_source[free] * source[free] + outside @ source[fixed]
        # A floating row on which nothing hangs rests anywhere; 1 S keeps its equation from being 0 = 0.
        alone = (inside.sum(axis=2) + leak) == 0
        rest[:, free] = _solve(inside, leak + alone, push[..., np.newaxis])[0][..., 0]
        lasting = modes.rate_hz < self.timing.f_clk_hz * _FASTEST
        return _Phase(to_source, free, link, modes, rest, lasting, self.capacitance)

    def _system(self, driven: int | None) -> tuple[Floats, Floats, Floats]:
        """Conductance to a source [nodes] (inf: the source itself) and its voltage, and those from
        node to node.
        """
        network, rows, cols = self.network, self.network.rows, self.network.cols
        series = np.full(rows + cols, network.r_row_grounded_ohm, dtype=float)
        if driven is not None:
            series[driven] = network.r_row_driven_ohm
        series[rows:] = network.r_column_ohm
        with np.errstate(divide="ignore"):
            to_source = np.where(series < 1.0 / _G_MAX_S, np.inf, 1.0 / series)
        voltage = np.zeros(rows + cols)
        if driven is not None:
            voltage[driven] = network.v_bias_v
        # A leak into a column behind its resistance shifts what it rests at; in front of none it shifts nothing.
        voltage[rows:] = network.v_column_offset_v + network.i_leak_a * network.r_column_ohm
        link = np.zeros((self.g.shape[0], rows + cols, rows + cols))
        link[:, :rows, rows:] = self.g
        link[:, rows:, :rows] = self.g.transpose(0, 2, 1)
        side = np.arange(rows, rows + cols - 1)
        link[:, side, side + 1] = link[:, side + 1, side] = min(
            rows * network.g_lateral_row_s, _G_LATERAL_MAX_S
        )
        return to_source, voltage, link

    def _inflow(self, phase: _Phase) -> Floats:
        """Current into each column's input for one volt of each mode, [frames, cols, modes].

        What taxel capacitances bring to a column that is held is the change of their charge.
        """
        network, rows, cols = self.network, self.network.rows, self.network.cols
        rate, shape = phase.modes.rate_hz, phase.modes.shape
        out = np.zeros((self.g.shape[0], cols, rate.shape[1]))
        held = np.isinf(phase.to_source[rows:])
        position = {int(node): i for i, node in enumerate(phase.free)}
        for c in range(cols):
            if not held[c]:
                out[:, c] = shape[:, position[rows + c]] * phase.to_source[rows + c]
        if held.any():
            live = np.array([i for i, node in enumerate(phase.free) if node < rows], dtype=int)
            rows_shape = shape[:, live]
            through = np.matmul(self.g[:, phase.free[live]].transpose(0, 2, 1), rows_shape)
            lag = network.c_taxel_f * np.where(phase.lasting, rate, 0.0)
            through -= (lag * rows_shape.sum(axis=1))[:, np.newaxis]
            beside = phase.link[:, rows:, rows:][:, held][:, :, ~held]
            free_columns = np.array([position[rows + c] for c in np.flatnonzero(~held)], dtype=int)
            out[:, held] = through[:, held] + np.matmul(beside, shape[:, free_columns])
        return out

    def _rounding(
        self, phase: _Phase, voltage: Floats, strength: Floats, inflow: Floats, t_start: float
    ) -> float:
        """Return the rounding error of the charge of a whole gate in a row that begins at
        `voltage`.

        The strength of a mode rounds with all charges behind it; a shape with all other shapes at
        the same node, since eigenvectors are known to a rounding of whole ones. Each row adds its
        own to what the next one begins with.
        """
        t_gate = self.timing.gate_clocks / self.timing.f_clk_hz
        # A rate is known to a rounding of shift, the norm it is found from to one of the largest norm, 1 / shift.
        modes, few = phase.modes, _ROUNDINGS * inflow.shape[2] * _EPS * phase.modes.spread
        part = np.divide(few, modes.norm * modes.shift_hz, out=np.zeros_like(modes.norm), where=phase.lasting)
        part *= 1.0 + (t_start + t_gate) * np.where(phase.lasting, modes.rate_hz, 0.0)
        unsure = phase.clocks(t_start, t_gate, phase.rounding(voltage) + np.abs(strength) * part)[0]
        there = np.abs(phase.clocks(t_start, t_gate, strength)[0]).sum(axis=1)
        size = np.abs(inflow)
        charge = np.matmul(size, unsure[..., np.newaxis])[..., 0]
        charge += few * size.max(axis=2, initial=0.0) * there[:, np.newaxis]
        return self.network.rows * float(charge.max())

    def transients(self, negligible_c: float, before_c: float | None) -> Transients | None:
        network, timing = self.network, self.timing
        t_clk = 1.0 / timing.f_clk_hz
        t_break = timing.break_clocks * t_clk
        t_start = (timing.settle_clocks - timing.break_clocks) * t_clk
        t_end = (timing.slot_clocks - timing.break_clocks) * t_clk
        same = network.r_row_driven_ohm == network.r_row_grounded_ohm
        gate, driven, pause = _Sums(self), _Sums(self), _Sums(self)
        idle: _Phase | None = None
        modes: _Modes | None = None
        voltage_now: Floats | None = None
        for row in range(network.rows):
            phase = self._phase(row, modes)
            modes = phase.modes if same else None
            if voltage_now is None:
                voltage_now = phase.rest
            elif timing.break_clocks:
                idle = idle or self._phase(None, modes)
                strength = idle.strength(voltage_now)
                if before_c is not None:
                    pause.put(row, self._inflow(idle), *idle.clocks(0.0, t_clk, strength))
                voltage_now = idle.after(t_break, strength)
            strength, inflow = phase.strength(voltage_now), self._inflow(phase)
            self.rounding_c = max(
                self.rounding_c, self._rounding(phase, voltage_now, strength, inflow, t_start)
            )
            gate.put(row, inflow, *phase.clocks(t_start, t_clk, strength))
            if before_c is not None:
                driven.put(row, inflow, *phase.clocks(0.0, t_clk, strength))
            voltage_now = phase.after(t_end, strength)
        # The whole share of each mode; those that share less than all may lose are left out.
        kept = gate.above(timing.gate_clocks, negligible_c)
        if before_c is None:
            return Transients(gate.charge[..., kept], gate.decay[..., kept]) if kept.any() else None
        kept |= driven.above(timing.slot_clocks, before_c)
        lasts = pause.above(timing.break_clocks, before_c)
        if not kept.any() and not lasts.any():
            return None
        return Transients(
            gate.charge[..., kept],
            gate.decay[..., kept],
            driven.charge[..., kept],
            pause.charge[..., lasts],
            pause.decay[..., lasts],
        )


class _Sums:
    """Exponentials of every row side by side; rows may have unlike numbers of them."""

    def __init__(self, slots: _Slots) -> None:
        frames, nodes = slots.g.shape[0], slots.network.rows + slots.network.cols
        self.charge = np.zeros((frames, slots.network.rows, slots.network.cols, nodes))
        self.decay = np.zeros((frames, slots.network.rows, nodes))
        self.size = 0

    def put(self, row: int, inflow: Floats, first: Floats, decay: Floats) -> None:
        """Store a row's modes: current for one volt of each, its integral over a clock, and its
        decay in a clock.
        """
        count = decay.shape[1]
        self.charge[:, row, :, :count] = inflow * first[:, np.newaxis]
        self.decay[:, row, :count] = decay
        self.size = max(self.size, count)

    def above(self, clocks: int, charge_c: float) -> NDArray[np.bool_]:
        """Return the modes that bring more charge in these clocks than their share of `charge_c`,
        in any column.
        """
        whole = (1 - self.decay**clocks) / np.maximum(1 - self.decay, _EPS)
        return (np.abs(self.charge) * whole[:, :, np.newaxis] > charge_c / max(self.size, 1)).any(
            axis=(0, 1, 2)
        )


@dataclass(frozen=True, eq=False)
class _Phase:
    """The network between two switchings: its links to sources, its modes and its steady state.

    `to_source` [nodes] and `link` [frames, nodes, nodes] are conductances, `free` the nodes behind
    a resistance, `rest` [frames, nodes] their settled voltages, `lasting` the modes that outlast a
    clock's beginning.
    """

    to_source: Floats
    free: NDArray[np.int64]
    link: Floats
    modes: _Modes
    rest: Floats
    lasting: NDArray[np.bool_]
    capacitance: _Capacitance

    def strength(self, voltage: Floats) -> Floats:
        """Return the amplitude of each mode for a phase that begins at `voltage` [frames, nodes],
        in volt.
        """
        # The charge of a node on resistances does not jump, even if sources do.
        charge = self.capacitance.times(self.modes.full, (voltage - self.rest)[..., np.newaxis])[..., 0]
        return np.divide(charge, self.modes.norm, out=np.zeros_like(charge), where=self.modes.norm > 0)

    def rounding(self, voltage: Floats) -> Floats:
        """Return the largest effect of rounding on each mode's amplitude: some roundings a node of
        all charges in it, and of the largest of all modes, since eigenvectors are known to a
        rounding of whole ones."""
        size = (np.abs(voltage) + np.abs(self.rest))[..., np.newaxis]
        charge = self.capacitance.times(np.abs(self.modes.full), size, 1.0)[..., 0]
        part = (
            _ROUNDINGS
            * voltage.shape[1]
            * _EPS
            * self.modes.spread
            * charge.max(axis=1, keepdims=True, initial=0.0)
        )
        part = np.broadcast_to(part, self.modes.norm.shape)
        return np.divide(part, self.modes.norm, out=np.zeros_like(part), where=self.modes.norm > 0)

    def clocks(self, t: float, t_clk: float, strength: Floats) -> tuple[Floats, Floats]:
        """Return the integral of each mode over the clock after a time t, and its decay over a
        clock.
        """
        rate = np.where(self.lasting, self.modes.rate_hz, 0.0)
        with np.errstate(under="ignore"):
            decay = np.where(self.lasting, np.exp(-t_clk * rate), 0.0)
            # A mode that outlasts any number of clocks brings the same in each.
            whole = np.divide(-np.expm1(-t_clk * rate), rate, out=np.full_like(rate, t_clk), where=rate > 0)
            if t == 0.0:  # whole, however fast it is over
                whole = np.where(self.lasting, whole, self.modes.norm)
                return strength * whole, decay
            return np.where(self.lasting, strength * np.exp(-t * rate) * whole, 0.0), decay

    def after(self, t: float, strength: Floats) -> Floats:
        """Voltages [frames, nodes] a time t later."""
        rate = np.where(self.lasting, self.modes.rate_hz, 0.0)
        with np.errstate(under="ignore"):
            left = np.where(self.lasting, strength * np.exp(-t * rate), 0.0)
        voltage = self.rest.copy()
        voltage[:, self.free] += np.matmul(self.modes.shape, left[..., np.newaxis])[..., 0]
        return voltage


# Modes faster than this part of a clock are over before the first settle clock is: exp(-1000) is 0.
_FASTEST = 1000.0
# Rounding of a dense solve of some hundred nodes; a wrong mode is off by 1.
_RESIDUAL_MAX = 1e-6
_EPS = np.finfo(float).eps
# Roundings a node in an eigenvalue or eigenvector, of the largest: an estimate, not a bound. At 4 one of five random
# networks was off by more against 80 digits (tb/model/test_settling.py), at 16 none.
_ROUNDINGS = 16


def _solve(link: Floats, leak: Floats, drive: Floats) -> tuple[Floats, Floats]:
    """Solve (leak + sum of links) v - link v = drive [frames, n, m] by star-mesh steps; v, and
    sqrt(1 / pivots) times the inverse of the triangle that they leave, whose square is the inverse
    of the matrix."""
    from dermis.array import star_mesh

    frames, n = leak.shape
    work = np.concatenate([link, leak[:, :, np.newaxis], drive, np.zeros((frames, n, n))], axis=2)
    pivot = np.empty_like(leak)
    star_mesh.down(work, pivot, 0, n, 0)
    own = np.arange(n)
    work[:, own, work.shape[2] - n + own] = np.sqrt(pivot)
    star_mesh.up(work, pivot, 0, n)
    # The steps divide by pivots; a node without any conductance would make one 0.
    if not np.isfinite(work[:, :, n + 1 :]).all():
        raise SimulatorError("settling of the lines: a voltage is not a finite number")
    return work[:, :, n + 1 : work.shape[2] - n], work[:, :, work.shape[2] - n :]


class _Capacitance:
    """Capacitors from every line to ground and across every taxel, taken one by one: what both ends
    of a large one do alike never enters, where a matrix of them would subtract it again."""

    def __init__(self, rows: int, cols: int, network: Network) -> None:
        self.rows, self.across_f = rows, network.c_taxel_f
        self.to_ground_f = np.repeat([network.c_row_f, network.c_column_f], [rows, cols])

    def times(self, left: Floats, right: Floats, other_end: float = -1.0) -> Floats:
        """Return left' C right of voltages [frames, nodes, k] and [frames, nodes, m]; with
        `other_end` 1, of magnitudes.
        """
        out = np.matmul(left.transpose(0, 2, 1), self.to_ground_f[:, np.newaxis] * right)
        if self.across_f:
            out += self.across_f * np.matmul(
                self._across(left, other_end).transpose(0, 2, 1), self._across(right, other_end)
            )
        return out

    def _across(self, voltage: Floats, other_end: float) -> Floats:
        difference = voltage[:, : self.rows, np.newaxis] + other_end * voltage[:, np.newaxis, self.rows :]
        return difference.reshape(
            voltage.shape[0], difference.shape[1] * difference.shape[2], voltage.shape[2]
        )

    def links(self, free: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Capacitances between free nodes [n, n], and from each of them to ground and to nodes that
        are held [n].
        """
        on_row = np.arange(self.to_ground_f.size) < self.rows
        across = self.across_f * (on_row[:, np.newaxis] != on_row)
        held = np.setdiff1d(np.arange(on_row.size), free)
        return across[np.ix_(free, free)], self.to_ground_f[free] + across[np.ix_(free, held)].sum(axis=1)


class _Modes:
    """Rates and shapes of C y' = -G y: G shape = rate C shape, shape' (G + shift C) shape = 1,
    shape' C shape = norm.

    Rates are found from the norm, 1 / (rate + shift). Whatever is slow is then as far apart from
    the rest as what lasts 1 / shift and no further: time constants from picoseconds to ages in one
    network cost what there is in a slot no digit. G + shift C has no sign but that of its diagonal
    and is eliminated without a subtraction (star_mesh), so a short beside a gigaohm costs none
    either.
    """

    def __init__(
        self, link: Floats, leak: Floats, capacitance: _Capacitance, free: NDArray[np.int64], shift_hz: float
    ) -> None:
        frames, n = leak.shape
        self.shift_hz, self.spread = shift_hz, 1.0
        self.rate_hz, self.norm = np.zeros((frames, n)), np.zeros((frames, n))
        self.full = np.zeros((frames, capacitance.to_ground_f.size, n))
        self.shape = self.full[:, free]
        if n == 0:
            return
        between, to_ground = capacitance.links(free)
        links, leaks = link + shift_hz * between, leak + shift_hz * to_ground
        leaks = leaks + ((links.sum(axis=2) + leaks) == 0)
        root = np.zeros_like(self.full)
        root[:, free] = _solve(links, leaks, np.zeros((frames, n, 0)))[1]
        # What rounds across a large capacitor is what both its ends have in common.
        self.spread = 1.0 + float(np.sqrt(shift_hz * capacitance.across_f) * np.abs(root).max())
        norm, vectors = np.linalg.eigh(capacitance.times(root, root))
        # The slowest first, so that what is left out is at the end.
        self.norm = np.clip(norm[:, ::-1], 0.0, 1.0 / shift_hz)
        self.full = np.matmul(root, vectors[:, :, ::-1])
        self.shape = self.full[:, free]
        rate = np.divide(1.0, self.norm, out=np.full_like(norm, np.inf), where=self.norm > 1.0 / _FAST_HZ)
        self.rate_hz = np.maximum(rate - shift_hz, 0.0)
        self._check(links, leaks, shift_hz * between, shift_hz * to_ground, shift_hz)

    def _check(
        self, links: Floats, leaks: Floats, between: Floats, to_ground: Floats, shift_hz: float
    ) -> None:
        """Check that shift C shape = shift norm (G + shift C) shape; links and leaks are those of
        the right side.
        """
        size = np.abs(self.shape)
        left = (between.sum(axis=1) + to_ground)[:, np.newaxis] * self.shape - np.matmul(between, self.shape)
        most = (between.sum(axis=1) + to_ground)[:, np.newaxis] * size + np.matmul(between, size)
        total = (links.sum(axis=2) + leaks)[:, :, np.newaxis]
        part = (shift_hz * self.norm)[:, np.newaxis]
        right = (total * self.shape - np.matmul(links, self.shape)) * part
        most = most.max(axis=1) + ((total * size + np.matmul(links, size)) * part[:, :, :1]).max(axis=1)
        if not (np.abs(left - right).max(axis=1) <= _RESIDUAL_MAX * most).all():
            raise np.linalg.LinAlgError("a mode does not solve C phi = tau G phi")


# Anything this fast is over at once.
_FAST_HZ = 1e60
