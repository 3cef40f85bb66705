# SPDX-License-Identifier: Apache-2.0
"""The resistive network of one frame: a record, without its solution."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from dermis import fields
from dermis.ndarrays import Floats


@dataclass(frozen=True, eq=False)
class Network:
    """The resistive network of one frame, everything in ohm, siemens and volt.

    Row r hangs on v_bias_v through r_row_driven_ohm while it is read and on ground through
    r_row_grounded_ohm otherwise (inf: floating); column c is held at v_column_offset_v[c] through
    r_column_ohm[c]. Lateral conductances lie between the inner electrodes of neighbouring taxels:
    `g_lateral_row_s` between columns c and c+1 in each row, `g_lateral_column_s` between rows r and
    r+1 in each column. Without trace resistance both ends of the latter are the same column line,
    so they carry no current and no solve here sees them; a deck still writes them.

    `i_leak_a[c]` flows into column c in front of r_column_ohm and adds to its current. Traces have
    a resistance per taxel pitch: a row line runs driver, segment, taxel 0, segment, taxel 1 ...; a
    column line taxel 0, segment, taxel 1 ... last taxel, segment, column node. Capacitances lie
    from every row line (behind its driver) and every column node to ground and across every taxel;
    they carry no direct current.

    Grounded rows share `r_return_ohm` to ground, the driven row does not. The pads' part of the
    resistances of rows and columns is in r_pad_row_ohm and r_pad_column_ohm as well, for a deck,
    where drivers and inputs may be transistors; no solve reads these two.
    """

    g_taxel_s: Floats
    v_bias_v: float
    r_row_driven_ohm: float = 0.0
    r_row_grounded_ohm: float = 0.0
    r_column_ohm: Floats = 0.0  # type: ignore[assignment]
    v_column_offset_v: Floats = 0.0  # type: ignore[assignment]
    g_lateral_row_s: float = 0.0
    g_lateral_column_s: float = 0.0
    r_trace_row_ohm: float = 0.0
    r_trace_column_ohm: float = 0.0
    i_leak_a: Floats = 0.0  # type: ignore[assignment]
    c_row_f: float = 0.0
    c_column_f: float = 0.0
    c_taxel_f: float = 0.0
    r_return_ohm: float = 0.0
    r_pad_row_ohm: float = 0.0
    r_pad_column_ohm: float = 0.0

    def __post_init__(self) -> None:
        g = np.asarray(self.g_taxel_s, dtype=float)
        if g.ndim != 2 or 0 in g.shape or not (g >= 0).all():
            raise ValueError("g_taxel_s must be [rows, cols], 0 or above")
        object.__setattr__(self, "g_taxel_s", g)
        for name in ("r_column_ohm", "v_column_offset_v", "i_leak_a"):
            array = np.empty(g.shape[1])
            array[:] = getattr(self, name)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        for what, names in LIMITED.items():
            for value in (getattr(self, name) for name in names):
                least, largest = ends(value)
                if not 0 <= least <= largest < np.inf:
                    raise ValueError(f"{what} must be finite and 0 or above")
        if not self.r_row_grounded_ohm >= 0:
            raise ValueError("row resistances must be 0 or above")
        if not (np.isfinite(self.v_column_offset_v).all() and np.isfinite(self.i_leak_a).all()):
            raise ValueError("v_column_offset_v and i_leak_a must be finite")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.g_taxel_s.shape[0]

    @property
    def cols(self) -> int:
        """Number of columns."""
        return self.g_taxel_s.shape[1]

    def active_fields(self) -> frozenset[str]:
        """Return the names of the non-ideal fields; the pads' part of a resistance has its own
        field.
        """
        return self._active

    @functools.cached_property
    def _active(self) -> frozenset[str]:
        active = fields.active(self, _GIVEN)
        pads = {
            "r_row_driven_ohm": self.r_pad_row_ohm,
            "r_row_grounded_ohm": self.r_pad_row_ohm,
            "r_column_ohm": self.r_pad_column_ohm,
        }
        return active - {n for n, pad_ohm in pads.items() if pad_ohm and np.all(getattr(self, n) == pad_ohm)}


def ends(value: Floats | float) -> tuple[float, float]:
    """Return the least and the largest element, at once for a number."""
    return (value.min(), value.max()) if isinstance(value, np.ndarray) else (value, value)


# What must be finite and 0 or above, by the words of an error.
LIMITED = {
    "r_column_ohm": ("r_column_ohm",),
    "row resistances": ("r_row_driven_ohm",),
    "lateral conductances": ("g_lateral_row_s", "g_lateral_column_s"),
    "trace resistances": ("r_trace_row_ohm", "r_trace_column_ohm"),
    "r_return_ohm": ("r_return_ohm",),
    "capacitances": ("c_row_f", "c_column_f", "c_taxel_f"),
}
# Fields of Network that a scene always sets.
_GIVEN = frozenset({"g_taxel_s", "v_bias_v"})
