# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_crc8 against its definition."""

from __future__ import annotations

from typing import Any

import cocotb
from cocotb.triggers import Timer

from dermis.chip.spi_protocol import crc8


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def every_pair(dut: Any) -> None:
    """All remainders with data 0 and with data 0x5A: the function is linear, so this fixes all 65536."""
    step = Timer(1, "ns")
    for crc in range(256):
        for data in (0, 0x5A, crc ^ 0xFF):
            dut.crc_i.value, dut.data_i.value = crc, data
            await step
            assert int(dut.crc_o.value) == crc8((data,), crc), f"{crc:02X} {data:02X}"
