# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_registers at several sizes."""

from __future__ import annotations

from pathlib import Path

import pytest
from rtl_run import simulate

from dermis.chip import register_map as rm
from dermis.scene.design import ROOT

SIZES = {"1x1x1": (1, 1, 1), "17x9x12": (17, 9, 12), "128x128x16": (128, 128, 16)}


def every_address(simulator: str, size: str, trap: Path | None = None) -> int:
    rows, cols, code_bits = SIZES[size]
    parameters = {"ROWS": rows, "COLS": cols, "CODE_BITS": code_bits, "GATE_CLOCKS": 300, "SETTLE_CLOCKS": 7}
    full = min(150, 2 ** (code_bits + 1) - 1)
    resets = {"GATE": 300, "SETTLE": 7, "DARK_MAX": -(-full // 32), "FULL_MIN": full - full // 16}
    sizes = {"rows": rows, "cols": cols, "code_bits": code_bits, "sync_latch": 1, "rounds": 1}
    got = simulate(
        simulator,
        "bench_registers",
        "dermis_registers",
        "every_address",
        parameters | {"SYNC_LATCH": 1},
        sizes | {"resets": resets},
        trap=trap,
    )
    return got["addresses"]


@pytest.mark.parametrize(
    ("simulator", "size"),
    [*(("icarus", size) for size in SIZES), pytest.param("verilator", "17x9x12", marks=pytest.mark.long)],
)
def test_every_address_is_the_register_of_the_map(simulator: str, size: str) -> None:
    addresses = every_address(simulator, size)
    assert addresses == sum(len(r.words(*SIZES[size])) for r in rm.REGISTERS.values())


FAULTS = {
    "a write without its address": ("      if (address_i == 8'h05) begin", "      begin"),
    "a word that does not exist answers": ("(m = 0; m < ROWS;", "(m = 0; m < ROWS + 16;"),
    "a read-only register takes a write": (
        "8'h08: begin\n          known = ~write_i;",
        "8'h08: begin\n          known = 1'b1;",
    ),
    "two columns share a pedestal": (
        "pedestal_d[CODE_BITS*n +: CODE_BITS]",
        "pedestal_d[CODE_BITS*(n/2) +: CODE_BITS]",
    ),
    "a pulse acts on a read": ("assign shot_o = write &", "assign shot_o = valid_i &"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    right, wrong = FAULTS[fault]
    text = (ROOT / "rtl" / "dermis_registers.v").read_text()
    assert right in text
    trap = tmp_path / "dermis_registers.v"
    trap.write_text(text.replace(right, wrong, 1))
    with pytest.raises(AssertionError, match=r"0 ran|1 failed"):
        every_address("icarus", "17x9x12", trap)
