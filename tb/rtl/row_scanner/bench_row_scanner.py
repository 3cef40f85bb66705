# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of dermis_row_scanner."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import Any

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, RisingEdge, Timer
from cocotb.utils import get_sim_time
from rtl_bench import fall, report, rise, scenario

INPUTS = (
    "enable_i",
    "continuous_i",
    "shot_i",
    "test_i",
    "dark_i",
    "settle_i",
    "gate_i",
    "row_mask_i",
    "busy_i",
)
OUTPUTS = (
    "row_select_o",
    "preset_o",
    "gate_o",
    "inject_o",
    "full_even_o",
    "full_odd_o",
    "frame_start_o",
    "scanning_o",
    "slot_done_o",
    "done_slot_o",
    "done_first_o",
    "done_last_o",
    "done_test_o",
    "done_dark_o",
    "done_gate_o",
)


def random_inputs(rng: random.Random, rows: int, last: dict[str, int]) -> dict[str, int]:
    """Inputs that dwell, so that whole frames happen as well as every kind of interruption."""
    new = dict(last)
    new["enable_i"] = int(rng.random() < (0.995 if last["enable_i"] else 0.3))
    new["continuous_i"] = int(rng.random() < (0.98 if last["continuous_i"] else 0.01))
    new["shot_i"] = int(rng.random() < 0.01)
    new["test_i"] = int(rng.random() < 0.005)
    new["busy_i"] = int(rng.random() < (0.8 if last["busy_i"] else 0.05))
    if rng.random() < 0.02:
        new["dark_i"] = rng.randint(0, 1)
        new["settle_i"] = rng.choice([0, 1, 2, 3, 4, 7, 12])
        new["gate_i"] = rng.choice([0, 1, 2, 5, 9])
        new["row_mask_i"] = rng.choice([0, (1 << rows) - 1, rng.getrandbits(rows)])
    return new


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def play(dut: Any) -> None:
    """Play inputs, given as [clocks, {port: value}] changes or random; report inputs and outputs of each edge."""
    s = scenario()
    rng = random.Random(9)
    rows = len(dut.row_mask_i)
    inputs = dict.fromkeys(INPUTS, 0) | {"row_mask_i": (1 << rows) - 1, "settle_i": 5, "gate_i": 4}
    inputs |= s.get("inputs", {})
    dut.clk_i.value = 0
    dut.rst_ni.value = 0
    for name, value in inputs.items():
        getattr(dut, name).value = value
    await Timer(10, "ns")
    dut.rst_ni.value = 1
    await fall(dut)
    changes = {int(clock): change for clock, change in s.get("changes", ())}
    seen = []
    for clock in range(s["clocks"]):
        inputs = random_inputs(rng, rows, inputs) if s.get("random") else inputs | changes.get(clock, {})
        for name, value in inputs.items():
            getattr(dut, name).value = value
        await Timer(1, "ns")
        await rise(dut)
        seen.append([list(inputs.values()), [int(getattr(dut, name).value) for name in OUTPUTS]])
        await fall(dut)
        inputs |= {"shot_i": 0, "test_i": 0}
    report({"inputs": list(inputs), "outputs": OUTPUTS, "seen": seen})


@cocotb.test(timeout_time=1, timeout_unit="sec")
async def lengths(dut: Any) -> None:
    """Let the clock run by itself; report the clocks from enable to the gate and of the gate.

    Settle and gate go to zero meanwhile, so that the next slot is the shortest.
    """
    for name, value in (dict.fromkeys(INPUTS, 0) | scenario()["inputs"] | {"enable_i": 0}).items():
        getattr(dut, name).value = value
    dut.rst_ni.value = 0
    dut.clk_i.value = 0
    await Timer(5, "ns")
    dut.rst_ni.value = 1
    Clock(dut.clk_i, 10, "ns").start()
    await FallingEdge(dut.clk_i)
    dut.enable_i.value = 1
    await RisingEdge(dut.clk_i)
    edges = [get_sim_time("ns")]
    for _ in range(2):
        await FallingEdge(dut.preset_o)
        edges.append(get_sim_time("ns"))
        dut.settle_i.value = 0
        dut.gate_i.value = 0
        await RisingEdge(dut.preset_o)
        edges.append(get_sim_time("ns"))
    report([round((b - a) / 10) for a, b in pairwise(edges)])
