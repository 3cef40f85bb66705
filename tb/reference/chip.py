# SPDX-License-Identifier: Apache-2.0
"""The chip in plain Python: charge balance in integers, the synchronizer, SPI and registers bit by
bit.

Written from the paper, docs/spi.md and the register map, without looking at the RTL. A duty x is a
pair of integers (p, q) for p/q packets a clock. The converter is ``q[n] = (w >= 0) and not q[n-1];
w += x - q[n]``, preset to w = -1/2 at t0, so that w at t1 is -1/2 + x.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import lcm
from typing import Any

from dermis.chip.register_map import REGISTERS
from dermis.chip.spi_protocol import (
    OP_FRAME,
    OP_READ,
    OP_WRITE,
    TOKEN_ACCESS,
    TOKEN_CRC,
    TOKEN_DATA,
    TOKEN_DONE,
    TOKEN_OPCODE,
    WAIT,
    crc8,
)

Duty = tuple[int, int]

# A short circuit has no finite duty; a million packets a clock saturates any gate in use.
SHORT: Duty = (10**6, 1)


class Synchronizer:
    """The two flip-flops of a column: a decision gates the charge packet one clock later, never
    twice in a row.

    Attributes
    ----------
    bit, charge : bool, or array of bool, one a column
        Outputs of the first and the second flip-flop.
    """

    def __init__(self, bit: Any = False) -> None:
        self.bit = self.charge = bit

    def clock(self, comparator: Any) -> Any:
        """Apply a rising clock edge and return the new decision."""
        self.bit, self.charge = comparator > self.bit, self.bit  # a > b of booleans: a and not b
        return self.bit


def ones(x: Duty, gate_clocks: int, w_preset: Duty = (-1, 2)) -> list[int]:
    """Decisions of one gate, one a clock, by the recursion itself.

    Parameters
    ----------
    x : (int, int)
        Duty p/q, in packets a clock.
    gate_clocks : int
        Number of samples.
    w_preset : (int, int)
        Stored charge at t0, in packets.
    """
    packet = lcm(x[1], w_preset[1])
    step = x[0] * (packet // x[1])
    w = w_preset[0] * (packet // w_preset[1]) + step
    decisions: list[int] = []
    flops = Synchronizer()
    for _ in range(gate_clocks):
        decisions.append(int(flops.clock(w >= 0)))
        w += step - decisions[-1] * packet
    return decisions


def count(x: Duty, gate_clocks: int, count_bits: int, w_preset: Duty = (-1, 2)) -> int:
    """Counter of one taxel: the ones of the gate, saturated at its width."""
    return min(2**count_bits - 1, sum(ones(x, gate_clocks, w_preset)))


def code(x: Duty, gate_clocks: int, code_bits: int, w_preset: Duty = (-1, 2)) -> int:
    """Code of one taxel: the ones of the gate, saturated at full scale."""
    return count(x, gate_clocks, code_bits, w_preset)


def duty_of_resistance(r_ohm: Duty) -> Duty:
    """Duty of a taxel in the paper's design: V_b / (k i0) is 250 ohm, so x = 250 / R."""
    return (250 * r_ohm[1], r_ohm[0])


FULL_SCALE: Duty = (1, 2)


