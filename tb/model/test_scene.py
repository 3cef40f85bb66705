# SPDX-License-Identifier: Apache-2.0
"""The scene reader: what is right comes back identical, what is wrong is one line that names it."""

import os
import re
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_plans import refused

from dermis import effects, engines
from dermis import plan as planning
from dermis.errors import InputError
from dermis.scene import design as design_module
from dermis.scene import scene
from dermis.scene.design import ROOT, TOPOLOGIES
from dermis.scene.schema import SCENE_BYTES_MAX, write_toml

Write = Callable[..., Path]
SCENES = sorted((ROOT / "models" / "scenes").glob("*.toml"))

UNIFORM = '[stimulus]\nkind = "uniform"\ncode = 17\n'


@pytest.mark.paper
@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_resolved_scene_loads_to_an_identical_plan(path: Path, tmp_path: Path) -> None:
    plan = planning.load(path)
    resolved = tmp_path / "deep" / "resolved.toml"
    resolved.parent.mkdir()
    resolved.write_text(plan.resolved_toml(resolved.parent), encoding="utf-8")
    again = planning.load(resolved)
    for name in ("topology", "timing", "drive", "sensor", "effects", "engine", "seed", "views"):
        assert getattr(plan, name) == getattr(again, name)
    assert np.array_equal(plan.resistance_ohm, again.resistance_ohm)
    assert np.array_equal(plan.converter.gain, again.converter.gain)
    assert again.resolved_toml(resolved.parent) == plan.resolved_toml(resolved.parent)


def test_every_stimulus_law_and_interface_has_a_scene() -> None:
    tables = [scene.load(path).table for path in SCENES]
    parts = [part for t in tables for part in [t.stimulus, *getattr(t.stimulus, "parts", [])]]
    known = [key for key, *_ in scene.schema_rows() if key.startswith("stimulus kind")]
    assert {part.kind for part in parts} == {key.split("= ")[1].split(".")[0] for key in known}
    shapes = {getattr(part, "shape", None) for part in parts} - {None}
    assert shapes == {"flat", "triangular", "cylindrical", "spherical", "round"}
    assert {t.sensor.law for t in tables} == {"inverse", "power"}
    assert {t.interface.topology for t in tables} == set(TOPOLOGIES)
    assert {t.interface.k for t in tables} >= {20, design_module.load().interface.k, 160}
    named = {name for path in SCENES for name in scene.load(path).effects}
    assert named == set(effects.EFFECTS)
    assert all(t.title for t in tables)


@pytest.mark.paper
def test_resolved_scene_names_every_default(write_scene: Write) -> None:
    on = "row_driver = { r_ohm = 3.0 }\nlateral = true\n"
    text = planning.load(write_scene(EFFECTS + on)).resolved_toml()
    for line in ("rows = 16", "k = 80", "v_bias_v = 0.5", "k_force_n_ohm = 7500.0", "seed = 0"):
        assert line in text
    assert "row_driver = { r_ohm = 3.0, grounded_r_ohm = 3.0 }" in text
    assert "lateral = { r_ohm = 1000.0 }" in text
    assert "column_input" not in text


TITLES = ["plain", "a\nb\n.control\n.endc", '"quoted" \\ \t \x7f', "Ünïcödé ☃ 😀 \u202e", "", " \u00a0"]


@pytest.mark.parametrize("title", TITLES)
def test_any_title_survives_the_round_trip(title: str, write_scene: Write, tmp_path: Path) -> None:
    plan = planning.load(write_scene(write_toml({"title": title}) + UNIFORM))
    assert plan.scene.title == title
    path = tmp_path / "resolved.toml"
    path.write_text(plan.resolved_toml(tmp_path), encoding="utf-8")
    assert planning.load(path).scene.title == title


FRAMES = "[stimulus]\nkind = 'frames'\nunit = 'codes'\n"
EFFECTS = UNIFORM + "[effects]\n"
SENSOR = UNIFORM + "[sensor]\n"
POWER = SENSOR + "law = 'power'\n"
DIRECT = UNIFORM + "[interface]\ntopology = 'direct'\n[effects]\n"

