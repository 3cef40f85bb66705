# SPDX-License-Identifier: Apache-2.0
"""Pinned packages keep the markers of pyproject.toml, so that set-up asks for nothing a machine cannot have."""

from __future__ import annotations

import subprocess
import sys
import tomllib

from dermis.scene.design import ROOT

WANTED = ["click", "atheris; python_version < '3.14'", "typing-extensions; python_version < '4'"]


def _kept(tmp_path: object, frozen: str, wanted: list[str]) -> subprocess.CompletedProcess[str]:
    file = f"{tmp_path}/wanted.txt"
    with open(file, "w", encoding="utf-8") as stream:
        stream.write("\n".join(wanted))
    return subprocess.run(
        [sys.executable, ROOT / "scripts" / "keep_markers.py", file],
        input=frozen,
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_markers_that_freeze_drops_are_put_back(tmp_path: object) -> None:
    told = _kept(tmp_path, "atheris==3.0.0\nclick==8.5.1\ntyping_extensions==4.16.0\n", WANTED)
    assert told.stdout.splitlines() == [
        "atheris==3.0.0; python_version < '3.14'",
        "click==8.5.1",
        "typing_extensions==4.16.0; python_version < '4'",
    ]
    assert told.returncode == 0


def test_a_marked_package_that_is_not_there_is_told(tmp_path: object) -> None:
    told = _kept(tmp_path, "click==8.5.1\n", WANTED[:2])
    assert (told.returncode, told.stdout) == (2, "")
    assert told.stderr == "keep_markers: not installed by this Python on this machine: atheris\n"


def test_the_pins_have_the_markers_of_the_project(tmp_path: object) -> None:
    with open(ROOT / "pyproject.toml", "rb") as file:
        project = tomllib.load(file)["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["dev"]
    pinned = [
        line for line in (ROOT / "requirements.txt").read_text().splitlines() if not line.startswith("#")
    ]
    bare = "\n".join(line.split(";")[0] for line in pinned)
    assert _kept(tmp_path, bare, wanted).stdout.splitlines() == pinned
    assert any(";" in line for line in pinned)
