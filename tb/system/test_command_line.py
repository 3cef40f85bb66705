# SPDX-License-Identifier: Apache-2.0
"""The command as a stranger uses it: results, their files, and one clear line for every mistake."""

import csv
import json
import os
import shlex
import shutil
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from system_bench import dermis

from dermis import cli, plan, simulate
from dermis.chip.netlist import frame_deck
from dermis.cli import main
from dermis.scene.design import ROOT
from dermis.scene.design import load as load_design

Write = Callable[..., Path]
Here = Callable[..., tuple[int, str]]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    """The command line in this process, for errors before any work: exit code and standard error.

    A process for each would spend a second on imports.
    """

    def call(*arguments: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["dermis", *arguments])
        monkeypatch.chdir(ROOT)
        code = cli._run()
        return code, capsys.readouterr().err

    return call


def test_a_run_writes_every_file_and_its_resolved_scene_gives_the_same_codes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in ("transient.png", "waves.vcd", "notes.txt"):
        (out / name).write_text("of an earlier run")
    done = dermis("run", "single_touch", "--out", str(out))
    assert done.returncode == 0, done.stderr
    # Files of another kind of run do not stay, files of the user do.
    assert not (out / "transient.png").exists()
    assert not (out / "waves.vcd").exists()
    assert (out / "notes.txt").exists()
    codes = np.load(out / "codes.npy")
    assert codes.dtype == np.min_scalar_type(load_design().timing.code_max)
    assert codes.shape == (1, 16, 16)
    with (out / "codes.csv").open() as file:
        table = list(csv.reader(file))
    assert table[0] == ["frame", "row", *(f"c{c}" for c in range(16))]
    assert np.array_equal(np.array(table[1:], int)[:, 2:], codes.reshape(16, 16))
    summary = json.loads((out / "summary.json").read_text())
    assert summary["engine"] == "closed"
    assert {e["name"] for e in summary["effects"] if e["on"]} == set(
        tomllib.loads((ROOT / "models/scenes/single_touch.toml").read_text())["effects"]
    )
    assert all(e["reason"] for e in summary["effects"])
    total = codes.astype(float).sum() * 15.0 / 255
    # 256 sums of numbers written with all their digits.
    assert abs(summary["decoded"]["total_force_n"][0] - total) < 1e-9 * total
    assert (out / "frame.png").stat().st_size > 10_000
    assert np.array_equal(simulate(out / "resolved.toml").codes, codes)


def test_a_run_checks_only_when_asked_and_says_what_that_costs(tmp_path: Path, write_scene: Write) -> None:
    text = '[stimulus]\nkind = "uniform"\ncode = [50, 100, 150]\n[effects]\nauto = {}\n'
    scene, out = str(write_scene(text)), tmp_path / "out"

    def rows(*options: str) -> dict[str, dict[str, object]]:
        done = dermis("run", scene, "--out", str(out), *options)
        assert done.returncode == 0, done.stderr
        table = json.loads((out / "summary.json").read_text())["verdicts"]
        return {row["name"].removesuffix(".scene"): row for row in table}

    asked = rows("--check", "300", "--processes", "2")
    assert asked["frame.code_error_lsb"]["note"].endswith("; 2 of 3 frames")
    assert asked["run.check_cpu_s"]["value"] > 0
    assert rows().keys() == {"run.taxels_at_full_scale"}


def one_line(code: int, said: str, words: str) -> None:
    """Judge the end of a command: exit 2, and one line on standard error with some words."""
    assert code == 2
    assert len(said.strip().splitlines()) == 1
    assert words in said


