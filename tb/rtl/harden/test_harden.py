# SPDX-License-Identifier: Apache-2.0
"""Claims about what is handed over: the wrapper's pads, the black box's pins, one file list, files that exist."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from rtl_run import simulate

from dermis.design import ROOT
from dermis.lint import rtl_include_dirs, rtl_sources

pytestmark = pytest.mark.timeout(120)
HARDEN = ROOT / "rtl" / "harden"
WRAPPER = HARDEN / "user_analog_project_wrapper.v"
STUB = Path(__file__).resolve().parent / "dermis_analog_front_end.v"
CIPO, READY, PADS = 8, 9, 27


def read_out(wrapper: Path = WRAPPER) -> dict:
    return simulate("icarus", "bench_wrapper", WRAPPER.stem, "read_out", around=[STUB, wrapper])


def test_chip_is_read_through_the_pads_of_the_wrapper() -> None:
    seen = read_out()
    every = (1 << PADS) - 1
    assert seen["identity"] == 0xDE01
    assert seen["geometry"] == 0x0808
    # The stub's comparators are always high: every second sample of a gate of 20.
    assert seen["codes"] == [[10] * 8] * 8
    # Only the interrupt pad drives, and the host's input while it talks.
    assert seen["idle"] == every & ~(1 << READY)
    assert seen["selected"] == every & ~(1 << READY) & ~(1 << CIPO)


@pytest.mark.parametrize(
    ("old", "new"),
    [("io_in[SCK]", "io_in[COPI + 4]"), ("(n == CIPO) ? cipo :", "(n == CIPO + 2) ? cipo :")],
    ids=["sck_elsewhere", "cipo_elsewhere"],
)
def test_wrong_pad_is_seen(tmp_path: Path, old: str, new: str) -> None:
    text = WRAPPER.read_text()
    assert text.count(old) == 1
    wrong = tmp_path / WRAPPER.name
    wrong.write_text(text.replace(old, new))
    with pytest.raises(AssertionError, match="read_out on icarus"):
        read_out(wrong)


def ports(path: Path) -> set[str]:
    return set(
        re.findall(r"^ +(?:input|output|inout) +wire +(?:\[[^]]*\] +)?(\w+)", path.read_text(), re.MULTILINE)
    )


def pins(block: str) -> set[str]:
    text = (ROOT / "spice" / "behavioural" / f"{block}.sp").read_text()
    found = re.search(rf"^\.subckt {block} ([^=\n]*?)(?: \w+ ?=.*)?$", text, re.MULTILINE)
    assert found, block
    return set(found[1].split())


def test_black_box_has_the_pins_of_the_spice_blocks() -> None:
    """Every pin of row driver, channel and mirror is there; two more have no circuit yet."""
    spice = set().union(*map(pins, ("row_driver", "channel_conveyor_mirror", "mirror")))
    inner = {"in", "out", "vss_ref", "d_k0", "d_k1"}
    black_box = ports(HARDEN / "dermis_analog_front_end.v") - {"vdd_d", "vss_d"}
    assert black_box - {"d_range", "d_sense", "d_test"} == spice - inner
    assert {"d_k0", "d_k1"} <= spice  # d_range is these two


def test_configuration_takes_the_sources_of_the_one_file_list() -> None:
    config = json.loads((HARDEN / "config.json").read_text())
    pattern = config["VERILOG_FILES"].removeprefix("dir::")
    assert sorted(p.resolve() for p in HARDEN.glob(pattern)) == sorted(p.resolve() for p in rtl_sources())
    includes = [(HARDEN / d.removeprefix("dir::")).resolve() for d in config["VERILOG_INCLUDE_DIRS"]]
    assert includes == [d.resolve() for d in rtl_include_dirs()]
    for key in ("PNR_SDC_FILE", "SIGNOFF_SDC_FILE", "FALLBACK_SDC", "LINTER_VLT", "IO_PIN_ORDER_CFG"):
        assert (HARDEN / config[key].removeprefix("dir::")).is_file(), key


def test_pin_order_names_every_port_of_the_top_once() -> None:
    patterns = [
        line.strip()
        for line in (HARDEN / "pin_order.cfg").read_text().splitlines()
        if line.strip() and line[0] not in "#@"
    ]
    names = ports(ROOT / "rtl" / "dermis_top.v")
    for name in names:
        matching = [p for p in patterns if re.fullmatch(p, name) or re.fullmatch(p, f"{name}[3]")]
        assert len(matching) == 1, (name, matching)
    for pattern in patterns:
        assert any(re.fullmatch(pattern, n) or re.fullmatch(pattern, f"{n}[3]") for n in names), pattern


def test_fusesoc_core_has_the_one_file_list() -> None:
    """Order and content; the core file is a second spelling of rtl/files.f that cannot drift."""
    text = (ROOT / "rtl" / "dermis.core").read_text()
    listed = re.findall(r"^ +- (dermis_\w+\.v)\b", text, re.MULTILINE)
    assert listed == [p.name for p in rtl_sources()]
    assert re.findall(r"^ +- (\w+\.vh) ?: ?\{is_include_file ?: ?true", text, re.MULTILINE) == [
        p.name for d in rtl_include_dirs() for p in sorted(d.glob("*.vh"))
    ]
