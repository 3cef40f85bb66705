# SPDX-License-Identifier: Apache-2.0
"""Frames as received: many at once are read as one by one, and nothing that one would refuse gets through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dermis.chip import read_out, spi_protocol
from dermis.errors import SimulatorError
from dermis.records import Timing


def timing(rows: int, bits: int) -> Timing:
    """Timing of the design with another number of rows and bits."""
    gate = 2 * (2**bits - 1)
    return Timing(5e6, gate + 115, 115, gate, 2**bits - 1, rows, break_clocks=1)


def frame(t: Timing, cols: int, number: int, rng: np.random.Generator) -> spi_protocol.Frame:
    """A frame that a chip may send."""
    codes = rng.integers(0, t.code_max, (t.rows, cols), dtype=np.uint16, endpoint=True)
    overflow = (codes == t.code_max) & (rng.random(codes.shape) < 0.5)
    bits = t.code_max.bit_length()
    return spi_protocol.Frame(number, cols, bits, t.gate_clocks, tuple(range(t.rows)), codes, overflow)


def table(frames: list[spi_protocol.Frame]) -> np.ndarray:
    """Bytes of frames, [frames, bytes]."""
    return np.array([list(spi_protocol.pack_frame(f)) for f in frames], dtype=np.uint8)


@pytest.mark.parametrize("bits", [1, 7, 8, 9, 12])
@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (2, 9), (5, 16)])
def test_many_at_once_are_read_as_one_by_one(bits: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(bits)
    t, cols = timing(shape[0], bits), shape[1]
    data = table([frame(t, cols, 1 + i, rng) for i in range(6)])
    one_by_one = [read_out.codes_of_frame(bytes(row), i, t, cols) for i, row in enumerate(data)]
    assert data.shape[1] == read_out.frame_bytes(t, cols)
    assert np.array_equal(read_out.codes_of_frames(data, t, cols), one_by_one)


def test_numbers_go_on_from_65535_with_0() -> None:
    t, rng = timing(1, 8), np.random.default_rng(1)
    one = table([frame(t, 1, 1, rng)])
    data = np.repeat(one, 65537, axis=0)
    data[:, 2:4] = [divmod((i + 1) & 0xFFFF, 256) for i in range(len(data))]
    crc = [spi_protocol.crc16(bytes(row[:-2])) for row in data]
    data[:, -2:] = [divmod(c, 256) for c in crc]
    got = read_out.codes_of_frames(data, t, 1)
    assert got is not None
    assert read_out.codes_of_frame(bytes(data[65535]), 65535, t, 1) == got[65535]


def test_any_wrong_bit_is_refused_by_both() -> None:
    t, rng = timing(2, 8), np.random.default_rng(2)
    data = table([frame(t, 3, 1 + i, rng) for i in range(2)])
    for bit in range(8 * data.shape[1]):
        wrong = data.copy()
        wrong[1, bit // 8] ^= 1 << bit % 8
        assert read_out.codes_of_frames(wrong, t, 3) is None
        with pytest.raises(SimulatorError, match="CRC"):
            read_out.codes_of_frame(bytes(wrong[1]), 1, t, 3)


OTHERS = {
    "number": 3,
    "gate_clocks": 509,
    "slots": (1, 0),
    "test": True,
    "pedestal_mode": 1,
    "dark": True,
    "fault": True,
}


@pytest.mark.parametrize("field", OTHERS)
def test_a_whole_frame_that_was_not_asked_for_is_refused_by_both(field: str) -> None:
    """The CRC is right: another frame, another setting, or a chip that found a fault."""
    t, rng = timing(2, 8), np.random.default_rng(3)
    good = [frame(t, 3, 1 + i, rng) for i in range(2)]
    wrong = replace(good[1], **{field: OTHERS[field]})
    assert read_out.codes_of_frames(table([good[0], wrong]), t, 3) is None
    with pytest.raises(SimulatorError, match=f"the chip handed over {field} "):
        read_out.codes_of_frame(spi_protocol.pack_frame(wrong), 1, t, 3)


def test_bits_beyond_columns_and_codes_are_refused_by_both() -> None:
    t, rng = timing(2, 7), np.random.default_rng(4)
    data = table([frame(t, 3, 1, rng)])
    for place, bit in ((9, 7), (12, 3), (12, 7)):  # a code of 7 bits; overflow bits of columns 3 and 7
        wrong = data.copy()
        wrong[0, place] |= 1 << bit
        wrong[0, -2:] = divmod(spi_protocol.crc16(bytes(wrong[0, :-2])), 256)
        assert read_out.codes_of_frames(wrong, t, 3) is None
        with pytest.raises(SimulatorError, match="bits beyond"):
            read_out.codes_of_frame(bytes(wrong[0]), 0, t, 3)


def test_frames_of_another_size_are_refused() -> None:
    t, rng = timing(2, 8), np.random.default_rng(5)
    assert read_out.codes_of_frames(table([frame(t, 4, 1, rng)]), t, 3) is None