UNIFORM = '[stimulus]\nkind = "uniform"\nforce_n = 3.0\n'
WRONG = [  # a command, and what its one line must say
    ("nonsense", "No such command 'nonsense'"),
    ("run", "Missing argument 'SCENE'"),
    ("run no_such_scene", "single_touch"),
    (f"run {'x' * 5000}", "single_touch"),
    (
        "run single_touch --engine 'magic\n.control'",
        "engine = magic .control: one of closed, event, rtl, cosim",
    ),
    ("run single_touch --out /dev/null", "out = /dev/null: a directory"),
    ("run single_touch --out ''", 'out = "": a directory'),
    ("run single_touch --waves", "--waves = closed: engine cosim"),
    ("run single_touch --simulator verilator", "--simulator = closed: engine rtl or cosim"),
    ("run single_touch --processes 0", "1<=x<=1024"),
    ("run single_touch --processes many", "'many'"),
    ("run uniform_staircase --processes 2 --engine cosim", "1 for engine cosim"),
    ("plan no_such_scene", "single_touch"),
    ("plan single_touch --engine magic", "engine = magic"),
    ("auto-check --scenes -1", "x>=1"),
    ("ablate", "Missing argument 'SCENE'"),
    ("ablate flat_indenter", "flat_indenter.toml: effects = none on"),
    ("ablate nonideal_channel --engine closed", "engine event or rtl or cosim"),
    ("ablate nonideal_channel --pairs 0", "x>=1"),
    ("sim --frames no_such_file.csv", "--frames = no_such_file.csv"),
    ("sim --frames README.md", "--frames = README.md"),
    ("sim --only no_such_case", "one of flat_indenter"),
]
WRONG_FILES = [  # a command, the content of its file, and what its one line must say
    ("run {} --engine cosim", UNIFORM + "colour = 1\n", "stimulus.colour"),
    ("run {} --engine cosim", UNIFORM + "[effects]\nrow_driver = { r_ohm = -1.0 }\n", "row_driver"),
    ("run {}", "title = 'a'\ntitle = 'b'\n" + UNIFORM, "title"),
    ("run {}", '[stimulus]\nkind = "resistance"\nfile = "no.csv"\n', "no.csv"),
    ("sim --only frame_file --frames {}", "1,2,3", "input"),
    ("sim --only frame_file --frames {}", ",".join(["256"] * 256), "input"),
    ("sim --only frame_file --frames {}", ".control\nshell touch gotcha\n.endc", "input"),
]


@pytest.mark.parametrize(
    ("command", "content", "words"), [*((c, None, words) for c, words in WRONG), *WRONG_FILES]
)
def test_a_mistake_ends_in_one_line_and_exit_2(
    tmp_path: Path, here: Here, command: str, content: str | None, words: str
) -> None:
    if content is not None:
        path = tmp_path / ("input.csv" if command.startswith("sim") else "input.toml")
        path.write_text(content)
        command = command.format(path)
    code, said = here(*shlex.split(command))
    one_line(code, said, words)
    assert content is None or path.name in said


FAILS_IN_THE_ENGINE = """
[stimulus]
kind = "uniform"
force_n = [3.0, 4.0]
[run]
engine = "event"
[effects]
trace = { r_row_ohm = 100.0, r_column_ohm = 100.0 }
line_capacitance = { c_row_f = 1e-7, c_column_f = 1e-7 }
"""


@pytest.mark.long
@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_run_that_fails_leaves_nothing(tmp_path: Path, processes: str, write_scene: Write) -> None:
    scene, out = write_scene(FAILS_IN_THE_ENGINE), tmp_path / "out"
    arguments = ["run", str(scene), "--out", str(out), "--processes", processes]
    done = dermis(*arguments)
    one_line(done.returncode, done.stderr, "effects.line_capacitance")
    assert not out.exists()
    # What an earlier run left stays whole.
    write_scene(FAILS_IN_THE_ENGINE.replace("100.0", "0.01"))
    assert dermis(*arguments).returncode == 0
    before = _contents(out)
    assert len(before) == 5
    write_scene(FAILS_IN_THE_ENGINE)
    assert dermis(*arguments).returncode == 2
    assert _contents(out) == before


def _contents(out: Path) -> dict[Path, bytes | None]:
    return {p.relative_to(out): p.read_bytes() if p.is_file() else None for p in out.rglob("*")}


