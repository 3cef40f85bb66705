# SPDX-License-Identifier: Apache-2.0
"""Hard cases of the array: shorts, opens, resistances 38 decades apart, lines that cancel, sizes
from 1x1 to 256x256.

Each runs in the solver and, if the network can be a scene, in engines closed and event. The
currents of every column in every slot and the codes are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines, plan, records
from dermis.array import solve_error
from dermis.array.array import Network, NoSolution, column_currents
from dermis.converter import vfc
from dermis.errors import InputError, SimulatorError
from tb.programs.hard.case import Case, Measured, case, texts
from tb.reference import nodal

Floats = NDArray[np.float64]

V_BIAS = 0.5
K_I0_A = 80 * 12.5e-6
"""Column current at duty 1 in the plans of `plan_of`."""

CLOCKS, CODE_MAX = 510, 255

DIGITS = 120

# A current of 0 is computed as the leakage of the stand-ins for ideal sources (docs/array.md,
# Bounds).
NOTHING_A = 1e-45


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(list(name.encode()))


def _random_g(name: str, rows: int, cols: int, low: float = 500.0, high: float = 64250.0) -> Floats:
    return 1.0 / np.exp(_rng(name).uniform(np.log(low), np.log(high), (rows, cols)))


@dataclass(frozen=True)
class Hard:
    """A hard network: its conductances, its other elements, and the source of its currents.

    `exact` gives the currents [rows, cols]; None uses the nodal matrix in DIGITS digits, only for
    `slots` if that would take long. With `cancels` the currents of offsets cancel, so errors are
    relative to the terms of the sum.
    """

    name: str
    g: Callable[[], Floats]
    kind: dict[str, Any] = field(default_factory=dict)
    exact: Callable[[Network], Floats] | None = None
    source: str = f"full nodal matrix by Gauss in {DIGITS} digits (tb/reference/nodal.py)"
    slots: tuple[int, ...] | None = None
    cancels: bool = False
    limit: float = 1e-12
    short: bool = False

    def network(self) -> Network:
        """Return the network."""
        return Network(self.g(), V_BIAS, **self.kind)

    def expected(self) -> Floats:
        """Return the currents of the slots in `slots`, or of all."""
        network = self.network()
        if self.exact is not None:
            return self.exact(network)[self.rows()]
        return nodal.column_currents(network, DIGITS, self.slots)

    def rows(self) -> Any:
        """Return the index of the compared slots."""
        return slice(None) if self.slots is None else list(self.slots)


def relative_error(hard: Hard) -> Measured:
    """Return the largest relative error of a current, relative to itself or to the largest one in
    its slot that cancels.
    """
    with solve_error.account() as account:
        have = column_currents(hard.network())[hard.rows()]
    want = hard.expected()
    size = np.abs(want)
    if hard.cancels:
        size = np.broadcast_to(np.abs(want).max(axis=-1, keepdims=True), want.shape)
    error = np.where(np.abs(have - want) <= NOTHING_A, 0.0, np.abs(have - want))
    worst = float(np.divide(error, size, out=np.where(error > 0, np.inf, 0.0), where=size > 0).max())
    note = (
        f"bound {account.bound:.1e}, residual {account.residual:.1e}, condition {account.condition:.1e}, "
        f"{account.slots_alone} slots alone"
    )
    return Measured(worst, note)


def plan_of(network: Network, engine: str) -> records.Plan:
    """Return a plan whose array is this network, with an ideal converter."""
    world = plan.scene.from_data(
        {
            "array": {"rows": network.rows, "cols": network.cols},
            "stimulus": {"kind": "uniform", "force_n": 0.0},
            "interface": {"v_bias_v": V_BIAS, "k": 80, "i0_a": K_I0_A / 80},
        },
        Path("network.toml"),
    )
    made = plan.make(world, engine)
    surrounding = {name: getattr(network, name) for name in network.active_fields()}
    with np.errstate(divide="ignore"):
        ohm = 1.0 / network.g_taxel_s[np.newaxis]
    return replace(made, resistance_ohm=ohm, surrounding=surrounding)


def code_error(hard: Hard, engine: str) -> Measured:
    """Return the largest error of a code; within 1e-6 count of a step both codes are right."""
    codes = engines.run(plan_of(hard.network(), engine)).codes[0][hard.rows()].astype(int)
    x = hard.expected() / K_I0_A
    # A millionth of a count: a thousandth of the error at which the solver refuses.
    low, high = (vfc.code(np.clip(x + s * 1e-6 / CLOCKS, -1e9, 1e9), CLOCKS, CODE_MAX) for s in (-1, 1))
    off = np.maximum(np.maximum(low - codes, codes - high), 0)
    return Measured(float(off.max()), f"codes {codes.min()}..{codes.max()}")


# ---- networks ------------------------------------------------------------------------------------------------------

CHIP = {"r_row_driven_ohm": 5.0, "r_row_grounded_ohm": 5.0, "r_column_ohm": 0.5, "g_lateral_row_s": 1e-3}
TRACES = CHIP | {"r_trace_row_ohm": 0.1, "r_trace_column_ohm": 0.1, "g_lateral_column_s": 1e-3}


def _with(value: float, *where: tuple[Any, Any], rows: int = 4, cols: int = 4) -> Floats:
    g = _random_g(f"{where}", rows, cols)
    for place in where:
        g[place] = value
    return g


def _decades(rows: int, cols: int, low: float, high: float) -> Floats:
    """Return conductances of resistances from 10^low to 10^high ohm, shuffled."""
    r = np.logspace(low, high, rows * cols)
    return 1.0 / _rng("decades").permutation(r).reshape(rows, cols)


def _uniform(network: Network) -> Floats:
    """Solve equal taxels with equal drivers and equal inputs by symmetry.

    Every column is at one voltage v and every row but the driven one at one voltage u: with n
    columns, m rows, the driven row at w, g (w - v) + (m - 1) g (u - v) = v / r_c, n g (v - u) = u /
    r, n g (w - v) = (V - w) / r.
    """
    m, n = network.rows, network.cols
    g, r, rc = float(network.g_taxel_s[0, 0]), network.r_row_driven_ohm, float(network.r_column_ohm[0])
    with nodal.mpmath.workdps(50):
        a = 1 / (
            nodal.mpmath.mpf(g) ** -1 + n * nodal.mpmath.mpf(r)
        )  # from a driver through a row to one column
        v = V_BIAS * a / (m * a + 1 / nodal.mpmath.mpf(rc))
        return np.full((m, n), float(v / nodal.mpmath.mpf(rc)))


def _ideal(network: Network) -> Floats:
    """Return V G minus the current that offsets drive into all rows."""
    return V_BIAS * network.g_taxel_s - (network.v_column_offset_v * network.g_taxel_s.sum(axis=0))


def _ladder(network: Network) -> Floats:
    """Solve one taxel after n segments of its row and m of its column: a series of resistances."""
    r, c = (int(i[0]) for i in np.nonzero(network.g_taxel_s))
    series = network.r_row_driven_ohm + (c + 1) * network.r_trace_row_ohm
    series += (
        (network.rows - r) * network.r_trace_column_ohm
        + network.r_column_ohm[c]
        + 1 / network.g_taxel_s[r, c]
    )
    out = np.zeros((network.rows, network.cols))
    out[r, c] = V_BIAS / series
    return out


def _one_of(size: int) -> Floats:
    g = np.zeros((size, size))
    g[1, size - 2] = 1e-3
    return g


ALL = slice(None)

HARD: tuple[Hard, ...] = (
    Hard("one_short", partial(_with, np.inf, (1, 2)), CHIP, short=True),
    Hard("many_shorts_share_a_row", partial(_with, np.inf, (1, 0), (1, 2), (2, 2), (3, 1)), CHIP),
    Hard("whole_row_shorted", partial(_with, np.inf, (2, ALL)), CHIP),
    Hard("whole_column_shorted", partial(_with, np.inf, (ALL, 1)), CHIP),
    Hard("all_shorted", partial(_with, np.inf, (ALL, ALL)), CHIP),
    Hard("one_open", partial(_with, 0.0, (1, 2)), CHIP, short=True),
    Hard("whole_row_open", partial(_with, 0.0, (2, ALL)), CHIP),
    Hard("whole_column_open", partial(_with, 0.0, (ALL, 1)), CHIP),
    Hard("all_open", partial(_with, 0.0, (ALL, ALL)), CHIP),
    Hard(
        "row_shorted_and_column_open",
        partial(_with, np.inf, (2, slice(0, 3)), (0, 0)),
        CHIP | {"r_row_grounded_ohm": np.inf},
    ),
    Hard("taxels_over_18_decades", partial(_decades, 4, 5, -3, 15), CHIP, short=True),
    Hard("taxels_over_18_decades_traces", partial(_decades, 4, 4, -3, 15), TRACES),
    Hard(
        "taxels_over_18_decades_floating",
        partial(_decades, 4, 5, -3, 15),
        CHIP | {"r_row_grounded_ohm": np.inf},
    ),
    Hard("taxels_over_70_decades", partial(_decades, 4, 4, -35, 35), CHIP),
    Hard(
        "tiny_taxels_share",
        lambda: np.array([[1e30, 1e30 / 3], [1e-3, 1e-3]]),
        {"r_row_driven_ohm": 1e3, "r_row_grounded_ohm": 1e3, "r_column_ohm": 1e-31},
    ),
    Hard("laterals_off_beside_real_inputs", partial(_random_g, "off", 4, 5), CHIP | {"g_lateral_row_s": 0.0}),
    *(
        Hard(f"laterals_{name}", partial(_random_g, "lateral", 4, 5), CHIP | {"g_lateral_row_s": 1 / ohm})
        for name, ohm, what in (
            ("nano_ohm", 1e-9, "one node, condition 1e9"),
            ("condition_1e16", 1e-16, "one node, condition past 1e16"),
            ("condition_1e24", 1e-24, "one node, condition past 1e24"),
            ("tera_ohm", 1e12, "practically isolated"),
        )
    ),
    Hard("drivers_ideal", partial(_random_g, "d", 4, 5), {"r_column_ohm": 0.5}),
    Hard(
        "drivers_1e9",
        partial(_random_g, "d9", 4, 5),
        CHIP | {"r_row_driven_ohm": 1e9, "r_row_grounded_ohm": 1e9},
    ),
    Hard(
        "driver_ideal_others_1e9",
        partial(_random_g, "d09", 4, 5),
        CHIP | {"r_row_driven_ohm": 0.0, "r_row_grounded_ohm": 1e9},
    ),
    Hard(
        "driver_1e9_others_ideal",
        partial(_random_g, "d90", 4, 5),
        CHIP | {"r_row_driven_ohm": 1e9, "r_row_grounded_ohm": 0.0},
    ),
    Hard(
        "driver_1e9_others_ideal_offsets",
        lambda: np.array([[1e12, 1e3], [1e-3, 2e-3]]),
        {
            "r_row_driven_ohm": 1e6,
            "r_row_grounded_ohm": 0.0,
            "r_column_ohm": 1e-12,
            "v_column_offset_v": [1e-3, 0.0],
        },
        cancels=True,
    ),
    Hard("rows_floating", partial(_random_g, "f", 5, 4), CHIP | {"r_row_grounded_ohm": np.inf}),
    Hard("rows_floating_and_open", partial(_with, 0.0, (2, ALL)), CHIP | {"r_row_grounded_ohm": np.inf}),
    Hard(
        "rows_floating_tiny_traces",
        partial(_random_g, "f23", 3, 3),
        TRACES | {"r_row_grounded_ohm": np.inf, "r_trace_row_ohm": 1e-23, "r_trace_column_ohm": 1e-23},
    ),
    *(
        Hard(
            f"traces_{name}",
            partial(_random_g, "traces", 4, 4),
            TRACES | {"r_trace_row_ohm": ohm, "r_trace_column_ohm": ohm},
        )
        for name, ohm in (("1e_minus_23", 1e-23), ("1e_minus_9", 1e-9), ("100", 100.0), ("1e9", 1e9))
    ),
    Hard(
        "traces_of_rows_1e9", partial(_random_g, "steep", 3, 12, 1e-3, 1e3), CHIP | {"r_trace_row_ohm": 1e9}
    ),
    Hard("traces_of_columns_alone", partial(_random_g, "columns", 4, 4), CHIP | {"r_trace_column_ohm": 0.3}),
    Hard("one_by_one", partial(_random_g, "1", 1, 1), TRACES, short=True),
    Hard("one_row", partial(_random_g, "1n", 1, 16), TRACES),
    Hard("one_column", partial(_random_g, "n1", 12, 1), TRACES),
    Hard(
        "offsets_1e_minus_20",
        partial(_random_g, "tiny", 4, 5),
        CHIP | {"v_column_offset_v": [1e-20, -1e-20, 1e-20, 0.0, 2e-20], "r_column_ohm": 1e-9},
        cancels=True,
    ),
    Hard(
        "offsets_1e3",
        partial(_random_g, "huge", 4, 5),
        CHIP | {"v_column_offset_v": [1e3, -1e3, 0.0, 5e2, 1.0]},
        cancels=True,
    ),
    Hard(
        "offset_1e30_behind_5e17",
        partial(_random_g, "1e30", 3, 3),
        CHIP | {"v_column_offset_v": [-1e30, 0.0, 0.0], "r_column_ohm": [5e17, 0.5, 0.5]},
        cancels=True,
    ),
    Hard(
        "leaks_behind_1e9",
        partial(_random_g, "leak", 3, 4),
        TRACES | {"i_leak_a": [1e-6, 0.0, -1e-9, 1e-15], "r_column_ohm": [1e9, 0.5, 1e3, 1e6]},
        cancels=True,
    ),
    Hard(
        "chip_with_everything",
        partial(_random_g, "chip", 16, 16),
        CHIP
        | {
            "r_row_grounded_ohm": 8.0,
            "v_column_offset_v": 1e-3 * _rng("offsets").standard_normal(16),
            "i_leak_a": 1e-8,
        },
        slots=(0, 9),
        cancels=True,
    ),
    Hard(
        "square_256_uniform",
        lambda: np.full((256, 256), 1e-4),
        {"r_row_driven_ohm": 1.0, "r_row_grounded_ohm": 1.0, "r_column_ohm": 0.5},
        exact=_uniform,
        source="symmetry: three equations, solved by hand, in 50 digits",
        limit=1e-11,
    ),
    Hard(
        "square_256_ideal_offsets",
        partial(_random_g, "256", 256, 256),
        {"v_column_offset_v": 1e-3 * _rng("256 offsets").standard_normal(256)},
        exact=_ideal,
        source="V G less offset times the sum of a column",
        cancels=True,
    ),
    Hard(
        "square_128_one_taxel_on_traces",
        partial(_one_of, 128),
        TRACES | {"g_lateral_row_s": 0.0, "g_lateral_column_s": 0.0},
        exact=_ladder,
        source="a series of resistances",
        limit=1e-11,
    ),
)


def exact_fractions() -> Measured:
    """Compare small networks with exact rationals: only the solver rounds."""
    worst, rng = 0.0, _rng("fractions")
    for _ in range(12):
        rows, cols = rng.integers(1, 4, 2)
        g = 10.0 ** -rng.integers(-3, 15, (rows, cols))
        kind = {
            "r_row_driven_ohm": 3.0,
            "r_row_grounded_ohm": 1e6,
            "r_column_ohm": 0.125,
            "g_lateral_row_s": 1e6,
        }
        network = Network(g, V_BIAS, **kind)
        want = nodal.column_currents(network, digits=0)
        worst = max(worst, float(np.abs(column_currents(network) / want - 1).max()))
    return Measured(worst)


def refused_value(field_name: str, value: Any) -> Measured:
    """Return 1 unless an invalid value is refused by name."""
    try:
        if field_name == "g_frames_s":
            column_currents(Network(np.ones((2, 2)), V_BIAS, 1.0), np.full((1, 2, 2), value))
        elif field_name == "g_taxel_s":
            Network(np.full((2, 2), value), V_BIAS)
        else:
            Network(np.ones((2, 2)), V_BIAS, **{field_name: value})
    except ValueError as error:
        said = {"r_row_driven_ohm": "row resistances", "g_lateral_row_s": "lateral conductances"}
        said |= {"r_trace_row_ohm": "trace resistances"}
        named = said.get(field_name, field_name) in str(error)
        return Measured(0.0 if named else 1.0, str(error))
    return Measured(1.0, "taken")


def no_solution(engine: str | None) -> Measured:
    """Return 1 unless a short across ideal sources is refused with its row and column."""
    network = Network(np.array([[1e-3, np.inf], [1e-3, 1e-3]]), V_BIAS, v_column_offset_v=[0.0, 1e-3])
    try:
        if engine is None:
            column_currents(network)
        else:
            engines.run(plan_of(network, engine))
    except (NoSolution, InputError) as error:
        return Measured(0.0 if "row 0, column 1" in str(error) else 1.0, str(error))
    return Measured(1.0, "solved")


def doubtful_code(engine: str) -> Measured:
    """Return 1 unless currents that cancel beyond double precision are refused with their row and
    column.
    """
    network = Network(np.full((2, 3), 1e-3), V_BIAS, g_lateral_row_s=1e12, v_column_offset_v=[1.0, 0.0, -1.0])
    try:
        engines.run(plan_of(network, engine))
    except SimulatorError as error:
        return Measured(0.0 if "column 1" in str(error) else 1.0, str(error))
    return Measured(1.0, "solved")


def random_networks(count: int) -> Measured:
    """Return the largest error of a current over its own bound, over random networks."""
    worst, rng = 0.0, _rng("random")
    for _ in range(count):
        rows, cols = rng.integers(1, 5, 2)
        kind = {
            "r_row_driven_ohm": 10 ** rng.uniform(-9, 9),
            "r_row_grounded_ohm": rng.choice([0.0, 10 ** rng.uniform(-9, 9), np.inf]),
            "r_column_ohm": 10 ** rng.uniform(-9, 9, cols),
            "g_lateral_row_s": rng.choice([0.0, 10 ** rng.uniform(-9, 9)]),
            "r_trace_row_ohm": rng.choice([0.0, 10 ** rng.uniform(-9, 9)]),
            "r_trace_column_ohm": rng.choice([0.0, 10 ** rng.uniform(-9, 9)]),
        }
        network = Network(10 ** -rng.uniform(-3, 15, (rows, cols)), V_BIAS, **kind)
        with solve_error.account() as account:
            have = column_currents(network)
        want = nodal.column_currents(network, DIGITS)
        error = np.where(np.abs(have - want) <= NOTHING_A, 0.0, np.abs(have - want))
        worst = max(worst, float((error / np.abs(want)).max()) / account.bound)
    return Measured(worst, f"{count} networks")


_PROMISE = "the promise of the solver: above its counted bound and far below a code"
_CANCELS = "; of the largest current of the slot, since sources cancel by nature"
_REFUSED = {
    "rtl": "its Verilog gets the currents of the same solver",
    "cosim": "resistances too far apart for ngspice; decks of ordinary arrays are compared in "
    "tb/system/test_decks.py and tb/model/test_array_peers.py",
}


def cases() -> list[Case]:
    """Return every case, and the refusals."""
    found = []
    for hard in HARD:
        why = texts()[hard.name]["why"]
        found.append(
            case(
                "array",
                hard.name,
                {"solver": partial(run_currents, hard.name)},
                expected="every column current in every slot",
                source=hard.source,
                tolerance=_PROMISE + (_CANCELS if hard.cancels else ""),
                limit=hard.limit,
                unit="1",
                short=hard.short,
            )
        )
        found.append(
            case(
                "array",
                f"{hard.name}_codes",
                {name: partial(run_code, hard.name, name) for name in ("closed", "event")},
                why=why,
                source=hard.source + ", then the count formula",
                **texts()["codes_of_networks"],
                short=hard.short,
                refused=_REFUSED,
            )
        )

    def refusal(name: str, runs: dict[str, Callable[[], Measured]], **other: str) -> Case:
        return case("array", name, runs, unit="1", short=True, **texts()["refused_networks"], **other)

    for key, value in (
        ("g_taxel_s", np.nan), ("g_taxel_s", -1e-3), ("g_frames_s", np.nan), ("r_column_ohm", np.nan),
        ("r_column_ohm", -1.0), ("r_row_driven_ohm", np.nan), ("g_lateral_row_s", -1.0), ("r_trace_row_ohm", np.nan),
        ("v_column_offset_v", np.inf), ("i_leak_a", np.nan),
    ):  # fmt: skip
        kind = "nan" if np.isnan(value) else "infinite" if np.isinf(value) else "negative"
        run = partial(refused_value, key, value)
        why = f"{kind} in {key} would spread into every current"
        found.append(refusal(f"{key}_{kind}_refused", {"solver": run}, why=why))
    shorts = {"solver": partial(no_solution, None)}
    shorts |= {engine: partial(no_solution, engine) for engine in ("closed", "event", "rtl", "cosim")}
    doubtful = {engine: partial(doubtful_code, engine) for engine in ("closed", "event")}
    return [
        *found,
        refusal("short_across_ideal_sources", shorts),
        refusal("offsets_cancel_beyond_doubles", doubtful),
        case("array", "small_networks_in_fractions", {"solver": exact_fractions}, limit=1e-12, unit="1"),
        case(
            "array",
            "random_networks_within_their_bounds",
            {"solver": partial(random_networks, 60)},
            source=f"nodal matrix in {DIGITS} digits",
            limit=1.0,
            unit="1",
        ),
    ]


def prepare(chosen: Sequence[Case]) -> None:
    """Compile the elimination before the timed runs."""
    for trace in (0.0, 0.1):
        column_currents(Network(np.ones((2, 2)), V_BIAS, 1.0, 1.0, 1.0, r_trace_column_ohm=trace))


def _hard(name: str) -> Hard:
    return next(hard for hard in HARD if hard.name == name)


def run_currents(name: str) -> Measured:
    """Return the error of the currents of a network by name (a worker process takes names)."""
    return relative_error(_hard(name))


def run_code(name: str, engine: str) -> Measured:
    """Return the error of the codes of a network by name, in an engine."""
    return code_error(_hard(name), engine)
