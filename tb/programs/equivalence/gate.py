# SPDX-License-Identifier: Apache-2.0
"""How many counts in 255 a channel in transistors and the model extracted from it are apart.

Charge decides. At clock n a converter has taken in w0 + y n packets of its own, whatever it is made of: what stands
on its integrator, and the packets that are complete. A short gate shows that line, start and slope, for the channel
and for the event engine alike; at clock 510 it says how many counts each would have reached, to a fraction of a count.
Two numbers less than 1 apart give codes at most 1 apart. A gate of 510 clocks says the same (docs/equivalence.md).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import plan
from dermis.array.array import column_currents
from dermis.engines import event
from dermis.records import Plan
from dermis.scene import design as design_module
from dermis.scene import scene
from dermis.scene.design import Design
from scripts.characterise.benches import Condition
from tb.programs.equivalence.loop import Slot

CODES = (0, 0, 2, 20, 64, 128, 200, 250)
"""Ideal codes of a column's taxels: both ends, and steps between. Above 250 a gain of 2 % is beyond full scale. In the
first slot after power-on the offset null settles; it is read like any other, and not compared."""

SETTLING_ROWS = 1

ANCHORS = (20, 200)
"""Codes whose counts give the model of a mismatch draw its start and its gain; the others are compared."""

CLOCKS = 64
"""Length of the short gate."""


TYPICAL = Condition()


@dataclass(frozen=True)
class Case:
    """One column to compare.

    Attributes
    ----------
    topology, k : the channel
    condition : where; transistors and temperature name the file of parameters, which is that of the nominal supply and
        of nominal resistors and capacitors
    codes : ideal codes of its taxels, row by row
    clocks : decisions of each row
    """

    topology: str = "conveyor_mirror"
    k: int = 80
    condition: Condition = TYPICAL
    codes: tuple[int, ...] = CODES
    clocks: int = CLOCKS

    @property
    def name(self) -> str:
        """As a part of a row's name."""
        at = self.condition
        supply = "" if at.supply == 1.0 else f"_{at.supply:g}"
        draw = "" if at.sample is None else f"_draw{at.sample}"
        return f"{self.topology}.k{self.k}.{at.corner}_{at.celsius:g}C{supply}{draw}"


@dataclass(frozen=True, eq=False)
class Reading:
    """Lines of charge of the rows of a column, in packets of the converter.

    Attributes
    ----------
    slope : [rows] packets a clock
    start : [rows] at the release of the preset, counted from the level of the decision
    packet : one packet in the unit of the charge that was read
    rest : largest distance of a charge from its line, in packets
    """

    slope: NDArray[np.float64]
    start: NDArray[np.float64]
    packet: float
    rest: float

    def counts(self, clocks: int = 510, most: float = 255.0) -> NDArray[np.float64]:
        """Counts before they are cut to whole ones, 0 .. `most`."""
        return np.clip(self.start + self.slope * clocks + 1.0, 0.0, most)

    def like(self, other: Reading, one: int, two: int, clocks: int = 510) -> Reading:
        """Return this reading with the gain and the start that bring its counts of two rows to those of another."""
        mine, its = (r.start + r.slope * clocks for r in (self, other))
        gain = (its[two] - its[one]) / (mine[two] - mine[one])
        start = its[one] - gain * mine[one] + gain * self.start
        return dataclasses.replace(self, start=start, slope=gain * self.slope)


def read(slots: Sequence[Slot]) -> Reading:
    """Fit the lines of a column: a start and a slope for each row, one packet for all.

    A packet decided at clock n flows from n + 1 to n + 2; at n + 2 its edge of 1 ns has just begun to fall, and the
    amplifier has not yet followed: that is one more unknown, the same for all packets.

    Raises
    ------
    ValueError
        No row has a packet, so its size is unknown.
    """
    rows = len(slots)
    parts, values = [], []
    for row, slot in enumerate(slots):
        n = np.arange(2, len(slot.bits) + 1)  # the preset's own charge is in from the first clock on
        complete = np.concatenate([[0], np.cumsum(slot.bits)])[n - 2]
        latest = np.concatenate([[0], slot.bits])[n - 2]
        part = np.zeros((n.size, 2 * rows + 2))
        part[:, row], part[:, rows + row] = 1.0, n
        part[:, -2], part[:, -1] = -complete, latest
        parts.append(part)
        values.append(slot.stored_v[n])
    if not any(slot.bits.any() for slot in slots):
        raise ValueError("no row has a packet")
    matrix, value = np.concatenate(parts), np.concatenate(values)
    found = np.linalg.lstsq(matrix, value, rcond=None)[0]
    packet = float(found[-2])
    rest = float(np.max(np.abs(matrix @ found - value))) / packet
    level = _levels(slots) / packet
    return Reading(found[rows : 2 * rows] / packet, found[:rows] / packet - level, packet, rest)


