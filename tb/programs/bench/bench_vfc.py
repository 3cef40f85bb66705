# SPDX-License-Identifier: Apache-2.0
"""One converter for the benchmark: dermis_top with one column, in lock-step with a circuit whose solution is known.

Started as `python -m tb.programs.bench.bench_vfc JOB` it runs the HDL simulator, which loads this module again as
the cocotb test; a job without a simulator drives ngspice alone. A job is a directory:
job.json in; result.npz or error.txt, and logs out.
"""

from __future__ import annotations

import dataclasses
import json
import os
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

# The same line goes into the decks of others, who get no worse from it.
OPTIONS = netlist.options(pole=False)


@dataclass(frozen=True)
class Circuit:
    """The converter that others were measured on: 1 uA into 10 pF for 1 us is a packet of 0.1 V.

    The circuit starts where the row is driven, `break_clocks` after the slot of the chip.
    There is no preset: the integrator starts so far above half a packet that it stands there, w = -1/2, when the gate
    opens. With `preset` it is held at half a packet until then, as on the chip.
    With `t_gbw_s` the amplifier's output follows the charge with this time constant, 1 / (2 pi gain-bandwidth).
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
        """Packets a clock, of the decimals as written."""
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
        """What the counter must read, in exact rationals."""
        return count_rational(self.duty, self.gate_clocks)


def blocks(circuit: Circuit, packet_error: float = 0.0, options: str = OPTIONS) -> list[str]:
    """Netlist of the converter in the project's own blocks: nodes d_charge, d_hold in; comp0, xvfc.v_int out."""
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
        "xvfc v_sum d_charge d_hold comp0 ibias vdd vss vfc "
        + " ".join(f"{name}={spice_number(value)}" for name, value in values.items()),
        options,
    ]


def start_lines(circuit: Circuit) -> list[str]:
    """What replaces the preset: no hold, and the integrator's voltage as initial condition (for `uic`)."""
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
    """The circuit for lock-step; probes are the comparator, then the integrator."""
    names = netlist.source_names(1, 1)
    nodes = ["d_row0", "d_hold" if circuit.preset else "d_preset", "d_charge"]
    lines = ["one converter", *blocks(circuit, packet_error, options)]
    lines += [f"{name} {node} 0 external" for name, node in zip(names, nodes, strict=True)]
    if not circuit.preset:
        lines += start_lines(circuit)
    abrupt = (False, circuit.preset, False)
    return Deck(tuple(lines), names, tuple(levels), abrupt, ("comp0", "xvfc.v_int"))


def exact_voltage(circuit: Circuit, charge: NDArray[Any], late_s: float = 0.0) -> Floats:
    """Integrator voltage at the clocks first, first + 1, ... of the exact solution.

    Parameters
    ----------
    circuit : Circuit
    charge : array_like of 0 and 1
        What the charge switch was told at each clock from `first` on; it was off before. A switch that is told at
        clock n moves on a straight line between n T and n T + t_edge.
    late_s : float
        How long after the clock the line begins, where a bridge is known to be late.

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
    """`exact_voltage` behind the amplifier's pole, in 50 digits: t v' = u - v with u the voltage without the pole.

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
    """Largest |voltage - exact| over the clock edges after the start.

    Parameters
    ----------
    circuit : Circuit
    voltage : ndarray
        Integrator at clocks 0, 1, ... to the end; what is before the start is not looked at.
    charge : ndarray
        What the charge switch was told at clocks 1, 2, ... to the end.
    """
    first = circuit.first
    told = np.concatenate([[0], charge])[first:-1]
    if voltage.shape != (told.size + first + 1,) or told.size < 1:
        raise ValueError(f"{voltage.size} samples and {charge.size} switch states do not belong together")
    return float(np.max(np.abs(voltage[first + 1 :] - exact_voltage(circuit, told)[1:])))


