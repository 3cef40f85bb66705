# SPDX-License-Identifier: Apache-2.0
"""Walk cells clock by clock: converters in packets and clocks, their noise, and counts of frames or of chosen cells.

docs/event.md has the equations. Where an effect makes the input change inside a gate, its mean over each clock takes
the place of the constant (converter.course).
"""

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dermis.array.array import column_currents
from dermis.converter import course, noise, walk_loops
from dermis.converter.coupling import Coupling, columns_in_gates, coupling
from dermis.converter.course import Slots
from dermis.converter.vfc import W_PRESET, Converter
from dermis.errors import SimulatorError
from dermis.fields import FAMILIES
from dermis.ndarrays import Floats
from dermis.records import Plan

RANDOM = FAMILIES["noise"]

# Of these, the effects drawn once a slot; they leave no decision open.
_SLOT_RANDOM = frozenset({"v_preset_noise_v", "packet_flicker"})

_LEAK_MAX = 1e12
# Another kind of argument is another loop to compile.
_NOTHING = np.empty(0)
# Duty beyond which a converter saturates whatever its noise is.
_X_NOISE_MAX = 1.0


@dataclass(frozen=True, eq=False)
class Cells:
    """Converters in packets and clocks, every field [n]: the input of the loops.

    `x` packets a clock; `leak` fraction of w lost a clock; `w0` start; `packet`; `rise` and `fall`
    the levels at which the comparator goes high and low; `low` and `high` the range of w; `delay`
    of the comparator in clocks, 0..1; `lag` time constant in clocks by which the output follows w
    (0: at once); `across` fraction of what the output has not followed yet that flows through the
    input a clock (the leak is the part of it that remains).
    """

    x: Floats
    leak: Floats
    w0: Floats
    packet: Floats
    rise: Floats
    fall: Floats
    low: Floats
    high: Floats
    delay: Floats
    lag: Floats
    across: Floats


class Noise(NamedTuple):
    """Noise of some cells: `rows` [4, n] (rows of converter.walk_loops.walk) and a key a cell [n]."""

    rows: Floats
    keys: NDArray[np.uint64]


Counts = tuple[NDArray[np.int64], Floats, Floats]
"""Counts, mean duties with what coupled columns give, and charges at the end."""


def count_frames(plan: Plan, part: slice, random: bool) -> Counts:
    """Count some frames, [frames, rows, cols] each."""
    g = plan.conductance_s(part)
    keys = noise.cell_keys(plan.seed, plan.first_frame + part.start, g.shape) if random else None
    column_s = columns_in_gates(plan, part)
    coupled = coupling(plan, part)
    if not plan.active_fields() & course.FIELDS:
        x = plan.converter.duty(column_currents(plan.network(0), g))
        return count(plan, plan.converter, x, column_s, keys, coupled=coupled)
    slots = Slots(plan, part)
    by_row = np.zeros((slots.rows, slots.frames, slots.cols))
    keys = None if keys is None else keys.swapaxes(0, 1)
    coupled = None if coupled is None else Coupling(*(of.swapaxes(0, 1) for of in coupled))
    found = count(plan, plan.converter, by_row, column_s.swapaxes(0, 1), keys, slots.blocks(), coupled)
    counts, x, end = (values.swapaxes(0, 1) for values in found)
    return counts, x, end


def count(
    plan: Plan,
    converter: Converter,
    x: Floats,
    column_s: Floats,
    keys: NDArray[np.uint64] | None,
    blocks: Iterable[tuple[slice, Floats, Floats]] | None = None,
    coupled: Coupling | None = None,
) -> Counts:
    """Count cells, shaped as `x`.

    Parameters
    ----------
    converter : of a plan, or of its chosen columns; its fields broadcast to x
    x : duties, without a meaning where there are `blocks`
    column_s : conductance on the cells' columns, broadcasts to x
    keys : of random numbers, shaped as x, or None
    blocks : (slice of the flat cells, charge of every clock [clocks, cells], mean [cells]) if the charge changes from
        clock to clock
    coupled : coupling of the cells, which are whole rows, or None
    """
    timing, draws = plan.timing, None
    cells = _cells(converter, x, _input_s(plan, converter, column_s, coupled))
    if keys is not None:
        cells = _with_slot_noise(converter, cells, keys)
        if plan.active_fields() & RANDOM - _SLOT_RANDOM:
            # Thermal noise of the conductance on a column.
            packet_c, share = converter.i0_a / converter.f_clk_hz, converter.gain / converter.k
            variance = 2.0 * converter.kt_noise_j * column_s * share**2 / (converter.f_clk_hz * packet_c**2)
            variance = np.broadcast_to(variance, x.shape)
            draws = Noise(noise_rows(converter, x, variance), keys.flatten())
    if blocks is None and coupled is None:
        counts, end = count_cells(cells, timing.gate_clocks, timing.charge_delay_clocks, draws)
        return counts, x, end
    rows = rows_of(cells, timing.charge_delay_clocks)
    counts, (means, end, given) = np.empty(x.size, dtype=np.int64), np.zeros((3, x.size))
    links = None if coupled is None else coupled.links.reshape(x.size, 2, -1)
    for block, charge, mean in blocks or [(slice(0, x.size), rows.cells.x[np.newaxis], x.reshape(-1))]:
        means[block] = mean
        if draws is not None:
            column = np.arange(block.start, block.stop) % converter.cols
            draws.rows[:, block] = noise_rows(converter, mean, variance.flat[block], column)
        clocks = timing.gate_clocks, timing.charge_delay_clocks
        walk_cells(*clocks, charge, rows, draws, block, counts, end, links, given)
    return counts.reshape(x.shape), (means + given).reshape(x.shape), end.reshape(x.shape)


