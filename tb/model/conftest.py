# SPDX-License-Identifier: Apache-2.0
"""The helpers of this room can be imported by name."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
