# SPDX-License-Identifier: Apache-2.0
"""Frames as received: read as the chip sends them, and anything else is refused."""

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


@pytest.mark.parametrize("bits", [1, 7, 8, 9, 12])
@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (2, 9), (5, 16)])
def test_a_frame_is_read_as_it_was_sent(bits: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(bits)
    t, cols = timing(shape[0], bits), shape[1]
    for i in (0, 5, 65535):  # numbers go on from 65535 with 0
        sent = frame(t, cols, (1 + i) & 0xFFFF, rng)
        data = spi_protocol.pack_frame(sent)
        assert np.array_equal(read_out.codes_of_frame(data, i, t, cols), sent.codes)


def test_any_wrong_bit_is_refused() -> None:
    t, rng = timing(2, 8), np.random.default_rng(2)
    data = spi_protocol.pack_frame(frame(t, 3, 2, rng))
    for bit in range(8 * len(data)):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(SimulatorError, match="CRC"):
            read_out.codes_of_frame(bytes(wrong), 1, t, 3)


OTHERS = {
    "number": 3, "gate_clocks": 509, "slots": (0, 2), "test": True, "pedestal_mode": 1, "dark": True, "fault": True,
}  # fmt: skip


@pytest.mark.parametrize("field", OTHERS)
def test_a_whole_frame_that_was_not_asked_for_is_refused(field: str) -> None:
    """The CRC is right: another frame, another setting, or a chip that found a fault."""
    t, rng = timing(2, 8), np.random.default_rng(3)
    wrong = replace(frame(t, 3, 2, rng), **{field: OTHERS[field]})
    with pytest.raises(SimulatorError, match=f"the chip handed over {field} "):
        read_out.codes_of_frame(spi_protocol.pack_frame(wrong), 1, t, 3)


def test_bits_beyond_columns_and_codes_are_refused() -> None:
    t, rng = timing(2, 7), np.random.default_rng(4)
    data = spi_protocol.pack_frame(frame(t, 3, 1, rng))
    for place, bit in ((9, 7), (12, 3), (12, 7)):  # a code of 7 bits; overflow bits of columns 3 and 7
        wrong = bytearray(data)
        wrong[place] |= 1 << bit
        wrong[-2:] = spi_protocol.crc16(wrong[:-2]).to_bytes(2, "big")
        with pytest.raises(SimulatorError, match="bits beyond"):
            read_out.codes_of_frame(bytes(wrong), 0, t, 3)


def test_frames_of_another_size_are_refused() -> None:
    t, rng = timing(2, 8), np.random.default_rng(5)
    with pytest.raises(SimulatorError, match="the chip handed over cols 4"):
        read_out.codes_of_frame(spi_protocol.pack_frame(frame(t, 4, 1, rng)), 0, t, 3)