def walk(half: AnalogHalf, circuit: Circuit, charge: Sequence[int]) -> None:
    """Advance an analog half to the end, with the charge switched as told at clocks 1, 2, ...

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


# ---- the child process ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """What the child does: `frames` runs of the circuit.

    `simulator` None drives ngspice alone with the charge bits of replay.npz; `replay` puts a half in ngspice's place
    that costs nothing and answers with the comparator bits of replay.npz; `keep` returns what crossed the bridge.
    `options` is the deck's line of options; `cuts` as for `NgspiceHalf`.

    The last two are faults, for the test that they are found: ngspice is given packets that are too large by
    `packet_error`, or hears of the 50th switching of the charge `late_s` too late.
    """

    circuit: Circuit
    frames: int
    t_max_step_s: float = 1e-6
    simulator: str | None = "icarus"
    replay: bool = False
    keep: bool = False
    build: str = ""
    packet_error: float = 0.0
    late_s: float = 0.0
    options: str = OPTIONS
    cuts: int = 0


@dataclass(frozen=True)
class Run:
    """What a job measured, one entry or row a frame; bits and voltages only where it was told to keep them.

    `seconds` and `cpu_seconds` count from the first instant of the circuit to its last; `charge` [frames, clocks] is
    what the charge switch was told at clocks 1.., `comparator` [frames, clocks] what the Verilog was told at clocks
    1.., `voltage` [frames, clocks + 1] the integrator at clocks 0.. (without a preset, ngspice gives none at 0).
    """

    codes: NDArray[np.int64]
    seconds: Floats
    cpu_seconds: Floats
    charge: NDArray[np.int64] | None = None
    comparator: NDArray[np.int64] | None = None
    voltage: Floats | None = None

    def rates(self, circuit: Circuit) -> Floats:
        """Clocks a second of each frame."""
        return circuit.clocks / self.seconds


class _Watched:
    """An analog half with a stop watch from its first answer to its end."""

    def __init__(self, inner: Any, job: Job) -> None:
        self._inner = inner
        self._job = job
        self._switched = 0
        self.voltage: list[float] = []
        self.seconds = self.cpu_seconds = 0.0

    def advance(self, to: float, edges: Sequence[Edge]) -> Floats:
        sample = self._inner.advance(to, self._with_fault(edges) if self._job.late_s else edges)
        if self._job.keep:
            self.voltage.append(float(sample[1]))
        elif not self._job.late_s:
            self.advance = self._inner.advance  # type: ignore[method-assign]  # nothing in between from now on
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


class _Replay:
    """Answers with recorded comparator bits, at no cost: what is left is the HDL simulator, cocotb and the bridge."""

    def __init__(self, comparator: NDArray[np.int64]) -> None:
        samples = np.where(np.concatenate([[0], comparator]) > 0, 1.0, -1.0)
        self._next = iter(samples.reshape(-1, 1)).__next__

    def advance(self, to: float, edges: Sequence[Edge]) -> Floats:
        return self._next()

    def close(self) -> None:
        """Nothing is held."""


def _load(where: Path) -> Job:
    said = json.loads((where / "job.json").read_text())
    return Job(**{**said, "circuit": Circuit(**said["circuit"])})


def _replay(where: Path) -> dict[str, NDArray[Any]]:
    with np.load(where / "replay.npz") as data:
        return dict(data)


def _write(where: Path, **arrays: Any) -> None:
    scratch = where / "result.partial.npz"
    np.savez(scratch, **arrays)
    scratch.replace(where / "result.npz")


def ngspice_half(job: Job, where: Path, levels: Sequence[float] = (1.0, 1.0, 0.0)) -> NgspiceHalf:
    """The circuit of a job, ready to be advanced."""
    circuit = job.circuit
    return NgspiceHalf(
        deck(circuit, levels, job.packet_error, job.options),
        t_edge_s=circuit.t_edge_s,
        t_max_step_s=job.t_max_step_s,
        t_stop_s=bridge.analog_s(circuit.timing),
        log=where / "ngspice.log",
        use_ic=not circuit.preset,
        cuts=job.cuts,
    )


async def _frames(dut: Any, where: Path) -> None:
    job = _load(where)
    circuit = job.circuit
    halves: list[_Watched] = []

    def make_half(frame: int, levels: list[float]) -> Any:
        if job.replay:
            half: Any = _Replay(_replay(where)["comparator"])
        else:
            half = ngspice_half(job, where, levels)
        halves.append(_Watched(half, job))
        return halves[-1]

    chip = bridge.Bridge(dut, circuit.timing, 1, trace=job.keep)
    codes = await chip.run(job.frames, make_half)
    arrays: dict[str, Any] = {
        "codes": codes.ravel(),
        "seconds": [half.seconds for half in halves],
        "cpu_seconds": [half.cpu_seconds for half in halves],
    }
    if chip.trace is not None:
        for name in ("charge", "comparator"):
            bits = getattr(chip.trace, name)
            arrays[name] = np.array([bits[begin : begin + circuit.clocks] for begin in chip.trace.begins])
        arrays["voltage"] = np.array([half.voltage for half in halves])
    _write(where, **arrays)


def _alone(job: Job, where: Path) -> None:
    charge = _replay(where)["charge"]
    halves = []
    for _ in range(job.frames):
        halves.append(_Watched(ngspice_half(job, where), job))
        walk(halves[-1], job.circuit, charge.tolist())
        halves[-1].close()
    arrays: dict[str, Any] = {"codes": [], "seconds": [h.seconds for h in halves]}
    arrays["cpu_seconds"] = [h.cpu_seconds for h in halves]
    if job.keep:
        arrays |= {"charge": [charge] * job.frames, "voltage": [h.voltage for h in halves]}
    _write(where, **arrays)


def main(where: Path) -> int:
    """Run a job; its exit code says nothing, the files it leaves do."""
    job = _load(where)
    try:
        if job.simulator is None:
            _alone(job, where)
            return 0
        told = {JOB_VARIABLE: str(where)}
        hdl.run_cocotb(
            job.simulator, Path(job.build), "dermis_top", "tb.programs.bench.bench_vfc", where, told
        )
    except (SimulatorError, RuntimeError, SystemExit) as error:
        if not (where / "error.txt").exists():
            write_atomic(where / "error.txt", f"{error}\n")
        return 1
    return 0


if JOB_VARIABLE in os.environ:
    import cocotb

    @cocotb.test()
    async def converter(dut: Any) -> None:
        """Run the frames of the job; what goes wrong is left as error.txt for the parent."""
        where = Path(os.environ[JOB_VARIABLE])
        try:
            await _frames(dut, where)
        except Exception as error:
            write_atomic(where / "error.txt", f"{type(error).__name__}: {error}\n")
            (where / "traceback.log").write_text(traceback.format_exc())
            raise


# ---- the parent -------------------------------------------------------------------------------------------------


def call(
    command: Sequence[str | Path], where: Path, limit_s: float, log: str = "console.log", **environment: str
) -> int:
    """Run a command in a directory until it ends; its output goes to a log there. Returns its exit code.

    Raises
    ------
    SimulatorError
        It ran longer than its limit and was ended, with all that it started.
    """
    (where / log).unlink(missing_ok=True)
    words = [str(word) for word in command]
    code = children.run_child(
        words, where, where / log, limit_s, {"OPENBLAS_NUM_THREADS": "1", **environment}
    )
    if code is None:
        raise SimulatorError(f"{Path(command[0]).name} took more than {limit_s:g} s", where / log)
    return code


def measure(job: Job, where: Path, limit_s: float, replay: Run | None = None) -> Run:
    """Run a job in a process of its own, in a new directory.

    Parameters
    ----------
    job : Job
        `build` may be left empty.
    where : Path
    limit_s : float
        After this the process is ended.
    replay : Run, optional
        Where the recorded bits come from.

    Raises
    ------
    SimulatorError
        It failed, took too long or left no result.
    """
    where.mkdir(parents=True)
    if job.simulator is not None:
        build = hdl.build(job.simulator, "dermis_top", job.circuit.parameters)
        job = dataclasses.replace(job, build=str(build))
    if replay is not None:
        assert replay.charge is not None
        assert replay.comparator is not None
        np.savez(where / "replay.npz", charge=replay.charge[0], comparator=replay.comparator[0])
    (where / "job.json").write_text(json.dumps(dataclasses.asdict(job)))
    call([sys.executable, "-m", "tb.programs.bench.bench_vfc", where], where, limit_s)
    if (where / "error.txt").exists():
        raise SimulatorError((where / "error.txt").read_text().strip(), where)
    try:
        with np.load(where / "result.npz") as data:
            return Run(**data)
    except (OSError, ValueError):
        raise SimulatorError("the process ended without a result", where) from None


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
