# SPDX-License-Identifier: Apache-2.0
"""The cocotb test of engine cosim: an HDL simulator and, in the same process, ngspice.

Its job is a directory: job.pickle in; progress, result.pickle and logs out.
"""

import os
import pickle
import traceback
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dermis.chip import bridge
from dermis.chip.analog import ExactHalf
from dermis.chip.split import SplitHalf, Workers
from dermis.engines.cosim_job import JOB_VARIABLE, STATISTICS, Block, Job
from dermis.errors import DermisError, SimulatorError
from dermis.files import write_atomic
from dermis.lockstep import ladder
from dermis.lockstep.ngspice import NgspiceHalf
from dermis.processes import cpu_time


async def _frames(dut: Any, job_dir: Path) -> dict[str, Any]:
    job: Job = pickle.loads((job_dir / "job.pickle").read_bytes())
    timing = job.timing
    ended: list[tuple[dict[str, int], Any]] = []  # steps and waveforms of circuits
    ways: dict[int, ladder.Climb] = {}
    way = ladder.Climb("no frame")  # of the running frame
    scanned: list[Any] = []
    workers = Workers()

    def circuit(block: Block, levels: list[float], level: ladder.Level) -> NgspiceHalf | SplitHalf:
        first, decks, shared = block.rows[0], {}, timing.rows + 1
        for part, deck in block.decks.items():
            at_start = (*levels[:shared], *(levels[shared + column] for column in part))
            lines = (*deck.lines, job.solver.options) if job.solver.options else deck.lines
            deck = replace(deck, lines=lines, levels=at_start)
            name = f"frame_{block.frame}" + (f"_row_{first}" if first else "")
            name += (f"_column_{part[0]}" if part else "_rows") if len(block.decks) > 1 else ""
            write_atomic(job_dir / f"{name}.cir", "\n".join(deck.lines) + "\n")
            decks[part] = deck
        options: dict[str, Any] = {"t_edge_s": job.solver.t_edge_s, "t_max_step_s": job.solver.t_max_step_s}
        options |= {"log": job_dir / "ngspice.log", "record": job.record, "level": level}
        options["t_stop_s"] = bridge.analog_s(timing, len(block.rows))
        if len(decks) == 1:
            half = NgspiceHalf(deck, **options)
            half.advance(0.0, [])
            return half
        try:
            return SplitHalf(decks, timing.rows, workers, **options)
        except ladder.Abort:
            workers.close()  # the others' circuits are in the middle of theirs
            raise

    def make_half(block: Block, levels: list[float]) -> Any:
        nonlocal way
        for column, (wanted, found) in enumerate(zip(job.ranges, chip.ranges(), strict=False)):
            if found != wanted:
                raise SimulatorError(f"range_o selects {found} in column {column}, not {wanted}")
        if block.duty is not None:
            t_clk_s, t_edge_s = 1.0 / timing.f_clk_hz, job.solver.t_edge_s
            return ExactHalf(block.duty, levels, t_clk_s=t_clk_s, t_edge_s=t_edge_s)
        way = ways.setdefault(block.frame, ladder.Climb(f"frame {block.frame}"))
        half = ladder.climb(lambda level: circuit(block, levels, level), way)
        close = half.close

        def closed() -> None:
            ended.append((half.statistics, half.waveform() if job.record else None))
            close()

        half.close = closed
        return half

    progress = (job_dir / "progress").open("wb", buffering=0)
    on_slot = partial(progress.write, b".")  # a byte a slot
    for scan in job.scans:
        before = len(ended)
        while True:
            options = {"sync_latch": job.sync_latch, "trace": job.record, "progress": on_slot}
            chip = bridge.Bridge(dut, timing, job.cols, rows=scan[0].rows, ranges=job.ranges, **options)
            try:
                codes = await chip.run(len(scan), lambda at, levels, scan=scan: make_half(scan[at], levels))
                break
            except ladder.Abort as abort:
                # Once more from reset, with this frame on its next rung: what the Verilog did with the samples before
                # the abort is not taken on, since on another rung they may be others.
                way.up(abort)
                workers.close()
                progress.truncate(progress.seek(sum(map(len, scanned))))
                del ended[before:]
        scanned.append(codes.reshape(-1, job.cols))
    workers.close()
    result: dict[str, Any] = {
        "codes": np.concatenate(scanned),
        "steps": {name: sum(statistics[name] for statistics, _ in ended) for name in STATISTICS},
        "processor_s": cpu_time.cpu_used_s(),
        "retries": {frame: way.retries for frame, way in ways.items() if way.retries},
    }
    if chip.trace is not None:
        result["trace"] = vars(chip.trace)
        result["charge_delay_clocks"] = chip.charge_delay_clocks
        begins_s = [begin / timing.f_clk_hz for begin in chip.trace.begins]
        result["waves"] = [(begin_s, *wave) for begin_s, (_, wave) in zip(begins_s, ended, strict=False)]
    return result


if JOB_VARIABLE in os.environ:
    import cocotb

    @cocotb.test()
    async def frames(dut: Any) -> None:
        """Leave the result of the job, or its error, for the parent."""
        job_dir = Path(os.environ[JOB_VARIABLE])
        result: Any
        try:
            result = await _frames(dut, job_dir)
        except DermisError as error:
            result = error
        except Exception as error:  # whatever it is, the parent reports it
            log = job_dir / "traceback.log"
            log.write_text(traceback.format_exc())
            result = SimulatorError(f"{type(error).__name__} in the co-simulation: {error}", log)
        write_atomic(job_dir / "result.pickle", pickle.dumps(result))
