# SPDX-License-Identifier: Apache-2.0
"""A look at the integrators of engine `rtl`, clock by clock: its models with one line more, which writes them down.

The models themselves hand out bits only. What is timed is run without that line.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.engines import Result, rtl
from dermis.errors import SimulatorError
from dermis.records import Plan

_LINE = '  always @(posedge clk_i) $display("integrator %m %b %b %.17g", d_preset, d_charge, v_c);\n'
_SAID = re.compile(rb"^integrator (\S+) ([01]) ([01]) (\S+)$", re.MULTILINE)


def models(directory: Path) -> Path:
    """Copy the real-number models to a new directory, the converter with the line that writes its output."""
    shutil.copytree(rtl.MODELS, directory)
    file = directory / "vfc.sv"
    text = file.read_text()
    if text.count("endmodule") != 1:
        raise ValueError(f"{file} is not one module")
    file.write_text(text.replace("endmodule", f"{_LINE}endmodule"))
    return directory


def run(plan: Plan, simulator: str, work: Path) -> tuple[Result, NDArray[np.float64], NDArray[np.int64]]:
    """Run the first frame of a plan and look.

    Parameters
    ----------
    plan : Plan
    simulator : "verilator" or "icarus"
    work : a directory that is not there yet

    Returns
    -------
    Result
        Of the first frame.
    output : ndarray
        [rows, cols, gate clocks] output of each integrator in packets at every clock of its gate behind the opening,
        just before what happens there.
    charge : ndarray of 0 and 1
        [rows, cols, gate clocks] what the charge switch was told at the clocks from the opening of the gate on, but for
        the last.

    Raises
    ------
    SimulatorError
        The simulator failed, or did not write what it should.
    """
    work.mkdir(parents=True)
    place = models(work / "models")
    one = plan.part(0, 1)
    result = rtl.run(one, simulator=simulator, work=work / "run", models=place)
    log = work / "run" / "simulator.log"
    said = _SAID.findall(log.read_bytes())
    names = list(dict.fromkeys(name for name, *_ in said))
    if len(names) != plan.cols:
        raise SimulatorError(f"{len(names)} integrators were written down, not {plan.cols}", log)
    names.sort(key=lambda name: int((re.findall(rb"\[(\d+)\]", name) or [b"0"])[-1]))
    gate = plan.timing.gate_clocks
    output = np.empty((plan.rows, plan.cols, gate))
    charge = np.empty((plan.rows, plan.cols, gate), dtype=np.int64)
    for column, name in enumerate(names):
        table = [line[1:] for line in said if line[0] == name]
        held = np.array([held == b"1" for held, _, _ in table])
        told = np.array([int(bit) for _, bit, _ in table])
        volts = np.array([float(value) for _, _, value in table])
        # The first clock that is not held closes the first clock of a gate: the one before it is its opening.
        opens = np.flatnonzero(held[:-1] & ~held[1:])[: plan.rows]
        if opens.size < plan.rows or opens[-1] + gate >= volts.size:
            raise SimulatorError(f"the gates of column {column} are not all there", log)
        for row, begin in enumerate(opens):
            output[row, column] = volts[begin + 1 : begin + gate + 1]
            charge[row, column] = told[begin + 1 : begin + gate + 1]
    return result, output, charge
