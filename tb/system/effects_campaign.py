# SPDX-License-Identifier: Apache-2.0
"""Random scenes with random effects through ngspice and the event engine; prints those more than 1 LSB apart.

Run it as ``python tb/system/effects_campaign.py --scenes 300``; docs/cosimulation.md has the outcome, and
test_cosim_effects.py runs a few. A scene depends on its number alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from deck_bench import DeckReader
from numpy.typing import NDArray

from dermis import effects, engines, plan
from dermis.errors import InputError
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES

# What a deck can have: no random numbers, and the sheet is not in it.
NAMES = [e.name for e in effects.EFFECTS.values() if not e.random and not e.name.startswith("sensor_")]


def scene(number: int, folder: Path) -> Plan:
    """Scene `number`: one to three rows, columns and frames more or less, effects on by chance."""
    rng = np.random.default_rng(number)
    topology = TOPOLOGIES[rng.integers(len(TOPOLOGIES))]
    rows, cols, frames = (int(n) for n in rng.integers(1, [5, 6, 3]))
    ohm = 450 * 100 ** rng.random((frames, rows, cols))
    often = rng.choice([0.15, 0.5, 0.9])
    lines = []
    for name in NAMES:
        values = effects.EFFECTS[name].draw(rng)
        if rng.random() < often and topology in effects.EFFECTS[name].topologies:
            inside = ", ".join(f"{key} = {value!r}" for key, value in values.items())
            lines.append(f"{name} = " + (f"{{ {inside} }}" if values else "true"))
    return _scene(number, folder, topology, ohm, lines)


def _scene(number: int, folder: Path, topology: str, ohm: NDArray[np.float64], lines: list[str]) -> Plan:
    rows, cols = ohm.shape[1:]
    np.save(folder / f"taxels_{number}.npy", ohm)
    path = folder / f"scene_{number}.toml"
    path.write_text(
        f'title = "{number}"\n[array]\nrows = {rows}\ncols = {cols}\n'
        f'[stimulus]\nkind = "resistance"\nfile = "taxels_{number}.npy"\n'
        f'[interface]\ntopology = "{topology}"\n[effects]\n' + "\n".join(lines) + "\n"
    )
    return plan.load(path, "event")


def difference(made: Plan, reader: DeckReader) -> int | None:
    """Largest difference of a code between ngspice and the event engine; None where the latter refuses the scene."""
    try:
        expected = engines.run(made).codes.astype(int)
    except InputError:
        return None
    return int(np.abs(reader.codes(made) - expected).max())


COST_SIZE = 16
COSTLY = (
    "trace",
    "line_capacitance",
    "mirror_lag",
    "range_switch",
    "integrator_bandwidth",
    "comparator_delay",
)
COSTLY += ("integrator_range", "supply_ripple")


def print_costs() -> None:
    """Print what one frame of 16 x 16 taxels costs with an effect at its default, and with all of them."""
    ohm = 510 * 60 ** np.random.default_rng(1).random((1, COST_SIZE, COST_SIZE))
    mirrored = [name for name in NAMES if "conveyor_mirror" in effects.EFFECTS[name].topologies]
    sets = {"none": [], **{name: [name] for name in COSTLY}, "all but trace": mirrored, "all": mirrored}
    sets["all but trace"] = [name for name in mirrored if name != "trace"]
    print("| on | steps a clock | iterations a step | us an iteration | s a frame | LSB from event |")
    print("|---|---:|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        reader = DeckReader(Path(folder))
        for label, names in sets.items():
            made = _scene(0, Path(folder), "conveyor_mirror", ohm, [f"{name} = true" for name in names])
            codes, said = reader.measured(made)
            apart = int(np.abs(codes - engines.run(made).codes).max())
            clocks, tried = made.timing.rows * made.timing.slot_clocks, said["accepted"] + said["rejected"]
            cells = f"{tried / clocks:.1f} | {said['loads'] / tried:.2f} | {1e6 * said['seconds'] / said['loads']:.0f}"
            print(f"| {label} | {cells} | {said['seconds']:.1f} | {apart} |", flush=True)
        reader.close()


def main() -> None:
    """Print how many scenes differ by how much, or what effects cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cost", action="store_true", help="print what effects cost a frame instead")
    chosen = parser.parse_args()
    if chosen.cost:
        print_costs()
        return
    found: Counter[int | None] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        reader = DeckReader(Path(folder))
        for number in range(chosen.first, chosen.first + chosen.scenes):
            made = scene(number, Path(folder))
            worst = difference(made, reader)
            found[worst] += 1
            if worst is not None and worst > 1:
                on = [state.name for state in made.effects if state.on]
                print(f"scene {number}: {worst} LSB, {made.topology}, {', '.join(on)}", flush=True)
        reader.close()
    for worst, count in sorted(found.items(), key=lambda item: -1 if item[0] is None else item[0]):
        print(f"{count} scenes: " + ("refused by event" if worst is None else f"at most {worst} LSB apart"))
    sys.exit(any(worst is not None and worst > 1 for worst in found))


if __name__ == "__main__":
    main()
