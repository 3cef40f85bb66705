# SPDX-License-Identifier: Apache-2.0
"""Claims about what is written from the register map."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from dermis.chip import register_map as rm
from dermis.errors import InputError
from dermis.scene import design as design_module
from dermis.scene.design import ROOT
from scripts import register_files as rf

DESIGN = design_module.load(ROOT / "models" / "design.toml")


def map_with(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """A root whose map was changed."""
    text = (ROOT / rf.SOURCE).read_text()
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new, 1)
    (tmp_path / "rtl").mkdir()
    (tmp_path / rf.SOURCE).write_text(text)
    return tmp_path


def test_design_numbers_come_from_the_design(tmp_path: Path) -> None:
    # The map's own defaults are for a reader of it alone; a design overrides every one of them.
    changes = (("GATE_CLOCKS   = 510", "GATE_CLOCKS   = 1"), ("RANGE_INDEX   = 2", "RANGE_INDEX   = 0"))
    root = map_with(tmp_path, *changes)
    assert rf.files(DESIGN, root) == rf.files(DESIGN, ROOT)
    assert rm.REGISTERS["GATE"].reset == DESIGN.timing.gate_clocks
    assert rm.REGISTERS["SETTLE"].reset == DESIGN.timing.settle_clocks
    assert DESIGN.interface.k_options[rm.REGISTERS["RANGE"].reset] == DESIGN.interface.k
    assert rm.REGISTERS["GEOMETRY"].reset == DESIGN.array.rows << 8 | DESIGN.array.cols
    # A good chip passes the self-test as it is after reset.
    counts_per_a = DESIGN.timing.gate_clocks / (DESIGN.interface.k * DESIGN.converter.i0_a)
    assert rm.REGISTERS["FULL_MIN"].reset == int(0.8 * counts_per_a * DESIGN.calibration.i_test_a)
    assert rm.REGISTERS["DARK_MAX"].reset >= 2 * int(counts_per_a * DESIGN.calibration.i_pedestal_a)


def test_a_changed_map_changes_every_file(tmp_path: Path) -> None:
    changes = (("TEST_RATE @ 0x16;", "TEST_SPEED @ 0x16;"), ("FULL_MIN @ 0x1C;", "FULL_MIN @ 0x1E;"))
    root = map_with(tmp_path, *changes)
    changed = rf.files(DESIGN, root)
    python = changed["models/dermis/chip/register_map.py"]
    assert all(
        "TEST_SPEED" in text for text in (changed["rtl/dermis_registers.h"], python, rf.table(DESIGN, root))
    )
    assert re.search(r"8'h0F\) begin\s+full_min_q <= wdata_i;", changed["rtl/dermis_registers.v"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("} TEST_RATE @ 0x16;", "} TEST_RATE @ 0x16", "SystemRDL"),
        ('hw = r; desc = "pulses per clock', 'hw = rw; desc = "pulses per clock', "TEST_RATE.test_rate"),
        ("regwidth    = 16", "regwidth    = 32", "regwidth"),
        ('lanes = "ROWS"; lane_bits = "1";', 'lane_bits = "1";', "ROW_MASK"),
    ],
)
def test_a_map_that_cannot_be_written_is_wrong_input(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        rf.files(DESIGN, map_with(tmp_path, (old, new)))
    assert caught.value.exit_code == 2
    assert said in str(caught.value) or "SystemRDL" in str(caught.value)


def test_the_c_header_compiles_and_agrees(tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    names = ["ID", "ROW_MASK", "PEDESTAL", "CONTROL_PEDESTAL_MODE_MASK", "CONTROL_PEDESTAL_MODE_SHIFT"]
    checks = "\n".join(f'_Static_assert(DERMIS_{n} == {getattr(rm, n)}, "{n}");' for n in names)
    checks += f'\n_Static_assert(DERMIS_GATE_RESET == {DESIGN.timing.gate_clocks}, "gate");'
    source = tmp_path / "check.c"
    source.write_text(f'#include "dermis_registers.h"\n{checks}\n')
    command = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{ROOT / 'rtl'}", "-c", str(source)]
    subprocess.run([*command, "-o", str(tmp_path / "check.o")], check=True, timeout=60)
