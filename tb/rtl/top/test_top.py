# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_top through its pins alone, so that they hold for a netlist as well."""

import os
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate, sync_random

from tb.reference.chip import SHORT, Duty

pytestmark = pytest.mark.timeout(170)

SMALL = {"ROWS": 4, "COLS": 5, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}
"""One build serves most tests: five columns are no power of two, and a frame lasts 264 clocks."""

FORMS = pytest.mark.parametrize("sync_latch", [0, 1], ids=["sync_ff", "sync_latch"])
WEIGHTS = [5, 2, 4, 2, 2, 5, 2, 1, 2]


def run(
    simulator: str, testcase: str, parameters: dict = SMALL, trap: Path | None = None, **scenario: Any
) -> Any:
    """One cocotb test of bench_top on a chip of these parameters."""
    scenario["parameters"] = parameters
    return simulate(simulator, "bench_top", "dermis_top", testcase, parameters, scenario, trap=trap)


def c_over_510(*codes: int) -> list[Duty]:
    return [(c, 510) for c in codes]


def form(sync_latch: int) -> dict[str, int]:
    """SMALL with a synchronizer; without a latch it is the build of most tests."""
    return SMALL | ({"SYNC_LATCH": 1} if sync_latch else {})


@FORMS
def test_the_client_library_reads_codes_that_are_exact(simulator: str, sync_latch: int) -> None:
    x = [c_over_510(0, 1, 2, 127, 128), c_over_510(254, 255, 100, 3, 37)]
    frames = 1 + (simulator == "verilator")
    got = run(simulator, "client", form(sync_latch) | {"ROWS": 2}, x=x, gate=510, sck_hz=2.5e6, frames=frames)
    assert got["codes"] == [[0, 1, 2, 127, 128], [254, 255, 100, 3, 37]]
    assert not any(map(any, got["overflow"]))


def test_a_short_reads_full_scale_with_its_overflow_bit(simulator: str) -> None:
    x = [[SHORT, (1, 2), (1, 4), (0, 1), (3, 1000)], [(1, 510)] * 5]
    got = run(simulator, "client", SMALL | {"ROWS": 2}, x=x, gate=516, sck_hz=5e6, frames=1)
    assert got["codes"][0][0] == got["codes"][0][1] == 255
    assert got["overflow"][0] == [True, True, False, False, False]


def test_configuration_changes_frames_and_their_rate(simulator: str) -> None:
    run(simulator, "configuration")


WIRED = {"ROWS": 18, "COLS": 19, "CODE_BITS": 10, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 9, "BREAK_CLOCKS": 3}
"""No parameter at its default, no row a column, more of both than a word has bits."""


def test_every_status_bit_header_flag_and_pin_is_wired(simulator: str) -> None:
    run(simulator, "wiring", WIRED)


PRESSED = [c_over_510(200, 100, 255, 0, 30)] * 4


@FORMS
def test_enable_takes_the_analog_side_off_without_a_clock(simulator: str, sync_latch: int) -> None:
    """In no time in the Verilog; on mapped gates in that of a flop and a gate (`dermis gl`)."""
    assert run(simulator, "off", form(sync_latch), x=PRESSED) == 0.0


@FORMS
def test_a_cut_at_any_time_corrupts_nothing(simulator: str, sync_latch: int) -> None:
    cuts = 400 if simulator == "verilator" else 40
    assert run(simulator, "cuts", form(sync_latch), x=PRESSED, seed=5, cuts=cuts) >= cuts // 8


MANY_ROWS = {"ROWS": 32, "COLS": 3, "CODE_BITS": 8, "GATE_CLOCKS": 60, "SETTLE_CLOCKS": 6}


@pytest.mark.timeout(900)
def test_settings_released_together_act_together(simulator: str) -> None:
    writes = 10_000 if simulator == "verilator" else 300
    assert run(simulator, "commits", MANY_ROWS, seed=7, writes=writes) >= writes // 20


@pytest.mark.long
def test_longest_and_shortest_slots_count_exactly(simulator: str) -> None:
    """All 16 bits in Verilator; Icarus would take a minute for the longest."""
    run(simulator, "lengths", longest=0xFFFF if simulator == "verilator" else 0x0FFF)


@pytest.mark.long
def test_counters_of_16_bits_wrap_or_stop_in_verilator() -> None:
    """FRAME_NUMBER wraps, LOST and SPI_ERRORS stop at their top; that far only in `make coverage`."""
    many = 70_000 if "DERMIS_COVERAGE" in os.environ else 700
    seen = run("verilator", "counters", many=many)
    most = 2**16 - 1
    assert many <= seen["number"] + 2**16 * (many > most) <= many + 10
    assert min(many - 2, most) <= seen["lost"] <= min(many + 10, most)
    assert min(many - 1, most) <= seen["errors"] <= min(many + 2, most)
    assert seen["lost_after_reset"] == seen["errors_after_reset"] == 0


