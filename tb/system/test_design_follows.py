# SPDX-License-Identifier: Apache-2.0
"""Claim: another array, clock and number of bits in models/design.toml, and everything follows."""

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from dermis.scene.design import ROOT
from scripts.demo import browser, demo

pytestmark = [pytest.mark.long, pytest.mark.timeout(1500)]

ASKED = "--rows 32 --cols 32 --bits 10 --f-clk-hz 10e6 --frame-s 8e-3 --settle-fraction 0.18 --write".split()
TESTS = [
    *(f"tb/model/test_{name}.py" for name in "calculator decode design generate register_files vfc".split()),
    *(f"tb/rtl/{name}" for name in "gated_counter harden registers row_scanner".split()),
    "tb/spice/test_blocks.py",
]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the checkout, with its environment as a link, and write the other design."""
    copy = tmp_path_factory.mktemp("follows") / "tree"
    left_out = shutil.ignore_patterns(".venv", ".git", "build", ".*cache*", ".hypothesis")
    shutil.copytree(ROOT, copy, ignore=left_out)
    (copy / ".venv").symlink_to(ROOT / ".venv")
    run(copy, "calc", *ASKED)
    run(copy, "generate")
    return copy


def run(tree: Path, *command: str, program: str = "dermis") -> str:
    """Run a command of the copy; return its output."""
    environment = {**os.environ, "PYTHONPATH": f"{tree / 'models'}{os.pathsep}{tree}"}
    together = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    command = (str(tree / ".venv" / "bin" / program), *command)
    done = subprocess.run(command, cwd=tree, env=environment, timeout=1200, **together)
    assert done.returncode == 0, done.stdout[-4000:]
    return done.stdout


def test_generated_files_follow(tree: Path) -> None:
    assert "0 FAIL, 0 ERROR" in run(tree, "generate", "--check")
    header = (tree / "rtl" / "dermis_design.vh").read_text()
    values = dict(re.findall(r"^`define (DERMIS_\w+) +(\d+)$", header, re.M))
    assert values["DERMIS_ROWS"] == values["DERMIS_COLS"] == "32"
    assert (values["DERMIS_CODE_BITS"], values["DERMIS_GATE_CLOCKS"]) == ("10", "2046")
    assert "set clk_period 100.0" in (tree / "rtl" / "synth" / "dermis.sdc").read_text()
    # A second time there is nothing to do.
    assert "everything is up to date" in run(tree, "generate")


def test_verilog_and_decks_are_clean_and_the_tests_pass(tree: Path) -> None:
    assert "0 FAIL, 0 ERROR" in run(tree, "lint")
    said = run(tree, "-q", "-n", "2", "--import-mode=importlib", *TESTS, program="pytest")
    assert " passed" in said
    assert "values of the paper" in said


@pytest.mark.parametrize("engine", ["closed", "rtl"])
def test_a_scene_is_read_with_the_new_array_and_bits(tree: Path, engine: str) -> None:
    scene = tree / "follows.toml"
    scene.write_text('[stimulus]\nkind = "uniform"\nforce_n = 15.0\n')
    run(tree, "run", str(scene), "--engine", engine, "--out", str(tree / "out"))
    codes = np.load(tree / "out" / "codes.npy")
    assert codes.shape[1:] == (32, 32)
    assert codes.dtype == np.uint16
    assert (codes == 1023).all()
    assert tomllib.loads((tree / "out" / "resolved.toml").read_text())["array"] == {"rows": 32, "cols": 32}


def test_the_page_with_the_chip_reads_the_new_array_and_bits(tree: Path) -> None:
    if reason := browser.missing() or demo.have_compiler():
        pytest.skip(reason)
    run(tree, "demo", "--check")
    rows = json.loads((tree / "build" / "demo.json").read_text())
    wrong = next(row for row in rows if row["name"] == "demo.wrong_codes")
    assert (wrong["status"], wrong["value"]) == ("PASS", 0), wrong
