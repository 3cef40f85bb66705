# SPDX-License-Identifier: Apache-2.0
"""Engines: each takes a plan and returns codes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass
class Result:
    """Codes uint8 [frames, rows, cols] and what else an engine found out."""

    codes: NDArray[np.uint8]
    info: dict[str, Any] = field(default_factory=dict)
