# SPDX-License-Identifier: Apache-2.0
"""The sheets of spice/schematic are the circuits of spice/sky130: a change on either side is found."""

import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from dermis.errors import InputError
from scripts.markdown import filled
from scripts.schematics import command
from scripts.schematics.command import SHEETS, Subckt, draw

pytestmark = pytest.mark.skipif(
    shutil.which("xschem") is None, reason="xschem (Debian package) is not installed; .ci/run needs it"
)


@pytest.fixture(scope="module")
def text() -> dict[str, Subckt]:
    return command.written()


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Subckt]:
    return command.drawn(tmp_path_factory.mktemp("all sheets"))


def test_every_subcircuit_has_a_sheet_that_is_its_netlist(text, sheets):
    rows = command.compare(text, sheets)
    assert [row for row in rows if row["status"] != "PASS"] == []
    assert len(rows) == len(text) - len(command.DEVICES)


def differences(text: dict[str, Subckt], sheets: dict[str, Subckt]) -> dict[str, str]:
    """Return what differs by subcircuit, of those that are not the same."""
    rows = command.compare(text, sheets)
    return {row["name"].removeprefix("schematics."): row["note"] for row in rows if row["status"] == "FAIL"}


def changed(place: Path, old: str, new: str) -> str:
    """Return the text of a file with one place of it changed."""
    return filled(place.read_text(encoding="utf-8"), {old: new}, place.name)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("xn_inp v_foldp inp v_tail vss nmos w=20", "xn_inp v_foldp inp v_tail vss nmos w=21"),
        ("k={2*pairs}", "k={3*pairs}"),
        ("xn_cascn out vcn", "xn_cascn out vcp"),
        ("xp_cascn out vcp v_foldn vdd pmos w=20 l=1 k={branches}\n", ""),
        ("xn_tail v_tail ibias vss vss nmos", "xn_tail v_tail ibias vss vss pmos"),
    ],
    ids=["width", "expression", "net", "device", "model"],
)
def test_a_change_of_the_text_is_found(old, new, text, sheets):
    faulty = text | command.parse(changed(command.TEXT / "ota.sp", old, new), Path("ota.sp"))
    assert differences(faulty, sheets).keys() == {"ota"}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("bias.sp", "w=0.69 l=403", "w=1 l=403"),
        ("bias.sp", "w=0.69 l=403", "w=0.69 l=403m"),
        ("conveyor.sp", "w=27.5 l=27.5", "w=31 l=27.5"),
        ("column.sp", "m=42 mult=42", "m=42"),
        ("bias.sp", "xstart vdd v_start vss", "xstart vdd v_start vdd"),
        ("ota.sp", "xn_cascn out vcn v_mn vss", "xn_cascn out vcn v_mn v_mn"),
    ],
)
def test_what_cannot_be_drawn_is_refused(text, file, old, new):
    assert command.undrawable(text) == []
    faulty = command.parse(changed(command.TEXT / file, old, new), Path(file))
    assert len(command.undrawable(faulty)) == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (".ends comparator", "", r"\.ends behind its elements"),
        (".ends comparator", ".ends inverter", "the .ends of it"),
        (
            ".ends comparator",
            ".ends comparator\n.subckt bias a b\nr1 a b 1\n.ends",
            "a name that no other file has",
        ),
    ],
)
def test_text_that_ngspice_refuses_or_ignores_is_refused(old, new, said, tmp_path):
    place = tmp_path / "sky130"
    shutil.copytree(command.TEXT, place)
    (place / "comparator.sp").write_text(changed(place / "comparator.sp", old, new), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        command.written(place)


SHEET_FAULTS = {
    "width": ("name=xn_inp w=20", "name=xn_inp w=21"),
    "net": ("lab=v_foldp", "lab=v_foldn"),
    "port": ("C {ipin.sym} -100 50 ", "C {lab.sym} -100 50 "),
}


@pytest.mark.parametrize("fault", [*SHEET_FAULTS, "swapped pins"])
def test_a_change_of_a_sheet_or_symbol_is_found(fault, text, tmp_path):
    place = tmp_path / "schematic"
    shutil.copytree(SHEETS, place)
    sheet, symbol = place / "ota.sch", place / "symbols" / "ota.sym"
    if fault in SHEET_FAULTS:
        sheet.write_text(changed(sheet, *SHEET_FAULTS[fault]), encoding="utf-8")
    else:
        lines = symbol.read_text(encoding="utf-8").splitlines()
        a, b = (next(n for n, line in enumerate(lines) if f"name={pin} " in line) for pin in ("inp", "inn"))
        lines[a], lines[b] = lines[b], lines[a]
        symbol.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert "ota" in differences(text, command.drawn(tmp_path / "work", place))


def test_a_subcircuit_on_one_side_alone_is_found(text, sheets):
    fewer = {name: subckt for name, subckt in sheets.items() if name != "switch"}
    assert differences(text, fewer)["switch"] == "no sheet"
    less = {name: subckt for name, subckt in text.items() if name != "switch"}
    assert differences(less, sheets)["switch"] == "a sheet without netlist"


def test_a_drawing_names_every_element_and_port(text):
    for sheet in sorted(SHEETS.glob("*.sch")):
        texts = [element.text for element in ElementTree.fromstring(draw(sheet)).iter() if element.text]
        words = {word for text_ in texts for word in command.bits(text_)}
        assert {*text[sheet.stem].elements, *text[sheet.stem].pins} <= words, sheet


def test_no_text_lies_on_another_text_or_on_a_wire():
    # A letter is half as wide as high, and at least 0.05 high below and 0.6 above its line, in every common font.
    for sheet in sorted(SHEETS.glob("*.sch")):
        boxes, wires = [], []
        for element in ElementTree.fromstring(draw(sheet)).iter():
            if element.tag.endswith("text"):
                x, y, size = (float(element.get(key)) for key in ("x", "y", "font-size"))
                width = 0.5 * size * len(element.text or "")
                left = x - width * ("start", "middle", "end").index(element.get("text-anchor")) / 2
                boxes.append((left, y - 0.6 * size, left + width, y - 0.05 * size, element.text))
            elif element.get("class") == "wire":
                (a, b), (c, d) = (map(float, p.split()) for p in element.get("d")[1:].split(" L"))
                wires.append((min(a, c), min(b, d), max(a, c), max(b, d), "wire"))
        for n, one in enumerate(boxes):
            for other in [*boxes[n + 1 :], *wires]:
                apart = one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]
                assert apart, (sheet.name, one[4], other[4])
