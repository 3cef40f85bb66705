# SPDX-License-Identifier: Apache-2.0
"""Engine cosim with auto: rows that engine event decides are masked on the chip, and no code changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deck_bench import DeckReader
from system_bench import MakePlan

from dermis import engines
from dermis.chip import hdl
from dermis.effects import EFFECTS
from dermis.engines import batch, closed, cosim, masking
from dermis.errors import SimulatorError
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES
from scripts import lint

NO_NOISE = "".join(f"{e.name} = false\n" for e in EFFECTS.values() if e.random)
"""Engine cosim takes no random effect."""


def near_steps(codes: Any) -> np.ndarray:
    """Resistances whose ideal level lies 0.004 packets above the step to a code: engine event is not certain of it."""
    return 250.0 * 510 / (np.asarray(codes, dtype=float) - 0.5 + 0.004)


def middles(codes: Any) -> np.ndarray:
    """Resistances in the middle of codes, inf for 0."""
    with np.errstate(divide="ignore"):
        return 250.0 * 510 / np.asarray(codes, dtype=float)


def filtered(plan: Plan) -> Plan:
    return replace(plan, filtered=True)


OHM = np.stack([middles(np.arange(12).reshape(4, 3) * k) for k in (1, 7, 19)])
OHM[0, 1, 2] = near_steps(40)
OHM[0, 3, 0] = near_steps(200)
OHM[2, 0, 1] = near_steps(3)


@pytest.mark.paper
def test_open_rows_alone_are_scanned(resistance_plan: MakePlan) -> None:
    """The bridge, the Verilog and its ROW_MASK, without a circuit simulator."""
    plan = filtered(resistance_plan(OHM))
    seen: list[int] = []
    result = cosim.run(plan, seen.append, analog="exact")
    assert np.array_equal(result.codes, closed.run(plan).codes)
    assert result.info["masked"] == {
        "rows_solved": 3,
        "rows_masked": 9,
        "rows_before": 0,
        "cells_open": 3,
        "reason": "",
        "rows": {"frame 0": "1, 3", "frame 2": "0"},
    }
    assert seen[-1] == 12


@pytest.mark.paper
def test_no_open_cell_starts_no_simulator(resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim, "_run_job", None)
    plan = filtered(resistance_plan(OHM[1:2]))
    result = cosim.run(plan)
    assert np.array_equal(result.codes, closed.run(plan).codes)
    assert result.info["masked"]["rows_solved"] == 0


def test_parts_have_the_rows_of_the_whole(resistance_plan: MakePlan) -> None:
    plan = filtered(resistance_plan(OHM))
    whole = masking.decide(plan).as_dict(plan.first_frame)
    tables = [masking.decide(part).as_dict(part.first_frame) for part in (plan.part(0, 2), plan.part(2, 3))]
    assert masking.merged(tables) == whole
    joined = batch._joined(
        [engines.Result(np.zeros((n, 4, 3)), {"masked": t}) for n, t in zip((2, 1), tables, strict=True)],
        [2, 1],
    )
    assert joined.info["masked"] == whole


@pytest.mark.paper
def test_a_chip_that_ignores_its_mask_is_found(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = lint.rtl_sources()
    at = next(i for i, source in enumerate(sources) if source.name == "dermis_row_scanner.v")
    text, right = sources[at].read_text(), "list       = {row_mask_i,"
    assert text.count(right) == 1, "the fault no longer fits the chip"
    sources[at] = tmp_path / "dermis_row_scanner.v"
    sources[at].write_text(text.replace(right, "list       = {{ROWS{1'b1}},"))
    monkeypatch.setattr(hdl, "rtl_sources", lambda: sources)
    with pytest.raises(SimulatorError, match="does not begin with row 1 driven"):
        cosim.run(filtered(resistance_plan(OHM[:1])), analog="exact", work=tmp_path / "work")


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        pytest.param(
            "range(rows[0], rows[-1] + 2)",
            "does not end 688 clocks after its first row",
            marks=pytest.mark.long,
        ),
        ("range(rows[0] - 1, rows[-1] + 1)", "does not begin with row 1 driven"),
    ],
)
def test_a_wrong_mask_is_found(
    resistance_plan: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: str, said: str
) -> None:
    """A host that masks too few rows: the co-simulation runs in a process of its own, which loads the fault."""
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(
        "import os\n"
        'if "DERMIS_COSIM_JOB" in os.environ:\n'
        "    from dermis.chip import bridge\n"
        "    right = bridge._settings\n"
        "    def wrong(timing, cols, rows, ranges):\n"
        f"        return right(timing, cols, {rows}, ranges)\n"
        "    bridge._settings = wrong\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "hook"), prepend=":")
    with pytest.raises(SimulatorError, match=said):
        cosim.run(filtered(resistance_plan(OHM[:1])), analog="exact", work=tmp_path / "work")


@pytest.mark.paper
def test_a_wrong_verdict_is_found_and_every_row_solved(
    resistance_plan: MakePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, right = filtered(resistance_plan(OHM[:1])), masking.decide

    def wrong(plan: Plan) -> masking.Verdict:
        found = right(plan)
        found.codes[0, 1, 0] += 1
        return found

    monkeypatch.setattr(masking, "decide", wrong)
    result = cosim.run(plan, analog="exact")
    assert np.array_equal(result.codes, closed.run(plan).codes)
    assert result.info["masked"]["rows_masked"] == 0
    assert "certain of" in result.info["masked"]["reason"]


def solved_both_ways(plan: Plan) -> dict[str, Any]:
    """Compare codes with and without masked rows; return the table."""
    assert plan.filtered
    masked, whole = cosim.run(plan), cosim.run(replace(plan, filtered=False))
    assert np.array_equal(masked.codes, whole.codes)
    table = masked.info["masked"]
    assert not table["reason"], table
    return table


def open_in(make: Any, rows: set[int]) -> Plan:
    """The first of some plans in which exactly these rows of frame 0 are open."""
    for seed in range(300):
        plan = make(np.random.default_rng(seed))
        verdict = masking.decide(plan)
        if set(np.flatnonzero(verdict.open[0].any(axis=1))) == rows and not verdict.reason:
            return plan
    raise AssertionError("no such scene")


@pytest.mark.parametrize(
    "topology", [TOPOLOGIES[0], *(pytest.param(t, marks=pytest.mark.long) for t in TOPOLOGIES[1:])]
)
def test_codes_with_every_effect_are_those_of_all_rows(resistance_plan: MakePlan, topology: str) -> None:
    effects = "auto = {}\nlateral = false\n" + NO_NOISE if topology == "direct" else "auto = {}\n" + NO_NOISE
    if topology == "direct":  # columns that move each other are all solved
        effects += "integrator_gain = false\nintegrator_bandwidth = false\n"
    plan = open_in(lambda rng: resistance_plan(520 * 60 ** rng.random((5, 3)), topology, effects), {2})
    table = solved_both_ways(plan)
    assert table["rows"] == {"frame 0": "2"}


@pytest.mark.long
def test_time_runs_on_over_masked_rows(resistance_plan: MakePlan) -> None:
    """Ripple and moving taxels in row 3 of 4: wrong by several codes if the scan of row 3 began at time zero."""
    effects = "auto = {}\nmotion = {}\nsupply_ripple = { relative = 0.05, frequency_hz = 700.0 }\n" + NO_NOISE

    def make(rng: np.random.Generator) -> Plan:
        ohm = 600 * 4 ** rng.random((2, 4, 2))
        return resistance_plan(ohm, effects=effects)

    table = solved_both_ways(open_in(make, {3}))
    assert table["rows"]["frame 0"] == "3"


@pytest.mark.long
@pytest.mark.parametrize(
    "slow",
    [
        "mirror_lag = { q_c = 4e-12 }",
        "line_capacitance = { c_row_f = 6e-8 }\nrow_driver = { r_ohm = 100.0 }\ntrace = false",
    ],
)
def test_rows_that_are_remembered_are_solved_as_well(resistance_plan: MakePlan, slow: str) -> None:
    plan = open_in(
        lambda rng: resistance_plan(
            900 * 60 ** rng.random((5, 2)), effects=f"auto = {{}}\n{slow}\n" + NO_NOISE
        ),
        {3},
    )
    table = solved_both_ways(plan)
    assert table["rows_before"] > 0
    assert table["rows_masked"] > 0


def test_reasons_for_solving_every_row(resistance_plan: MakePlan) -> None:
    coupled = "lateral = { r_ohm = 1e5 }\nintegrator_gain = true\n"
    plan = resistance_plan(OHM[:1], "direct", coupled)
    assert "move each other" in masking.decide(plan).reason
    tied = resistance_plan(OHM[:1], effects="integrator_bandwidth = { gbw_hz = 20e3 }\n")
    assert masking.decide(tied).open.all()  # an amplifier that has not settled when the gate opens
    recorded = cosim.run(filtered(resistance_plan(OHM[:1, :2, :2])), record=True)
    assert "waveforms" in recorded.info["masked"]["reason"]


@pytest.mark.parametrize(
    "topology", ["conveyor_mirror", pytest.param("multi_output_conveyor", marks=pytest.mark.long)]
)
def test_levels_of_ngspice_are_as_close_as_the_masks_assume(
    resistance_plan: MakePlan, tmp_path: Path, topology: str
) -> None:
    """Offsets put the level of every column APART_LSB from a step, first below, then above."""
    effects = "auto = {}\nintegrator_range = false\n" + NO_NOISE
    plan = replace(
        resistance_plan(700 * 60 ** np.random.default_rng(5).random((1, 6)), topology, effects),
        filtered=False,
    )
    like = replace(plan, engine="event")
    codes = engines.run(like).codes
    low, high = np.zeros(plan.cols), np.ones(plan.cols)

    def moved(made: Plan, packets: np.ndarray) -> Plan:
        c = made.converter
        offset_v = c.v_comp_offset_v + packets * c.packet_v()
        return replace(made, converter=replace(c, v_comp_offset_v=offset_v))

    for _ in range(14):
        middle = 0.5 * (low + high)
        same = (engines.run(moved(like, middle)).codes >= codes)[0, 0]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    reader = DeckReader(tmp_path)
    for sign, expected in ((-1.0, codes), (1.0, codes - 1)):
        assert np.array_equal(reader.codes(moved(plan, low + sign * masking.APART_LSB)), expected)
    reader.close()
