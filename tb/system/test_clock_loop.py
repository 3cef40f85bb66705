# SPDX-License-Identifier: Apache-2.0
"""The clock loop in C does what the one in Python does: samples, voltages, pins and codes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from system_bench import MakePlan

from dermis.chip import hdl
from dermis.errors import SimulatorError
from dermis.lockstep import ngspice
from scripts.markdown import filled
from tb.programs.bench.circuit import in_simulator
from tb.reference import python_loop
from tb.reference.python_loop import Job

LIMIT_S = 120.0
OHM = 300 * 100 ** np.random.default_rng(11).random((2, 2, 3))
"""Two frames of 2 x 3 taxels."""
WIDE_OHM = 300 * 100 ** np.random.default_rng(12).random((1, 2, 40))
"""More columns than a word of VPI has bits."""


def run(job: Job, where: Path, simulator: str = "icarus") -> list[dict[str, Any]]:
    build = hdl.build(simulator, "dermis_top", hdl.reader_parameters(job.plan, job.sync_latch))
    where.mkdir()
    return in_simulator(python_loop.both, job, simulator, build, "dermis_top", where, LIMIT_S)


def difference(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Return the first quantity in which two runs differ, or nothing."""
    if one["trace"] != other["trace"]:
        return "pins"
    if not np.array_equal(one["codes"], other["codes"]):
        return "codes"
    if not all(np.array_equal(a, b) for a, b in zip(one["samples"], other["samples"], strict=True)):
        return "samples"
    pairs = zip(one["halves"], other["halves"], strict=True)
    for (steps, (time, volts)), (steps_2, (time_2, volts_2)) in pairs:
        if steps["accepted"] != steps_2["accepted"] or not np.array_equal(time, time_2):
            return "time points"
        if not all(np.array_equal(volts[name], volts_2[name]) for name in volts):
            return "voltages"
    return ""


LATE = "comparator_delay = { t_s = 5.3e-8 }"  # over 1/20 clock: sampled earlier, on a time point
CASES = {
    # topology, effects, half, latch, simulator
    "mirror": ("conveyor_mirror", "", "ngspice", False, "icarus"),
    "late-latch": ("conveyor_mirror", LATE, "ngspice", True, "icarus"),
    "direct-late": ("direct", LATE, "ngspice", False, "icarus"),
    "inverted": ("conveyor_mirror_inverted", "", "ngspice", True, "icarus"),
    "multi_output": ("multi_output_conveyor", "line_capacitance = true", "ngspice", False, "icarus"),
    "split": ("conveyor_mirror", "", "split", False, "icarus"),
    "exact": ("conveyor_mirror", "", "exact", True, "icarus"),
    "verilator": ("conveyor_mirror", "", "ngspice", False, "verilator"),
    "verilator-late-latch": ("multi_output_conveyor", LATE, "ngspice", True, "verilator"),
}


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=[pytest.mark.long] * (c not in ("late-latch", "exact"))) for c in CASES]
)
def test_both_loops_are_equal_to_the_bit(resistance_plan: MakePlan, tmp_path: Path, case: str) -> None:
    topology, effects, half, latch, simulator = CASES[case]
    made = resistance_plan(WIDE_OHM if half == "exact" else OHM, topology, effects)
    in_c, in_python = run(Job(made, half, latch), tmp_path / "run", simulator)
    assert difference(in_c, in_python) == ""
    assert len(in_c["samples"]) == made.frames
    assert np.ptp(in_c["codes"]) > 50, "the taxels cover a part of the range"
    if effects == LATE:
        made = resistance_plan(OHM, topology)
        prompt, _ = run(Job(made, half, latch), tmp_path / "prompt", simulator)
        assert difference(in_c, prompt), "late samples move something"


# Text of clock_loop.c, a fault in its place, and the quantity that shows it.
FAULTS = {
    "delay": ("(double)(net->tick - lp.event_tick)", "0.0", "codes|samples|pins"),
    "bit": ("put(out->handle, word", "word[0] >>= 1, put(out->handle, word", "codes|samples|pins"),
    "early": ("(edge ? loop.settle : 0)", "(loop.settle / 2)", "Error"),
}


@pytest.mark.parametrize("name", [pytest.param(f, marks=[pytest.mark.long] * (f != "delay")) for f in FAULTS])
def test_a_fault_in_the_loop_is_seen(resistance_plan: MakePlan, tmp_path: Path, name: str) -> None:
    right, wrong, seen = FAULTS[name]
    source = tmp_path / "clock_loop.c"
    source.write_text(filled(ngspice.LOOP_SOURCE.read_text(), {right: wrong}, source.name))
    try:
        found = difference(*run(Job(resistance_plan(OHM), "ngspice", True, source), tmp_path / "run"))
    except SimulatorError as error:
        found = f"Error {error}"
    assert found
    assert any(word in found for word in seen.split("|")), found
