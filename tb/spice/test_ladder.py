# SPDX-License-Identifier: Apache-2.0
"""The ladder of retries: rungs taken by circuits that need them, in order, reported, and the end beyond the last."""

import functools
import multiprocessing
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import plan
from dermis.chip import netlist, spice_batch
from dermis.errors import SimulatorError
from dermis.lockstep import ladder
from dermis.scene import scene
from tb.reference import deck_chip
from tb.reference import ladder_circuits as circuits
from tb.reference.ladder_circuits import half_of


def apart(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a process of its own: ngspice keeps its circuit in global variables."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        return pool.submit(function, *arguments).result()


def climbed(lines: tuple[str, ...], probe: str = "b") -> tuple[float, list[ladder.Retry], ladder.Level]:
    samples, way = circuits.lockstep(lines, probe, [1e-8])
    return float(samples[-1]), way.retries, way.level


@pytest.mark.parametrize("rung", list(circuits.NEEDS))
def test_a_start_is_taken_by_the_circuit_that_needs_it_and_by_none_below(rung: str) -> None:
    value, retries, level = apart(climbed, circuits.NEEDS[rung])
    names = ["plain"] + [start.name for start in ladder.START[1:]]
    assert level.name == rung
    assert [retry.rung for retry in retries] == names[: names.index(rung)]
    assert [retry.next for retry in retries] == names[1 : names.index(rung) + 1]
    # reltol 1e-6 of a volt
    assert abs(value - float(circuits.needed_operating_point(rung))) < 1e-6


def leap(foot: int) -> tuple[float, list[str | None]]:
    way = ladder.Climb("leap", ladder.Level(0, foot), report=lambda line: None)

    def attempt(level: ladder.Level) -> float:
        half = half_of(circuits.LEAP, "leap", 1e-6, 1e-4, level=level)
        samples = [half.advance(k * 1e-6, [])[0] for k in range(101)]
        return max(abs(sample - circuits.leap_v()) for sample in samples[61:])

    return ladder.climb(attempt, way), [retry.next for retry in way.retries]


def test_what_a_node_leaps_by_alternates_with_trapezoids_and_is_gone_with_gear() -> None:
    error, retries = apart(leap, 0)
    assert retries == ["capacitance"]
    assert error < 5e-4  # ngspice's reltol 1e-3 of half a volt
    error, retries = apart(leap, 2)
    assert retries == []
    assert error < 1e-6  # the millionth of a volt that vntol is


def own_deck(steps: int, poles: bool) -> tuple[list[int], list[ladder.Retry]]:
    bends = {"comparator_delay": {"t_s": 8e-9}, "integrator_bandwidth": {"gbw_hz": 5e6}}
    data = {"array": {"rows": 1, "cols": 4}, "stimulus": {"kind": "uniform", "code": [0]}}
    data["effects"] = bends if poles else {}
    made = plan.make(scene.from_data(data, Path("rungs.toml")), "cosim")
    made = replace(made, resistance_ohm=np.array([[[500.0, 1275.0, 7.5e3, 1e6]]]), force_n=None)
    deck = netlist.frame_deck(made, 0, deck_chip.levels_of(made))
    way = ladder.Climb("rungs", ladder.Level(0, steps), report=lambda line: None)
    read = functools.partial(deck_chip.read_deck, deck, made.timing, made.cols, Path("/dev/null"))
    return ladder.climb(read, way).ravel().tolist(), way.retries


@pytest.mark.parametrize("poles", [False, True])
@pytest.mark.parametrize("steps", [1, 2])
def test_the_decks_of_scenes_have_the_same_codes_on_every_rung(steps: int, poles: bool) -> None:
    # 510 times 250 ohm over R; 0.1275 of a packet is none
    assert apart(own_deck, steps, poles) == ([255, 100, 17, 0], [])


def test_no_rung_loosens_a_tolerance() -> None:
    for rung in (*ladder.START, *ladder.STEPS):
        assert not re.search(r"(abstol|reltol|vntol|chgtol|gmin)\s*=", rung.options), rung.name


def exhausted(lines: tuple[str, ...]) -> SimulatorError:
    with pytest.raises(SimulatorError) as caught:
        circuits.lockstep(lines, "c", [1e-6, 2e-6])
    return caught.value


def test_beyond_the_ladder_are_time_node_and_advice() -> None:
    said = {
        circuits.LATE_RELAY: r'at 1\.5\d*e-06 s.*node "c".*tried: plain, capacitance, gear; try: look at c',
        circuits.RELAY: "at 0 s.*tried: plain, gmin_stepping, source_stepping, ramp; try: a nodeset at c",
    }
    for lines, words in said.items():
        error = apart(exhausted, lines)
        assert error.exit_code == 3
        assert re.search(words, str(error))


def test_a_batch_deck_climbs_as_well_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deck = tmp_path / "needs_ramp.sp"
    body = "\n".join(circuits.NEEDS["ramp"])
    deck.write_text(f"batch\n{body}\n.tran 1n 10n\n.meas tran b find v(b) at=5n\n.end\n")
    measured = spice_batch.run(deck)
    assert [retry.next for retry in measured.retries] == ["gmin_stepping", "source_stepping", "ramp"]
    # reltol 1e-6 of a volt
    assert abs(measured.values["b"] - float(circuits.needed_operating_point("ramp"))) < 1e-6
    assert capsys.readouterr().err.count("ngspice, needs_ramp, at 0 s") == 3


def floating() -> None:
    """A node without an operating point, to which ngspice alone gives 0.25 V by a hidden transient."""
    half_of(circuits.FLOATING, "b", 1e-7, 1e-6).advance(0.0, [])


def test_a_hidden_transient_is_no_answer() -> None:
    with pytest.raises(ladder.Abort, match=r"singular matrix.*b"):
        apart(floating)


def sampled(lines: tuple[str, ...]) -> None:
    """Samples of node c at 0.5, 1, 1.5 and 2 us, plainly."""
    half = half_of(lines, "c", 1e-7, 2e-6)
    for time_s in (0.0, 5e-7, 1e-6, 1.5e-6, 2e-6):
        half.advance(time_s, [])


# 1e308 times 1e10 times a volt that begins to rise at 1 us: Newton's method takes inf as converged, inf - inf
# being beyond no tolerance.
BEYOND = ("v1 a 0 pwl(0 0 1u 0 2u 1)", "r1 a 0 1k", "e1 b 0 a 0 1e308", "e2 c 0 b 0 1e10", "r2 c 0 1g")


def test_a_sample_beyond_the_range_of_numbers_is_an_abort_that_says_so() -> None:
    said = r'ngspice at 1\.5e-06 s: a sample is no number: node "c" is -?inf'
    with pytest.raises(ladder.Abort, match=said):
        apart(sampled, BEYOND)


def again() -> tuple[str, float]:
    """An abort in mid-run, then another circuit in the same process."""
    try:
        sampled(circuits.LATE_RELAY)
    except ladder.Abort as abort:
        said = abort.phase
    samples, way = circuits.lockstep(("v1 a 0 1", "r1 a b 1k", "c1 b 0 1n"), "b", [1e-6])
    return said + way.level.name, float(samples[0])


def test_a_process_can_have_another_circuit_behind_an_abort_and_without_its_capacitors() -> None:
    said, value = apart(again)
    assert said == "stepsplain"
    assert value == pytest.approx(1.0, abs=1e-6)  # reltol of the operating point
