# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_top: codes against the exact charge balance, slot timing, reset and enable."""

from __future__ import annotations

import random
from typing import Any

import pytest
from rtl_reference import SHORT, Duty, code, code_closed, duty_of_resistance, ones
from rtl_run import simulate

from dermis.lint import header_values

pytestmark = pytest.mark.timeout(120)

HEADER = header_values()
DEFAULT = {
    "ROWS": HEADER["DERMIS_ROWS"],
    "COLS": HEADER["DERMIS_COLS"],
    "CODE_BITS": HEADER["DERMIS_CODE_BITS"],
    "GATE_CLOCKS": HEADER["DERMIS_GATE_CLOCKS"],
    "SETTLE_CLOCKS": HEADER["DERMIS_SETTLE_CLOCKS"],
}
SYNCHRONIZERS = pytest.mark.parametrize("sync_latch", [0, 1], ids=["sync_ff", "sync_latch"])


def read(
    simulator: str, x: list[list[Duty]], parameters: dict[str, int], slots: int | None = None, **scenario: Any
) -> Any:
    """Simulate `slots` slots (one frame by default) of the array `x`; only parameters away from default are set."""
    p = DEFAULT | parameters
    assert (len(x), len(x[0])) == (p["ROWS"], p["COLS"])
    slots = p["ROWS"] if slots is None else slots
    limit = slots * (p["GATE_CLOCKS"] + p["SETTLE_CLOCKS"]) + 20
    away = {key: value for key, value in parameters.items() if DEFAULT.get(key, 0) != value}
    return simulate(
        simulator,
        "bench_top",
        "dermis_top",
        "frames",
        away,
        {"x": x, "slots": slots, "limit": limit, **scenario},
    )


def codes(result: Any) -> list[list[int]]:
    return [slot["codes"] for slot in result["slots"]]


def expected(x: list[list[Duty]], p: dict[str, int]) -> list[list[int]]:
    return [[code(taxel, p["GATE_CLOCKS"], p["CODE_BITS"]) for taxel in row] for row in x]


def random_duties(rows: int, cols: int, seed: int, top: float = 0.5) -> list[list[Duty]]:
    """Duties from 0 to `top` with denominators to 10^6, half of them near the bottom of the range."""
    rng = random.Random(seed)

    def duty() -> Duty:
        q = rng.randint(1, 10**6)
        p = rng.randint(0, int(q * top))
        return (p, q * 100) if rng.random() < 0.5 else (p, q)

    return [[duty() for _ in range(cols)] for _ in range(rows)]


@SYNCHRONIZERS
def test_duty_c_over_510_reads_code_c_for_every_code(simulator: str, sync_latch: int) -> None:
    values = random.Random(2).sample(range(256), 256)  # no code stands beside its neighbour
    table = [values[16 * r : 16 * r + 16] for r in range(16)]
    result = read(simulator, [[(c, 510) for c in row] for row in table], {"SYNC_LATCH": sync_latch})
    assert codes(result) == table


@SYNCHRONIZERS
def test_random_duties_read_the_exact_charge_balance(simulator: str, sync_latch: int) -> None:
    x = random_duties(16, 16, seed=3)
    assert expected(x, DEFAULT) == [[code_closed(taxel, 510, 8) for taxel in row] for row in x]
    result = read(simulator, x, {"SYNC_LATCH": sync_latch})
    assert codes(result) == expected(x, DEFAULT)


@SYNCHRONIZERS
def test_half_a_count_either_side_of_each_code_boundary_is_resolved(simulator: str, sync_latch: int) -> None:
    """x = (c - 1/2)/510 is the lowest duty that reads c; a ten-millionth of a count below it reads c - 1."""
    fine = 10**7
    edges = list(range(1, 256, 2))  # 128 boundaries, each from both sides
    flat = [d for c in edges for d in ((2 * c - 1, 1020), (fine * (2 * c - 1) - 2, 1020 * fine))]
    x = [flat[16 * r : 16 * r + 16] for r in range(16)]
    result = read(simulator, x, {"SYNC_LATCH": sync_latch})
    wanted = [v for c in edges for v in (c, c - 1)]
    assert codes(result) == [wanted[16 * r : 16 * r + 16] for r in range(16)]


