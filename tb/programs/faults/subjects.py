# SPDX-License-Identifier: Apache-2.0
"""Small commands for trials; together they start every kind of process of dermis."""

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
    name : str
    make : callable
        (directory, number of the trial) -> arguments without --out; writes the scene.
    at_work_s : float
        Lifetime of its youngest process on an idle core; faults come within it.
    stalls : tuple of str
        Changes that shorten its limits, for trials in which a process stands still.
    """

    name: str
    make: Callable[[Path, int], Sequence[str]]
    at_work_s: float = 1.0
    stalls: tuple[str, ...] = ()


def _run(
    shape: tuple[int, int, int], engine: str, *options: str, effects: str = ""
) -> Callable[..., list[str]]:
    """Return a function that writes a scene of resistances [frames, rows, cols] and returns its
    command.
    """

    def make(work: Path, number: int) -> list[str]:
        # Size 0: one that no other trial has, so that nothing is built yet.
        frames, rows, cols = shape if shape[1] else (1, 5 + number // 40, 5 + number % 40)
        ohm = 500.0 * 10 ** np.random.default_rng(sum(shape)).uniform(0, 2, (frames, rows, cols))
        np.save(work / "taxels.npy", ohm)
        (work / "scene.toml").write_text(
            f'title = "fault"\n[array]\nrows = {rows}\ncols = {cols}\n'
            '[stimulus]\nkind = "resistance"\nfile = "taxels.npy"\n'
            f'[run]\nengine = "{engine}"\n[effects]\n{effects}\n'
        )
        return ["run", str(work / "scene.toml"), *options]

    return make


_POOL = ("dermis.processes.pool:STALL_S=4",)
_RTL = ("dermis.engines.rtl:FRAME_LIMIT_S=4", "dermis.chip.hdl:BUILD_LIMIT_S=8")
_COSIM = ("dermis.engines.cosim:START_LIMIT_S=8", "dermis.engines.cosim:SLOT_LIMIT_S=4")
_ICARUS, _VERILATOR, _TWO = ("--simulator", "icarus"), ("--simulator", "verilator"), ("--processes", "2")
SUBJECTS = {
    subject.name: subject
    for subject in (
        Subject("closed", _run((4, 8, 8), "closed")),
        Subject(
            "batch",
            _run((400, 16, 16), "event", *_TWO, effects="comparator_delay = { t_s = 1e-8 }"),
            1.5,
            _POOL,
        ),
        Subject("rtl", _run((4, 4, 4), "rtl", *_ICARUS), 0.4, _RTL),
        Subject("verilator", _run((1500, 4, 4), "rtl", *_VERILATOR), 0.4, _RTL),
        Subject("rtl_batch", _run((6, 4, 4), "rtl", *_ICARUS, *_TWO), 0.4, _POOL),
        Subject("build", _run((0, 0, 0), "rtl", *_VERILATOR), 5.0, _RTL),
        Subject("cosim", _run((4, 2, 3), "cosim"), 2.0, _COSIM),
        Subject("cosim_verilator", _run((6, 2, 3), "cosim", *_VERILATOR), 2.0, _COSIM),
    )
}
