# SPDX-License-Identifier: Apache-2.0
"""The circuits of spice/sky130 as they would be drawn: devices and pins alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from dermis.chip import sky130, spice_batch
from dermis.scene import design
from dermis.scene.extracted import CIRCUIT
from scripts.characterise import benches
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


def test_the_circuits_have_devices_and_pins_alone() -> None:
    files = sorted(f for f in CIRCUIT.iterdir() if f.suffix in (".sp", ".inc"))
    assert len(files) > 15
    found = {f.name: list(ideal(f.read_text())) for f in files}
    # The four transistors of the wheel are wrapped in subcircuits, whose device is an x line as well.
    assert {name: lines for name, lines in found.items() if lines} == {}


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


# Two rows and two columns: 1 kohm and 10 kohm a taxel, row 0 driven, then row 1 with the test current on column 1.
# From its enable the bias takes up to 14 us (sky130.start_up_s) and a column as much again at ss, -40 C.
_NETS = {
    "enable": "0 0 2u 0 2.01u 1 70u 1 70.01u 0",
    "preset": "0 1 40u 1 40.001u 0 58u 0 58.01u 1",
    "row0": "0 1 53u 1 53.01u 0",
    "row1": "0 0 53u 0 53.01u 1",
    "charge0": "0 0 50u 0 50.001u 1 50.2u 1 50.201u 0",
    "charge1": "0 0",
    "range0": "0 0",
    "range1": "0 1",
    "range2": "0 1",
    "range3": "0 0",
    "test0": "0 0",
    "test1": "0 0 53u 0 53.01u 1",
}
_MEASURES = {
    "i_off": "i(vdd_x) at=1.9u",
    "i_on": "i(vdd_x) at=39u",
    "i_down": "i(vdd_x) at=94u",
    "sense0": "v(d_sense0) at=50u",
    "sense1": "v(d_sense1) at=50u",
    "sense0_later": "v(d_sense0) at=57u",
    "sense1_later": "v(d_sense1) at=57u",
    "comp_held": "v(comp0) at=39.9u",
    "comp_past": "v(comp0) at=49.9u",
    "fast_0": "v(xdut.xcolumn0.xvfc.v_int) at=40.2u",
    "fast_1": "v(xdut.xcolumn0.xvfc.v_int) at=40.6u",
    "slow_0": "v(xdut.xcolumn1.xvfc.v_int) at=40.5u",
    "slow_1": "v(xdut.xcolumn1.xvfc.v_int) at=42.5u",
    "i_test": "i(vbias) at=65u",
}


@pytest.mark.parametrize(
    "condition", [Condition(), pytest.param(Condition("ss", -40.0, 0.9), marks=pytest.mark.long)], ids=str
)
def test_the_front_end_starts_converts_senses_tests_and_stops(tmp_path: Path, condition: Condition) -> None:
    """The generated netlist with two rows and two columns, from power-up without bias to power-down."""
    pins = " ".join({"r_ref": "r_ref_x", "vdd": "vdd_front"}.get(p, p) for p in sky130.front_end_pins(2, 2))
    taxels = "".join(f"rt{r}{c} row{r} col{c} {1e3 * 10**c}\n" for r in range(2) for c in range(2))
    body = (
        sky130.front_end(2, 2)
        + f"vbias vbias agnd 0.5\nvdd_x vdd vdd_front 0\nxdut {pins} dermis_analog_front_end\n"
        + f"rref_x r_ref_x agnd 50k\n{taxels}cc0 col0 0 400p\ncc1 col1 0 400p\n"
        + "".join(f"v_{name} logic_{name} 0 pwl({points})\n" for name, points in _NETS.items())
        + ".tran 50n 95u\n"
        + "".join(f".meas tran {name} find {what}\n" for name, what in _MEASURES.items())
    )
    deck = tmp_path / "front_end.sp"
    deck.write_text(benches.deck(body, condition))
    found = spice_batch.run(deck, limit_s=200.0).values
    # Two columns take 1.1 mA; off, what is left is the dividers of the steering pairs and the reference's start branch.
    assert found["i_on"] > 0.8e-3
    assert abs(found["i_off"]) < 40e-6
    assert abs(found["i_down"]) < 40e-6
    low = -benches.SUPPLY_V * condition.supply
    high = low + sky130.logic_v(condition.supply)
    levels = {"sense0": high, "sense1": low, "sense0_later": low, "sense1_later": high}
    levels |= {"comp_held": low, "comp_past": high}
    # The core reads a level within a tenth of its supply; the gates are rail to rail.
    assert {n: found[n] for n in levels} == pytest.approx(levels, abs=0.18)
    pedestal_a = 16e-6
    fast, slow = (0.5e-3 + pedestal_a) / 80, (0.05e-3 + pedestal_a) / 40
    # 0.5 V over 1 kohm by 80, and over 10 kohm by 40, each with the pedestal: 0.5 mV of column and 0.5 % of mirror are
    # a hundredth at most.
    assert 5e-12 * (found["fast_0"] - found["fast_1"]) / 0.4e-6 == pytest.approx(fast, rel=0.01)
    assert 5e-12 * (found["slow_0"] - found["slow_1"]) / 2e-6 == pytest.approx(slow, rel=0.02)
    # The test current goes with the poly's own coefficients.
    at_27, here = (1.0 - 2.47e-3 * (c - 25.0) + 2.7e-6 * (c - 25.0) ** 2 for c in (27.0, condition.celsius))
    i_test_a = design.load().calibration.i_test_a * at_27 / here
    # Row 1 and the test current: the column's few millivolts are a hundredth of 0.5 V at most.
    assert -found["i_test"] == pytest.approx(0.55e-3 + i_test_a, rel=0.01)
