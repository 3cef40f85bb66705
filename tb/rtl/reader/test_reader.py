# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_reader: counts against the exact charge balance, slot timing, modes, reset and enable."""

import random
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rtl_run import simulate

from dermis.chip.hdl import gate_min
from dermis.chip.sources import rtl_include_dirs, rtl_sources
from scripts.lint import header_values
from tb.reference.chip import SHORT, Duty, count, ones

pytestmark = pytest.mark.timeout(120)

HEADER = header_values()
DEFAULT = {name: HEADER[f"DERMIS_{name}"] for name in ("ROWS", "COLS", "CODE_BITS", "BREAK_CLOCKS")}
DEFAULT |= {name: HEADER[f"DERMIS_{name.upper()}_CLOCKS"] for name in ("gate", "settle")}
SYNCHRONIZERS = pytest.mark.parametrize("sync_latch", [0, 1], ids=["sync_ff", "sync_latch"])
INJECT, DARK, FULL_EVEN, FULL_ODD = 0xF0, 0xF1, 0xF2, 0xF3


def read(simulator: str, x: list[list[Duty]], shape: dict, slots: int | None = None, **scenario: Any) -> Any:
    """Simulate `slots` slots (one frame by default) of the array `x`.

    `shape` has Verilog parameters in capitals, and gate and settle, which are inputs.
    """
    p = DEFAULT | shape
    assert (len(x), len(x[0])) == (p["ROWS"], p["COLS"])
    slots = p["ROWS"] if slots is None else slots
    limit = slots * (p["gate"] + p["settle"] + p["COLS"] + 12) + 20
    away = {key: value for key, value in shape.items() if key.isupper() and DEFAULT.get(key, 0) != value}
    settings = {"gate_i": p["gate"], "settle_i": p["settle"]} | scenario.pop("settings", {})
    played = {"x": x, "slots": slots, "limit": limit, "settings": settings, **scenario}
    return simulate(simulator, "bench_reader", "dermis_reader", "frames", away, played)


def counts(result: Any) -> list[list[int]]:
    return [slot["counts"] for slot in result["slots"]]


def expected(x: list[list[Duty]], p: dict[str, int]) -> list[list[int]]:
    return [[count(taxel, p["gate"], p["CODE_BITS"] + 1) for taxel in row] for row in x]


def random_duties(rows: int, cols: int, seed: int, top: float = 0.5) -> list[list[Duty]]:
    """Duties from 0 to `top` with denominators to 10^6, half of them near the bottom of the range."""
    rng = random.Random(seed)

    def duty() -> Duty:
        q = rng.randint(1, 10**6)
        p = rng.randint(0, int(q * top))
        return (p, q * 100) if rng.random() < 0.5 else (p, q)

    return [[duty() for _ in range(cols)] for _ in range(rows)]


def every_code() -> tuple[list[Duty], list[int]]:
    """Duties c/510 in random order; each reads c."""
    values = random.Random(2).sample(range(256), 256)
    return [(c, 510) for c in values], values


def boundaries() -> tuple[list[Duty], list[int]]:
    """x = (c - 1/2)/510 is the lowest duty that reads c; a ten-millionth of a count below it reads c - 1."""
    fine, edges = 10**7, list(range(1, 256, 2))
    x = [d for c in edges for d in ((2 * c - 1, 1020), (fine * (2 * c - 1) - 2, 1020 * fine))]
    return x, [v for c in edges for v in (c, c - 1)]


