# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the chip in ngspice: extreme resistances, longest steps, integration and tolerances.

Engine `lockstep` is the deck of a frame with row scanner and flip-flops in Python; tb/system ties
such a chip to the Verilog.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan, records
from dermis.chip import ladder, netlist
from dermis.chip.analog import Edge
from dermis.chip.ngspice import NgspiceHalf
from dermis.converter import vfc
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design
from tb.programs.hard.case import Case, Measured

EXTREME_OHM = (0.0, 1e-3, 1.0, 249.0, 500.0, 510.0, 7.5e3, 123456.0, 1e6, 1e9, 1e12, 1e15)
BENT_OHM = (500.0, 510.0, 7.5e3, 1e6)
COLS = 4

CORNERS: dict[str, dict[str, Any]] = {
    "nominal": {},
    "low": {"v_bias_v": 0.4, "k": 40},
    "high": {"v_bias_v": 0.6, "k": 160},
}


def chip(
    topology: str,
    corner: str = "nominal",
    effects: Mapping[str, Any] | None = None,
    ohms: Sequence[float] = EXTREME_OHM,
) -> records.Plan:
    """Return a plan with these resistances in an array of four columns."""
    interface = {"topology": topology, **(CORNERS[corner] if topology != "direct" else {})}
    data = {
        "array": {"rows": len(ohms) // COLS, "cols": COLS},
        "stimulus": {"kind": "uniform", "code": [0]},
        "interface": interface,
        "effects": dict(effects or {}),
    }
    made = plan.make(scene.from_data(data, Path("hard.toml")), "cosim")
    ohm = np.array(ohms).reshape(1, -1, COLS)
    return replace(made, resistance_ohm=ohm, force_n=None)


def exact_codes(made: records.Plan) -> NDArray[np.int64]:
    """Return the codes of charge balance in exact rationals; a short is the floor of the design."""
    floor = load_design().array.r_floor_ohm
    interface = made.scene.table.interface
    unit = Fraction(repr(interface.v_bias_v)) / (interface.k * Fraction(repr(interface.i0_a)))
    gate = made.timing.gate_clocks
    codes = [
        min(vfc.count_rational(unit / Fraction(repr(max(r, floor))), gate), made.timing.code_max)
        for r in EXTREME_OHM
    ]
    return np.array(codes).reshape(1, -1, COLS)


def extremes(engine: str, topology: str, corner: str = "nominal") -> Measured:
    """Return the largest error of a code against charge balance."""
    made, note = chip(topology, corner), ""
    if engine == "lockstep":
        codes, way = read_frame(made)
        note = ", ".join(retry.rung for retry in way.retries)
    else:
        codes = engines.runner(engine)(made).codes.astype(np.int64)
    return Measured(float(np.abs(codes - exact_codes(made)).max()), note)


STEPS_S = {"step_100_ns": 1e-7, "step_1_us": 1e-6, "step_10_us": 1e-5}
BENDS = {"comparator_delay": {"t_s": 8e-9}, "integrator_bandwidth": {"gbw_hz": 5e6}}
# ten times the tolerances of netlist.py for a deck with poles
CHANGES = {
    **dict.fromkeys(STEPS_S, ""),
    "gear": ".options method=gear maxord=2",
    "reltol_ten_times": ".options reltol=1e-3",
    "all_tolerances_ten_times": ".options reltol=1e-3 abstol=1e-11 vntol=1e-6 chgtol=1e-13",
}


def unmoved(change: str, bent: bool) -> Measured:
    """Return the largest error of a code against charge balance (engine event, with poles) under a
    change.
    """
    made = chip("conveyor_mirror", effects=BENDS, ohms=BENT_OHM) if bent else chip("conveyor_mirror")
    codes, way = read_frame(made, CHANGES[change], STEPS_S.get(change, 1e-6))
    exact = engines.runner("event")(made).codes.astype(np.int64) if bent else exact_codes(made)
    return Measured(float(np.abs(codes - exact).max()), ", ".join(retry.rung for retry in way.retries))


def read_frame(
    made: records.Plan, options: str = "", t_max_step_s: float = 1e-6, begin: ladder.Level = ladder.PLAIN
) -> tuple[NDArray[np.int64], ladder.Climb]:
    """Return codes [1, rows, cols] of the first frame: its deck with row scanner and flip-flops in
    Python.
    """
    timing, rows, cols = made.timing, made.rows, made.cols
    deck = netlist.frame_deck(made, 0, [1.0] + [0.0] * (rows - 1) + [1.0] + [0.0] * cols)
    if options:
        deck = replace(deck, lines=(*deck.lines, options))
    t_clk = 1.0 / timing.f_clk_hz

    def attempt(level: ladder.Level) -> NDArray[np.int64]:
        half = NgspiceHalf(
            deck,
            t_edge_s=1e-9,
            t_max_step_s=t_max_step_s,
            t_stop_s=(rows * timing.slot_clocks - timing.break_clocks) * t_clk,
            log=Path(folder) / "ngspice.log",
            level=level,
        )
        counts = np.zeros((1, rows, cols), dtype=np.int64)
        first = second = np.zeros(cols, dtype=bool)
        edges: list[Edge] = []
        half.advance(0.0, [])
        # The deck starts where row 0 is driven.
        for clock in range(timing.break_clocks + 1, rows * timing.slot_clocks + 1):
            now = (clock - timing.break_clocks) * t_clk
            high = half.advance(now, edges)[:cols] > 0.0
            row, at = divmod(clock - 1, timing.slot_clocks)
            told, first = first, (high & ~first) & (at >= timing.settle_clocks)
            counts[0, row] += first
            edges = [(now, rows + 1 + int(c), float(told[c])) for c in np.flatnonzero(told != second)]
            second = told
            if at + 1 == timing.settle_clocks:
                edges.append((now, rows, 0.0))
            if at + 1 == timing.slot_clocks:
                edges += [(now, rows, 1.0), (now, row, 0.0)]
                at, row = -1, row + 1
            if at + 1 == timing.break_clocks and 0 < row < rows:
                edges.append((now, row, 1.0))
        half.close()
        return np.minimum(counts, timing.code_max)

    with tempfile.TemporaryDirectory() as folder:
        way = ladder.Climb("hard chip", begin, report=lambda line: None)
        return ladder.climb(attempt, way), way


def cases() -> list[Case]:
    """Return every case of this module."""
    whole = "codes are whole numbers"
    runs: dict[str, tuple[str, str, dict[str, Any]]] = {}
    for name, topology, corner in (
        *((topology, topology, "nominal") for topology in TOPOLOGIES),
        *((f"{corner}_corner", "conveyor_mirror", corner) for corner in ("low", "high")),
    ):
        run = {e: partial(extremes, e, topology, corner) for e in ("closed", "event", "lockstep")}
        why = f"0 to 1e15 ohm in one array {CORNERS[corner] or ''}".strip()
        runs[f"extreme_resistances_{name}"] = why, "exact rationals (vfc.count_rational)", run
    runs["step_and_method_straight_lines"] = (
        "The longest step from half a clock to fifty.",
        "exact rationals (vfc.count_rational)",
        {change: partial(unmoved, change, False) for change in STEPS_S},
    )
    runs["step_and_method_poles"] = (
        "The longest step from half a clock to fifty, Gear's formula, tolerances ten times larger.",
        "engine event, clock by clock",
        {change: partial(unmoved, change, True) for change in CHANGES},
    )
    return [
        Case(name, "circuit", why, "the codes of charge balance", run, source, whole)
        for name, (why, source, run) in runs.items()
    ]
