# SPDX-License-Identifier: Apache-2.0
"""The real Verilog with real-number models: equal to engine event, no trace of what is off, loud when it fails."""

import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from system_bench import OF_THE_CHIP, MakePlan, dermis, effects_of, of_codes, processes_with, scene_of

from dermis import effects, simulate
from dermis.chip import hdl, spi_protocol
from dermis.engines import closed, event, rtl
from dermis.errors import InputError, SimulatorError
from dermis.processes import children
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES
from scripts.markdown import filled


def random_ohm(seed: int, *shape: int) -> np.ndarray:
    """Resistances from overload to next to nothing."""
    return 350 * 200 ** np.random.default_rng(seed).random(shape)


def by_event(made: Plan, sync_latch: bool = False) -> np.ndarray:
    """Codes of engine event, as integers."""
    timing = replace(made.timing, charge_delay_clocks=0.5 if sync_latch else 1.0)
    return event.run(replace(made, timing=timing)).codes.astype(int)


# ---- the ideal reader


# The synchronizer does not know the topology, so one build with the latch is enough. Verilator compiles C++ for each
# build; the scenes below are its short test.
@pytest.mark.parametrize("simulator", ["icarus", pytest.param("verilator", marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("topology", "sync_latch"), [*((topology, False) for topology in TOPOLOGIES), ("conveyor_mirror", True)]
)
@pytest.mark.paper
def test_all_256_codes_read_back_exactly(
    resistance_plan: MakePlan, simulator: str, topology: str, sync_latch: bool
) -> None:
    codes = np.random.default_rng(3).permutation(256).reshape(16, 16)
    got = rtl.run(resistance_plan(of_codes(codes), topology), simulator=simulator, sync_latch=sync_latch)
    assert np.array_equal(got.codes[0], codes)


def test_ideal_scenes_equal_the_closed_formula_and_the_event_engine(resistance_plan: MakePlan) -> None:
    """Shorts, opens, overload, and resistances that stand on the boundary of two codes included."""
    ohm = random_ohm(1, 200, 16, 16)
    ohm[0] = np.resize([1000.0, 3000.0, 5000.0, 15000.0, 500.0, 312.0, 0.0, np.inf], (16, 16))
    ohm[1, ::2], ohm[1, 1::2] = 0.0, of_codes([2])[0]
    made = resistance_plan(ohm)
    got = rtl.run(made).codes
    assert np.array_equal(got, closed.run(made).codes)
    assert np.array_equal(got, event.run(made).codes)


# 128 columns are 1160 bits in 625 clocks: the clock of the host is faster than that of the chip.
@pytest.mark.parametrize(
    "shape", [(1, 1), (5, 1), (2, 20), pytest.param((1, 128), marks=pytest.mark.long)], ids=str
)
def test_any_size_reads_the_same(resistance_plan: MakePlan, shape: tuple[int, int]) -> None:
    made = resistance_plan(random_ohm(2, 3, *shape))
    assert np.array_equal(rtl.run(made, simulator="icarus").codes, closed.run(made).codes)


def test_parts_of_a_run_follow_each_other(resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    made = resistance_plan(random_ohm(4, 7, 3, 4))
    monkeypatch.setattr(rtl, "_VALUES_AT_ONCE", 30)
    seen: list[int] = []
    got = rtl.run(made, seen.append, simulator="icarus").codes
    assert np.array_equal(got, closed.run(made).codes)
    assert seen == sorted(seen)
    assert seen[-1] == 21
    assert {6, 12, 18} <= set(seen)


# ---- effects


@pytest.mark.long
@pytest.mark.parametrize("name", OF_THE_CHIP)
def test_an_effect_alone_equals_the_event_engine(resistance_plan: MakePlan, name: str) -> None:
    ohm = random_ohm(5, 2, 2, 12)
    effect = effects.EFFECTS[name]
    made = resistance_plan(ohm, effects=scene_of({**effect.needs, name: effect.example()}))
    for sync_latch in (False, True):
        got = rtl.run(made, simulator="icarus", sync_latch=sync_latch).codes.astype(int)
        expected = by_event(made, sync_latch)
        assert np.array_equal(got, expected)
        assert np.abs(expected - closed.run(resistance_plan(ohm)).codes).max() >= 1, "too small to be seen"


@pytest.mark.parametrize("simulator", ["icarus", pytest.param("verilator", marks=pytest.mark.long)])
@pytest.mark.parametrize("topology", ["conveyor_mirror", pytest.param("direct", marks=pytest.mark.long)])
@pytest.mark.paper
def test_all_effects_equal_the_event_engine(resistance_plan: MakePlan, simulator: str, topology: str) -> None:
    ohm = random_ohm(6, 2, 2, 3)  # columns at an edge and between others; Icarus takes 0.8 s for each
    made = resistance_plan(ohm, topology, scene_of(effects_of(topology)))
    for sync_latch in (False, True) if simulator == "icarus" else (False,):
        got = rtl.run(made, simulator=simulator, sync_latch=sync_latch).codes.astype(int)
        # A count may fall either side of a half in another engine's rounding.
        assert np.abs(got - by_event(made, sync_latch)).max() <= 1
        assert np.abs(got - closed.run(resistance_plan(ohm)).codes).max() > 3, "too small to be seen"


def test_one_build_serves_other_values(resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    first = resistance_plan(random_ohm(9, 2, 4), effects="mirror_ratio = { ratio_error = 0.01 }")
    rtl.run(first, simulator="icarus")

    def compile_again(*args: object, **options: object) -> None:
        pytest.fail("a second build")

    monkeypatch.setattr(children, "run_logged", compile_again)
    errors = "mirror_ratio = { ratio_error = [0.1, -0.1, 0, 0.2] }"
    second = resistance_plan(random_ohm(10, 5, 2, 4), effects=errors)
    assert np.array_equal(rtl.run(second, simulator="icarus").codes, closed.run(second).codes)


# ---- what is caught

FAULTS = {
    "packet_not_removed": ("charge_source.sv", "assign out    = d_charge;", "assign out    = 0.0;"),
    "preset_missing": ("integrator.sv", "drawn_q <= d_preset ? -out_preset : drawn_c", "drawn_q <= drawn_c"),
    "preset_at_zero": ("integrator.sv", "assign out_preset = -0.5;", "assign out_preset = 0.0;"),
    "row_of_before": ("array.sv", "row_select_i[n/(COLS*CELL)]", "row_select_i[(n/(COLS*CELL) + 1) % ROWS]"),
    "columns_swapped": ("skin.sv", "u_array.i_column[CELL*c + v]", "u_array.i_column[CELL*(COLS-1-c) + v]"),
    "comparator_upside_down": ("comparator.sv", "high_c = in_c >= rise;", "high_c = in_c < rise;"),
    "time_stands": ("skin.sv", "preset ? 1.0 : t_clocks + 1.0", "1.0"),
}


def with_fault(folder: Path, file: str, right: str, wrong: str) -> Path:
    """A copy of the models with one change."""
    models = shutil.copytree(rtl.MODELS, folder / "models")
    (models / file).write_text(filled((models / file).read_text(), {right: wrong}, file))
    return models


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_model_is_caught(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    monkeypatch.setattr(rtl, "MODELS", with_fault(tmp_path, *FAULTS[fault]))
    made = resistance_plan(of_codes(np.random.default_rng(3).permutation(256).reshape(16, 16)[:4]))
    wrong = rtl.run(made, simulator="icarus").codes
    assert not np.array_equal(wrong, closed.run(made).codes)


def test_verilator_needs_a_path_without_a_space(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """tb/system/test_wheel.py has the builds themselves, which go into the environment if build/ has a space."""
    monkeypatch.setattr(hdl, "BUILD", tmp_path / "two words")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "two words"))
    with pytest.raises(InputError, match="a path without a space"):
        hdl.build("verilator", "dermis_top", {})


def test_models_that_do_not_compile_end_with_the_log(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rtl, "MODELS", with_fault(tmp_path, "mirror.sv", "module mirror", "modul mirror"))
    for simulator in hdl.SIMULATORS:
        with pytest.raises(SimulatorError, match="failed with exit code") as caught:
            rtl.run(resistance_plan(random_ohm(11, 2, 2)), simulator=simulator)
        assert caught.value.exit_code == 3
        assert "mirror" in Path(caught.value.log).read_text()


CODES = np.array([[1, 2], [3, 4]], dtype=np.uint16)
FRAME = spi_protocol.pack_frame(spi_protocol.Frame(1, 2, 8, 510, (0, 1), CODES, CODES > 4))
"""A frame of 2 x 2 taxels as the chip sends it; tb/model/test_read_out.py has what is wrong in others."""
GOOD = f"3c{len(FRAME):04x}{FRAME.hex()}\n"
BIT_LOST = GOOD.replace("0102", "0103")


def writes(text: str) -> str:
    """A program in the simulator's place."""
    return f"open('frames.txt', 'w').write({text!r})"


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("raise SystemExit(1)", "exit code 1"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended with signal SIGSEGV"),
        ("pass", "left no frames"),
        (writes(GOOD[:-1]), "0 whole frames instead of 1"),
        (writes("e2\n"), "frame 0: the chip answers FRAME with e2"),
        (writes(GOOD[:-3] + "xx\n"), "is not a frame of the host protocol"),
        (writes(BIT_LOST), "frame 0: frame of 18 bytes: CRC"),
    ],
)
def test_bad_results_are_errors(resistance_plan: MakePlan, tmp_path: Path, program: str, said: str) -> None:
    made = resistance_plan(random_ohm(12, 2, 2))
    with pytest.raises(SimulatorError, match=re.escape(said)):
        rtl.simulate(made, [sys.executable, "-c", program], tmp_path, 1, lambda rows: None)


def test_a_simulator_that_stops_answering_is_ended(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rtl, "FRAME_LIMIT_S", 0.5)
    made, sleeps = resistance_plan(random_ohm(12, 2, 2)), f"import time; time.sleep(60)  # {tmp_path}"
    with pytest.raises(SimulatorError, match="wrote no frame"):
        rtl.simulate(made, [sys.executable, "-c", sleeps], tmp_path, 1, lambda rows: None)
    assert not processes_with(str(tmp_path))


# ---- the command


def test_the_command_runs_a_scene_and_says_which_engine(tmp_path: Path) -> None:
    done = dermis("run", "single_touch", "--engine", "rtl", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "(rtl, " in done.stdout
    assert np.array_equal(np.load(tmp_path / "codes.npy"), simulate("single_touch", engine="closed").codes)
