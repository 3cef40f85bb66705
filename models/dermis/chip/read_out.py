# SPDX-License-Identifier: Apache-2.0
"""Frames as a host receives them: checked against the request, and turned into codes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dermis.chip import spi_protocol
from dermis.errors import SimulatorError
from dermis.records import Timing

_CRC16 = np.array([spi_protocol.crc16([byte], 0) for byte in range(256)], dtype=np.uint16)


def frame_bytes(timing: Timing, cols: int, rows: int | None = None) -> int:
    """Bytes of a frame of some number of rows; of all by default."""
    slots = timing.rows if rows is None else rows
    return spi_protocol.frame_bytes(slots, cols, timing.code_max.bit_length())


def codes_of_frame(
    data: bytes, frame: int, timing: Timing, cols: int, rows: range | None = None
) -> NDArray[np.uint16]:
    """Return the codes [rows, cols] of frame number `frame` after a reset, from 0.

    `rows` are the rows that are not masked; all by default.

    Raises
    ------
    SimulatorError
        It is damaged, it is another one, or not one of each of these rows once with nothing subtracted.
    """
    try:
        got = spi_protocol.parse_frame(data)
    except spi_protocol.FrameError as error:
        raise SimulatorError(str(error)) from None
    bits = timing.code_max.bit_length()
    wanted = {
        "number": (frame + 1) & 0xFFFF,
        "cols": cols,
        "code_bits": bits,
        "gate_clocks": timing.gate_clocks,
        "slots": tuple(range(timing.rows) if rows is None else rows),
        "test": False,
        "pedestal_mode": 0,
        "dark": False,
        "fault": False,
    }
    for name, value in wanted.items():
        if (found := getattr(got, name)) != value:
            raise SimulatorError(f"the chip handed over {name} {found} in place of {value}")
    return got.codes


def codes_of_frames(data: NDArray[np.uint8], timing: Timing, cols: int) -> NDArray[np.uint16] | None:
    """Return the codes [frames, rows, cols] of consecutive frames [frames, bytes] after a reset.

    None if anything is not as `codes_of_frame` wants it, which then says what.
    """
    frames, size = data.shape
    if size != frame_bytes(timing, cols):
        return None
    crc = np.full(frames, 0xFFFF, dtype=np.uint16)
    for column in np.ascontiguousarray(data.T):
        crc = (crc << 8) ^ _CRC16[(crc >> 8) ^ column]
    head = np.zeros((frames, spi_protocol.HEADER_BYTES), dtype=np.uint8)
    bits = timing.code_max.bit_length()
    head[:, [0, 4, 5]] = spi_protocol.FORMAT, cols, bits
    head[:, 2:4] = _big_endian(np.arange(1, frames + 1))
    head[:, 6:8] = _big_endian(np.array([timing.gate_clocks]))
    slots = data[:, spi_protocol.HEADER_BYTES : -spi_protocol.CRC_BYTES].reshape(frames, timing.rows, -1)
    wide = 2 if bits > 8 else 1
    end = 1 + cols * wide
    codes = slots[:, :, 1:end].astype(np.uint16)
    if wide == 2:
        codes = codes[:, :, 0::2] << 8 | codes[:, :, 1::2]
    spare = slots[:, :, -1] >> (cols - 1) % 8 + 1  # of the overflow bits, 8 columns a byte
    as_wanted = (
        not crc.any()
        and np.array_equal(data[:, : spi_protocol.HEADER_BYTES], head)
        and (slots[:, :, 0] == np.arange(timing.rows)).all()
        and not spare.any()
        and codes.max(initial=0) <= timing.code_max
    )
    return codes if as_wanted else None


def _big_endian(values: NDArray[np.int64]) -> NDArray[np.uint8]:
    return (values & 0xFFFF).astype(">u2").view(np.uint8).reshape(-1, 2)
