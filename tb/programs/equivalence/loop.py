# SPDX-License-Identifier: Apache-2.0
"""Closed loop of one channel in transistors: ngspice in lock-step with the synchronizer, row after row.

The column loads the channel as in the array: one row is driven, the others are at ground, and each slot drives the
next row after a preset of full length. The synchronizer is that of tb/reference/chip.py, so that a channel is judged
apart from the Verilog, which has its own proofs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.chip import ladder, netlist, sky130
from dermis.chip.ngspice import Deck, NgspiceHalf
from dermis.chip.spice_text import spice_number
from dermis.scene.design import Design
from scripts.characterise.benches import SUPPLY_V, Condition
from scripts.characterise.runs import START
from tb.reference.chip import Synchronizer


@dataclass(frozen=True, eq=False)
class Slot:
    """Record of a slot, clock by clock from 1.

    Attributes
    ----------
    comparator, bits : [clocks] what the synchronizer found, and what it decided
    stored_v : [clocks + 1] the integrator's output turned so that stored charge counts up; [0] where the preset ends
    """

    comparator: NDArray[np.bool_]
    bits: NDArray[np.bool_]
    stored_v: NDArray[np.float64]


def deck_of(
    topology: str,
    k: int,
    resistance_ohm: Sequence[float],
    condition: Condition,
    design: Design,
    blocks: Path | None = None,
) -> Deck:
    """The deck of a column: ideal row drivers, its taxels, its line's capacitance, the channel.

    Parameters
    ----------
    resistance_ohm : of each row's taxel; inf leaves it out
    blocks : a folder of netlists in place of spice/sky130
    """
    rows = len(resistance_ohm)
    integrator = "xch.v_int" if topology == "direct" else "xch.xvfc.v_int"
    lines = [
        f"column of {rows} taxels on {topology}, k = {k}",
        *sky130.deck_head(condition.corner, condition.celsius, condition.sample is not None, blocks),
        *sky130.supplies(SUPPLY_V, -SUPPLY_V, condition.supply),
        *sky130.REFERENCE,
        sky130.bias_current("ibias"),
        *(f"v_row{r} row{r} 0 external" for r in range(rows)),
        *(
            f"rtaxel{r} row{r} col {spice_number(float(ohm))}"
            for r, ohm in enumerate(resistance_ohm)
            if math.isfinite(ohm)
        ),
        f"ccolumn col 0 {spice_number(design.array.c_column_f)}",
        "v_d_preset logic_preset 0 external",
        "v_d_charge logic_charge 0 external",
        *(sky130.logic(name, condition.supply) for name in ("preset", "charge")),
        f"xch col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d channel_{topology} k={k}",
        netlist.transistor_options(),
    ]
    if condition.sample is not None:
        lines.insert(1, f".options seed={condition.sample}")
    names = (*(f"v_row{r}" for r in range(rows)), "v_d_preset", "v_d_charge")
    levels = (design.interface.v_bias_v, *[0.0] * (rows - 1), 1.0, 0.0)
    abrupt = (*[False] * rows, True, False)
    growth = netlist.STEP_GROWTH_TRANSISTORS
    return Deck(tuple(lines), names, levels, abrupt, ("comp", integrator), step_growth=growth)


def column(
    deck: Deck,
    clocks: int,
    sign: float,
    design: Design,
    log: Path,
    progress: Callable[[int], None] = lambda rows: None,
) -> list[Slot]:
    """Read every row of a column once, `clocks` decisions each.

    Parameters
    ----------
    deck : of `deck_of`
    clocks : length of the gate
    sign : of the integrator's voltage over the stored charge (vfc.Converter.v_sign)
    log : where ngspice's own words go
    progress : called with the rows done

    Raises
    ------
    SimulatorError
        ngspice gave up on every rung of the ladder.
    """

    def attempt(level: ladder.Level) -> list[Slot]:
        run = _Run(deck, clocks, sign, design, log, level)
        try:
            return run.slots(progress)
        finally:
            run.half.close()

    return ladder.climb(attempt, ladder.Climb(deck.lines[0], START))


class _Run:
    """One attempt of a column: time in clocks, and the edges from there."""

    def __init__(
        self, deck: Deck, clocks: int, sign: float, design: Design, log: Path, level: ladder.Level
    ) -> None:
        self.rows = len(deck.sources) - 2
        self.clocks, self.sign = clocks, sign
        self.t_clk, self.v_bias_v = 1.0 / design.converter.f_clk_hz, design.interface.v_bias_v
        self.settle, self.pause = design.timing.settle_clocks, design.timing.break_clocks
        # After the last decision two more clocks for its packet.
        self.slot_clocks = self.settle + clocks + 2
        self.now = 0
        self.edges: list[tuple[float, int, float]] = []
        self.half = NgspiceHalf(
            deck,
            t_edge_s=design.converter.t_edge_s,
            t_max_step_s=self.slot_clocks * self.t_clk,  # truncation control decides between edges
            t_stop_s=(self.rows * self.slot_clocks + 1) * self.t_clk,
            log=log,
            level=level,
        )
        self.half.advance(0.0, [])

    def slots(self, progress: Callable[[int], None]) -> list[Slot]:
        """Every row in its turn."""
        found = []
        for row in range(self.rows):
            if row:
                self._change_row(row)
            found.append(self._read(row * self.slot_clocks + self.settle))
            progress(row + 1)
        self._go(self.now + 1)
        return found

    def _go(self, clock: int) -> NDArray[np.float64]:
        """Comparator and integrator at a clock, past the edges that were put down meanwhile."""
        sample = self.half.advance(clock * self.t_clk, self.edges)
        self.now, self.edges = clock, []
        return sample

    def _put(self, source: int, level: float) -> None:
        self.edges.append((self.now * self.t_clk, source, level))

    def _change_row(self, row: int) -> None:
        """Preset, release a row, and after the break drive the next one."""
        self._put(self.rows, 1.0)
        self._put(row - 1, 0.0)
        self._go(self.now + self.pause)
        self._put(row, self.v_bias_v)

    def _read(self, release: int) -> Slot:
        """Release preset at a clock and count."""
        n = self.clocks
        comparator, bits, stored = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), np.zeros(n + 1)
        stored[0] = self.sign * self._go(release)[1]
        self._put(self.rows, 0.0)
        flops = Synchronizer()
        for clock in range(1, n + 3):
            high, v_int = self._go(release + clock)
            charge = flops.charge
            bit = flops.clock(bool(high > 0.0) and clock <= n)
            if flops.charge != charge:
                self._put(self.rows + 1, float(flops.charge))
            if clock <= n:
                comparator[clock - 1], bits[clock - 1], stored[clock] = high > 0.0, bit, self.sign * v_int
        return Slot(comparator, bits, stored)
