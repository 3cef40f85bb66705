# SPDX-License-Identifier: Apache-2.0
"""The loop of a co-simulation: clock_loop.c with a Python face.

The loop runs in callbacks of the HDL simulator, without Python for an analog half in C. Its slow
reference in Python is tb/reference/python_loop.py.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dermis.errors import SimulatorError
from dermis.lockstep import ngspice
from dermis.lockstep.ngspice import Edge

# Of clock_loop.c.
_WRONG = 1
_BITS, _CODE, _REAL = range(3)
MAX_SAMPLES, MAX_NETS, MAX_BITS, MAX_CLOCKS = 4096, 64, 256, 8
_NUMBER, _WHOLE, _TICKS = ctypes.c_double, ctypes.c_int, ctypes.c_ulonglong
_TEXT, _ARRAY = ctypes.c_char_p, ctypes.c_void_p
_SOLVE = ctypes.CFUNCTYPE(_WHOLE, _NUMBER, _WHOLE, ctypes.POINTER(_WHOLE), *[ctypes.POINTER(_NUMBER)] * 5)


class AnalogHalf(Protocol):
    """The analog side of a lock-step run.

    The caller knows every edge of an interval before the interval is solved, because digital nets
    change at clock edges only; so an analog half never has to go back.
    """

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to `to` seconds with these edges; return a sample a comparator, > 0 if high."""

    def close(self) -> None:
        """Release its resources."""


class _Loop(ctypes.Structure):
    """`loop` of clock_loop.c."""

    _fields_ = (
        ("solve", _ARRAY),
        *((name, _TICKS) for name in ("before", "base", "settle", "idle")),
        *((name, _NUMBER) for name in ("base_s", "step_s", "first_step_s")),
        *((name, ctypes.c_long) for name in ("end", "both_edges", "samples", "trace", "failed")),
        ("overshoot_v", _NUMBER),
        ("kept", _ARRAY),
        ("kept_bytes", ctypes.c_size_t),
        ("text", ctypes.c_char * 512),
    )


@functools.cache
def _library() -> ctypes.CDLL:
    lib = ngspice.loaded()
    lib.loop_net.argtypes = [_TEXT, _WHOLE, _WHOLE, _NUMBER, _NUMBER, _TEXT]
    lib.loop_output.argtypes = [_TEXT, _WHOLE, _ARRAY, _WHOLE]
    lib.loop_clock.argtypes = [_TEXT, _TICKS]
    lib.loop_unit.restype = _NUMBER
    return lib


