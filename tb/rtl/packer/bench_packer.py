# SPDX-License-Identifier: Apache-2.0
"""cocotb test of dermis_packer: rows in, bytes out."""

from typing import Any

import cocotb
from cocotb.triggers import Timer
from rtl_bench import fall, report, reset, rise, scenario

ROW_PORTS = ("slot_i", "first_i", "last_i", "test_frame_i", "dark_frame_i", "gate_clocks_i", "fault_i")


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def rows(dut: Any) -> None:
    """Offer rows as dermis_reader does; report each frame's bytes, the columns shown and the clocks
    busy.

    A row is {port: value, "counts": [...], "pedestals": [...], "pedestal_mode_i": m}.
    """
    s = scenario()
    code_bits = len(dut.count_i) - 1
    await reset(dut, ("row_valid_i", "count_i", "pedestal_i", "pedestal_mode_i", *ROW_PORTS))
    frames, columns, busy, numbers, underflows = ([] for _ in range(5))
    frame: list[int] | None = None
    for row in s["rows"]:
        for port in ROW_PORTS:
            getattr(dut, port).value = row.get(port, 0)
        dut.pedestal_mode_i.value = row.get("pedestal_mode_i", 0)
        dut.pedestal_i.value = sum(p << (c * code_bits) for c, p in enumerate(row.get("pedestals", ())))
        counts = list(row["counts"])
        dut.row_valid_i.value = 1
        clocks = 0
        while True:
            dut.count_i.value = counts[0] if counts else 0
            await Timer(1, "ns")
            if int(dut.begin_o.value):
                frame = []
                assert not int(dut.we_o.value)
            if int(dut.we_o.value):
                assert frame is not None, "a byte outside a frame"
                frame.append(int(dut.byte_o.value))
            if int(dut.end_o.value):
                assert not int(dut.we_o.value)
                frames.append(frame)
                underflows.append(int(dut.underflow_o.value))
                frame = None
            if int(dut.column_valid_o.value):
                shown = dut.column_slot_o, dut.column_o, dut.column_count_o, dut.count_shift_o
                columns.append([int(port.value) for port in shown])
                counts = counts[1:]
            clocks += int(dut.busy_o.value)
            started = int(dut.row_valid_i.value)
            idle = not started and not int(dut.busy_o.value)
            await rise(dut)
            await fall(dut)
            dut.row_valid_i.value = 0
            if idle:
                break
        busy.append(clocks)
        numbers.append(int(dut.frame_number_o.value))
    lists = {"frames": frames, "columns": columns, "busy": busy, "numbers": numbers, "underflows": underflows}
    report(lists | {"open": frame is not None})
