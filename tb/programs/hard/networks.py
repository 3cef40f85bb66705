# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the array: shorts, opens, resistances 70 decades apart, lines that cancel, sizes
from 1x1 to 256x256.

Each runs in the solver and in engines closed and event. The currents of every column in every slot
and the codes are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan, records
from dermis.array import solve_error
from dermis.array.array import Network, NoSolution, column_currents
from dermis.converter import vfc
from dermis.errors import InputError, SimulatorError
from dermis.scene import scene
from tb.programs.hard.case import Case, Measured
from tb.reference import nodal

Floats = NDArray[np.float64]

V_BIAS = 0.5
K_I0_A = 80 * 12.5e-6
"""Column current at duty 1 in the plans of `plan_of`."""

CLOCKS, CODE_MAX = 510, 255

DIGITS = 120
_NODAL = f"full nodal matrix by Gauss in {DIGITS} digits (tb/reference/nodal.py)"

# A current of 0 is computed as the leakage of the stand-ins for ideal sources (docs/array.md,
# Bounds).
NOTHING_A = 1e-45


@dataclass(frozen=True)
class Hard:
    """A hard network: its conductances, its other elements, and the source of its currents.

    `exact` gives the currents [rows, cols]; None uses the nodal matrix in DIGITS digits, only for
    `slots` if that would take long. With `cancels` the currents of offsets cancel, so errors are
    relative to the terms of the sum.
    """

    name: str
    why: str
    g: Floats
    kind: dict[str, Any] = field(default_factory=dict)
    exact: Callable[[Network], Floats] | None = None
    source: str = _NODAL
    slots: tuple[int, ...] | None = None
    cancels: bool = False
    limit: float = 1e-12
    short: bool = False

    def network(self) -> Network:
        """Return the network."""
        return Network(self.g, V_BIAS, **self.kind)

    def expected(self) -> Floats:
        """Return the currents of the slots in `slots`, or of all."""
        if self.exact is not None:
            return self.exact(self.network())
        return nodal.column_currents(self.network(), DIGITS, self.slots)

    def rows(self) -> Any:
        """Return the index of the compared slots."""
        return slice(None) if self.slots is None else list(self.slots)


def _error(have: Floats, want: Floats) -> Floats:
    return np.where(np.abs(have - want) <= NOTHING_A, 0.0, np.abs(have - want))


def currents(name: str) -> Measured:
    """Return the largest relative error of a current, relative to itself or to the largest one in
    its slot that cancels.
    """
    hard = TABLE[name]
    with solve_error.recording() as record:
        have = column_currents(hard.network())[hard.rows()]
    want = hard.expected()
    size = np.abs(want)
    if hard.cancels:
        size = np.broadcast_to(size.max(axis=-1, keepdims=True), want.shape)
    error = _error(have, want)
    worst = np.divide(error, size, out=np.where(error > 0, np.inf, 0.0), where=size > 0).max()
    return Measured(float(worst), f"bound {record.bound:.1e}, condition {record.condition:.1e}")


def plan_of(network: Network, engine: str) -> records.Plan:
    """Return a plan whose array is this network, with an ideal converter."""
    data = {
        "array": {"rows": network.rows, "cols": network.cols},
        "stimulus": {"kind": "uniform", "force_n": 0.0},
        "interface": {"v_bias_v": V_BIAS, "k": 80, "i0_a": K_I0_A / 80},
    }
    made = plan.make(scene.from_data(data, Path("network.toml")), engine)
    surrounding = {name: getattr(network, name) for name in network.active_fields()}
    with np.errstate(divide="ignore"):
        ohm = 1.0 / network.g_taxel_s[np.newaxis]
    return replace(made, resistance_ohm=ohm, surrounding=surrounding)


def codes(name: str, engine: str) -> Measured:
    """Return the largest error of a code; within 1e-6 count of a step both codes are right."""
    hard = TABLE[name]
    found = engines.run(plan_of(hard.network(), engine)).codes[0][hard.rows()].astype(int)
    x = hard.expected() / K_I0_A
    # A millionth of a count: a thousandth of the error at which the solver refuses.
    low, high = (vfc.code(np.clip(x + s * 1e-6 / CLOCKS, -1e9, 1e9), CLOCKS, CODE_MAX) for s in (-1, 1))
    off = np.maximum(np.maximum(low - found, found - high), 0)
    return Measured(float(off.max()), f"codes {found.min()}..{found.max()}")


