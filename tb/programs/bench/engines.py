# SPDX-License-Identifier: Apache-2.0
"""Speed and memory of the engines without a circuit simulator, and a peer of the array solve, all
on one core.
"""

from __future__ import annotations

import functools
import json
import math
import os
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dermis import effects, engines, plan
from dermis.array import array
from dermis.engines import batch, certificate
from dermis.errors import SimulatorError
from dermis.processes import children, cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene import scene
from tb.programs.bench.measure import one_core, random_plan, time_ratios

# Shortest sample of speed in s; a shorter one measures the resolution of the timer.
SAMPLE_S = 0.25
CHILD_LIMIT_S = 120.0
BADCROSSBAR = "badcrossbar==1.1.0"
SERIES = {"lateral": True, "row_driver": True, "column_input": True}
"""Lateral and series resistances with the values of the design."""
OVER_RANGE = "frames of 16x16 resistances over the range"
SIZES = (16, 32, 64, 128, 256)
LARGE = 256
"""Rows and columns of a large frame."""
BATCH_FRAMES = 400

MEMORY: dict[str, tuple[str, int, int, dict[str, bool]]] = {
    "memory_mb.start": ("closed", 16, 1, {}),
    "memory_mb.closed.frames_10000": ("closed", 16, 10_000, SERIES),
    "memory_mb.event.frames_10000": ("event", 16, 10_000, {}),
    "memory_mb.closed.frame_256x256": ("closed", 256, 1, SERIES),
    "memory_mb.event.frame_256x256": ("event", 256, 1, SERIES),
}
"""Engine, size, frames and effects by row."""


def all_effects(engine: str, work: Path) -> tuple[dict[str, bool], list[str]]:
    """Return the effects that an engine honours with their physical defaults, and the names it
    refuses.
    """
    names = [
        name for name in effects.EFFECTS if name != "return"
    ]  # event refuses it together with line_capacitance
    probe = random_plan(work, 1, engine, **dict.fromkeys(names, True))
    lost = {name for field in engines.refused(probe, engine) for name in probe.effects_of_field(field)}
    return {name: True for name in names if name not in lost}, sorted({*lost, "return"})


def _runner(made: Plan) -> functools.partial[engines.Result]:
    engines.check(made)
    return functools.partial(engines.runner(made.engine), made)


def speed(name: str, made: Plan, repeat: int, note: str) -> Row:
    """Return the row of frames a second of a plan through its engine, without certified codes."""
    run = _runner(made)
    run()  # compiles and fills caches
    rates, cpu = [], []
    for _ in range(repeat):
        count, begin, cpu_begin = 0, time.perf_counter(), cpu_time.cpu_used_s()
        while (taken := time.perf_counter() - begin) < SAMPLE_S:
            run()
            count += made.frames
        rates.append(count / taken)
        cpu.append(count / (cpu_time.cpu_used_s() - cpu_begin))
    note = f"{note}; {statistics.median(cpu):.0f} a second of processor time"
    return verdict.median(name, rates, "1/s", note)