def _levels(slots: Sequence[Slot]) -> NDArray[np.float64]:
    """Return the threshold of the comparator in each row, half way between its highest low and lowest high.

    A row in which it called everything the same has the level of the nearest row in which it did not.
    """
    found = np.full(len(slots), math.nan)
    for row, slot in enumerate(slots):
        stored = slot.stored_v[1:]
        free = ~np.concatenate([[False], slot.bits[:-1]])
        low, high = stored[free & ~slot.comparator], stored[free & slot.comparator]
        if low.size and high.size:
            found[row] = (low.max() + high.min()) / 2.0
    known = np.flatnonzero(np.isfinite(found))
    for row in np.flatnonzero(~np.isfinite(found)):
        found[row] = found[known[np.argmin(np.abs(known - row))]] if known.size else 0.0
    return found


def model(case: Case, design: Design, off: Sequence[str] = ("row_driver",)) -> Plan:
    """The plan of a column of extracted converters: a frame of one column; the drivers of the gate are ideal."""
    named: dict[str, Any] = {
        "extracted": {
            "corner": case.condition.corner.partition("_")[0],
            "temperature_c": float(case.condition.celsius),
        }
    }
    data = {
        "array": {"rows": len(case.codes), "cols": 1},
        "stimulus": {"kind": "uniform", "code": 0},
        "interface": {"topology": case.topology, "k": case.k},
        "effects": named | dict.fromkeys(off, False),
    }
    made = plan.make(scene.from_data(data, Path("equivalence"), design), "event")
    return dataclasses.replace(made, resistance_ohm=resistances(case, design)[None, :, None])


def resistances(case: Case, design: Design) -> NDArray[np.float64]:
    """Of the taxels of a column, whose ideal codes the case gives."""
    unit_ohm = design.interface.v_bias_v / (case.k * design.converter.i0_a)
    with np.errstate(divide="ignore"):
        return unit_ohm * design.timing.gate_clocks / np.array(case.codes, dtype=float)


def model_slots(made: Plan, clocks: int) -> list[Slot]:
    """Return a column of the event engine clock by clock, from gates of every length; charge in packets."""
    g = made.conductance_s()
    x = made.converter.duty(column_currents(made.network(0), g))
    cells = event.cells_of(made, x, g)
    ends = [event.count_cells(cells, n, made.timing.charge_delay_clocks) for n in range(1, clocks + 1)]
    counts = np.array([count[0, :, 0] for count, _ in ends]).T
    charge = np.array([end[0, :, 0] for _, end in ends]).T
    slots = []
    for row in range(made.rows):
        bits = np.diff(counts[row], prepend=0) > 0
        # After a one the comparator is not sampled, and `read` skips it.
        slots.append(Slot(bits, bits, np.concatenate([[cells.w0[0, row, 0]], charge[row]])))
    return slots


def compare(case: Case, slots: Sequence[Slot], design: Design | None = None) -> Mapping[str, Any]:
    """Counts of both at 510 clocks, and how far apart they are; of a mismatch draw with the model calibrated to it.

    Returns
    -------
    dict
        `codes`: ideal ones; `circuit` and `model`: counts, fractions kept; `apart`: their difference; `worst`: its
        largest magnitude; `rest` of the circuit's lines in packets.
    """
    design = design or design_module.load()
    circuit, stands_for_it = read(slots), read(model_slots(model(case, design), case.clocks))
    if case.condition.sample is not None:
        # What the host calibrates of a column: the files have no draw of the mismatch.
        stands_for_it = stands_for_it.like(circuit, *(case.codes.index(code) for code in ANCHORS))
    have, want = (reading.counts()[SETTLING_ROWS:] for reading in (circuit, stands_for_it))
    apart = have - want
    return {
        "codes": list(case.codes[SETTLING_ROWS:]),
        "circuit": have.tolist(),
        "model": want.tolist(),
        "apart": apart.tolist(),
        "worst": float(np.max(np.abs(apart))),
        "rest": circuit.rest,
    }
