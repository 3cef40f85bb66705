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
    "open_drain": ("ota.sp", "xn_cascn out", "rcut out v_cut 1g\nxn_cascn v_cut"),
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
    "switch_stuck_on": (
        "integrator.sp",
        "xs_preset out vref on_late off_late vdd vss switch",
        "xs_preset out vref vdd vss vdd vss switch",
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
