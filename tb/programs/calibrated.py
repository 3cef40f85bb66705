# SPDX-License-Identifier: Apache-2.0
"""`dermis calibrated`: columns of spice/sky130 with mismatch through the closed loop, after calibration.

Each draw is a whole `column`. It is calibrated at 27 C as the host does it (dermis.chip.column_calibration), with its
own pedestal and test current. Its readings are then compared with the currents of known taxels, at 27 C and at the
ends of temperature and supply.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from dermis.chip import column_calibration, netlist, sky130
from dermis.chip.ngspice import Deck
from dermis.chip.spice_text import spice_number
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.report import progress, verdict
from dermis.report.verdict import Row
from dermis.scene import design as design_module
from dermis.scene.design import Design
from scripts.characterise.benches import SUPPLY_V, Condition
from tb.programs.equivalence import cases, gate
from tb.programs.equivalence.loop import Slot

ERRORS = BUILD / "calibrated" / "errors.json"
"""Error in codes of every draw by condition and resistance."""
DRAWS = 100
CLOCKS = 32
"""Decisions of a row; the charge at each of them gives the count of a full gate (docs/equivalence.md)."""
SHIFT_A = 2.5e-6
"""Current taken from the integrator in a shifted row, known by the same taxel with and without it."""
EXTREMES = tuple(Condition("tt", celsius, supply) for celsius in (-40.0, 125.0) for supply in (0.9, 1.1))


@dataclass(frozen=True)
class Load:
    """What a row adds to the column while it is driven: a taxel, the test current or nothing.

    A duty above 1/2 is not counted, and with the pedestal 500 ohm has 0.508, so such a row is read less SHIFT_A.
    """

    ohm: float = math.inf
    test: bool = False
    shifted: bool = False


DARK, TEST, KNOWN, SHIFTED = Load(), Load(test=True), Load(1e3), Load(1e3, shifted=True)
FULL, LOW = Load(500.0, shifted=True), Load(64e3)
SETTLING = 3
"""Rows after power-on in which the offset null settles: a gate of CLOCKS has three of its time constants."""
CALIBRATION = (DARK,) * SETTLING + (DARK, TEST, KNOWN, SHIFTED, FULL, LOW)
NEAR_FULL = Load(0.5 / 0.9e-3)
DRIFT = (DARK,) * SETTLING + (NEAR_FULL, LOW)
"""Loads away from 27 C; the error at 500 ohm is on the line through those of NEAR_FULL and LOW."""


def deck_of(loads: Sequence[Load], condition: Condition, design: Design, blocks: Path | None = None) -> Deck:
    """Return the deck of a column with a row for each load, ideal row drivers and the capacitance of its line."""
    k = design.interface.k
    d_k0, d_k1 = (("vss_d", "vdd_d")[(20, 40, 80, 160).index(k) >> n & 1] for n in (0, 1))
    test = [r for r, load in enumerate(loads) if load.test]
    lines = [
        f"column of {len(loads)} loads at {condition}",
        *([f".options seed={condition.sample}"] if condition.sample is not None else []),
        *sky130.deck_head(condition.corner, condition.celsius, condition.sample is not None, blocks),
        *sky130.supplies(SUPPLY_V, -SUPPLY_V, condition.supply),
        *sky130.REFERENCE,
        sky130.bias_current("ibias"),
        f"vbias vbias 0 {design.interface.v_bias_v!r}",
        *(f"v_row{r} row{r} 0 external" for r in range(len(loads))),
    ]
    for r, load in enumerate(loads):
        if math.isfinite(load.ohm):
            lines.append(f"rtaxel{r} row{r} col {spice_number(load.ohm)}")
        if load.shifted:
            lines.append(f"gshift{r} xch.v_sum 0 row{r} 0 {SHIFT_A / design.interface.v_bias_v:.9g}")
    gain = sky130.logic_v(condition.supply) / design.interface.v_bias_v
    lines += [
        f"etest d_test vss_d row{test[0]} 0 {gain:.9g}" if test else "vtest d_test vss_d 0",
        f"ccolumn col 0 {spice_number(design.array.c_column_f)}",
        "v_d_preset logic_preset 0 external",
        "v_d_charge logic_charge 0 external",
        *(sky130.logic(name, condition.supply) for name in ("preset", "charge")),
        f"xch col d_charge d_preset {d_k0} {d_k1} d_test comp vbias vref agnd ibias vdd vss vdd_d vss_d column",
        netlist.transistor_options(),
    ]
    names = (*(f"v_row{r}" for r in range(len(loads))), "v_d_preset", "v_d_charge")
    levels = (design.interface.v_bias_v, *[0.0] * (len(loads) - 1), 1.0, 0.0)
    abrupt = (*[False] * len(loads), True, False)
    probes = ("xch.v_comp", "xch.xvfc.v_int")
    growth = netlist.STEP_GROWTH_TRANSISTORS
    return cases.whole(Deck(tuple(lines), names, levels, abrupt, probes, step_growth=growth))


def column_of(
    loads: Sequence[Load], condition: Condition, design: Design, blocks: Path | None = None
) -> cases.Column:
    """Return the column of `deck_of` to run."""
    return cases.Column(deck_of(loads, condition, design, blocks), CLOCKS)


@dataclass(frozen=True)
class Line:
    """Charge in packets at the clocks of a gate: start + slope n, counted from the level of the decision."""

    start: float
    slope: float

    def count(self, clocks: int) -> int:
        """Return the count of a gate."""
        return math.floor(self.start + self.slope * clocks + 1.0)

    def code(self, clocks: int) -> float:
        """Return the code before it is rounded: half a packet of preset is not in it."""
        return self.start + self.slope * clocks + 0.5


def lines_of(loads: Sequence[Load], slots: Sequence[Slot]) -> dict[Load, Line]:
    """Return the line of each load, without those of the first SETTLING rows."""
    found = gate.read(slots[SETTLING:])
    pairs = zip(found.start.tolist(), found.slope.tolist(), strict=True)
    return {load: Line(*pair) for load, pair in zip(loads[SETTLING:], pairs, strict=True)}


@dataclass(frozen=True)
class Calibrated:
    """Values that the host stores of a column: current of a code and code without current."""

    step_a: float
    start_code: float

    def current_a(self, code: float) -> float:
        """Return the column's current."""
        return self.step_a * (code - self.start_code)


