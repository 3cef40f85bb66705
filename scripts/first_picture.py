# SPDX-License-Identifier: Apache-2.0
"""The first picture of README: a fingertip, its codes, and the error of the newtons, corrected and not."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

import dermis
from dermis.scene.design import Design
from scripts import templates

SCENE = "fingertip"
PATH = "docs/figures/fingertip.svg"
SHADES = 24  # of a scale


def _panel(
    title: str, words: str, values: NDArray[Any], scale: str, low: float, high: float, unit: str
) -> Any:
    """Return a map as the template draws it: taxels that differ from the colour of 0, and the scale."""
    paint = np.vectorize(lambda share: to_hex(colormaps[scale](float(share))))
    fills, zero = paint((values - low) / (high - low)), str(paint(-low / (high - low)))
    cells = [(row, col, fills[row, col]) for row, col in np.argwhere(fills != zero).tolist()]
    ends = [f"{end:+g}{unit}" if low < 0 else f"{end:g}{unit}" for end in (low, high)]
    shades = paint(np.linspace(0, 1, SHADES)).tolist()
    return {"title": title, "words": words, "zero": zero, "cells": cells, "scale": shades,
            "low": ends[0].replace("-", "−"), "high": ends[1]}  # fmt: skip


def svg(design: Design) -> str:
    """Return the picture of scene `SCENE` in this design; engine closed, as every engine gives its codes."""
    read = dermis.simulate(SCENE, engine="closed", design=design)
    force, codes = read.applied_force_n[0], read.codes[0]
    most, code_max = design.sensor.force_max_n, design.timing.code_max
    panels = [
        _panel("Force", f"a fingertip, {force.max():.1f} N at its peak", force, "viridis", 0, most, " N"),
        _panel("Code of the chip", f"at most {codes.max()} of {code_max}", codes, "viridis", 0, code_max, ""),
    ]
    corrected = dermis.newtons(read.codes, read, corrected=True)
    errors = {"Error of the newtons": read.force_n[0] - force, "The same, corrected": corrected[0] - force}
    end = max(0.5, *(float(np.ceil(np.abs(error).max() * 2) / 2) for error in errors.values()))
    for title, error in errors.items():
        words = f"at most {np.abs(error).max():.2f} N"
        panels.append(_panel(title, words, error, "RdBu_r", -end, end, " N"))
    sizes = {"cell_x": 240 / codes.shape[1], "cell_y": 240 / codes.shape[0]}
    return templates.text("fingertip.svg", panels=panels, **sizes)
