# SPDX-License-Identifier: Apache-2.0
"""What a clock of a channel in transistors costs: `python tb/system/views_cost.py` prints docs/views.md's figures.

One column of a deck in lock-step with two flip-flops, without the Verilog; processor time of this machine as it is.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from dermis import plan as planning
from dermis.chip import ladder, netlist
from dermis.chip.ngspice import NgspiceHalf
from dermis.scene import scene

SETTLE, CLOCKS = 10, 50

CASES: tuple[tuple[str, Any, int, float], ...] = (
    ("1 row, 1 kohm: a packet in four clocks", "sky130", 1, 1e3),
    ("1 row, 1 Mohm: none", "sky130", 1, 1e6),
    ("16 rows, 1 kohm", "sky130", 16, 1e3),
    ("16 rows, 1 kohm, row drivers models", {"row_driver": "behavioural"}, 16, 1e3),
)


def cost(views: Any, rows: int, ohm: float, log: Path) -> tuple[float, float, float]:
    """Steps, iterations and seconds of a processor a clock, of one column of sixteen."""
    data = {
        "array": {"rows": rows, "cols": 16},
        "stimulus": {"kind": "uniform", "r_ohm": ohm},
        "run": {"engine": "cosim", "views": views},
    }
    made = planning.make(scene.from_data(data, log.with_suffix(".toml")))
    t_clk = 1.0 / made.timing.f_clk_hz
    levels = [1.0] + [0.0] * (rows - 1) + [1.0] + [0.0] * made.cols
    half = NgspiceHalf(
        netlist.frame_deck(made, 0, levels, columns=(0,)),
        t_edge_s=1e-9,
        t_max_step_s=1e-6,
        t_stop_s=CLOCKS * t_clk,
        log=log,
        level=ladder.Level(start=1),
    )
    half.advance(0.0, [])
    sample = charge = False
    edges: list[tuple[float, int, float]] = []
    before, start = half.statistics, time.process_time()
    for clock in range(1, CLOCKS + 1):
        comparator = half.advance(clock * t_clk, edges)[0] > 0.0
        old, charge = charge, sample
        sample = bool(comparator) and not sample and clock >= SETTLE
        edges = [(clock * t_clk, rows + 1, float(charge))] if charge != old else []
        if clock == SETTLE:
            edges.append((clock * t_clk, rows, 0.0))
            before, start = half.statistics, time.process_time()
    seconds, after = time.process_time() - start, half.statistics
    half.close()
    clocks = CLOCKS - SETTLE
    steps, loads = ((after[name] - before[name]) / clocks for name in ("accepted", "loads"))
    return steps, loads, seconds / clocks


def main() -> None:
    """Print the table."""
    print("| one column | steps a clock | iterations a clock | ms a clock | us an iteration |")
    print("|---|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        for name, views, rows, ohm in CASES:
            steps, loads, seconds = cost(views, rows, ohm, Path(folder) / "ngspice.log")
            print(
                f"| {name} | {steps:.1f} | {loads:.0f} | {1e3 * seconds:.1f} | {1e6 * seconds / loads:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
