# SPDX-License-Identifier: Apache-2.0
"""The long form of the random SPI traffic: ``.venv/bin/python tb/rtl/top/random_traffic.py``, minutes on one core."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from test_top import SMALL, WEIGHTS, run  # noqa: E402


def main() -> None:
    """Run seed behind seed until there were enough transactions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--transactions", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=5_000, help="transactions of one simulation")
    parser.add_argument("--simulator", choices=("verilator", "icarus"), default="verilator")
    chosen = parser.parse_args()
    done: dict[str, int] = {}
    frames, begun = 0, time.monotonic()
    for seed in range(chosen.seed, chosen.seed + -(-chosen.transactions // chosen.each)):
        got = run(
            chosen.simulator,
            "traffic",
            SMALL,
            seed=seed,
            transactions=chosen.each,
            slowest=0.7,
            weights=WEIGHTS,
        )
        frames += got["frames"]
        for kind, count in got["done"].items():
            done[kind] = done.get(kind, 0) + count
        print(f"seed {seed}: {sum(done.values())} transactions, {time.monotonic() - begun:.0f} s", flush=True)
    print(
        f"{sum(done.values())} transactions over {frames} frames: "
        + ", ".join(f"{n} {k}" for k, n in done.items())
    )


if __name__ == "__main__":
    main()
