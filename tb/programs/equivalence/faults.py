# SPDX-License-Identifier: Apache-2.0
"""Faults of drawing and wiring, one of each kind, seeded in the channel of Fig. 5a: the gate must notice them."""

from __future__ import annotations

import shutil
from pathlib import Path

from dermis.files import write_atomic
from dermis.scene.extracted import CIRCUIT
from tb.programs.equivalence.gate import Case

LOOP = Case(codes=(0, 64, 240), clocks=48)
"""The column that has the faults."""

# A cut line is 1 Gohm, two joined lines are 10 ohm: an open node needs some path to have a voltage at all.
FAULTS = {
    "wrong_polarity": (
        "comparator.sp",
        "xp_first v_first v_pair vdd vdd pmos",
        "xp_first v_first v_pair vdd vdd nmos",
    ),
    "missing_device": ("bias.sp", "xn_sense v_load r_ref v_tail vss nmos w=40 l=4\n", ""),
    "open_drain": ("ota.sp", "xn_cascn out", "rcut out v_cut 1g\nxn_cascn v_cut"),
    "drain_and_source_joined": ("offset_null.sp", "xp_out v_amp", "rjoin v_amp vdd 10\nxp_out v_amp"),
    "gate_and_drain_swapped": ("conveyor.sp", "xn_follow vdd v_amp", "xn_follow v_amp vdd"),
    "wrong_ratio": (
        "mirror.sp",
        "mirror_fixed in out ibias vdd vss params: k=80\nxin in in vcn vss mirror_group units={k}",
        "mirror_fixed in out ibias vdd vss params: k=80\nxin in in vcn vss mirror_group units={k-1}",
    ),
    "controls_swapped": (
        "charge_source.sp",
        "on off v_high v_low vdd vss vdd_d vss_d steering_driver units={units}\nxn_source",
        "off on v_high v_low vdd vss vdd_d vss_d steering_driver units={units}\nxn_source",
    ),
    "inputs_swapped": ("vfc.sp", "xcomparator agnd v_int", "xcomparator v_int agnd"),
    "missing_switch": (
        "integrator.sp",
        "xs_unity iin v_amp on off vdd vss switch\nxc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7\n",
        "xc_int out iin sky130_fd_pr__cap_mim_m3_1 w=50 l=49.7\n",
    ),
    "switch_stuck_on": (
        "integrator.sp",
        "xs_preset out vref on off vdd vss switch\nxs_out",
        "xs_preset out vref vdd vss vdd vss switch\nxs_out",
    ),
    "switch_stuck_off": (
        "integrator.sp",
        "xs_out out v_amp off on vdd vss switch k=2",
        "xs_out out v_amp vss vdd vdd vss switch k=2",
    ),
}
"""File, text that occurs there once, text in its place, by kind of fault."""


def written(kind: str, folder: Path) -> Path:
    """Write a copy of spice/sky130 with a fault and return its folder."""
    file, right, wrong = FAULTS[kind]
    place = folder / kind
    shutil.copytree(CIRCUIT, place, dirs_exist_ok=True)
    text = (CIRCUIT / file).read_text(encoding="utf-8")
    if text.count(right) != 1:
        raise ValueError(f"{file}: {right!r} occurs {text.count(right)} times, not once")
    write_atomic(place / file, text.replace(right, wrong))
    return place
