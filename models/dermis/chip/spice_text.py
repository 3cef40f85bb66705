# SPDX-License-Identifier: Apache-2.0
"""SPICE text: numbers, folded lines, and the array with every element of a scene."""

import math

import numpy as np
from numpy.typing import ArrayLike

from dermis.errors import InputError
from dermis.scene import design as design_module
from dermis.scene.design import Design


def spice_number(value: float | int) -> str:
    """Return a number as a deck may hold it; only finite numbers get there, never text."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} cannot stand in a deck")
    return repr(int(value)) if isinstance(value, int) else repr(number)


def array_subckt(
    rows: int,
    cols: int,
    resistance_ohm: ArrayLike | None = None,
    lateral_ohm: ArrayLike | str | None = None,
    name: str = "array",
    design: Design | None = None,
    *,
    lateral_column_ohm: float | None = None,
    trace_row_ohm: float = 0.0,
    trace_column_ohm: float = 0.0,
    taxel_f: float = 0.0,
    slope_s_per_s: ArrayLike | None = None,
) -> str:
    """Write the taxel array as a subckt with the pins r0 r1 ... c0 c1 ...

    A taxel is a resistor ``rtaxel_r3c4`` between its row and its column; its inner electrode is the
    column line. A lateral resistor ``rlat_r3c4`` is between the inner electrodes of (3, 4) and
    (3, 5).

    With trace resistance the taxel (3, 4) joins the nodes ``u_r3c4`` of its row line and ``v_r3c4``
    of its column line, its inner electrode. Row line 3 runs pin, ``rtrace_row_r3c0``, u_r3c0,
    ``rtrace_row_r3c1``, u_r3c1 ...; column line 4 runs v_r0c4, ``rtrace_col_r0c4``, v_r1c4 ... last
    row, its rtrace_col, pin. Only then has a lateral resistor along a column (``rlat_col_r3c4``, to
    row 4) two ends, and is written.

    Parameters
    ----------
    resistance_ohm
        Scalar or [rows, cols]; inf leaves the element out, what is below array.r_floor_ohm of the design becomes that.
        None makes each taxel a parameter ``r_r3c4_ohm``, r_max_ohm by default.
    lateral_ohm
        Scalar or [rows, cols - 1] (inf and 0 as above), None to leave the lateral resistors out, "parameter" to make
        them all ``{r_lateral_ohm}``, a parameter of the subckt.
    design : where the defaults come from; models/design.toml when None
    lateral_column_ohm : lateral resistors along a column; None to leave them out
    trace_row_ohm, trace_column_ohm : of a line and a taxel pitch; 0 writes no element and makes the line one node
    taxel_f : capacitance across every taxel, ``ctaxel_r3c4``; 0 writes none
    slope_s_per_s
        [rows, cols] in siemens a second: how fast conductances change. A taxel that does is a source ``btaxel_r3c4``
        and no resistor; its resistance is that at time 0.

    InputError for a wrong shape, NaN, negative or non-numeric resistances.
    """
    design = design or design_module.load()
    floor = design.array.r_floor_ohm
    params: list[str] = []
    elements: list[str] = []
    cells = [(r, c) for r in range(rows) for c in range(cols)]

    def row_node(r: int, c: int) -> str:
        return f"u_r{r}c{c}" if trace_row_ohm and c >= 0 else f"r{r}"

    def inner(r: int, c: int) -> str:
        return f"v_r{r}c{c}" if trace_column_ohm and r < rows else f"c{c}"

    def resistors(name: str, key: str, values: ArrayLike, down: int, right: int) -> None:
        """Add resistors from every inner electrode to the one a step away."""
        for (r, c), ohm in _resistances(key, values, (rows - down, cols - right)):
            if math.isfinite(ohm):
                ends = f"{inner(r, c)} {inner(r + down, c + right)}"
                elements.append(f"{name}_r{r}c{c} {ends} {spice_number(max(ohm, floor))}")

    if resistance_ohm is None:
        default = spice_number(design.sensor.r_max_ohm)
        params += [f"r_r{r}c{c}_ohm={default}" for r, c in cells]
        elements += [f"rtaxel_r{r}c{c} {row_node(r, c)} {inner(r, c)} {{r_r{r}c{c}_ohm}}" for r, c in cells]
    else:
        slope = np.broadcast_to(0.0 if slope_s_per_s is None else np.asarray(slope_s_per_s), (rows, cols))
        for (r, c), ohm in _resistances("resistance_ohm", resistance_ohm, (rows, cols)):
            ends = row_node(r, c), inner(r, c)
            if slope[r, c]:
                start, rate = spice_number(1.0 / max(ohm, floor)), spice_number(float(slope[r, c]))
                law = f"v({','.join(ends)})*({start} + ({rate})*time)"
                elements.append(f"btaxel_r{r}c{c} {' '.join(ends)} i = {law}")
            elif math.isfinite(ohm):
                elements.append(f"rtaxel_r{r}c{c} {' '.join(ends)} {spice_number(max(ohm, floor))}")
    if taxel_f:
        farad = spice_number(float(taxel_f))
        elements += [f"ctaxel_r{r}c{c} {row_node(r, c)} {inner(r, c)} {farad}" for r, c in cells]
    if isinstance(lateral_ohm, str) and lateral_ohm == "parameter":
        params.append(f"r_lateral_ohm={spice_number(design.array.r_lateral_ohm)}")
        pairs = [(r, c) for r, c in cells if c < cols - 1]
        elements += [f"rlat_r{r}c{c} {inner(r, c)} {inner(r, c + 1)} {{r_lateral_ohm}}" for r, c in pairs]
    elif lateral_ohm is not None:
        resistors("rlat", "lateral_ohm", lateral_ohm, 0, 1)
    if trace_column_ohm and lateral_column_ohm is not None:
        resistors("rlat_col", "lateral_column_ohm", lateral_column_ohm, 1, 0)
    if trace_row_ohm:
        ohms = spice_number(float(trace_row_ohm))
        elements += [f"rtrace_row_r{r}c{c} {row_node(r, c - 1)} {row_node(r, c)} {ohms}" for r, c in cells]
    if trace_column_ohm:
        ohms = spice_number(float(trace_column_ohm))
        elements += [f"rtrace_col_r{r}c{c} {inner(r, c)} {inner(r + 1, c)} {ohms}" for r, c in cells]
    pins = [f"r{r}" for r in range(rows)] + [f"c{c}" for c in range(cols)]
    head = [f".subckt {name}", *folded(pins, 16)]
    head += folded([f"params: {params[0]}", *params[1:]], 4) if params else []
    return "\n".join([*head, *elements, f".ends {name}", ""])


def _resistances(key: str, values: ArrayLike, shape: tuple[int, int]) -> list[tuple[tuple[int, int], float]]:
    try:
        table = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError("array", key, "(not numeric)", "numbers in ohm") from None
    if table.shape not in ((), shape):
        raise InputError("array", key, f"shape {table.shape}", f"shape {shape}")
    table = np.broadcast_to(table, shape)
    for r, c in np.argwhere(~(table >= 0)).tolist():
        value = repr(float(table[r, c]))
        raise InputError("array", f"{key}[{r}, {c}]", value, "0 ohm or more, inf for an open taxel")
    return [(cell, float(ohm)) for cell, ohm in np.ndenumerate(table)]


def folded(words: list[str], per_line: int) -> list[str]:
    """Return words on continuation lines."""
    return ["+ " + " ".join(words[i : i + per_line]) for i in range(0, len(words), per_line)]
