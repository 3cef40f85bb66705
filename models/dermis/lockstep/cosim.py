# SPDX-License-Identifier: Apache-2.0
"""A circuit of ngspice that runs with the Verilog of a cocotb test."""

from __future__ import annotations

import math
import re
from asyncio import CancelledError
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.errors import InputError
from dermis.lockstep import netlist_faults
from dermis.lockstep.clock_loop import ClockLoop, width
from dermis.lockstep.ngspice import Deck, NgspiceHalf

RESET_CLOCKS = 3
START_TRIES = 1000  # to find a time that is clear of the edges of all clocks
IDLE_STEPS = 100  # without a clock, the HDL is met after so many of the largest steps without a crossing
END_S = 1e3  # end of the transient: no run is as long
IDLE = "v_dermis_idle"


@dataclass(frozen=True)
class Drive:
    """Sources that a net of the Verilog drives.

    Attributes
    ----------
    source : `external` voltage source of the netlist; one for each bit of a vector, bit 0 first, or one for the number
        on a vector (unsigned) or on a real net
    low, high : its level in volt for 0 and for 1; other numbers are on the straight line through both
    edge_s : duration of its ramp, in seconds
    abrupt : ngspice begins anew at each corner of the ramp, and chooses its own steps. If all sources are False, a
        step is as long as it may be: exact where every current is linear in time between two corners, and with the
        error of the trapezoidal rule where every time constant is far above `step_s`; a shorter one would ring. A
        source that switches a conductance needs True.
    """

    source: str | Sequence[str]
    low: float = 0.0
    high: float = 1.0
    edge_s: float = 1e-9
    abrupt: bool = True


@dataclass(frozen=True)
class Compare:
    """One bit of a net of the Verilog: 1 while a node is above a threshold.

    Attributes
    ----------
    node : of the netlist
    above : threshold in volt
    crossing : the Verilog sees a crossing when it happens; otherwise, if there is a clock, at its next edge
    """

    node: str
    above: float = 0.0
    crossing: bool = False


@dataclass(frozen=True)
class Reset:
    """A net that has the value `active` for the first `RESET_CLOCKS` clocks, before the circuit starts."""

    net: str
    active: int = 0


