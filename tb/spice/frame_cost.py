# SPDX-License-Identifier: Apache-2.0
"""Measures what a whole array costs in plain ngspice: 16 channels, 16 x 16 taxels, 16 row drivers; prints a table.

Run it as ``python tb/spice/frame_cost.py``; the table in docs/spice.md came from it.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ngspice_batch import SPICE

from dermis import design as design_module
from dermis import generate

SIZE = 16
CLOCKS = 500


@dataclass(frozen=True)
class Cost:
    """What ngspice's own account says of one transient."""

    equations: int
    points: int
    rejected: int
    iterations: int
    seconds: float

    @property
    def us_per_iteration(self) -> float:
        return 1e6 * self.seconds / self.iterations

    @property
    def iterations_per_point(self) -> float:
        return self.iterations / self.points


def deck(topology: str, dut: Mapping[str, float], row_ohm: float = 0.0, options: str = "trtol=1e9") -> str:
    """Write a deck with a fixed train of packets in each column, of three phases and many rates."""
    t_clk = design_module.load().converter.t_clk_s
    values = " ".join(f"{k}={v!r}" for k, v in dut.items())
    ohm = [[500.0 + 100 * c + 10 * r for c in range(SIZE)] for r in range(SIZE)]
    lines = [
        "cost of a frame",
        f'.include "{SPICE / "design.inc"}"',
        f'.include "{SPICE / "behavioural" / "blocks.inc"}"',
        f".options acct reltol=1e-6 abstol=1e-13 vntol=1e-9 {options}",
        "vdd vdd 0 1.65",
        "vss vss 0 -1.65",
        f"vpreset d_preset 0 pulse(1 0 {10 * t_clk} 1n 1n 1 2)",
        *generate.array_subckt(SIZE, SIZE, ohm).splitlines(),
        f"xarray {' '.join(f'row{i}' for i in range(SIZE))} {' '.join(f'col{i}' for i in range(SIZE))} array",
    ]
    for i in range(SIZE):
        lines.append(f"vrow{i} d_row{i} 0 {1 if i == 0 else 0}")
        lines.append(f"xrow{i} d_row{i} row{i} 0 0 row_driver r_on_ohm={row_ohm} r_ground_ohm={row_ohm}")
        start, period = (11 + i % 3) * t_clk, max(2, round(2 * (1 + 0.2 * i))) * t_clk
        lines.append(f"vcharge{i} d_charge{i} 0 pulse(0 1 {start} 1n 1n {t_clk - 1e-9} {period})")
        lines.append(f"xch{i} col{i} d_charge{i} d_preset comp{i} 0 vdd vss channel_{topology} {values}")
    step = t_clk
    lines += [f".tran {step} {(10 + CLOCKS) * t_clk} 0 {step}", ".save v(comp0)"]
    lines += [".control", "run", "rusage all", "quit", ".endc", ".end"]
    return "\n".join(lines) + "\n"


def measure(text: str, limit_s: float = 120.0) -> Cost:
    """Run a deck and read ngspice's account.

    Raises
    ------
    RuntimeError
        The account is not complete.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cost.sp"
        path.write_text(text)
        done = subprocess.run(
            ["ngspice", "-b", str(path)], capture_output=True, text=True, timeout=limit_s, check=False
        )
    out = done.stdout + done.stderr

    def number(name: str) -> float:
        found = re.search(rf"{name}\s*=\s*([\d.e+-]+)", out)
        if found is None:
            raise RuntimeError(f"no {name!r} in what ngspice says:\n{out[-2000:]}")
        return float(found[1])

    return Cost(
        equations=int(number("Circuit Equations")),
        points=int(number("Accepted timepoints")),
        rejected=int(number("Rejected timepoints")),
        iterations=int(number("Transient iterations")),
        seconds=number("Transient analysis time"),
    )


def main() -> None:
    """Print the table, each row the fastest of three runs."""
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
    cases = [(f"{t}, ideal", deck(t, {})) for t in topologies]
    cases += [(f"conveyor_mirror, {name}", deck("conveyor_mirror", g)) for name, g in groups.items()]
    cases.append(("conveyor_mirror, row drivers of 1 ohm", deck("conveyor_mirror", {}, row_ohm=1.0)))
    cases += [(f"{t}, all of these", deck(t, everything, row_ohm=1.0)) for t in topologies]
    print("| deck | equations | us per iteration | iterations per step |\n|---|---:|---:|---:|")
    for name, text in cases:
        cost = min((measure(text) for _ in range(3)), key=lambda one: one.seconds)
        print(
            f"| {name} | {cost.equations} | {cost.us_per_iteration:.1f} | {cost.iterations_per_point:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
