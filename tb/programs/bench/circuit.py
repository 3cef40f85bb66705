# SPDX-License-Identifier: Apache-2.0
"""One converter: dermis_top with one column in lock-step with a circuit of known solution.

The HDL simulator loads this module again as the cocotb test.
"""

import dataclasses
import math
import os
import pickle
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from dermis.chip import bridge, hdl, netlist
from dermis.chip.spice_text import spice_number
from dermis.converter.vfc import count_rational
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.lockstep.ngspice import Deck, NgspiceHalf, loaded
from dermis.ndarrays import Floats
from dermis.records import Timing

JOB_VARIABLE = "DERMIS_BENCH_JOB"

T_EDGE_S = 1e-9

# The decks of the peers have the same line, which does not harm them.
OPTIONS = netlist.options(pole=False)


@dataclass(frozen=True)
class Circuit:
    """The circuit of the benchmark: 1 uA into 10 pF for 1 us is a packet of 0.1 V.

    The circuit starts where the row is driven, one clock of break after the slot of the chip. The
    integrator starts above half a packet and is at w = -1/2 when the gate opens. With `t_gbw_s` the amplifier's
    output follows the charge with this time constant, 1 / (2 pi gain-bandwidth).
    """

    i_in_a: float = 0.3717e-6  # 371.7 packets in 1000 clocks: no short cycle, and far from a tie
    i0_a: float = 1e-6
    c_int_f: float = 10e-12
    f_clk_hz: float = 1e6
    t_edge_s: float = T_EDGE_S
    settle_clocks: int = 8
    gate_clocks: int = 1000
    t_gbw_s: float = 0.0

    @property
    def timing(self) -> Timing:
        """One row slot; the counter has 12 bits, so it never saturates."""
        clocks = 1 + self.clocks, 1 + self.settle_clocks, self.gate_clocks
        return Timing(self.f_clk_hz, *clocks, 2**12 - 1, rows=1, break_clocks=1)

    @property
    def clocks(self) -> int:
        return self.settle_clocks + self.gate_clocks

    @property
    def parameters(self) -> dict[str, int]:
        clocks = {"GATE_CLOCKS": self.gate_clocks, "SETTLE_CLOCKS": 1 + self.settle_clocks}
        return {"ROWS": 1, "COLS": 1, "CODE_BITS": 12, "BREAK_CLOCKS": 1, "SYNC_LATCH": 0} | clocks

    @property
    def packet_v(self) -> float:
        """One packet on the capacitor."""
        return self.i0_a / self.f_clk_hz / self.c_int_f

    @property
    def duty(self) -> Fraction:
        """Packets per clock, from the decimals as written."""
        return Fraction(repr(self.i_in_a)) / Fraction(repr(self.i0_a))

    @property
    def v_start_v(self) -> float:
        """Integrator at clock 0: half a packet at the opening of the gate."""
        return (0.5 + float(self.duty) * self.settle_clocks) * self.packet_v

    @property
    def pulses(self) -> int:
        """Exact count in rationals."""
        return count_rational(self.duty, self.gate_clocks)


def blocks(circuit: Circuit, packet_error: float = 0.0, options: str = OPTIONS) -> list[str]:
    """Return the converter in our blocks: node d_charge in, comp0 and xvfc.v_int out.

    It has no preset but an initial condition of the integrator (for `uic`).
    """
    start = spice_number(circuit.v_start_v)
    values = {"i0_a": circuit.i0_a, "c_int_f": circuit.c_int_f}
    values |= {"v_preset_v": 0.5 * circuit.packet_v, "packet_error": packet_error}
    if circuit.t_gbw_s:
        values["int_t_gbw_s"] = circuit.t_gbw_s
    lines = [
        f'.include "{netlist.SPICE / "design.inc"}"',
        f'.include "{netlist.SPICE / "behavioural" / "blocks.inc"}"',
        "vdd vdd 0 1.65",
        "vss vss 0 -1.65",
        "vibias ibias 0 0",
        f"iin 0 v_sum {spice_number(circuit.i_in_a)}",
        "xvfc v_sum d_charge d_hold comp0 0 0 ibias vdd vss 0 0 vfc "
        + " ".join(f"{name}={spice_number(value)}" for name, value in values.items()),
        options,
        "vhold d_hold 0 0",
        f".ic v(xvfc.v_int)={start}",
    ]
    return [*lines, f".ic v(xvfc.xintegrator.v_amp)={start}"] if circuit.t_gbw_s else lines


def deck(
    circuit: Circuit,
    levels: Sequence[float] = (1.0, 1.0, 0.0),
    packet_error: float = 0.0,
    options: str = OPTIONS,
) -> Deck:
    """Return the circuit for lock-step; probes are the comparator, then the integrator."""
    names = netlist.source_names(1, 1)
    nodes = ["d_row0", "d_preset", "d_charge"]
    lines = ["one converter", *blocks(circuit, packet_error, options)]
    lines += [f"{name} {node} 0 external" for name, node in zip(names, nodes, strict=True)]
    return Deck(tuple(lines), names, tuple(levels), (False,) * 3, ("comp0", "xvfc.v_int"))


