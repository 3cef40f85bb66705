# SPDX-License-Identifier: Apache-2.0
"""Frames as a host receives them: checked against the request, and turned into codes."""

import numpy as np
from numpy.typing import NDArray

from dermis.chip import spi_protocol
from dermis.errors import SimulatorError
from dermis.timing import Timing


def codes_of_frame(
    data: bytes, frame: int, timing: Timing, cols: int, rows: range | None = None
) -> NDArray[np.uint16]:
    """Return the codes [rows, cols] of frame number `frame` after a reset, from 0.

    `rows` are the rows that are not masked; all by default. SimulatorError if the frame is damaged, is
    another one, or has not each of these rows once with nothing subtracted.
    """
    try:
        got = spi_protocol.parse_frame(data, sure=True)
    except spi_protocol.FrameError as error:
        raise SimulatorError(str(error)) from None
    bits = timing.code_max.bit_length()
    wanted = {
        "number": (frame + 1) & 0xFFFF,
        "cols": cols,
        "code_bits": bits,
        "gate_clocks": timing.gate_clocks,
        "slots": tuple(range(timing.rows) if rows is None else rows),
        "pedestal_mode": 0,
        **dict.fromkeys(("test", "dark", "fault"), False),
    }
    for name, value in wanted.items():
        if (found := getattr(got, name)) != value:
            raise SimulatorError(f"the chip handed over {name} {found} in place of {value}")
    return got.codes