class Cosim:
    """A circuit that runs with the Verilog of a cocotb test.

    Parameters
    ----------
    netlist : file, or text of more than one line; the first line is the title
    inputs : nets of the Verilog, "dut.NAME", that drive the circuit
    outputs : nets of the Verilog that it drives, a Compare for each bit, bit 0 first
    clock : net of the clock, or period in seconds of each clock by its net; the room drives it, low first, and nets
        change at rising edges. None for a circuit without a clock, whose comparators are then all crossings.
    period_s : period of the one clock
    reset : net that is low before the circuit starts, or Reset
    probes : nodes that are in `samples` as well; or one
    step_s : largest step of ngspice; the shortest period by default
    settle_s : nets that change up to so long after a clock edge or crossing (a delay in the Verilog) are exact as well
    both_edges : nets change, and comparators are read, at falling edges of the clocks as well
    log : file for the messages of ngspice

    Attributes
    ----------
    times : seconds from the start of the circuit of all events, ascending, [events]
    samples : by node, voltage at these times, [events]
    overshoot_v : largest distance by which a crossing was passed

    InputError for a value or a combination that is not possible.
    """

    def __init__(
        self,
        netlist: str | Path,
        inputs: Mapping[str, Drive],
        outputs: Mapping[str, Compare | Sequence[Compare]],
        *,
        clock: str | Mapping[str, float] | None = None,
        period_s: float | None = None,
        reset: str | Reset | None = None,
        probes: str | Sequence[str] = (),
        step_s: float | None = None,
        settle_s: float = 0.0,
        both_edges: bool = False,
        log: str | Path = "ngspice.log",
    ) -> None:
        text = str(netlist)
        self._file = "netlist" if "\n" in text else text
        if "\n" not in text:
            try:
                text = _with_paths(Path(text).read_text(errors="replace"), Path(text).resolve().parent)
            except OSError as error:
                raise self._wrong("netlist", text, f"a file, or text: {error.strerror}") from None
        self._lines = re.split(r"\n[ \t]*\.end\b", text, maxsplit=1, flags=re.IGNORECASE)[0].splitlines()
        self._reset = Reset(reset) if isinstance(reset, str) else reset
        sources = {net: _several(getattr(drive, "source", None), str) for net, drive in inputs.items()}
        self._inputs = {net: (drive, sources[net]) for net, drive in inputs.items()}
        self._outputs = {net: _several(bits, Compare) for net, bits in outputs.items()}
        for net, (drive, own) in self._inputs.items():
            if not isinstance(drive, Drive) or not all(isinstance(source, str) for source in own):
                raise self._wrong(net, drive, "a Drive with names of sources")
        for net, bits in self._outputs.items():
            if not all(isinstance(bit, Compare) for bit in bits):
                raise self._wrong(net, outputs[net], "a Compare, or one for each bit")
        if isinstance(clock, str) == (period_s is None):
            raise self._wrong("period_s", period_s, "that of the one clock; none beside periods by net")
        self._clocks = {clock: period_s} if isinstance(clock, str) else dict(clock or {})
        numbers = {net: (drive.low, drive.high, drive.edge_s) for net, (drive, _) in self._inputs.items()}
        numbers |= {net: tuple(bit.above for bit in bits) for net, bits in self._outputs.items()}
        numbers |= {"clock, period_s": self._clocks.values(), "settle_s": (settle_s,)}
        numbers |= {"step_s": () if step_s is None else (step_s,)}
        for key, values in numbers.items():
            if not all(isinstance(value, Real) and math.isfinite(value) for value in values):
                raise self._wrong(key, ", ".join(map(repr, values)), "finite numbers")
        for net in (*self._clocks, *([] if self._reset is None else [self._reset.net])):
            if net in outputs:
                raise self._wrong("clock, reset", net, "a net that the circuit does not drive")
        shortest = min(self._clocks.values(), default=math.inf)
        self._both_edges = both_edges
        self._step_s = shortest if step_s is None else step_s
        if not 0.0 < self._step_s < math.inf or shortest <= 0.0 or settle_s < 0.0:
            allowed = "above 0, settle_s from 0; without a clock step_s"
            raise self._wrong("step_s, period_s, settle_s", f"{step_s}, {period_s}, {settle_s}", allowed)
        for net, (drive, _) in self._inputs.items():
            between = 0.5 * shortest if both_edges else shortest
            if not 0.0 < drive.edge_s < between:
                allowed = f"above 0 and below {between:g} s, the time between edges"
                raise self._wrong(f"{net}: edge_s", drive.edge_s, allowed)
        for net, bits in self._outputs.items():
            if len({bit.crossing for bit in bits}) != 1:
                raise self._wrong(net, bits, "bits that all, or none of them, are crossings")
        self._nodes = [c.node for bits in self._outputs.values() for c in bits] + [*_several(probes, str)]
        self._settle_s, self._log = settle_s, Path(log)
        self.times: NDArray[np.float64] = np.zeros(0)
        self.samples: dict[str, NDArray[np.float64]] = {}
        self.overshoot_v = 0.0

    def _wrong(self, key: str, value: object, allowed: str) -> InputError:
        return InputError(self._file, key, value, allowed)

    @asynccontextmanager
    async def running(self, dut: Any) -> AsyncIterator[Cosim]:
        """Reset the Verilog, start the circuit, and run both for as long as the block takes.

        A fault ends the test within 256 clocks, at the latest at the end of the block. InputError for a net that the
        Verilog does not have, or of a width that does not fit; SimulatorError if ngspice failed, a net is X or Z, or
        it changed at a time that is not exact; the message names it.
        """
        import cocotb
        from cocotb.triggers import Timer

        with ExitStack() as at_end:
            loop, half, times, longest = await self._ready(dut, at_end)

            async def watch() -> None:
                while True:
                    await Timer(256 * longest, unit="step")
                    loop.require()

            loop.arm(half, **times, samples=len(self._nodes))
            try:
                at_end.callback(cocotb.start_soon(watch()).cancel)
                yield self
                loop.require()
            except CancelledError:
                raise
            except BaseException:
                loop.require()  # the cause of whatever failed in the block
                raise
            finally:
                self.times, table = loop.samples()
                self.samples = dict(zip(self._nodes, table.T, strict=True))
                self.overshoot_v = loop.overshoot_v

    async def _ready(self, dut: Any, at_end: ExitStack) -> tuple[ClockLoop, NgspiceHalf, dict[str, Any], int]:
        """Start the clocks, reset the Verilog and load the circuit; `at_end` takes all back.

        Return loop, circuit, times for `ClockLoop.arm`, and the longest period, or step, in units of time.
        """
        import cocotb
        from cocotb.triggers import Timer

        handles = {net: self._handle(dut, net) for net in (*self._inputs, *self._outputs, *self._clocks)}
        loop = ClockLoop()
        at_end.callback(loop.close)
        self._connect(loop, handles)
        unit = loop.unit_s
        periods = {net: 2 * round(0.5 * period / unit) for net, period in self._clocks.items()}
        for net, units in periods.items():
            exact = self._clocks[net] / unit
            # 1e-9 is rounding of decimals; a difference would shift the times of the two simulators
            if not units or abs(units - exact) > 1e-9 * exact:
                allowed = f"an even multiple of the simulator's unit of time, {unit:g} s; {units * unit:.12g} is near"
                raise self._wrong(f"clock {net}", self._clocks[net], allowed)
        between = [units // 2 if self._both_edges else units for units in periods.values()]
        began = cocotb.utils.get_sim_time("step")
        for net, units in periods.items():
            loop.clock(handles[net], units // 2)
        longest = max(periods.values(), default=math.ceil(self._step_s / unit))
        if self._reset is not None:
            reset = self._handle(dut, self._reset.net)
            reset.value = self._reset.active
            await Timer(RESET_CLOCKS * longest, unit="step")
            reset.value = 1 - self._reset.active
        settle = 1 + math.ceil(self._settle_s / unit)
        # comparators that are crossings settle before the first edge
        ahead = settle if any(bits[0].crossing for bits in self._outputs.values()) else 0
        if ahead and between and 2 * settle >= min(between):
            allowed = "below half of the time between edges, for comparators that are crossings"
            raise self._wrong("settle_s", self._settle_s, allowed)
        await Timer(settle, unit="step")
        for _ in range(START_TRIES):
            since, wait = cocotb.utils.get_sim_time("step") - began, 0
            for units, gap in zip(periods.values(), between, strict=True):
                past = (since + units // 2) % gap  # from its last edge to now
                wait = max(wait, 0 if settle <= past < gap - ahead else (settle - past) % gap)
            if not wait:
                break
            await Timer(wait, unit="step")
        one = len(periods) == 1  # whose edges are multiples of its period to the last digit
        shortest_s = min((drive.edge_s for drive, _ in self._inputs.values()), default=self._step_s)
        times = {
            "base": longest if one else 1,
            "base_s": max(self._clocks.values()) if one else unit,
            "settle": settle,
            "both_edges": self._both_edges,
            "step_s": self._step_s,
            "first_step_s": min(0.125 * shortest_s, self._step_s),
            "idle": math.ceil(IDLE_STEPS * self._step_s / unit),
        }
        loop.require()
        half = self._circuit(loop.levels())
        at_end.callback(half.close)
        at_end.callback(loop.stop)
        return loop, half, times, longest

    def _handle(self, dut: Any, net: str) -> Any:
        import cocotb
        from cocotb.handle import ArrayObject, ValueObjectBase

        top, *names = net.split(".")
        handle = dut
        for name in names:
            handle = getattr(handle, name, None)
        usable = isinstance(handle, ValueObjectBase) and not isinstance(handle, ArrayObject)
        if top != "dut" or not names or not usable:
            found = f"in {dut._name} that {cocotb.SIM_NAME} finds"
            raise self._wrong("net", net, f"dut.NAME: a bit, a vector or a real {found}; no memory")
        if net in self._clocks and width(handle) != 1:
            raise self._wrong("clock", net, "a net of one bit")
        return handle

    def _connect(self, loop: ClockLoop, handles: Mapping[str, Any]) -> None:
        """Give the loop all nets but clocks; sources and samples are in the order of inputs and outputs."""
        taken: set[str] = set()
        for name, (drive, own) in self._inputs.items():
            count = loop.net(handles[name], drive.low, drive.high, isinstance(drive.source, str))
            if len(own) != count:
                raise self._wrong(name, own, "one source" + f", or {count}" * (count > 1))
            for source in own:
                if source.lower() in taken:
                    raise self._wrong(name, source, "a source that no other bit drives")
                taken.add(source.lower())
        for name, compared in self._outputs.items():
            handle = handles[name]
            if isinstance(handle.value, float) or width(handle) != len(compared):
                raise self._wrong(
                    name, f"{len(compared)} bits", "a Compare for each bit of a net that is not real"
                )
            crossing = compared[0].crossing or not self._clocks
            loop.output(handle, [bit.above for bit in compared], crossing)
            handle.value = 0

    def _circuit(self, levels: Sequence[float]) -> NgspiceHalf:
        drives = [(name, drive.edge_s, drive.abrupt) for drive, own in self._inputs.values() for name in own]
        # Another source, by which a circuit without any can be ended as well.
        shortest = min((edge_s for _, edge_s, _ in drives), default=self._step_s)
        names, edges_s, abrupt = zip(*drives, (IDLE, shortest, not drives), strict=True)
        lines = (*self._lines, f"{IDLE} dermis_idle 0 external")
        circuit = lines, names, (*levels, 0.0), abrupt, tuple(self._nodes)
        deck = Deck(*circuit, edges_s=edges_s, own_steps=any(abrupt) or netlist_faults.breaks(self._lines))
        return NgspiceHalf(deck, t_edge_s=shortest, t_max_step_s=self._step_s, t_stop_s=END_S, log=self._log)


def _several(given: Any, kind: type) -> tuple[Any, ...]:
    """Return one or several of a kind as several; what is neither as one."""
    return tuple(given) if isinstance(given, Sequence) and not isinstance(given, kind) else (given,)


def _with_paths(text: str, folder: Path) -> str:
    """Return a netlist with whole paths of included files in its own folder; ngspice looks in the working folder."""

    def whole(found: re.Match[str]) -> str:
        file = folder / found[2].strip("\"'")
        return f'{found[1]}"{file}"' if file.is_file() else found[0]

    line = r"^([ \t]*\.(?:inc\w*|lib)[ \t]+)(\"[^\"\n]+\"|'[^'\n]+'|\S+)"
    return re.sub(line, whole, text, flags=re.I | re.M)