# ---- networks ------------------------------------------------------------------------------------------------------


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


def _uniform(network: Network) -> Floats:
    """Solve equal taxels with equal drivers and equal inputs by symmetry.

    Every column is at one voltage v and every row but the driven one at one voltage u: with n
    columns, m rows, the driven row at w, g (w - v) + (m - 1) g (u - v) = v / r_c, n g (v - u) = u /
    r, n g (w - v) = (V - w) / r.
    """
    m, n = network.rows, network.cols
    g, r, rc = float(network.g_taxel_s[0, 0]), network.r_row_driven_ohm, float(network.r_column_ohm[0])
    with mpmath.workdps(50):
        a = 1 / (1 / mpmath.mpf(g) + n * mpmath.mpf(r))  # from a driver through a row to one column
        v = V_BIAS * a / (m * a + 1 / mpmath.mpf(rc))
        return np.full((m, n), float(v / mpmath.mpf(rc)))


def _ideal(network: Network) -> Floats:
    """Return V G minus the current that offsets drive into all rows."""
    return V_BIAS * network.g_taxel_s - network.v_column_offset_v * network.g_taxel_s.sum(axis=0)


def _ladder(network: Network) -> Floats:
    """Solve one taxel after n segments of its row and m of its column: a series of resistances."""
    r, c = (int(i[0]) for i in np.nonzero(network.g_taxel_s))
    series = network.r_row_driven_ohm + (c + 1) * network.r_trace_row_ohm
    series += (network.rows - r) * network.r_trace_column_ohm
    series += network.r_column_ohm[c] + 1 / network.g_taxel_s[r, c]
    out = np.zeros((network.rows, network.cols))
    out[r, c] = V_BIAS / series
    return out


def _one_of(size: int) -> Floats:
    g = np.zeros((size, size))
    g[1, size - 2] = 1e-3
    return g


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
_MANY_MILLIVOLTS = 1e-3 * _rng("256 offsets").standard_normal(256)
_TINY = {"r_row_driven_ohm": 1e3, "r_row_grounded_ohm": 1e3, "r_column_ohm": 1e-31}
_LARGE = {"r_row_driven_ohm": 1.0, "r_row_grounded_ohm": 1.0, "r_column_ohm": 0.5}
_NO_LATERALS = TRACES | {"g_lateral_row_s": 0.0, "g_lateral_column_s": 0.0}
_UNEQUAL = {"r_row_driven_ohm": 1e6, "r_row_grounded_ohm": 0.0, "r_column_ohm": 1e-12}
_LEAKS = {"i_leak_a": [1e-6, 0.0, -1e-9, 1e-15], "r_column_ohm": [1e9, 0.5, 1e3, 1e6]}
_EVERYTHING = {"r_row_grounded_ohm": 8.0, "v_column_offset_v": _MILLIVOLTS, "i_leak_a": 1e-8}

