# SPDX-License-Identifier: Apache-2.0
"""Engine cosim with auto: rows that engine event decides are masked on the chip, and no code changes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deck_bench import DeckReader
from system_bench import FaultyChip, MakePlan

from dermis.effects import EFFECTS
from dermis.engines import closed, cosim, event, masking
from dermis.errors import SimulatorError
from dermis.records import Plan

NO_NOISE = "".join(f"{e.name} = false\n" for e in EFFECTS.values() if e.random)
"""Engine cosim takes no random effect."""

# Levels in the middle of codes, but for three that lie 0.004 packets above a step: those stay open.
with np.errstate(divide="ignore"):
    OHM = 250.0 * 510 / np.stack([np.arange(12.0).reshape(4, 3) * k for k in (1, 7, 19)])
OHM[0, 1, 2], OHM[0, 3, 0], OHM[2, 0, 1] = 250.0 * 510 / (np.array([40, 200, 3]) - 0.5 + 0.004)


def filtered(plan: Plan) -> Plan:
    return replace(plan, filtered=True)


@pytest.mark.paper
def test_open_rows_alone_are_scanned(resistance_plan: MakePlan) -> None:
    """The bridge, the Verilog and its ROW_MASK, without a circuit simulator."""
    plan = filtered(resistance_plan(OHM))
    seen: list[int] = []
    result = cosim.run(plan, seen.append, analog="exact")
    assert np.array_equal(result.codes, closed.run(plan).codes)
    table = result.info["masked"]
    assert table["rows"] == {"frame 0": "1, 3", "frame 2": "0"}
    assert (table["rows_solved"], table["rows_masked"], table["reason"]) == (3, 9, "")
    assert seen[-1] == 12


@pytest.mark.paper
def test_no_open_cell_starts_no_simulator(resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim, "_run_job", None)
    plan = filtered(resistance_plan(OHM[1:2]))
    result = cosim.run(plan)
    assert np.array_equal(result.codes, closed.run(plan).codes)
    assert result.info["masked"]["rows_solved"] == 0


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        ("{ROWS{1'b1}}", "does not begin with row 1 driven"),
        pytest.param("row_mask_i | (row_mask_i << 1)", "does not end 624 clocks", marks=pytest.mark.long),
    ],
)
@pytest.mark.paper
def test_a_chip_that_scans_other_rows_is_found(
    resistance_plan: MakePlan, tmp_path: Path, faulty_chip: FaultyChip, mask: str, said: str
) -> None:
    faulty_chip("dermis_row_scanner.v", "list       = {row_mask_i,", f"list       = {{{mask},")
    with pytest.raises(SimulatorError, match=said):
        cosim.run(filtered(resistance_plan(OHM[:1])), analog="exact", work=tmp_path / "work")


@pytest.mark.paper
def test_a_decided_cell_that_reads_otherwise_has_every_row_solved(
    resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, right, calls = filtered(resistance_plan(OHM[:1])), cosim._run_job, []

    def once_wrong(*arguments: Any) -> dict[str, Any]:
        part = right(*arguments)
        calls.append(len(part["codes"]))
        part["codes"][0][1] += len(calls) == 1
        return part

    monkeypatch.setattr(cosim, "_run_job", once_wrong)
    result = cosim.run(plan, analog="exact")
    assert np.array_equal(result.codes, closed.run(plan).codes)
    assert result.info["masked"]["rows_masked"] == 0
    assert "certain of" in result.info["masked"]["reason"]


RIPPLE = "motion = {}\nsupply_ripple = { relative = 0.05, frequency_hz = 700.0 }\n"
ALONE = "lateral = false\nintegrator_gain = false\nintegrator_bandwidth = false\n"
# Scenes with everything on in which one row alone is open: topology, effects, shape, seed, and that row. Columns of
# `direct` that move each other would all be solved. With ripple and moving taxels the last row is off by several codes
# if its scan begins at time zero. Slow mirrors remember the row before, which is solved as well.
CASES = {
    "direct": ("direct", ALONE, (3, 2), 36, 1),
    "mirror": ("conveyor_mirror", "", (5, 3), 99, 2),
    "inverted": ("conveyor_mirror_inverted", "", (5, 3), 99, 2),
    "multi_output": ("multi_output_conveyor", "", (5, 3), 99, 2),
    "time": ("conveyor_mirror", RIPPLE, (2, 4, 2), 4, 3),
    "lag": ("conveyor_mirror", "mirror_lag = { q_c = 4e-12 }\n", (5, 2), 59, 3),
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] * (n != "direct")) for n in CASES])
def test_codes_with_every_effect_are_those_of_all_rows(resistance_plan: MakePlan, name: str) -> None:
    topology, effects, shape, seed, row = CASES[name]
    ohm = 600 * 40 ** np.random.default_rng(seed).random(shape)
    plan = resistance_plan(ohm, topology, f"auto = {{}}\n{effects}{NO_NOISE}")
    masked, whole = cosim.run(plan), cosim.run(replace(plan, filtered=False))
    assert np.array_equal(masked.codes, whole.codes)
    table = masked.info["masked"]
    assert not table["reason"], table
    assert str(row) in table["rows"]["frame 0"]
    assert table["rows_masked"] > 0
    assert name != "lag" or table["rows_solved"] > 1


@pytest.mark.long
@pytest.mark.parametrize("topology", ["conveyor_mirror", "multi_output_conveyor"])
def test_levels_of_ngspice_are_as_close_as_the_masks_assume(
    resistance_plan: MakePlan, reader: DeckReader, topology: str
) -> None:
    """Offsets put the level of every column APART_LSB from a step, first below, then above."""
    effects = "auto = {}\nintegrator_range = false\n" + NO_NOISE
    plan = resistance_plan(700 * 60 ** np.random.default_rng(5).random((1, 6)), topology, effects)
    plan = replace(plan, filtered=False)

    def moved(lsb: Any) -> Plan:
        offset = plan.converter.v_comp_offset_v + lsb * plan.converter.packet_v()
        return replace(plan, converter=replace(plan.converter, v_comp_offset_v=offset))

    codes = event.run(plan).codes
    low, high = np.zeros(codes.shape[-1]), np.ones(codes.shape[-1])
    for _ in range(14):
        middle = 0.5 * (low + high)
        same = (event.run(moved(middle)).codes >= codes)[0, 0]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    for sign, expected in ((-1.0, codes), (1.0, codes - 1)):
        assert np.array_equal(reader.codes(moved(low + sign * masking.APART_LSB)), expected)
