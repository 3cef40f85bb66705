# SPDX-License-Identifier: Apache-2.0
"""Measures what a whole array costs in plain ngspice: 16 channels, 16 x 16 taxels, 16 row drivers; prints a table.

Run it as ``python tb/spice/frame_cost.py``; the table in docs/spice.md came from it.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ngspice_batch import SPICE

from dermis.chip.spice_text import array_subckt
from dermis.scene import design as design_module

SIZE = 16
CLOCKS = (100, 1100)


@dataclass(frozen=True)
class Cost:
    """What ngspice's own account says of one transient."""

    equations: int
    points: int
    iterations: int
    seconds: float

    @property
    def us_per_iteration(self) -> float:
        return 1e6 * self.seconds / self.iterations

    @property
    def iterations_per_point(self) -> float:
        return self.iterations / self.points


def deck(topology: str, dut: Mapping[str, float], row_ohm: float = 0.0, clocks: int = 100) -> str:
    """Write a deck with a fixed train of packets in each column, of three phases and many rates."""
    t_clk = design_module.load().converter.t_clk_s
    values = " ".join(f"{k}={v!r}" for k, v in dut.items())
    ohm = [[500.0 + 100 * c + 10 * r for c in range(SIZE)] for r in range(SIZE)]
    lines = [
        "cost of a frame",
        f'.include "{SPICE / "design.inc"}"',
        f'.include "{SPICE / "behavioural" / "blocks.inc"}"',
        # The tolerances of dermis.chip.netlist's ideal decks: this measures their cost.
        ".options acct reltol=1e-6 abstol=1e-13 vntol=1e-9 trtol=1e9",
        "vdd vdd 0 1.65",
        "vss vss 0 -1.65",
        f"vpreset d_preset 0 pulse(1 0 {10 * t_clk} 1n 1n 1 2)",
        *array_subckt(SIZE, SIZE, ohm).splitlines(),
        f"xarray {' '.join(f'row{i}' for i in range(SIZE))} {' '.join(f'col{i}' for i in range(SIZE))} array",
    ]
    for i in range(SIZE):
        lines.append(f"vrow{i} d_row{i} 0 {1 if i == 0 else 0}")
        lines.append(f"xrow{i} d_row{i} row{i} 0 0 row_driver r_on_ohm={row_ohm} r_ground_ohm={row_ohm}")
        start, period = (11 + i % 3) * t_clk, max(2, round(2 * (1 + 0.2 * i))) * t_clk
        lines.append(f"vcharge{i} d_charge{i} 0 pulse(0 1 {start} 1n 1n {t_clk - 1e-9} {period})")
        lines.append(f"xch{i} col{i} d_charge{i} d_preset comp{i} 0 vdd vss channel_{topology} {values}")
    step = t_clk
    lines += [f".tran {step} {(10 + clocks) * t_clk} 0 {step}", ".save v(comp0)"]
    lines += [".control", "run", "rusage all", "quit", ".endc", ".end"]
    return "\n".join(lines) + "\n"


def account(text: str) -> Cost:
    """Run a deck and read ngspice's account; its time is processor time, since a busy machine stretches any other.

    Raises
    ------
    RuntimeError
        The account is not complete.
    """
    with tempfile.TemporaryDirectory() as folder:
        path, log = Path(folder) / "cost.sp", Path(folder) / "cost.log"
        path.write_text(text)
        with log.open("w") as stream:
            process = subprocess.Popen(["ngspice", "-b", str(path)], stdout=stream, stderr=subprocess.STDOUT)
            _, _, used = os.wait4(process.pid, 0)
            process.returncode = 0  # reaped here
        out = log.read_text()

    def number(name: str) -> int:
        found = re.search(rf"{name}\s*=\s*(\d+)", out)
        if found is None:
            raise RuntimeError(f"no {name!r} in what ngspice says:\n{out[-2000:]}")
        return int(found[1])

    return Cost(
        equations=number("Circuit Equations"),
        points=number("Accepted timepoints"),
        iterations=number("Transient iterations"),
        seconds=used.ru_utime + used.ru_stime,
    )


def measure(topology: str, dut: Mapping[str, float], row_ohm: float = 0.0, repeat: int = 3) -> Cost:
    """Return the cost of the clocks between a short and a long run, so that reading the deck does not count."""
    short, long = (
        min((account(deck(topology, dut, row_ohm, clocks)) for _ in range(repeat)), key=lambda c: c.seconds)
        for clocks in CLOCKS
    )
    return Cost(
        equations=long.equations,
        points=long.points - short.points,
        iterations=long.iterations - short.iterations,
        seconds=long.seconds - short.seconds,
    )


def main() -> None:
    """Print the table."""
    design = design_module.load()
    i, c, v, m = design.integrator, design.comparator, design.conveyor, design.mirror
    groups: dict[str, dict[str, float]] = {
        "conveyor: r_x": {"conv_r_x_ohm": v.r_x_ohm},
        "conveyor: limit": {"conv_i_out_max_a": v.i_out_max_a},
        "conveyor: pole": {"conv_t_pole_s": v.t_pole_s},
        "mirror: pole": {"mir_t_pole_s": m.t_pole_s},
        "integrator: gain": {"int_gain_dc": i.gain_dc},
        "integrator: bandwidth": {"int_t_gbw_s": i.t_gbw_s},
        "integrator: range": {"int_v_out_max_v": i.v_out_max_v, "int_v_out_min_v": i.v_out_min_v},
        "comparator: gain": {"comp_gain_dc": c.gain_dc},
        "comparator: hysteresis": {"comp_v_hysteresis_v": c.v_hysteresis_v},
        "comparator: delay": {"comp_t_delay_s": c.t_delay_s},
    }
    everything = {k: x for g in groups.values() for k, x in g.items()}
    topologies = ("direct", "conveyor_mirror", "conveyor_mirror_inverted", "multi_output_conveyor")
    cases: list[tuple[str, str, dict[str, float], float]] = [("ideal", t, {}, 0.0) for t in topologies]
    cases += [(name, "conveyor_mirror", g, 0.0) for name, g in groups.items()]
    cases.append(("row drivers of 1 ohm", "conveyor_mirror", {}, 1.0))
    cases += [("all of these", t, everything, 1.0) for t in topologies]
    print("| deck | equations | us per iteration | iterations per step |\n|---|---:|---:|---:|")
    for name, topology, dut, row_ohm in cases:
        cost = measure(topology, dut, row_ohm)
        cells = f"{topology}, {name} | {cost.equations}"
        print(f"| {cells} | {cost.us_per_iteration:.1f} | {cost.iterations_per_point:.2f} |", flush=True)


if __name__ == "__main__":
    main()
