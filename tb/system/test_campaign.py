# SPDX-License-Identifier: Apache-2.0
"""A campaign notices a fault seeded in each engine, shrinks it and continues after a kill; found cases stay cured."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis.converter import walk
from dermis.effects import EFFECTS
from dermis.engines import cosim, rtl
from dermis.records import Plan
from scripts import workers
from scripts.checkpoint import Checkpoint
from tb.programs.campaign import command, laws
from tb.reference import scenes
from tb.reference.scenes import World

FOUND = sorted(command.FOUND.glob("*.toml"))
OHM = 250.0 / np.linspace(0.03, 0.9, 12).reshape(2, 2, 3)  # V_b / (k i0) is 250 ohm, so x = 250 / R


def made(effects: Any = None, ohm: Any = OHM, engines: str = "closed,event", **interface: Any) -> World:
    """Two frames of 2 x 3 taxels from twice full scale down, with effects on."""
    values = np.array(ohm, dtype=float)
    rows, cols = values.shape[1:]
    stimulus = {"kind": "resistance", "file": "taxels.csv"}
    scene = {"array": {"rows": rows, "cols": cols}, "stimulus": stimulus, "effects": effects or {}}
    scene["interface"] = interface or {"topology": "conveyor_mirror"}
    return World(scene, files={"taxels.csv": values.reshape(-1, cols).tolist()}, engines=engines)


def broken(one: World, engines: str = "closed,event", seeds: int = 3) -> set[str]:
    """Return the laws that a world breaks; some laws look at one cell a seed."""
    names = list(laws.ENGINES[engines])
    return {law for seed in range(seeds) for law, _ in laws.judge(one, engines, seed, names).broken}


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
    assert case.refused in outcome.refused
    assert bool(case.refused) == bool(outcome.refused)


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


@pytest.mark.parametrize(("engines", "least"), [("rtl", 6), pytest.param("cosim", 3, marks=pytest.mark.long)])
def test_scenes_of_a_campaign_break_no_law(engines: str, least: int) -> None:
    """The first scenes that engine event and the other one both take."""
    compared = 0
    for number in range(4 * least):
        outcome = laws.judge(drawn(engines, number), engines, number)
        assert not outcome.broken, number
        compared += not outcome.refused
        if compared == least:
            return
    pytest.fail(f"{compared} of {4 * least} scenes were compared")


# ---- seeded faults


def _lost(run: Any, plan: Plan, **options: Any) -> Any:
    """Run without an effect."""
    converter = dataclasses.replace(plan.converter, packet_error=0.0)
    return run(dataclasses.replace(plan, converter=converter), **options)


def _count(change: Callable[[Any], Any]) -> Callable[..., Any]:
    def wrong(real: Any, *given: Any) -> Any:
        counts, end = real(*given)
        return change(counts), end

    return wrong


def _leak(real: Any, cells: walk.Cells, charge_delay: float) -> walk.Rows:
    return real(dataclasses.replace(cells, leak=-cells.leak), charge_delay)


def _coupled(real: Any, plan: Plan, part: slice) -> Any:
    found = real(plan, part)
    return found and found._replace(links=found.links * (1.0 + 1e-9 * (part.stop - part.start)))


def _first_column(real: Any, *given: Any) -> Any:
    return real(*given) * np.array([1.01, 1.0, 1.0])


def _no_offset(real: Any, *given: Any) -> Any:
    values = real(*given)
    values[..., rtl.value_places()["RISE"]] *= -1.0
    return values


OFFSETS = made({"comparator_offset": {"v_v": 2.5}, "offset_current": {"i_a": 1e-7}}, engines="rtl")
GAIN = {"integrator_gain": {"gain_dc": 20.0, "r_in_ohm": 1e5}}
COUPLED = made({"integrator_gain": True, "row_driver": True}, topology="direct")
PACKET = made({"charge_packet": {"packet_error": 0.1}}, ohm=[[[600.0]]], engines="cosim")


@pytest.mark.paper
@pytest.mark.parametrize(
    ("law", "seeded", "one", "seeds"),
    [
        ("closed_equals_event", (walk, "count_cells", _count(lambda n: n + (n > 100))), made(), 3),
        ("typed_errors", (walk, "count_cells", _count(lambda n: n // np.zeros_like(n))), made(), 1),
        # The reference of fifty digits covers scenes that engine closed refuses.
        ("fifty_digits", (walk, "rows_of", _leak), made(GAIN), 8),
        ("parts", (walk, "coupling", _coupled), COUPLED, 3),
        ("symmetric", (walk, "column_currents", _first_column), made({"row_driver": {"r_ohm": 5.0}}), 5),
        ("through_verilog", (rtl, "run_time_values", _no_offset), OFFSETS, 1),
        pytest.param("through_spice", (cosim, "run", _lost), PACKET, 1, marks=pytest.mark.long),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_law_holds_and_breaks_on_its_fault(
    law: str, seeded: tuple[Any, str, Any], one: World, seeds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert broken(one, one.engines, 1) == set()
    module, name, fault = seeded
    real = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *given, **more: fault(real, *given, **more))
    assert law in broken(one, one.engines, seeds)


# ---- going on


def _piece(engines: str, seed: int, first: int, stop: int) -> dict[str, Any]:
    wrong = [(n, "numbers", "made up") for n in range(first, stop) if n == 7]
    return {"counts": {"worlds": stop - first, "compared.numbers": stop - first}, "broken": wrong}


def test_a_campaign_goes_on_and_names_what_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(scenes_: int, path: str, ends_after: int | None = None) -> command.Tally:
        def tasks(given: Iterable[workers.Task], *_: Any, **__: Any) -> Iterator[tuple[int, workers.Outcome]]:
            for number, task in enumerate(given):
                if number == ends_after:
                    raise KeyboardInterrupt
                first, stop = task.arguments[2:]
                done = {"fault": "hangs"} if first <= 331 < stop else {"value": _piece(*task.arguments)}
                yield number, workers.Outcome(**done)

        monkeypatch.setattr(workers, "run", tasks)
        return command.run("closed,event", 0, scenes_, Checkpoint(tmp_path / path, "code"), 1)

    expected = run(333, "whole.json")
    assert expected.counts["worlds"] == 333
    assert sorted(expected.broken) == [(7, "numbers", "made up"), (331, "ends", "hangs")]
    stored = command.store_cases("closed,event", 0, expected, tmp_path)
    assert drawn("closed,event", 7).scene in [scenes.load(path).scene for path in stored]
    rows = {row["name"]: row for row in command.rows("closed,event", 0, 333, expected)}
    assert rows["campaign.broken.closed_event.ends"]["status"] == "FAIL"
    assert rows["campaign.broken.closed_event.numbers"]["value"] == 1
    with pytest.raises(KeyboardInterrupt):
        run(333, "ended.json", ends_after=3)
    assert len(Checkpoint(tmp_path / "ended.json", "code").pieces) == 3
    assert run(333, "ended.json") == expected
    # A longer or a shorter run counts its own scenes only.
    assert run(75, "ended.json").counts["worlds"] == 75
