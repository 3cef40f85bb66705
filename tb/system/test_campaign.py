# SPDX-License-Identifier: Apache-2.0
"""A campaign notices a fault seeded in each engine, shrinks it and continues after a kill; found cases stay cured."""

from __future__ import annotations

import dataclasses
import random
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis.array.array import column_currents
from dermis.converter import coupling, walk
from dermis.effects import EFFECTS
from dermis.engines import Result, cosim, rtl
from dermis.records import Plan
from scripts import workers
from scripts.checkpoint import Checkpoint
from tb.programs.campaign import command, laws
from tb.reference import scenes
from tb.reference.scenes import PROFILES, World, random_scene

FOUND = sorted(command.FOUND.glob("*.toml"))
# Defects that are not cured yet (docs/verification.md); a cured case moves to FOUND.
OPEN = sorted((command.FOUND.parent / "open").glob("*.toml"))
UNIT_OHM = 250.0  # V_b / (k i0), so x = 250 / R


def made(effects: dict[str, Any] | None = None, ohm: Any = None, **interface: Any) -> World:
    """Two frames of 2 x 3 taxels from twice full scale down, with effects on."""
    values = (
        UNIT_OHM / np.linspace(0.03, 0.9, 12).reshape(2, 2, 3) if ohm is None else np.array(ohm, dtype=float)
    )
    rows, cols = values.shape[1:]
    scene = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "resistance", "file": "taxels.csv"},
        "interface": interface or {"topology": "conveyor_mirror"},
        "effects": effects or {},
    }
    return World(scene, files={"taxels.csv": values.reshape(-1, cols).tolist()})


def broken(one: World, engines: str = "closed,event", seeds: int = 3) -> set[str]:
    """Return the laws that a world breaks; some laws look at one cell a seed."""
    names = list(laws.ENGINES[engines])
    return {law for seed in range(seeds) for law in laws.judge(one, engines, seed, names).laws}


# ---- cases that campaigns found


@pytest.mark.parametrize(
    "path",
    # A deck takes seconds, other cases hundredths.
    [pytest.param(p, marks=[pytest.mark.long] * (scenes.load(p).engines == "cosim")) for p in FOUND],
    ids=lambda path: path.stem,
)
@pytest.mark.paper
def test_found_case_stays_cured(path: Path) -> None:
    case = scenes.load(path)
    assert len(FOUND) >= 10
    outcome = laws.judge(case, case.engines, 0, list(laws.ENGINES[case.engines]))
    assert not outcome.broken, f"{case.why}: {outcome.broken}"
    if case.refused:
        assert case.refused in outcome.refused
    else:
        assert not outcome.refused


@pytest.mark.long
@pytest.mark.parametrize("path", OPEN, ids=lambda path: path.stem)
def test_an_open_case_is_still_open(path: Path) -> None:
    case = scenes.load(path)
    assert laws.judge(case, case.engines, 0, list(laws.ENGINES[case.engines])).broken, (
        "cured: move it to found/"
    )


def test_a_world_survives_its_file(tmp_path: Path) -> None:
    one = dataclasses.replace(
        made({"row_driver": {"r_ohm": 3.5, "grounded_r_ohm": np.inf}, "auto": {"budget_lsb": 0.5}}),
        design={"timing": {"break_clocks": 2}},
        why='a "quoted" reason',
        refused="x",
    )
    (tmp_path / "made.toml").write_text(one.to_toml())
    assert scenes.load(tmp_path / "made.toml") == one


def drawn(engines: str, number: int, seed: int = 0) -> World:
    return command.scene_of(engines, seed, number)


def test_a_campaign_draws_everything() -> None:
    """Every effect, stimulus, topology and code width within the first 500 scenes."""
    worlds = [drawn("closed,event", n) for n in range(500)]
    assert {name for one in worlds for name in one.scene["effects"]} == {*EFFECTS, "auto"}
    assert {one.scene["stimulus"]["kind"] for one in worlds} == set(scenes.KINDS)
    assert len({one.scene["interface"]["topology"] for one in worlds}) == 4
    bits = {one.design.get("timing", {}).get("code_bits", 8) for one in worlds}
    assert min(bits) == 1
    assert max(bits) > 8
    assert drawn("closed,event", 7) == drawn("closed,event", 7)
    assert drawn("closed,event", 7, seed=1) != drawn("closed,event", 7)