@SYNCHRONIZERS
def test_taxels_below_500_ohm_read_full_scale_and_leave_the_next_row_alone(
    simulator: str, sync_latch: int
) -> None:
    """Duties from just above 1/2 to a short circuit, in every other row; the rows between hold small codes."""
    over = [(1001, 2000), (2, 3), duty_of_resistance((312, 1)), (1, 1), (3, 2), (100, 1), SHORT, (256, 510)]
    x = [[over[(r // 2 + c) % 8] if r % 2 == 0 else ((r + c) % 4, 510) for c in range(16)] for r in range(16)]
    result = read(simulator, x, {"SYNC_LATCH": sync_latch}, slots=17)
    wanted = [[255 if r % 2 == 0 else (r + c) % 4 for c in range(16)] for r in range(16)]
    assert codes(result) == [*wanted, wanted[0]]


SHAPES: dict[str, dict[str, int]] = {
    "8x8": {"ROWS": 8, "COLS": 8},
    "16x1": {"ROWS": 16, "COLS": 1},
    "1x1": {"ROWS": 1, "COLS": 1},
    "3x4_10bit_2046": {"ROWS": 3, "COLS": 4, "CODE_BITS": 10, "GATE_CLOCKS": 2046, "SETTLE_CLOCKS": 30},
    "5x3_shortest_settle": {"ROWS": 5, "COLS": 3, "CODE_BITS": 4, "GATE_CLOCKS": 30, "SETTLE_CLOCKS": 2},
    "1x2_shortest_slot": {"ROWS": 1, "COLS": 2, "CODE_BITS": 1, "GATE_CLOCKS": 1, "SETTLE_CLOCKS": 2},
}


@SYNCHRONIZERS
@pytest.mark.parametrize("shape", SHAPES)
def test_other_sizes_read_the_exact_charge_balance(simulator: str, sync_latch: int, shape: str) -> None:
    p = DEFAULT | SHAPES[shape]
    x = random_duties(p["ROWS"], p["COLS"], seed=4, top=0.8)
    x[0][0] = SHORT
    x[-1][-1] = (1, 2) if p["GATE_CLOCKS"] > 1 else (1, 2 * 10**6)
    slots = 2 * p["ROWS"] + 1
    result = read(simulator, x, SHAPES[shape] | {"SYNC_LATCH": sync_latch}, slots=slots)
    wanted = expected(x, p)
    assert codes(result) == [wanted[s % p["ROWS"]] for s in range(slots)]
    assert [slot["row"] for slot in result["slots"]] == [s % p["ROWS"] for s in range(slots)]
    assert [slot["frame_done"] for slot in result["slots"]] == [
        s % p["ROWS"] == p["ROWS"] - 1 for s in range(slots)
    ]


@SYNCHRONIZERS
@pytest.mark.parametrize("shape", ["16x16", "1x1", "5x3_shortest_settle", "1x2_shortest_slot"])
def test_switches_and_codes_move_on_the_stated_edges(simulator: str, sync_latch: int, shape: str) -> None:
    """e0: row and preset; e0 + settle: preset off; e0 + settle + gate: next row; codes SYNC_CLOCKS + 1 edges later."""
    p = DEFAULT | SHAPES.get(shape, {})
    x = random_duties(p["ROWS"], p["COLS"], seed=5)
    slots = p["ROWS"] + 2
    result = read(simulator, x, SHAPES.get(shape, {}) | {"SYNC_LATCH": sync_latch}, slots=slots)
    e0 = 6  # TopBench.reset makes six edges
    slot = p["SETTLE_CLOCKS"] + p["GATE_CLOCKS"]
    wanted = [[0, 0, 1]]
    for s in range(slots):
        row = 1 << s % p["ROWS"]
        wanted += [[e0 + s * slot, row, 1], [e0 + s * slot + p["SETTLE_CLOCKS"], row, 0]]
    delay = 2 if sync_latch else 3
    edges = [e0 + (s + 1) * slot + delay for s in range(slots)]
    assert [s["edge"] for s in result["slots"]] == edges
    assert [w for w in result["switches"] if w[0] <= edges[-1] - delay - 1] == wanted


@SYNCHRONIZERS
@pytest.mark.parametrize("comparators", ["ones", "random"])
def test_comparators_that_chatter_during_preset_change_no_code(
    simulator: str, sync_latch: int, comparators: str
) -> None:
    p = SHAPES["8x8"]
    x = random_duties(8, 8, seed=6, top=0.6)
    result = read(simulator, x, p | {"SYNC_LATCH": sync_latch}, slots=9, comp_in_preset=comparators)
    wanted = expected(x, DEFAULT | p)
    assert codes(result) == [*wanted, wanted[0]]


@SYNCHRONIZERS
def test_every_sample_of_the_gate_counts_and_no_other(simulator: str, sync_latch: int) -> None:
    """Preset charges that put the single one of a gate at its first and at its last sample, and one sample too late."""
    p = {"ROWS": 1, "COLS": 4, "CODE_BITS": 4, "GATE_CLOCKS": 30, "SETTLE_CLOCKS": 2}
    # With x = 1/1000 the only one comes at sample n when the preset is -n/1000.
    preset = [(-1, 1000), (-30, 1000), (-31, 1000), (0, 1)]
    x = [[(1, 1000)] * 4]
    assert [ones(x[0][0], 30, w).index(1) if any(ones(x[0][0], 30, w)) else None for w in preset] == [
        0,
        29,
        None,
        0,
    ]
    result = read(simulator, x, p | {"SYNC_LATCH": sync_latch}, slots=3, w_preset=preset)
    assert codes(result) == [[1, 1, 0, 1]] * 3


@SYNCHRONIZERS
def test_dropped_enable_ends_the_slot_at_once_and_starts_again_at_row_0(
    simulator: str, sync_latch: int
) -> None:
    p = {"ROWS": 3, "COLS": 2, "CODE_BITS": 4, "GATE_CLOCKS": 6, "SETTLE_CLOCKS": 2, "SYNC_LATCH": sync_latch}
    slot = p["GATE_CLOCKS"] + p["SETTLE_CLOCKS"]
    x: list[list[Duty]] = [[(1, 2), (1, 6)], [(1, 3), (0, 1)], [SHORT, (2, 6)]]
    wanted = expected(x, DEFAULT | p)
    outcomes = simulate(
        simulator,
        "bench_top",
        "dermis_top",
        "enable_dropped",
        p,
        {"x": x, "longest": 3 * slot + 2, "off_clocks": [1, 2, 3, 7], "then_clocks": 4 * slot + 5},
    )
    assert len(outcomes) == 4 * (3 * slot + 2)
    delay = 2 if sync_latch else 3
    for o in outcomes:
        when = f"after {o['on_clocks']} clocks"
        assert (o["row_select"], o["preset"]) == (0, 1), when
        # A slot is whole when its last sample was taken, even by the very edge that saw enable low.
        whole = o["on_clocks"] // slot
        rows = [s % 3 for s in range(whole)] + [0, 1, 2, 0]
        assert [s["row"] for s in o["slots"]] == rows, when
        assert [s["codes"] for s in o["slots"]] == [wanted[r] for r in rows], when
        assert [s["edge"] - o["again"] for s in o["slots"][whole:]] == [
            n * slot + delay for n in (1, 2, 3, 4)
        ], when


@SYNCHRONIZERS
def test_power_up_and_reset_leave_no_row_driven_and_preset_on(simulator: str, sync_latch: int) -> None:
    p = {"ROWS": 3, "COLS": 2, "CODE_BITS": 4, "GATE_CLOCKS": 6, "SETTLE_CLOCKS": 2, "SYNC_LATCH": sync_latch}
    seen = simulate(
        simulator, "bench_top", "dermis_top", "power_up", p, {"x": [[SHORT, SHORT]] * 3, "into_slot": 6}
    )
    assert len(seen) == 15
    for what, *outputs in seen:
        assert outputs == ["000", "1", "00", "0"], what
