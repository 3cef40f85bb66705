# SPDX-License-Identifier: Apache-2.0
"""What each effect costs: shifts that can be told beforehand, the engine behind them, and the rows."""

from pathlib import Path

import numpy as np
import pytest

from dermis import effects, plan
from dermis.converter import vfc
from dermis.errors import InputError
from dermis.report import ablate
from dermis.scene import scene
from dermis.scene.scene import Scene

CODES = list(range(3, 250, 8))


def _world(tmp_path: Path, codes: list[int] = CODES, **effects: object) -> Scene:
    stimulus = {"kind": "uniform", "code": codes}
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": stimulus, "effects": effects}
    return scene.from_data(data, tmp_path / "ablate.toml")


def _by_name(costs: list[ablate.Cost]) -> dict[str, ablate.Cost]:
    return {cost.name: cost for cost in costs}


def test_costs_are_those_of_the_formula(tmp_path: Path) -> None:
    world = _world(tmp_path, charge_packet={"packet_error": -0.0213}, comparator_offset={"v_v": 1e-6})
    full, costs = ablate.measure(world, pairs=1)
    assert full.engine == "closed"
    found = _by_name(costs)
    assert list(found) == [ablate.EVERYTHING, "charge_packet", "comparator_offset"]
    x = np.array(CODES) / 510
    shift = vfc.code(x, packet=1 - 0.0213) - vfc.code(x)
    packet = found["charge_packet"]
    assert packet.code_max_lsb == shift.max() > 3
    assert packet.mean_shift_lsb == pytest.approx(shift.mean())
    assert packet.moved == pytest.approx((shift != 0).mean())
    assert (found["comparator_offset"].code_max_lsb, found["comparator_offset"].moved) == (0, 0.0)
    assert found[ablate.EVERYTHING].code_max_lsb == packet.code_max_lsb
    assert all(cost.time_ratio > 0 for cost in costs)


def test_everything_runs_through_the_cheapest_engine_that_can_do_it_all(tmp_path: Path) -> None:
    world = _world(tmp_path, CODES[:3], row_driver=True, comparator_delay=True)
    full, costs = ablate.measure(world, pairs=1)
    assert full.engine == "event"
    found = _by_name(costs)
    assert (found["comparator_delay"].engine, found["row_driver"].engine) == ("closed", "event")
    with pytest.raises(InputError, match="not possible with engine closed"):
        ablate.measure(world, "closed", pairs=1)


def test_a_scene_without_effects_has_nothing_to_take_off(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one effect"):
        ablate.measure(_world(tmp_path))


def test_long_scenes_are_ablated_where_most_happens(tmp_path: Path) -> None:
    codes = [1] * 40 + [200, 210] + [1] * 40
    made = plan.make(_world(tmp_path, codes))
    part = made.busiest(6)
    assert (part.frames, part.first_frame <= 40, part.first_frame + 6 > 41) == (6, True, True)
    assert made.busiest(100) is made
    world = _world(tmp_path, codes, charge_packet={"packet_error": -0.02})
    full, costs = ablate.measure(world, frames=2, pairs=1)
    assert full.frames == 2
    assert _by_name(costs)["charge_packet"].code_max_lsb == 4  # 205 where 201 was


def test_rows_and_figure_hold_every_cost(tmp_path: Path) -> None:
    full, costs = ablate.measure(_world(tmp_path, CODES[:2], row_driver=True, mirror_ratio=True), pairs=1)
    rows = {row["name"]: row for row in ablate.rows_of(costs, full)}
    assert len(rows) == 4 * 3
    assert rows["ablate.mirror_ratio.code_max_lsb"]["value"] == _by_name(costs)["mirror_ratio"].code_max_lsb
    assert {row["status"] for row in rows.values()} == {"PASS"}
    lines = ablate.docs_table(costs, "a title").splitlines()
    assert lines[0] == "a title."
    assert [line.split("`")[1] for line in lines[4:]] == [cost.name for cost in costs]
    assert len({line.count("|") for line in lines[2:]}) == 1
    ablate.figure(costs, "a title", tmp_path / "ablate.png")
    assert (tmp_path / "ablate.png").stat().st_size > 5000


# Every effect that is off compiles a loop of its own: some forty with all, which is the long one.
FEW = ("trace", "leak", "thermal_noise", "comparator_delay", "charge_packet", "motion", "row_driver")


@pytest.mark.parametrize(
    "off", [pytest.param({"trace"}, marks=pytest.mark.long), set(effects.EFFECTS) - set(FEW[1:])]
)
def test_auto_is_ablated_with_all_that_it_may_choose_from(tmp_path: Path, off: set[str]) -> None:
    world = _world(tmp_path, [120], auto={"budget_lsb": 0.25}, **dict.fromkeys(off, False))
    assert plan.make(world).filtered
    full, costs = ablate.measure(world, pairs=1)
    names = {cost.name for cost in costs} - {ablate.EVERYTHING}
    assert names == set(scene.with_auto(world).effects)
    assert "trace" not in names
    assert {e.name for e in full.effects if e.on} == names
    assert full.engine == "event"