def calibrate(lines: Mapping[Load, Line], i_test_a: float, design: Design) -> Calibrated:
    """Return the values of a column from its counts, as `column_calibration.measure` finds them."""
    normal = design.timing.gate_clocks
    long = column_calibration.DARK_GATES * normal
    gates = column_calibration.full_gates(normal)
    dark = lines[DARK].count(long) / long
    counts = np.array([[lines[TEST].count(n)] for n in gates], dtype=float)
    full = float(column_calibration.duty(counts, gates)[0])
    return Calibrated(i_test_a / (normal * (full - dark)), normal * dark)


def test_current_a(lines: Mapping[Load, Line], design: Design) -> float:
    """Return the test current of the chip: that of a column without mismatch, against a known taxel."""
    dark, test, known = (lines[load].slope for load in (DARK, TEST, KNOWN))
    return (test - dark) / (known - dark) * design.interface.v_bias_v / KNOWN.ohm


def errors_lsb(lines: Mapping[Load, Line], values: Calibrated, design: Design) -> dict[float, float]:
    """Return the error of each taxel by its resistance, in codes; rounding to whole codes is not in it."""
    normal, volt = design.timing.gate_clocks, design.interface.v_bias_v
    code_a = design.interface.k * design.converter.i0_a / normal
    shift = lines[KNOWN].code(normal) - lines[SHIFTED].code(normal) if SHIFTED in lines else 0.0
    return {
        load.ohm: (values.current_a(line.code(normal) + shift * load.shifted) - volt / load.ohm) / code_a
        for load, line in lines.items()
        if math.isfinite(load.ohm) and load != SHIFTED
    }


def drift_lsb(lines: Mapping[Load, Line], values: Calibrated, design: Design) -> dict[float, float]:
    """Return the errors at 500 ohm and 64 kohm; the first from the line through those of DRIFT."""
    found = errors_lsb(lines, values, design)
    near, low = found[NEAR_FULL.ohm], found[LOW.ohm]
    far = (1 / FULL.ohm - 1 / LOW.ohm) / (1 / NEAR_FULL.ohm - 1 / LOW.ohm)
    return {FULL.ohm: low + (near - low) * far, LOW.ohm: low}


