# SPDX-License-Identifier: Apache-2.0
"""The cocotb test of engine cosim: an HDL simulator and, in the same process, ngspice.

Its job is a directory: job.pickle in; progress, result.npz or error.json, and logs out.
"""

from __future__ import annotations

import json
import os
import pickle
import traceback
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from dermis.chip import bridge
from dermis.chip.analog import ExactHalf
from dermis.chip.split import SplitHalf, Workers
from dermis.engines.cosim_job import JOB_VARIABLE, STATISTICS, Block, Job
from dermis.errors import SimulatorError
from dermis.files import write_atomic
from dermis.lockstep import ladder
from dermis.lockstep.ngspice import NgspiceHalf
from dermis.processes import cpu_time


async def _frames(dut: Any, job_dir: Path) -> None:
    job: Job = pickle.loads((job_dir / "job.pickle").read_bytes())
    timing = job.timing
    # Steps and waveforms of the circuits: of the running scan, and of the scans before it.
    kept: list[tuple[dict[str, int], Any]] = []
    ended: list[tuple[dict[str, int], Any]] = []
    ways: dict[int, ladder.Climb] = {}
    running: list[int] = []
    scanned, before = [], 0

    workers = Workers(job_dir / "ngspice.log")

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
        options: dict[str, Any] = {
            "t_edge_s": job.solver.t_edge_s,
            "t_max_step_s": job.solver.t_max_step_s,
            "t_stop_s": bridge.analog_s(timing, len(block.rows)),
            "record": job.record,
            "level": level,
        }
        if len(decks) == 1:
            half = NgspiceHalf(deck, log=job_dir / "ngspice.log", **options)
            half.advance(0.0, [])
            return half
        try:
            return SplitHalf(decks, timing.rows, workers, **options)
        except ladder.Abort:
            workers.close()  # the others' circuits are in the middle of theirs
            raise

    def make_half(block: Block, levels: list[float]) -> Any:
        running.append(block.frame)
        if job.ranges and (pins := tuple(chip.ranges())) != job.ranges:
            column = next(
                c for c, pair in enumerate(zip(pins, job.ranges, strict=True)) if pair[0] != pair[1]
            )
            raise SimulatorError(
                f"range_o selects {pins[column]} in column {column}, not {job.ranges[column]}"
            )
        if block.duty is not None:
            t_clk_s, t_edge_s = 1.0 / timing.f_clk_hz, job.solver.t_edge_s
            return ExactHalf(block.duty, levels, t_clk_s=t_clk_s, t_edge_s=t_edge_s)
        way = ways.setdefault(block.frame, ladder.Climb(f"frame {block.frame}"))
        half = ladder.climb(lambda level: circuit(block, levels, level), way)
        close = half.close

        def closed() -> None:
            kept.append((half.statistics, half.waveform() if job.record else None))
            close()

        half.close = closed
        return half

    progress = os.open(job_dir / "progress", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)

    def on_slot(slots: int) -> None:
        os.pwrite(progress, f"{before + slots}\n".encode(), 0)

    for scan in job.scans:
        while True:
            chip = bridge.Bridge(
                dut,
                timing,
                job.cols,
                rows=scan[0].rows,
                ranges=job.ranges,
                sync_latch=job.sync_latch,
                trace=job.record,
                progress=on_slot,
            )
            running.clear()
            try:
                codes = await chip.run(len(scan), lambda at, levels, scan=scan: make_half(scan[at], levels))
                break
            except ladder.Abort as abort:
                # Once more from reset, with this frame on its next rung: what the Verilog did with the samples before
                # the abort is not taken on, since on another rung they may be others.
                ways[running[-1]].up(abort)
                workers.close()
                os.ftruncate(progress, 0)
                kept.clear()
        scanned.append(codes.reshape(-1, job.cols))
        before += len(scanned[-1])
        ended += kept
        kept.clear()
    workers.close()
    arrays: dict[str, Any] = {"codes": np.concatenate(scanned)}
    for name in STATISTICS:
        arrays[f"statistics_{name}"] = sum(statistics[name] for statistics, _ in ended)
    arrays["processor_s"] = cpu_time.cpu_used_s()
    arrays["retries"] = json.dumps(
        {frame: [asdict(retry) for retry in way.retries] for frame, way in ways.items() if way.retries}
    )
    if chip.trace is not None:
        for name, values in vars(chip.trace).items():
            arrays[f"trace_{name}"] = np.array([f"{v:x}" for v in values])
        arrays["trace_charge_delay_clocks"] = chip.charge_delay_clocks
        for i, (time, probes) in enumerate(waveform for _, waveform in ended):
            arrays[f"wave{i}_time_s"] = time
            arrays[f"wave{i}_begin_s"] = chip.trace.begins[i] / timing.f_clk_hz
            arrays |= {f"wave{i}_{name}": values for name, values in probes.items()}
    scratch = job_dir / "result.partial.npz"
    np.savez(scratch, **arrays)
    scratch.replace(job_dir / "result.npz")


if JOB_VARIABLE in os.environ:
    import cocotb

    @cocotb.test()
    async def frames(dut: Any) -> None:
        """Read the frames of the job; whatever goes wrong is left as error.json for the parent."""
        job_dir = Path(os.environ[JOB_VARIABLE])
        try:
            await _frames(dut, job_dir)
        except Exception as error:
            said: dict[str, Any] = {"what": f"{type(error).__name__} in the co-simulation: {error}"}
            if isinstance(error, SimulatorError):
                said = {"what": error.what, "log": error.log}
            else:
                said["log"] = str(job_dir / "traceback.log")
                (job_dir / "traceback.log").write_text(traceback.format_exc())
            write_atomic(job_dir / "error.json", json.dumps(said))
            raise
