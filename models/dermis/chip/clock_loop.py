# SPDX-License-Identifier: Apache-2.0
"""The clock loop of a co-simulation: clock_loop.c with a Python face.

The loop runs in callbacks of the HDL simulator, without Python for an analog half in C. Its slow
reference in Python is tb/reference/python_loop.py.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip import ngspice
from dermis.chip.analog import AnalogHalf, Edge
from dermis.errors import SimulatorError

_RUNNING, _ENDED, _WRONG = 1, 2, 3  # of `enum state` in clock_loop.c
_SOLVE = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_double,
    ctypes.c_int,
    ctypes.POINTER(ctypes.c_int),
    *[ctypes.POINTER(ctypes.c_double)] * 3,
)


@dataclass(frozen=True)
class Net:
    """A net of the Verilog that drives sources of an analog half.

    Attributes
    ----------
    name : hierarchical name
    source : source that bit 0 drives; further bits drive those after it
    delay_s : time from the rising edge of the clock to the edge of the source, less than a clock
    copy : a net that receives the same value half a clock later, or None
    """

    name: str
    source: int
    delay_s: float = 0.0
    copy: str | None = None


class ClockLoop:
    """Carries nets to an analog half, and its comparators back, clock by clock.

    There is one in a process.

    Parameters
    ----------
    clock : name of the clock; nets change with its rising edge
    output : name of the net whose bit i is high while sample i of the half is above 0
    nets : whatever drives sources
    settle : a latch opens with the falling edge, so the loop looks at the nets one unit of time after it

    Raises
    ------
    SimulatorError
        The Verilog has no such net.
    """

    def __init__(self, clock: str, output: str, nets: Sequence[Net], *, settle: bool = False) -> None:
        self._lib = lib = ngspice.loaded()
        text, number, whole = ctypes.c_char_p, ctypes.c_double, ctypes.c_int
        lib.loop_bind.argtypes = [text, text]
        lib.loop_net.argtypes = [text, whole, number, text]
        lib.loop_arm.argtypes = [ctypes.c_void_p, number, ctypes.c_long, whole, whole, whole]
        lib.loop_text.restype = text
        lib.loop_clocks.restype = ctypes.c_long
        lib.loop_samples.restype = ctypes.POINTER(number)
        lib.loop_trace.restype = ctypes.POINTER(ctypes.c_uint32)
        self._settle = settle
        self._half: Any = None
        self._raised: BaseException | None = None
        lib.loop_stop()
        failed = lib.loop_bind(clock.encode(), output.encode())
        for net in nets:
            copy = None if net.copy is None else net.copy.encode()
            failed = failed or lib.loop_net(net.name.encode(), net.source, net.delay_s, copy)
        if failed:
            raise SimulatorError(self._text())

    def _text(self) -> str:
        return self._lib.loop_text().decode(errors="replace")

    def arm(
        self, half: AnalogHalf, period_s: float, clocks: int, *, samples: int = 0, trace: bool = False
    ) -> None:
        """Begin at a falling edge; the rising edge before it is time 0 of the half.

        Parameters
        ----------
        half : its sources are as the nets are now
        period_s : of the clock
        clocks : after so many the loop ends by itself; the half is solved up to there
        samples : number of samples that are kept each clock (`samples`)
        trace : keep the nets each clock (`trace`)

        Raises
        ------
        SimulatorError
            As `require`.
        """
        self._half, self._raised, self._samples = half, None, samples
        entry = getattr(half, "entry", None)
        if entry is None:  # it is in Python
            self._callback = _SOLVE(self._advance)
            entry = ctypes.cast(self._callback, ctypes.c_void_p).value
        self._lib.loop_arm(entry, period_s, clocks, self._settle, samples, trace)
        self.require()

    def _advance(self, to: float, count: int, source: Any, time: Any, level: Any, sample: Any) -> int:
        """Advance a half that is in Python."""
        edges: list[Edge] = [(time[i], source[i], level[i]) for i in range(count)]
        try:
            for i, value in enumerate(self._half.advance(to, edges)):
                sample[i] = value
        except BaseException as error:  # C hands it on to `require`
            self._raised = error
            return -1
        return 0

    @property
    def clocks(self) -> int:
        """Clocks since the loop was armed."""
        return self._lib.loop_clocks()

    @property
    def ended(self) -> bool:
        """True after the last clock."""
        return self._lib.loop_state() == _ENDED

    def require(self) -> None:
        """Raise the error that ended the loop, if one did.

        Raises
        ------
        SimulatorError
            A net is X or Z; or whatever the half raised.
        """
        state = self._lib.loop_state()
        if state in (_RUNNING, _ENDED):
            return
        if self._raised is not None:
            raise self._raised
        if state == _WRONG:
            raise SimulatorError(self._text())
        self._half.fail(self._lib.loop_code())

    def stop(self) -> None:
        """End the loop where it is."""
        self._lib.loop_stop()

    def samples(self) -> NDArray[np.float64]:
        """Return the samples [clocks + 1, samples] at clocks 0, 1, ..., volt."""
        shape = self.clocks + 1, self._samples
        return np.ctypeslib.as_array(self._lib.loop_samples(), shape).copy()

    def trace(self, bits: Sequence[int]) -> list[list[int]]:
        """Return every net at clocks 1, 2, ..., and the output as it was there.

        `bits` is the number of bits of each net in the order of `nets`, and of the output.
        """
        words = [(n + 31) // 32 for n in bits]
        table = np.ctypeslib.as_array(self._lib.loop_trace(), (self.clocks, sum(words))).astype("<u4")
        parts = np.split(table, np.cumsum(words)[:-1], axis=1)
        return [[int.from_bytes(row.tobytes(), "little") for row in part] for part in parts]


def replay(half: ngspice.NgspiceHalf, period_s: float, edges: Sequence[Sequence[Edge]]) -> None:
    """Solve clock after clock with known edges, those of clock i in `edges[i]`, in C and without an
    HDL simulator.

    Raises
    ------
    SimulatorError
        As NgspiceHalf.
    """
    lib = ngspice.loaded()
    first = np.cumsum([0, *map(len, edges)], dtype=np.int32)
    time, source, level = zip(*(edge for clock in edges for edge in clock), strict=True)
    arrays = first, np.array(source, np.int32), np.array(time), np.array(level)
    lib.loop_replay.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_long, *[ctypes.c_void_p] * 4]
    if code := lib.loop_replay(half.entry, period_s, len(edges), *(a.ctypes.data for a in arrays)):
        half.fail(code)
