# SPDX-License-Identifier: Apache-2.0
"""Make tb/hard importable, in worker processes too."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
