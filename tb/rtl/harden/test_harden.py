# SPDX-License-Identifier: Apache-2.0
"""Claims about what is handed over: the wrapper's pads, the black box's pins, one file list, files that exist."""

import json
import re
from pathlib import Path

import pytest
from rtl_run import simulate

from dermis.chip import sky130
from dermis.chip.sources import rtl_include_dirs, rtl_sources, verilator_root
from dermis.processes.children import output_of
from dermis.scene.design import ROOT
from dermis.scene.design import load as load_design
from scripts.synth.cells import TECHNOLOGIES, for_cells

pytestmark = pytest.mark.timeout(120)
HARDEN = ROOT / "rtl" / "harden"
WRAPPER = HARDEN / "user_analog_project_wrapper.v"
STUB = Path(__file__).resolve().parent / "dermis_analog_front_end.v"
CIPO, READY, PADS = 8, 9, 27


def test_chip_is_read_through_the_pads_of_the_wrapper() -> None:
    seen = simulate("icarus", "bench_wrapper", WRAPPER.stem, "read_out", around=[STUB, WRAPPER])
    every = (1 << PADS) - 1
    assert seen["identity"] == 0xDE01
    assert seen["geometry"] == 0x0808
    # The stub's comparators are always high: every second sample of a gate of 20.
    assert seen["codes"] == [[10] * 8] * 8
    # docs/handover.md: no bias in reset; of ready, preset and frame start only preset is high before a frame.
    assert (seen["bias"], seen["analyser"]) == ([0, 1], 0b010)
    # Only the interrupt pad drives, and the host's input while it talks.
    assert seen["idle"] == every & ~(1 << READY)
    assert seen["selected"] == every & ~(1 << READY) & ~(1 << CIPO)


def ports(path: Path) -> set[str]:
    return set(
        re.findall(r"^ +(?:input|output|inout) +wire +(?:\[[^]]*\] +)?(\w+)", path.read_text(), re.MULTILINE)
    )


def test_black_box_has_the_pins_of_the_top_netlist() -> None:
    """Bit for bit, from the netlist of the design's size; the black box has them as buses."""
    text = (ROOT / "spice" / "sky130" / "dermis_analog_front_end.sp").read_text()
    head = re.search(r"^\.subckt dermis_analog_front_end\n((?:\+.*\n)+)", text, re.MULTILINE)
    assert head
    pins = head[1].replace("+", " ").split()
    rows, cols = load_design().array.rows, load_design().array.cols
    assert pins == sky130.front_end_pins(rows, cols)
    box = (HARDEN / "dermis_analog_front_end.v").read_text()
    widths = {"ROWS-1": rows, "COLS-1": cols, "2*COLS-1": 2 * cols}
    declared = re.findall(r"(?:inout|input|output) +wire +(?:\[([^:]+):0\])? *(\w+)", box)
    assert {name for _, name in declared} == ports(HARDEN / "dermis_analog_front_end.v")
    bits = [f"{name}{n}" if width else name for width, name in declared for n in range(widths.get(width, 1))]
    assert sorted(bits) == sorted(pins)


def test_configuration_takes_the_sources_of_the_one_file_list() -> None:
    config = json.loads((HARDEN / "config.json").read_text())
    patterns = [pattern.removeprefix("dir::") for pattern in config["VERILOG_FILES"]]
    listed = sorted(path.resolve() for pattern in patterns for path in HARDEN.glob(pattern))
    assert listed == sorted(path.resolve() for path in for_cells(rtl_sources(), TECHNOLOGIES["sky130"]))
    includes = [(HARDEN / d.removeprefix("dir::")).resolve() for d in config["VERILOG_INCLUDE_DIRS"]]
    assert includes == [d.resolve() for d in rtl_include_dirs()]
    for key in ("PNR_SDC_FILE", "SIGNOFF_SDC_FILE", "FALLBACK_SDC", "LINTER_VLT", "IO_PIN_ORDER_CFG"):
        assert (HARDEN / config[key].removeprefix("dir::")).is_file(), key


