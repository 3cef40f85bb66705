# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the array: shorts, opens, resistances 70 decades apart, currents that cancel.

Each runs in the solver and in engines closed and event: currents of every slot and codes are compared.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dermis import engines, plan, records
from dermis.array import solve_error
from dermis.array.array import Network, column_currents
from dermis.converter import vfc
from dermis.ndarrays import Floats
from tb.programs.hard.case import Case, Measured
from tb.reference import nodal, scenes

V_BIAS = 0.5
K_I0_A = 80 * 12.5e-6  # column current at duty 1 in the plans of `plan_of`
CLOCKS, CODE_MAX = 510, 255

DIGITS = 120

# A current of 0 is computed as the leakage of stand-ins for ideal sources (docs/array.md, Bounds).
NOTHING_A = 1e-45


@dataclass(frozen=True)
class Hard:
    """A hard network: its conductances and its other elements.

    The currents are those of the nodal matrix in DIGITS digits, only for `slots` if that would take
    long. With `cancels` errors are relative to the terms of a sum.
    """

    name: str
    g: Floats
    kind: dict[str, Any] = field(default_factory=dict)
    slots: tuple[int, ...] | None = None
    cancels: bool = False
    short: bool = False

    def network(self) -> Network:
        return Network(self.g, V_BIAS, **self.kind)

    def expected(self) -> Floats:
        """Return the currents of the slots in `slots`, or of all."""
        return nodal.column_currents(self.network(), DIGITS, self.slots)

    def rows(self) -> Any:
        return slice(None) if self.slots is None else list(self.slots)


def currents(name: str) -> Measured:
    """Return the largest error of a current over itself, or over the largest of a slot that cancels."""
    hard = TABLE[name]
    with solve_error.recording() as record:
        have = column_currents(hard.network())[hard.rows()]
    want = hard.expected()
    size = np.abs(want)
    if hard.cancels:
        size = np.broadcast_to(size.max(axis=-1, keepdims=True), want.shape)
    error = np.where(np.abs(have - want) <= NOTHING_A, 0.0, np.abs(have - want))
    worst = np.divide(error, size, out=np.where(error > 0, np.inf, 0.0), where=size > 0).max()
    return Measured(float(worst), f"bound {record.bound:.1e}, condition {record.condition:.1e}")


def plan_of(network: Network, engine: str) -> records.Plan:
    """Return a plan whose array is this network, with an ideal converter."""
    with np.errstate(divide="ignore"):
        ohm = 1.0 / network.g_taxel_s[np.newaxis]
    interface = {"v_bias_v": V_BIAS, "k": 80, "i0_a": K_I0_A / 80}
    made = plan.make(scenes.of_resistances(ohm, {}, interface), engine)
    return replace(made, surrounding={name: getattr(network, name) for name in network.active_fields()})


def codes(name: str, engine: str) -> Measured:
    """Return the largest error of a code; within 1e-6 count of a step both codes are right."""
    hard = TABLE[name]
    found = engines.run(plan_of(hard.network(), engine)).codes[0][hard.rows()].astype(int)
    x = hard.expected() / K_I0_A
    # A millionth of a count: a thousandth of the error at which the solver refuses.
    low, high = (vfc.code(np.clip(x + s * 1e-6 / CLOCKS, -1e9, 1e9), CLOCKS, CODE_MAX) for s in (-1, 1))
    off = np.maximum(np.maximum(low - found, found - high), 0)
    return Measured(float(off.max()), f"codes {found.min()}..{found.max()}")


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(list(name.encode()))


def _random(name: str, rows: int, cols: int, low: float = 500.0, high: float = 64250.0) -> Floats:
    return 1.0 / np.exp(_rng(name).uniform(np.log(low), np.log(high), (rows, cols)))


def _with(value: float, *where: tuple[Any, Any]) -> Floats:
    g = _random(f"{where}", 4, 4)
    for place in where:
        g[place] = value
    return g


def _decades(rows: int, cols: int, low: float, high: float) -> Floats:
    """Return conductances of resistances from 10^low to 10^high ohm, shuffled."""
    return 1.0 / _rng("decades").permutation(np.logspace(low, high, rows * cols)).reshape(rows, cols)


def _drivers(driven: float, grounded: float) -> dict[str, Any]:
    return CHIP | {"r_row_driven_ohm": driven, "r_row_grounded_ohm": grounded}


def _traces(ohm: float) -> dict[str, Any]:
    return TRACES | {"r_trace_row_ohm": ohm, "r_trace_column_ohm": ohm}


def _offsets(*volt: float) -> dict[str, Any]:
    return CHIP | {"v_column_offset_v": list(volt)}


