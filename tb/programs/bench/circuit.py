# SPDX-License-Identifier: Apache-2.0
"""One converter: dermis_top with one column in lock-step with a circuit whose exact solution is
known.

A job runs in a separate process, in a directory with job.pickle, and writes result.pickle or
error.txt, and logs. The HDL simulator loads this module again as the cocotb test; a job without a
simulator drives ngspice alone.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from dermis.chip import bridge, hdl, netlist
from dermis.chip.analog import AnalogHalf, Edge
from dermis.chip.ngspice import Deck, NgspiceHalf
from dermis.chip.spice_text import spice_number
from dermis.converter.vfc import count_rational
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.processes import children
from dermis.records import Timing

Floats = NDArray[np.float64]

JOB_VARIABLE = "DERMIS_BENCH_JOB"

ROW, PRESET, CHARGE = range(3)
"""Sources of a deck with one row and one column."""

# The decks of the peers have the same line, which does not harm them.
OPTIONS = netlist.options(pole=False)


@dataclass(frozen=True)
class Circuit:
    """The circuit of the benchmark: 1 uA into 10 pF for 1 us is a packet of 0.1 V.

    The circuit starts where the row is driven, `break_clocks` after the slot of the chip. Without a
    preset the integrator starts above half a packet and is at w = -1/2 when the gate opens. With
    `preset` it is held at half a packet until then, as on the chip. With `t_gbw_s` the amplifier's
    output follows the charge with this time constant, 1 / (2 pi gain-bandwidth).
    """

    i_in_a: float = 0.3717e-6  # 371.7 packets in 1000 clocks: no short cycle, and far from a tie
    i0_a: float = 1e-6
    c_int_f: float = 10e-12
    f_clk_hz: float = 1e6
    t_edge_s: float = 1e-9
    settle_clocks: int = 8
    gate_clocks: int = 1000
    break_clocks: int = 1
    preset: bool = False
    t_gbw_s: float = 0.0

    @property
    def timing(self) -> Timing:
        """One row slot; the counter has 12 bits, so it never saturates."""
        return Timing(
            f_clk_hz=self.f_clk_hz,
            slot_clocks=self.break_clocks + self.clocks,
            settle_clocks=self.break_clocks + self.settle_clocks,
            gate_clocks=self.gate_clocks,
            code_max=2**12 - 1,
            rows=1,
            break_clocks=self.break_clocks,
        )

    @property
    def clocks(self) -> int:
        """Clocks of a run of the circuit."""
        return self.settle_clocks + self.gate_clocks

    @property
    def parameters(self) -> dict[str, int]:
        """Parameters of dermis_top."""
        return {
            "ROWS": 1,
            "COLS": 1,
            "CODE_BITS": 12,
            "GATE_CLOCKS": self.gate_clocks,
            "SETTLE_CLOCKS": self.break_clocks + self.settle_clocks,
            "BREAK_CLOCKS": self.break_clocks,
            "SYNC_LATCH": 0,
        }

    @property
    def packet_v(self) -> float:
        """One packet on the capacitor."""
        return self.i0_a / self.f_clk_hz / self.c_int_f

    @property
    def duty(self) -> Fraction:
        """Packets per clock, from the decimals as written."""
        return Fraction(repr(self.i_in_a)) / Fraction(repr(self.i0_a))

    @property
    def first(self) -> int:
        """Clock at which integration starts."""
        return self.settle_clocks if self.preset else 0

    @property
    def v_start_v(self) -> float:
        """Integrator at clock `first`: half a packet at the opening of the gate."""
        return (0.5 + float(self.duty) * (self.settle_clocks - self.first)) * self.packet_v

    @property
    def pulses(self) -> int:
        """Exact count in rationals."""
        return count_rational(self.duty, self.gate_clocks)


def blocks(circuit: Circuit, packet_error: float = 0.0, options: str = OPTIONS) -> list[str]:
    """Return the netlist of the converter in our blocks: nodes d_charge, d_hold in; comp0,
    xvfc.v_int out.
    """
    values = {
        "i0_a": circuit.i0_a,
        "c_int_f": circuit.c_int_f,
        "v_preset_v": 0.5 * circuit.packet_v,
        "packet_error": packet_error,
    }
    if circuit.t_gbw_s:
        values["int_t_gbw_s"] = circuit.t_gbw_s
    return [
        f'.include "{netlist.SPICE / "design.inc"}"',
        f'.include "{netlist.SPICE / "behavioural" / "blocks.inc"}"',
        "vdd vdd 0 1.65",
        "vss vss 0 -1.65",
        "vibias ibias 0 0",
        f"iin 0 v_sum {spice_number(circuit.i_in_a)}",
        "xvfc v_sum d_charge d_hold comp0 0 0 ibias vdd vss 0 0 vfc "
        + " ".join(f"{name}={spice_number(value)}" for name, value in values.items()),
        options,
    ]


def start_lines(circuit: Circuit) -> list[str]:
    """Return the replacement of the preset: no hold, and the integrator's voltage as initial
    condition (for `uic`).
    """
    start = spice_number(circuit.v_start_v)
    lines = ["vhold d_hold 0 0", f".ic v(xvfc.v_int)={start}"]
    if circuit.t_gbw_s:
        lines.append(f".ic v(xvfc.xintegrator.v_amp)={start}")
    return lines


def deck(
    circuit: Circuit,
    levels: Sequence[float] = (1.0, 1.0, 0.0),
    packet_error: float = 0.0,
    options: str = OPTIONS,
) -> Deck:
    """Return the circuit for lock-step; probes are the comparator, then the integrator."""
    names = netlist.source_names(1, 1)
    nodes = ["d_row0", "d_hold" if circuit.preset else "d_preset", "d_charge"]
    lines = ["one converter", *blocks(circuit, packet_error, options)]
    lines += [f"{name} {node} 0 external" for name, node in zip(names, nodes, strict=True)]
    if not circuit.preset:
        lines += start_lines(circuit)
    abrupt = (False, circuit.preset, False)
    return Deck(tuple(lines), names, tuple(levels), abrupt, ("comp0", "xvfc.v_int"))


def exact_voltage(circuit: Circuit, charge: NDArray[Any], late_s: float = 0.0) -> Floats:
    """Return the integrator voltage at the clocks first, first + 1, ... of the exact solution.

    Parameters
    ----------
    circuit : Circuit
    charge : array_like of 0 and 1
        State of the charge switch at each clock from `first` on; it was off before. A switch that changes at
        clock n moves on a straight line between n T and n T + t_edge.
    late_s : float
        Delay of that line after the clock, for a bridge with a known delay.

    Notes
    -----
    v(n) = v_start - packet (n x - sum of whole clocks charged + (t_edge / 2 + late) / T while a packet is running):
    equal ramps up and down make every finished packet whole.
    """
    if circuit.t_gbw_s:
        return _exact_with_pole(circuit, charge, late_s)
    told = np.asarray(charge, dtype=float)
    before = np.concatenate([[0.0], told])  # in the clock that ends here
    whole = np.concatenate([[0.0], np.cumsum(told)])
    running = (0.5 * circuit.t_edge_s + late_s) * circuit.f_clk_hz * before
    clocks = np.array([float(n * circuit.duty) for n in range(whole.size)])
    return circuit.v_start_v - circuit.packet_v * (clocks - (whole - running))


@mp.workdps(50)
def _exact_with_pole(circuit: Circuit, charge: NDArray[Any], late_s: float) -> Floats:
    """Return `exact_voltage` with the amplifier's pole, in 50 digits: t v' = u - v with u the
    voltage without the pole.

    u is a parabola while the charge switch moves and a straight line elsewhere. Of u = a + b s + c s^2 follows
    v = p(s) + (v(0) - p(0)) exp(-s / t) with p = u - t u' + t^2 u''.
    """
    t_clk, t = 1 / mpf(repr(circuit.f_clk_hz)), mpf(repr(circuit.t_gbw_s))
    ramp, late = mpf(repr(circuit.t_edge_s)), mpf(repr(late_s))
    fall = mpf(repr(circuit.i_in_a)) / mpf(repr(circuit.c_int_f))
    rise = mpf(repr(circuit.i0_a)) / mpf(repr(circuit.c_int_f))
    u = v = mpf(circuit.v_start_v)
    decay = {span: mp.exp(-span / t) for span in (late, ramp, t_clk - late - ramp)}
    found, before = [v], 0
    for told in [int(bit) for bit in charge]:
        for span, level, change in (
            (late, before, 0),
            (ramp, before, told - before),
            (t_clk - late - ramp, told, 0),
        ):
            if not span:
                continue
            b, c = rise * level - fall, rise * change / (2 * span)
            end = u + b * span + c * span**2
            p_begin = u - t * b + 2 * t**2 * c
            p_end = end - t * (b + 2 * c * span) + 2 * t**2 * c
            u, v = end, p_end + (v - p_begin) * decay[span]
        before = told
        found.append(v)
    return np.array([float(x) for x in found])


def edge_error_v(circuit: Circuit, voltage: Floats, charge: NDArray[Any]) -> float:
    """Return the largest |voltage - exact| over the clock edges after the start.

    Parameters
    ----------
    circuit : Circuit
    voltage : ndarray
        Integrator at clocks 0, 1, ... to the end; values before the start are ignored.
    charge : ndarray
        State of the charge switch at clocks 1, 2, ... to the end.
    """
    first = circuit.first
    told = np.concatenate([[0], charge])[first:-1]
    if voltage.shape != (told.size + first + 1,) or told.size < 1:
        raise ValueError(f"{voltage.size} samples and {charge.size} switch states do not match")
    return float(np.max(np.abs(voltage[first + 1 :] - exact_voltage(circuit, told)[1:])))


def walk(half: AnalogHalf, circuit: Circuit, charge: Sequence[int]) -> None:
    """Advance an analog half to the end, with these states of the charge switch at clocks 1, 2, ...

    The preset falls as the gate opens.
    """
    t_clk = 1.0 / circuit.f_clk_hz
    half.advance(0.0, [])
    edges: list[Edge] = []
    last = 0
    for clock, told in enumerate(charge, 1):
        now = clock * t_clk
        half.advance(now, edges)
        edges = [] if told == last else [(now, CHARGE, float(told))]
        if clock == circuit.settle_clocks:
            edges.append((now, PRESET, 0.0))
        last = told


# ---- a run in a separate process -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """Job of the child: `frames` runs of the circuit.

    `simulator` None drives ngspice alone with the charge bits `charge`; `keep` returns the bits and
    voltages at the bridge. `options` is the deck's line of options; `cuts` as for `NgspiceHalf`.

    The last two are seeded faults for a test: packets in ngspice are too large by
    `packet_error`, or the 50th switching of the charge is late by `late_s`.
    """

    circuit: Circuit
    frames: int
    t_max_step_s: float = 1e-6
    simulator: str | None = "icarus"
    keep: bool = False
    charge: NDArray[Any] | None = None
    packet_error: float = 0.0
    late_s: float = 0.0
    options: str = OPTIONS
    cuts: int = 0


@dataclass(frozen=True)
class Run:
    """Result of a job, one entry or row per frame; bits and voltages only if the job keeps them.

    `seconds` and `cpu_seconds` count from the first instant of the circuit to its last; `charge`
    [frames, clocks] is the state of the charge switch at clocks 1.., `voltage` [frames, clocks + 1]
    the integrator at clocks 0.. (without a preset, ngspice gives none at 0).
    """

    codes: NDArray[Any]
    seconds: Floats
    cpu_seconds: Floats
    charge: NDArray[Any] | None = None
    voltage: Floats | None = None

    def rate(self, circuit: Circuit) -> float:
        """Clocks per second, median of the frames."""
        return float(np.median(circuit.clocks / self.seconds))

    def cpu_per_clock_s(self, circuit: Circuit) -> float:
        """Processor seconds per clock, median of the frames."""
        return float(np.median(self.cpu_seconds)) / circuit.clocks

    def miscount(self, circuit: Circuit) -> int:
        """Largest difference of a code from the exact count."""
        return int(np.max(np.abs(self.codes - circuit.pulses))) if len(self.codes) else 0

    def error_v(self, circuit: Circuit) -> float:
        """Largest error of the integrator in the first frame of a job that keeps its voltages."""
        assert self.voltage is not None
        assert self.charge is not None
        return edge_error_v(circuit, self.voltage[0], self.charge[0])


class _Watched:
    """An analog half that measures the time from its first answer to its end."""

    def __init__(self, inner: Any, job: Job) -> None:
        self._inner, self._job, self._switched = inner, job, 0
        self.voltage: list[float] = []
        self.seconds = self.cpu_seconds = 0.0

    def advance(self, to: float, edges: Sequence[Edge]) -> Floats:
        sample = self._inner.advance(to, self._with_fault(edges) if self._job.late_s else edges)
        if self._job.keep:
            self.voltage.append(float(sample[1]))
        elif not self._job.late_s:
            self.advance = self._inner.advance  # type: ignore[method-assign]  # no detour from now on
        if to == 0.0:
            self._start = time.perf_counter(), time.process_time()
        return sample

    def _with_fault(self, edges: Sequence[Edge]) -> list[Edge]:
        heard = []
        for now, source, level in edges:
            self._switched += source == CHARGE
            late = self._job.late_s if source == CHARGE and self._switched == 50 else 0.0
            heard.append((now + late, source, level))
        return heard

    def close(self) -> None:
        self.seconds = time.perf_counter() - self._start[0]
        self.cpu_seconds = time.process_time() - self._start[1]
        self._inner.close()


def _half(job: Job, where: Path, levels: Sequence[float] = (1.0, 1.0, 0.0)) -> _Watched:
    circuit = job.circuit
    inner = NgspiceHalf(
        deck(circuit, levels, job.packet_error, job.options),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=job.t_max_step_s,
        t_stop_s=bridge.analog_s(circuit.timing),
        log=where / "ngspice.log",
        use_ic=not circuit.preset,
        cuts=job.cuts,
    )
    return _Watched(inner, job)


def _run(codes: Any, halves: Sequence[_Watched], charge: Any) -> Run:
    voltage = None if charge is None else np.array([half.voltage for half in halves])
    seconds, cpu = (np.array([getattr(half, n) for half in halves]) for n in ("seconds", "cpu_seconds"))
    return Run(np.asarray(codes), seconds, cpu, None if charge is None else np.asarray(charge), voltage)


async def _frames(dut: Any, job: Job, where: Path) -> Run:
    halves: list[_Watched] = []

    def make_half(frame: int, levels: list[float]) -> Any:
        halves.append(_half(job, where, levels))
        return halves[-1]

    chip = bridge.Bridge(dut, job.circuit.timing, 1, trace=job.keep)
    codes = await chip.run(job.frames, make_half)
    charge = None
    if chip.trace is not None:
        bits = chip.trace.charge
        charge = [bits[begin : begin + job.circuit.clocks] for begin in chip.trace.begins]
    return _run(codes.ravel(), halves, charge)


def _alone(job: Job, where: Path) -> Run:
    assert job.charge is not None
    halves = [_half(job, where) for _ in range(job.frames)]
    for half in halves:
        walk(half, job.circuit, job.charge.tolist())
        half.close()
    return _run([], halves, [job.charge] * job.frames if job.keep else None)


def _leave(where: Path, name: str, value: Any) -> None:
    write_atomic(where / name, pickle.dumps(value))


def main(where: Path) -> None:
    """Run the job of a directory and write result.pickle or error.txt there."""
    job, build = pickle.loads((where / "job.pickle").read_bytes())
    try:
        if job.simulator is None:
            _leave(where, "result.pickle", _alone(job, where))
        else:
            hdl.run_cocotb(
                job.simulator,
                build,
                "dermis_top",
                "tb.programs.bench.circuit",
                where,
                {JOB_VARIABLE: str(where)},
            )
    except (SimulatorError, RuntimeError, SystemExit) as error:
        if not (where / "error.txt").exists():
            write_atomic(where / "error.txt", f"{error}\n")


if JOB_VARIABLE in os.environ:
    import cocotb

    @cocotb.test()
    async def converter(dut: Any) -> None:
        """Run the frames of the job; a failure is written to error.txt for the parent."""
        where = Path(os.environ[JOB_VARIABLE])
        try:
            job, _ = pickle.loads((where / "job.pickle").read_bytes())
            _leave(where, "result.pickle", await _frames(dut, job, where))
        except Exception as error:
            write_atomic(where / "error.txt", f"{type(error).__name__}: {error}\n")
            (where / "traceback.log").write_text(traceback.format_exc())
            raise


def call(
    command: Sequence[str | Path], where: Path, limit_s: float, log: str = "console.log", **environment: str
) -> int:
    """Run a command in a directory, its output into a log there, and return its exit code.

    Raises
    ------
    SimulatorError
        It exceeded its time limit and was ended, with its children.
    """
    (where / log).unlink(missing_ok=True)
    words = [str(word) for word in command]
    environment = {"OPENBLAS_NUM_THREADS": "1", **environment}
    code = children.run_child(words, where, where / log, limit_s, environment)
    if code is None:
        raise SimulatorError(f"{Path(command[0]).name} took more than {limit_s:g} s", where / log)
    return code


def result(where: Path) -> Any:
    """Return the result that a child wrote to a directory.

    Raises
    ------
    SimulatorError
        It wrote an error, or no result.
    """
    if (where / "error.txt").exists():
        raise SimulatorError((where / "error.txt").read_text().strip(), where)
    try:
        return pickle.loads((where / "result.pickle").read_bytes())
    except OSError:
        raise SimulatorError("the process ended without a result", where) from None


def measure(job: Job, where: Path, limit_s: float) -> Run:
    """Run a job in a separate process, in a new directory.

    Raises
    ------
    SimulatorError
        It failed, took longer than `limit_s` or wrote no result.
    """
    where.mkdir(parents=True)
    build = None
    if job.simulator is not None:
        build = hdl.build(job.simulator, "dermis_top", job.circuit.parameters)
    _leave(where, "job.pickle", (job, build))
    # Not -m: the classes of the pickle belong to this module by its name.
    program = (
        "import sys, pathlib; from tb.programs.bench import circuit; circuit.main(pathlib.Path(sys.argv[1]))"
    )
    call([sys.executable, "-c", program, where], where, limit_s)
    return result(where)