class ClockLoop:
    """Carries nets to an analog half, and its comparators back, event by event; the last one made is in use.

    Nets are handles of cocotb. SimulatorError if there are too many or too wide ones. Times are in units of time of the
    HDL simulator, or in seconds (`_s`).
    """

    def __init__(self) -> None:
        self._lib = _library()
        self._loop = _Loop.in_dll(self._lib, "loop")
        self._nets: list[tuple[Any, int, float, float, bool]] = []
        self._outputs = self._clocks = 0
        self._raised: BaseException | None = None
        self.close()

    def close(self) -> None:
        """End the loop and its clocks, whose nets stay as they are."""
        self._lib.loop_clear()

    @property
    def unit_s(self) -> float:
        """Unit of time of the HDL simulator, in seconds."""
        return self._lib.loop_unit()

    def clock(self, handle: Any, half: int) -> None:
        """Drive a clock from C: 0 now, 1 after `half` units of time, and so on. Its edges are events of the loop."""
        self._clocks += 1
        _limit(self._clocks, MAX_CLOCKS, "clocks")
        handle.value = 0
        self._lib.loop_clock(handle._path.encode(), half)
        self.require()

    def net(
        self, handle: Any, low: float = 0.0, high: float = 1.0, code: bool = False, copy: Any = None
    ) -> int:
        """Let a net drive the next sources of the analog half; return their number.

        Parameters
        ----------
        handle : net; a real one drives one source
        low, high : level of a source for 0 and for 1, volt; other numbers are on the straight line
        code : its bits drive one source with their number, unsigned
        copy : a net that receives the same value when the loop looks, or None
        """
        bits = width(handle)
        kind = _REAL if isinstance(handle.value, float) else _CODE if code and bits > 1 else _BITS
        self._nets.append((handle, bits, low, high, kind == _BITS))
        _limit(len(self._nets), MAX_NETS, "nets")
        copied = None if copy is None else copy._path.encode()
        self._lib.loop_net(handle._path.encode(), kind, bits, low, high, copied)
        self.require()
        return bits if kind == _BITS else 1

    def output(self, handle: Any, above: Sequence[float], crossing: bool = False) -> None:
        """Make the bits of a net comparators of the next samples: bit i is high while its sample is over `above[i]` V.

        The Verilog sees a `crossing` when it happens, otherwise at the next edge of a clock.
        """
        self._outputs += 1
        _limit(self._outputs, MAX_NETS, "nets")
        levels = (_NUMBER * width(handle))(*above)
        self._lib.loop_output(handle._path.encode(), width(handle), levels, crossing)
        self.require()

    def levels(self) -> list[float]:
        """Return the level of each source, as the nets are now, in volt; SimulatorError for X or Z."""
        levels: list[float] = []
        for handle, bits, low, high, bitwise in self._nets:
            value = known(handle)
            if bitwise:
                levels += [high if value >> bit & 1 else low for bit in range(bits)]
            else:
                levels.append(low + (high - low) * value)
        return levels

    def arm(
        self,
        half: AnalogHalf,
        *,
        base: int,
        base_s: float,
        settle: int,
        before: int = 0,
        both_edges: bool = False,
        step_s: float = 0.0,
        first_step_s: float = 0.0,
        idle: int = 0,
        end: int = 0,
        samples: int = 0,
        trace: bool = False,
    ) -> None:
        """Begin now, where no net changes until the next event.

        Parameters
        ----------
        half : its sources are as the nets are
        base, base_s : `base` units are this long on the analog side; a clock's period, or one unit
        settle : a net moves less than so long after an event, and the loop looks then
        before : from time 0 of the analog half to now
        both_edges : falling edges of the clocks are events as well
        step_s, first_step_s : largest step towards a crossing, and the first one after an event
        idle : without a clock the HDL is met so often
        end : number of events to the end of the loop, up to which the half is solved; 0 for no end
        samples : number of samples that are kept at each event (`samples`)
        trace : keep the nets at each event as well (`trace`)

        Errors are those of `require`.
        """
        given = {name: value for name, value in locals().items() if name not in ("self", "half")}
        if not trace <= samples <= MAX_SAMPLES:
            raise ValueError(f"samples must be 0..{MAX_SAMPLES}, with trace from 1, not {samples}")
        self._half: Any = half
        self._raised = None
        entry = getattr(half, "entry", None)
        if entry is None:  # it is in Python
            self._callback = _SOLVE(self._advance)
            entry = ctypes.cast(self._callback, _ARRAY).value
        for name, value in (given | {"solve": entry}).items():
            setattr(self._loop, name, value)
        self._lib.loop_arm()
        self.require()

    def _advance(self, to: float, count: int, source: Any, time: Any, level: Any, *told: Any) -> int:
        """Advance a half that is in Python."""
        edges: list[Edge] = [(time[i], source[i], level[i]) for i in range(count)]
        try:
            values = self._half.advance(to, edges)
            _limit(len(values), MAX_SAMPLES, "samples of a half")
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

    def _kept(self) -> list[NDArray[np.float64]]:
        """Return the rows that are kept, [events, n]: times, samples, and with a trace the words of each net."""
        self.stop()
        words = [self._loop.trace * ((bits + 31) // 32) for _, bits, *_ in self._nets]
        *starts, width = np.cumsum([1, self._loop.samples, *words]).tolist()
        numbers = np.frombuffer(ctypes.string_at(self._loop.kept, self._loop.kept_bytes))
        rows = numbers[: len(numbers) // width * width].reshape(-1, width)
        return np.split(rows.copy(), starts, axis=1)

    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """End the loop; return the times [events] in s of 0 and all events, and samples [events, samples] in volt."""
        times, samples, *_ = self._kept()
        return times[:, 0], samples

    def trace(self) -> list[list[int]]:
        """End the loop; return every net after events 1, 2, ..."""
        _, _, *nets = self._kept()
        words = [net[1:].astype("<u4") for net in nets]
        return [[int.from_bytes(row.tobytes(), "little") for row in net] for net in words]


def _limit(number: int, most: int, what: str) -> None:
    if number > most:
        raise SimulatorError(f"more than {most} {what}")


def width(handle: Any) -> int:
    """Return the number of bits of a net, 64 of a real one; SimulatorError for too many."""
    found = 64 if isinstance(handle.value, float) else len(handle) if hasattr(handle, "__len__") else 1
    _limit(found, MAX_BITS, f"bits in {handle._path}")
    return found


def known(handle: Any) -> Any:
    """Return the value of a net, an integer or a real number; SimulatorError for X or Z."""
    try:
        value = handle.value
        return value if isinstance(value, float) else int(value)  # is_resolvable takes 7 us for sixteen bits
    except ValueError:
        said = f"{handle._path} is {str(value).lower()}, not 0 or 1: the Verilog lost its state"
        raise SimulatorError(said) from None
