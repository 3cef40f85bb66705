# SPDX-License-Identifier: Apache-2.0
"""The register map. Generated from rtl/dermis_registers.rdl; change it there and run: dermis generate."""

from typing import NamedTuple

ID = 0x00
GEOMETRY = 0x01
FORMAT = 0x02
CONTROL = 0x03
SETTLE = 0x04
GATE = 0x05
RANGE = 0x06
STATUS = 0x07
FRAME_NUMBER = 0x08
LOST = 0x09
SPI_ERRORS = 0x0A
TEST_RATE = 0x0B
TEST_COUNT = 0x0C
DARK_MAX = 0x0D
FULL_MIN = 0x0E
ROW_MASK = 0x20
ROW_FAULT = 0x28
INJECT_FAULT = 0x30
DARK_FAULT = 0x38
FULL_FAULT = 0x40
RANGE_COLUMN = 0x50
PEDESTAL = 0x80
GEOMETRY_COLS_MASK, GEOMETRY_COLS_SHIFT = 0x00FF, 0
GEOMETRY_ROWS_MASK, GEOMETRY_ROWS_SHIFT = 0xFF00, 8
FORMAT_CODE_BITS_MASK, FORMAT_CODE_BITS_SHIFT = 0x001F, 0
FORMAT_SYNC_LATCH_MASK, FORMAT_SYNC_LATCH_SHIFT = 0x0100, 8
FORMAT_BREAK_CLOCKS_MASK, FORMAT_BREAK_CLOCKS_SHIFT = 0xFE00, 9
CONTROL_CONTINUOUS_MASK, CONTROL_CONTINUOUS_SHIFT = 0x0001, 0
CONTROL_SHOT_MASK, CONTROL_SHOT_SHIFT = 0x0002, 1
CONTROL_TEST_MASK, CONTROL_TEST_SHIFT = 0x0004, 2
CONTROL_DARK_MASK, CONTROL_DARK_SHIFT = 0x0008, 3
CONTROL_PEDESTAL_MODE_MASK, CONTROL_PEDESTAL_MODE_SHIFT = 0x0030, 4
CONTROL_RANGE_PER_COLUMN_MASK, CONTROL_RANGE_PER_COLUMN_SHIFT = 0x0040, 6
CONTROL_HOLD_MASK, CONTROL_HOLD_SHIFT = 0x0080, 7
RANGE_RANGE_MASK, RANGE_RANGE_SHIFT = 0x0003, 0
STATUS_SCANNING_MASK, STATUS_SCANNING_SHIFT = 0x0001, 0
STATUS_FRAME_READY_MASK, STATUS_FRAME_READY_SHIFT = 0x0002, 1
STATUS_TEST_DONE_MASK, STATUS_TEST_DONE_SHIFT = 0x0004, 2
STATUS_FAULT_MASK, STATUS_FAULT_SHIFT = 0x0008, 3
STATUS_TEST_CUT_MASK, STATUS_TEST_CUT_SHIFT = 0x0010, 4
STATUS_UNDERFLOW_MASK, STATUS_UNDERFLOW_SHIFT = 0x0020, 5


class Register(NamedTuple):
    """A register, or a list of lanes over several words; masks and reset are those of a full word.

    `lanes` is what there is one lane of (a row, a column, nothing), `lane_bits` the width, 0 for CODE_BITS.
    `readable` bits can be other than 0, `writable` ones stay as written, `pulse` ones act and read 0.
    """

    address: int
    lanes: str
    lane_bits: int
    reset: int
    readable: int
    writable: int
    pulse: int

    def words(self, rows: int, cols: int, code_bits: int) -> list[int]:
        """Bits that exist in each word of a chip of this size."""
        if not self.lanes:
            return [0xFFFF]
        bits = self.lane_bits or code_bits
        per_word = 16 // self.lane_bits if self.lane_bits else 1
        lanes = rows if self.lanes == "rows" else cols
        return [(1 << bits * min(lanes - first, per_word)) - 1 for first in range(0, lanes, per_word)]


REGISTERS: dict[str, Register] = {
    "ID": Register(0x00, "", 0, 0xDE01, 0xFFFF, 0x0000, 0x0000),
    "GEOMETRY": Register(0x01, "", 0, 0x1010, 0xFFFF, 0x0000, 0x0000),
    "FORMAT": Register(0x02, "", 0, 0x0208, 0xFF1F, 0x0000, 0x0000),
    "CONTROL": Register(0x03, "", 0, 0x0001, 0x00F9, 0x00F9, 0x0006),
    "SETTLE": Register(0x04, "", 0, 0x0073, 0xFFFF, 0xFFFF, 0x0000),
    "GATE": Register(0x05, "", 0, 0x01FE, 0xFFFF, 0xFFFF, 0x0000),
    "RANGE": Register(0x06, "", 0, 0x0002, 0x0003, 0x0003, 0x0000),
    "STATUS": Register(0x07, "", 0, 0x0000, 0x003F, 0x0000, 0x0000),
    "FRAME_NUMBER": Register(0x08, "", 0, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "LOST": Register(0x09, "", 0, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "SPI_ERRORS": Register(0x0A, "", 0, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "TEST_RATE": Register(0x0B, "", 0, 0x4000, 0xFFFF, 0xFFFF, 0x0000),
    "TEST_COUNT": Register(0x0C, "", 0, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "DARK_MAX": Register(0x0D, "", 0, 0x0008, 0xFFFF, 0xFFFF, 0x0000),
    "FULL_MIN": Register(0x0E, "", 0, 0x00B7, 0xFFFF, 0xFFFF, 0x0000),
    "ROW_MASK": Register(0x20, "rows", 1, 0xFFFF, 0xFFFF, 0xFFFF, 0x0000),
    "ROW_FAULT": Register(0x28, "rows", 1, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "INJECT_FAULT": Register(0x30, "cols", 1, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "DARK_FAULT": Register(0x38, "cols", 1, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "FULL_FAULT": Register(0x40, "cols", 1, 0x0000, 0xFFFF, 0x0000, 0x0000),
    "RANGE_COLUMN": Register(0x50, "cols", 2, 0xAAAA, 0xFFFF, 0xFFFF, 0x0000),
    "PEDESTAL": Register(0x80, "cols", 0, 0x0000, 0xFFFF, 0xFFFF, 0x0000),
}