def overloads() -> tuple[list[Duty], list[int]]:
    """Duties from just above 1/2 to a short circuit in every other row; small codes between them."""
    over = [(1001, 2000), (2, 3), (250, 312), (1, 1), (3, 2), (100, 1), SHORT, (256, 510)]
    small = [(r + c) % 4 for r in range(16) for c in range(16)]
    rows = [n // 16 for n in range(256)]
    x = [over[(r // 2 + n) % 8] if r % 2 == 0 else (small[n], 510) for n, r in enumerate(rows)]
    return x, [255 if r % 2 == 0 else small[n] for n, r in enumerate(rows)]


@pytest.mark.paper
# Whole frames take a second; the small arrays below read through both synchronizers in the short run.
@pytest.mark.parametrize(
    "sync_latch", [pytest.param(0, id="sync_ff"), pytest.param(1, id="sync_latch", marks=pytest.mark.long)]
)
@pytest.mark.parametrize("taxels", [every_code, boundaries, overloads])
def test_a_frame_reads_the_exact_codes(simulator: str, sync_latch: int, taxels: Any) -> None:
    x, codes = (np.array(values, dtype=object) for values in taxels())
    result = read(simulator, x.reshape(16, 16, 2).tolist(), {"SYNC_LATCH": sync_latch}, slots=17)
    wanted = codes.reshape(16, 16).tolist()
    assert counts(result) == [*wanted, wanted[0]]


SMALL = {"ROWS": 3, "COLS": 5}

# Each with one synchronizer: what depends on both, size and form, the lint and short slots see.
SHAPES: dict[str, dict[str, int]] = {
    "8x8": {"ROWS": 8, "COLS": 8, "SYNC_LATCH": 1},
    "16x1": {"ROWS": 16, "COLS": 1, "gate": 126, "settle": 30},
    "1x1": {"ROWS": 1, "COLS": 1, "CODE_BITS": 1, "SYNC_LATCH": 1},
    "3x4_10bit_2046_break_of_5": {"ROWS": 3, "COLS": 4, "CODE_BITS": 10, "BREAK_CLOCKS": 5}
    | {"gate": 2046, "settle": 30},
    "64x64_10bit": {"ROWS": 64, "COLS": 64, "CODE_BITS": 10, "SYNC_LATCH": 1, "gate": 62, "settle": 5},
    "small": SMALL,
}


def reads_every_row(simulator: str, shape: dict[str, int], slots: int, **scenario: Any) -> None:
    """A scan of random taxels, a short among them, must show the exact counts and describe its rows."""
    p = DEFAULT | shape
    x = random_duties(p["ROWS"], p["COLS"], seed=4, top=0.8)
    x[0][0] = SHORT
    x[-1][-1] = (1, 2) if p["gate"] > 1 else (1, 2 * 10**6)
    result = read(simulator, x, shape, slots=slots, **scenario)
    wanted = expected(x, p)
    assert counts(result) == [wanted[s % p["ROWS"]] for s in range(slots)]
    last = p["ROWS"] - 1
    for s, slot in enumerate(result["slots"]):
        row = s % p["ROWS"]
        keys = "slot first last test_frame dark_frame gate_clocks row_fault".split()
        assert [slot[key] for key in keys] == [row, row == 0, row == last, 0, 0, p["gate"], 0]


@pytest.mark.parametrize(
    "shape", [pytest.param(shape, marks=[pytest.mark.long] * ("10bit" in shape)) for shape in SHAPES]
)
def test_other_sizes_read_the_exact_charge_balance(simulator: str, shape: str) -> None:
    p = SHAPES[shape]
    reads_every_row(simulator, p, p["ROWS"] + 2 if p["ROWS"] == 64 else 2 * p["ROWS"] + 1)


@SYNCHRONIZERS
@pytest.mark.parametrize(
    ("gate", "settle", "in_preset"), [(62, 12, "random"), (30, 3, "ones"), (1, 3, "model"), (5, 0, "random")]
)
def test_short_slots_read_the_exact_charge_balance_whatever_comparators_show_in_preset(
    simulator: str, sync_latch: int, gate: int, settle: int, in_preset: str
) -> None:
    shape = SMALL | {"SYNC_LATCH": sync_latch, "gate": gate, "settle": settle}
    reads_every_row(simulator, shape, 7, comp_in_preset=in_preset)


@SYNCHRONIZERS
@pytest.mark.parametrize("shape", [pytest.param("16x16", marks=pytest.mark.long), "small"])
def test_switches_and_rows_move_on_the_stated_edges(simulator: str, sync_latch: int, shape: str) -> None:
    """e0: row off, preset; e0 + break: row; e0 + settle: gate; the next e0 a gate later; counts SYNC_CLOCKS + 1 on."""
    p = DEFAULT | SHAPES.get(shape, {})
    x = random_duties(p["ROWS"], p["COLS"], seed=5)
    slots = p["ROWS"] + 2
    result = read(simulator, x, SHAPES.get(shape, {}) | {"SYNC_LATCH": sync_latch}, slots=slots)
    e0 = 6  # ReaderBench.reset makes six edges
    slot = p["settle"] + p["gate"]
    wanted = [[0, 0, 1]]
    for s in range(slots):
        row, start = 1 << s % p["ROWS"], e0 + s * slot
        wanted += [[start, 0, 1]] if s else []
        wanted += [[start + p["BREAK_CLOCKS"], row, 1], [start + p["settle"], row, 0]]
    delay = 2 if sync_latch else 3
    edges = [e0 + (s + 1) * slot + delay for s in range(slots)]
    assert [s["edge"] for s in result["slots"]] == edges
    assert [w for w in result["switches"] if w[0] < edges[-1] - delay] == wanted
    assert result["frame_starts"][:2] == [e0, e0 + p["ROWS"] * slot]


@SYNCHRONIZERS
def test_every_sample_of_the_gate_counts_and_no_other(simulator: str, sync_latch: int) -> None:
    """Preset charges that put the single one of a gate at its first and at its last sample, and one sample too late."""
    p = SMALL | {"gate": 30, "settle": 3, "SYNC_LATCH": sync_latch}
    # With x = 1/1000 the only one comes at sample n when the preset is -n/1000.
    preset = [(-1, 1000), (-30, 1000), (-31, 1000), (0, 1), (-15, 1000)]
    x = [[(1, 1000)] * 5] * 3
    gates = [ones(x[0][0], 30, w) for w in preset]
    assert [gate.index(1) if any(gate) else None for gate in gates] == [0, 29, None, 0, 14]
    result = read(simulator, x, p, slots=3, w_preset=preset)
    assert counts(result) == [[1, 1, 0, 1, 1]] * 3


@pytest.mark.long
@SYNCHRONIZERS
@pytest.mark.parametrize("rate", [0, 1111, 0x4000, 0x5555, 0x8000, 0xFFFF])
def test_a_self_test_injects_the_same_pulses_everywhere(simulator: str, sync_latch: int, rate: int) -> None:
    """Level of sample n: the carry of add n - 1; a synchronizer takes every second of consecutive ones at most.

    59 times 1111 is just above 2^16: without its last bit there is no pulse.
    """
    p = SMALL | {"gate": 60, "settle": 10, "SYNC_LATCH": sync_latch}
    settings = {"continuous_i": 0, "test_rate_i": rate}
    x = random_duties(3, 5, seed=7)
    result = read(simulator, x, p, slots=7, settings=settings, changes=[[0, {"test_i": 1}]])
    total = q = 0
    for n in range(1, 61):
        level = n > 1 and (n - 1) * rate // 2**16 > (n - 2) * rate // 2**16
        q = int(level and not q)
        total += q
    assert [s["slot"] for s in result["slots"]] == [INJECT, DARK, FULL_EVEN, FULL_ODD, 0, 1, 2]
    assert all(s["test_frame"] and s["dark_frame"] for s in result["slots"])
    half = 30  # full scale is x = 1/2
    wanted = [[total] * 5, [0] * 5, [half, 0] * 2 + [half], [0, half] * 2 + [0], *expected(x, DEFAULT | p)]
    assert counts(result) == wanted
    assert {s["test_count"] for s in result["slots"]} == {total}
    assert not result["scanning"]


def test_settings_change_with_the_next_frame_and_not_within_one(simulator: str) -> None:
    p = SMALL | {"gate": 40, "settle": 20}
    x: list[list[Duty]] = [[(1, 3 * r + c + 4) for c in range(5)] for r in range(3)]
    changed = {"gate_i": 50, "settle_i": 9, "row_mask_i": 0b101, "range_i": 0b1001, "dark_i": 1}
    result = read(simulator, x, p, slots=9, changes=[[1, changed]])
    slots = result["slots"]
    assert [s["slot"] for s in slots] == [0, 1, 2, DARK, 0, 2, DARK, 0, 2]
    assert [s["gate_clocks"] for s in slots] == [40] * 3 + [50] * 6
    assert [s["range"] for s in slots][:2] == [0, 0]
    assert [s["range"] for s in slots][3:] == [0b1001] * 6
    assert counts(result)[:3] == [[count(d, 40, 9) for d in row] for row in x]
    assert counts(result)[3:6] == [[0] * 5, *([count(d, 50, 9) for d in x[r]] for r in (0, 2))]
    edges = [s["edge"] for s in slots]
    assert [b - a for a, b in pairwise(edges)] == [60, 60, *[59] * 6]


@SYNCHRONIZERS
def test_power_up_and_reset_leave_no_row_driven_and_preset_on(simulator: str, sync_latch: int) -> None:
    p = SMALL | {"SYNC_LATCH": sync_latch}
    settings = {"gate_i": 40, "settle_i": 3, "range_i": 0x3FF}
    played = {"x": [[SHORT] * 5] * 3, "into_slot": 7, "settings": settings}
    seen = simulate(simulator, "bench_reader", "dermis_reader", "power_up", p, played)
    assert len(seen) == 15
    for what, *outputs in seen:
        assert outputs == ["000", "1", "00000", "00000", "0", "0" * 10, "000"], what


def test_a_gate_that_waits_for_packing_is_the_one_that_a_plan_is_refused_for(tmp_path: Path) -> None:
    """`hdl.gate_min` and dermis_reader say from which gate on a row is packed in time, at every size."""
    sizes = [(cols, bits) for cols in (1, 2, 7, 8, 9, 16, 64, 127, 128) for bits in (1, 8, 9, 16)]
    lines = ["module sizes;"]
    for n, (cols, bits) in enumerate(sizes):
        lines.append(f"dermis_reader #(.COLS({cols}), .CODE_BITS({bits})) r{n} ();")
        lines.append(f'initial $display("%0d", r{n}.PACK_CLOCKS);')
    top, out = tmp_path / "sizes.v", tmp_path / "sizes.vvp"
    top.write_text("\n".join([*lines, "initial $finish;", "endmodule", ""]))
    command = ["iverilog", "-g2005", "-s", "sizes", "-o", str(out), *(f"-I{d}" for d in rtl_include_dirs())]
    subprocess.run([*command, *map(str, rtl_sources()), str(top)], check=True, timeout=60)
    said = subprocess.check_output(["vvp", "-n", str(out)], timeout=60, text=True)
    wanted = [gate_min(cols, bits) for cols, bits in sizes]
    assert [int(line) for line in said.split()] == wanted