def _worst(found: Mapping[str, Mapping[float, float]]) -> tuple[float, str]:
    value, where, ohm = max(
        ((error, where, ohm) for where, errors in found.items() for ohm, error in errors.items()),
        key=lambda one: abs(one[0]),
    )
    return abs(value), f"{value:+.3f} at {where}, {ohm:g} ohm"


def rows_of(
    shown: Mapping[Condition, Sequence[Slot] | str], design: Design
) -> tuple[list[Row], dict[str, dict[str, float]]]:
    """Return the verdicts of all draws, and the error of each by condition and resistance."""
    names = ("pedestal_lsb", "calibrated_error", "calibrated_drift")
    faults = [f"{at}: {slots}" for at, slots in shown.items() if isinstance(slots, str)]
    typical = shown[Condition()]
    if isinstance(typical, str):
        return [verdict.error(f"sky130.{name}", faults[0], "lsb") for name in names], {}
    lines = {
        at: lines_of(DRIFT if at.celsius != Condition().celsius else CALIBRATION, slots)
        for at, slots in shown.items()
        if not isinstance(slots, str)
    }
    i_test_a = test_current_a(lines[Condition()], design)
    gate_clocks = design.timing.gate_clocks
    zero, still, moved = {}, {}, {}
    own = {at.sample: calibrate(one, i_test_a, design) for at, one in lines.items() if DARK in one}
    for at, one in lines.items():
        if at.sample is None:
            continue
        if DARK in one:
            zero[str(at)] = one[DARK].code(gate_clocks)
            still[str(at)] = errors_lsb(one, own[at.sample], design)
        elif at.sample in own:
            moved[str(at)] = drift_lsb(one, own[at.sample], design)
    rows = []
    for name, found in zip(names, (zero, still, moved), strict=True):
        full = f"sky130.{name}"
        if not found:
            rows.append(verdict.error(full, faults[0] if faults else "no draw", "lsb"))
            continue
        if name == "pedestal_lsb":
            where = min(zero, key=zero.__getitem__)
            worst, said = zero[where], f"{where}; mean {np.mean([*zero.values()]):.2f}"
        else:
            worst, said = _worst(found)
            ends = np.array([errors[FULL.ohm] for errors in found.values()])
            said += f"; at 500 ohm {ends.mean():+.3f}, sigma {ends.std():.3f}"
        row = verdict.judge(full, worst, f"{len(found)} columns, worst {said}")
        lost = [fault for fault in faults if ("27" not in fault) == (name == "calibrated_drift")]
        if lost and row["status"] == "PASS":
            row |= {"status": "ERROR", "note": f"{len(lost)} not measured, {lost[0]}; {row['note']}"}
        rows.append(row)
    table = {at: {f"{ohm:g}": e for ohm, e in errors.items()} for at, errors in (still | moved).items()}
    return rows, table


@click.command("calibrated")
@click.option("--draws", default=DRAWS, show_default=True, type=click.IntRange(1, 10**4), help="Columns.")
@click.option("--still", is_flag=True, help="27 C and nominal supply alone.")
@click.option(
    "--jobs", default=os.cpu_count(), show_default=True, type=click.IntRange(1, 64), help="Processes."
)
@click.option("--fresh", is_flag=True, help="Run what is kept from earlier runs as well.")
def calibrated_command(draws: int, still: bool, jobs: int, fresh: bool) -> int:
    """Columns in transistors with mismatch, calibrated at 27 C: their zero, error and drift."""
    design = design_module.load()
    places: list[tuple[Condition, Sequence[Load]]] = [(Condition(), CALIBRATION)]
    places += [(Condition(sample=n), CALIBRATION) for n in range(1, draws + 1)]
    if not still:
        for n in range(1, draws + 1):
            places += [(Condition(at.corner, at.celsius, at.supply, n), DRIFT) for at in EXTREMES]
    columns = [column_of(loads, at, design) for at, loads in places]
    with progress.slots("calibrated", len(columns), "columns") as tell:
        found = cases.records(columns, jobs, tell, fresh)
    rows, table = rows_of(dict(zip((at for at, _ in places), found, strict=True)), design)
    if still:
        rows = rows[:2]
    write_atomic(ERRORS, json.dumps(table, indent=1) + "\n")
    verdict.write_rows("calibrated", rows)
    verdict.print_rows(rows, "calibrated")
    return verdict.exit_code(rows)
