# SPDX-License-Identifier: Apache-2.0
"""One channel in SKY130 transistors behind the real Verilog: error of its integrator against time, by options.

There is no exact solution. The reference is the same run with a tenth of the tolerances and steps of 10 ns at most: it
is no better known than to some part of what the points with finer settings differ from it by.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan
from dermis.chip import netlist
from dermis.engines import cosim
from dermis.errors import InputError, SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from tb.programs.accuracy.converter import options_with
from tb.programs.accuracy.frames import recorded
from tb.programs.accuracy.point import Point

WORK = "one channel, SKY130 transistors"
R_OHM = 1371.0
"""About a third of full scale, on no boundary of two codes."""


def channel_plan(work: Path) -> Plan:
    """A sheet of one taxel, its channel in transistors."""
    work.mkdir(parents=True, exist_ok=True)
    np.save(work / "channel.npy", np.array([[R_OHM]]))
    data = {
        "array": {"rows": 1, "cols": 1},
        "stimulus": {"kind": "resistance", "file": "channel.npy"},
        "run": {"engine": "cosim", "views": "sky130"},
    }
    return plan.make(scene.from_data(data, work / "channel.toml"))


def _scaled(line: str, share: float, **other: str) -> str:
    """A line of options with every tolerance times `share`."""
    values = dict(word.split("=") for word in line.split()[1:])
    # All together, so that none hides the others; trtol is no tolerance of its own.
    moved = {name: share * float(values[name]) for name in ("reltol", "abstol", "vntol", "chgtol")}
    return options_with(line, **moved, **other)


def solvers(made: Plan) -> tuple[cosim.Solver, dict[str, cosim.Solver]]:
    """The reference's, and those of the points by their words; about the options of the deck as it is written."""
    deck = netlist.frame_deck(made, 0, [1.0, 1.0, 0.0])
    line = next(line for line in reversed(deck.lines) if line.startswith(".options"))
    return cosim.Solver(t_max_step_s=10e-9, options=_scaled(line, 0.1)), {
        "trap, tolerances x 10": cosim.Solver(options=_scaled(line, 10.0)),
        "trap, as the project has it": cosim.Solver(),
        "trap, step 50 ns": cosim.Solver(t_max_step_s=50e-9),
        "gear of order 2": cosim.Solver(options=_scaled(line, 1.0, method="gear", maxord="2")),
    }


def _run(made: Plan, solver: cosim.Solver) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Code, output of the integrator at the clocks of the gate in volt, processor seconds a clock."""
    begin = cpu_time.cpu_used_s()
    result = engines.run(made, simulator="verilator", solver=solver, record=True)
    seconds = cpu_time.cpu_used_s() - begin
    volts, _ = recorded(made, result.info["records"][0])
    return result.codes[0].astype(np.int64), volts, seconds / made.timing.slot_clocks


def apart_v(volts: NDArray[np.float64], reference: NDArray[np.float64], packet_v: float) -> float:
    """Largest difference in volt, whole packets apart: a pulse that falls a clock later is one for a clock."""
    difference = volts - reference
    return float(np.max(np.abs(difference - packet_v * np.rint(difference / packet_v))))


def measure(work: Path, tell: Callable[[str], None]) -> tuple[list[Point], list[Row]]:
    """The points, or none and a row with the reason: SKIP where transistors or a tool are missing, else ERROR."""
    name = "accuracy.cosim.sky130"
    try:
        made = channel_plan(work)
        packet_v = float(made.converter.packet_v()[0])
        tell(f"{WORK}, reference")
        finest, settings = solvers(made)
        codes, expected, seconds = _run(made, finest)
        points = []
        for words, solver in settings.items():
            tell(f"{WORK}, {words}")
            found, volts, taken = _run(made, solver)
            error = apart_v(volts, expected, packet_v)
            off = float(np.abs(found - codes).max())
            points.append(Point(WORK, "cosim, verilator, sky130", words, error, "V", off, (taken,)))
    except InputError as error:
        return [], [verdict.skip(name, str(error))]
    except SimulatorError as error:
        return [], [verdict.error(name, str(error))]
    tell(f"{WORK}: the reference took {1e3 * seconds:.3g} ms a clock")
    return points, []