def test_scenes_are_drawn_within_their_profile() -> None:
    """No deck draws random numbers, so that scenes for one have no noise; gentle scenes have only auto's budgets."""
    for engines in ("rtl", "cosim"):
        for n in range(100):
            on = drawn(engines, n).scene["effects"]
            assert not [
                name for name, value in on.items() if name in EFFECTS and EFFECTS[name].random and value
            ]
            assert "auto" not in on
    gentle = [random_scene(random.Random(n), PROFILES["auto"]) for n in range(20)]
    assert {one.scene["effects"]["auto"]["budget_lsb"] for one in gentle} == {0.0}
    assert all(one.plan(Path(), None) for one in gentle if not one.files)


@pytest.mark.parametrize(
    ("engines", "wanted"), [("rtl", 6), pytest.param("cosim", 3, marks=pytest.mark.long)]
)
def test_scenes_of_a_campaign_break_no_law(engines: str, wanted: int) -> None:
    """The first scenes that engine event and the other one both take."""
    compared = 0
    for number in range(4 * wanted):
        outcome = laws.judge(drawn(engines, number), engines, number)
        assert not outcome.broken, number
        compared += not outcome.refused
        if compared == wanted:
            return
    pytest.fail(f"{compared} of {4 * wanted} scenes were compared")


# ---- seeded faults


def _counts(change: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    original = walk.count_cells

    def wrong(cells: walk.Cells, clocks: int, *rest: Any) -> Any:
        counts, end = original(cells, clocks, *rest)
        return change(counts, cells), end

    return wrong


def _lost(module: Any, **fields: float) -> Callable[..., Result]:
    """Return an engine that ignores an effect."""
    original = module.run

    def wrong(plan: Plan, *rest: Any, **options: Any) -> Result:
        converter = dataclasses.replace(plan.converter, **fields)
        return original(dataclasses.replace(plan, converter=converter), *rest, **options)

    return wrong


def test_nothing_is_found_where_nothing_is_wrong() -> None:
    assert broken(made()) == set()
    assert broken(made({"column_input": True, "offset_current": {"i_a": -3e-8}})) == set()


def test_one_count_too_many_in_event_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "count_cells", _counts(lambda n, cells: n + (n > 100)))
    assert "closed_equals_event" in broken(made())


@pytest.mark.paper
def test_a_wrong_sign_in_event_alone_is_found_by_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference of fifty digits covers scenes that engine closed refuses."""
    original = walk.rows_of

    def wrong(cells: walk.Cells, charge_delay: float) -> walk.Rows:
        return original(dataclasses.replace(cells, leak=-cells.leak), charge_delay)

    monkeypatch.setattr(walk, "rows_of", wrong)
    found = broken(made({"integrator_gain": {"gain_dc": 20.0, "r_in_ohm": 1e5}}), seeds=8)
    assert found & {"fifty_digits", "monotone", "typed_errors"}


def test_frames_that_move_each_other_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A result that depends on the number of frames in a part."""
    original = coupling.coupling

    def wrong(plan: Plan, g: Any, x: Any) -> Any:
        found = original(plan, g, x)
        return found and dataclasses.replace(found, x=found.x + 1e-9 * len(g))

    monkeypatch.setattr(walk, "coupling", wrong)
    direct = {"topology": "direct"}
    assert "parts" in broken(made({"integrator_gain": True, "row_driver": True}, **direct))


def test_a_current_that_leaves_the_wrong_column_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    original = walk.column_currents

    def wrong(network: Any, g: Any) -> Any:
        current = original(network, g).copy()
        current[..., 0] *= 1.01
        return current

    monkeypatch.setattr(walk, "column_currents", wrong)
    assert {"closed_equals_event", "symmetric"} <= broken(made({"row_driver": {"r_ohm": 5.0}}), seeds=5)


