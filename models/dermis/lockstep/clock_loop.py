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

# Of clock_loop.c.
_WRONG = 1
_KINDS = "bits", "code", "real"
MAX_SAMPLES, MAX_NETS, MAX_BITS = 4096, 64, 256
_NUMBER, _WHOLE, _TICKS = ctypes.c_double, ctypes.c_int, ctypes.c_ulonglong
_TEXT, _ARRAY = ctypes.c_char_p, ctypes.c_void_p
_SOLVE = ctypes.CFUNCTYPE(_WHOLE, _NUMBER, _WHOLE, ctypes.POINTER(_WHOLE), *[ctypes.POINTER(_NUMBER)] * 5)


class _Loop(ctypes.Structure):
    """`loop` of clock_loop.c."""

    _fields_ = (
        ("solve", _ARRAY),
        *((name, _TICKS) for name in ("before", "base", "settle", "idle")),
        *((name, _NUMBER) for name in ("base_s", "step_s", "first_step_s")),
        ("end", ctypes.c_long),
        *((name, _WHOLE) for name in ("both_edges", "samples", "trace", "failed")),
        ("overshoot_v", _NUMBER),
        ("kept", _ARRAY),
        ("kept_bytes", ctypes.c_size_t),
        ("text", ctypes.c_char * 512),
    )


@functools.cache
def _library() -> ctypes.CDLL:
    lib = ngspice.loaded()
    lib.loop_net.argtypes = [_TEXT, *[_WHOLE] * 3, _NUMBER, _NUMBER, _TEXT]
    lib.loop_output.argtypes = [_TEXT, _WHOLE, _ARRAY, _WHOLE]
    lib.loop_drive.argtypes = [_TEXT, _TICKS]
    lib.loop_replay.argtypes = [_ARRAY, _NUMBER, ctypes.c_long, *[_ARRAY] * 4]
    lib.loop_unit.restype = _NUMBER
    return lib


@dataclass(frozen=True)
class Net:
    """A net of the Verilog that drives sources of an analog half.

    Attributes
    ----------
    handle : of cocotb
    width : number of bits; 64 of a real net
    source : source that bit 0 drives; further bits drive those after it
    low, high : level of a source for 0 and for 1, volt; other numbers are on the straight line
    kind : "bits", or one source for the whole "code" (unsigned) or for a "real" net
    copy : handle of a net that receives the same value when the loop looks, or None
    """

    handle: Any
    width: int
    source: int
    low: float = 0.0
    high: float = 1.0
    kind: Literal["bits", "code", "real"] = "bits"
    copy: Any = None


@dataclass(frozen=True)
class Output:
    """A net of the Verilog whose bits are comparators of the next samples of an analog half.

    Attributes
    ----------
    handle : of cocotb
    above : bit i is high while its sample is above `above[i]`, volt
    crossing : the Verilog sees a crossing when it happens, not at the next edge of a clock
    """

    handle: Any
    above: tuple[float, ...]
    crossing: bool = False


@dataclass(frozen=True)
class Timebase:
    """Times of a loop, in units of time of the HDL simulator, or in seconds (`_s`).

    Attributes
    ----------
    before : from time 0 of the analog half to now
    base, base_s : `base` units are this long on the analog side; a clock's period, or one unit
    settle : a net moves less than so long after an event, and the loop looks then
    both_edges : falling edges of the clocks (`DrivenClock`) are events as well
    step_s, first_step_s : largest step towards a crossing, and the first one after an event
    idle : without a clock the HDL is met so often
    """

    before: int
    base: int
    base_s: float
    settle: int
    both_edges: bool = False
    step_s: float = 0.0
    first_step_s: float = 0.0
    idle: int = 0


