# SPDX-License-Identifier: Apache-2.0
"""cocotb test of what only a reader of one bit a clock sees."""

from __future__ import annotations

from typing import Any

import cocotb
from rtl_bench import TopBench, report, scenario


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def serial_readout(dut: Any) -> None:
    """Read codes_o one bit a clock, from the clock of codes_valid_o on, and report the words of each slot."""
    s = scenario()
    bench = TopBench(dut, s["x"], checks=False)
    await bench.reset()
    dut.enable_i.value = 1
    words = []
    for _ in range(s["slots"]):
        await bench.run_slots(1, limit=s["limit"])
        bits = 0
        for k in range(len(dut.codes_o)):
            if k:
                await bench.run(1)
            bits |= (int(dut.codes_o.value) >> k & 1) << k
        words.append(
            [bits >> (c * bench.code_bits) & ((1 << bench.code_bits) - 1) for c in range(bench.cols)]
        )
    report(words)
