# SPDX-License-Identifier: Apache-2.0
"""The SPICE deck of a plan: row drivers, array and one channel a column, written from the records and nothing else.

A record field at its default writes nothing beyond the ideal setting of its block, so an effect that is off leaves no
element behind. Every number is formatted from a float and every name is made here: no text of a scene reaches a deck.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dermis.array import Network
from dermis.design import ROOT
from dermis.ngspice import Deck
from dermis.plan import Drive, Plan
from dermis.spice_text import array_subckt, spice_number
from dermis.vfc import Converter

SPICE = ROOT / "spice"

HONOURS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "v_column_offset_v",
        "g_lateral_row_s",
        "g_lateral_column_s",  # without column traces both ends are one column line: no element, no current
        "r_trace_row_ohm",
        "r_trace_column_ohm",
        "i_leak_a",
        "c_row_f",
        "c_column_f",
        "c_taxel_f",
        "gain",
        "i_offset_a",
        "inv_gain_dc",
        "g_in_s",
        "v_int_max_v",
        "v_int_min_v",
        "packet_error",
        "preset_error_v",
        "v_comp_offset_v",
        "v_hysteresis_v",
        "t_comp_delay_s",
        "inv_i_range_a",
        "q_mirror_c",
        "t_gbw_s",
        "ripple",
        "motion",
    }
)
"""Record fields a deck can express; a field not named here is refused, never ignored."""

# A deck without a pole has straight lines between the corners of its sources, and trapezoidal integration of a
# capacitor follows those exactly at any step: there is no truncation error to watch (trtol), and the tolerances are
# those of Newton's method, which linear decks meet in the least number of iterations anyway.
_OPTIONS_EXACT = {"reltol": 1e-6, "abstol": 1e-13, "vntol": 1e-9, "trtol": 1e12}

# With a pole the step follows the truncation error. Ten times tighter changes no code of nonideal_channel and takes
# 1.8 times the steps; trtol 7 is ngspice's own, said because XSPICE elements would turn it into 1.
_OPTIONS_POLE = {"reltol": 1e-4, "abstol": 1e-12, "vntol": 1e-7, "chgtol": 1e-14, "trtol": 7.0}

# A clamp inside the converter's own swing is met at every packet, and what it takes decides which clock the next one
# falls on. At 1e-4 a code of a range of -0.25 .. 0.6 V is off by 3; at 1e-5 by 1; here by none.
_OPTIONS_CLAMP = {"reltol": 1e-6, "abstol": 1e-13, "vntol": 1e-9, "chgtol": 1e-16, "trtol": 3.0}
_SWING_PACKETS = 1.5  # the stored charge stays within -1 .. 1 below x = 1/2


def source_names(rows: int, cols: int) -> tuple[str, ...]:
    """Names of the sources that the digital side drives: rows, preset, charge switches."""
    return (
        *(f"v_d_row{r}" for r in range(rows)),
        "v_d_preset",
        *(f"v_d_charge{c}" for c in range(cols)),
    )


def _channel_parameters(plan: Plan, network: Network, column: int) -> dict[str, float]:
    """Parameters of one channel that are away from the ideal channel, and the packet."""
    converter = plan.converter
    direct = plan.topology == "direct"
    packet_v = float(converter.packet_v()[column])
    values = {
        "i0_a": float(converter.i0_a[column]),
        "c_int_f": float(converter.c_int_f[column]),
        # v_preset_v is minus the stored charge, whatever the polarity of the channel
        "v_preset_v": 0.5 * packet_v - float(converter.preset_error_v[column]),
    }
    ideal = {
        "packet_error": (converter.packet_error, 0.0),
        "comp_v_offset_v": (converter.v_comp_offset_v, 0.0),
        "comp_v_hysteresis_v": (converter.v_hysteresis_v, 0.0),
        "comp_t_delay_s": (converter.t_comp_delay_s, 0.0),
        "int_v_out_max_v": (converter.v_int_max_v, np.inf),
        "int_v_out_min_v": (converter.v_int_min_v, -np.inf),
        "int_t_gbw_s": (converter.t_gbw_s, 0.0),
    }
    if direct:
        ideal["int_v_offset_v"] = (network.v_column_offset_v, 0.0)
    else:
        values["k"] = float(converter.k[column])
        ideal["conv_r_x_ohm"] = (network.r_column_ohm, 0.0)
        ideal["conv_v_offset_v"] = (network.v_column_offset_v, 0.0)
        ideal["out_inv_i_range_a"] = (converter.inv_i_range_a, 0.0)
        ideal["out_q_lag_c"] = (converter.q_mirror_c, 0.0)
        if plan.topology == "multi_output_conveyor":
            ideal["conv_gain_error"] = (converter.gain - 1.0, 0.0)
        else:
            ideal["mir_ratio_error"] = (converter.gain - 1.0, 0.0)
    values |= {name: float(v[column]) for name, (v, off) in ideal.items() if v[column] != off}
    if converter.inv_gain_dc[column]:
        values["int_gain_dc"] = 1.0 / float(converter.inv_gain_dc[column])
    if converter.g_in_s[column]:
        values["int_r_in_ohm"] = 1.0 / float(converter.g_in_s[column])
    return values


def _assignments(values: Mapping[str, float]) -> str:
    return " ".join(f"{name}={spice_number(value)}" for name, value in values.items())


def frame_deck(plan: Plan, frame: int, levels: Sequence[float], *, record: bool = False) -> Deck:
    """Write the deck of one frame.

    Parameters
    ----------
    plan : Plan
    frame : int
        Which frame's resistances stand in the array.
    levels : sequence of float
        Value of every source at time zero, in the order of `source_names`.
    record : bool
        Probe the integrators as well, for waveforms.

    Returns
    -------
    Deck
        Its probes are the comparator outputs, then, if recorded, the integrator outputs.
    """
    network = plan.network(frame)
    rows, cols = network.rows, network.cols
    direct = plan.topology == "direct"
    supply = plan.scene.design.supply
    lines = [
        f"dermis frame {frame}: {rows} x {cols}, {plan.topology}",
        f'.include "{SPICE / "design.inc"}"',
        f'.include "{SPICE / "behavioural" / "blocks.inc"}"',
        f"vdd vdd 0 {spice_number(supply.vdd_v)}",
        f"vss vss 0 {spice_number(supply.vss_v)}",
        f"vbias vbias 0 {_bias(plan, frame)}",
        "vibias ibias 0 0",
    ]
    # A dc value beside `external` crashes libngspice 39.
    lines += [f"{name} {name[2:]} 0 external" for name in source_names(rows, cols)]
    driver = {
        "r_on_ohm": float(network.r_row_driven_ohm),
        "r_ground_ohm": min(float(network.r_row_grounded_ohm), 1e18),  # inf: floating
        "v_bias_v": float(network.v_bias_v),
    }
    if plan.drive.ripple:
        driver["follow"] = 1
    lines += [f"xrow{r} d_row{r} row{r} vbias 0 row_driver {_assignments(driver)}" for r in range(rows)]

    lines += _array(plan, frame, network)
    if network.c_row_f:
        lines += [f"crow{r} row{r} 0 {spice_number(float(network.c_row_f))}" for r in range(rows)]
    if network.c_column_f:
        lines += [f"ccolumn{c} col{c} 0 {spice_number(float(network.c_column_f))}" for c in range(cols)]
    pins = [f"row{r}" for r in range(rows)] + [f"col{c}" for c in range(cols)]
    lines.append(f"xarray {' '.join(pins)} array")

    for c in range(cols):
        node = f"col{c}"
        if direct and network.r_column_ohm[c]:
            node = f"vg{c}"
            lines.append(f"rcolumn{c} col{c} {node} {spice_number(float(network.r_column_ohm[c]))}")
        if leak := float(network.i_leak_a[c]):
            lines.append(f"ileak{c} 0 col{c} {spice_number(leak)}")
        values = _assignments(_channel_parameters(plan, network, c))
        lines.append(
            f"xch{c} {node} d_charge{c} d_preset comp{c} ibias vdd vss channel_{plan.topology} {values}"
        )
        if offset := float(plan.converter.i_offset_a[c]):
            summing = node if direct else f"xch{c}.v_sum"
            lines.append(f"ioffset{c} 0 {summing} {spice_number(-plan.converter.v_sign * offset)}")
    lines.append(options(has_pole(plan), clamp_bites(plan.converter)))
    probes = [f"comp{c}" for c in range(cols)]
    if record:
        probes += [integrator_node(c) for c in range(cols)]
    abrupt = (True,) * (rows + 1) + (False,) * cols
    return Deck(
        tuple(lines),
        source_names(rows, cols),
        tuple(levels),
        abrupt,
        tuple(probes),
        longest_step_s(plan.drive),
    )


def _bias(plan: Plan, frame: int) -> str:
    """The bias: a number, or a sine whose phase at the frame's first instant carries on from the frame before."""
    drive, level = plan.drive, plan.v_bias_v
    if not drive.ripple:
        return spice_number(level)
    if not drive.f_ripple_hz:  # ngspice would take one period a transient
        return spice_number(level * (1.0 + drive.ripple * math.sin(drive.phase_ripple_rad)))
    turns = drive.turns(plan.first_frame + frame, plan.timing.break_clocks, plan.timing.f_clk_hz)
    phase = math.degrees(drive.phase_ripple_rad) + 360.0 * turns
    numbers = (level, drive.ripple * level, drive.f_ripple_hz, 0.0, 0.0, phase)
    return f"sin({' '.join(spice_number(float(n)) for n in numbers)})"


