# SPDX-License-Identifier: Apache-2.0
"""The converter of the benchmark in other mixed-signal simulators, and the array solve in badcrossbar.

None of their code is in this tree. Each simulator gets the same circuit, flip-flops and solver options,
and is compared with the same exact solution for the charge pulses of its own digital side. XSPICE comes
with ngspice; the others are measured if they are installed.
"""

import dataclasses
import importlib.util
import logging
import re
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.array.array import Network
from dermis.chip.sources import rtl_sources
from dermis.converter.vfc import count_rational
from dermis.errors import SimulatorError
from dermis.ndarrays import Floats
from dermis.processes import children
from scripts import templates, workers
from tb.programs.bench import circuit as circuits
from tb.programs.bench.circuit import OPTIONS, Circuit, Run
from tb.programs.bench.measure import cpu_once

PIP = {
    "spicebind": "spicebind==0.0.2",
    "cocotbext_ams": "cocotbext-ams==0.1.0",
    "badcrossbar": "badcrossbar==1.1.0 pathvalidate",
}
"""Versions measured; `pip install --no-deps` adds them to .venv."""

T_GATE_S = 1e-12
"""The shortest delay of XSPICE; a clock edge takes three of them to the ramp of the charge."""


def missing(peer: str) -> str | None:
    """Return the reason why a peer cannot be measured here, or None."""
    try:
        found = importlib.util.find_spec(peer.replace("_", "."))
    except ModuleNotFoundError:
        found = None
    if found is not None and found.origin:  # a removed package may leave a folder, which has none
        return None
    return f"not installed; to measure it here: .venv/bin/pip install --no-deps {PIP[peer]}"


def _short(circuit: Circuit, clocks: int) -> Circuit:
    """Return the circuit without clocks before the gate."""
    return dataclasses.replace(circuit, settle_clocks=0, gate_clocks=clocks)


def _write(where: Path, name: str, lines: Sequence[str]) -> None:
    where.mkdir(parents=True, exist_ok=True)
    (where / name).write_text("\n".join(lines) + "\n")


def _judged(
    circuit: Circuit, seconds: float, time_s: Floats, voltage: Floats, told: NDArray[Any], late_s: float = 0.0
) -> Run:
    """Compare a waveform, and the switch states at clocks 0, 1, ..., with the exact solution and count."""
    clocks = circuit.gate_clocks
    end_s = time_s[-1] if time_s.size else 0.0
    if told.size < clocks or end_s < clocks / circuit.f_clk_hz or not set(np.unique(told)) <= {0, 1}:
        raise SimulatorError(f"a waveform to {end_s:g} s and {told.size} pulses of {clocks} clocks")
    told = told[:clocks]
    at_edges = np.interp(np.arange(1, clocks + 1) / circuit.f_clk_hz, time_s, voltage)
    error = np.abs(at_edges - circuits.exact_voltage(circuit, told, late_s)[1:])
    # A decision reaches the switch one clock later, and none can fall on clock 0.
    code = int(told.sum())
    return Run(
        code, abs(code - count_rational(circuit.duty, clocks - 2)), clocks, seconds, float(error.max())
    )


def xspice(
    circuit: Circuit, step_s: float, clocks: int, where: Path, limit_s: float, options: str = OPTIONS
) -> Run:
    """Run plain ngspice: bridges, two d_dff and a gate as event-driven code models, clock from a d_source file.

    The time is that of the transient.
    """
    circuit = _short(circuit, clocks)
    t_clk = 1.0 / circuit.f_clk_hz
    edges = [(0.5 * n * t_clk, 1 - n % 2) for n in range(2, 2 * clocks + 4)]
    _write(where, "clock.txt", ["0.0 0s", *(f"{time:.12e} {level}s" for time, level in edges)])
    given = {"t_gate_s": T_GATE_S, "t_edge_s": circuit.t_edge_s, "step_s": step_s}
    given |= {"blocks": circuits.blocks(circuit, options=options), "end_s": f"{(clocks + 0.75) * t_clk:.12e}"}
    (where / "deck.cir").write_text(templates.text("xspice.cir", **given))
    log = where / "console.log"
    children.run_logged(["ngspice", "-b", "deck.cir"], where, log, limit_s, "ngspice")
    try:
        begin, end = (float(t) for t in re.findall(r"BENCH_(\d+\.\d+)", log.read_text()))
        time_s, v_int, _, charge = np.loadtxt(where / "waves.dat").T
    except (OSError, ValueError) as error:
        raise SimulatorError(f"ngspice wrote no waveform: {error}", where) from None
    told = np.round(np.interp((np.arange(clocks) + 0.5) * t_clk, time_s, charge), 6)
    return _judged(circuit, end - begin, time_s, v_int, told, late_s=2 * T_GATE_S)


