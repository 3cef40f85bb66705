# SPDX-License-Identifier: Apache-2.0
"""Waveforms of a co-simulation: digital nets and integrator voltages as VCD, for GTKWave."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip.netlist import integrator_nodes
from dermis.engines import Result
from dermis.errors import optional
from dermis.files import atomic
from dermis.records import Plan


def integrator_waves(record: dict[str, Any], cols: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times [points] in seconds over all frames, and voltages [cols, points]."""
    times, volts = [], []
    frame = 0
    while f"wave{frame}_time_s" in record:
        time = record[f"wave{frame}_time_s"]
        times.append(time + float(record[f"wave{frame}_begin_s"]))
        names = [
            next(n for n in (f"wave{frame}_{node}" for node in integrator_nodes(c)) if n in record)
            for c in range(cols)
        ]
        volts.append([record[name] for name in names])
        frame += 1
    if not times:
        return np.zeros(0), np.zeros((cols, 0))
    return np.concatenate(times), np.concatenate([np.array(v) for v in volts], axis=1)


def trace(record: dict[str, Any], name: str) -> list[int]:
    """Return a digital net of a record, one value for each clock (see dermis.chip.bridge.Trace)."""
    return [int(word, 16) for word in record[f"trace_{name}"]]


def _changes(values: list[int], t_clk_ps: float, delay_clocks: float) -> Iterator[tuple[int, int]]:
    last = None
    for clock, value in enumerate(values, start=1):
        if value != last:
            yield round((clock + delay_clocks) * t_clk_ps), value
            last = value


def write(out: Path, made: Plan, result: Result, part: int = 0) -> Path:
    """Write waves.vcd and waves.gtkw of one part of a run into `out`; return the VCD's path."""
    vcd, gtkw = optional("vcd", "chip"), optional("vcd.gtkw", "chip")
    record = result.info["records"][part]
    rows, cols = made.rows, made.cols
    t_clk_ps = 1e12 / made.timing.f_clk_hz
    time_s, v_int = integrator_waves(record, cols)
    events: list[tuple[int, str, Any]] = []
    for net in ("preset", "row_select", "charge", "comparator"):
        delay = float(record["trace_charge_delay_clocks"]) if net == "charge" else 0.0
        events += [(time, net, value) for time, value in _changes(trace(record, net), t_clk_ps, delay)]
    for column in range(cols):
        name = f"v_int{column}"
        events += [(round(t * 1e12), name, float(v)) for t, v in zip(time_s, v_int[column], strict=True)]
    events.sort(key=lambda event: event[0])
    out.mkdir(parents=True, exist_ok=True)
    target = out / "waves.vcd"
    with atomic(target) as binary:
        file = io.TextIOWrapper(binary, encoding="utf-8", newline="\n")
        with vcd.VCDWriter(file, timescale="1 ps", date="", version="dermis") as writer:
            variables = {
                "preset": writer.register_var("chip", "preset", "wire", size=1),
                "row_select": writer.register_var("chip", "row_select", "wire", size=rows),
                "charge": writer.register_var("chip", "charge", "wire", size=cols),
                "comparator": writer.register_var("chip", "comparator", "wire", size=cols),
            }
            for column in range(cols):
                name = f"v_int{column}"
                variables[name] = writer.register_var("analog", name, "real", init=0.0)
            for time, name, value in events:
                writer.change(variables[name], time, value)
        file.detach()  # flushed by then; the file below it is closed where it was opened
    with atomic(out / "waves.gtkw") as binary:
        file = io.TextIOWrapper(binary, encoding="utf-8", newline="\n")
        save = gtkw.GTKWSave(file)
        save.dumpfile(target.name, abspath=False)
        save.zoom_markers(-22.0)
        save.trace("chip.preset")
        for net, width in (("row_select", rows), ("charge", cols), ("comparator", cols)):
            save.trace(f"chip.{net}[{width - 1}:0]" if width > 1 else f"chip.{net}", datafmt="hex")
        for column in range(cols):
            save.trace(f"analog.v_int{column}", extraflags=["analog_step"])
        file.detach()
    return target