def _array(plan: Plan, frame: int, network: Network) -> list[str]:
    """The array of one frame; its taxels move to those of the next frame if the plan says so."""
    slope = None
    g_taxel_s = network.g_taxel_s
    floor = plan.scene.design.array.r_floor_ohm
    if plan.drive.motion:
        now, then = (
            np.minimum(g, 1.0 / floor)
            for g in (network.g_taxel_s, plan.next_conductance_s(slice(frame, frame + 1))[0])
        )
        slope = (then - now) / plan.drive.t_frame_s
        g_taxel_s = now + slope * (plan.timing.break_clocks / plan.timing.f_clk_hz)
    with np.errstate(divide="ignore"):
        resistance = np.divide(1.0, g_taxel_s)
        row, column = (1.0 / g if g else None for g in (network.g_lateral_row_s, network.g_lateral_column_s))
    text = array_subckt(
        network.rows,
        network.cols,
        resistance,
        row,
        design=plan.scene.design,
        lateral_column_ohm=column,
        trace_row_ohm=float(network.r_trace_row_ohm),
        trace_column_ohm=float(network.r_trace_column_ohm),
        taxel_f=float(network.c_taxel_f),
        slope_s_per_s=slope,
    )
    return text.splitlines()


def options(pole: bool, clamp: bool = False) -> str:
    """The `.options` line of a deck with a time constant besides its integrators, without, or with a biting clamp."""
    return ".options " + _assignments(_OPTIONS_CLAMP if clamp else _OPTIONS_POLE if pole else _OPTIONS_EXACT)


