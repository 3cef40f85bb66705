# SPDX-License-Identifier: Apache-2.0
"""Floating-point exceptions of compiled loops, which numpy's errstate does not see, turned into errors.

The processor notes each invalid operation, division by zero and overflow in flags that stay up until they are
cleared (IEEE 754 clause 7, C11 annex F). `watch` clears them, lets the loop run and looks. It is on where
DERMIS_FLOAT_FLAGS is `raise`, as tb/conftest.py sets it for every test and all that a test starts; elsewhere `watch`
hands out one object that does nothing.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import platform
from contextlib import nullcontext
from types import TracebackType

VARIABLE = "DERMIS_FLOAT_FLAGS"

# Bits of fenv.h by machine: the C standard leaves them open, and glibc takes those of the hardware.
_BITS = {
    "x86_64": {"invalid": 0x01, "divide by zero": 0x04, "overflow": 0x08},
    "aarch64": {"invalid": 0x01, "divide by zero": 0x02, "overflow": 0x04},
}
_NAMES = _BITS.get(platform.machine(), {})
_MASK = sum(_NAMES.values())


def wanted() -> bool:
    """Whether the environment asks for flags to be errors, on a machine whose flags are known."""
    return os.environ.get(VARIABLE) == "raise" and bool(_NAMES)


class Flags:
    """The flags of this thread; `clear` and `raised` are one call into libm each."""

    def __init__(self) -> None:
        libm = ctypes.CDLL(ctypes.util.find_library("m") or "libm.so.6")
        self._clear, self._test = libm.feclearexcept, libm.fetestexcept

    def clear(self) -> None:
        """Take all flags down."""
        self._clear(_MASK)

    def raised(self) -> list[str]:
        """Names of the flags that are up."""
        up = self._test(_MASK)
        return [name for name, bit in _NAMES.items() if up & bit]


class _Watch:
    """Raises FloatingPointError at its end if a flag came up inside it."""

    def __init__(self, what: str, flags: Flags) -> None:
        self._what, self._flags = what, flags

    def __enter__(self) -> None:
        self._flags.clear()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        raised = self._flags.raised()
        self._flags.clear()
        if raised and kind is None:
            raise FloatingPointError(f"{', '.join(raised)} in {self._what}")


_OFF = nullcontext()
_flags = Flags() if wanted() else None


def watch(what: str) -> nullcontext[None] | _Watch:
    """Raise FloatingPointError, naming `what`, if compiled code inside raises a flag; do nothing where it is off."""
    return _OFF if _flags is None else _Watch(what, _flags)