def _compiled(circuit: Circuit, where: Path, *options: str) -> Path:
    """Return the test bench built by Icarus in a new directory."""
    where.mkdir(parents=True)
    needed = [path for path in rtl_sources() if path.stem in ("dermis_sync_ff", "dermis_tech_dff")]
    command = ["iverilog", "-g2012", "-s", "bench_peer", f"-Pbench_peer.CLOCKS={circuit.gate_clocks}"]
    command += [*options, "-o", "sim.vvp", str(Path(__file__).with_name("bench_peer.v")), *map(str, needed)]
    children.run_logged(command, where, where / "compile.log", 60, "Icarus")
    return where / "sim.vvp"


def _pulses(where: Path) -> NDArray[Any]:
    """Return the switch states from clock 0 on; the test bench writes each at the next clock."""
    return np.array([int(line) for line in (where / "told.txt").read_text().split()])


def _raw(path: Path, node: str) -> tuple[Floats, Floats]:
    """Return time and one voltage of a binary ngspice raw file."""
    head, _, body = path.read_bytes().partition(b"Binary:\n")
    listed = head.decode(errors="replace").partition("Variables:\n")[2]
    names = [line.split()[1] for line in listed.strip().splitlines()]
    values = np.frombuffer(body, "<f8")
    values = values[: values.size // len(names) * len(names)].reshape(-1, len(names))
    return values[:, 0], values[:, next(i for i, name in enumerate(names) if node in name)]


def spicebind(
    circuit: Circuit, step_s: float, clocks: int, where: Path, limit_s: float, options: str = OPTIONS
) -> Run:
    """Run SpiceBind: Icarus with its VPI plug-in; the time is that of the process."""
    import spicebind as package

    circuit = _short(circuit, clocks)
    program = _compiled(circuit, where)
    lines = [
        "one converter",
        *circuits.blocks(circuit, options=options),
        "vd_charge d_charge 0 external",
        "bcomp comp 0 v = v(comp0) > 0 ? 1 : 0",
        f".tran {circuit.t_edge_s} {(clocks + 2) / circuit.f_clk_hz:.12e} 0 {step_s} uic",
        ".end",
    ]
    _write(where, "deck.cir", lines)
    environment = {"SPICE_NETLIST": "deck.cir", "HDL_INSTANCE": "bench_peer.u_analog"}
    environment |= {"VCC": "1.0", "SPICE_DUMP_RAW": "1"}
    command = ["vvp", "-M", str(Path(package.__file__).parent), "-m", "spicebind_vpi", str(program)]
    begin = time.perf_counter()
    children.run_child(command, where, where / "console.log", limit_s, environment)
    seconds = time.perf_counter() - begin
    return _judged(circuit, seconds, *_raw(where / "dump.raw", "v_int"), _pulses(where))


def cocotbext_ams(
    circuit: Circuit, step_s: float, clocks: int, where: Path, limit_s: float, options: str = OPTIONS
) -> Run:
    """Run cocotbext-ams: its bridge in a cocotb test on Icarus, exchanging every step_s."""
    circuit = _short(circuit, clocks)
    _compiled(circuit, where, "-DNO_INSTANCE")
    # It needs a subckt with the pins in its own order, and writes the sources itself.
    blocks = circuits.blocks(circuit)
    inner = [
        ".subckt bench_analog d_charge comp vdd_unused vss_unused",
        *(line for line in blocks if not line.startswith(".")),
        "bcomp comp 0 v = v(comp0) > 0 ? 1 : 0",
        ".ends",
    ]
    _write(where, "analog.sp", inner)
    whole = (line for line in blocks if line.startswith((".include", ".ic")))
    outer = [*(line.replace("v(xvfc", "v(x1.xvfc") for line in whole), ".save v(x1.xvfc.v_int)", options]
    job = step_s, (clocks + 2) / circuit.f_clk_hz, outer
    seconds, waves = circuits.in_simulator(_ams_run, job, "icarus", where, "bench_peer", where, limit_s)
    return _judged(circuit, seconds, *waves.T, _pulses(where))


async def _ams_run(dut: Any, job: tuple[float, float, list[str]], where: Path) -> tuple[float, Floats]:
    """Return the wall time in seconds, and [points, 2] times and voltages."""
    import cocotbext.ams as ams
    from cocotbext.ams import _bridge

    step_s, end_s, lines = job
    write, points = _bridge.generate_netlist, []
    # `dc 0 external` crashes libngspice 39.
    _bridge.generate_netlist = lambda **told: [
        re.sub(r" dc \S+ external", " external", line) for line in write(**told)
    ]
    pins = {"d_charge": ams.DigitalPin("input", vdd=1.0), "comp": ams.DigitalPin("output", vdd=1.0)}
    block = ams.AnalogBlock(
        name="bench_analog", spice_file=where / "analog.sp", subcircuit="bench_analog", digital_pins=pins,
        vdd=1.65, vss=-1.65, tran_step=f"{step_s * 1e9:g}n", extra_lines=lines,
    )  # fmt: skip
    chip = ams.MixedSignalBridge(dut, [block], max_sync_interval_ns=step_s * 1e9)
    make = chip._create_simulator

    class Writer:
        """Replacement for its waveform writer, which calls it with keywords."""

        def write_values(self, sim_time: float, analog_values: dict[str, float], digital_values: Any) -> None:
            points.append((sim_time, next(v for name, v in analog_values.items() if "v_int" in name)))

        def close(self) -> None:
            pass

    def watched(kind: str) -> Any:
        simulator = make(kind)
        simulator._vcd_writer = Writer()
        return simulator

    chip._create_simulator = watched
    begin = time.perf_counter()
    await chip.start(duration_ns=end_s * 1e9)
    return time.perf_counter() - begin, np.array(points).reshape(-1, 2)


GUESTS: dict[str, Callable[..., Run]] = {"spicebind": spicebind, "cocotbext_ams": cocotbext_ams}
"""Simulators that are measured if they are installed."""
PEERS = {"xspice": xspice, **GUESTS}


def badcrossbar(network: Network, limit_s: float, repeat: int) -> tuple[float, Floats]:
    """Return processor seconds of badcrossbar for all rows of a frame at once, and column currents [rows, cols].

    It has a process of its own; raises SimulatorError if it failed or took too long.
    """
    [(_, outcome)] = workers.run([workers.Task(_badcrossbar, (network, repeat), limit_s)], 1)
    if outcome.fault:
        raise SimulatorError(outcome.fault)
    return outcome.value


def _badcrossbar(network: Network, repeat: int) -> tuple[float, Floats]:
    import badcrossbar as package

    logging.disable(logging.CRITICAL)
    applied = network.v_bias_v * np.eye(len(network.g_taxel_s))
    words = {"r_i_word_line": network.r_trace_row_ohm, "r_i_bit_line": network.r_trace_column_ohm}
    words |= {"node_voltages": False, "all_currents": False}  # its fastest form
    compute = partial(package.compute, applied, 1.0 / network.g_taxel_s, **words)
    found, seconds = zip(*(cpu_once(compute) for _ in range(1 + repeat)), strict=True)
    return statistics.median(seconds[1:]), np.asarray(found[-1].currents.output)
