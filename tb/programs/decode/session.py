# SPDX-License-Identifier: Apache-2.0
"""Calibration session of a simulated sheet, written as `dermis calibrate` reads it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dermis.decode.calibration import Calibration
from dermis.ndarrays import Floats
from dermis.skin import Skin

T_FRAME_S = 2e-3


def currents(true: Calibration, count: int = 40) -> tuple[Floats, NDArray[np.int64]]:
    """Return test currents in ampere, the first 0, and the codes [currents, rows, cols] they read."""
    current = np.linspace(0, 0.9 * true.code_max, count) * true.step_a.mean()
    codes = np.floor(current[:, None, None] / true.step_a + true.start_code + 0.5)
    codes = np.clip(codes, 0, true.code_max).astype(np.int64)
    return current, np.broadcast_to(codes, (count, true.rows, true.cols))


def rectangles(rng: np.random.Generator, forces_n: Floats, rows: int, cols: int) -> Floats:
    """Return weights [loads, rows, cols] in newtons, one a force, each on a rectangle, which may hang over."""
    loads, size = np.zeros((len(forces_n), rows, cols)), np.array([rows, cols])
    for load, force in zip(loads, forces_n, strict=True):
        extent = rng.integers(np.maximum(size // 3, 1), size + 1)
        corner = rng.integers(-extent // 2, size - extent // 2)
        r, c = np.maximum(corner, 0)
        load[r : max(corner[0] + extent[0], r + 1), c : max(corner[1] + extent[1], c + 1)] = force
    return loads


def cycle(skin: Skin, peak_n: float) -> tuple[Floats, NDArray[np.integer]]:
    """Return a rise, a hold and a fall of all taxels [750, rows, cols] and their codes, from rest."""
    rise = peak_n * np.sin(np.pi / 2 * np.arange(250) / 250) ** 2
    force = np.concatenate([rise, np.full(250, peak_n), rise[::-1]])
    force = np.broadcast_to(force[:, None, None], (750, skin.rows, skin.cols))
    skin.reset()
    codes = skin.read(force, T_FRAME_S)
    skin.reset()
    return force, codes


def write_tables(
    directory: Path, size: tuple[int, int], start: str, loads: Floats, codes: Sequence[NDArray], *more: str
) -> Path:
    """Write a session of loads [loads, rows, cols] with their codes [frames, rows, cols]; return its file."""
    lines = [f"[array]\nrows = {size[0]}\ncols = {size[1]}\n[start]\n{start}", *more]
    for n, (force, read) in enumerate(zip(loads, codes, strict=True)):
        np.save(directory / f"codes_{n}.npy", read)
        np.save(directory / f"force_{n}.npy", force[None])
        lines.append(f'[[load]]\nname = "weight {n}"\nfile = "codes_{n}.npy"\nforce_n = "force_{n}.npy"')
    path = directory / "session.toml"
    path.write_text("\n\n".join(lines) + "\n")
    return path


def write(directory: Path, skin: Skin, forces_n: Floats, law: str = "linear") -> Path:
    """Write a session of test currents, loads and, for a sheet with memory, a cycle; return its file."""
    true, lines = Calibration.of_plan(skin.plan), []
    for n, (amps, codes) in enumerate(zip(*currents(true), strict=True)):
        np.save(directory / f"current_{n}.npy", codes[None])
        lines.append(f'[[current]]\nfile = "current_{n}.npy"\ncurrent_a = {float(amps)!r}')
    if true.memory.active:
        force, codes = cycle(skin, float(forces_n.max()))
        np.save(directory / "cycle.npy", codes)
        np.save(directory / "cycle_force.npy", force)
        lines.append(f'[[cycle]]\nfile = "cycle.npy"\nforce_n = "cycle_force.npy"\nt_frame_s = {T_FRAME_S!r}')
    loads, codes = rectangles(np.random.default_rng(0), forces_n, skin.rows, skin.cols), []
    for load in loads:
        skin.reset()  # each is put on from rest
        codes.append(skin.read(load)[None])
    return write_tables(directory, (skin.rows, skin.cols), f'law = "{law}"', loads, codes, *lines)
