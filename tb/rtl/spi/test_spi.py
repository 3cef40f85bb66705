# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_spi alone, with its CRC."""

from pathlib import Path

import pytest
from rtl_run import changed, simulate


def test_every_command_and_every_answer(simulator: str) -> None:
    simulate(simulator, "bench_spi", "dermis_spi", "commands", {}, {"seed": 1, "rounds": 8})


def test_mode_3_works_as_well() -> None:
    simulate("icarus", "bench_spi", "dermis_spi", "commands", {}, {"seed": 2, "rounds": 4, "mode": 3})


def test_no_part_of_a_command_is_one(simulator: str) -> None:
    simulate(simulator, "bench_spi", "dermis_spi", "bits_and_resets")


FAULTS = {
    "no look at the CRC": ("commands", "(byte_in == crc_q)", "1'b1"),
    "the rest of a command behind a reset": ("bits_and_resets", "if (!begun_q) ", "if (1'b0) "),
    "CIPO with the rising edge": ("commands", "always @(negedge sck_i", "always @(posedge sck_i"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    testcase, right, wrong = FAULTS[fault]
    trap = changed(tmp_path, "dermis_spi", (right, wrong))
    with pytest.raises(AssertionError, match=r"0 ran|1 failed"):
        simulate("icarus", "bench_spi", "dermis_spi", testcase, {}, {"seed": 1, "rounds": 3}, trap=trap)
