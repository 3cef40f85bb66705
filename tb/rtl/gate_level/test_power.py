# SPDX-License-Identifier: Apache-2.0
"""The power of a netlist against a sum by hand."""

import json
from pathlib import Path

import pytest

from dermis.errors import SimulatorError
from scripts.synth import power
from scripts.synth.cells import TECHNOLOGIES
from scripts.synth.map import Netlist

SKY130 = TECHNOLOGIES["sky130"]
VCD = """$timescale
\t1ps
$end
$var wire 1 ! clk_i $end
$var wire 2 " two [1:0] $end
$var wire 1 # other $end
$enddefinitions $end
#0
0!
bx "
x#
#1000
1!
b1 "
1#
#2000
0!
b10 "
#4000
1!
b11 "
"""


def test_changes_are_counted_bit_by_bit_and_unknown_levels_are_none(tmp_path: Path) -> None:
    (tmp_path / "a.vcd").write_text(VCD)
    assert power.toggles(tmp_path / "a.vcd") == ({"clk_i": [3], "two": [2, 1], "other": [0]}, 4.0)
    (tmp_path / "a.vcd").write_text("$timescale 1ps\n")
    with pytest.raises(SimulatorError, match="no changes"):
        power.toggles(tmp_path / "a.vcd")


def test_power_is_half_of_c_v_squared_a_change_and_what_cells_add(tmp_path: Path) -> None:
    kind = "sky130_fd_sc_hd__dfrtp_1"
    directions = {"CLK": "input", "D": "input", "RESET_B": "input", "Q": "output"}
    nets = {"CLK": [2], "D": [3], "RESET_B": ["1"], "Q": [4]}
    flop = {"type": kind, "port_directions": directions, "connections": nets}
    nets = {"clk_i": {"bits": [2]}, "two": {"bits": [3, 4]}}
    module = {"attributes": {"top": "1"}, "cells": {"a": flop, "b": flop}, "netnames": nets}
    (tmp_path / "n.json").write_text(json.dumps({"modules": {"dermis_top": module}}))
    netlist = Netlist(SKY130, tmp_path, tmp_path / "n.v", tmp_path / "n.json")
    found = power.power_uw(netlist, 2.0, {"clk_i": [10], "two": [4, 8]}, 100.0, lambda kind, pin: 5.0)
    pins = {"CLK": 1.7, "D": 1.7}  # fF, about: the Liberty has them
    assert found["cells"] == 2 * 10 * 5.0 / 100
    for name, pin, changes in (("clock", "CLK", 10), ("nets", "D", 4)):
        about = 0.5 * 2 * (pins[pin] + SKY130.wire_ff_per_sink) * 4 * changes / 100
        # Capacitances of pins above have two digits.
        assert found[name] == pytest.approx(about, rel=0.1)
