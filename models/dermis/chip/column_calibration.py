# SPDX-License-Identifier: Apache-2.0
"""Calibration of every column over SPI: self-test frames in, gain, offset and a verdict per column out.

A self-test frame has a dark slot (no row driven, the pedestal alone) and two slots with the test
current in the even and the odd columns. One code resolves half an LSB. A gate 16 times as long
resolves the dark duty 16 times better; a full-scale count would not fit there, so its duty is the
intersection of what 16 gates next to each other allow. docs/howto_calibrate.md has the same steps
for firmware.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dermis.chip import register_map as rm
from dermis.chip import spi_protocol as spi
from dermis.errors import SimulatorError
from dermis.ndarrays import Bools, Floats
from dermis.scene.design import Design

DARK_GATES = 16
"""The dark slot is counted over this many normal gates: 1/32 LSB."""
FULL_GATES = 16
"""Gates for the test current: an error of at most 0.12 LSB at duties of 0.41 to 0.48."""
# 2 % of mismatch and 10 % of the test resistor's sheet, 2.5 sigma from chip to chip.
GAIN_LIMIT = 0.12
"""Largest gain error of a good column, relative."""
FULL_PART = 0.8
"""Part of the nominal count of the test current below which a column is faulty: 8 sigma."""
POLLS = 10_000
"""Reads of STATUS after which a self-test frame is overdue; each takes at least a clock."""

Steps = Generator[spi.Transaction[Any], Any, spi.Result]
"""Yields SPI transactions; the result of each is sent back into it."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Calibration of the columns of a chip.

    Attributes
    ----------
    dark, full : [cols], duty in packets a clock without current and with the test current
    verdict : [cols], "ok", or the first test that failed: "inject", "dark", "full" (masks of the chip), "pedestal" (no
        count without current: offsets below it are lost), "gain"
    gate_clocks : gate of the codes that `step_a` and `start_code` are for
    i_test_a : test current in ampere
    """

    dark: Floats
    full: Floats
    verdict: tuple[str, ...]
    gate_clocks: int
    i_test_a: float

    @property
    def step_a(self) -> Floats:
        """Column current of one code in ampere, [cols]; inf if the test current gives code 0."""
        with np.errstate(divide="ignore"):
            return self.i_test_a / (self.gate_clocks * np.maximum(self.full - self.dark, 0.0))

    @property
    def start_code(self) -> Floats:
        """Code without current, [cols]; fields as in dermis.decode.calibration.Calibration."""
        return self.gate_clocks * self.dark


def measure(design: Design, cols: int) -> Steps[Columns]:
    """Measure all columns; yields transactions, takes their results, returns the calibration.

    The chip is left scanning with the normal gate. Raises SimulatorError if a self-test frame does
    not come.
    """
    gate, made = design.timing.gate_clocks, design.calibration
    full_a = design.interface.k * design.converter.i0_a
    nominal, pedestal = made.i_test_a / full_a, made.i_pedestal_a / full_a
    long = DARK_GATES * gate
    yield spi.write_register(rm.CONTROL, 0)
    yield spi.write_register(rm.DARK_MAX, round(2 * gate * pedestal))
    yield spi.write_register(rm.FULL_MIN, int(FULL_PART * gate * nominal))
    frame = yield from _test_frame(long)
    counts = frame.slot(spi.SLOT_DARK).astype(float)
    dark = counts / long
    found = []
    for gate_clocks in full_gates(gate):
        frame = yield from _test_frame(gate_clocks)
        even = np.arange(cols) % 2 == 0
        found.append(np.where(even, frame.slot(spi.SLOT_FULL_EVEN), frame.slot(spi.SLOT_FULL_ODD)))
    failed = {}
    for name, first in (("inject", rm.INJECT_FAULT), ("dark", rm.DARK_FAULT), ("full", rm.FULL_FAULT)):
        failed[name] = yield from _mask(first, cols)
    full = duty(np.array(found, dtype=float), full_gates(gate))
    failed["pedestal"] = counts == 0
    failed["gain"] = np.abs((full - dark) / nominal - 1.0) > GAIN_LIMIT
    verdict = tuple(next((n for n, bad in failed.items() if bad[c]), "ok") for c in range(cols))
    yield spi.write_register(rm.CONTROL, rm.CONTROL_CONTINUOUS_MASK)
    return Columns(dark, full, verdict, gate, made.i_test_a)


def full_gates(gate: int) -> range:
    """Return the gates in which the test current is counted, in clocks."""
    return range(gate - FULL_GATES + 1, gate + 1)


def duty(counts: Floats, gates: Sequence[int]) -> Floats:
    """Return the middle of the duties that all counts [gate, col] allow, [col], 0..1."""
    clocks = np.array(gates)[:, None]
    # The preset rounds: count c says c - 1/2 <= gate x < c + 1/2.
    low, high = np.max((counts - 0.5) / clocks, axis=0), np.min((counts + 0.5) / clocks, axis=0)
    return 0.5 * (np.maximum(low, 0.0) + np.minimum(high, 1.0))


def _test_frame(gate_clocks: int) -> Steps[spi.Frame]:
    yield spi.write_register(rm.GATE, gate_clocks)
    yield spi.write_register(rm.CONTROL, rm.CONTROL_TEST_MASK)
    for _ in range(POLLS):
        status = yield spi.read_register(rm.STATUS)
        if status & rm.STATUS_TEST_DONE_MASK:
            return (yield spi.read_frame())
        if status & rm.STATUS_TEST_CUT_MASK:
            said = "the enable pin went low during a self-test frame, or was low before"
            raise SimulatorError(f"calibration: {said}")
    said = f"no self-test frame after {POLLS} reads of STATUS; is the enable pin high?"
    raise SimulatorError(f"calibration: {said}")


def _mask(first: int, cols: int) -> Steps[Bools]:
    bits: list[bool] = []
    for word in range((cols + 15) // 16):
        value = yield spi.read_register(first + word)
        bits += [bool(value >> n & 1) for n in range(16)]
    return np.array(bits[:cols])