_HARD = (
    Hard("one_short", "0 ohm and kilohms in one array", _with(INF, (1, 2)), CHIP, short=True),
    Hard(
        "many_shorts_share_a_row", "two shorts share a current as small equal resistances do", _SHARED, CHIP
    ),
    Hard("whole_row_shorted", "four columns are one node through a row", _with(INF, (2, ALL)), CHIP),
    Hard("whole_column_shorted", "every row is one node through a column", _with(INF, (ALL, 1)), CHIP),
    Hard("all_shorted", "nothing but shorts between drivers and inputs", _with(INF, (ALL, ALL)), CHIP),
    Hard("one_open", "a conductance of 0", _with(0.0, (1, 2)), CHIP, short=True),
    Hard("whole_row_open", "a row that leads nowhere", _with(0.0, (2, ALL)), CHIP),
    Hard("whole_column_open", "a column that only laterals feed", _with(0.0, (ALL, 1)), CHIP),
    Hard("all_open", "a matrix of drivers and inputs alone", _with(0.0, (ALL, ALL)), CHIP),
    Hard("row_shorted_and_column_open", "0 and infinity in one matrix", _SHORT_AND_OPEN, FLOATING),
    Hard("taxels_over_18_decades", "1e-3 to 1e15 ohm in one array", _decades(4, 5, -3, 15), CHIP, short=True),
    Hard("taxels_over_18_decades_traces", "and traces between them", _decades(4, 4, -3, 15), TRACES),
    Hard("taxels_over_18_decades_floating", "rows on 1e15 ohm alone", _decades(4, 5, -3, 15), FLOATING),
    Hard("taxels_over_70_decades", "far beyond the stand-ins for 0 and inf", _decades(4, 4, -35, 35), CHIP),
    Hard(
        "tiny_taxels_share",
        "taxels of 1e-30 and 3e-30 ohm share a driver's current 3 to 1",
        np.array([[1e30, 1e30 / 3], [1e-3, 1e-3]]),
        _TINY,
    ),
    Hard(
        "laterals_off", "a diagonal block but for rows", _random("off", 4, 5), CHIP | {"g_lateral_row_s": 0.0}
    ),
    *(
        Hard(f"laterals_{name}", why, _random("lateral", 4, 5), CHIP | {"g_lateral_row_s": siemens})
        for name, siemens, why in (
            ("nano_ohm", 1e9, "columns are one node, condition 1e9"),
            ("condition_1e16", 1e16, "columns are one node, condition past 1e16"),
            ("condition_1e24", 1e24, "columns are one node, condition past 1e24"),
            ("tera_ohm", 1e-12, "columns are as good as alone"),
        )
    ),
    Hard("drivers_ideal", "drivers of 0 ohm: rows are no nodes", _random("d", 4, 5), {"r_column_ohm": 0.5}),
    Hard("drivers_1e9", "rows nearly float, driven or not", _random("d9", 4, 5), _drivers(1e9, 1e9)),
    Hard("driver_ideal_others_1e9", "a slot holds a floating node", _random("d09", 4, 5), _drivers(0.0, 1e9)),
    Hard("driver_1e9_others_ideal", "a slot frees a held node", _random("d90", 4, 5), _drivers(1e9, 0.0)),
    Hard(
        "driver_1e9_others_ideal_offsets",
        "the current that offsets drive through that row must vanish again",
        np.array([[1e12, 1e3], [1e-3, 2e-3]]),
        _UNEQUAL | {"v_column_offset_v": [1e-3, 0.0]},
        cancels=True,
    ),
    Hard("rows_floating", "only the driven row is connected: ghosts", _random("f", 5, 4), FLOATING),
    Hard("rows_floating_and_open", "a floating row without a taxel", _with(0.0, (2, ALL)), FLOATING),
    Hard(
        "rows_floating_tiny_traces",
        "traces of 1e-23 ohm along floating rows",
        _random("f23", 3, 3),
        _traces(1e-23) | {"r_row_grounded_ohm": INF},
    ),
    *(
        Hard(f"traces_{name}", f"lines of {ohm:g} ohm a pitch", _random("traces", 4, 4), _traces(ohm))
        for name, ohm in (("1e_minus_23", 1e-23), ("1e_minus_9", 1e-9), ("100", 100.0), ("1e9", 1e9))
    ),
    Hard(
        "traces_of_rows_1e9",
        "row lines with so large a drop that products along them leave the range of factors",
        _random("steep", 3, 12, 1e-3, 1e3),
        CHIP | {"r_trace_row_ohm": 1e9},
    ),
    Hard(
        "traces_of_columns_alone",
        "a chain of blocks without row lines",
        _random("columns", 4, 4),
        CHIP | {"r_trace_column_ohm": 0.3},
    ),
    Hard("one_by_one", "a matrix with one element", _random("1", 1, 1), TRACES, short=True),
    Hard("one_row", "no grounded row at all", _random("1n", 1, 16), TRACES),
    Hard("one_column", "no neighbour to share a row with", _random("n1", 12, 1), TRACES),
    Hard(
        "offsets_1e_minus_20",
        "offsets of 1e-20 of the bias alone: their relative error counts",
        _random("tiny", 4, 5),
        _offsets(1e-20, -1e-20, 1e-20, 0.0, 2e-20) | {"r_column_ohm": 1e-9},
        cancels=True,
    ),
    Hard(
        "offsets_1e3",
        "offsets 2000 times the bias",
        _random("huge", 4, 5),
        _offsets(1e3, -1e3, 0.0, 5e2, 1.0),
        cancels=True,
    ),
    Hard(
        "offset_1e30_behind_5e17",
        "-1e30 V and 5e17 ohm: 2e12 A next to microamperes",
        _random("1e30", 3, 3),
        _offsets(-1e30, 0.0, 0.0) | {"r_column_ohm": [5e17, 0.5, 0.5]},
        cancels=True,
    ),
    Hard(
        "leaks_behind_1e9",
        "a leak whose path through the array has a thousandth of the resistance of its own input",
        _random("leak", 3, 4),
        TRACES | _LEAKS,
        cancels=True,
    ),
    Hard(
        "chip_with_everything",
        "16x16, all series resistances, unequal drivers, offsets and leaks",
        _random("chip", 16, 16),
        CHIP | _EVERYTHING,
        slots=(0, 9),
        cancels=True,
    ),
    Hard(
        "square_256_uniform",
        "65 536 taxels, four panels of columns",
        np.full((256, 256), 1e-4),
        _LARGE,
        _uniform,
        "symmetry: three equations, solved by hand, in 50 digits",
        limit=1e-11,
    ),
    Hard(
        "square_256_ideal_offsets",
        "256x256 with offsets on ideal lines",
        _random("256", 256, 256),
        {"v_column_offset_v": _MANY_MILLIVOLTS},
        _ideal,
        "V G less offset times the sum of a column",
        cancels=True,
    ),
    Hard(
        "square_128_one_taxel_on_traces",
        "one taxel at the far corner after 255 segments",
        _one_of(128),
        _NO_LATERALS,
        _ladder,
        "a series of resistances",
        limit=1e-11,
    ),
)
TABLE = {hard.name: hard for hard in _HARD}


