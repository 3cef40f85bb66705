# SPDX-License-Identifier: Apache-2.0
"""The converter of the benchmark in other mixed-signal simulators; none of their code is in this
tree.

Each gets the same circuit, flip-flops and solver options, and is compared with the same exact
solution for the charge pulses of its own digital side. XSPICE comes with ngspice; the
other two are measured if they are installed.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import pickle
import re
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.chip import hdl
from dermis.chip.sources import rtl_sources
from dermis.converter.vfc import count_rational
from dermis.errors import InputError, SimulatorError
from dermis.files import write_atomic
from tb.programs.bench import circuit as circuits
from tb.programs.bench.circuit import Circuit, Floats

AMS_VARIABLE = "DERMIS_BENCH_AMS"

PIP = {"spicebind": "spicebind==0.0.2", "cocotbext_ams": "cocotbext-ams==0.1.0"}
"""Versions measured; `pip install --no-deps` adds them to .venv."""


@dataclass(frozen=True)
class PeerRun:
    """Voltage error in volt, |pulses - exact|, and wall time of the clocks; NaN seconds if not
    timed.
    """

    error_v: float
    count_error: int
    clocks: int
    seconds: float = np.nan

    @property
    def rate(self) -> float:
        """Clocks a second."""
        return self.clocks / self.seconds


def missing(name: str) -> str | None:
    """Return the reason why a peer cannot be measured here, or None."""
    module = {"spicebind": "spicebind", "cocotbext_ams": "cocotbext.ams"}[name]
    try:
        found = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        found = None
    if found is None:
        return f"not installed; to measure it here: .venv/bin/pip install --no-deps {PIP[name]}"
    return None


def short(circuit: Circuit, clocks: int) -> Circuit:
    """Return the circuit without clocks before the gate, for a peer."""
    return dataclasses.replace(circuit, settle_clocks=0, gate_clocks=clocks, preset=False)


def _judge(
    circuit: Circuit, time_s: Floats, voltage: Floats, told: NDArray[Any], late_s: float
) -> tuple[float, int]:
    """Compare a waveform and the switch states at clocks 0.. with the exact solution and the exact
    count.
    """
    if (
        time_s.size < told.size
        or time_s[-1] < told.size / circuit.f_clk_hz
        or not set(np.unique(told)) <= {0, 1}
    ):
        raise SimulatorError(
            f"the waveform ends at {time_s[-1] if time_s.size else 0:g} s, or its pulses are not bits"
        )
    at_edges = np.interp(np.arange(1, told.size + 1) / circuit.f_clk_hz, time_s, voltage)
    error = np.abs(at_edges - circuits.exact_voltage(circuit, told, late_s)[1:])
    # A decision reaches the switch one clock later, and none can fall on clock 0.
    return float(error.max()), abs(int(told.sum()) - count_rational(circuit.duty, told.size - 2))


# ---- ngspice with XSPICE ----------------------------------------------------------------------------------------

# The shortest delay of XSPICE; a clock edge takes three of them to the ramp of the charge.
_T_GATE_S = 1e-12


def xspice(
    circuit: Circuit,
    t_max_step_s: float,
    clocks: int,
    where: Path,
    limit_s: float,
    options: str = circuits.OPTIONS,
) -> PeerRun:
    """Run plain ngspice: bridges, two d_dff and a gate as event-driven code models, clock from a
    d_source file.
    """
    where.mkdir(parents=True)
    circuit = short(circuit, clocks)
    t_clk = 1.0 / circuit.f_clk_hz
    ticks = [f"{n * t_clk:.12e} 1s\n{(n + 0.5) * t_clk:.12e} 0s\n" for n in range(1, clocks + 2)]
    (where / "clock.txt").write_text("0.0 0s\n" + "".join(ticks))
    delays = " ".join(f"{name}={_T_GATE_S}" for name in ("rise_delay", "fall_delay"))
    lines = [
        "one converter with event-driven code models",
        *circuits.blocks(circuit, options=options),
        *circuits.start_lines(circuit),
        "aclk [clk] ticks",
        '.model ticks d_source(input_file="clock.txt")',
        "acmp [comp0] [comp] adc",
        f".model adc adc_bridge(in_low=0 in_high=0 {delays})",
        "ainv sample sample_n inv",
        f".model inv d_inverter({delays})",
        "aand [comp sample_n] sample_d gate",
        f".model gate d_and({delays})",
        "asample sample_d clk null null sample null flop",
        "apulse sample clk null null pulse null flop",
        f".model flop d_dff(clk_delay={_T_GATE_S} ic=0 {delays})",
        "adac [pulse] [d_charge] dac",
        f".model dac dac_bridge(out_low=0 out_high=1 t_rise={circuit.t_edge_s} t_fall={circuit.t_edge_s})",
        ".save v(xvfc.v_int) v(d_charge)",
        ".control",
        "set numdgt=15",
        "shell date +BENCH_%s.%N",
        f"tran {circuit.t_edge_s} {(clocks + 0.75) * t_clk:.12e} 0 {t_max_step_s} uic",
        "shell date +BENCH_%s.%N",
        "wrdata waves.dat v(xvfc.v_int) v(d_charge)",
        "quit",
        ".endc",
        ".end",
    ]
    (where / "deck.cir").write_text("\n".join(lines) + "\n")
    tool = shutil.which("ngspice")
    if tool is None:
        raise InputError("PATH", "ngspice", "missing", "ngspice; `make setup` installs it")
    circuits.call([tool, "-b", "deck.cir"], where, limit_s)
    try:
        begin, end = (float(t) for t in re.findall(r"BENCH_(\d+\.\d+)", (where / "console.log").read_text()))
        time_s, v_int, _, charge = np.loadtxt(where / "waves.dat").T
    except (OSError, ValueError) as error:
        raise SimulatorError(f"ngspice wrote no waveform: {error}", where) from None
    middles = (np.arange(clocks) + 0.5) * t_clk
    told = np.round(np.interp(middles, time_s, charge), 6)
    error_v, count_error = _judge(circuit, time_s, v_int, told, late_s=2 * _T_GATE_S)
    return PeerRun(error_v, count_error, clocks, end - begin)


# ---- SpiceBind --------------------------------------------------------------------------------------------------

# The flip-flops are the project's. Reset ends after clock 1, whose decision is 0 in any case, so
# that the level that the plug-in has not yet driven is not sampled.
_VERILOG = """`timescale 1ns/1ps
`ifndef NO_INSTANCE
module bench_analog(input wire d_charge, output wire comp);
endmodule
`endif
module bench_peer;
  parameter CLOCKS = 100;
  reg clk = 1'b0;
  reg rst_n = 1'b1;
  wire d_charge;
  integer n = 0, file;
`ifdef NO_INSTANCE
  reg comp, seen;
  always @(comp) seen = comp;
