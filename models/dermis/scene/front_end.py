# SPDX-License-Identifier: Apache-2.0
"""[front_end]: a board with dividers or transimpedance amplifiers and an ADC in place of the chip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from dermis.ndarrays import Floats
from dermis.scene.schema import Strict, allowed_of, entry, filled, refuse

LEAST_R = 100.0
"""Default of r_min_ohm: this part of the divider. A count is 2.5 % of the conductance there, with 12 bits."""
EFFECT_FIELDS = frozenset(
    "g_lateral_row_s g_lateral_column_s r_trace_row_ohm r_trace_column_ohm r_return_ohm v_column_offset_v "
    "i_leak_a".split()
)
"""Record fields of effects that a board may have; a front end gives the others itself, or has none."""


_Ohm = Annotated[float, Field(gt=0)]


class FrontEndTable(Strict):
    """[front_end]: the board that reads the sheet."""

    circuit: Literal["divider", "transimpedance"] = entry(
        ...,
        "divider: a resistor a column, and the ADC reads the column; transimpedance: an amplifier a column holds it at "
        "the level of the idle rows",
    )
    full_scale: int = entry(..., "Largest count of the ADC, 4095 for 12 bits", ge=1, le=65535)
    supply_v: float = entry(
        ...,
        "Voltage between the driven row and the far end of the divider, or the amplifier's level, in V",
        gt=0,
    )
    reference_v: float | None = entry(
        None, "Voltage of the ADC's full scale, full_scale + 1 counts, in V", default_from="supply_v", gt=0
    )
    resistor_ohm: _Ohm | list[_Ohm] = entry(
        ..., "Divider or feedback resistor, in ohm", "a number > 0, or a list of one a column"
    )
    side: Literal["ground", "supply"] | None = entry(
        None,
        "divider: end of the resistor. ground: a driven row is at the supply, counts rise with force; supply: it is at "
        "ground, counts fall",
        "ground or supply; with circuit divider it must be given",
    )
    zero_count: float | None = entry(
        None,
        "transimpedance: count without force, the mean of readings by this ADC, so that it has its rounding in it",
        "a number >= 0; with circuit transimpedance it must be given",
        ge=0,
    )
    counts: Literal["rise", "fall"] | None = entry(
        None,
        "transimpedance: direction of the counts with force",
        "rise or fall; with circuit transimpedance it must be given",
    )
    idle_rows: Literal["held", "open"] = entry(
        ...,
        "Rows that are not driven. held: at the far end of the divider, or at the amplifier's level; open: unconnected",
    )
    idle_columns: Literal["loaded", "open"] = entry(
        "loaded",
        "loaded: every column has its resistor or amplifier all the time; open: one is switched from column to column, "
        "which no decoder here can invert",
    )
    multiplexer_ohm: float = entry(0.0, "On-resistance in series with every row, in ohm", ge=0)
    rounding: Literal["nearest", "down"] = entry(
        "nearest", "divider: how the ADC rounds, to the nearest count or down"
    )
    r_min_ohm: float | None = entry(
        None,
        "Smallest resistance of a pressed taxel, in ohm; what reads less is saturated",
        default_from="1/100 of resistor_ohm",
        gt=0,
    )


@dataclass(frozen=True, eq=False)
class FrontEnd:
    """A board as a decoder needs it: rising counts are step_a (count - start_count) in ampere."""

    full_scale: int  # largest count
    falling: bool  # the ADC counts down with force: `full_scale` less its count rises
    divider: bool
    step_a: Floats  # [cols] ampere a count
    start_count: Floats  # [cols] of no current
    full_count: Floats  # [cols] from which on a taxel is saturated
    zero_count: int  # largest that no current may have
    g_max_s: float  # conductance of r_min_ohm
    network: dict[str, Any]  # fields of array.Network that the board sets

    @classmethod
    def of_table(cls, table: FrontEndTable, cols: int) -> FrontEnd:
        """Return the record of a resolved table for this number of columns."""
        ohm = np.broadcast_to(np.asarray(table.resistor_ohm, dtype=float), cols)
        divider, low = table.circuit == "divider", table.rounding == "down"
        falling = table.side == "supply" if divider else table.counts == "fall"
        step_a = table.reference_v / (table.full_scale + 1) / ohm
        if divider:
            # The middle of count n is n, or n + 1/2 if rounded down; seen from the supply it is full_scale + 1 - n.
            start, zero = (0.5 * low - 1.0 if falling else -0.5 * low), 0
        else:
            start = table.full_scale - table.zero_count if falling else table.zero_count
            zero = int(np.floor(start + 0.5))
        in_column, in_row = ohm.copy() if divider else 0.0, table.multiplexer_ohm
        held = in_row if table.idle_rows == "held" else np.inf
        network = {"r_row_driven_ohm": in_row, "r_row_grounded_ohm": held, "r_column_ohm": in_column}
        least_a = table.supply_v / (table.r_min_ohm + in_column)
        full = np.minimum(np.floor(least_a / step_a + start + 0.5), table.full_scale)
        made = table.full_scale, falling, divider, step_a, np.full(cols, start), full, zero
        return cls(*made, 1.0 / table.r_min_ohm, network)


_OWN = {"divider": ("side",), "transimpedance": ("zero_count", "counts")}


def resolve(table: FrontEndTable, cols: int, file: Path | str) -> FrontEndTable:
    """Fill in the defaults; refuse keys of the other circuit and boards that cannot be inverted."""
    least_ohm = float(np.min(table.resistor_ohm, initial=np.inf)) / LEAST_R
    table = filled(table, {"reference_v": table.supply_v, "r_min_ohm": least_ohm})
    refuse(_wrong(table, cols), table, file, "front_end.")
    return table


def _wrong(table: FrontEndTable, cols: int) -> Iterator[tuple[str, str]]:
    """Yield keys with impossible values, the missing ones first, and what is allowed."""
    for circuit, names in _OWN.items():
        for name in names:
            missing = getattr(table, name) is None
            if circuit == table.circuit and missing:
                yield name, allowed_of(FrontEndTable.model_fields[name])
            if circuit != table.circuit and not missing:
                yield name, f'left out with circuit "{table.circuit}"'
    if table.idle_columns == "open":
        said = '"loaded"; with one resistor for all columns the open ones float, and no decoder here inverts that'
        yield "idle_columns", said
    if np.size(table.resistor_ohm) not in (1, cols):
        yield "resistor_ohm", f"a number > 0, or a list of {cols}, one a column"
    if table.side == "supply" and table.reference_v != table.supply_v:
        said = f"{table.supply_v:g}, as supply_v: a divider to the supply is measured from there"
        yield "reference_v", said
    if table.counts == "rise" and table.zero_count >= table.full_scale:
        yield "zero_count", f"below full_scale, {table.full_scale}"
    if table.counts == "fall" and not 0 < table.zero_count <= table.full_scale:
        yield "zero_count", f"above 0, at most full_scale, {table.full_scale}, as counts fall from there"
