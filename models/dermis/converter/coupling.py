# SPDX-License-Identifier: Apache-2.0
"""Coupling of the columns of the direct interface through virtual grounds of finite gain.

Charge that stands in an integrator of finite gain lifts its virtual ground, and what the ground
gives way to flows through the array into the others (docs/event.md, "Coupled columns").
"""

from typing import NamedTuple

import numpy as np

from dermis.array.array import Network, between_columns
from dermis.converter.walk_loops import BLOCK
from dermis.errors import InputError
from dermis.ndarrays import Floats
from dermis.records import Plan

# Conductance of a short across a virtual ground: any integrator loses all its charge through it.
G_ACROSS_S = 1e12
# Part of a packet in other columns that may reach a column within a clock, and that part times the part of its own
# charge that it loses in one. The walk takes the mean of what flows in a clock; up to here its codes are within one of
# the common equation of all columns (tb/model/test_event_columns.py).
_STRONGEST, _STRONGEST_BESIDE_LEAK = 0.15, 1e-3

# Fields that make the virtual ground of one column see the others.
COUPLING = frozenset(
    "r_row_driven_ohm r_row_grounded_ohm r_column_ohm g_lateral_row_s r_trace_row_ohm r_trace_column_ohm".split()
)


def seen_from_grounds(network: Network, g_frames_s: Floats) -> Floats:
    """Return the conductance matrix between the virtual grounds, as `array.between_columns` defines it."""
    return between_columns(network, np.minimum(g_frames_s, G_ACROSS_S))


def on_columns(g_frames_s: Floats) -> Floats:
    """Return the conductance of all taxels on each column, [frames, 1, cols], with shorts as in `seen_from_grounds`."""
    return np.minimum(g_frames_s, G_ACROSS_S).sum(axis=1, keepdims=True)


def columns_in_gates(plan: Plan, part: slice) -> Floats:
    """Return `on_columns` where a frame begins, with the direct interface in the middle of each gate: [frames, rows,
    cols].
    """
    g = plan.conductance_s(part)
    now = on_columns(g)
    if plan.drive.motion and plan.topology == "direct":  # elsewhere only thermal noise depends on it
        share = plan.gate_shares()[2, :, np.newaxis]
        now = (1.0 - share) * now + share * on_columns(plan.next_conductance_s(part))
    return np.broadcast_to(now, g.shape)


class Coupling(NamedTuple):
    """Coupling between the columns of some frames.

    `across_s` [frames, rows, cols]: conductance that a column's own input sees in the middle of the
    gate. `links` [frames, rows, cols, 2, cols]: packets a clock into the first column while the
    virtual ground of the second one is off by what a packet makes of its capacitor, in the middle of
    the gate, and by how much that changes over the gate, also of the column itself.
    """

    across_s: Floats
    links: Floats


def couples(plan: Plan) -> str | None:
    """Return the effect by which columns of a plan are coupled, None if they are not."""
    active = plan.active_fields()
    if plan.topology != "direct" or not active & COUPLING:
        return None
    of_field = {"inv_gain_dc": "integrator_gain", "t_gbw_s": "integrator_bandwidth"}
    return next((effect for field, effect in of_field.items() if field in active), None)


def coupling(plan: Plan, part: slice) -> Coupling | None:
    """Return the coupling of some frames, None if there is none.

    InputError where columns are coupled so strongly that the walk may be off by a count.
    """
    if (effect := couples(plan)) is None:
        return None
    if plan.cols > BLOCK:
        allowed = f"at most {BLOCK} columns that are coupled, or engine cosim"
        raise InputError(plan.scene.path, "array.cols", plan.cols, allowed)
    converter, own = plan.converter, np.arange(plan.cols)
    middle_s, change_s = _in_gates(plan, part)
    a_clock = converter.packet_v() / converter.i0_a[:, np.newaxis]
    links = -np.stack([middle_s * a_clock, change_s * a_clock], axis=-2)
    links[..., own, 0, own] = 0.0
    # How far a packet in the charge moves the virtual ground. What an output lags is over when it has followed, and
    # counts a quarter, as measured.
    amplitude = 1.0 / (1.0 + converter.inv_gain_dc)
    lag = converter.t_gbw_s * amplitude * converter.f_clk_hz
    ground = converter.inv_gain_dc * amplitude + 0.25 * lag
    strength = float(((np.abs(links[..., 0, :]) + 0.5 * np.abs(links[..., 1, :])) @ ground).max())
    leak = float((middle_s[..., own, own] * a_clock[own, own] * converter.inv_gain_dc * amplitude).max())
    doubt = max(strength / _STRONGEST, strength * leak / _STRONGEST_BESIDE_LEAK)
    if not doubt <= 1.0:
        active = plan.active_fields()
        names = {name for field in COUPLING & active for name in plan.effects_of_field(field)}
        raise plan.unsure(effect, sorted(names), "column coupling that", 1.0, doubt)
    shape = (len(middle_s), plan.rows, plan.cols, 2, plan.cols)
    return Coupling(np.broadcast_to(middle_s[..., own, own], shape[:3]), np.broadcast_to(links, shape))


def _in_gates(plan: Plan, part: slice) -> tuple[Floats, Floats]:
    """Return `seen_from_grounds` in the middle of the gate of each row, and its change over the gate.

    With motion by the parabola in time through both frames and the middle between them.
    """
    network, g = plan.network(0), plan.conductance_s(part)
    now = seen_from_grounds(network, g)
    if not plan.drive.motion:
        return now, np.zeros_like(now)
    then = plan.next_conductance_s(part)
    change = seen_from_grounds(network, then) - now
    bend = 4.0 * seen_from_grounds(network, 0.5 * (np.minimum(g, G_ACROSS_S) + np.minimum(then, G_ACROSS_S)))
    bend -= 4.0 * now + 2.0 * change
    begin, end, middle = plan.gate_shares()[:3, np.newaxis, :, np.newaxis, np.newaxis]
    at = [now + s * change + s * (1.0 - s) * bend for s in (begin, end, middle)]
    return at[2], at[1] - at[0]
