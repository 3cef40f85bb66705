# SPDX-License-Identifier: Apache-2.0
"""`dermis board`: one column of the direct interface from parts on a board, in ngspice (docs/board.md)."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

import click
import numpy as np

from dermis.chip import spice_batch
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.lockstep import ladder
from dermis.places import BUILD, ROOT
from dermis.report import verdict
from dermis.scene.design import load as load_design
from scripts.judged import SHOW, attempt, finish

Changes = Mapping[str, float]
"""Parameters of spice/board/column.sp with other values."""
_BOARDS = tomllib.loads((ROOT / "spice" / "board" / "boards.toml").read_text(encoding="utf-8"))
FIT: dict[str, Changes] = _BOARDS["fit"]
UNFIT: dict[str, Changes] = _BOARDS["unfit"]


def conversion(r_taxel_ohm: float, changes: Changes, work: Path) -> Mapping[str, float]:
    """Return the measurements of one conversion on a board; `work` receives deck and log.

    KeyError if the deck has no such parameter, SimulatorError if ngspice did not measure.
    """
    text = (ROOT / "spice" / "board" / "column.sp").read_text(encoding="utf-8")
    text = text.replace(".include ../design.inc", f'.include "{ROOT}/spice/design.inc"')
    for name, value in {**changes, "r_taxel_ohm": r_taxel_ohm}.items():
        text, found = re.subn(rf"(?m)^\.param {name} = .*$", f".param {name} = {float(value)!r}", text)
        if not found:
            raise KeyError(name)
    write_atomic(work / "column.sp", text)
    # Newton's method alone does not find the start of the saturating amplifier.
    return spice_batch.run(work / "column.sp", level=ladder.Level(start=1)).values


def column_error(changes: Changes, points: int, work: Path) -> tuple[float, str]:
    """Return the largest |code / gain - 510 x| of a board in LSB, and a note.

    The gain is that of the same parts with the first resistance alone. x is the charge balance
    (docs/charge_balance.md) at the voltage of a row behind row_driver.r_on_ohm, as the host knows it.
    """
    design = load_design()
    ohm = np.geomspace(1.01 * design.sensor.r_min_ohm, design.sensor.r_max_ohm, points)
    row_s = np.array([1 / ohm, 1 / ohm + changes.get("other_row", 0) / design.sensor.r_min_ohm])
    v_row = design.interface.v_bias_v / (1 + design.row_driver.r_on_ohm * row_s)
    i0_a = design.derived()["converter.i0_direct_a"]
    alone, line = design.timing.gate_clocks * v_row / i0_a / ohm
    gain = conversion(ohm[0], {**changes, "other_column": 0, "other_row": 0}, work)["packets"] / alone[0]
    found = (conversion(r, changes, work) for r in ohm)
    counts = np.array([(round(values["pulses"]), values["packets"]) for values in found]).T
    error, fine = np.abs(counts / gain - line).max(axis=1)
    return float(error), f"{fine:.2f} without rounding, gain {gain:.4f}, {points} resistances"


@click.command("board", context_settings=SHOW)
@click.option("--points", type=click.IntRange(8, 256), default=40, help="Number of resistances a board.")
def board_command(points: int) -> int:
    """Convert resistances with a column on a board, in ngspice: error after one gain point."""
    rows = []
    for kind, boards in (("column_error_lsb", FIT), ("unfit_error_lsb", UNFIT)):
        for key, changes in ((f"board.{kind}.{name}", changes) for name, changes in boards.items()):
            with attempt(rows, key):
                rows.append(verdict.judge(key, *column_error(changes, points, BUILD / "board")))
    code = finish("board", rows, "a column on a board: error after one gain point")
    return SimulatorError.exit_code if any(row["status"] == "ERROR" for row in rows) else code