class ClockLoop:
    """Carries nets to an analog half, and its comparators back, event by event; the last one made is in use.

    SimulatorError if the Verilog has no such net, or there are too many or too wide ones.
    """

    def __init__(self, nets: Sequence[Net], outputs: Sequence[Output]) -> None:
        widths = [*(net.width for net in nets), *(len(out.above) for out in outputs)]
        if max(len(nets), len(outputs)) > MAX_NETS or max(widths, default=0) > MAX_BITS:
            raise SimulatorError(f"more than {MAX_NETS} nets one way, or {MAX_BITS} bits of a net")
        self._lib, self._nets = _library(), tuple(nets)
        self._loop = _Loop.in_dll(self._lib, "loop")
        self._raised: BaseException | None = None
        self._lib.loop_clear()
        for net in nets:
            numbers = _KINDS.index(net.kind), net.width, net.source, net.low, net.high
            self._lib.loop_net(_name(net.handle), *numbers, _name(net.copy))
        for out in outputs:
            above = (_NUMBER * len(out.above))(*out.above)
            self._lib.loop_output(_name(out.handle), len(above), above, out.crossing)
        self.require()

    def levels(self) -> list[float]:
        """Return the level of each source, as the nets are now, in volt; SimulatorError for X or Z."""
        levels: list[float] = []
        for net in self._nets:
            value = known(net.handle)
            if net.kind == "bits":
                levels += [net.high if value >> bit & 1 else net.low for bit in range(net.width)]
            else:
                levels.append(net.low + (net.high - net.low) * value)
        return levels

    def arm(
        self, half: AnalogHalf, time: Timebase, *, end: int = 0, samples: int = 0, trace: bool = False
    ) -> None:
        """Begin now, where no net changes until the next event.

        Parameters
        ----------
        half : its sources are as the nets are
        time : all times
        end : number of events to the end of the loop, up to which the half is solved; 0 for no end
        samples : number of samples that are kept at each event (`samples`)
        trace : keep the nets at each event as well (`trace`)

        Errors are those of `require`.
        """
        if not trace <= samples <= MAX_SAMPLES:
            raise ValueError(f"samples must be 0..{MAX_SAMPLES}, with trace from 1, not {samples}")
        self._half: Any = half
        self._raised = None
        entry = getattr(half, "entry", None)
        if entry is None:  # it is in Python
            self._callback = _SOLVE(self._advance)
            entry = ctypes.cast(self._callback, _ARRAY).value
        given = {"solve": entry, "end": end, "samples": samples, "trace": trace}
        for name, value in (vars(time) | given).items():
            setattr(self._loop, name, value)
        self._lib.loop_arm()
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
        return self._loop.overshoot_v

    def require(self) -> None:
        """Raise the error that ended the loop, if one did.

        SimulatorError if a net is X or Z, or changes at a time that is not exact; or whatever the half raised.
        """
        if self._raised is not None:
            raise self._raised
        if self._loop.failed == _WRONG:
            raise SimulatorError(self._loop.text.decode(errors="replace"))
        if self._loop.failed:
            self._half.fail(self._loop.failed)

    def stop(self) -> None:
        """End the loop where it is."""
        self._lib.loop_stop()

    def _kept(self) -> NDArray[np.float64]:
        self.stop()
        width = 1 + self._loop.samples + self._loop.trace * sum((net.width + 31) // 32 for net in self._nets)
        rows = np.frombuffer(ctypes.string_at(self._loop.kept, self._loop.kept_bytes))
        return rows[: len(rows) // width * width].reshape(-1, width)

    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """End the loop; return the times [events] in s of 0 and all events, and samples [events, samples] in volt."""
        rows = self._kept()
        return rows[:, 0], rows[:, 1 : 1 + self._loop.samples]

    def trace(self) -> list[list[int]]:
        """End the loop; return every net after events 1, 2, ..."""
        words = self._kept()[1:, 1 + self._loop.samples :].astype("<u4")
        ends = np.cumsum([(net.width + 31) // 32 for net in self._nets])[:-1]
        parts = np.split(words, ends, axis=1)
        return [[int.from_bytes(row.tobytes(), "little") for row in part] for part in parts]


class DrivenClock:
    """A clock of the Verilog, driven from C: 0 now, 1 after `half` units of time, and so on.

    `handle` is cocotb's of the net, `half` half a period in units of time of the HDL simulator. Raises
    SimulatorError if there are too many.
    """

    def __init__(self, handle: Any, half: int) -> None:
        handle.value = 0
        self._lib = _library()
        self._index = self._lib.loop_drive(_name(handle), half)
        if self._index < 0:
            raise SimulatorError(f"{handle._path}: no net, or more than 8 clocks")

    def stop(self) -> None:
        """Leave the net as it is."""
        self._lib.loop_release(self._index)


def known(handle: Any) -> Any:
    """Return the value of a net, an integer or a real number; SimulatorError for X or Z."""
    try:
        value = handle.value
        return value if isinstance(value, float) else int(value)  # is_resolvable takes 7 us for sixteen bits
    except ValueError:
        said = f"{handle._path} is {str(value).lower()}, not 0 or 1: the Verilog lost its state"
        raise SimulatorError(said) from None


def _name(handle: Any) -> bytes | None:
    return None if handle is None else handle._path.encode()


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