def integrator_node(column: int) -> str:
    """Name of the integrator output of a channel in the flattened deck."""
    return f"xch{column}.xvfc.v_int"


# A leak this many clocks long bends a clock's straight line by 1 / (12 n^2) of what it takes: 3e-5 of a packet in all.
_LEAK_CLOCKS = 50.0


def has_pole(plan: Plan) -> bool:
    """Whether anything in the deck has a time constant besides the integrators that the steps must follow.

    Comparator, range clamp, bandwidth, slow mirror, capacitance, and an integrator that leaks within some clocks.
    What only moves (ripple, taxels) is followed well enough by steps of a clock, or of `longest_step_s`.
    """
    converter = plan.converter
    clamped = np.isfinite(converter.v_int_max_v) | np.isfinite(converter.v_int_min_v)
    fields = (converter.t_comp_delay_s, converter.v_hysteresis_v, converter.t_gbw_s, converter.q_mirror_c)
    capacitances = {"c_row_f", "c_column_f", "c_taxel_f"} & plan.surrounding.keys()
    if any(np.any(f) for f in fields) or np.any(clamped) or any(plan.surrounding[c] for c in capacitances):
        return True
    if not converter.inv_gain_dc.any():
        return False
    across = converter.g_in_s
    if plan.topology == "direct":
        across = across + plan.conductance_s().sum(axis=1).max(axis=0)
    leak = across * converter.inv_gain_dc / (converter.c_int_f * converter.f_clk_hz)
    return bool(np.any(leak * _LEAK_CLOCKS > 1.0))


def clamp_bites(converter: Converter) -> bool:
    """Whether the range of an integrator is so small that charge is lost in normal use."""
    room = np.minimum(converter.v_int_max_v, -converter.v_int_min_v)
    # A range of exactly so many packets, up to rounding, is enough.
    return bool(np.any(room < _SWING_PACKETS * converter.packet_v() * (1.0 - 1e-9)))


def longest_step_s(drive: Drive) -> float:
    """A fortieth of a period of the ripple, whose area trapezoids then have to 0.2 %; inf without."""
    return 1.0 / (40.0 * drive.f_ripple_hz) if drive.ripple and drive.f_ripple_hz else math.inf
