# SPDX-License-Identifier: Apache-2.0
"""How many counts in 255 a channel in transistors and the model extracted from it are apart.

Charge decides. At clock n a converter has taken in w0 + y n packets of its own, whatever it is made of: what stands
on its integrator, and the packets that are complete. A short gate shows that line, start and slope, for the channel
and for the event engine alike; at clock 510 it says how many counts each would have reached, to a fraction of a count.
Two numbers less than 1 apart give codes at most 1 apart. A gate of 510 clocks says the same (docs/equivalence.md).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dermis import plan
from dermis.array.array import column_currents
from dermis.converter import walk
from dermis.converter.coupling import on_columns
from dermis.ndarrays import Floats
from dermis.records import Plan
from dermis.scene import design as design_module
from dermis.scene.design import TOPOLOGIES
from scripts.characterise.benches import Condition
from scripts.characterise.runs import EXTRACTED, TYPICAL
from tb.programs.equivalence.columns import Column, Slot, deck_of
from tb.reference import scenes

CODES = (0, 0, 2, 20, 64, 128, 200, 250)
"""Ideal codes of a column's taxels: both ends, and steps between. Above 250 a gain of 2 % is beyond full scale. In the
first slot after power-on the offset null settles; it is read like any other, and not compared."""

SETTLING_ROWS = 1

CLOCKS = 64  # length of the short gate


@dataclass(frozen=True)
class Case:
    """One column to compare; parameters are those of nominal supply, resistors and capacitors."""

    topology: str = "conveyor_mirror"
    k: int = 80
    condition: Condition = TYPICAL
    codes: tuple[int, ...] = CODES  # ideal codes of its taxels, row by row
    clocks: int = CLOCKS  # decisions of each row

    @property
    def name(self) -> str:
        at = self.condition
        supply = "" if at.supply == 1.0 else f"_{at.supply:g}"
        return f"{self.topology}.k{self.k}.{at.corner}_{at.celsius:g}C{supply}"

    def resistances(self) -> Floats:
        gate_clocks = design_module.load().timing.gate_clocks
        with np.errstate(divide="ignore"):
            return scenes.unit_ohm({"k": self.k}) * gate_clocks / np.array(self.codes, dtype=float)

    def column(self, blocks: Path | None = None) -> Column:
        """Return the column to run, of spice/sky130 or of a changed copy."""
        pins = "col d_charge d_preset comp vref agnd ibias vdd vss vdd_d vss_d"
        channel = f"xch {pins} channel_{self.topology} k={self.k}"
        probes = ("comp", "xch.v_int" if self.topology == "direct" else "xch.xvfc.v_int")
        deck = deck_of(self.resistances(), [channel], probes, self.condition, blocks)
        return Column(deck, self.clocks, 1.0 if self.topology == "conveyor_mirror_inverted" else -1.0)


def everything() -> list[Case]:
    """Return the columns of the gate.

    Every channel at k = 80 and every range of Fig. 5a at three corners, both supplies and both ends of resistors and
    capacitors there, the skews once.
    """
    corners, skews = EXTRACTED[:3], EXTRACTED[3:]
    supplies = [dataclasses.replace(at, supply=s) for at in corners for s in (0.9, 1.1)]
    ends = [dataclasses.replace(at, corner=f"{at.corner}_{end}") for at in corners for end in ("low", "high")]
    return [
        *(Case(topology, 80, at) for at in corners for topology in TOPOLOGIES),
        *(Case(condition=at) for at in skews),
        *(Case(k=k, condition=at) for at in corners for k in (20, 40, 160)),
        *(Case(condition=at) for at in (*supplies, *ends)),
    ]


@dataclass(frozen=True)
class Line:
    """Charge of a row in packets of the converter, by clock after the release of the preset."""

    start: float  # counted from the level of the decision
    slope: float

    def reach(self, clocks: int) -> float:
        """Return the count of a gate before it is cut to a whole one."""
        return self.start + self.slope * clocks + 1.0


def counts(lines: Sequence[Line], clocks: int = 510, most: float = 255.0) -> Floats:
    """Return the counts of rows before they are cut to whole ones, 0 .. `most`."""
    return np.clip([line.reach(clocks) for line in lines], 0.0, most)


def read(slots: Sequence[Slot]) -> list[Line]:
    """Fit the lines of a column: a start and a slope for each row, one packet for all.

    A packet decided at clock n flows from n + 1 to n + 2; at n + 2 its edge of 1 ns has just begun to fall, and the
    amplifier has not yet followed: that is one more unknown, the same for all packets. ValueError without a packet.
    """
    rows, bits = len(slots), np.array([slot.bits for slot in slots], dtype=float)
    if not bits.any():
        raise ValueError("no row has a packet")
    n = np.arange(2, bits.shape[1] + 1)  # the preset's own charge is in from the first clock on
    latest = np.pad(bits, ((0, 0), (1, 0)))[:, n - 2]
    lines = (np.kron(np.eye(rows), part[:, None]) for part in (np.ones(n.size), n))
    packets = (part.reshape(-1, 1) for part in (-latest.cumsum(axis=1), latest))
    value = np.array([slot.stored_v[n] for slot in slots]).ravel()
    found = np.linalg.lstsq(np.hstack([*lines, *packets]), value, rcond=None)[0]
    packet = float(found[-2])
    starts, slopes = (found[:rows] - _levels(slots)) / packet, found[rows : 2 * rows] / packet
    return [Line(*pair) for pair in zip(starts.tolist(), slopes.tolist(), strict=True)]


def _levels(slots: Sequence[Slot]) -> Floats:
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


def model(case: Case) -> Plan:
    """Return the plan of a column of extracted converters: a frame of one column, with ideal row drivers."""
    at = case.condition
    named = {"corner": at.corner.partition("_")[0], "temperature_c": float(at.celsius)}
    on, interface = {"extracted": named, "row_driver": False}, {"topology": case.topology, "k": case.k}
    world = scenes.of_resistances(case.resistances()[None, :, None], on, interface, "equivalence")
    return plan.make(world, "event")


def model_slots(made: Plan, clocks: int) -> list[Slot]:
    """Return a column of the event engine clock by clock, from gates of every length; charge in packets."""
    g = made.conductance_s()
    x = made.converter.duty(column_currents(made.network(0), g))
    cells = walk.cells_of(made, x, on_columns(g))
    ends = [walk.count_cells(cells, n, made.timing.charge_delay_clocks) for n in range(1, clocks + 1)]
    counts = np.array([count[0, :, 0] for count, _ in ends]).T
    charge = np.array([end[0, :, 0] for _, end in ends]).T
    # After a one the comparator is not sampled, and `read` skips it.
    bits, stored = np.diff(counts, prepend=0) > 0, np.hstack([cells.w0[0, :, :1], charge])
    return [Slot(own, own, volts) for own, volts in zip(bits, stored, strict=True)]


def compare(case: Case, slots: Sequence[Slot]) -> dict[int, float]:
    """Return the counts at 510 clocks of the circuit less those of the model, by ideal code; errors of `read`."""
    apart = counts(read(slots)) - counts(read(model_slots(model(case), case.clocks)))
    return dict(zip(case.codes[SETTLING_ROWS:], apart[SETTLING_ROWS:].tolist(), strict=True))
