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
from dermis.array.settling import transients
from dermis.records import Timing

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


def test_operating_points_of_ngspice_are_met_to_1e_9(tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    ohm = [0.05, 0.5, 5.0, 50.0, 1e3]
    for _ in range(20):
        rows, cols = rng.integers(1, 7, 2)
        g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e6), (rows, cols)))
        g[rng.random((rows, cols)) < 0.15] = 0.0
        network = Network(
            g,
            0.5,
            r_row_driven_ohm=rng.choice([0.0, *ohm]),
            r_row_grounded_ohm=rng.choice([0.0, *ohm, 1e6]),
            r_column_ohm=rng.choice(ohm, cols),
            v_column_offset_v=rng.choice([0.0, 1e-3, -2e-3]) * np.ones(cols),
            g_lateral_row_s=rng.choice([0.0, 1e-3, 1.0]),
            g_lateral_column_s=rng.choice([0.0, 1e-3, 1.0]),
            r_trace_row_ohm=rng.choice([0.01, 1.0, 100.0]),
            r_trace_column_ohm=rng.choice([0.01, 1.0, 100.0]),
            i_leak_a=rng.choice([0.0, 1e-7, -1e-6], cols),
        )
        theirs = ngspice_currents(network, tmp_path)
        # 1e-18 A: an open taxel, where ngspice leaves its rounding.
        assert (np.abs(column_currents(network) - theirs) <= 1e-9 * np.abs(theirs) + 1e-18).all()


def test_charges_of_a_settling_slot_are_those_of_a_transient_analysis(tmp_path: Path) -> None:
    timing = Timing(f_clk_hz=5e6, slot_clocks=60, settle_clocks=10, gate_clocks=48, code_max=255, rows=3)
    g = 1 / np.random.default_rng(5).uniform(500, 5000, (3, 2))
    series = {
        "r_row_driven_ohm": 2e3,
        "r_row_grounded_ohm": 2e3,
        "r_column_ohm": 1e3,
        "g_lateral_row_s": 1e-4,
    }
    network = Network(g, 0.5, **series, c_row_f=3e-9, c_column_f=4e-9, c_taxel_f=5e-10)
    clock, slot = 1 / timing.f_clk_hz, timing.slot_clocks / timing.f_clk_hz
    edge = 1e-12
    lines = ["array"]
    for r in range(3):
        # Each row is at the bias for its slot; the first one from the operating point on.
        points = [(0.0, 0.5 if r == 0 else 0.0)]
        if r:
            points += [(r * slot, 0.0), (r * slot + edge, 0.5)]
        points += [((r + 1) * slot, 0.5), ((r + 1) * slot + edge, 0.0)]
        lines.append(f"vrow{r} e{r} 0 pwl({' '.join(f'{t!r} {v!r}' for t, v in points)})")
        lines += [f"rrow{r} e{r} u{r} {network.r_row_driven_ohm!r}", f"crow{r} u{r} 0 {network.c_row_f!r}"]
        for c in range(2):
            lines += [
                f"rt{r}{c} u{r} v{c} {float(1 / g[r, c])!r}",
                f"ct{r}{c} u{r} v{c} {network.c_taxel_f!r}",
            ]
    for c in range(2):
        lines += [f"ccol{c} v{c} 0 {network.c_column_f!r}", f"rcol{c} v{c} i{c} 1000.0", f"vin{c} i{c} 0 0"]
    lines += [f"rlat v0 v1 {1 / (3 * network.g_lateral_row_s)!r}", f".tran 1e-9 {3 * slot!r} 0 2e-9"]
    names, parts = [], list(range(0, 49, 12))
    for r in range(3):
        for c in range(2):
            for k in range(4):
                begin, end = (r * slot + (10 + n) * clock for n in (parts[k], parts[k + 1]))
                names.append(f"q{r}{c}{k}")
                lines.append(f".meas tran {names[-1]} integ i(vin{c}) from={begin!r} to={end!r}")
                # of a formula it prints as many digits as it is asked for
                lines.append(f".meas tran full_{names[-1]} param='{names[-1]}'")
    # Tight enough that halving each moves no charge by more than a tenth of what is compared below.
    lines += [".options reltol=1e-7 abstol=1e-16 vntol=1e-11 chgtol=1e-20", ".end", ""]
    said = ngspice_says("\n".join(lines), tmp_path)
    measured = dict(re.findall(r"^full_(q\d{3})\s+=\s+([-+]?\d\.\d+e[-+]\d+)\s*$", said, re.MULTILINE))
    assert sorted(measured) == names, said
    theirs = np.array([float(measured[name]) for name in names]).reshape(3, 2, 4)

    found = transients(network, g[np.newaxis], timing, 1e-25)
    assert found is not None
    extra = np.add.reduceat(found.per_clock(48)[0], parts[:-1], axis=2)
    settled = 12 * clock * column_currents(network)[:, :, np.newaxis]
    assert np.abs(extra).max() > 0.05 * settled.max()  # there is something to compare
    # Twice the reltol that ngspice runs with.
    assert np.abs(settled + extra - theirs).max() < 2e-7 * np.abs(theirs).max()
