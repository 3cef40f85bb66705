# SPDX-License-Identifier: Apache-2.0
"""Reads a VCD file of a co-simulation back into arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.errors import optional

UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ps": 1e-12, "fs": 1e-15}


def read(path: Path) -> dict[str, tuple[NDArray[np.float64], NDArray[Any]]]:
    """Return times in seconds and values of every net of a VCD file, by its name with scopes.

    Wires are integers (an unknown bit counts as 0), reals are floats.
    """
    reader = optional("vcd.reader", "chip")
    kinds = reader.TokenKind
    names: dict[str, str] = {}
    times: dict[str, list[float]] = {}
    values: dict[str, list[Any]] = {}
    scopes: list[str] = []
    unit, now = 1e-12, 0
    with path.open("rb") as file:
        for token in reader.tokenize(file):
            data = token.data
            if token.kind is kinds.TIMESCALE:
                unit = data.magnitude * UNITS_S[data.unit.value]
            elif token.kind is kinds.SCOPE:
                scopes.append(data.ident)
            elif token.kind is kinds.UPSCOPE:
                scopes.pop()
            elif token.kind is kinds.VAR:
                names[data.id_code] = ".".join([*scopes, data.reference])
                times[data.id_code], values[data.id_code] = [], []
            elif token.kind is kinds.CHANGE_TIME:
                now = data
            elif token.kind in (kinds.CHANGE_SCALAR, kinds.CHANGE_VECTOR, kinds.CHANGE_REAL):
                value = data.value
                if token.kind is kinds.CHANGE_SCALAR:
                    value = int(value == "1")
                elif isinstance(value, str):
                    value = int("".join("1" if bit == "1" else "0" for bit in value), 2)
                times[data.id_code].append(now * unit)
                values[data.id_code].append(value)
    return {name: (np.array(times[code]), np.array(values[code])) for code, name in names.items()}
