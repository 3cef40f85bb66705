# SPDX-License-Identifier: Apache-2.0
"""Engine `cosim`: the real Verilog in lock-step with ngspice, each chunk of frames in a process of its own.

In a scene with auto the chip scans only the rows that engine event leaves open (masking.py).
"""

import contextlib
import math
import os
import pickle
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from dermis.chip import hdl, netlist
from dermis.engines import Result, masking
from dermis.engines.cosim_job import JOB_VARIABLE, STATISTICS, Block, Job, Solver
from dermis.errors import InputError, SimulatorError
from dermis.lockstep import ladder
from dermis.processes import children
from dermis.records import Plan

HONOURS, honours = netlist.HONOURS, netlist.honours
"""Record fields that this engine simulates: with behavioural views, and with the views of a plan."""

HONOURS_EXACT = frozenset({"g_lateral_row_s", "g_lateral_column_s"})
"""Fields of the exact analog half: its converters are ideal; laterals between ideal lines carry no current."""

FRAMES_A_PROCESS = 4
"""A process costs about a second to start, a frame about four: short enough to share out, long enough to pay."""

_cores = threading.BoundedSemaphore(os.cpu_count() or 1)  # over every run of this process, not each

SLOT_LIMIT_S = 120.0
"""Longest wait for the first row slot (loading, operating point), and each further one; ideal ones take under 1 s."""
EFFECTS_LIMIT_FACTOR = 5.0
"""The limit times this with effects: 16 x 16 with all of them took 11 s a row, 70 s on a busy machine."""
VIEWS_LIMIT_FACTOR = 10.0
"""With transistors: a row of 16 columns at 29 ms a clock (docs/views.md) is 290 s of one core, shared by four runs."""


def refuses(plan: Plan) -> InputError | None:
    """Return the error for a plan outside the limits of the chip or of its transistors, or None."""
    return hdl.beyond_the_chip(plan) or netlist.refuses(plan)


