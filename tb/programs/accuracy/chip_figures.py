# SPDX-License-Identifier: Apache-2.0
"""Pictures of what resolution costs in conversion time on the chip."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from dermis.report.figures import BLUE, GREEN, GREY, ORANGE, RED, save
from dermis.scene import design
from tb.programs.accuracy import chip
from tb.programs.accuracy.chip import Point

SKY, PINK = "#56B4E9", "#CC79A7"
COLOURS = (BLUE, ORANGE, GREEN, RED, PINK, "black", SKY, GREY)
DASHES = ("-", "--", ":")


def _curves(points: Sequence[Point]) -> dict[str, list[Point]]:
    found: dict[str, list[Point]] = {}
    for point in points:
        found.setdefault(point.curve, []).append(point)
    return found


def _draw(axes: Any, points: Sequence[Point], x: Any, label: str | None = None, **style: Any) -> None:
    order = sorted(points, key=x)
    at = [x(p) for p in order]
    bits = np.array([p.bits for p in order])
    around = [bits - [p.bits_least for p in order], [p.bits_most for p in order] - bits]
    axes.errorbar(
        at, bits, yerr=around, marker="o", markersize=3, linewidth=1.2, capsize=1.5, label=label, **style
    )


def _star(axes: Any, x: float, label: str) -> None:
    axes.plot(x, chip.PAPER_BITS, marker="*", markersize=16, color=RED, linestyle="none", label=label)


def _newtons(axes: Any) -> None:
    """A second scale: the step of so many bits in newtons."""
    full_n = design.load().sensor.force_max_n
    right = axes.secondary_yaxis(
        "right", functions=(lambda b: full_n / 2.0**b, lambda n: np.log2(full_n / np.maximum(n, 1e-9)))
    )
    right.set_ylabel("step of the equivalent quantiser / N")
    right.yaxis.set_minor_locator(NullLocator())
    right.set_yticks([3, 1, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
    right.yaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:g}"))


def resolution(points: Sequence[Point], path: Path) -> None:
    """Bits against gate length at the paper's clock, step by step, and against time a row at every clock."""
    figure = Figure(figsize=(13.5, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    own = [p for p in points if p.f_clk_hz == chip.PAPER_HZ]
    for colour, (name, curve) in zip(COLOURS, _curves(own).items(), strict=False):
        _draw(left, curve, lambda p: p.gate_clocks, name, color=colour)
    gates = [chip.gate_of(n) for n in chip.BITS]
    said = "quantisation and noise by formula"
    left.plot(
        gates, [chip.formula(chip.PAPER_HZ, g).bits for g in gates], color=GREY, dashes=(4, 2), label=said
    )
    for kelvin in (1, 30):
        bits = chip.drifted(kelvin).bits
        left.axhline(bits, color=GREY, linestyle=":", linewidth=1)
        left.text(
            16, bits + 0.08, f"reference {kelvin} K off its calibration (formula)", fontsize=8, color=GREY
        )
    paper = chip.gate_of(chip.PAPER_BITS)
    left.plot(
        paper,
        chip.PAPER_BITS,
        marker="*",
        markersize=16,
        color=RED,
        linestyle="none",
        label="the paper: 510 clocks, 8 bits",
    )
    left.set_xscale("log", base=2)
    left.set_xlabel("gate / clocks at 5 MHz")
    left.set_ylabel("effective resolution / bits")
    left.set_title("Engine event, median of three seeds", fontsize=10)
    for colour, f in zip(COLOURS, chip.CLOCKS_HZ, strict=False):
        curve = [p for p in points if p.curve == chip.FULL and p.f_clk_hz == f]
        _draw(right, curve, lambda p: 1e6 * p.slot_s, f"{1e-6 * f:g} MHz", color=colour)
    for name, slot_s in chip.SLOTS_S.items():
        right.axvline(1e6 * slot_s, color=GREY, linestyle=":", linewidth=1)
        right.text(1e6 * slot_s, 14.6, name + " ", rotation=90, fontsize=8, ha="right", va="top", color=GREY)
    right.plot(
        125,
        chip.PAPER_BITS,
        marker="*",
        markersize=16,
        color=RED,
        linestyle="none",
        label="the paper: 125 us, 8 bits",
    )
    right.set_xscale("log")
    right.set_xlabel("time of one row / us: 23 us to settle and the gate (frame rates: 16 rows)")
    right.set_title("Everything on", fontsize=10)
    _tenth(left, points)
    for axes in (left, right):
        axes.grid(True, alpha=0.3)
        axes.set_ylim(2.5, 15.5)
        axes.legend(fontsize=8, loc="lower right")
    _newtons(right)
    save(figure, path)


def _tenth(axes: Any, points: Sequence[Point]) -> None:
    """What a tenth of an LSB of the paper's 8 bits takes in gate time, and what a tenth of that time leaves."""
    wanted = chip.PAPER_BITS + np.log2(10.0)
    axes.axhline(wanted, color=RED, linestyle="--", linewidth=1)
    axes.text(16, wanted + 0.08, "0.1 LSB of 8 bits", fontsize=8, color=RED)
    said = []
    straight = list(chip.STEPS)[list(chip.STEPS).index(chip.FULL) - 1]
    for words, curve in (("without the range switch's bend", straight), ("everything on", chip.FULL)):
        gate = chip.gate_for(points, curve, wanted)
        if gate is None:
            best = max(p.bits for p in points if (p.curve, p.f_clk_hz) == (curve, chip.PAPER_HZ))
            said.append(f"{words}: never; at best {2.0 ** (chip.PAPER_BITS - best):.2f} LSB")
            continue
        left = chip.bits_at(points, curve, gate / 10.0)
        lsb = 2.0 ** (chip.PAPER_BITS - left)
        said.append(f"{words}: {gate:.0f} clocks, {1e3 * gate / chip.PAPER_HZ:.2g} ms")
        said.append(f"   a tenth of that, {1e6 * gate / chip.PAPER_HZ / 10.0:.0f} us: {lsb:.2g} LSB")
        axes.plot([gate / 10.0, gate], [left, wanted], "o", color=RED, markersize=8, fillstyle="none")
    text = "\n".join(["0.1 LSB (of 8 bits) takes a gate of", *said])
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": RED, "alpha": 0.9}
    axes.text(0.02, 0.98, text, transform=axes.transAxes, va="top", fontsize=8.5, bbox=box)


def energy(points: Sequence[Point], current: chip.ChannelCurrent | None, path: Path) -> None:
    """Energy of a conversion and of a bit against gate length, and of a step of the quantiser against bits."""
    figure = Figure(figsize=(13.5, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    own = sorted(
        (p for p in points if p.curve == chip.FULL and p.f_clk_hz == chip.PAPER_HZ),
        key=lambda p: p.gate_clocks,
    )
    gates, bits = [p.gate_clocks for p in own], np.array([p.bits for p in own])
    kinds = [("declared currents alone: a floor", None, "--", GREY)]
    if current is not None:
        kinds.append((f"channel of {1e6 * current.typical:.0f} uA, measured", current.typical, "-", BLUE))
    for words, channel_a, dash, colour in kinds:
        joule = np.array([chip.energy_j(p.slot_s, channel_a) for p in own])
        left.plot(
            gates,
            1e9 * joule,
            color=colour,
            linestyle=dash,
            marker="o",
            markersize=3,
            label=f"a conversion, {words}",
        )
        left.plot(
            gates, 1e9 * joule / bits, color=colour, linestyle=dash, marker="s", markersize=3,
            fillstyle="none", label=f"a bit, {words}",
        )  # fmt: skip
        right.plot(
            bits,
            1e12 * joule / 2.0**bits,
            color=colour,
            linestyle=dash,
            marker="o",
            markersize=3,
            label=words,
        )
    left.axvline(chip.gate_of(chip.PAPER_BITS), color=RED, linestyle=":", label="the paper: 510 clocks")
    left.set_xscale("log", base=2)
    left.set_yscale("log")
    left.set_xlabel("gate / clocks at 5 MHz (23 us to settle before it)")
    left.set_ylabel("energy / nJ")
    right.set_yscale("log")
    right.axvline(chip.PAPER_BITS, color=RED, linestyle=":", label="the paper: 8 bits")
    right.set_xlabel("effective resolution with everything on / bits")
    right.set_ylabel("energy over 2^bits / pJ")
    source = "not measured" if current is None else "in ngspice, SKY130 transistors"
    left.set_title(f"One column at a quarter of the clock rate; its supply current: {source}", fontsize=9)
    right.set_title("What a step costs: least shortly before waiting ends", fontsize=9)
    for axes in (left, right):
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8)
    save(figure, path)


def frame_rates(points: Sequence[Point], divided: Sequence[Point], path: Path) -> None:
    """Bits against frame rate for each size, and against the share of a slot that is left to settle."""
    figure = Figure(figsize=(13.5, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for dash, f in zip(DASHES, (5e6, 20e6, 50e6), strict=True):
        for colour, size in zip(COLOURS, chip.SIZES, strict=False):
            curve = [p for p in points if p.curve == chip.FULL and p.f_clk_hz == f]
            label = f"{size}x{size}" if f == chip.PAPER_HZ else None
            rate = [chip.frame_hz(size, p.slot_s) for p in curve]
            left.plot(rate, [p.bits for p in curve], color=colour, linestyle=dash, label=label, linewidth=1.3)
    for dash, name in zip(DASHES, ("5 MHz", "20 MHz", "50 MHz"), strict=True):
        left.plot([], [], color="black", linestyle=dash, label=name)
    left.plot(
        500,
        chip.PAPER_BITS,
        marker="*",
        markersize=16,
        color=RED,
        linestyle="none",
        label="the paper: 16x16, 500/s",
    )
    for rate in (1000, 2000):
        left.axvline(rate, color=GREY, linestyle=":", linewidth=1)
    left.set_xscale("log")
    left.set_xlabel("frames a second, 23 us to settle")
    left.set_title("Everything on; dotted: what robots ask for", fontsize=10)
    kinds = ((rate, f) for rate in chip.SLOTS_S for f in (5, 20, 50))
    for k, (rate, f) in enumerate(kinds):
        for speed, dash in (("fast", "-"), ("slow", ":")):
            curve = [p for p in divided if p.curve == f"{rate}, {f} MHz, {speed} mirror"]
            label = f"{rate}, {f} MHz" if speed == "fast" else None
            right.plot(
                [1e6 * p.settle_s for p in curve], [p.bits for p in curve], linestyle=dash,
                color=(BLUE, ORANGE, GREEN)[k // 3], linewidth=(0.8, 1.5, 2.4)[k % 3], label=label,
            )  # fmt: skip
    right.plot([], [], color="black", linestyle=":", label="slow mirror (500 fC)")
    right.axvline(1e6 * chip.SETTLE_S, color=RED, linestyle="--", linewidth=1, label="the paper's 23 us")
    right.set_xscale("log")
    right.set_xlabel("part of the slot left to settle / us, 16 rows")
    right.set_title("One slot divided between settling and gate", fontsize=10)
    for axes in (left, right):
        axes.set_ylabel("effective resolution / bits")
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=7.5)
    save(figure, path)


def without_time(
    reading: Sequence[Point], drooping: Sequence[Point], settled: Sequence[Point], path: Path
) -> None:
    """What buys accuracy without time: other ways to read, the correction of row droop, a pedestal."""
    figure = Figure(figsize=(15, 5.2), layout="constrained")
    for axes, points, title in zip(
        figure.subplots(1, 3),
        (reading, drooping, settled),
        (
            "One converter, 5 MHz",
            "16x16 behind 1 ohm drivers, 0.5 ohm inputs",
            "Light rows after others, 510 clocks",
        ),
        strict=True,
    ):
        for colour, (name, curve) in zip(COLOURS, _curves(points).items(), strict=False):
            if points is settled:
                _draw(axes, curve, lambda p: 1e6 * p.settle_s, name, color=colour)
            else:
                _draw(axes, curve, lambda p: p.gate_clocks, name, color=colour)
        axes.set_xscale("log", base=10 if points is settled else 2)
        axes.set_xlabel("time to settle / us" if points is settled else "gate / clocks")
        axes.set_ylabel("effective resolution / bits of full scale")
        axes.set_title(title, fontsize=10)
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8)
    save(figure, path)