def test_columns_that_shorts_join_are_known_to_what_the_engine_says_and_others_to_the_last_digits() -> None:
    case = scenes.load(command.FOUND / "symmetric_shorted_neighbours.toml")
    with tempfile.TemporaryDirectory() as scratch:
        plan = case.plan(Path(scratch), "event")
    apart = dataclasses.replace(
        plan, resistance_ohm=np.where(plan.resistance_ohm == 0, 1e3, plan.resistance_ohm)
    )
    for one, says in ((plan, True), (apart, False)):
        g = one.conductance_s()
        duty = one.converter.duty(column_currents(one.network(0), g))
        coupled = coupling.coupling(one, g, duty)
        assert coupled is not None
        assert (coupled.known > 0).any() == says


def test_a_warning_and_a_foreign_exception_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "count_cells", _counts(lambda n, cells: n // np.zeros_like(n)))
    assert laws.judge(made(), "closed,event", 0).laws == {"typed_errors"}


def test_a_lost_effect_in_the_verilog_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    one = made({"comparator_offset": {"v_v": 2.5}, "offset_current": {"i_a": 1e-7}})
    assert broken(one, "rtl", 1) == set()
    original = rtl.run_time_values

    def wrong(*arguments: Any) -> Any:
        values = original(*arguments)
        values[..., rtl.value_places()["RISE"]] *= -1.0
        return values

    monkeypatch.setattr(rtl, "run_time_values", wrong)
    assert broken(one, "rtl", 1) == {"through_verilog"}


@pytest.mark.long
def test_a_lost_effect_in_the_deck_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    one = made({"charge_packet": {"packet_error": 0.1}}, ohm=[[[600.0]]])
    assert broken(one, "cosim", 1) == set()
    monkeypatch.setattr(cosim, "run", _lost(cosim, packet_error=0.0))
    assert broken(one, "cosim", 1) == {"through_spice"}


# ---- going on


def _piece(engines: str, seed: int, first: int, stop: int) -> dict[str, Any]:
    wrong = [(n, "numbers", "made up") for n in range(first, stop) if n == 7]
    return {"counts": {"worlds": stop - first, "compared.numbers": stop - first}, "broken": wrong}


def _workers(ends_after: int | None = None, hangs: int = -1) -> Callable[..., Iterator[tuple[int, Any]]]:
    def run(
        tasks: Iterable[workers.Task], count: int, fresh: bool = False
    ) -> Iterator[tuple[int, workers.Outcome]]:
        for number, task in enumerate(tasks):
            if number == ends_after:
                raise KeyboardInterrupt
            first, stop = task.arguments[2:]
            if first <= hangs < stop:
                yield number, workers.Outcome(fault="hangs: ended after 1 s")
            else:
                yield number, workers.Outcome(task.function(*task.arguments))

    return run


def test_a_campaign_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "run_scenes", _piece)

    def run(scenes_: int, path: str, ends_after: int | None = None) -> command.Tally:
        monkeypatch.setattr(workers, "run", _workers(ends_after))
        return command.run("closed,event", 0, scenes_, Checkpoint(tmp_path / path, "code"), 1)

    expected = run(333, "whole.json")
    assert expected.counts["worlds"] == 333
    assert expected.broken == [(7, "numbers", "made up")]
    (stored,) = command.store_cases("closed,event", 0, expected, tmp_path)
    assert scenes.load(stored).scene == drawn("closed,event", 7).scene
    with pytest.raises(KeyboardInterrupt):
        run(333, "ended.json", ends_after=3)
    assert len(Checkpoint(tmp_path / "ended.json", "code").pieces) == 3
    assert run(333, "ended.json", ends_after=4) == expected
    # A longer or a shorter run counts its own scenes only.
    assert run(75, "ended.json").counts["worlds"] == 75


def test_a_scene_that_hangs_is_named_and_the_others_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "run_scenes", _piece)
    monkeypatch.setattr(workers, "run", _workers(hangs=61))
    total = command.run("closed,event", 0, 120, Checkpoint(tmp_path / "state.json", "code"), 1)
    assert total.counts["worlds"] == 120
    assert (61, "ends", "hangs: ended after 1 s") in total.broken
    rows = {row["name"]: row for row in command.rows("closed,event", 0, 120, total)}
    assert rows["campaign.broken.closed_event.ends"]["status"] == "FAIL"
    assert rows["campaign.broken.closed_event.numbers"]["value"] == 1