# ---- many networks, refusals ---------------------------------------------------------------------------------------


def small_in_fractions() -> Measured:
    """Compare small networks with exact rationals: only the solver rounds."""
    worst, rng = 0.0, _rng("fractions")
    kind = {"r_row_driven_ohm": 3.0, "r_row_grounded_ohm": 1e6, "r_column_ohm": 0.125, "g_lateral_row_s": 1e6}
    for _ in range(12):
        network = Network(10.0 ** -rng.integers(-3, 15, rng.integers(1, 4, 2)), V_BIAS, **kind)
        want = nodal.column_currents(network, digits=0)
        worst = max(worst, float(np.abs(column_currents(network) / want - 1).max()))
    return Measured(worst)


def random_networks(count: int) -> Measured:
    """Return the largest error of a current over its own bound, over random networks."""
    worst, rng = 0.0, _rng("random")

    def ohm(size: int | None = None) -> Any:
        return 10 ** rng.uniform(-9, 9, size)

    for _ in range(count):
        rows, cols = rng.integers(1, 5, 2)
        network = Network(
            10 ** -rng.uniform(-3, 15, (rows, cols)),
            V_BIAS,
            r_row_driven_ohm=ohm(),
            r_row_grounded_ohm=rng.choice([0.0, ohm(), INF]),
            r_column_ohm=ohm(cols),
            g_lateral_row_s=rng.choice([0.0, ohm()]),
            r_trace_row_ohm=rng.choice([0.0, ohm()]),
            r_trace_column_ohm=rng.choice([0.0, ohm()]),
        )
        with solve_error.recording() as record:
            have = column_currents(network)
        want = nodal.column_currents(network, DIGITS)
        worst = max(worst, float((_error(have, want) / np.abs(want)).max()) / record.bound)
    return Measured(worst, f"{count} networks")


def refused_value(name: str, value: float) -> Measured:
    """Return 1 unless an invalid value of a field is refused by the name of its kind."""
    try:
        if name == "g_frames_s":
            column_currents(Network(np.ones((2, 2)), V_BIAS, 1.0), np.full((1, 2, 2), value))
        else:
            bad = np.full((2, 2), value) if name == "g_taxel_s" else value
            Network(**{"g_taxel_s": np.ones((2, 2)), "v_bias_v": V_BIAS, name: bad})
    except ValueError as error:
        return Measured(float(REFUSED[name][0] not in str(error)), str(error))
    return Measured(1.0, "accepted")


