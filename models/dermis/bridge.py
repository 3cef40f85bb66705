# SPDX-License-Identifier: Apache-2.0
"""The lock-step loop: carries every edge of dermis_top to an analog half and every comparator back, clock by clock.

Time is counted in clock edges on the digital side and in seconds on the analog side; edge n of a frame stands at
n / f_clk exactly, however the HDL simulator rounds its own period.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.analog import AnalogHalf, Edge
from dermis.errors import SimulatorError
from dermis.plan import Timing


@dataclass
class Trace:
    """What crossed the bridge, one entry a clock: integers whose bit c is column c (row r for `row_select`)."""

    comparator: list[int] = field(default_factory=list)
    charge: list[int] = field(default_factory=list)
    row_select: list[int] = field(default_factory=list)
    preset: list[int] = field(default_factory=list)


HalfFactory = Callable[[int, "list[float]"], AnalogHalf]
"""(frame, source levels at the frame's first instant) -> analog half; sources are rows, preset, charge."""


def _bits(samples: NDArray[np.float64]) -> int:
    return int.from_bytes(np.packbits(samples > 0.0, bitorder="little").tobytes(), "little")


def _changed(old: int, new: int) -> list[tuple[int, float]]:
    """Index and new level of every bit that differs."""
    found = []
    different = old ^ new
    while different:
        index = (different & -different).bit_length() - 1
        different &= different - 1
        found.append((index, float(new >> index & 1)))
    return found


def _known(handle: Any, what: str) -> int:
    try:
        return int(handle.value)  # asking is_resolvable first costs 7 us for sixteen bits
    except ValueError:
        raise SimulatorError(f"{what} is {handle.value}, not 0 or 1: the Verilog lost its state") from None


class Bridge:
    """Runs frames of dermis_top against analog halves, inside a cocotb test.

    Parameters
    ----------
    dut : cocotb handle of dermis_top
    timing : Timing
    cols : number of columns
    sync_latch : the chip was built with the flip-flop + latch synchronizer
    trace : keep what crossed, clock by clock
    progress : called with the number of slots done
    """

    def __init__(
        self,
        dut: Any,
        timing: Timing,
        cols: int,
        *,
        sync_latch: bool = False,
        trace: bool = False,
        progress: Callable[[int], None] = lambda slots: None,
    ) -> None:
        self._dut = dut
        self._timing = timing
        self._cols = cols
        self._sync_latch = sync_latch
        self._progress = progress
        self._slots = 0
        self.trace = Trace() if trace else None
        self._codes: list[tuple[int, int]] = []
        self.charge_delay_clocks = 0.5 if sync_latch else 0.0  # the latch opens with the falling edge
        self._half_ps = max(1, round(0.5e12 / timing.f_clk_hz))

    async def run(self, frames: int, make_half: HalfFactory) -> NDArray[np.uint16]:
        """Reset the chip and read `frames` frames; return codes [frames, rows, cols].

        Raises
        ------
        SimulatorError
            The analog half stopped, the Verilog drives an X, loses its row scan or delivers the wrong number of rows.
        """
        import cocotb
        from cocotb.clock import Clock
        from cocotb.triggers import FallingEdge, Timer

        dut, timing = self._dut, self._timing
        # made once: a trigger may be awaited again and again
        self._edge, self._settled = FallingEdge(dut.clk_i), Timer(1, unit="ps")
        dut.rst_ni.value = 0
        dut.enable_i.value = 0
        dut.comp_async_i.value = 0
        clock = Clock(dut.clk_i, 2 * self._half_ps, unit="ps", impl="gpi")
        clock.start(start_high=False)
        for _ in range(3):
            await FallingEdge(dut.clk_i)
        dut.rst_ni.value = 1
        await FallingEdge(dut.clk_i)
        dut.enable_i.value = 1
        watcher = cocotb.start_soon(self._collect())
        await self._next_clock()
        levels = self._levels()
        for frame in range(frames):
            if levels[: timing.rows] != [1.0] + [0.0] * (timing.rows - 1) or levels[timing.rows] != 1.0:
                raise SimulatorError(f"frame {frame} does not begin with row 0 driven and the preset on")
            half = make_half(frame, levels)
            try:
                levels = await self._frame(half, levels)
            finally:
                half.close()
        for _ in range(8):  # the last row is handed over a few clocks after its slot
            await self._next_clock()
        watcher.cancel()
        return self._assemble(frames)

    async def _next_clock(self) -> None:
        await self._edge
        if self._sync_latch:
            await self._settled  # the latch opens with the falling edge: look once it has settled

    def _levels(self) -> list[float]:
        t = self._timing
        row = _known(self._dut.row_select_o, "row_select_o")
        charge = _known(self._dut.charge_o, "charge_o")
        levels = [float(row >> r & 1) for r in range(t.rows)]
        levels.append(float(_known(self._dut.preset_o, "preset_o")))
        return levels + [float(charge >> c & 1) for c in range(self._cols)]

    async def _frame(self, half: AnalogHalf, levels: list[float]) -> list[float]:
        """Run one frame, from its edge 0 (already passed) to the next frame's edge 0; return the levels there."""
        from cocotb.handle import Immediate

        dut, timing, trace = self._dut, self._timing, self.trace
        rows, cols = timing.rows, self._cols
        t_clk = 1.0 / timing.f_clk_hz
        charge_delay = self.charge_delay_clocks * t_clk
        row_handle, preset_handle, charge_handle, comp_handle = (
            dut.row_select_o,
            dut.preset_o,
            dut.charge_o,
            dut.comp_async_i,
        )
        row = sum(1 << r for r in range(rows) if levels[r])
        preset = int(levels[rows])
        charge = sum(1 << c for c in range(cols) if levels[rows + 1 + c])
        edges: list[Edge] = []
        sent = -1
        half.advance(0.0, [])
        for clock in range(1, timing.rows * timing.slot_clocks + 1):
            now = clock * t_clk
            bits = _bits(half.advance(now, edges)[:cols])
            if bits != sent:
                comp_handle.set(Immediate(bits))
                sent = bits
            await self._next_clock()
            new_charge = _known(charge_handle, "charge_o")
            new_preset = _known(preset_handle, "preset_o")
            new_row = _known(row_handle, "row_select_o")
            if trace is not None:
                trace.comparator.append(bits)
                trace.charge.append(new_charge)
                trace.row_select.append(new_row)
                trace.preset.append(new_preset)
            edges = [(now + charge_delay, rows + 1 + c, level) for c, level in _changed(charge, new_charge)]
            if new_preset != preset:
                edges.append((now, rows, float(new_preset)))
            if new_row != row:
                edges += [(now, r, level) for r, level in _changed(row, new_row)]
                self._slots += 1
                self._progress(self._slots)
            charge, preset, row = new_charge, new_preset, new_row
        return self._levels()

    async def _collect(self) -> None:
        from cocotb.triggers import FallingEdge, RisingEdge

        while True:
            await RisingEdge(self._dut.codes_valid_o)
            await FallingEdge(self._dut.clk_i)
            row = _known(self._dut.codes_row_o, "codes_row_o")
            self._codes.append((row, _known(self._dut.codes_o, "codes_o")))

    def _assemble(self, frames: int) -> NDArray[np.uint16]:
        t = self._timing
        rows = [row for row, _ in self._codes]
        if rows != list(range(t.rows)) * frames:
            raise SimulatorError(
                f"the chip handed over rows {rows[:40]} instead of 0..{t.rows - 1} in {frames} frames"
            )
        bits = t.code_max.bit_length()
        flat = [word >> c * bits & t.code_max for _, word in self._codes for c in range(self._cols)]
        return np.array(flat, dtype=np.uint16).reshape(frames, t.rows, self._cols)
