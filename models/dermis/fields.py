# SPDX-License-Identifier: Apache-2.0
"""Fields of the records that effects write: a field at its default is the ideal."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np


@functools.cache
def _defaults(kind: type, given: frozenset[str]) -> tuple[tuple[str, Any], ...]:
    return tuple((f.name, f.default) for f in dataclasses.fields(kind) if f.name not in given)


def active(record: Any, given: frozenset[str]) -> frozenset[str]:
    """Return the fields of a record that are away from their defaults; `given` are those that a
    scene always sets.

    Every other field counts, whoever added it: an engine refuses each one that it does not list.
    """
    found = []
    for name, default in _defaults(type(record), given):
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            # The first element decides most of them.
            if (value.flat[0] != default) or (value != default).any():
                found.append(name)
        elif value != default:
            found.append(name)
    return frozenset(found)
