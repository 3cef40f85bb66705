# SPDX-License-Identifier: Apache-2.0
"""How fast the engines without a circuit simulator are, what memory they take, and a peer for the array solve.

Everything here runs on one core: the process is held on it, with whatever it starts.
"""

from __future__ import annotations

import functools
import json
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dermis import effects, engines, plan
from dermis.array import array
from dermis.array.array import Network
from dermis.engines import batch, certificate
from dermis.errors import SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from dermis.scene.design import load as load_design

# A sample of speed is at least this long; shorter ones measure the clock.
_SAMPLE_S = 0.25

CHILD_LIMIT_S = 120.0

BADCROSSBAR = "badcrossbar==1.1.0"

SERIES = {"lateral": True, "row_driver": True, "column_input": True}
"""Lateral and series resistances, with the values of the design."""

OVER_RANGE = "frames of 16x16 resistances over the range"


def random_plan(work: Path, frames: int, engine: str, size: int | None = None, **effects_on: Any) -> Plan:
    """Frames of resistances spread evenly in log R over the sensor's range, always the same ones."""
    design = load_design()
    low, high = math.log(design.sensor.r_min_ohm), math.log(design.sensor.r_max_ohm)
    rows, cols = (size, size) if size else (design.array.rows, design.array.cols)
    work.mkdir(parents=True, exist_ok=True)
    file = work / f"resistance_{frames}_{rows}x{cols}.npy"
    if not file.exists():
        np.save(file, np.exp(np.random.default_rng(2026).uniform(low, high, (frames, rows, cols))))
    data = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "resistance", "file": file.name},
        "effects": effects_on,
    }
    return plan.make(scene.from_data(data, work / "random.toml"), engine)


def all_effects(engine: str, work: Path) -> tuple[dict[str, bool], list[str]]:
    """Every effect, by name, that an engine does with its physical defaults; and those that it refuses."""
    probe = random_plan(work, 1, engine, **dict.fromkeys(effects.EFFECTS, True))
    lost = {name for field in engines.refused(probe, engine) for name in probe.effects_of_field(field)}
    return {name: True for name in effects.EFFECTS if name not in lost}, sorted(lost)


@contextmanager
def one_core() -> Iterator[None]:
    """Hold this process, and those that it starts, on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})  # the first one serves the interrupts of most machines
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def speed(name: str, made: Plan, repeat: int, note: str) -> Row:
    """Frames a second of a plan through its engine, without certified codes."""
    engines.check(made)
    run = engines.runner(made.engine)
    run(made)  # whatever is compiled or cached is so now
    rates, cpu = [], []
    for _ in range(repeat):
        count, begin, cpu_begin = 0, time.perf_counter(), cpu_time.cpu_used_s()
        while (taken := time.perf_counter() - begin) < _SAMPLE_S:
            run(made)
            count += made.frames
        rates.append(count / taken)
        cpu.append(count / (cpu_time.cpu_used_s() - cpu_begin))
    note = f"{note}; {statistics.median(cpu):.0f} a second of processor time"
    return verdict.median(name, rates, "1/s", note)


def closed_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Speed of the closed engine, ideal, with lateral and series resistances, and with traces; and of badcrossbar."""
    kinds = {"": (512, {}), ".series": (512, SERIES), ".trace": (128, {**SERIES, "trace": True})}
    plans = {kind: random_plan(work, frames, "closed", **on) for kind, (frames, on) in kinds.items()}
    with one_core():
        for kind, made in plans.items():
            what = (
                " ".join(name for name, state in zip(kinds[kind][1], [1] * 9, strict=False) if state)
                or "ideal"
            )
            yield speed(f"closed.frames_per_s{kind}", made, repeat, f"{OVER_RANGE}; {what}")
        yield from _badcrossbar(work, repeat, quick)


def _trace_network(work: Path) -> Network:
    return random_plan(work, 1, "closed", trace={"r_row_ohm": 1.0, "r_column_ohm": 1.0}).network(0)


