# SPDX-License-Identifier: Apache-2.0
"""The circuits of spice/sky130 as they would be drawn: devices and pins alone."""

from collections.abc import Iterator

import pytest

from dermis.chip import sky130
from dermis.report import verdict
from dermis.scene.extracted import CIRCUIT
from scripts.characterise import benches, runs
from scripts.characterise.benches import Condition

DIRECTIVES = {".subckt", ".ends", ".include"}


def ideal(text: str) -> Iterator[str]:
    """Lines of a netlist that no layout could hold: a source, a global net, node 0, a circuit chosen by a parameter."""
    for line in text.replace("\n+", "").splitlines():
        words = line.lower().split()
        if not words or line.startswith("*"):
            continue
        nodes = [word for word in words[1:] if "=" not in word and word != "params:"]
        if (words[0][0] != "x" and words[0] not in DIRECTIVES) or "0" in nodes:
            yield line


def test_every_pad_to_the_board_has_its_cell_and_the_supplies_a_clamp() -> None:
    for rows, cols in ((2, 3), (16, 16)):
        lines = [line.split() for line in sky130.front_end(rows, cols).splitlines()]
        pads = ["vbias", "vref", "r_ref", "agnd", *(f"row{r}" for r in range(rows))]
        pads += [f"col{c}" for c in range(cols)]
        cells = [line[1:] for line in lines if line and line[-1] == "esd_pad"]
        assert sorted(cells) == sorted([pad, "vdd", "vss", "esd_pad"] for pad in pads)
        assert ["xclamp", "vdd", "vss", "esd_clamp"] in lines


def test_the_circuits_have_devices_and_pins_alone() -> None:
    files = sorted(f for f in CIRCUIT.iterdir() if f.suffix in (".sp", ".inc"))
    assert len(files) > 15
    # The four transistors of the wheel are wrapped in subcircuits, whose device is an x line as well.
    assert {f.name: lines for f in files if (lines := list(ideal(f.read_text())))} == {}


@pytest.mark.parametrize(
    "line",
    [
        "gpacket out vss d_charge vss_d 25u",
        "rref v_r agnd 50k",
        "xn_off 0 off v_tail vss nmos w=5 l=0.5",
        ".global vref",
        ".if (polarity > 0)",
    ],
)
def test_an_ideal_element_is_noticed(line: str) -> None:
    text = (CIRCUIT / "charge_source.sp").read_text()
    assert list(ideal(text.replace(".ends charge_source\n", f"{line}\n.ends charge_source\n"))) == [line]


@pytest.mark.parametrize(
    "condition", [Condition(), pytest.param(Condition("ss", -40.0, 0.9), marks=pytest.mark.long)], ids=str
)
def test_the_front_end_starts_converts_senses_tests_and_stops(condition: Condition) -> None:
    """The generated netlist with two rows and two columns, from power-up without bias to power-down."""
    bench = benches.BENCHES["front_end"]
    for name, value in bench.values(runs.measured(bench.body, condition)).items():
        row = verdict.judge(f"sky130.{name}", value)
        assert row["status"] == "PASS", row


# A wrong net of the top, and the quantity that it moves by at least so much.
WRONG = [
    ("xbias vref", "xbias vbias", "error.packet", 0.05),
    ("d_charge0 d_preset d_range0 d_range1", "d_charge0 d_preset d_range2 d_range3", "error.fast", 0.5),
    ("xsense1 row1", "xsense1 row0", "output_v", 0.5),
    ("xcolumn1 col1 d_charge1", "xcolumn1 col1 d_charge0", "error.slow", 0.5),
]


@pytest.mark.parametrize("nets", [WRONG[:3], *(pytest.param([w], marks=pytest.mark.long) for w in WRONG)])
def test_a_wrong_net_of_the_top_is_noticed(nets: list[tuple[str, str, str, float]]) -> None:
    """Three at once, as each moves another quantity: ngspice takes 8 s. The bias moves the fast column by 0.1."""
    text = (bench := benches.BENCHES["front_end"]).body
    for right, wrong, _, _ in nets:
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    found = bench.values(runs.measured(text, Condition()))
    for _, _, name, least in nets:
        assert abs(value := found[f"front_end_{name}"]) > least
        assert verdict.judge(f"sky130.front_end_{name}", value)["status"] == "FAIL"
