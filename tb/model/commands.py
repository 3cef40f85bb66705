# SPDX-License-Identifier: Apache-2.0
"""Commands in this process, and what `dermis read` writes."""

import json
from pathlib import Path
from unittest import mock

import click
import numpy as np
from click.testing import CliRunner

from dermis.decode.decoder import Forces
from dermis.report import verdict
from dermis.report.read import read_command


def run(command: click.Command, *arguments: object) -> tuple[int, str]:
    """Return the exit code and the output of a command; it writes no rows into build/, and its errors are raised."""
    words = list(map(str, arguments))
    with mock.patch.object(verdict, "write_rows"):
        done = CliRunner().invoke(command, words, standalone_mode=False, catch_exceptions=False)
    return done.return_value, done.output


def read_array(folder: Path, values: np.ndarray, *options: object, unit: str = "newtons") -> tuple[int, str]:
    """Read an array by the command, with results in out/."""
    np.save(folder / "touch.npy", values)
    said = "--unit", unit, "--rate", 50, "--out", folder / "out"
    return run(read_command, folder / "touch.npy", *said, *options)


def decoded(out: Path) -> Forces:
    """Return the forces in a directory of results."""
    arrays = (np.load(out / f"forces{end}_n.npy") for end in ("", "_low", "_high"))
    return Forces(*arrays, np.empty(0, np.uint8))


def failed(out: Path) -> list[str]:
    """Return the names of the verdicts that failed."""
    verdicts = json.loads((out / "summary.json").read_text())["verdicts"]
    return [row["name"] for row in verdicts if row["status"] == "FAIL"]
