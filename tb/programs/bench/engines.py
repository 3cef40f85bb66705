# SPDX-License-Identifier: Apache-2.0
"""Speed of the engines without a circuit simulator, and of the array solve, on one core.

Each function makes the rows of one section: (scratch directory, repetitions, quick) -> rows.
"""

from __future__ import annotations

import functools
import math
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dermis import effects, engines
from dermis.array import array
from dermis.errors import SimulatorError
from dermis.processes import cpu_time
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from tb.programs.bench import peers
from tb.programs.bench.measure import one_core, random_plan, time_ratios

# Shortest sample of speed in s; a shorter one measures the resolution of the timer.
SAMPLE_S = 0.25
PEER_LIMIT_S = 120.0
SERIES = {"lateral": True, "row_driver": True, "column_input": True}
"""Lateral and series resistances with the values of the design."""
OVER_RANGE = "frames of 16x16 resistances over the range"
SIZES = (16, 32, 64, 128, 256)
LARGE = 256
"""Rows and columns of a large frame."""


def all_effects(engine: str, work: Path) -> tuple[dict[str, bool], list[str]]:
    """Return the effects that an engine honours with their physical defaults, and the names it
    refuses.
    """
    # event refuses `return` together with line_capacitance
    names = [name for name in effects.EFFECTS if name != "return"]
    probe = random_plan(work, 1, engine, **dict.fromkeys(names, True))
    lost = {name for field in engines.refused(probe, engine) for name in probe.effects_of_field(field)}
    return {name: True for name in names if name not in lost}, sorted({*lost, "return"})


def _runner(made: Plan) -> functools.partial[engines.Result]:
    engines.check(made)
    return functools.partial(engines.runner(made.engine), made)


def _speed(name: str, run: Callable[[], Any], frames: int, repeat: int, note: str, least_s: float) -> Row:
    """Return the row of frames a second of a call, repeated for `least_s` a sample."""
    rates, cpu = [], []
    for _ in range(repeat):
        count, begin, cpu_begin = 0, time.perf_counter(), cpu_time.cpu_used_s()
        while not count or time.perf_counter() - begin < least_s:
            run()
            count += frames
        rates.append(count / (time.perf_counter() - begin))
        cpu.append(count / (cpu_time.cpu_used_s() - cpu_begin))
    note = f"{OVER_RANGE}; {note}; {statistics.median(cpu):.0f} a second of processor time"
    return verdict.median(name, rates, "1/s", note)


def _plan_speed(name: str, made: Plan, repeat: int, note: str) -> Row:
    run = _runner(made)
    run()  # compiles and fills caches
    return _speed(name, run, made.frames, repeat, note, SAMPLE_S)


def closed_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the closed engine: ideal, with lateral and series resistances, with traces."""
    kinds = {"": (512, {}), ".series": (512, SERIES), ".trace": (128, {**SERIES, "trace": True})}
    with one_core():
        for kind, (frames, on) in kinds.items():
            made = random_plan(work, frames, "closed", **on)
            yield _plan_speed(f"closed.frames_per_s{kind}", made, repeat, " ".join(on) or "ideal")


BADCROSSBAR_ROWS = (
    "peer.badcrossbar.frames_per_s",
    "closed.speed_ratio.badcrossbar",
    "closed.difference.badcrossbar",
)


def badcrossbar_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Solve the same frame with distributed lines, every row in turn, by badcrossbar and by our
    solver, in pairs.
    """
    if reason := peers.missing("badcrossbar"):
        yield from (verdict.skip(name, reason) for name in BADCROSSBAR_ROWS)
        return
    network = random_plan(work, 1, "closed", trace={"r_row_ohm": 1.0, "r_column_ohm": 1.0}).network(0)
    g = np.broadcast_to(network.g_taxel_s, (64, *network.g_taxel_s.shape)).copy()
    rates, ratios = [], []
    with one_core():
        for _ in range(repeat):
            seconds, currents = peers.badcrossbar(network, PEER_LIMIT_S, 1 if quick else 5)
            rates.append(1.0 / seconds)
            ours = [cpu_time.cpu_seconds(lambda: array.column_currents(network, g)) for _ in range(5)]
            ratios.append(len(g) / statistics.median(ours) * seconds)
    difference = float(np.max(np.abs(array.column_currents(network, g[:1])[0] / currents - 1.0)))
    speed, ratio, apart = BADCROSSBAR_ROWS
    note = f"{peers.PIP['badcrossbar'].split()[0]}: a frame with 1 ohm a pitch, all rows at once"
    yield verdict.median(speed, rates, "1/s", f"{note}, processor time")
    note = "our frames per second over badcrossbar's, the same network, in pairs"
    yield verdict.median(ratio, ratios, "1", note)
    yield verdict.measured(apart, difference, "1", "largest relative difference of a column current")


def event_rows(work: Path, repeat: int, quick: bool) -> Iterator[Row]:
    """Measure the event engine, ideal and with all effects, and the cost of a taxel of a large
    frame.
    """
    on, lost = all_effects("event", work)
    note = f"{len(on)} effects with their physical defaults, noise included; without {', '.join(lost)}"
    with one_core():
        made = random_plan(work, 128, "event")
        yield _plan_speed("event.frames_per_s.ideal", made, repeat, "no effect")
        made = random_plan(work, 64, "event", **on)
        yield _plan_speed("event.frames_per_s.all_effects", made, repeat, f"{note}, which event refuses")
        # Converters only: array.exponent has the cost of the network.
        small = random_plan(work, (LARGE // 16) ** 2, "event", 16)
        large = random_plan(work, 1, "event", LARGE)
        note = "processor time of one frame of 256x256 over 256 of 16x16, in pairs; no effect"
        ratios = time_ratios(_runner(large), _runner(small), repeat)
        yield verdict.median("event.cost_per_taxel_ratio", ratios, "1", note)


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
        run = functools.partial(engines.run, made, simulator=simulator)
        wrong = int((run().codes != engines.run(random_plan(work, frames, "closed")).codes).sum())  # builds
        if wrong:
            raise SimulatorError(f"{simulator}: {wrong} of {frames} frames' codes differ from engine closed")
        with one_core():
            note = f"{frames} at a time, start of the process included; codes are those of closed"
            yield _speed(f"rtl.frames_per_s.{simulator}", run, frames, min(repeat, 3), note, 0.0)
