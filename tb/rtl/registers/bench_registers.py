# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_registers: each address against the map, each port against the register behind it."""

from __future__ import annotations

import random
from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import report, scenario

from dermis.chip import register_map as rm

# Ports that show or feed a register: register -> (port, lowest bit).
OUTPUTS = {
    "CONTROL": {
        "continuous": (0, 1),
        "dark": (3, 1),
        "pedestal_mode": (4, 2),
        "range_per_column": (6, 1),
        "hold": (7, 1),
    },
    "SETTLE": {"settle": (0, 16)},
    "GATE": {"gate": (0, 16)},
    "RANGE": {"range": (0, 2)},
    "TEST_RATE": {"test_rate": (0, 16)},
    "DARK_MAX": {"dark_max": (0, 16)},
    "FULL_MIN": {"full_min": (0, 16)},
}
INPUTS = {
    "STATUS": {
        "scanning": (0, 1),
        "frame_ready": (1, 1),
        "test_done": (2, 1),
        "fault": (3, 1),
        "test_cut": (4, 1),
        "underflow": (5, 1),
    },
    "FRAME_NUMBER": {"frame_number": (0, 16)},
    "LOST": {"lost": (0, 16)},
    "SPI_ERRORS": {"spi_errors": (0, 16)},
    "TEST_COUNT": {"test_count": (0, 16)},
}
LIST_OUTPUTS = {"ROW_MASK": "row_mask", "RANGE_COLUMN": "range_column", "PEDESTAL": "pedestal"}
LIST_INPUTS = {
    "ROW_FAULT": "row_fault",
    "INJECT_FAULT": "inject_fault",
    "DARK_FAULT": "dark_fault",
    "FULL_FAULT": "full_fault",
}


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def every_address(dut: Any) -> None:
    """Random accesses to all 256 addresses, with all ports compared behind each."""
    s = scenario()
    rng = random.Random(1)
    rows, cols, code_bits = s["rows"], s["cols"], s["code_bits"]
    existing = {n: r.words(rows, cols, code_bits) for n, r in rm.REGISTERS.items()}
    place = {r.address + i: (n, i) for n, r in rm.REGISTERS.items() for i in range(len(existing[n]))}
    values = {a: s["resets"].get(n, rm.REGISTERS[n].reset) & existing[n][i] for a, (n, i) in place.items()}
    values[rm.GEOMETRY] = rows << 8 | cols
    values[rm.FORMAT] = 1 << 9 | s["sync_latch"] << 8 | code_bits

    def width(name: str) -> int:
        register = rm.REGISTERS[name]
        return min(16, register.lane_bits * (16 // register.lane_bits)) if register.lane_bits else code_bits

    def joined(name: str) -> int:
        start = rm.REGISTERS[name].address
        return sum(values[start + i] << width(name) * i for i in range(len(existing[name])))

    def outputs_are_right() -> None:
        for name, fields in OUTPUTS.items():
            for field, (low, bits) in fields.items():
                got = int(getattr(dut, f"{field}_o").value)
                assert got == values[rm.REGISTERS[name].address] >> low & (1 << bits) - 1, field
        for name, port in LIST_OUTPUTS.items():
            assert int(getattr(dut, f"{port}_o").value) == joined(name), port

    async def clock() -> None:
        await Timer(1, "ns")
        dut.clk_i.value = 1
        await Timer(1, "ns")
        dut.clk_i.value = 0
        await Timer(1, "ns")

    def feed() -> None:
        for name, fields in INPUTS.items():
            value = 0
            for field, (low, bits) in fields.items():
                part = rng.getrandbits(bits)
                getattr(dut, f"{field}_i").value = part
                value |= part << low
            values[rm.REGISTERS[name].address] = value
        for name, port in LIST_INPUTS.items():
            lanes = rng.getrandbits(rows if name == "ROW_FAULT" else cols)
            getattr(dut, f"{port}_i").value = lanes
            for i in range(len(existing[name])):
                values[rm.REGISTERS[name].address + i] = lanes >> 16 * i & 0xFFFF

    dut.clk_i.value = dut.rst_ni.value = dut.valid_i.value = dut.write_i.value = 0
    dut.address_i.value = dut.wdata_i.value = 0
    feed()
    await clock()
    dut.rst_ni.value = 1
    outputs_are_right()
    addresses = list(range(256)) * s["rounds"]
    rng.shuffle(addresses)
    for address in addresses:
        for write in rng.sample((0, 1), 2):
            # A read with all ones on the bus: what only a write may do would show.
            data = rng.getrandbits(16) if write else 0xFFFF
            dut.valid_i.value, dut.write_i.value = 1, write
            dut.address_i.value, dut.wdata_i.value = address, data
            feed()
            await Timer(1, "ns")
            name, i = place.get(address, ("", 0))
            register = rm.REGISTERS.get(name)
            allowed = register is not None and (not write or bool(register.writable))
            assert int(dut.error_o.value) == (not allowed), f"{address:02X} {write}"
            if not write:
                wanted = values[address] & register.readable if register else 0
                assert int(dut.rdata_o.value) == wanted, f"{address:02X}: {int(dut.rdata_o.value):04X}"
            acts = write and address == rm.CONTROL
            assert int(dut.shot_o.value) == (acts and data >> 1 & 1)
            assert int(dut.test_o.value) == (acts and data >> 2 & 1)
            if allowed and write:
                values[address] = data & register.writable & existing[name][i]
            await clock()
            outputs_are_right()
            # Without valid_i nothing is written, nothing acts and nothing shows.
            dut.valid_i.value = 0
            dut.wdata_i.value = rng.getrandbits(16)
            await clock()
            assert not int(dut.rdata_o.value) | int(dut.error_o.value)
            assert not int(dut.shot_o.value) | int(dut.test_o.value)
            outputs_are_right()
    report({"addresses": len(place)})
