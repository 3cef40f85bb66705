# SPDX-License-Identifier: Apache-2.0
"""The allow-list of deck lines accepts every deck of the project, and no line that could be a command."""

import re
import tomllib
from pathlib import Path

import pytest

from dermis import plan, records
from dermis.chip import netlist, sky130
from dermis.effects import EFFECTS
from dermis.errors import InputError
from dermis.scene import scene
from dermis.scene.design import ROOT, TOPOLOGIES
from tb.programs.fuzz import deck


def with_everything(topology: str) -> records.Plan:
    """Return a plan with every effect of an interface that cosim accepts in combination."""
    effects = {name: True for name, effect in EFFECTS.items() if topology in effect.topologies}
    stimulus = {"kind": "ramp", "force_n": [0.0, 5.0], "frames": 2}
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": stimulus, "interface": {"topology": topology}}
    while True:
        try:
            return plan.whole(scene.from_data({**data, "effects": effects}, Path("made.toml")), "cosim")
        except InputError as error:
            del effects[error.key.split(".")[1].split()[0]]


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_line_of_a_deck_with_every_effect_has_an_allowed_form(topology: str) -> None:
    made = with_everything(topology)
    assert len(made.on) > 15
    lines = netlist.frame_deck(made, 0, [0.0] * 5, record=True).lines
    assert deck.strange_lines(lines) == []
    assert len(lines) > 40


VIEWS = (
    '"sky130"',
    '{ corner = "sf", temperature_c = -40.0, supply_scale = 0.9 }',
    '{ conveyor = "behavioural", corner = "fs" }',
    '{ row_driver = "behavioural", integrator = "behavioural", columns = [1] }',
    '{ default = "behavioural", row_driver = "sky130", corner = "ss" }',
    '{ default = "behavioural", conveyor = "sky130", corner = "ff" }',
    '{ default = "behavioural", comparator = "sky130", columns = [0] }',
)
CONVEYOR = 'conveyor = "sky130"'
"""Alone it is refused for the direct interface, which has no conveyor (tb/system/test_views.py)."""


@pytest.mark.parametrize(
    ("views", "topology"), [(v, t) for v in VIEWS for t in TOPOLOGIES if t != "direct" or CONVEYOR not in v]
)
def test_every_line_of_a_deck_of_views_has_an_allowed_form(views: str, topology: str) -> None:
    """The whole array, and each circuit that is solved apart, with other columns as a resistor."""
    stimulus = {"kind": "ramp", "force_n": [0.0, 5.0], "frames": 2}
    inputs = {"column_input": {"r_ohm": 20.0}, "column_offset": True}
    on = {} if CONVEYOR in views else inputs
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": stimulus, "interface": {"topology": topology}}
    data |= {"run": {"engine": "cosim", **tomllib.loads(f"views = {views}")}, "effects": on}
    made = plan.make(scene.from_data(data, Path("made.toml")))
    for columns in (None, *netlist.parts(made)):
        lines = netlist.frame_deck(made, 1, [0.0] * 5, record=True, columns=columns).lines
        assert deck.strange_lines(lines) == []


def strange_parameters(text: str) -> list[str]:
    """Return the lines of a parameter file that are neither `.param name = number` nor a comment."""
    known = rf"\.param [a-z][a-z0-9_]* = {deck.NUMBER}|\*[ -~]*"
    return [line for line in text.split("\n") if line and not re.fullmatch(known, line)]


def test_the_parameters_of_the_design_have_the_allowed_form() -> None:
    text = (ROOT / "spice" / "design.inc").read_text()
    assert strange_parameters(text) == []
    assert text.count(".param") > 60


@pytest.mark.parametrize(
    "line",
    [
        ".control", "shell touch x", "* a comment", "", '.include "/etc/passwd"', ".lib 'x' tt", "quit", ".end",
        "+ r0 ; shell", "rtaxel_r0c0 r0 c0 1e3\n.control", "rtaxel_r0c0 r0 c0 1k", "rtaxel_r0c0 r0 c0 nan",
        "rtaxel_r0c0 r0 c0 {x}", "rtaxel_r0c0 r0 c0 `id`", "RTAXEL_R0C0 r0 c0 1e3", "rtaxel_r٣c0 r0 c0 1.0",
        "btaxel_r0c0 r0 c0 i = system(x)", "btaxel_r0c0 r0 c0 i = v(r0,c0)*(1 + (2)*time)\nquit",
        "xch0 col0 d_charge0 d_preset comp0 0 0 ibias vdd vss 0 0 channel_direct k=80.0 x=$(id)",
        ".options reltol=1e-3 post",  # a line that must be refused, no tolerance
        ".param comparator_early_s={x}", "dermis frame 0: 2 x 2, direct\n.control", "\trtaxel_r0c0 r0 c0 1.0",
        ".subckt other", ".temp {x}", f'.include "{ROOT}/build/sky130/../../etc/passwd"',
        f'.include "{sky130.models("tt")}"\n.control', f'.include "{ROOT}/spice/sky130/other.sp"',
    ],
)  # fmt: skip
def test_a_line_that_is_no_line_of_a_deck_is_refused(line: str) -> None:
    assert deck.strange_lines([line]) == [line]


@pytest.mark.parametrize(
    "line", [".param x = 1\n.control", ".param x = {a}", ".control", "* a\x1bb", ".param x = nan"]
)
def test_a_line_that_is_no_parameter_is_refused(line: str) -> None:
    assert strange_parameters(f"* fine\n.param a_b = 1e-05\n{line}\n")