REFUSED: dict[str, tuple[str, Sequence[float]]] = {
    "g_taxel_s": ("g_taxel_s", (np.nan, -1e-3)),
    "g_frames_s": ("g_frames_s", (np.nan,)),
    "r_column_ohm": ("r_column_ohm", (np.nan, -1.0)),
    "r_row_driven_ohm": ("row resistances", (np.nan,)),
    "g_lateral_row_s": ("lateral conductances", (-1.0,)),
    "r_trace_row_ohm": ("trace resistances", (np.nan,)),
    "v_column_offset_v": ("v_column_offset_v", (INF,)),
    "i_leak_a": ("i_leak_a", (np.nan,)),
}
"""Field of a network -> the word that an error says, and values that it must not have."""

SHORT = Network(np.array([[1e-3, INF], [1e-3, 1e-3]]), V_BIAS, v_column_offset_v=[0.0, 1e-3])
CANCELLING = Network(np.full((2, 3), 1e-3), V_BIAS, g_lateral_row_s=1e12, v_column_offset_v=[1.0, 0.0, -1.0])


def no_answer(network: Network, engine: str, where: str) -> Measured:
    """Return 1 unless a network is refused with its row and column."""
    try:
        column_currents(network) if engine == "solver" else engines.run(plan_of(network, engine))
    except (NoSolution, InputError, SimulatorError) as error:
        return Measured(float(where not in str(error)), str(error))
    return Measured(1.0, "solved")


_PROMISE = "the promise of the solver: above its counted bound and far below a code"
_NAMED = "0: an error names it, 1: it does not"
_SKIPPED = {
    "rtl": "its Verilog gets the currents of the same solver",
    "cosim": "too far apart for ngspice; decks of ordinary arrays are compared in tb/system/test_decks.py",
}


def cases() -> list[Case]:
    """Return every case, and the refusals."""

    def case(name: str, why: str, run: dict[str, Any], **other: Any) -> Case:
        text = {"expected": "every current", "source": _NODAL, "tolerance": _PROMISE, "unit": "1"}
        return Case(**{"name": name, "group": "array", "why": why, "runs": run, **text, **other})

    found = []
    for name, hard in TABLE.items():
        cancels = "; of the largest current of the slot, since sources cancel" if hard.cancels else ""
        more = {"source": hard.source, "short": hard.short}
        solver = {"solver": partial(currents, name)}
        found.append(case(name, hard.why, solver, tolerance=_PROMISE + cancels, limit=hard.limit, **more))
        runs = {engine: partial(codes, name, engine) for engine in ("closed", "event")}
        more |= {"expected": "the code of the exact current", "refused": _SKIPPED, "unit": "lsb"}
        whole = "codes are whole; within 1e-6 of a step both sides are right"
        found.append(case(f"{name}_codes", hard.why, runs, tolerance=whole, **more))
    none = {"expected": "an error that names it", "source": "no answer exists", "tolerance": _NAMED}
    bad = {f"{n}_{v:g}": partial(refused_value, n, v) for n, (_, values) in REFUSED.items() for v in values}
    short = {
        e: partial(no_answer, SHORT, e, "row 0, column 1")
        for e in ("solver", "closed", "event", "rtl", "cosim")
    }
    cancel = {engine: partial(no_answer, CANCELLING, engine, "column 1") for engine in ("closed", "event")}
    fractions, many = {"solver": small_in_fractions}, {"solver": partial(random_networks, 60)}
    return [
        *found,
        case(
            "values_refused",
            "NaN, inf and a negative would spread into every current",
            bad,
            short=True,
            **none,
        ),
        case(
            "short_across_ideal_sources",
            "0 ohm between a held row and a column with an offset",
            short,
            **none,
        ),
        case(
            "offsets_cancel_beyond_doubles", "1e12 A in and out again, where 2 uA are a code", cancel, **none
        ),
        case("small_networks_in_fractions", "the reference has no rounding", fractions, limit=1e-12),
        case(
            "random_networks_within_their_bounds", "36 decades apart, within their own bound", many, limit=1.0
        ),
    ]