@mp.workdps(50)
def exact_voltage(circuit: Circuit, charge: NDArray[Any], late_s: float = 0.0) -> Floats:
    """Return the integrator voltage at the clocks 0, 1, ... of the exact solution, in 50 digits.

    `charge` has 1 where the charge switch is on, clock by clock; it was off before. A switch that changes
    at clock n moves on a straight line from n T + `late_s` on, for `t_edge_s`.

    The voltage u without the pole is a parabola u = a + b s + c s^2 while the charge switch moves, and a
    straight line elsewhere. With the pole t v' = u - v, so v = p(s) + (v(0) - p(0)) exp(-s / t) with
    p = u - t u' + t^2 u''.
    """
    t_clk, t = 1 / mpf(repr(circuit.f_clk_hz)), mpf(repr(circuit.t_gbw_s))
    ramp, late = mpf(repr(circuit.t_edge_s)), mpf(repr(late_s))
    fall = mpf(repr(circuit.i_in_a)) / mpf(repr(circuit.c_int_f))
    rise = mpf(repr(circuit.i0_a)) / mpf(repr(circuit.c_int_f))
    spans = (late, ramp, t_clk - late - ramp)
    decay = {span: mp.exp(-span / t) if t else mpf(0) for span in spans}
    u = v = mpf(circuit.v_start_v)
    found, before = [v], 0
    for told in [int(bit) for bit in charge]:
        for span, level, change in zip(spans, (before, before, told), (0, told - before, 0), strict=True):
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


@dataclass(frozen=True)
class Run:
    """Result of a simulator: its count, its errors against the exact solution, and wall time of the clocks."""

    code: int
    miscount: int
    clocks: int
    seconds: float
    error_v: float = math.nan  # largest at a clock edge, if samples are kept
    cpu_s: float = math.nan  # processor time of the clocks, where it is known without that of the start
    charge: NDArray[Any] | None = None  # charge switch at clocks 1, 2, ..., if samples are kept

    @property
    def rate(self) -> float:
        return self.clocks / self.seconds


@dataclass(frozen=True)
class Job:
    """One frame with Verilog and ngspice; `make_deck` is called with the levels of the sources."""

    timing: Timing
    cols: int
    parameters: dict[str, int]  # of dermis_top
    make_deck: Callable[[Sequence[float]], Deck]
    use_ic: bool = False
    step_s: float = 1e-6  # largest of ngspice
    simulator: str = "icarus"
    keep: bool = False  # the bits, and comparator and integrator at every clock
    alone: bool = False  # run ngspice alone as well, on the edges that the Verilog made


class Frame(NamedTuple):
    """Result of a job; times are from the first instant of the circuit to its last."""

    codes: NDArray[Any]
    seconds: float
    cpu_s: float
    alone_s: float  # processor time of ngspice alone, NaN if it was not asked for
    charge: list[int]  # bits of the charge switches at clocks 1, 2, ...
    samples: Floats | None = None  # [clocks + 1, nodes]


class TimedHalf(NgspiceHalf):
    """ngspice at time 0, which measures the time from there to its end."""

    def __init__(self, deck: Deck, job: Job, log: Path) -> None:
        times = {"t_edge_s": T_EDGE_S, "t_max_step_s": job.step_s, "t_stop_s": bridge.analog_s(job.timing)}
        super().__init__(deck, **times, log=log, use_ic=job.use_ic)
        self.advance(0.0, [])
        self._start = time.perf_counter(), time.process_time()

    def close(self) -> None:
        self.seconds = time.perf_counter() - self._start[0]
        self.cpu_seconds = time.process_time() - self._start[1]
        super().close()


@numba.njit
def _replay(advance: Any, period_s: float, first: Any, source: Any, time: Any, level: Any, told: Any) -> int:
    """Advance a circuit in C by clocks, with edges first[i] to first[i + 1] in clock i; return 0, or its failure."""
    for clock in range(len(first) - 1):
        a, b = first[clock], first[clock + 1]
        edges = source[a:].ctypes.data, time[a:].ctypes.data, level[a:].ctypes.data
        samples, low, high = told[0].ctypes.data, told[1].ctypes.data, told[2].ctypes.data
        failed = advance((clock + 1) * period_s, b - a, *edges, samples, low, high)
        if failed:
            return failed
    return 0


