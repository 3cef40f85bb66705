# SPDX-License-Identifier: Apache-2.0
"""Wrong designs next to the right one; each must read its own number (docs/rtl.md, traps)."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate

from tb.reference.chip import Duty

pytestmark = pytest.mark.timeout(120)

HALF: Duty = (1, 2)  # 500 ohm
OVER, TWO = (250, 312), (2, 510)  # 312 ohm, where V_b / (k i0) is 250 ohm
DUTIES: list[Duty] = [HALF, (200, 510), (100, 510), (10, 510)]
# Stored charge at t0, over a whole packet.
PHASES: list[Duty] = [(-n, 16) for n in range(16, 0, -1)]
# The counter of a code of 7 bits has 8, with no bit to spare for a pedestal.
EIGHT = {"CODE_BITS": 7}
LATCH = {"SYNC_LATCH": 1}

# A wrong design: the module, then texts and their replacements.
Fault = tuple[Any, ...]
PRESET_ONCE: Fault = (
    "dermis_row_scanner",
    (
        "  assign preset_o       = preset_q;\n",
        """  reg gated_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) gated_q <= 1'b0;
    else         gated_q <= active_q & (gated_q | ~preset_q);
  assign preset_o      = preset_q & ~(gated_q & active_q);
""",
    ),
)
GATE_WITH_ROW: Fault = (
    "dermis_row_scanner",
    ("clocks_q     <= settle_q;", "clocks_q     <= gate_q - 1'b1; preset_q <= 1'b0;"),
)
WRAPS: Fault = ("dermis_gated_counter", ("if (rising && !(&start))", "if (rising)"))
SECOND_QBAR: Fault = ("dermis_sync_ff", ("comp_async_i & ~sample_q", "comp_async_i & ~pulse_o"))
BOTH_QBAR: Fault = ("dermis_sync_ff", ("comp_async_i & ~sample_q", "comp_async_i & ~sample_q & ~pulse_o"))
# Without its register: the counters themselves are read out.
NO_BUFFER: Fault = (
    "dermis_row_buffer",
    ("reg [COLS*COUNT_BITS-1:0] counts_q;", "reg [7:0] column_q;"),
    ("counts_q <= {(COLS*COUNT_BITS){1'b0}};", "column_q <= 8'd0;"),
    ("counts_q <= counts_i;", "column_q <= 8'd0;"),
    ("counts_q <= counts_q >> COUNT_BITS;", "column_q <= column_q + 8'd1;"),
    ("= counts_q[COUNT_BITS-1:0];", "= counts_i[column_q*COUNT_BITS +: COUNT_BITS];"),
)
SERIAL = {"shift_clocks": 8, "busy": False}


@dataclass(frozen=True)
class Trap:
    """A wrong design, or other inputs of the right one.

    `right` and `wrong` are the counts of the first slots, row by row.
    """

    fault: Fault | dict[str, int]
    x: list[list[Duty]]
    right: list[list[int]]
    wrong: list[list[int]]
    gate: int = 510
    settle: int = 115
    parameters: dict[str, int] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)


def wraps(gate: int, other: int, wrong: int) -> Trap:
    """A counter of 8 bits that wraps at full scale; the second column is far from it."""
    x: list[list[Duty]] = [[HALF, (100, 510)]]
    return Trap(WRAPS, x, [[255, other]], [[wrong, other]], gate, 625 - gate, EIGHT)


def short_preset(gate: int, right: int, wrong: list[int], parameters: dict[str, int]) -> Trap:
    """A gate that opens with the row: the packet of a one in the last sample falls after the preset.

    Duty 1/40: ones at samples 20, 60, 100, ... of a slot that starts from the preset.
    """
    counts = [[right]] * 4, [[c] for c in wrong]
    return Trap(GATE_WITH_ROW, [[(1, 40)]], *counts, gate=gate, settle=3, parameters=parameters)


TRAPS = {
    "wraps_512": wraps(512, 100, 0),
    "wraps_516": wraps(516, 101, 2),
    # A gate of 511 depends on the phase.
    "gate_511": Trap(
        {"gate_i": 511, "settle_i": 114},
        [[HALF] * 16],
        [[255] * 16],
        [[255] * 8 + [256] * 8],
        more={"w_preset": PHASES},
    ),
    # Two flip-flops on one clock edge: pulses of two clocks, or a rate of a third.
    "second_qbar": Trap(SECOND_QBAR, [DUTIES], [[255, 200, 100, 10]], [[128, 100, 50, 5]]),
    "both_qbar": Trap(BOTH_QBAR, [DUTIES], [[255, 200, 100, 10]], [[170, 170, 100, 10]]),
    # Charge of an overloaded row: 98 counts after 510 clocks (the first row is preset in its own
    # settle), 133 after 624, a slot without its break; 100 with a gate of 512.
    "no_preset": Trap(
        PRESET_ONCE, [[OVER], [TWO], [TWO]], [[255], [2], [2], [255], [2]], [[255], [98], [2], [255], [133]]
    ),
    "no_preset_512": Trap(
        PRESET_ONCE, [[OVER], [TWO], [TWO]], [[256], [2]], [[256], [100]], gate=512, settle=113
    ),
    # Counters read out themselves, one bit a clock: 115 bits are out when they start again.
    "no_buffer": Trap(
        NO_BUFFER,
        [[HALF] * 16, [(0, 1)] * 16],
        [[255] * 16, [0] * 16],
        [[255] * 14 + [7, 0], [0] * 15 + [5]],
        parameters=EIGHT,
        more=SERIAL,
    ),
    "preset_of_one_clock": short_preset(20, 1, [1, 0, 1, 0], {}),
    # A whole packet lost puts the next slot's only one at sample 60 again; half a packet, of the
    # latch, at sample 40, so that the slot after it is right.
    "preset_of_one_clock_60": short_preset(60, 2, [2, 1, 1, 1], {}),
    "preset_of_one_clock_60_latch": short_preset(60, 2, [2, 1, 2, 1], LATCH),
}
FAST = ("wraps_512", "gate_511", "no_buffer")
"""Each wrong variant is a build of its own: the others are for the long tests."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] * (n not in FAST)) for n in TRAPS])
def test_a_wrong_design_reads_its_own_number(name: str, tmp_path: Path) -> None:
    trap = TRAPS[name]
    settings = {"gate_i": trap.gate, "settle_i": trap.settle}
    parameters = {"ROWS": len(trap.x), "COLS": len(trap.x[0]), **trap.parameters}

    def counts(slots: int, fault: Path | None, **other: int) -> list[list[int]]:
        scenario = {"x": trap.x, "slots": slots, "limit": 800 * slots + 50, "checks": fault is None}
        scenario |= {"settings": settings | other, **trap.more}
        seen = simulate("icarus", "bench_reader", "dermis_reader", "frames", parameters, scenario, trap=fault)
        return [slot["counts"] for slot in seen["slots"]]

    assert counts(len(trap.right), None) == trap.right
    if isinstance(trap.fault, dict):
        wrong = counts(len(trap.wrong), None, **trap.fault)
    else:
        wrong = counts(len(trap.wrong), changed(tmp_path, *trap.fault))
    assert wrong == trap.wrong