`else
  wire comp;
  wire seen = comp;
  bench_analog u_analog (.d_charge (d_charge), .comp (comp));
`endif
  dermis_sync_ff u_sync (.clk_i (clk), .rst_ni (rst_n), .inhibit_i (1'b0), .comp_async_i (seen), .pulse_o (d_charge));
  initial begin
    file = $fopen("told.txt");
    #1 rst_n = 1'b0;
    #1499 rst_n = 1'b1;
  end
  always begin
    #500 clk = 1'b0;
    #500 clk = 1'b1;
  end
  always @(posedge clk) begin
    n = n + 1;
    if (n <= CLOCKS) $fdisplay(file, "%b", d_charge);
    if (n == CLOCKS) $fclose(file);
`ifndef NO_INSTANCE
    if (n == CLOCKS + 1) $finish;
`endif
  end
endmodule
"""


def _compile(circuit: Circuit, clocks: int, where: Path, *options: str) -> Path:
    if circuit.f_clk_hz != 1e6:
        raise ValueError("the test bench has a clock of 1 MHz")
    (where / "bench_peer.v").write_text(_VERILOG)
    tool = shutil.which("iverilog")
    if tool is None:
        raise InputError("PATH", "iverilog", "missing", "Icarus Verilog; `make setup` installs it")
    needed = [path for path in rtl_sources() if path.stem in ("dermis_sync_ff", "dermis_tech_dff")]
    options = (f"-Pbench_peer.CLOCKS={clocks}", *options)
    command = [tool, "-g2012", "-s", "bench_peer", *options, "-o", "sim.vvp", "bench_peer.v", *needed]
    circuits.call(command, where, 60, "compile.log")
    if not (where / "sim.vvp").exists():
        raise SimulatorError("Icarus does not build the test bench", where / "compile.log")
    return where / "sim.vvp"


def _judged(
    circuit: Circuit, clocks: int, where: Path, seconds: float, wave: tuple[Floats, Floats] | None
) -> PeerRun:
    """Compare the waveform of a run, and the pulses that the test bench wrote, with the exact
    solution; without a waveform only time it.
    """
    try:
        # Switch states from clock 0 on: each line is the state at the next clock.
        told = np.array([int(line) for line in (where / "told.txt").read_text().split()])
    except (OSError, ValueError) as error:
        raise SimulatorError(f"the test bench wrote no pulses: {error}", where) from None
    if told.size < clocks:
        raise SimulatorError(f"the run ended after {told.size} of {clocks} clocks", where)
    if wave is None:
        return PeerRun(np.nan, 0, clocks, seconds)
    error_v, count_error = _judge(circuit, *wave, told[:clocks], late_s=0.0)
    return PeerRun(error_v, count_error, clocks, seconds)


def _raw(path: Path, node: str) -> tuple[Floats, Floats]:
    """Return time and one voltage of a binary ngspice raw file."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SimulatorError(f"no waveform: {error}", path.parent) from None
    head, _, body = content.partition(b"Binary:\n")
    text = head.decode(errors="replace")
    names = [line.split()[1] for line in text.partition("Variables:\n")[2].strip().splitlines()]
    values = np.frombuffer(body, "<f8")
    values = values[: values.size // len(names) * len(names)].reshape(-1, len(names))
    return values[:, 0], values[:, next(i for i, name in enumerate(names) if node in name)]


def spicebind(
    circuit: Circuit,
    t_max_step_s: float,
    clocks: int,
    where: Path,
    limit_s: float,
    waves: bool = True,
    options: str = circuits.OPTIONS,
) -> PeerRun:
    """Run SpiceBind: Icarus with its VPI plug-in; its wall time is from start to end of the
    process.
    """
    import spicebind as package

    where.mkdir(parents=True)
    circuit = short(circuit, clocks)
    program = _compile(circuit, clocks, where)
    lines = [
        "one converter",
        *circuits.blocks(circuit, options=options),
        *circuits.start_lines(circuit),
        "vd_charge d_charge 0 external",
        "bcomp comp 0 v = v(comp0) > 0 ? 1 : 0",
        f".tran {circuit.t_edge_s} {(clocks + 2) / circuit.f_clk_hz:.12e} 0 {t_max_step_s} uic",
        ".end",
    ]
    (where / "deck.cir").write_text("\n".join(lines) + "\n")
    environment = {"SPICE_NETLIST": "deck.cir", "HDL_INSTANCE": "bench_peer.u_analog", "VCC": "1.0"}
    if waves:
        environment["SPICE_DUMP_RAW"] = "1"
    plugin = Path(package.__file__).parent
    begin = time.perf_counter()
    circuits.call(["vvp", "-M", plugin, "-m", "spicebind_vpi", program], where, limit_s, **environment)
    seconds = time.perf_counter() - begin
    return _judged(circuit, clocks, where, seconds, _raw(where / "dump.raw", "v_int") if waves else None)


# ---- cocotbext-ams ----------------------------------------------------------------------------------------------


def cocotbext_ams(
    circuit: Circuit,
    t_max_step_s: float,
    clocks: int,
    where: Path,
    limit_s: float,
    waves: bool = True,
    options: str = circuits.OPTIONS,
) -> PeerRun:
    """Run cocotbext-ams: its bridge in a cocotb test on Icarus, exchanging every t_max_step_s."""
    where.mkdir(parents=True)
    circuit = short(circuit, clocks)
    # Icarus 11 does not carry a forced value through ports and assignments; a process sees it.
    _compile(circuit, clocks, where, "-DNO_INSTANCE")
    # It needs a subckt with the pins in its own order, and writes the sources itself.
    inner = [
        ".subckt bench_analog d_charge comp vdd_unused vss_unused",
        *(line for line in circuits.blocks(circuit) if not line.startswith((".include", ".options"))),
        "vhold d_hold 0 0",
        "bcomp comp 0 v = v(comp0) > 0 ? 1 : 0",
        ".ends",
    ]
    (where / "analog.sp").write_text("\n".join(inner) + "\n")
    starts = ["v_int"] + (["xintegrator.v_amp"] if circuit.t_gbw_s else [])
    told = {
        "step_s": t_max_step_s,
        "end_s": (clocks + 2) / circuit.f_clk_hz,
        "waves": waves,
        "lines": [f".ic v(x1.xvfc.{node})={circuit.v_start_v!r}" for node in starts] + [options],
    }
    write_atomic(where / "limits.json", json.dumps(told))
    command = [sys.executable, "-m", "tb.programs.bench.peers", where]
    circuits.call(command, where, limit_s, **{AMS_VARIABLE: str(where)})
    time_s, v_int, seconds = circuits.result(where)
    return _judged(circuit, clocks, where, seconds, (time_s, v_int) if waves else None)


def _ams_main(where: Path) -> None:
    hdl.run_cocotb("icarus", where, "bench_peer", "tb.programs.bench.peers", where, {})


async def _ams_run(dut: Any, where: Path) -> None:
    import cocotbext.ams as ams
    from cocotbext.ams import _bridge

    told = json.loads((where / "limits.json").read_text())
    step = told["step_s"]
    write = _bridge.generate_netlist

    def without_dc(**options: Any) -> list[str]:
        # `dc 0 external` crashes libngspice 39.
        return [re.sub(r" dc \S+ external", " external", line) for line in write(**options)]

    _bridge.generate_netlist = without_dc
    block = ams.AnalogBlock(
        name="bench_analog",
        spice_file=where / "analog.sp",
        subcircuit="bench_analog",
        digital_pins={
            "d_charge": ams.DigitalPin("input", vdd=1.0),
            "comp": ams.DigitalPin("output", vdd=1.0),
        },
        vdd=1.65,
        vss=-1.65,
        tran_step=f"{step * 1e9:g}n",
        extra_lines=[
            f'.include "{circuits.netlist.SPICE / "design.inc"}"',
            f'.include "{circuits.netlist.SPICE / "behavioural" / "blocks.inc"}"',
            ".save v(x1.xvfc.v_int)",
            *told["lines"],
        ],
    )
    chip = ams.MixedSignalBridge(dut, [block], max_sync_interval_ns=step * 1e9)
    points: list[tuple[float, float]] = []

    class Watch:
        """Replacement for its waveform writer."""

        # Called with keywords.
        def write_values(self, sim_time: float, analog_values: dict[str, float], digital_values: Any) -> None:
            names = ("v(x1.xvfc.v_int)", "x1.xvfc.v_int")
            found = next((analog_values[name] for name in names if name in analog_values), np.nan)
            points.append((sim_time, found))

        def close(self) -> None:
            pass

    make = chip._create_simulator

    def watched(kind: str) -> Any:
        simulator = make(kind)
        simulator._vcd_writer = Watch()
        return simulator

    if told["waves"]:
        chip._create_simulator = watched
    begin = time.perf_counter()
    await chip.start(duration_ns=told["end_s"] * 1e9)
    seconds = time.perf_counter() - begin
    table = np.array(points).reshape(-1, 2)
    write_atomic(where / "result.pickle", pickle.dumps((table[:, 0], table[:, 1], seconds)))


if AMS_VARIABLE in os.environ and __name__ != "__main__":
    import cocotb

    @cocotb.test()
    async def converter(dut: Any) -> None:
        """Run the converter; a failure is written to error.txt for the parent."""
        where = Path(os.environ[AMS_VARIABLE])
        try:
            await _ams_run(dut, where)
        except Exception as error:
            write_atomic(where / "error.txt", f"{type(error).__name__}: {error}\n")
            raise


GUESTS: dict[str, Callable[..., PeerRun]] = {"spicebind": spicebind, "cocotbext_ams": cocotbext_ams}
"""Peers other than XSPICE: (circuit, t_max_step_s, clocks, where, limit_s, waves) -> PeerRun; no
waves, no error.
"""


def rate(
    peer: str, circuit: Circuit, t_max_step_s: float, place: Callable[[], Path], limit_s: float
) -> float:
    """Return clocks per second from the difference of a long and a short run, without start and end
    of the process.
    """
    few, clocks = 100, 400

    def seconds(clocks: int) -> float:
        return GUESTS[peer](circuit, t_max_step_s, clocks, place(), limit_s, waves=False).seconds

    short_s = seconds(few)
    # The ends of processes differ by about 10 ms, so the difference must be far longer.
    while (more_s := seconds(clocks) - short_s) < 0.6:
        clocks *= 4
        if clocks > 200_000:
            raise SimulatorError(f"{peer}: {clocks} clocks are too short to time")
    return (clocks - few) / more_s


if __name__ == "__main__":
    _ams_main(Path(sys.argv[1]))