def cells_of(plan: Plan, x: Floats, column_s: Floats, coupled: Coupling | None = None) -> Cells:
    """Turn the converters of a plan into packets and clocks, for x and conductances of columns [frames, rows, cols]."""
    return _cells(plan.converter, x, _input_s(plan, plan.converter, column_s, coupled))


def _input_s(plan: Plan, converter: Converter, column_s: Floats, coupled: Coupling | None) -> Floats | None:
    """Return the conductance across the input of integrators, None where no charge is lost through it."""
    if not (converter.inv_gain_dc.any() or converter.t_gbw_s.any()):
        return None
    if coupled is not None:
        return converter.g_in_s + coupled.across_s
    # The virtual ground of the direct interface carries the whole column, whichever row is driven.
    return converter.g_in_s + column_s if plan.topology == "direct" else converter.g_in_s


def _cells(converter: Converter, x: Floats, g_in_s: Floats | None) -> Cells:
    """Cells of duties x, the fields of whose converters broadcast to x; `g_in_s` is None where no charge is lost."""
    packet_v = converter.packet_v()
    # Output of the integrator over the voltage of its capacitor.
    amplitude = 1.0 / (1.0 + converter.inv_gain_dc)
    leak = across = np.zeros(())
    if g_in_s is not None:
        across = np.minimum(g_in_s / converter.c_int_f / converter.f_clk_hz, _LEAK_MAX)
        leak = across * (converter.inv_gain_dc * amplitude)
    most = converter.saturating_duty()
    scale = packet_v * amplitude
    low, high = converter.range_v() / scale
    columns = {
        "w0": np.clip(W_PRESET + converter.preset_error_v / packet_v, low, high),
        "packet": 1.0 + converter.packet_error,
        "rise": (converter.v_comp_offset_v + converter.v_hysteresis_v / 2) / scale,
        "fall": (converter.v_comp_offset_v - converter.v_hysteresis_v / 2) / scale,
        "low": low,
        "high": high,
        "delay": converter.t_comp_delay_s * converter.f_clk_hz,
        "lag": converter.t_gbw_s * amplitude * converter.f_clk_hz,
        "x": np.clip(x, -most, most),
        "leak": leak,
        "across": across,
    }
    return Cells(**{name: np.broadcast_to(value, x.shape) for name, value in columns.items()})


def _with_slot_noise(converter: Converter, cells: Cells, keys: NDArray[np.uint64]) -> Cells:
    """Draw the noise of a slot: the charge after the preset, and the size of the packet."""
    changed = {}
    if converter.v_preset_noise_v.any():
        spread = converter.v_preset_noise_v / converter.packet_v()
        start = cells.w0 + spread * noise.normals(keys, noise.PRESET)
        changed["w0"] = np.clip(start, cells.low, cells.high)
    if converter.packet_flicker.any():
        changed["packet"] = cells.packet * (
            1.0 + converter.packet_flicker * noise.normals(keys, noise.FLICKER)
        )
    return Cells(**vars(cells) | changed) if changed else cells