def _badcrossbar(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Distributed lines: the same frame, every row in turn, by badcrossbar and by our solver, in turns."""
    network = _trace_network(work)
    np.save(work / "peer_resistance.npy", 1.0 / network.g_taxel_s)
    command = [sys.executable, "-c", _BADCROSSBAR, str(work / "peer_resistance.npy"), str(network.v_bias_v)]
    command += [str(network.r_trace_row_ohm), str(network.r_trace_column_ohm), str(1 if quick else 5)]
    g = np.broadcast_to(network.g_taxel_s, (64, *network.g_taxel_s.shape)).copy()
    rates, ratios, version = [], [], ""
    for _ in range(repeat):
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=CHILD_LIMIT_S, check=False, env=_one_thread()
        )
        if done.returncode == 9:
            reason = (
                f"not installed; to measure it: .venv/bin/pip install --no-deps {BADCROSSBAR} pathvalidate"
            )
            yield verdict.skip("peer.badcrossbar.frames_per_s", reason, "1/s")
            yield verdict.skip("closed.speed_ratio.badcrossbar", reason, "1")
            yield verdict.skip("closed.difference.badcrossbar", reason, "1")
            return
        if done.returncode:
            raise SimulatorError(f"badcrossbar: {(done.stderr.strip().splitlines() or ['no word'])[-1]}")
        said = json.loads(done.stdout.splitlines()[-1])
        version, theirs = said["version"], np.array(said["currents"])
        rates.append(1.0 / said["seconds"])
        ours = array.column_currents(network, g[:1])[0]
        taken = statistics.median(
            cpu_time.cpu_seconds(lambda: array.column_currents(network, g)) for _ in range(5)
        )
        ratios.append(len(g) / taken / rates[-1])
        difference = float(np.max(np.abs(ours / theirs - 1.0)))
    note = f"badcrossbar {version}: a frame with 1 ohm a pitch, all rows at once, output currents only, processor time"
    yield verdict.median("peer.badcrossbar.frames_per_s", rates, "1/s", note)
    note = "frames a second of our solver over badcrossbar's, the same network, in pairs"
    yield verdict.median("closed.speed_ratio.badcrossbar", ratios, "1", note)
    note = "largest relative difference of a column current between the two"
    yield verdict.measured("closed.difference.badcrossbar", difference, "1", note)


_BADCROSSBAR = """
import importlib.metadata, json, logging, sys, time, warnings
warnings.simplefilter("ignore")
try:
    import badcrossbar
    compute = badcrossbar.compute
except (ImportError, AttributeError):
    sys.exit(9)
warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
import numpy as np
ohm, (v, row, column), repeat = np.load(sys.argv[1]), map(float, sys.argv[2:5]), int(sys.argv[5])
applied = v * np.eye(len(ohm))
taken = []
for _ in range(1 + repeat):
    begin = time.process_time()
    found = compute(applied, ohm, r_i_word_line=row, r_i_bit_line=column, node_voltages=False, all_currents=False)
    taken.append(time.process_time() - begin)
print(json.dumps({"seconds": sorted(taken[1:])[repeat // 2], "version": importlib.metadata.version("badcrossbar"),
                  "currents": np.asarray(found.currents.output).tolist()}))
"""


def _one_thread() -> dict[str, str]:
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def event_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Speed of the event engine, ideal and with everything on, and what a taxel of a large frame costs."""
    on, lost = all_effects("event", work)
    told = f"{len(on)} effects with their physical defaults, noise included"
    if lost:
        told += f"; without {', '.join(lost)}, which engine event refuses"
    with one_core():
        made = random_plan(work, 128, "event")
        yield speed("event.frames_per_s.ideal", made, repeat, OVER_RANGE)
        made = random_plan(work, 64, "event", **on)
        yield speed("event.frames_per_s.all_effects", made, repeat, f"{OVER_RANGE}; {told}")
        run = functools.partial(engines.runner("event"), made)
        result = run()
        certify = functools.partial(certificate.certified, made, result)
        ratios = [
            1.0 + cpu_time.cpu_seconds(certify) / cpu_time.cpu_seconds(run) for _ in range(min(repeat, 3))
        ]
        note = "the same run with certified lower and upper codes over that without, processor time"
        yield verdict.median("event.certificate_time_ratio", ratios, "1", note)
        # The converters alone: what the network solve costs at that size is array.exponent.
        alone = {name: True for name in on if not _of_network(name)}
        for kind, chosen in (("", {}), (".converter_effects", alone)):
            small = random_plan(work, (LARGE // 16) ** 2, "event", 16, **chosen)
            large = random_plan(work, 1, "event", LARGE, **chosen)
            yield verdict.median(
                f"event.cost_per_taxel_ratio{kind}",
                _time_ratios(large, small, repeat),
                "1",
                f"processor time of one frame of 256x256 over 256 of 16x16, in pairs; {len(chosen)} effects",
            )


def _of_network(name: str) -> bool:
    """Whether an effect writes into the network."""
    data = {"stimulus": {"kind": "uniform", "code": 100}, "effects": {name: True}}
    return bool(plan.make(scene.from_data(data, Path("defaults.toml"))).surrounding)


def _time_ratios(first: Plan, second: Plan, repeat: int) -> list[float]:
    runs = []
    for made in (first, second):
        engines.check(made)
        runs.append(functools.partial(engines.runner(made.engine), made))
        runs[-1]()
    return [cpu_time.cpu_seconds(runs[0]) / cpu_time.cpu_seconds(runs[1]) for _ in range(repeat)]


def off_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """What effects cost that are named and off."""
    off = dict.fromkeys(effects.EFFECTS, False)
    frames = {"closed": 512, "event": 32}
    with one_core():
        for kind, engine in (("", "event"), (".closed", "closed")):
            bare, named = (random_plan(work, frames[engine], engine, **on) for on in ({}, off))
            note = f"{engine}: {len(off)} effects named and off over the bare scene, processor time, in pairs"
            ratios = _time_ratios(named, bare, 2 * repeat + 1)
            yield verdict.median(f"effects_off.time_ratio{kind}", ratios, "1", note)


SIZES = (16, 32, 64, 128, 256)

LARGE = 256
"""Rows and columns of a frame that is large."""


def exponent_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """How the network solve grows with the number of taxels."""
    for kind, on in (("", SERIES), (".trace", {**SERIES, "trace": True})):
        sizes = SIZES if not (quick or kind) else SIZES[:-1]
        with one_core():
            times = [_solve_s(work, size, 1 if quick else min(repeat, 3), on) for size in sizes]
        exponent = float(np.polyfit(np.log([n * n for n in sizes]), np.log(times), 1)[0])
        last = math.log(times[-1] / times[-2]) / math.log((sizes[-1] / sizes[-2]) ** 2)
        each = ", ".join(f"{n}: {1e9 * t / n**2:.0f}" for n, t in zip(sizes, times, strict=True))
        note = (
            f"t ~ taxels^e, {sizes[0]}x{sizes[0]} to {sizes[-1]}x{sizes[-1]}, {' '.join(on)}; "
            f"between the last two {last:.2f}; ns a taxel: {each}"
        )
        yield verdict.measured(f"array.exponent{kind}", exponent, "1", note)


def _solve_s(work: Path, size: int, repeat: int, on: dict[str, Any]) -> float:
    """Processor time a frame of the array solve, in batches of as many frames as closed takes at once."""
    frames = max(1, (1 << 15) // size**2)
    made = random_plan(work, frames, "closed", size, **on)
    base, g = made.network(0), made.conductance_s()
    array.column_currents(base, g)
    taken = [cpu_time.cpu_seconds(lambda: array.column_currents(base, g)) for _ in range(repeat)]
    return statistics.median(taken) / frames


def rtl_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Speed of the real Verilog with real-number models."""
    names = ("rtl.frames_per_s.verilator", "rtl.frames_per_s.icarus")
    for name, frames in zip(names, (256, 2) if quick else (2048, 4), strict=True):
        simulator = name.rsplit(".", 1)[1]
        made = random_plan(work, frames, "rtl")
        engines.run(made.part(0, 1), simulator=simulator)  # builds
        with one_core():
            rates, cpu = [], []
            for _ in range(min(repeat, 3)):
                begin, cpu_begin = time.perf_counter(), cpu_time.cpu_used_s()
                codes = engines.run(made, simulator=simulator).codes
                rates.append(frames / (time.perf_counter() - begin))
                cpu.append(frames / (cpu_time.cpu_used_s() - cpu_begin))
        expected = engines.run(random_plan(work, frames, "closed")).codes
        wrong = int((codes != expected).sum())
        if wrong:
            raise SimulatorError(f"{simulator}: {wrong} of {codes.size} codes differ from engine closed")
        note = f"{frames} {OVER_RANGE}, counters and scanner included, start of the process too; codes are closed's; "
        note += f"{statistics.median(cpu):.0f} a second of processor time"
        yield verdict.median(name, rates, "1/s", note)


BATCH_FRAMES = 400


def batch_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """What a second process is worth."""
    name = "batch.speed_ratio.two_processes"
    if len(os.sched_getaffinity(0)) < 2:
        yield verdict.skip(name, "there is one core", "1")
        return
    on, _ = all_effects("event", work)
    made = random_plan(work, BATCH_FRAMES if quick else 25 * BATCH_FRAMES, "event", **on)
    times = []
    for processes in (1, 2):
        begin = time.perf_counter()
        batch.run(made, processes=processes)
        times.append(time.perf_counter() - begin)
    note = f"wall time of one process over two, engine event, {len(on)} effects, {made.frames} frames, start included"
    yield verdict.report(name, times[0] / times[1], "1", note)


# name: engine, size, frames, effects
MEMORY: dict[str, tuple[str, int, int, dict[str, bool]]] = {
    "memory_mb.start": ("closed", 16, 1, {}),
    "memory_mb.closed.frames_10000": ("closed", 16, 10_000, SERIES),
    "memory_mb.event.frames_10000": ("event", 16, 10_000, {}),
    "memory_mb.closed.frame_256x256": ("closed", 256, 1, SERIES),
    "memory_mb.event.frame_256x256": ("event", 256, 1, SERIES),
}


def memory_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Peak memory of whole processes."""
    for name, (engine, size, frames, on) in MEMORY.items():
        random_plan(work, frames, engine, size)  # writes the file, so that its making does not count
        call = [
            sys.executable,
            "-m",
            "tb.programs.bench.bench_engines",
            str(work),
            engine,
            str(size),
            str(frames),
            json.dumps(on),
        ]
        done = subprocess.run(call, capture_output=True, text=True, timeout=CHILD_LIMIT_S, check=False)
        if done.returncode:
            raise SimulatorError(f"{name}: {(done.stderr.strip().splitlines() or ['no word'])[-1]}")
        what = f"{frames} frame{'s' if frames > 1 else ''} of {size}x{size}, {' '.join(on) or 'ideal'}"
        note = f"peak of a whole process with Python and packages: {engine}, {what}"
        yield verdict.measured(name, float(done.stdout), "MB", note)


def _memory_main(arguments: Sequence[str]) -> None:
    work, engine, size, frames, on = arguments
    engines.run(random_plan(Path(work), int(frames), engine, int(size), **json.loads(on)))
    status = Path("/proc/self/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    print(int(peak.split()[1]) * 1024 / 1e6)


SECTIONS: tuple[tuple[tuple[str, ...], Callable[[Path, int, bool], Iterator[Row]], float], ...] = (
    (
        (
            "closed.frames_per_s",
            "closed.frames_per_s.series",
            "closed.frames_per_s.trace",
            "peer.badcrossbar.frames_per_s",
            "closed.speed_ratio.badcrossbar",
            "closed.difference.badcrossbar",
        ),
        closed_rows,
        180,
    ),
    (
        (
            "event.frames_per_s.ideal",
            "event.frames_per_s.all_effects",
            "event.certificate_time_ratio",
            "event.cost_per_taxel_ratio",
            "event.cost_per_taxel_ratio.converter_effects",
        ),
        event_rows,
        300,
    ),
    (("effects_off.time_ratio", "effects_off.time_ratio.closed"), off_rows, 120),
    (("array.exponent", "array.exponent.trace"), exponent_rows, 300),
    (("rtl.frames_per_s.verilator", "rtl.frames_per_s.icarus"), rtl_rows, 300),
    (("batch.speed_ratio.two_processes",), batch_rows, 300),
    (tuple(MEMORY), memory_rows, 300),
)

if __name__ == "__main__":
    _memory_main(sys.argv[1:])