async def _frame(dut: Any, job: Job, where: Path) -> Frame:
    halves = []

    def make_half(frame: int, levels: list[float]) -> TimedHalf:
        halves.append((TimedHalf(job.make_deck(levels), job, where / "ngspice.log"), levels))
        return halves[-1][0]

    samples = 2 * job.cols if job.keep else 0
    chip = bridge.Bridge(dut, job.timing, job.cols, trace=job.keep, samples=samples)
    codes = await chip.run(1, make_half)
    charge = chip.trace.charge[chip.trace.begins[0] :] if chip.trace is not None else []
    alone_s = math.nan
    if job.alone:  # the edges are kept in a second frame, for that takes time as well
        again = bridge.Bridge(dut, job.timing, job.cols, trace=True)
        await again.run(1, make_half)
        alone_s = _alone_s(job, again.trace, halves[1][1], make_half)
    half = halves[0][0]
    return Frame(codes, half.seconds, half.cpu_seconds, alone_s, charge, *chip.samples)


def _alone_s(job: Job, trace: Any, levels: list[float], make_half: Callable[..., TimedHalf]) -> float:
    """Return the processor time of a circuit without Verilog on the edges of a frame."""
    timing, t_clk = job.timing, 1.0 / job.timing.f_clk_hz
    nets = (trace.row_select, timing.rows), (trace.preset, 1), (trace.charge, job.cols)
    clocks = range(trace.begins[0], len(trace.charge) - 1)
    now = np.array([[word[n] >> bit & 1 for word, width in nets for bit in range(width)] for n in clocks])
    clock, source = np.nonzero(np.diff(now, axis=0, prepend=[levels]))
    first = np.searchsorted(clock + 1, np.arange(len(now) + 2)).astype(np.int32)
    told = np.zeros((3, 2 * job.cols + 8))
    arrays = source.astype(np.int32), (clock + 1) * t_clk, now[clock, source].astype(float), told
    _replay(loaded().lockstep_advance, t_clk, first[:1], *arrays)  # compiles
    half = make_half(0, levels)
    if failed := _replay(loaded().lockstep_advance, t_clk, first, *arrays):
        half.fail(failed)
    half.close()
    return half.cpu_seconds


if JOB_VARIABLE in os.environ:
    import cocotb

    @cocotb.test()
    async def run_job(dut: Any) -> None:
        """Run a job and leave its value, or the words of its failure."""
        where = Path(os.environ[JOB_VARIABLE])
        try:
            test, job = pickle.loads((where / "job.pickle").read_bytes())
            value = await test(dut, job, where)
        except Exception as error:  # whatever it is, the parent reports it
            (where / "traceback.log").write_text(traceback.format_exc())
            value = f"{type(error).__name__}: {error}"
        write_atomic(where / "result.pickle", pickle.dumps(value))


def in_simulator(
    test: Callable[..., Any], job: Any, simulator: str, build: Path, top: str, where: Path, limit_s: float
) -> Any:
    """Return the value of the coroutine `test(dut, job, where)`, awaited in an HDL simulator.

    Raises SimulatorError if it failed, took longer than `limit_s` or left no result.
    """
    (where / "job.pickle").write_bytes(pickle.dumps((test, job)))
    hdl.run_cocotb(simulator, build, top, __name__, where, {JOB_VARIABLE: str(where)}, limit_s=limit_s)
    try:
        value = pickle.loads((where / "result.pickle").read_bytes())
    except OSError:
        raise SimulatorError("the HDL simulator ended without a result", where) from None
    if isinstance(value, str):
        raise SimulatorError(value, where)
    return value


def frame(job: Job, where: Path, limit_s: float) -> Frame:
    """Run a job in a new directory; raise SimulatorError as `in_simulator` does."""
    where.mkdir(parents=True)
    build = hdl.build(job.simulator, "dermis_top", job.parameters)
    return in_simulator(_frame, job, job.simulator, build, "dermis_top", where, limit_s)


def converter(circuit: Circuit, packet_error: float = 0.0, options: str = OPTIONS, **how: Any) -> Job:
    """Return the job of one converter; `how` has further fields, `packet_error` is a seeded fault of a test."""
    make_deck = partial(deck, circuit, packet_error=packet_error, options=options)
    return Job(circuit.timing, 1, circuit.parameters, make_deck, use_ic=True, **how)


def cosim(
    circuit: Circuit,
    step_s: float,
    clocks: int,
    where: Path,
    limit_s: float,
    options: str = OPTIONS,
    **how: Any,
) -> Run:
    """Run Verilog with ngspice, called as the simulators of peers.py; `how` as for `converter`."""
    circuit = dataclasses.replace(circuit, gate_clocks=clocks)
    job = converter(circuit, options=options, step_s=step_s, **{"keep": True} | how)
    done = frame(job, where, limit_s)
    code, kept = int(done.codes.item()), {}
    if job.keep:
        bits = np.array(done.charge[: circuit.clocks])
        exact = exact_voltage(circuit, np.concatenate([[0], bits[:-1]]))
        kept = {"charge": bits, "error_v": float(np.abs(done.samples[1:, 1] - exact[1:]).max())}
    return Run(code, abs(code - circuit.pulses), circuit.clocks, done.seconds, cpu_s=done.cpu_s, **kept)
