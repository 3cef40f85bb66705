# SPDX-License-Identifier: Apache-2.0
"""Fields of the records that effects write: a field at its default is the ideal."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np


def active(record: Any, given: frozenset[str]) -> frozenset[str]:
    """Return the fields of a record that differ from their defaults; `given` are those that a scene always sets.

    Every other field counts, whoever added it: an engine refuses each one that it does not list.
    """
    named = (field for field in dataclasses.fields(record) if field.name not in given)
    return frozenset(f.name for f in named if bool(np.any(np.asarray(getattr(record, f.name)) != f.default)))