# (scene text, the key that is named, a piece of what is allowed); test_strictness.py has every key alone.
WRONG = [
    ("", "stimulus", "a table with a kind"),
    ("tittle = 'x'\n" + UNIFORM, "tittle", "known here: array, effects, front_end, interface"),
    ("[stimulus]\nkind = 'slipping'\n", "stimulus.kind", "indenter"),
    ("[[stimulus]]\nkind = 'uniform'\n", "stimulus", "a table"),
    ("[stimulus]\nkind = 'uniform'\n", "stimulus", "exactly one of"),
    ("[stimulus]\nkind = 'uniform'\ncode = [1, -1]\n", "stimulus.code.1", "0..255"),
    ("[stimulus]\nkind = 'indenter'\nshape = 'flat'\n", "stimulus", "exactly one of force_n, total_force_n"),
    (UNIFORM + "[interface]\nk = 81\n", "interface.k", "20, 40, 80, 160"),
    (UNIFORM + "[interface]\nc_int_f = 1e-13\n", "interface.c_int_f", "packet"),
    (EFFECTS + "latteral = true\n", "effects.latteral", "lateral"),
    (EFFECTS + "column_input = { r_ohm = [1, 2] }\n", "effects.column_input.r_ohm", "list of 16"),
    (EFFECTS + "mirror_ratio = { ratio_error = -1 }\n", "effects.mirror_ratio.ratio_error", "> -1"),
    (EFFECTS + "comparator_delay = { t_s = 2e-7 }\n", "effects.comparator_delay.t_s", "one clock"),
    (DIRECT + "mirror_ratio = true\n", "effects.mirror_ratio", "conveyor_mirror"),
    (DIRECT + "column_input = true\n", "effects.column_input.r_ohm", "no default"),
    (EFFECTS + "comparator_hysteresis = { v_v = 1.0 }\n", "effects.comparator_hysteresis.v_v", "one packet"),
    (EFFECTS + "integrator_range = { v_max_v = 0.3, v_min_v = -0.3 }", "effects.integrator_range", "the range"),
    (EFFECTS + "integrator_range = true\npreset_error = { v_v = -2 }",
     "effects.integrator_range and effects.preset_error", "inside the range"),
    (EFFECTS + "charge_packet = { packet_error = -0.6 }\nreference_drift = { tc_per_k = 0.01, delta_k = -50 }",
     "effects.charge_packet and effects.reference_drift", "above 0 together"),
    (UNIFORM + "[run]\ntime_s = 3\n", "run.time_s", "removed; use [effects] auto"),
    (UNIFORM + "code = 18\n", "TOML", "valid TOML"),
    ("title = \n" + UNIFORM, "TOML", "line 1"),
    ("x = 99999-99-99\n", "TOML", "valid TOML"),
    ("a" + ".a" * 40 + " = 1\n", "line 1", "keys of fewer than 32 parts"),
    ("\n\n[" + " . ".join("x" * 40) + "]\n", "line 3", "keys of fewer than 32 parts"),
    ('"" = 1\n' + UNIFORM, "scene", "unknown key"),
    ("x = " + "[" * 5000 + "]" * 5000, "TOML", "valid TOML"),
    ("x = 1" + "0" * 5000 + "\n" + UNIFORM, "TOML", "valid TOML"),
    (UNIFORM + "[interface]\nk_column = [80, 80]\n", "interface.k_column", "a list of 16, one a column"),
    (UNIFORM + f"[interface]\nk_column = {[80] * 15 + [81]}\n", "interface.k_column", "each one of 20, 40, 80, 160"),
    (UNIFORM + f"[interface]\ntopology = 'direct'\nk_column = {[80] * 16}\n", "interface.k_column", "no mirror"),
    (SENSOR + "r_open_ohm = 1e6", "sensor.r_open_ohm", 'left out with law "inverse"'),
    (SENSOR + "force_points_n = [1, 2]", "sensor.force_points_n", 'left out with law "inverse"'),
    (POWER + "k_force_n_ohm = 7e3", "sensor.k_force_n_ohm", 'left out with law "power"'),
    (POWER + "force_points_n = [1, 2]", "sensor.r_points_ohm", "2 resistances"),
    (POWER + "force_points_n = [1, 2, 2, 3]", "sensor.force_points_n", "rise"),
    (POWER + "force_points_n = [2, 1, 3, 4]", "sensor.force_points_n", "rise"),
    (POWER + "force_points_n = [0, 1]", "sensor.force_points_n.0", "1e-9"),
    (POWER + "r_points_ohm = [1e3, 1e3, 10, 1]", "sensor.r_points_ohm", "fall"),
    (POWER + "r_points_ohm = [1e3, nan]", "sensor.r_points_ohm.1", "1e-6"),
    (POWER + "r_open_ohm = 30e3", "sensor.r_open_ohm", "above the first of r_points_ohm, 30000"),
    (FRAMES, "stimulus.file", "csv"),
    (FRAMES + "file = 'a.csv'\n", "stimulus.file", "No such file"),
    (FRAMES + "file = 'a.xls'\n", "stimulus.file", ".csv"),
    (FRAMES + 'file = "a\\u0000.csv"\n', "stimulus.file", "file name"),
    (FRAMES + "file = 'x/../..csv'\n", "stimulus.file", "No such file"),
    (FRAMES + "file = 'a.csv'\nkey = 'codes'\n", "stimulus.key", "npz"),
]  # fmt: skip


