# SPDX-License-Identifier: Apache-2.0
"""`dermis calibrated`: columns of spice/sky130 with mismatch through the closed loop, after calibration.

Each draw is a whole `column`. It is calibrated at 27 C as the host does it (dermis.chip.column_calibration), with its
own pedestal and test current. Its readings are then compared with the currents of known taxels, at 27 C and at the
ends of temperature and supply.
"""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from dermis.chip import column_calibration, sky130
from dermis.files import write_atomic
from dermis.places import BUILD
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import design as design_module
from dermis.scene.design import Design
from scripts import judged
from scripts.characterise.benches import Condition
from tb.programs.equivalence import columns, gate
from tb.programs.equivalence.columns import Column, Slot, deck_of
from tb.programs.equivalence.gate import Line

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


def column_of(loads: Sequence[Load], condition: Condition, blocks: Path | None = None) -> Column:
    design = design_module.load()
    k, v_bias_v = design.interface.k, design.interface.v_bias_v
    elements = [f"vbias vbias 0 {v_bias_v!r}"]
    test = "vtest d_test vss_d 0"
    for r, load in enumerate(loads):
        if load.shifted:
            elements.append(f"gshift{r} xch.v_sum 0 row{r} 0 {SHIFT_A / v_bias_v:.9g}")
        if load.test:
            test = f"etest d_test vss_d row{r} 0 {sky130.logic_v(condition.supply) / v_bias_v:.9g}"
    d_k0, d_k1 = (("vss_d", "vdd_d")[sky130.MIRROR_RATIOS.index(k) >> n & 1] for n in (0, 1))
    pins = f"col d_charge d_preset {d_k0} {d_k1} d_test comp vbias vref agnd ibias vdd vss vdd_d vss_d"
    probes = ("xch.v_comp", "xch.xvfc.v_int")
    channel = [*elements, test, f"xch {pins} column"]
    deck = deck_of([load.ohm for load in loads], channel, probes, condition, blocks)
    return Column(deck, CLOCKS)


def lines_of(loads: Sequence[Load], slots: Sequence[Slot]) -> dict[Load, Line]:
    """Return the line of each load, without those of the first SETTLING rows."""
    return dict(zip(loads[SETTLING:], gate.read(slots[SETTLING:]), strict=True))


def code(line: Line, clocks: int) -> float:
    """Return the code of a gate before it is rounded: half a packet of preset is not in it."""
    return line.reach(clocks) - 0.5


Calibrated = tuple[float, float]
"""Values that the host stores of a column: current of a code, and code without current."""


def calibrate(lines: Mapping[Load, Line], i_test_a: float, design: Design) -> Calibrated:
    """Return the values of a column from its counts, as `column_calibration.measure` finds them."""
    normal = design.timing.gate_clocks
    long = column_calibration.DARK_GATES * normal
    gates = column_calibration.full_gates(normal)
    dark = math.floor(lines[DARK].reach(long)) / long
    counts = np.floor([[lines[TEST].reach(n)] for n in gates])
    full = float(column_calibration.duty(counts, gates)[0])
    return i_test_a / (normal * (full - dark)), normal * dark


def test_current_a(lines: Mapping[Load, Line], design: Design) -> float:
    """Return the test current of the chip: that of a column without mismatch, against a known taxel."""
    dark, test, known = (lines[load].slope for load in (DARK, TEST, KNOWN))
    return (test - dark) / (known - dark) * design.interface.v_bias_v / KNOWN.ohm


def errors_lsb(lines: Mapping[Load, Line], values: Calibrated, design: Design) -> dict[float, float]:
    """Return the error of each taxel by its resistance, in codes; rounding to whole codes is not in it."""
    normal, volt = design.timing.gate_clocks, design.interface.v_bias_v
    step_a, start_code = values
    code_a = design.interface.k * design.converter.i0_a / normal
    shift = code(lines[KNOWN], normal) - code(lines[SHIFTED], normal) if SHIFTED in lines else 0.0
    return {
        load.ohm: (step_a * (code(line, normal) + shift * load.shifted - start_code) - volt / load.ohm)
        / code_a
        for load, line in lines.items()
        if math.isfinite(load.ohm) and load != SHIFTED
    }