def closed_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the closed engine, ideal, with lateral and series resistances, and with traces; and
    badcrossbar.
    """
    kinds = {"": (512, {}), ".series": (512, SERIES), ".trace": (128, {**SERIES, "trace": True})}
    with one_core():
        for kind, (frames, on) in kinds.items():
            made = random_plan(work, frames, "closed", **on)
            yield speed(
                f"closed.frames_per_s{kind}", made, repeat, f"{OVER_RANGE}; {' '.join(on) or 'ideal'}"
            )
        yield from _badcrossbar(work, repeat, quick)


def _badcrossbar(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Solve the same frame with distributed lines, every row in turn, by badcrossbar and by our
    solver, in pairs.
    """
    network = random_plan(work, 1, "closed", trace={"r_row_ohm": 1.0, "r_column_ohm": 1.0}).network(0)
    np.save(work / "peer_resistance.npy", 1.0 / network.g_taxel_s)
    words = (network.v_bias_v, network.r_trace_row_ohm, network.r_trace_column_ohm, 1 if quick else 5)
    command = [sys.executable, "-c", _BADCROSSBAR, str(work / "peer_resistance.npy"), *map(str, words)]
    g = np.broadcast_to(network.g_taxel_s, (64, *network.g_taxel_s.shape)).copy()
    rates, ratios, said = [], [], {}
    for _ in range(repeat):
        code, text = children.output_of(command, CHILD_LIMIT_S, environment=_ONE_THREAD)
        if code == 9:
            reason = (
                f"not installed; to measure it: .venv/bin/pip install --no-deps {BADCROSSBAR} pathvalidate"
            )
            for name in _BADCROSSBAR_ROWS:
                yield verdict.skip(name, reason)
            return
        if code:
            raise SimulatorError(f"badcrossbar: {(text.strip().splitlines() or ['no output'])[-1]}")
        said = json.loads(text.splitlines()[-1])
        rates.append(1.0 / said["seconds"])
        ours = [cpu_time.cpu_seconds(lambda: array.column_currents(network, g)) for _ in range(5)]
        ratios.append(len(g) / statistics.median(ours) / rates[-1])
    difference = float(np.max(np.abs(array.column_currents(network, g[:1])[0] / said["currents"] - 1.0)))
    speeds, ratio, apart = _BADCROSSBAR_ROWS
    note = (
        f"badcrossbar {said['version']}: a frame with 1 ohm a pitch, all rows at once, output currents only"
    )
    yield verdict.median(speeds, rates, "1/s", f"{note}, processor time")
    yield verdict.median(
        ratio, ratios, "1", "our frames per second over badcrossbar's, the same network, in pairs"
    )
    yield verdict.measured(apart, difference, "1", "largest relative difference of a column current")


_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
_BADCROSSBAR_ROWS = (
    "peer.badcrossbar.frames_per_s",
    "closed.speed_ratio.badcrossbar",
    "closed.difference.badcrossbar",
)
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


def event_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the event engine, ideal and with all effects, and the cost of a taxel of a large
    frame.
    """
    on, lost = all_effects("event", work)
    told = f"{len(on)} effects with their physical defaults, noise included"
    if lost:
        told += f"; without {', '.join(lost)}, which engine event refuses"
    with one_core():
        yield speed("event.frames_per_s.ideal", random_plan(work, 128, "event"), repeat, OVER_RANGE)
        made = random_plan(work, 64, "event", **on)
        yield speed("event.frames_per_s.all_effects", made, repeat, f"{OVER_RANGE}; {told}")
        run = _runner(made)
        certify = functools.partial(certificate.certified, made, run())
        ratios = [1.0 + ratio for ratio in time_ratios(certify, run, min(repeat, 3))]
        note = "the same run with certified lower and upper codes over that without, processor time"
        yield verdict.median("event.certificate_time_ratio", ratios, "1", note)
        # Converters only: array.exponent has the cost of the network.
        alone = {name: True for name in on if not _of_network(name)}
        for kind, chosen in (("", {}), (".converter_effects", alone)):
            small = random_plan(work, (LARGE // 16) ** 2, "event", 16, **chosen)
            large = random_plan(work, 1, "event", LARGE, **chosen)
            note = (
                f"processor time of one frame of 256x256 over 256 of 16x16, in pairs; {len(chosen)} effects"
            )
            ratios = time_ratios(_runner(large), _runner(small), repeat)
            yield verdict.median(f"event.cost_per_taxel_ratio{kind}", ratios, "1", note)


def _of_network(name: str) -> bool:
    """Return True if an effect writes into the network."""
    data = {"stimulus": {"kind": "uniform", "code": 100}, "effects": {name: True}}
    return bool(plan.make(scene.from_data(data, Path("defaults.toml"))).surrounding)


def off_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the cost of effects that are named but off."""
    off = dict.fromkeys(effects.EFFECTS, False)
    with one_core():
        for kind, engine, frames in (("", "event", 32), (".closed", "closed", 512)):
            bare, named = (_runner(random_plan(work, frames, engine, **on)) for on in ({}, off))
            note = f"{engine}: {len(off)} effects named and off over the bare scene, processor time, in pairs"
            ratios = time_ratios(named, bare, 2 * repeat + 1)
            yield verdict.median(f"effects_off.time_ratio{kind}", ratios, "1", note)