def noise_rows(
    converter: Converter, x: Floats, variance: Floats, column: NDArray[np.int64] | slice = slice(None)
) -> Floats:
    """Rows of `Noise` for mean duties x [..., column]; per-packet noise comes at the mean rate of packets.

    `variance` is what the charge of a clock has from elsewhere, in packets^2.
    """
    x = np.minimum(np.abs(x), _X_NOISE_MAX)
    rate = np.minimum(x, 0.5)
    shot = (converter.q_shot_c * converter.f_clk_hz / converter.i0_a)[column]
    jitter = (converter.t_jitter_s * converter.f_clk_hz)[column]
    output_v = (converter.packet_v() / (1.0 + converter.inv_gain_dc))[column]
    rows = np.empty((4, *x.shape))
    rows[walk_loops.SIGMA] = np.sqrt(variance + shot * (x + rate) + 2.0 * jitter**2 * rate)
    rows[walk_loops.WHITE] = converter.v_comp_noise_v[column] / output_v
    rows[walk_loops.SLOPE] = x * jitter
    rows[walk_loops.APERTURE] = x * (0.5 * converter.t_meta_s[column] * converter.f_clk_hz)
    return rows.reshape(4, -1)


class Rows(NamedTuple):
    """Cells as converter.walk_loops.walk takes them.

    lags : the outputs lag
    one_step : no cell has a window or a range: without noise no clock is looked at again
    at_edge : every sample is taken at the clock edge
    """

    cells: walk_loops.Flat
    lags: bool
    one_step: bool
    at_edge: bool


def rows_of(cells: Cells, charge_delay: float) -> Rows:
    """Return cells flattened, and which of their effects are on."""
    if not 0 < charge_delay <= 1:
        raise ValueError(f"charge_delay = {charge_delay} is outside 0..1")
    # Copies, so that none is read-only: the loops would be compiled again for it.
    flat = walk_loops.Flat(**{k: np.asarray(v, dtype=float).flatten() for k, v in vars(cells).items()})
    lags = bool(flat.lag.any())
    if lags and not flat.lag.all():
        raise ValueError("the output of some cells lags and of others does not")
    endless = np.isinf(flat.low).all() and np.isinf(flat.high).all()
    one_step = bool((flat.rise == flat.fall).all() and endless)
    return Rows(flat, lags, one_step, not flat.delay.any())


def count_cells(
    cells: Cells, clocks: int, charge_delay: float, draws: Noise | None = None
) -> tuple[NDArray[np.int64], Floats]:
    """Count the ones of `clocks` decisions and return (counts, charge at the end), shaped as `cells.x`.

    A one decided at clock n takes its packet out between clocks n + D and n + D + 1, D = `charge_delay` in
    0..1. A loop is compiled for each kind of cell: none of them tests for an effect that is off.
    """
    rows = rows_of(cells, charge_delay)
    flat = rows.cells
    counts, end = np.empty(flat.x.size, dtype=np.int64), np.empty(flat.x.size)
    if draws is None and rows.one_step and rows.at_edge and not (rows.lags or flat.leak.any()):
        walk_loops.plain(flat.x, flat.w0, flat.packet, flat.rise, clocks, charge_delay, counts, end)
        _check_charge(end)
    else:
        whole = slice(0, flat.x.size)
        walk_cells(clocks, charge_delay, flat.x[np.newaxis], rows, draws, whole, counts, end)
    return counts.reshape(cells.x.shape), end.reshape(cells.x.shape)


def walk_cells(
    clocks: int,
    late: float,
    x: Floats,
    rows: Rows,
    draws: Noise | None,
    block: slice,
    counts: NDArray[np.int64],
    end: Floats,
    links: Floats | None = None,
    given: Floats = _NOTHING,
) -> None:
    """Count a block of `rows`, whose `links` [n, 2, cols] are those of all of them; the rest as for
    converter.walk_loops.walk.
    """
    of, keys = (None, None) if draws is None else draws
    step = None if of is None else walk_loops.grid_step(of[walk_loops.SIGMA], clocks)
    lags = True if rows.lags else None
    # Of coupled columns one loop less to compile.
    limits = None if of is None and rows.one_step and links is None else True
    early = None if limits is None and rows.at_edge else True
    links = None if links is None else np.ascontiguousarray(links[block])
    walk_loops.walk(
        clocks, late, x, rows.cells, lags, early, limits, of, keys, step, links, block.start, block.stop,
        counts, end, given,
    )  # fmt: skip
    _check_charge(end[block])


def _check_charge(end: Floats) -> None:
    """Raise SimulatorError if a charge is not finite: a comparator fed with NaN would read as an unpressed taxel."""
    if not np.isfinite(end).all():
        raise SimulatorError("engine event: the charge of a converter is not a finite number")


def columns_of(converter: Converter, col: NDArray[np.intp]) -> Converter:
    """The converters of chosen columns [n], each with values of its own."""
    chosen = copy.copy(converter)  # its arrays are checked already
    for name, value in vars(converter).items():
        if isinstance(value, np.ndarray):
            object.__setattr__(chosen, name, value[col])
    return chosen