def drift_lsb(lines: Mapping[Load, Line], values: Calibrated, design: Design) -> dict[float, float]:
    """Return the errors at 500 ohm and 64 kohm; the first from the line through those of DRIFT."""
    found = errors_lsb(lines, values, design)
    near, low = found[NEAR_FULL.ohm], found[LOW.ohm]
    far = (1 / FULL.ohm - 1 / LOW.ohm) / (1 / NEAR_FULL.ohm - 1 / LOW.ohm)
    return {FULL.ohm: low + (near - low) * far, LOW.ohm: low}


def rows_of(
    shown: Mapping[Condition, Sequence[Slot] | str], design: Design
) -> tuple[list[Row], dict[str, dict[float, float]]]:
    """Return the verdicts of all draws, and the error of each by condition and resistance."""
    lost = {at: slots for at, slots in shown.items() if isinstance(slots, str)}
    still = {at: at.celsius == Condition().celsius for at in shown}
    loads = {at: CALIBRATION if still[at] else DRIFT for at in shown}
    lines = {at: lines_of(loads[at], slots) for at, slots in shown.items() if at not in lost}
    zero, error, drift = {}, {}, {}
    if Condition() in lines:
        i_test_a = test_current_a(lines.pop(Condition()), design)
        own = {at.sample: calibrate(one, i_test_a, design) for at, one in lines.items() if still[at]}
        for at, one in lines.items():
            if still[at]:
                zero[str(at)] = {math.inf: code(one[DARK], design.timing.gate_clocks)}
                error[str(at)] = errors_lsb(one, own[at.sample], design)
            elif at.sample in own:
                drift[str(at)] = drift_lsb(one, own[at.sample], design)
    rows = []
    for name, found in (("pedestal_lsb", zero), ("calibrated_error", error), ("calibrated_drift", drift)):
        faults = [f"{at}: {s}" for at, s in lost.items() if not found or still[at] == (found is not drift)]
        if not found:
            rows.append(verdict.error(f"sky130.{name}", (*faults, "no draw")[0]))
            continue
        every = [(value, at, ohm) for at, values in found.items() for ohm, value in values.items()]
        if found is zero:
            worst, at, _ = min(every)
            note = f"at {at}; mean {np.mean([value for value, _, _ in every]):.2f}"
        else:
            value, at, ohm = max(every, key=lambda one: abs(one[0]))
            worst, ends = abs(value), np.array([values[FULL.ohm] for values in found.values()])
            note = f"{value:+.3f} at {at}, {ohm:g} ohm; at 500 ohm {ends.mean():+.3f}, sigma {ends.std():.3f}"
        row = verdict.judge(f"sky130.{name}", worst, f"{len(found)} columns, worst {note}")
        if faults and row["status"] == "PASS":
            row |= {"status": "ERROR", "note": f"{len(faults)} not measured, {faults[0]}; {row['note']}"}
        rows.append(row)
    return rows, error | drift


@click.command("calibrated")
@click.option("--draws", default=DRAWS, show_default=True, type=click.IntRange(1, 10**4), help="Columns.")
@click.option("--still", is_flag=True, help="27 C and nominal supply alone.")
@columns.JOBS
@columns.FRESH
def calibrated_command(draws: int, still: bool, jobs: int, fresh: bool) -> int:
    """Columns in transistors with mismatch, calibrated at 27 C: their zero, error and drift."""
    samples = range(1, draws + 1)
    loads = {Condition(): CALIBRATION} | {Condition(sample=n): CALIBRATION for n in samples}
    if not still:
        loads |= {dataclasses.replace(at, sample=n): DRIFT for n in samples for at in EXTREMES}
    asked = [column_of(own, at) for at, own in loads.items()]
    found = columns.records(asked, jobs, "calibrated", fresh)
    rows, errors = rows_of(dict(zip(loads, found, strict=True)), design_module.load())
    rows = rows[:2] if still else rows
    table = {at: {f"{ohm:g}": e for ohm, e in values.items()} for at, values in errors.items()}
    write_atomic(ERRORS, json.dumps(table, indent=1) + "\n")
    return judged.finish("calibrated", rows, "calibrated")
