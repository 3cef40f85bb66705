# SPDX-License-Identifier: Apache-2.0
"""Bench of dermis_top through its pins: clock, a stand-in for the analog side, and a model of the registers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import First, RisingEdge, Timer, ValueChange

from dermis.chip import register_map as rm
from dermis.chip.spi_protocol import SLOT_DARK, Frame
from tb.reference.chip import AnalogColumns, Duty, ones

CLOCK_PS = 200_000
"""5 MHz."""

Levels = Callable[[int, int], int]
"""(number of the frame, row) -> comparators while that row is driven, a bit vector."""


class Chip:
    """Clock, reset and analog side of dermis_top; the SPI pins are left to a client.

    Parameters
    ----------
    dut : cocotb handle
    parameters : mapping
        Those of dermis_top.
    levels : callable, optional
        Comparators constant during a slot: a column at 1 counts every second sample. Fast and exact.
    x : [rows][cols] of Duty, optional
        Duties for charge-balance columns instead.
    analog : optional
        Other columns instead, with the methods of AnalogColumns.
    """

    clock_ps = CLOCK_PS

    def __init__(
        self,
        dut: Any,
        parameters: Mapping[str, int],
        levels: Levels | None = None,
        x: Sequence[Sequence[Duty]] | None = None,
        analog: Any = None,
    ) -> None:
        self.dut, self.levels, self.analog = dut, levels or (lambda _frame, row: row * 0x55 + 1), analog
        self.rows, self.cols = parameters["ROWS"], parameters["COLS"]
        self.code_bits = parameters.get("CODE_BITS", 8)
        self.x = [[tuple(d) for d in row] for row in x] if x else None
        self.frame = 0
        self.stopped = False  # the clock stands where it is, with charge-balance columns
        self.set_faults()
        for name in ("rst_ni", "enable_i", "comp_async_i", "row_sense_i"):
            getattr(dut, name).value = 0
        for task in (self._count_frames, self._follow_rows):
            cocotb.start_soon(task())
        if self.analog:
            cocotb.start_soon(self._charge_balance())
        else:
            Clock(dut.clk_i, CLOCK_PS, "ps").start()

    def set_faults(self, **faults: Sequence[Any]) -> None:
        """Break the array, in place of earlier faults.

        comparators_high, comparators_low, open_columns: columns; shorted_columns: pairs of columns;
        rows_high, rows_low: rows; shorted_rows: pairs of rows, of which the driven one pulls the
        other along.
        """
        self.faults = faults
        if self.x:
            columns = (faults.get(name, ()) for name in ("open_columns", "shorted_columns"))
            self.analog = AnalogColumns(self.x, None, *columns)

    def _lines(self, fault: str) -> int:
        return sum(1 << line for line in self.faults.get(fault, ()))

    async def clocks(self, count: float) -> None:
        """Wait a number of clock periods."""
        await Timer(int(count * CLOCK_PS), "ps")

    async def reset(self, enable: bool = True) -> None:
        """Power up."""
        self.dut.rst_ni.value = 0
        await self.clocks(3.3)
        self.dut.rst_ni.value = 1
        self.frame = 0
        self.dut.enable_i.value = int(enable)
        await self.clocks(4)

    async def starts(self, count: int) -> None:
        """Wait for the starts of a number of frames."""
        for _ in range(count):
            await RisingEdge(self.dut.frame_start_o)

    async def _count_frames(self) -> None:
        while True:
            await RisingEdge(self.dut.frame_start_o)
            self.frame += 1
            self._drive()

    async def _follow_rows(self) -> None:
        changes = [ValueChange(self.dut.row_select_o), ValueChange(self.dut.test_current_o)]
        while True:
            await First(*changes)
            self._drive()

    def _drive(self) -> None:
        self.dut.row_sense_i.value = rows = self._rows()
        if self.analog is None:
            level = self.levels(self.frame, rows.bit_length() - 1) if rows else 0
            self._compare(level | self._level(self.dut.test_current_o))

    def _rows(self) -> int:
        """Return the levels of the rows, faults included."""
        rows = self._level(self.dut.row_select_o)
        for a, b in self.faults.get("shorted_rows", ()):
            pair = 1 << a | 1 << b
            rows |= pair if rows & pair else 0
        return (rows | self._lines("rows_high")) & ~self._lines("rows_low")

    def _compare(self, levels: int) -> None:
        """Drive the comparators, faults included."""
        levels = (levels | self._lines("comparators_high")) & ~self._lines("comparators_low")
        self.dut.comp_async_i.value = levels & ((1 << self.cols) - 1)

    @staticmethod
    def _level(handle: Any) -> int:
        """Value of an output; nothing is driven before the first reset has told the flops."""
        try:
            return int(str(handle.value), 2)  # a third of the time of is_resolvable, at each half clock
        except ValueError:
            return 0

    async def _charge_balance(self) -> None:
        """The clock with converters around it, half a clock at a time."""
        # The comparators move a nanosecond in front of the edge that samples them, not with it.
        dut, before = self.dut, Timer(1, "ns")
        half, rest = Timer(CLOCK_PS // 2, "ps"), Timer(CLOCK_PS // 2 - 1000, "ps")
        dut.clk_i.value = 0
        await half
        while True:
            while self.stopped:
                await half
            dut.clk_i.value = 1
            await half
            rows, preset, current = self._rows(), self._level(dut.preset_o), self._level(dut.test_current_o)
            self.analog.half_clock(rows, preset, self._level(dut.charge_o), current)
            while self.stopped:
                await half
            dut.clk_i.value = 0
            await rest
            self.analog.half_clock(rows, preset, self._level(dut.charge_o), current)
            self._compare(self.analog.comparators())
            await before

    def expected(
        self,
        number: int,
        gate: int,
        row_mask: int | None = None,
        dark: bool = False,
        pedestal_mode: int = 0,
        pedestals: Sequence[int] | None = None,
    ) -> Frame:
        """Return the expected content of frame `number`."""
        full = 2**self.code_bits - 1
        mask = (1 << self.rows) - 1 if row_mask is None else row_mask
        rows = [r for r in range(self.rows) if mask >> r & 1]
        counts = [[0] * self.cols] * dark + [self._counts(number, r, gate) for r in rows]
        off = np.zeros((len(counts), self.cols), dtype=np.int64)
        if pedestal_mode == 1:
            off[int(dark) :] = pedestals
        net = np.array(counts) - off
        return Frame(
            number=number,
            cols=self.cols,
            code_bits=self.code_bits,
            gate_clocks=gate,
            slots=(SLOT_DARK,) * dark + tuple(rows),
            codes=np.clip(net, 0, full).astype(np.uint16),
            overflow=net > full,
            dark=dark,
            pedestal_mode=pedestal_mode,
        )

    def _counts(self, number: int, row: int, gate: int) -> list[int]:
        most = 2 ** (self.code_bits + 1) - 1
        if self.x is not None:
            return [min(most, sum(ones(x, gate))) for x in self.x[row]]
        level = self.levels(number, row)
        return [min(most, (gate + 1) // 2) if level >> c & 1 else 0 for c in range(self.cols)]


class RegisterModel:
    """Model of the writable registers, from the map."""

    def __init__(self, rows: int, cols: int, code_bits: int, resets: Mapping[str, int]) -> None:
        self.bits: dict[int, int] = {}  # address -> bits that exist and stay as written
        self.read_only: set[int] = set()
        self.values: dict[int, int] = {}
        for name, register in rm.REGISTERS.items():
            for n, exist in enumerate(register.words(rows, cols, code_bits)):
                address = register.address + n
                if register.writable:
                    self.bits[address] = register.writable & exist
                    self.values[address] = resets.get(name, register.reset) & exist
                else:
                    self.read_only.add(address)

    def exists(self, address: int) -> bool:
        """Return True if a read is answered."""
        return address in self.bits or address in self.read_only

    def write(self, address: int, value: int) -> bool:
        """Write; False where the chip refuses."""
        if address not in self.bits:
            return False
        self.values[address] = value & self.bits[address]
        return True


def reset_values(parameters: Mapping[str, int]) -> dict[str, int]:
    """Reset values that follow from the parameters of dermis_top, reckoned apart from the map's expressions."""
    full = min(parameters["GATE_CLOCKS"] // 2, 2 ** (parameters.get("CODE_BITS", 8) + 1) - 1)
    return {
        "SETTLE": parameters["SETTLE_CLOCKS"],
        "GATE": parameters["GATE_CLOCKS"],
        "DARK_MAX": -(-full // 32),
        "FULL_MIN": full * 18 // 25,
    }
