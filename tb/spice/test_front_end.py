# SPDX-License-Identifier: Apache-2.0
"""The circuits of spice/sky130 as they would be drawn: devices and pins alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from dermis.scene.extracted import CIRCUIT

DIRECTIVES = {".subckt", ".ends", ".include"}


def ideal(text: str) -> Iterator[str]:
    """Lines of a netlist that no layout could hold: a source, a global net, node 0, a circuit chosen by a parameter."""
    for line in text.splitlines():
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
        "ehigh high 0 d 0 3.3",
        "ehigh high vss d vss_d 3.3",
        "gpacket out vss d_charge vss_d 25u",
        "fout 0 out vin 1",
        "hout out vss vsum 1",
        "bdrive row agnd v = v(d_row)",
        "vpedout v_pedcopy out 0",
        "rref v_r agnd 50k",
        "xn_off 0 off v_tail vss nmos w=5 l=0.5",
        ".global vref",
        ".if (polarity > 0)",
    ],
)
def test_an_ideal_element_is_noticed(line: str) -> None:
    text = (CIRCUIT / "charge_source.sp").read_text()
    assert list(ideal(text.replace(".ends charge_source\n", f"{line}\n.ends charge_source\n"))) == [line]
