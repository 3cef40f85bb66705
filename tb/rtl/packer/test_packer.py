# SPDX-License-Identifier: Apache-2.0
"""Claims about dermis_packer: the bytes of frames against a reference written from docs/rtl.md alone."""

import random
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
from rtl_run import changed, simulate

from dermis.chip import spi_protocol as spi

pytestmark = pytest.mark.timeout(120)

DARK, FULL_EVEN = 0xF1, 0xF2
SIZES = [(9, 8), (1, 1), (128, 16), (5, 10)]

Row = dict[str, Any]


def pack(rows: list[Row], cols: int, code_bits: int) -> tuple[list[list[int]], list[int]]:
    """Return the bytes of each frame, and for each frame 1 if a count of a row is below its pedestal."""
    frames: list[list[int]] = []
    below: list[int] = []
    data: list[int] = []
    full = 2**code_bits - 1
    dark = [0] * cols
    mode = number = 0
    for row in rows:
        if row["first_i"]:
            number = (number + 1) % 2**16
            mode = row.get("pedestal_mode_i", 0) % 3
            flags = row.get("fault_i", 0) << 4 | row.get("dark_frame_i", 0) << 3 | mode << 1
            flags |= row.get("test_frame_i", 0)
            gate = row["gate_clocks_i"].to_bytes(2, "big")
            data = [1, flags, *number.to_bytes(2, "big"), cols, code_bits, *gate]
            below.append(0)
        pedestals = [[0] * cols, row.get("pedestals"), dark][mode if row["slot_i"] < 0xF0 else 0]
        net = [n - p for n, p in zip(row["counts"], pedestals, strict=True)]
        below[-1] |= min(net) < 0
        codes = [min(max(n, 0), full) for n in net]
        over = sum((n > full) << c for c, n in enumerate(net))
        data.append(row["slot_i"])
        for code in codes:
            data += code.to_bytes(2 if code_bits > 8 else 1, "big")
        data += over.to_bytes((cols + 7) // 8, "little")
        if row["slot_i"] == DARK:
            dark = codes
        if row["last_i"]:
            frames.append([*data, *spi.crc16(data).to_bytes(2, "big")])
    return frames, below


def random_rows(cols: int, code_bits: int, frames: int, seed: int) -> list[Row]:
    """Frames of one to five slots, dark and test ones among them, with counts and pedestals at and near their ends."""
    rng = random.Random(seed)
    full, most = 2**code_bits - 1, 2 ** (code_bits + 1) - 1

    def count() -> int:
        return rng.choice([0, 1, full - 1, full, full + 1, most, rng.randint(0, most)]) & most

    rows: list[Row] = []
    for _ in range(frames):
        slots = [*([DARK] if rng.random() < 0.5 else []), *([FULL_EVEN] if rng.random() < 0.2 else [])]
        slots += sorted(rng.sample(range(128), rng.randint(0 if slots else 1, 3)))
        common = {
            "test_frame_i": rng.randint(0, 1),
            "dark_frame_i": rng.randint(0, 1),
            "gate_clocks_i": rng.randint(1, 65535),
            "pedestal_mode_i": rng.randint(0, 3),
        }
        for n, slot in enumerate(slots):
            place = {"slot_i": slot, "first_i": int(n == 0), "last_i": int(n == len(slots) - 1)}
            pedestals = [rng.choice([0, 1, full, rng.randint(0, full)]) for _ in range(cols)]
            counts = [count() for _ in range(cols)]
            rows.append(
                {**common, **place, "fault_i": rng.randint(0, 1), "pedestals": pedestals, "counts": counts}
            )
    return rows


def run(simulator: str, rows: list[Row], cols: int, code_bits: int, trap: Path | None = None) -> Any:
    p = {"COLS": cols, "CODE_BITS": code_bits}
    return simulate(simulator, "bench_packer", "dermis_packer", "rows", p, {"rows": rows}, trap=trap)


@pytest.mark.parametrize(("cols", "code_bits"), SIZES)
def test_random_frames_have_the_bytes_of_the_reference(simulator: str, cols: int, code_bits: int) -> None:
    rows = random_rows(cols, code_bits, 40, seed=11)
    result = run(simulator, rows, cols, code_bits)
    wanted, below = pack(rows, cols, code_bits)
    assert len(wanted) == 40
    assert (result["frames"], result["underflows"]) == (wanted, below)
    assert not result["open"]
    # As they are taken, columns are shown raw and in order.
    shown = [[row["slot_i"], c, n, 1] for row in rows for c, n in enumerate(row["counts"])]
    assert result["columns"] == shown
    # One byte a clock, and never longer than dermis_reader reckons with.
    wide = 2 if code_bits > 8 else 1
    body = 1 + cols * wide + (cols + 7) // 8
    assert result["busy"] == [8 * r["first_i"] + body + 2 * r["last_i"] for r in rows]
    assert result["numbers"] == list(accumulate(row["first_i"] for row in rows))


def row_of(slot: int, counts: list[int], first: int, last: int, mode: int = 0) -> Row:
    more = {"gate_clocks_i": 510, "pedestal_mode_i": mode, "pedestals": [4] * 3}
    return {"slot_i": slot, "counts": counts, "first_i": first, "last_i": last, **more}


def test_pedestals_and_a_frame_that_is_cut(simulator: str) -> None:
    """The last dark slot is the pedestal of rows; mode 3 has none; a cut frame never ends, and the next is whole."""
    rows = [
        row_of(DARK, [3, 300, 0], 1, 0, 2),
        row_of(7, [10, 400, 5], 0, 1, 2),
        row_of(9, [2, 256, 5], 1, 0, 2),
        row_of(FULL_EVEN, [9, 9, 9], 0, 1, 2),
        row_of(0, [9, 3, 0], 1, 0, 1),
        row_of(1, [9, 300, 9], 0, 1, 1),
        row_of(2, [1, 2, 3], 1, 0),
        row_of(0, [9, 9, 9], 1, 1, 3),
    ]
    result = run(simulator, rows, 3, 8)
    frames = result["frames"]
    assert [frame[8:-2] for frame in frames] == [
        [DARK, 3, 255, 0, 0b010, 7, 7, 145, 5, 0],
        [9, 0, 1, 5, 0, FULL_EVEN, 9, 9, 9, 0],
        [0, 5, 0, 0, 0, 1, 5, 255, 5, 0b010],
        [0, 9, 9, 9, 0],
    ]
    assert [frame[1] for frame in frames] == [0b100, 0b100, 0b010, 0]
    assert frames[-1][2:4] == [0, 5]
    # Below a pedestal: 2 - 3 in the second frame, 3 - 4 in the third.
    assert result["underflows"] == [0, 1, 1, 0]


# What is wrong -> text of dermis_packer, or of its CRC, and what stands in its place.
SEEDED = {
    "overflow bit at full scale": ("& difference[CODE_BITS];", "& (difference[CODE_BITS] | (&code));"),
    "special slots corrected": ("if (special) ", "if (1'b0) "),
    "mode 3 is mode 2": ("(pedestal_mode_i == 2'd3) ? 2'd0", "(pedestal_mode_i == 2'd3) ? 2'd2"),
    "underflow of the last code": ("under_q <= under_q | under;", "under_q <= under;"),
    "CRC polynomial": ("{3'd0, x, 5'd0}", "{4'd0, x, 4'd0}"),
    "bytes of a code swapped": ("code_wide[7:0] : code_wide[15:8]", "code_wide[15:8] : code_wide[7:0]"),
    "ring kept by special slots": ("(slot_i == DARK) ?", "(special) ?"),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", SEEDED)
def test_the_reference_finds_a_seeded_fault(fault: str, tmp_path: Path) -> None:
    module = "dermis_crc16" if fault == "CRC polynomial" else "dermis_packer"
    wrong = changed(tmp_path, module, SEEDED[fault])
    rows = random_rows(5, 10, 40, seed=11)
    try:
        result = run("icarus", rows, 5, 10, trap=wrong)
    except AssertionError:
        return
    assert (result["frames"], result["underflows"]) != pack(rows, 5, 10)