@pytest.mark.parametrize("name", ["codes.npy", "waves.vcd"])
def test_a_directory_in_the_place_of_a_file_is_refused(tmp_path: Path, name: str, here: Here) -> None:
    out = tmp_path / "out"
    (out / name).mkdir(parents=True)
    (out / "codes.csv").write_text("of an earlier run")
    before = _contents(out)
    one_line(*here("run", "single_touch", "--out", str(out)), name)
    assert _contents(out) == before


def test_a_defect_is_one_line_even_where_its_log_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(**_: object) -> None:
        raise ValueError("no such thing")

    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    monkeypatch.setattr("dermis.cli.cli", broken)
    for root, said in ((tmp_path, "(log: "), (tmp_path / "missing", "ValueError: no such thing\n")):
        monkeypatch.setattr("dermis.cli.BUILD", root / "build")
        with pytest.raises(SystemExit) as raised:
            main()
        assert raised.value.code == 3
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert "no such thing" in (tmp_path / "build" / "internal_error.log").read_text()


def test_an_ablation_prints_what_it_writes(write_scene: Write) -> None:
    names = ("mirror_ratio", "offset_current")
    text = f"[array]\nrows = 2\ncols = 2\n{UNIFORM}[effects]\n" + "".join(f"{n} = true\n" for n in names)
    done = dermis("ablate", str(write_scene(text)), "--engine", "event", "--pairs", "1", "--frames", "1")
    assert done.returncode == 0, done.stderr
    rows = {row["name"]: row for row in json.loads((ROOT / "build" / "ablate.json").read_text())}
    assert {name.split(".")[1] for name in rows} == {"all_effects", *names}
    for name in names:
        line = next(line.split() for line in done.stdout.splitlines() if line.split()[:1] == [name])
        assert int(line[1]) == rows[f"ablate.{name}.code_max_lsb"]["value"]


def test_a_missing_simulator_is_named(tmp_path: Path) -> None:
    """A PATH with Python alone: Icarus must be asked for, not crashed on."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "cc").symlink_to(shutil.which("cc") or "/usr/bin/cc")
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{Path(sys.executable).parent}"}
    done = dermis("run", "single_touch", "--engine", "cosim", "--out", str(tmp_path / "out"), env=environment)
    one_line(done.returncode, done.stderr, "iverilog")


def test_no_text_of_a_scene_reaches_the_deck(tmp_path: Path, write_scene: Write) -> None:
    file = tmp_path / "x\n.control\nshell touch gotcha\n.endc.npy"
    np.save(file, np.full((2, 2), 1e3))
    name = file.name.replace("\n", "\\n")
    scene = write_scene(
        f'title = "a\\n.control\\nshell touch gotcha\\n.endc"\n[array]\nrows = 2\ncols = 2\n'
        f'[stimulus]\nkind = "resistance"\nfile = "{name}"\n'
    )
    made = plan.load(scene, "cosim")
    deck = frame_deck(made, 0, [0.0] * 5).lines
    assert not [line for line in deck if "\n" in line or "gotcha" in line or ".control" in line]


def test_frames_of_a_pressure_sheet_read_back_as_their_codes(tmp_path: Path, gait_csv: Path) -> None:
    """Verilog and ngspice read the strongest frame."""
    frame = max(gait_csv.read_text().splitlines(), key=lambda line: sum(map(float, line.split(","))))
    file = tmp_path / "sheet.csv"
    file.write_text(f"{frame}\n")
    done = dermis("sim", "--frames", str(file), "--only", "frame_file")
    assert done.returncode == 0, done.stdout + done.stderr
    rows = {row["name"]: row for row in json.loads((ROOT / "build" / "sim.json").read_text())}
    assert rows["frame.readback_error_lsb.frame_file"]["status"] == "PASS"
    codes = np.load(ROOT / "build" / "sim" / "frame_file" / "codes.npy")
    assert np.array_equal(codes.ravel(), np.array(frame.split(","), float).astype(int))
