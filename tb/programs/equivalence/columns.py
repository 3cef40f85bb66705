# SPDX-License-Identifier: Apache-2.0
"""Closed loop of a channel in transistors: ngspice in lock-step with the synchronizer, row after row.

The column loads the channel as in the array: one row is driven, the others are at ground, and each slot drives the
next row after a preset of full length. The synchronizer is that of tb/reference/chip.py, so that a channel is judged
apart from the Verilog, which has its own proofs. A column runs once: its record is stored under the hash of its deck.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from dermis.chip import netlist, sky130
from dermis.chip.spice_text import spice_number
from dermis.lockstep import ladder, ngspice
from dermis.lockstep.ngspice import Deck, NgspiceHalf
from dermis.report import progress
from dermis.scene import design as design_module
from dermis.scene.design import ROOT
from scripts import workers
from scripts.characterise import runs
from scripts.characterise.benches import SUPPLY_V, Condition
from scripts.checkpoint import Checkpoint
from scripts.judged import SHOW, digest
from tb.reference.chip import Synchronizer

WORK = ROOT / "build" / "equivalence"
"""Records and logs of columns, of `dermis equivalence` and `dermis calibrated`."""

_OPEN_S, _CLOCK_S = 120.0, 1.0
"""Time limits of a column: operating point and clock, thirty times those on an idle core."""


@dataclass(frozen=True, eq=False)
class Slot:
    """Record of a slot, clock by clock from 1."""

    comparator: NDArray[np.bool_]  # [clocks] at the synchronizer's input
    bits: NDArray[np.bool_]  # [clocks] decisions
    stored_v: NDArray[np.float64]  # [clocks + 1] output with the sign of the charge; [0] ends the preset


JOBS = click.option("--jobs", default=os.cpu_count(), type=click.IntRange(1, 64), help="Processes.", **SHOW)
FRESH = click.option("--fresh", is_flag=True, help="Run what is kept from earlier runs as well.")
"""Options of commands that run columns."""

Record = tuple[list[bool], list[bool], list[float]]
"""A slot as JSON holds it."""


def deck_of(
    ohm: Sequence[float],
    channel: Sequence[str],
    probes: tuple[str, str],
    condition: Condition,
    blocks: Path | None = None,
) -> Deck:
    """Return the deck of a column with ideal row drivers and the capacitance of its line, in one piece.

    `ohm` are taxels, infinite for none, between the row lines row0 ... and the column `col`, `channel` are the
    instance on it and other elements, `probes` comparator and integrator, and `blocks` a folder of netlists in
    place of spice/sky130.
    """
    design, drawn, rows = design_module.load(), condition.sample is not None, len(ohm)
    lines = [
        f"column of {rows} rows at {condition}",
        *([f".options seed={condition.sample}"] if drawn else []),
        *sky130.deck_head(condition.corner, condition.celsius, drawn, blocks),
        *sky130.supplies(SUPPLY_V, -SUPPLY_V, condition.supply),
        *sky130.REFERENCE,
        sky130.bias_current("ibias"),
        *(f"v_row{r} row{r} 0 external" for r in range(rows)),
        *(f"rtaxel{r} row{r} col {spice_number(float(x))}" for r, x in enumerate(ohm) if math.isfinite(x)),
        f"ccolumn col 0 {spice_number(design.array.c_column_f)}",
        "v_d_preset logic_preset 0 external",
        "v_d_charge logic_charge 0 external",
        *(sky130.logic(name, condition.supply) for name in ("preset", "charge")),
        *channel,
        netlist.transistor_options(),
        ".end",
    ]
    whole = runs.resolved("\n".join(lines)).splitlines()
    return Deck(
        tuple(line for line in whole if line != ".end"),
        (*(f"v_row{r}" for r in range(rows)), "v_d_preset", "v_d_charge"),
        (design.interface.v_bias_v, *[0.0] * (rows - 1), 1.0, 0.0),
        (*[False] * rows, True, False),
        probes,
        step_growth=netlist.STEP_GROWTH_TRANSISTORS,
    )


@dataclass(frozen=True)
class Column:
    """A column to run."""

    deck: Deck
    clocks: int  # decisions of each row
    sign: float = -1.0  # of the integrator's voltage over the stored charge

    @property
    def name(self) -> str:
        """Name of its record and log."""
        return runs.key("\n".join(self.deck.lines)) + f"_{self.clocks}"

    @property
    def rows(self) -> int:
        """Row lines."""
        return len(self.deck.sources) - 2


def _attempt(column: Column, log: Path, level: ladder.Level) -> list[Record]:
    design = design_module.load()
    t_clk, settle = 1.0 / design.converter.f_clk_hz, design.timing.settle_clocks
    preset, charge = column.rows, column.rows + 1  # numbers of their sources, after the rows
    slot_clocks = settle + column.clocks + 2  # two clocks after the last decision for its packet
    half = NgspiceHalf(
        column.deck,
        t_edge_s=design.converter.t_edge_s,
        t_max_step_s=slot_clocks * t_clk,  # truncation control decides between edges
        t_stop_s=(column.rows * slot_clocks + 1) * t_clk,
        log=log,
        level=level,
    )
    found, edges = [], []
    try:
        half.advance(0.0, edges)
        for row in range(column.rows):
            begin = row * slot_clocks
            release = begin + settle
            if row:
                driven = begin + design.timing.break_clocks
                edges += [(begin * t_clk, preset, 1.0), (begin * t_clk, row - 1, 0.0)]
                half.advance(driven * t_clk, edges)
                edges = [(driven * t_clk, row, design.interface.v_bias_v)]
            stored = [column.sign * float(half.advance(release * t_clk, edges)[1])]
            edges = [(release * t_clk, preset, 0.0)]
            flops, comparator, bits = Synchronizer(), [], []
            for clock in range(1, column.clocks + 3):
                now = (release + clock) * t_clk
                v_comp, v_int = half.advance(now, edges)
                before, high = flops.charge, bool(v_comp > 0.0)
                bit = flops.clock(high and clock <= column.clocks)
                edges = [(now, charge, float(flops.charge))] if flops.charge != before else []
                if clock <= column.clocks:
                    comparator.append(high)
                    bits.append(bit)
                    stored.append(column.sign * float(v_int))
            found.append((comparator, bits, stored))
        half.advance((column.rows * slot_clocks + 1) * t_clk, edges)
    finally:
        half.close()
    return found


def simulate(column: Column, log: Path) -> list[Record]:
    """Read every row of a column once in this process, which ngspice needs for itself.

    Raises SimulatorError if ngspice gave up on every rung of the ladder.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    os.chdir(log.parent)  # the transistor model writes a file in its working directory
    return ladder.climb(partial(_attempt, column, log), ladder.Climb(column.deck.lines[0], runs.START))


def records(
    columns: Sequence[Column],
    jobs: int,
    title: str = "columns",
    fresh: bool = False,
    work: Path = WORK,
) -> list[list[Slot] | str]:
    """Return the records of columns in order; a text is the reason for a missing one.

    They are kept in `work` under the title; with `fresh` none from before is used.
    """
    stamp = digest((Path(__file__), ngspice.SOURCE, Path(ngspice.__file__)))
    store = Checkpoint(work / f"{title}.json", stamp, fresh=fresh)
    tasks = {}
    for c in columns:
        limit_s = _OPEN_S + _CLOCK_S * c.clocks * c.rows
        tasks[c.name] = workers.Task(simulate, (c, work / "logs" / f"{c.name}.log"), limit_s)
    with progress.slots(title, len(tasks), "columns") as tell:
        faults = store.run(tasks, jobs, tell, fresh=True)
    whole = {
        name: [Slot(*map(np.array, slot)) for slot in store.pieces[name]] for name in tasks.keys() - faults
    }
    return [(whole | faults)[c.name] for c in columns]
