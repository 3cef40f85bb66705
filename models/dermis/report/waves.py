# SPDX-License-Identifier: Apache-2.0
"""Waveforms of a co-simulation: digital nets and integrator voltages as VCD, for GTKWave."""

import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip.netlist import integrator_nodes
from dermis.engines import Result
from dermis.errors import optional
from dermis.files import write_atomic
from dermis.records import Plan


def integrator_waves(record: dict[str, Any], cols: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times [points] in seconds over all frames, and voltages [cols, points]."""
    times, volts = [], []
    for begin_s, time_s, voltages in record["waves"]:
        times.append(time_s + begin_s)
        volts.append([next(voltages[n] for n in integrator_nodes(c) if n in voltages) for c in range(cols)])
    if not times:
        return np.zeros(0), np.zeros((cols, 0))
    return np.concatenate(times), np.concatenate([np.array(v) for v in volts], axis=1)


def write(out: Path, made: Plan, result: Result) -> None:
    """Write waves.vcd and waves.gtkw of the first part of a run into `out`."""
    vcd, gtkw = optional("vcd", "chip"), optional("vcd.gtkw", "chip")
    record = result.info["records"][0]
    nets = {"preset": 1, "row_select": made.rows, "charge": made.cols, "comparator": made.cols}
    t_clk_ps = 1e12 / made.timing.f_clk_hz
    time_s, v_int = integrator_waves(record, made.cols)
    events: list[tuple[int, str, Any]] = []
    for net in nets:
        delay = record["charge_delay_clocks"] if net == "charge" else 0.0
        for clock, (last, value) in enumerate(pairwise([None, *record["trace"][net]]), start=1):
            if value != last:
                events.append((round((clock + delay) * t_clk_ps), net, value))
    for column, volts in enumerate(v_int):
        events += [(round(t * 1e12), f"v_int{column}", float(v)) for t, v in zip(time_s, volts, strict=True)]
    events.sort(key=lambda event: event[0])
    file = io.StringIO()
    with vcd.VCDWriter(file, timescale="1 ps", date="", version="dermis") as writer:
        variables = {net: writer.register_var("chip", net, "wire", size=n) for net, n in nets.items()}
        for name in (f"v_int{column}" for column in range(made.cols)):
            variables[name] = writer.register_var("analog", name, "real", init=0.0)
        for time, name, value in events:
            writer.change(variables[name], time, value)
    write_atomic(out / "waves.vcd", file.getvalue())
    file = io.StringIO()
    save = gtkw.GTKWSave(file)
    save.dumpfile("waves.vcd", abspath=False)
    save.zoom_markers(-22.0)
    save.trace("chip.preset")
    for net, width in list(nets.items())[1:]:
        save.trace(f"chip.{net}[{width - 1}:0]" if width > 1 else f"chip.{net}", datafmt="hex")
    for column in range(made.cols):
        save.trace(f"analog.v_int{column}", extraflags=["analog_step"])
    write_atomic(out / "waves.gtkw", file.getvalue())
