# SPDX-License-Identifier: Apache-2.0
"""Prints the wait bytes of each command against SCK / clk: ``.venv/bin/python tb/rtl/top/wait_bytes.py``."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from test_top import RATIOS, SMALL, run  # noqa: E402


def main() -> None:
    """Measure with transactions at random phases of the two clocks."""
    print("| SCK / clk | write | read | frame |\n|---:|---:|---:|---:|")
    for row in run("verilator", "ratios", SMALL, ratios=RATIOS, repeats=40, frames=8):
        cells = [
            f"{low}" if low == high else f"{low}..{high}"
            for low, high in (row[k] for k in ("write", "read", "frame"))
        ]
        print(f"| {row['ratio']:g} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
