# SPDX-License-Identifier: Apache-2.0
"""A simulator that dies or hangs: exit code, place, log, and no process left."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from system_bench import MakePlan, processes_with

from dermis.engines import cosim
from dermis.errors import SimulatorError
from tb.programs.faults.bench import poll


def gone(text: str) -> bool:
    """Return True once no process with a text in its command line is left."""
    return bool(poll(lambda: not processes_with(text), 5.0))


def test_an_abort_of_ngspice_names_time_node_and_log(resistance_plan: MakePlan, tmp_path: Path) -> None:
    made = resistance_plan(np.full((2, 4), 1000.0))
    broken = replace(made, converter=replace(made.converter, i_offset_a=np.full(4, -1e300)))
    with pytest.raises(SimulatorError, match=r"row \d.* at [\d.e-]+ s.*Timestep too small.*node") as caught:
        cosim.run(broken, work=tmp_path / "work")
    assert caught.value.exit_code == 3
    assert "Timestep too small" in Path(caught.value.log).read_text()
    assert gone(str(tmp_path / "work"))


def test_a_dead_hdl_simulator_ends_the_run(resistance_plan: MakePlan, tmp_path: Path) -> None:
    made = resistance_plan(np.full((16, 4), 1000.0))
    work = tmp_path / "work"

    def kill_vvp(slots: int) -> None:
        for pid in processes_with(str(work)):
            if Path(f"/proc/{pid}/comm").read_text().strip() == "vvp":
                os.kill(pid, signal.SIGSEGV)

    with pytest.raises(SimulatorError, match="without a result in frame 0, row") as caught:
        cosim.run(made, kill_vvp, work=work)
    assert Path(caught.value.log).is_dir()
    assert gone(str(work))


def test_a_simulator_that_stops_answering_is_ended(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of 1e-25 s does not advance time in double precision."""
    monkeypatch.setattr(cosim, "SLOT_LIMIT_S", 2.0)
    made = resistance_plan(np.full((1, 1), 1000.0))
    with pytest.raises(SimulatorError, match="stopped answering"):
        cosim.run(made, solver=cosim.Solver(t_max_step_s=1e-25), work=tmp_path / "work")
    assert gone(str(tmp_path / "work"))
