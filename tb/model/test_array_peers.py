# SPDX-License-Identifier: Apache-2.0
"""The array solve against solvers that others wrote: badcrossbar and ngspice."""

from __future__ import annotations

import logging
import os
import re
import shutil
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dermis.array.array import Network, column_currents

with warnings.catch_warnings(record=True):
    # It complains, whatever the filters say, that it cannot draw.
    import badcrossbar

logging.getLogger("badcrossbar").setLevel(logging.WARNING)


def badcrossbar_currents(network: Network) -> NDArray[np.float64]:
    """All slots of a network that has nothing but traces, each with one word line at v_bias_v and 0 on the others."""
    with np.errstate(divide="ignore"):
        resistance = 1 / network.g_taxel_s
    solution = badcrossbar.compute(
        network.v_bias_v * np.eye(network.rows),
        resistance,
        r_i_word_line=network.r_trace_row_ohm,
        r_i_bit_line=network.r_trace_column_ohm,
        node_voltages=False,
        all_currents=False,
    )
    return np.asarray(solution.currents.output)


@pytest.mark.parametrize(
    ("row_ohm", "column_ohm"), [(0.1, 0.1), (2.0, 0.5), (0.0, 1.0), (1.0, 0.0), (50.0, 80.0)]
)
def test_distributed_lines_are_those_of_badcrossbar_to_1e_12(row_ohm: float, column_ohm: float) -> None:
    rng = np.random.default_rng(11)
    for shape in ((16, 16), (16, 16), (5, 9), (12, 3), (2, 2)):
        g = 1 / np.exp(rng.uniform(np.log(500), np.log(64250), shape))
        g[rng.random(shape) < 0.1] = 0.0
        network = Network(g, 0.5, r_trace_row_ohm=row_ohm, r_trace_column_ohm=column_ohm)
        theirs = badcrossbar_currents(network)
        miss = np.abs(column_currents(network) - theirs)
        # What our solver promises; their LU leaves some 1e-16 of the largest current on the smallest.
        assert (miss <= 1e-12 * np.abs(theirs) + 1e-15 * theirs.max()).all()


def test_badcrossbar_would_see_another_geometry() -> None:
    g = 1 / np.random.default_rng(11).uniform(500, 64250, (6, 5))
    network = Network(g, 0.5, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1)
    mirrored = Network(g[:, ::-1], 0.5, r_trace_row_ohm=0.1, r_trace_column_ohm=0.1)
    # 0.1 ohm a step in 500 ohm is 2e-4; a twentieth of that is far above any rounding.
    assert np.abs(column_currents(mirrored)[:, ::-1] / badcrossbar_currents(network) - 1).max() > 1e-5


def deck(network: Network) -> str:
    """Every slot of a network as a circuit of its own, in one deck; resistances of 0 join their nodes."""
    lines = ["array"]
    count = 0

    def resistor(a: str, b: str, ohm: float) -> None:
        nonlocal count
        if np.isfinite(ohm):
            count += 1
            lines.append(f"r{count} {a} {b} {float(ohm)!r}")

    rows, cols = network.rows, network.cols
    names = []
    for slot in range(rows):
        for r in range(rows):
            series = network.r_row_driven_ohm if r == slot else network.r_row_grounded_ohm
            volt = network.v_bias_v if r == slot else 0.0
            first = f"s{slot}d{r}"
            source = f"s{slot}e{r}" if series else first
            lines.append(f"v{source} {source} 0 {volt!r}")
            if series:
                resistor(source, first, float(series))
            for c in range(cols):
                here = f"s{slot}u{r}_{c}"
                resistor(first, here, network.r_trace_row_ohm)
                first = here
                if g := network.g_taxel_s[r, c]:
                    resistor(here, f"s{slot}v{r}_{c}", float(1 / g))
                if c + 1 < cols and network.g_lateral_row_s:
                    resistor(f"s{slot}v{r}_{c}", f"s{slot}v{r}_{c + 1}", 1 / network.g_lateral_row_s)
                below = f"s{slot}v{r + 1}_{c}" if r + 1 < rows else f"s{slot}c{c}"
                resistor(f"s{slot}v{r}_{c}", below, network.r_trace_column_ohm)
                if r + 1 < rows and network.g_lateral_column_s:
                    resistor(f"s{slot}v{r}_{c}", below, 1 / network.g_lateral_column_s)
        for c in range(cols):
            names.append(f"vi{slot}_{c}")
            resistor(f"s{slot}c{c}", f"s{slot}i{c}", float(network.r_column_ohm[c]))
            lines.append(f"{names[-1]} s{slot}i{c} 0 {float(network.v_column_offset_v[c])!r}")
            lines.append(f"ileak{slot}_{c} 0 s{slot}c{c} {float(network.i_leak_a[c])!r}")
    prints = [f"print i({name})" for name in names]
    # A linear circuit: Newton takes one step; tolerances near rounding make it take the second that removes
    # gmin.
    options = ".options reltol=1e-12 abstol=1e-18 vntol=1e-15 gmin=1e-18 pivrel=1e-3"
    return "\n".join(
        [*lines, options, ".control", "set numdgt=15", "op", *prints, "quit", ".endc", ".end", ""]
    )


def ngspice_says(text: str, folder: Path) -> str:
    """Run a deck in batch mode and return all that ngspice prints."""
    tool = shutil.which("ngspice")
    assert tool, "make setup installs ngspice"
    (folder / "array.sp").write_text(text)
    done = subprocess.run(
        [tool, "-b", "array.sp"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "NGSPICE_MEAS_PRECISION": "15"},
        stdin=subprocess.DEVNULL,
    )
    return done.stdout + done.stderr


def ngspice_currents(network: Network, folder: Path) -> NDArray[np.float64]:
    """Column currents of all slots as ngspice's operating point prints them."""
    said = ngspice_says(deck(network), folder)
    found = re.findall(r"^i\(vi(\d+)_(\d+)\) = ([-+]?\d\.\d+e[-+]\d+)\s*$", said, re.MULTILINE)
    currents = np.full((network.rows, network.cols), np.nan)
    for slot, column, value in found:
        currents[int(slot), int(column)] = float(value)
    assert np.isfinite(currents).all(), said
    return currents