def exponent_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the growth of the network solve with the number of taxels."""
    for kind, on in (("", SERIES), (".trace", {**SERIES, "trace": True})):
        sizes = SIZES if not (quick or kind) else SIZES[:-1]
        with one_core():
            times = [_solve_s(work, size, 1 if quick else min(repeat, 3), on) for size in sizes]
        exponent = float(np.polyfit(np.log([n * n for n in sizes]), np.log(times), 1)[0])
        last = math.log(times[-1] / times[-2]) / math.log((sizes[-1] / sizes[-2]) ** 2)
        each = ", ".join(f"{n}: {1e9 * t / n**2:.0f}" for n, t in zip(sizes, times, strict=True))
        note = f"t ~ taxels^e, {sizes[0]}x{sizes[0]} to {sizes[-1]}x{sizes[-1]}, {' '.join(on)}; "
        note += f"between the last two {last:.2f}; ns a taxel: {each}"
        yield verdict.measured(f"array.exponent{kind}", exponent, "1", note)


def _solve_s(work: Path, size: int, repeat: int, on: dict[str, Any]) -> float:
    """Return the processor time per frame of the array solve, with the batch size of engine
    closed.
    """
    frames = max(1, (1 << 15) // size**2)
    made = random_plan(work, frames, "closed", size, **on)
    base, g = made.network(0), made.conductance_s()
    array.column_currents(base, g)
    taken = [cpu_time.cpu_seconds(lambda: array.column_currents(base, g)) for _ in range(repeat)]
    return statistics.median(taken) / frames


def rtl_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the real Verilog with real-number models."""
    for simulator, frames in (("verilator", 256 if quick else 2048), ("icarus", 2 if quick else 4)):
        made = random_plan(work, frames, "rtl")
        engines.run(made.part(0, 1), simulator=simulator)  # builds
        with one_core():
            rates, cpu = [], []
            for _ in range(min(repeat, 3)):
                begin, cpu_begin = time.perf_counter(), cpu_time.cpu_used_s()
                codes = engines.run(made, simulator=simulator).codes
                rates.append(frames / (time.perf_counter() - begin))
                cpu.append(frames / (cpu_time.cpu_used_s() - cpu_begin))
        wrong = int((codes != engines.run(random_plan(work, frames, "closed")).codes).sum())
        if wrong:
            raise SimulatorError(f"{simulator}: {wrong} of {codes.size} codes differ from engine closed")
        note = f"{frames} {OVER_RANGE}, start of the process included; codes are those of closed; "
        note += f"{statistics.median(cpu):.0f} a second of processor time"
        yield verdict.median(f"rtl.frames_per_s.{simulator}", rates, "1/s", note)


def batch_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the gain of a second process."""
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


def memory_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the peak memory of whole processes."""
    for name, (engine, size, frames, on) in MEMORY.items():
        random_plan(work, frames, engine, size)  # writes the file, so that writing it does not count
        call = [sys.executable, "-m", "tb.programs.bench.engines"]
        call += [str(work), engine, str(size), str(frames), json.dumps(on)]
        code, text = children.output_of(call, CHILD_LIMIT_S)
        if code:
            raise SimulatorError(f"{name}: {(text.strip().splitlines() or ['no output'])[-1]}")
        note = (
            f"peak of a whole process with Python and packages: {engine}, {frames} frames of {size}x{size}, "
        )
        yield verdict.measured(name, float(text.split()[-1]), "MB", note + (" ".join(on) or "ideal"))


def _memory_main(arguments: Sequence[str]) -> None:
    work, engine, size, frames, on = arguments
    engines.run(random_plan(Path(work), int(frames), engine, int(size), **json.loads(on)))
    status = Path("/proc/self/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    print(int(peak.split()[1]) * 1024 / 1e6)


_KINDS = ("", ".series", ".trace")
SECTIONS = (
    ((*(f"closed.frames_per_s{kind}" for kind in _KINDS), *_BADCROSSBAR_ROWS), closed_rows, 180),
    (
        (
            *(f"event.frames_per_s.{kind}" for kind in ("ideal", "all_effects")),
            "event.certificate_time_ratio",
            *(f"event.cost_per_taxel_ratio{kind}" for kind in ("", ".converter_effects")),
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
"""Rows of each section, its function (work, repeat, quick) and its time limit in seconds."""

if __name__ == "__main__":
    _memory_main(sys.argv[1:])