class AnalogColumns:
    """Ideal integrators and comparators of all columns, advanced half a clock at a time in
    integers.

    Half clocks, because the flip-flop + latch form moves its charge edge at the falling clock edge.

    Parameters
    ----------
    x : [rows][cols] of (int, int)
        Duty of each taxel.
    w_preset : [cols] of (int, int), optional
        Stored charge the preset forces, in packets; -1/2 by default.
    open_columns : columns whose currents do not arrive
    shorted_columns : pairs of columns that share their currents equally
    """

    def __init__(
        self,
        x: Sequence[Sequence[Duty]],
        w_preset: Sequence[Duty] | None = None,
        open_columns: Sequence[int] = (),
        shorted_columns: Sequence[tuple[int, int]] = (),
    ) -> None:
        cols = len(x[0])
        preset = list(w_preset) if w_preset is not None else [(-1, 2)] * cols
        self.half_packet: list[int] = []
        self.preset: list[int] = []
        self.half_step: list[list[int]] = [[0] * cols for _ in x]
        self.half_full: list[int] = []
        # A factor of two for half clocks, and one for currents that halve where columns are
        # shorted.
        units = [4 * lcm(FULL_SCALE[1], preset[c][1], *(row[c][1] for row in x)) for c in range(cols)]
        for a, b in shorted_columns:
            units[a] = units[b] = lcm(units[a], units[b])
        for c, packet in enumerate(units):
            self.half_packet.append(packet // 2)
            self.preset.append(preset[c][0] * (packet // preset[c][1]))
            self.half_full.append(FULL_SCALE[0] * (packet // 2 // FULL_SCALE[1]))
            for r, row in enumerate(x):
                self.half_step[r][c] = row[c][0] * (packet // 2 // row[c][1])
        self.open_columns = list(open_columns)
        self.shorted_columns = list(shorted_columns)
        self.w = list(self.preset)

    def half_clock(self, row_select: int, preset: int, charge: int, test_current: int = 0) -> None:
        """Advance half a clock with the switches as given (bit vectors); several rows driven add
        their currents.
        """
        if preset:
            self.w = list(self.preset)
            return
        step = [full if test_current >> c & 1 else 0 for c, full in enumerate(self.half_full)]
        while row_select:
            r = row_select.bit_length() - 1
            row_select ^= 1 << r
            step = [a + b for a, b in zip(step, self.half_step[r], strict=True)]
        for a, b in self.shorted_columns:
            step[a] = step[b] = (step[a] + step[b]) // 2
        for c in self.open_columns:
            step[c] = 0
        self.w = [
            w + i - (h if charge >> c & 1 else 0)
            for c, (w, i, h) in enumerate(zip(self.w, step, self.half_packet, strict=True))
        ]

    def comparators(self) -> int:
        """Comparator levels as a bit vector, column 0 in bit 0."""
        return sum((w >= 0) << c for c, w in enumerate(self.w))


# ---- SPI and registers

ROWS, COLS, CODE_BITS = 16, 16, 8
FRAME = bytes(n ^ 0xC3 for n in range(5))
ALL = 0xFFFF
# Constants that register_chip.v wires to the read-only registers.
AT_REST = {
    "STATUS": 0b0101,
    "FRAME_NUMBER": 0x1234,
    "LOST": 0x0567,
    "TEST_COUNT": 0x0089,
    "ROW_FAULT": ALL,
    "DARK_FAULT": ALL,
}


class Chip:
    """SPI, register port and registers: `cs`, `bit` and `reset` are pins, `errors` and `pulses`
    counters.

    It holds where SCK is slower than the clock: then every answer has one wait byte, and no request
    is still crossing when the next command has come.
    """

    def __init__(self) -> None:
        self.cs_low = False
        self.reset()

    def reset(self) -> None:
        """Power up; the rest of an interrupted transaction is ignored."""
        self.errors = self.pulses = 0
        self.values: dict[int, int] = {}
        self._masks: dict[int, tuple[str, int]] = {}
        for name, register in REGISTERS.items():
            for n, exists in enumerate(register.words(ROWS, COLS, CODE_BITS)):
                self.values[register.address + n] = AT_REST.get(name, register.reset) & exists
                self._masks[register.address + n] = name, exists
        self._begun = False
        self._rest()

    def _rest(self) -> None:
        self._got: list[int] = []
        self._out = self._in = self._count = self._shown = 0
        self._over = self._refusing = False
        self._answer: deque[int] = deque()

    def cs(self, low: bool) -> None:
        """Set CS; a rising CS ends the transaction at any bit."""
        if low and not self.cs_low:
            self._begun = True
        self.cs_low = low
        if not low:
            self._rest()

    def bit(self, value: int) -> int:
        """Apply one period of SCK and return the bit that came back."""
        if not self.cs_low:
            return 0
        got = self._shown
        self._in = (self._in << 1 | value) & 0xFF
        self._out = self._out << 1 & 0xFF
        self._count += 1
        if self._count == 8:
            self._count = 0
            self._out = self._byte(self._in)
        self._shown = self._out >> 7
        return got

    def byte(self, value: int) -> int:
        """Send eight bits, the highest first, and return the byte that came back."""
        return sum(self.bit(value >> n & 1) << n for n in range(7, -1, -1))

    def _byte(self, value: int) -> int:
        """Take a whole byte and return the next one to send."""
        if not self._begun or self._over:
            return self._next()
        self._got.append(value)
        if self._got[0] == OP_WRITE:
            if len(self._got) == 5:
                return self._written()
        elif self._got[0] == OP_READ:
            if len(self._got) == 2:
                self._read(value)
        elif self._got[0] == OP_FRAME:
            self._over = True
            self._answer.extend((TOKEN_DATA, *len(FRAME).to_bytes(2, "big"), *FRAME))
        else:
            self._over = True
            return self._refused(TOKEN_OPCODE)
        return WAIT

    def _next(self) -> int:
        if self._refusing:
            self._refusing = False
            return self._refused(TOKEN_ACCESS)
        return self._answer.popleft() if self._answer else 0

    def _refused(self, token: int) -> int:
        """Count a refusal when its token is loaded: a transaction cut before is not counted."""
        self.errors = min(self.errors + 1, ALL)
        self.values[REGISTERS["SPI_ERRORS"].address] = self.errors
        return token

    def _written(self) -> int:
        self._over = True
        if crc8(self._got[:4]) != self._got[4]:
            return self._refused(TOKEN_CRC)
        address, value = self._got[1], self._got[2] << 8 | self._got[3]
        name, exists = self._masks.get(address, ("", 0))
        if not name or not REGISTERS[name].writable:
            self._refusing = True
            return WAIT
        self.values[address] = value & REGISTERS[name].writable & exists
        self.pulses = (self.pulses + (value & REGISTERS[name].pulse).bit_count()) & ALL
        self._answer.append(TOKEN_DONE)
        return WAIT

    def _read(self, address: int) -> None:
        self._over = True
        name, _ = self._masks.get(address, ("", 0))
        if not name:
            self._refusing = True
            return
        word = self.values[address] & REGISTERS[name].readable
        body = word.to_bytes(2, "big")
        self._answer.extend((TOKEN_DATA, *body, crc8((OP_READ, address, *body))))


# Commands of a stream, as register_chip_main.cpp takes them.
BYTE, BITS, LOW, HIGH, RESET = range(5)


def answer(stream: bytes) -> bytes:
    """Answer of register_chip to a stream: a byte for each whole byte, then errors and pulses."""
    chip, out, at = Chip(), bytearray(), 0
    while at < len(stream):
        command, left = stream[at], len(stream) - at
        if command == BYTE and left > 1:
            out.append(chip.byte(stream[at + 1]))
            at += 1
        elif command == BITS and left > 2:
            for n in range(stream[at + 1] % 8):
                chip.bit(stream[at + 2] >> (7 - n) & 1)
            at += 2
        elif command == LOW:
            chip.cs(True)
        elif command == RESET:
            chip.reset()
        else:
            chip.cs(False)
        at += 1
    return bytes(out) + chip.errors.to_bytes(2, "big") + chip.pulses.to_bytes(2, "big")