@pytest.mark.paper
@pytest.mark.parametrize(("text", "key", "allowed"), WRONG)
def test_a_wrong_scene_is_one_line_that_names_key_and_what_is_allowed(
    text: str, key: str, allowed: str, write_scene: Write
) -> None:
    error = refused(planning.load, write_scene(text))
    assert error.key == key
    assert allowed in error.allowed
    assert Path(error.file).name == "scene.toml"


def test_the_line_reads_as_promised(write_scene: Write) -> None:
    path = write_scene(UNIFORM + "[interface]\nv_bias_v = 'half a volt'\n")
    expected = f'{path}: interface.v_bias_v = "half a volt": a finite number > 0, at most 10'
    assert str(refused(planning.load, path)) == expected


def test_what_is_no_file_is_one_line(tmp_path: Path) -> None:
    assert "No such file" in refused(planning.load, tmp_path / "absent.toml").allowed
    assert "regular file" in refused(planning.load, tmp_path).allowed
    (tmp_path / "binary.toml").write_bytes(b"a = '\xff'\n")
    assert "text in UTF-8" in refused(planning.load, tmp_path / "binary.toml").allowed
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    assert "regular file" in refused(planning.load, pipe).allowed
    huge = tmp_path / "huge.toml"
    with open(huge, "wb") as stream:
        stream.truncate(SCENE_BYTES_MAX + 1)
    assert "at most" in refused(planning.load, huge).allowed
    with pytest.raises(InputError):
        planning.load(str(tmp_path / "nul\0.toml"))


def test_every_scene_shown_on_the_page_runs(write_scene: Write) -> None:
    page = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    shown = [block for block in re.findall(r"(?:^(?:    .*)?\n)+", page, re.M) if "[stimulus]" in block]
    assert len(shown) >= 2
    for block in shown:
        plan = planning.load(write_scene(textwrap.dedent(block)), "closed")
        assert engines.run(plan).codes.any()


def test_the_page_on_scenes_holds_the_table_of_the_schema() -> None:
    page = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    assert scene.schema_table() in page
    assert scene.scenes_table() in page


def test_a_name_is_a_stored_scene_or_a_file_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("single_touch").mkdir()  # as the results of a run
    assert scene.find("single_touch") == scene.SCENES / "single_touch.toml"
    Path("two_fingers").write_text("")
    with pytest.raises(InputError, match=r"two_fingers: \./two_fingers for the file"):
        scene.find("two_fingers")
    assert scene.find("./two_fingers") == Path("two_fingers")