def test_pin_order_names_every_port_of_the_top_once() -> None:
    patterns = re.findall(r"^([^#@\s]\S*)\s*$", (HARDEN / "pin_order.cfg").read_text(), re.MULTILINE)
    matched = []
    for name in ports(ROOT / "rtl" / "dermis_top.v"):
        matching = [p for p in patterns if re.fullmatch(p, name) or re.fullmatch(p, f"{name}[3]")]
        assert len(matching) == 1, (name, matching)
        matched += matching
    assert set(matched) == set(patterns)


def test_fusesoc_core_has_the_one_file_list() -> None:
    """Order and content; the core file is a second spelling of rtl/files.f that cannot drift."""
    text = (ROOT / "rtl" / "dermis.core").read_text()
    listed = re.findall(r"^ +- (dermis_\w+\.v)\b", text, re.MULTILINE)
    assert listed == [p.name for p in rtl_sources()]
    headers = [p.name for d in rtl_include_dirs() for p in sorted(d.glob("*.vh"))]
    assert re.findall(r"^ +- (\w+\.vh) ?: ?\{is_include_file ?: ?true", text, re.MULTILINE) == headers


# Caravan's numbering, from the comments in its example project's wrapper: (first and last index, first pad).
PADS_OF = {
    "io_in": ((0, 13, 0), (14, 26, 25)),
    "io_out": ((0, 13, 0), (14, 26, 25)),
    "gpio_analog": ((0, 6, 7), (7, 17, 25)),
    "gpio_noesd": ((0, 6, 7), (7, 17, 25)),
    "io_analog": ((0, 10, 14),),
}


def pad(port: str, index: int) -> int:
    """The mprj_io that a bit of one of the wrapper's ports is."""
    return next(pad + index - first for first, last, pad in PADS_OF[port] if first <= index <= last)


DIGITAL = {
    "SCK": "SCK",
    "CS, low active": "CS_N",
    "COPI": "COPI",
    "CIPO": "CIPO",
    "frame ready": "READY",
    "enable": "ENABLE",
    "row 0": "ROW_0",
    "reference voltage": "VREF",
}


def test_the_table_of_pads_is_that_of_the_wrapper() -> None:
    """Each signal of docs/handover.md has its own pad, if digital, row or reference that of the wrapper."""
    page = (ROOT / "docs" / "handover.md").read_text()
    table = re.findall(r"^\| (\d+) \| `(\w+)\[(\d+)\]` \| ([^|]+) \|", page, re.MULTILINE)
    assert len({number for number, *_ in table}) == len(table) == 6 + 2 * 8 + 4
    text = WRAPPER.read_text()
    value = {name: int(number) for name, number in re.findall(r"localparam (\w+) += (\d+);", text)}
    index = {signal: int(n) for _, _, n, signal in table}
    assert {signal: index[signal] for signal in DIGITAL} == {s: value[name] for s, name in DIGITAL.items()}
    for number, port, n, _ in table:
        assert pad(port, int(n)) == int(number) >= 5  # the lowest five are the housekeeping SPI's


def macro(text: str) -> str:
    """An empty 8x8 core with supply pins and without parameters, as a hardened one is."""
    header = text[text.index(") (") : text.index(");")]
    sized = re.sub(r"\bROWS\b|\bCOLS\b", "8", header.removeprefix(") ("))
    return f"module dermis_top (\n  inout wire vccd1,\n  inout wire vssd1,{sized});\nendmodule\n"


def test_wrapper_takes_a_hardened_macro(tmp_path: Path) -> None:
    """With supply pins and without parameters; a supply pin that is not connected is a warning."""
    core = tmp_path / "dermis_top.v"
    core.write_text(macro((ROOT / "rtl" / "dermis_top.v").read_text()))
    place = verilator_root()
    command = [place / "bin" / "verilator_bin", "--lint-only", "-DDERMIS_MACRO", "--top-module", WRAPPER.stem]
    command += [core, HARDEN / "dermis_analog_front_end.v", WRAPPER]

    def messages(*defines: str) -> list[tuple[str, str]]:
        said = output_of([*command, *defines], 60.0, ROOT, {"VERILATOR_ROOT": str(place)})[1]
        return re.findall(r"^%(?!Error: Exiting)(?:Warning-(\w+): .*'(\w+)')?", said, re.MULTILINE)

    assert messages("-DUSE_POWER_PINS") == []
    assert messages() == [("PINMISSING", "vccd1"), ("PINMISSING", "vssd1")]
