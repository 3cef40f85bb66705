# SPDX-License-Identifier: Apache-2.0
"""Commands that faults are tried on: small, and together every kind of process that dermis starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Subject:
    """A command.

    Attributes
    ----------
    name : lower_snake
    make : writes its input into a directory, given the trial's number; gives the arguments but for --out
    roles : processes it has, as tb.programs.faults.bench.role names them
    at_work_s : about how long the youngest of them lives on an idle core: within it a fault is sent
    patient : changes that make its limits short, for trials in which something stands still
    """

    name: str
    make: Callable[[Path, int], Sequence[str]]
    roles: tuple[str, ...]
    at_work_s: float
    patient: tuple[str, ...] = ()


def _scene(work: Path, shape: tuple[int, int, int], engine: str, effects: str = "") -> str:
    """Write a scene of resistances [frames, rows, cols], the same for the same shape; give its path."""
    ohm = 500.0 * 10 ** np.random.default_rng(sum(shape)).uniform(0, 2, shape)
    np.save(work / "taxels.npy", ohm)
    scene = work / "scene.toml"
    scene.write_text(
        f'title = "fault"\n[array]\nrows = {shape[1]}\ncols = {shape[2]}\n'
        '[stimulus]\nkind = "resistance"\nfile = "taxels.npy"\n'
        f'[run]\nengine = "{engine}"\n[effects]\n{effects}\n'
    )
    return str(scene)


_DELAY = "comparator_delay = { t_s = 1e-8 }"


def _closed(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (4, 8, 8), "closed")]


def _batch(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (400, 16, 16), "event", _DELAY), "--processes", "2"]


def _rtl(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (4, 4, 4), "rtl"), "--simulator", "icarus"]


def _verilator(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (1500, 4, 4), "rtl"), "--simulator", "verilator"]


def _rtl_batch(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (6, 4, 4), "rtl"), "--simulator", "icarus", "--processes", "2"]


def _build(work: Path, number: int) -> list[str]:
    # A size that no other trial has: nothing is built yet.
    return ["run", _scene(work, (1, 5 + number // 40, 5 + number % 40), "rtl"), "--simulator", "verilator"]


def _cosim(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (4, 2, 3), "cosim")]


def _cosim_verilator(work: Path, _: int) -> list[str]:
    return ["run", _scene(work, (6, 2, 3), "cosim"), "--simulator", "verilator"]


_STALLS = ("dermis.engines.cosim:START_LIMIT_S=8", "dermis.engines.cosim:SLOT_LIMIT_S=4")
_RTL_STALLS = ("dermis.engines.rtl:FRAME_LIMIT_S=4", "dermis.chip.hdl:BUILD_LIMIT_S=8")

SUBJECTS = {
    subject.name: subject
    for subject in (
        Subject("closed", _closed, ("parent",), 1.0),
        Subject("batch", _batch, ("parent", "worker", "watchdog"), 1.5, ("dermis.processes.pool:STALL_S=4",)),
        Subject("rtl", _rtl, ("parent", "hdl_simulator", "watchdog"), 0.4, _RTL_STALLS),
        Subject("verilator", _verilator, ("parent", "hdl_simulator"), 0.4, _RTL_STALLS),
        Subject(
            "rtl_batch", _rtl_batch, ("worker", "hdl_simulator"), 0.4, ("dermis.processes.pool:STALL_S=4",)
        ),
        Subject("build", _build, ("parent", "compiler"), 5.0, _RTL_STALLS),
        Subject("cosim", _cosim, ("parent", "cosim_child", "hdl_simulator", "watchdog"), 2.0, _STALLS),
        Subject(
            "cosim_verilator", _cosim_verilator, ("parent", "cosim_child", "hdl_simulator"), 2.0, _STALLS
        ),
    )
}
