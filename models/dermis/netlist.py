# SPDX-License-Identifier: Apache-2.0
"""The SPICE deck of a plan: row drivers, array and one channel a column, written from the records and nothing else.

A record field at its default writes nothing beyond the ideal setting of its block, so an effect that is off leaves no
element behind. Every number is formatted from a float and every name is made here: no text of a scene reaches a deck.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dermis import generate
from dermis.array import Network
from dermis.design import ROOT
from dermis.generate import spice_number
from dermis.ngspice import Deck
from dermis.plan import Plan
from dermis.vfc import Converter

SPICE = ROOT / "spice"

HONOURS = frozenset(
    {
        "r_row_driven_ohm",
        "r_row_grounded_ohm",
        "r_column_ohm",
        "v_column_offset_v",
        "g_lateral_row_s",
        "g_lateral_column_s",  # both ends on one column line: no element, no current
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
    }
    if direct:
        ideal["int_v_offset_v"] = (network.v_column_offset_v, 0.0)
    else:
        values["k"] = float(converter.k[column])
        ideal["conv_r_x_ohm"] = (network.r_column_ohm, 0.0)
        ideal["conv_v_offset_v"] = (network.v_column_offset_v, 0.0)
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
        f"vbias vbias 0 {spice_number(network.v_bias_v)}",
        "vibias ibias 0 0",
    ]
    # A dc value beside `external` crashes libngspice 39.
    lines += [f"{name} {name[2:]} 0 external" for name in source_names(rows, cols)]
    driver = {
        "r_on_ohm": float(network.r_row_driven_ohm),
        "r_ground_ohm": min(float(network.r_row_grounded_ohm), 1e18),  # inf: floating
        "v_bias_v": float(network.v_bias_v),
    }
    lines += [f"xrow{r} d_row{r} row{r} vbias 0 row_driver {_assignments(driver)}" for r in range(rows)]

    with np.errstate(divide="ignore"):
        resistance = np.divide(1.0, network.g_taxel_s)
        lateral = 1.0 / network.g_lateral_row_s if network.g_lateral_row_s else None
    lines += generate.array_subckt(rows, cols, resistance, lateral, design=plan.scene.design).splitlines()
    pins = [f"row{r}" for r in range(rows)] + [f"col{c}" for c in range(cols)]
    lines.append(f"xarray {' '.join(pins)} array")

    for c in range(cols):
        node = f"col{c}"
        if direct and network.r_column_ohm[c]:
            node = f"vg{c}"
            lines.append(f"rcolumn{c} col{c} {node} {spice_number(float(network.r_column_ohm[c]))}")
        values = _assignments(_channel_parameters(plan, network, c))
        lines.append(
            f"xch{c} {node} d_charge{c} d_preset comp{c} ibias vdd vss channel_{plan.topology} {values}"
        )
        if offset := float(plan.converter.i_offset_a[c]):
            summing = node if direct else f"xch{c}.v_sum"
            lines.append(f"ioffset{c} 0 {summing} {spice_number(-plan.converter.v_sign * offset)}")
    lines.append(options(has_pole(plan.converter)))
    probes = [f"comp{c}" for c in range(cols)]
    if record:
        probes += [integrator_node(c) for c in range(cols)]
    abrupt = (True,) * (rows + 1) + (False,) * cols
    return Deck(tuple(lines), source_names(rows, cols), tuple(levels), abrupt, tuple(probes))


def options(pole: bool) -> str:
    """The `.options` line of a deck that has a time constant besides its integrators, or none."""
    return ".options " + _assignments(_OPTIONS_POLE if pole else _OPTIONS_EXACT)


def integrator_node(column: int) -> str:
    """Name of the integrator output of a channel in the flattened deck."""
    return f"xch{column}.xvfc.v_int"


def has_pole(converter: Converter) -> bool:
    """Whether anything in the deck has a time constant besides the integrators: comparator, range clamp."""
    clamped = np.isfinite(converter.v_int_max_v) | np.isfinite(converter.v_int_min_v)
    return bool(np.any(converter.t_comp_delay_s) or np.any(converter.v_hysteresis_v) or np.any(clamped))
