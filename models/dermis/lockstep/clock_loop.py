# SPDX-License-Identifier: Apache-2.0
"""The loop of a co-simulation: clock_loop.c with a Python face.

The loop runs in callbacks of the HDL simulator, without Python for an analog half in C. Its slow
reference in Python is tb/reference/python_loop.py.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dermis.errors import SimulatorError
from dermis.lockstep import ngspice
from dermis.lockstep.half import AnalogHalf, Edge

# Of clock_loop.c: `enum state`, `enum kind`, and MAX_EDGES, the room for the samples of a half.
_RUNNING, _ENDED, _WRONG = 1, 2, 3
_KINDS = "bits", "code", "real"
MAX_SAMPLES = 4096
_NUMBER, _WHOLE, _LONG = ctypes.c_double, ctypes.c_int, ctypes.c_longlong
_TEXT, _ARRAY = ctypes.c_char_p, ctypes.c_void_p
_SOLVE = ctypes.CFUNCTYPE(_WHOLE, _NUMBER, _WHOLE, ctypes.POINTER(_WHOLE), *[ctypes.POINTER(_NUMBER)] * 5)


@functools.cache
def _library() -> ctypes.CDLL:
    lib = ngspice.loaded()
    lib.loop_net.argtypes = [_TEXT, _WHOLE, _WHOLE, _NUMBER, _NUMBER, _TEXT]
    lib.loop_output.argtypes = [_TEXT, _WHOLE, _WHOLE, _ARRAY, _WHOLE]
    lib.loop_clock.argtypes = [_LONG, _LONG]
    lib.loop_drive.argtypes = [_TEXT, _LONG]
    lib.loop_levels.argtypes = [_ARRAY]
    lib.loop_arm.argtypes = [_ARRAY, _NUMBER, *[_LONG] * 3, ctypes.c_long, *[_NUMBER] * 3, _WHOLE, _WHOLE]
    lib.loop_replay.argtypes = [_ARRAY, _NUMBER, ctypes.c_long, *[_ARRAY] * 4]
    lib.loop_text.restype = _TEXT
    lib.loop_clocks.restype = ctypes.c_long
    lib.loop_rows.restype = ctypes.c_size_t
    lib.loop_overshoot.restype = lib.loop_unit.restype = _NUMBER
    lib.loop_samples.restype = ctypes.POINTER(_NUMBER)
    lib.loop_trace.restype = ctypes.POINTER(ctypes.c_uint32)
    return lib


def _check(failed: int) -> None:
    if failed:
        raise SimulatorError(_library().loop_text().decode(errors="replace"))


@dataclass(frozen=True)
class Net:
    """A net of the Verilog that drives sources of an analog half.

    Attributes
    ----------
    name : hierarchical name
    source : source that bit 0 drives; further bits drive those after it
    low, high : level of a source for 0 and for 1, volt; other numbers are on the straight line
    kind : "bits", or one source for the whole "code" (unsigned) or for a "real" net
    copy : a net that receives the same value when the loop looks, or None
    """

    name: str
    source: int
    low: float = 0.0
    high: float = 1.0
    kind: Literal["bits", "code", "real"] = "bits"
    copy: str | None = None


@dataclass(frozen=True)
class Output:
    """A net of the Verilog whose bits are comparators.

    Attributes
    ----------
    name : hierarchical name
    first : sample of the analog half that bit 0 compares; further bits compare those after it
    above : bit i is high while its sample is above `above[i]`, volt
    crossing : the Verilog sees a crossing when it happens, not at the next edge of a clock
    """

    name: str
    first: int
    above: tuple[float, ...]
    crossing: bool = False


@dataclass(frozen=True)
class Timebase:
    """Times of a loop, in units of time of the HDL simulator (`unit_s`) or in seconds.

    Attributes
    ----------
    before : units from time 0 of the analog half to now
    base_s, base : `base` units are this long on the analog side; a clock's period, or one unit
    settle : a net moves less than so many units after an event, and the loop looks then
    clocks : time of the first edge after time 0, and period, in units, of each clock
    step_s, first_step_s : largest step towards a crossing, and the first one after an event
    idle_s : without a clock the HDL is met so often
    """

    before: int
    base_s: float
    base: int
    settle: int
    clocks: tuple[tuple[int, int], ...]
    step_s: float = 0.0
    first_step_s: float = 0.0
    idle_s: float = 0.0


class ClockLoop:
    """Carries nets to an analog half, and its comparators back, event by event; there is one in a process.

    SimulatorError if the Verilog has no such net, or one of another width.
    """

    def __init__(self, nets: Sequence[Net], outputs: Sequence[Output]) -> None:
        self._lib = _library()
        self._nets, self._outputs = tuple(nets), tuple(outputs)
        self._bind()

    def _bind(self) -> None:
        self._lib.loop_clear()
        for net in self._nets:
            copy, kind = net.copy and net.copy.encode(), _KINDS.index(net.kind)
            _check(self._lib.loop_net(net.name.encode(), kind, net.source, net.low, net.high, copy))
        for out in self._outputs:
            above = np.array(out.above, dtype=float)
            numbers = out.first, len(above), above.ctypes.data, out.crossing
            _check(self._lib.loop_output(out.name.encode(), *numbers))

    def levels(self, sources: int) -> list[float]:
        """Return the level of each source, as the nets are now, in volt; SimulatorError for X or Z."""
        level = np.zeros(sources)
        _check(self._lib.loop_levels(level.ctypes.data))
        return level.tolist()

    def arm(
        self, half: AnalogHalf, time: Timebase, *, clocks: int = 0, samples: int = 0, trace: bool = False
    ) -> None:
        """Begin now, where no net changes until the next event.

        Parameters
        ----------
        half : its sources are as the nets are
        time : all times
        clocks : number of edges of clocks to the end of the loop, up to which the half is solved; 0 for no end
        samples : number of samples that are kept at each event (`samples`)
        trace : keep the nets at each edge of a clock (`trace`); needs `clocks`

        Errors are those of `require`.
        """
        if not 0 <= samples <= MAX_SAMPLES:
            raise ValueError(f"samples must be 0..{MAX_SAMPLES}, not {samples}")
        self._bind()
        for first, period in time.clocks:
            _check(self._lib.loop_clock(first, period))
        self._half: Any = half
        self._raised: BaseException | None = None
        self._samples = samples
        entry = getattr(half, "entry", None)
        if entry is None:  # it is in Python
            self._callback = _SOLVE(self._advance)
            entry = ctypes.cast(self._callback, ctypes.c_void_p).value
        steps = time.step_s, time.first_step_s, time.idle_s
        numbers = time.base_s, time.base, time.before, time.settle, clocks, *steps, samples, trace
        self._lib.loop_arm(entry, *numbers)
        self.require()

    def _advance(self, to: float, count: int, source: Any, time: Any, level: Any, *told: Any) -> int:
        """Advance a half that is in Python."""
        edges: list[Edge] = [(time[i], source[i], level[i]) for i in range(count)]
        try:
            values = self._half.advance(to, edges)
            if len(values) > MAX_SAMPLES:
                raise ValueError(f"{len(values)} samples of a half; at most {MAX_SAMPLES}")
            for array in told:  # the samples, and their extremes
                for i, value in enumerate(values):
                    array[i] = value
        except BaseException as error:  # C hands it on to `require`
            self._raised = error
            return -1
        return 0

    @property
    def overshoot_v(self) -> float:
        """Largest distance by which a crossing was passed, in volt."""
        return self._lib.loop_overshoot()

    def require(self) -> None:
        """Raise the error that ended the loop, if one did.

        SimulatorError if a net is X or Z, or changes at a time that is not exact; or whatever the half raised.
        """
        state = self._lib.loop_state()
        if state in (_RUNNING, _ENDED):
            return
        if self._raised is not None:
            raise self._raised
        _check(state == _WRONG)
        self._half.fail(self._lib.loop_code())

    def stop(self) -> None:
        """End the loop where it is."""
        self._lib.loop_stop()

    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the times [events] in s of time 0 and of all events, and the samples [events, samples] in volt."""
        shape = self._lib.loop_rows(), self._samples + 1
        table = np.ctypeslib.as_array(self._lib.loop_samples(), shape).copy()
        return table[:, 0], table[:, 1:]

    def trace(self, bits: Sequence[int]) -> list[list[int]]:
        """Return every net at clocks 1, 2, ..., and the outputs as they were there.

        `bits` is the number of bits of each net, and of each output.
        """
        words = [(n + 31) // 32 for n in bits]
        table = np.ctypeslib.as_array(self._lib.loop_trace(), (self._lib.loop_clocks(), sum(words)))
        parts = np.split(table.astype("<u4"), np.cumsum(words)[:-1], axis=1)
        return [[int.from_bytes(row.tobytes(), "little") for row in part] for part in parts]


class DrivenClock:
    """A clock of the Verilog, driven from C: 0 now, 1 after `half` units of time, and so on.

    `handle` is cocotb's of the net, `half` half a period in units of time of the HDL simulator. Raises
    SimulatorError if there are too many.
    """

    def __init__(self, handle: Any, half: int) -> None:
        handle.value = 0
        self._lib = _library()
        self._index = self._lib.loop_drive(handle._path.encode(), half)
        _check(self._index < 0)

    def stop(self) -> None:
        """Leave the net as it is."""
        self._lib.loop_release(self._index)


def unit_s() -> float:
    """Return the unit of time of the HDL simulator, in seconds."""
    return _library().loop_unit()


def replay(half: ngspice.NgspiceHalf, period_s: float, edges: Sequence[Sequence[Edge]]) -> None:
    """Solve clock after clock with known edges, those of clock i in `edges[i]`, in C without an HDL simulator."""
    for clock in edges:
        half.check(clock)
    first = np.cumsum([0, *map(len, edges)], dtype=np.int32)
    flat = np.array([edge for clock in edges for edge in clock], dtype=float).reshape(-1, 3).T
    arrays = first, flat[1].astype(np.int32), flat[0].copy(), flat[2].copy()
    lib = _library()
    if code := lib.loop_replay(half.entry, period_s, len(edges), *(a.ctypes.data for a in arrays)):
        half.fail(code)