def run(
    plan: Plan,
    progress: Callable[[int], None] | None = None,
    *,
    simulator: str = "icarus",
    sync_latch: bool = False,
    analog: Literal["ngspice", "exact"] = "ngspice",
    solver: Solver | None = None,
    record: bool = False,
    work: Path | None = None,
) -> Result:
    """Read every frame of a plan through the Verilog.

    Parameters
    ----------
    progress : called with the number of row slots done so far, over all processes
    simulator : "icarus" or "verilator"
    sync_latch : build the chip with the flip-flop + latch synchronizer
    analog : "ngspice", or "exact" for the ideal converters without a circuit simulator
    solver : step control
    record : keep waveforms (info["trace"], info["waves"])
    work : directory for decks and logs, emptied first; default one in build/cosim that stays only after a failure

    Returns codes uint8 [frames, rows, cols]; info has seconds, those of a processor, ngspice's step counts, by frame
    the attempts that ngspice gave up (docs/ladder.md; on stderr as well), in a scene with auto the rows that were
    solved and, if recorded, the records.

    InputError for an effect that the exact half would have to ignore, or an array or timing that the chip is not made
    for; SimulatorError if either simulator failed, stopped answering or left no result.
    """
    if analog == "exact" and (lost := plan.active_fields() - HONOURS_EXACT):
        names = sorted({f"effects.{name}" for field in lost for name in plan.effects_of_field(field)})
        what, allowed = "not possible with the exact analog half", "ideal converters, or analog ngspice"
        raise InputError(plan.scene.path, names[0] if names else min(lost), what, allowed)
    start = time.perf_counter()
    build = hdl.build(simulator, "dermis_top", hdl.reader_parameters(plan, sync_latch))

    def scanned(blocks: tuple[masking.Block, ...], files: Path) -> list[dict[str, Any]]:
        slots = sum(len(block.rows) for block in blocks)
        masked = plan.frames * plan.rows - slots
        # Waves are those of the first process: the same frames on any number of cores.
        cores = 1 if record else os.cpu_count() or 1
        jobs = max(min(cores, len(blocks)), math.ceil(slots / plan.rows / FRAMES_A_PROCESS))
        done = [0] * jobs

        def one(index: int) -> dict[str, Any]:
            def on_slots(slots: int) -> None:
                done[index] = slots
                if progress is not None:
                    progress(masked + sum(done))

            mine = blocks[index * len(blocks) // jobs : (index + 1) * len(blocks) // jobs]
            # Whole frames follow each other, as the chip scans them by itself. A mask is written after a reset.
            scans = tuple((block,) for block in mine) if masked else (mine,)
            with _cores:
                made = tuple(tuple(_block(plan, block, analog, record) for block in scan) for scan in scans)
                ranges, steps = netlist.ranges_of(plan), solver or Solver()
                job = Job(plan.timing, plan.cols, ranges, made, sync_latch, steps, record)
                return _run_job(job, plan, simulator, build, files / f"job_{index}", on_slots)

        with children.stoppable(max(jobs, 1)) as pool:
            return list(pool.map(one, range(jobs)))

    rows = masking.everything(plan, "waveforms are of whole frames")
    if not record:
        rows = masking.decide(plan) if plan.filtered else masking.everything(plan)
    with hdl.work_directory("cosim", plan, work) as files:
        parts = scanned(rows.blocks, files)
        codes = rows.with_solved(line for part in parts for line in part["codes"])
        if codes is None:
            rows = masking.everything(plan, "ngspice reads a cell otherwise than engine event is certain of")
            parts = scanned(rows.blocks, files / "all_rows")
            codes = rows.with_solved(line for part in parts for line in part["codes"])
    info: dict[str, Any] = {
        "seconds": time.perf_counter() - start,
        "processor_s": sum(part["processor_s"] for part in parts),
        "simulator": simulator,
        "steps": {name: sum(part["steps"][name] for part in parts) for name in STATISTICS},
        "retries": {name: said for part in parts for name, said in _retries(part).items()},
    }
    if plan.filtered:
        info["masked"] = rows.as_dict(plan.first_frame)
    if record:
        info["records"] = parts
    return Result(codes, info)


def _retries(part: dict[str, Any]) -> dict[str, Any]:
    """Return the retries of ngspice by frame, and report them on stderr."""
    for frame, retries in part["retries"].items():
        ladder.Climb(f"frame {frame}").add(retries)
    return {f"frame {frame}": [asdict(retry) for retry in some] for frame, some in part["retries"].items()}


def _block(plan: Plan, block: masking.Block, analog: str, record: bool) -> Block:
    """Return a block with its circuits: decks, or duties of the exact half."""
    frame, rows = block.frame, block.rows
    if analog == "exact":
        duty = plan.v_bias_v * plan.conductance_s(frame) / (plan.converter.k * plan.converter.i0_a)
        return Block(frame, rows, {}, duty)
    levels = [0.0] * (plan.rows + 1 + plan.cols)  # those of the chip's pins come later
    decks = {
        part: netlist.frame_deck(plan, frame, levels, record=record, columns=part, first_row=rows[0])
        for part in netlist.parts(plan)
    }
    return Block(frame, rows, decks)


def _run_job(
    job: Job, plan: Plan, simulator: str, build: Path, directory: Path, on_slots: Callable[[int], None]
) -> dict[str, Any]:
    directory.mkdir(parents=True)
    directory = directory.resolve()  # ngspice leaves its check of transistors, bsim4v5.out, where it runs
    (directory / "job.pickle").write_bytes(pickle.dumps(job))
    factor = EFFECTS_LIMIT_FACTOR if plan.active_fields() else 1.0
    if plan.views.in_transistors(plan.topology):
        factor = VIEWS_LIMIT_FACTOR
    slots = 0

    def progress() -> int:
        nonlocal slots
        with contextlib.suppress(FileNotFoundError):  # not there yet
            slots = (directory / "progress").stat().st_size
        on_slots(slots)
        return slots

    def simulate(command: list[str], work: Path, log: Path, limit_s: float, _: str, env: Any) -> None:
        """Run the simulator; its exit code says nothing, the files that it leaves do."""
        if children.run_child(command, work, log, limit_s, env, progress) is None:
            raise SimulatorError(f"the co-simulation stopped answering in {_place(job, slots)}", directory)

    told = {JOB_VARIABLE: str(directory), "OPENBLAS_NUM_THREADS": "1"}
    module, limit_s = "dermis.engines.cosim_hdl", factor * SLOT_LIMIT_S
    with contextlib.suppress(RuntimeError, SystemExit):  # of cocotb's runner, for a test that failed
        hdl.run_cocotb(simulator, build, "dermis_top", module, directory, told, limit_s=limit_s, run=simulate)
    try:
        result = pickle.loads((directory / "result.pickle").read_bytes())
    except OSError:
        what = f"the HDL simulator ended without a result in {_place(job, slots)}"
        raise SimulatorError(what, directory) from None
    if isinstance(result, InputError):  # a netlist that ngspice is not given
        raise result
    if isinstance(result, SimulatorError):
        raise SimulatorError(f"{_place(job, slots)}: {result.what}", result.log or directory)
    return result


def _place(job: Job, slots: int) -> str:
    read = [(block.frame, row) for scan in job.scans for block in scan for row in block.rows]
    frame, row = read[min(slots, len(read) - 1)]
    return f"frame {frame}, row {row}"
