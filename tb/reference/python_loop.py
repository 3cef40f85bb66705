# SPDX-License-Identifier: Apache-2.0
"""The clock loop in Python, the reference of clock_loop.c, and both in one HDL simulation.

The HDL simulator loads this module for `both`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from cocotb.handle import Immediate
from cocotb.triggers import FallingEdge

from dermis.chip import bridge, netlist
from dermis.chip.analog import ExactHalf
from dermis.chip.split import SplitHalf, Workers
from dermis.lockstep import ngspice
from dermis.lockstep.clock_loop import AnalogHalf, ClockLoop
from dermis.lockstep.ngspice import Deck, Edge, NgspiceHalf
from dermis.ndarrays import Floats
from dermis.records import Plan


class PythonBridge(bridge.Bridge):
    """A bridge whose clock loop is in Python: every pin is read at every clock."""

    async def _frame(self, frame: int, loop: ClockLoop, half: AnalogHalf) -> None:
        dut, timing = self._dut, self._timing
        t_clk = 1.0 / timing.f_clk_hz
        widths = timing.rows, 1, self._cols

        def levels() -> list[float]:
            words = zip(self._pins(), widths, strict=True)
            return [float(word >> bit & 1) for word, width in words for bit in range(width)]

        old = levels()
        delays = [0.0] * (timing.rows + 1) + [self.charge_delay_clocks * t_clk] * self._cols
        if self.trace is not None:
            self.trace.begins.append(len(self.trace.row_select))
        edges: list[Edge] = []
        kept = [half.advance(0.0, [])[: self._samples].copy()]
        for clock in range(1, round(bridge.analog_s(timing, len(self._rows)) / t_clk) + 1):
            sample = half.advance(clock * t_clk, edges)
            kept.append(sample[: self._samples].copy())
            bits = sum(int(v > 0.0) << c for c, v in enumerate(sample[: self._cols]))
            dut.comp_async_i.set(Immediate(bits))
            await FallingEdge(dut.clk_i)
            if self._sync_latch:
                await self._settled
            self._record()
            dut.row_sense_i.value = self._pins()[0]
            new = levels()
            edges = [(clock * t_clk + delays[i], i, level) for i, level in enumerate(new) if level != old[i]]
            old = new
        self.samples.append(np.array(kept))


class LateHalf(NgspiceHalf):
    """ngspice with the late probes of a deck sampled from Python."""

    def __init__(self, deck: Deck, **options: Any) -> None:
        super().__init__(replace(deck, late_s=()), **options)
        self._late = self._late_s = np.array(deck.late_s or [0.0] * len(deck.probes))
        self._told = np.zeros(len(deck.probes))

    def advance(self, to: float, edges: Sequence[Edge]) -> Floats:
        """Return the probes at `to`, or as much earlier as they are late."""
        for late in sorted(set(self._late[self._late > 0.0]), reverse=True):
            if to > late:
                early = super().advance(to - late, [edge for edge in edges if edge[0] <= to - late])
                edges = [edge for edge in edges if edge[0] > to - late]
                self._told[self._late == late] = early[self._late == late]
        prompt = (self._late == 0.0) | (to <= self._late)
        self._told[prompt] = super().advance(to, edges)[prompt]
        return self._told


@dataclass(frozen=True)
class Job:
    """Input of `both`."""

    plan: Plan
    half: str = "ngspice"  # or "split" by columns, or "exact"
    sync_latch: bool = False
    loop_source: Path | None = None  # clock_loop.c from another place


async def both(dut: Any, job: Job, where: Path) -> list[dict[str, Any]]:
    """Return codes, samples, trace, steps and waveform of the loop in C, then of the one in Python."""
    ngspice.LOOP_SOURCE = job.loop_source or ngspice.LOOP_SOURCE
    plan, workers = job.plan, Workers()
    options = {"t_edge_s": 1e-9, "t_max_step_s": 1e-6, "t_stop_s": bridge.analog_s(plan.timing)}
    options |= {"log": where / "ngspice.log", "record": True}
    width = plan.cols * (2 if job.half == "ngspice" else 1)  # comparators, then integrators
    found = []
    for chip_class, half_class in ((bridge.Bridge, NgspiceHalf), (PythonBridge, LateHalf)):
        halves: list[tuple[Any, Any]] = []

        def make(frame: int, levels: list[float], half_class: Any = half_class, halves: Any = halves) -> Any:
            def deck(columns: tuple[int, ...] | None = None) -> Deck:
                return netlist.frame_deck(plan, frame, levels, record=True, columns=columns)

            if job.half == "exact":
                t_clk_s = 1.0 / plan.timing.f_clk_hz
                return ExactHalf(plan.duty_ideal()[frame], levels, t_clk_s=t_clk_s, t_edge_s=1e-9)
            if job.half == "split":
                decks = {(c,): deck((c,)) for c in range(plan.cols)}
                half = SplitHalf(decks, plan.rows, workers, **options)
            else:
                half = half_class(deck(), **options)
            close = half.close

            def closed() -> None:
                halves.append((half.statistics, half.waveform()))
                close()

            half.close = closed
            return half

        chip = chip_class(dut, plan.timing, plan.cols, sync_latch=job.sync_latch, trace=True, samples=width)
        codes = await chip.run(plan.frames, make)
        found.append({"codes": codes, "samples": chip.samples, "trace": vars(chip.trace), "halves": halves})
    workers.close()
    return found