ALL, INF = slice(None), np.inf
CHIP = {"r_row_driven_ohm": 5.0, "r_row_grounded_ohm": 5.0, "r_column_ohm": 0.5, "g_lateral_row_s": 1e-3}
TRACES = CHIP | {"r_trace_row_ohm": 0.1, "r_trace_column_ohm": 0.1, "g_lateral_column_s": 1e-3}
FLOATING = CHIP | {"r_row_grounded_ohm": INF}
_SHARED = _with(INF, (1, 0), (1, 2), (2, 2), (3, 1))
_SHORT_AND_OPEN = _with(INF, (2, slice(0, 3)), (0, 0))
_MILLIVOLTS = 1e-3 * _rng("offsets").standard_normal(16)
_FAR_APART = np.array([[1e12, 1e3], [1e-3, 2e-3]])
_UNEQUAL = {"r_row_driven_ohm": 1e6, "r_column_ohm": 1e-12, "v_column_offset_v": [1e-3, 0.0]}
_TINY = _offsets(1e-20, -1e-20, 1e-20, 0.0, 2e-20) | {"r_column_ohm": 1e-9}
_HUGE = _offsets(-1e30, 0.0, 0.0) | {"r_column_ohm": [5e17, 0.5, 0.5]}
_LEAKS = {"i_leak_a": [1e-6, 0.0, -1e-9, 1e-15], "r_column_ohm": [1e9, 0.5, 1e3, 1e6]}
_EVERYTHING = {"r_row_grounded_ohm": 8.0, "v_column_offset_v": _MILLIVOLTS, "i_leak_a": 1e-8}

_HARD = (
    Hard("one_short", _with(INF, (1, 2)), CHIP, short=True),
    Hard("many_shorts_share_a_row", _SHARED, CHIP),
    Hard("whole_row_shorted", _with(INF, (2, ALL)), CHIP),
    Hard("whole_column_shorted", _with(INF, (ALL, 1)), CHIP),
    Hard("all_shorted", _with(INF, (ALL, ALL)), CHIP),
    Hard("one_open", _with(0.0, (1, 2)), CHIP, short=True),
    Hard("whole_row_open", _with(0.0, (2, ALL)), CHIP),
    Hard("whole_column_open", _with(0.0, (ALL, 1)), CHIP),
    Hard("all_open", _with(0.0, (ALL, ALL)), CHIP),
    Hard("row_shorted_and_column_open", _SHORT_AND_OPEN, FLOATING),
    Hard("taxels_over_18_decades", _decades(4, 5, -3, 15), CHIP, short=True),
    Hard("taxels_over_18_decades_traces", _decades(4, 4, -3, 15), TRACES),
    Hard("taxels_over_18_decades_floating", _decades(4, 5, -3, 15), FLOATING),
    Hard("taxels_over_70_decades", _decades(4, 4, -35, 35), CHIP),
    *(
        # From 1e9 S on columns are one node, with a condition number of that size.
        Hard(f"laterals_of_{siemens:g}_s", _random("lateral", 4, 5), CHIP | {"g_lateral_row_s": siemens})
        for siemens in (1e9, 1e16, 1e24, 1e-12)
    ),
    Hard("drivers_ideal", _random("d", 4, 5), {"r_column_ohm": 0.5}),
    Hard("drivers_1e9", _random("d9", 4, 5), _drivers(1e9, 1e9)),
    Hard("driver_ideal_others_1e9", _random("d09", 4, 5), _drivers(0.0, 1e9)),
    Hard("driver_1e9_others_ideal", _random("d90", 4, 5), _drivers(1e9, 0.0)),
    Hard("driver_1e9_others_ideal_offsets", _FAR_APART, _UNEQUAL, cancels=True),
    Hard("rows_floating", _random("f", 5, 4), FLOATING),
    Hard("rows_floating_and_open", _with(0.0, (2, ALL)), FLOATING),
    Hard("rows_floating_tiny_traces", _random("f23", 3, 3), _traces(1e-23) | {"r_row_grounded_ohm": INF}),
    *(
        Hard(f"traces_{name}", _random("traces", 4, 4), _traces(ohm))
        for name, ohm in (("1e_minus_23", 1e-23), ("1e_minus_9", 1e-9), ("100", 100.0), ("1e9", 1e9))
    ),
    Hard("traces_of_rows_1e9", _random("steep", 3, 12, 1e-3, 1e3), CHIP | {"r_trace_row_ohm": 1e9}),
    Hard("traces_of_columns_alone", _random("columns", 4, 4), CHIP | {"r_trace_column_ohm": 0.3}),
    Hard("one_by_one", _random("1", 1, 1), TRACES, short=True),
    Hard("one_row", _random("1n", 1, 16), TRACES),
    Hard("one_column", _random("n1", 12, 1), TRACES),
    Hard("offsets_1e_minus_20", _random("tiny", 4, 5), _TINY, cancels=True),
    Hard("offset_1e30_behind_5e17", _random("1e30", 3, 3), _HUGE, cancels=True),
    Hard("leaks_behind_1e9", _random("leak", 3, 4), TRACES | _LEAKS, cancels=True),
    Hard("chip_with_everything", _random("chip", 16, 16), CHIP | _EVERYTHING, slots=(0, 9), cancels=True),
)
TABLE = {hard.name: hard for hard in _HARD}


_SKIPPED = {
    "rtl": "its Verilog gets the currents of the same solver",
    "cosim": "too far apart for ngspice; decks of ordinary arrays are compared in tb/system/test_decks.py",
}


def cases() -> list[Case]:
    """Return the currents and the codes of every network.

    The limit of a current is the promise of the solver: above its counted bound and far below a code.
    """
    found = []
    for name, hard in TABLE.items():
        solver = {"solver": partial(currents, name)}
        found.append(Case(name, "array", solver, 1e-12, "1", short=hard.short))
        runs = {engine: partial(codes, name, engine) for engine in ("closed", "event")}
        found.append(Case(f"{name}_codes", "array", runs, short=hard.short, refused=_SKIPPED))
    return found