SHORT_SIZES = "9x16x8x3 3x4x9".split()
"""Rows, columns, bits (8) and clocks of a break (1). A bank of 2^8 + 1 bytes, and two bytes for a code."""
SIZES = "8x8 16x16 64x64 16x1 16x1x12".split()


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "size", [*SHORT_SIZES, *(pytest.param(size, marks=pytest.mark.long) for size in SIZES)]
)
def test_every_size_answers_and_sends_exact_frames(simulator: str, size: str) -> None:
    numbers = [int(number) for number in size.split("x")]
    rows, cols, code_bits, break_clocks = numbers + [8, 1][len(numbers) - 2 :]
    more = {"CODE_BITS": code_bits, "BREAK_CLOCKS": break_clocks}
    run(simulator, "size", SMALL | {"ROWS": rows, "COLS": cols} | more)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_bank_of_more_than_32_kib_sends_exact_frames() -> None:
    """A length or an address of 15 bits would do at every other size. In one simulator: it takes minutes."""
    run("icarus", "size", SMALL | {"ROWS": 128, "COLS": 128, "CODE_BITS": 16, "BREAK_CLOCKS": 1})


RATIOS = [0.02, 0.1, 0.5, 0.8, 1.0, 1.05, 2.0, 5.0, 10.0]


@pytest.mark.long
def test_any_ratio_of_sck_to_clk(simulator: str) -> None:
    repeats, frames = (40, 8) if simulator == "verilator" else (3, 2)
    waits = run(simulator, "ratios", ratios=RATIOS, repeats=repeats, frames=frames)
    for row in waits:
        if row["ratio"] <= 0.8:
            assert max(row["write"][1], row["read"][1], row["frame"][1]) <= 1, row


def test_random_traffic_hangs_nothing_and_corrupts_nothing(simulator: str, tmp_path: Path) -> None:
    transactions = 5000 if simulator == "verilator" else 150
    trap = sync_random(tmp_path) if simulator == "icarus" else None
    run(simulator, "traffic", trap=trap, seed=1, transactions=transactions, slowest=0.7, weights=WEIGHTS)


# What is wrong -> module, right, wrong, the test that must fail.
FAULTS = {
    "a write without a look at its CRC": ("dermis_spi", "(byte_in == crc_q)", "1'b1", "traffic"),
    "a gate one clock too long": ("dermis_register_port", "= wdata_i;", "= wdata_i | 16'd1;", "configuration"),
    "rows that need the clock": ("dermis_safe_outputs", "row_select_i & {ROWS{on_q}}", "row_select_i", "off"),
    "a preset that needs the clock": ("dermis_safe_outputs", "preset_i | ~on_q", "preset_i", "off"),
    "a cut that the core does not see": ("dermis_safe_outputs", ".d_i    (on_q)", ".d_i    (enable_i)", "cuts"),
    "a row that was cut but delivered": ("dermis_reader", "loaded & enable_i;", "loaded;", "cuts"),
    "a frame begun under hold": ("dermis_row_scanner", "| test_q) & ~hold_i", "| test_q)", "commits"),
    "a pedestal mode of another frame": ("dermis_row_scanner", "<= mode_q;", "<= pedestal_mode_i;", "commits"),
}  # fmt: skip
ASKED: dict[str, dict[str, Any]] = {
    "traffic": {"seed": 1, "transactions": 60, "slowest": 0.0, "weights": WEIGHTS},
    "off": {"x": PRESSED},
    "cuts": {"x": PRESSED, "seed": 5, "cuts": 400},
    "commits": {"parameters": MANY_ROWS, "seed": 7, "writes": 2000},
    "wiring": {"parameters": WIRED},
}

# What is wrong between modules -> module, right, wrong: all passed every test of the modules.
MISWIRED = {
    "break": ("dermis_top", ".BREAK_CLOCKS (BREAK_CLOCKS),\n    .SYNC_LATCH   (SYNC_LATCH)\n  ) u_reader",
              ".SYNC_LATCH   (SYNC_LATCH)\n  ) u_reader"),
    "fault flag": ("dermis_top", ".fault_i         (fault),", ".fault_i         (1'b0),"),
    "pending test": ("dermis_top", ".test_pending_i (test_pending),", ".test_pending_i (1'b0),"),
    "output enable": ("dermis_spi", "assign cipo_oe_o        = ~cs_ni;", "assign cipo_oe_o        = 1'b1;"),
    "gate of the header": ("dermis_top", ".gate_clocks_i   (gate_clocks),", ".gate_clocks_i   (gate),"),
    "rate of 8 bits": ("dermis_top", "_rate_i     (test_rate)", "_rate_i     ({8'h00, test_rate[7:0]})"),
    "limit of 8 bits": ("dermis_top", "_min_i     (full_min)", "_min_i     ({8'h00, full_min[7:0]})"),
    "scanning": ("dermis_top", ".scanning_i         (scanning),", ".scanning_i         (enable),"),
    "phase of the test": ("dermis_reader", "    else if (inject & preset_o) {level_q, phase_q} <= 17'd0;\n", ""),
    "overflow": ("dermis_packer", "over_q  <= over_q >> 8;", "over_q  <= over_q >> 7;"),
    "end of a frame": ("dermis_spi", "(frame_address_q == frame_length_i)",
                       "(frame_address_q[8:0] == frame_length_i[8:0])"),
}  # fmt: skip
FAULTS |= {name: (*fault, "wiring") for name, fault in MISWIRED.items()}


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_the_checks_see(fault: str, tmp_path: Path) -> None:
    module, right, wrong, testcase = FAULTS[fault]
    trap = changed(tmp_path, module, (right, wrong))
    with pytest.raises(AssertionError, match=r"1 failed"):
        run("icarus", testcase, trap=trap, **ASKED.get(testcase, {}))
