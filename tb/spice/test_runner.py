# SPDX-License-Identifier: Apache-2.0
"""The runner of batch benches: what ngspice does not say with its exit code, it must."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from ngspice_batch import SECTIONS, SPICE, run

from dermis.chip import sky130
from dermis.errors import SimulatorError
from scripts.characterise import benches, runs

BENCHES = sorted(p.stem for p in (SPICE / "bench").glob("*.sp"))

RC = """seeded deck
v1 a 0 pulse(0 1 0 1n 1n 1 2)
r1 a b 1k
c1 b 0 1n
.tran 10n {stop} 0 10n
.meas tran v_half find v(b) at=1u
.meas tran v_late find v(b) at={late}
.control
run
quit
.endc
.end
"""
RIGHT = RC.format(stop="3u", late="2u")
NEVER = RIGHT.replace(".control", ".meas tran t_never when v(b)=5 rise=1\n.control")
PEAK = RIGHT.replace("run\nquit", "run\nlet v_peak = vecmax(v(b))\nprint v_peak\nquit")


def deck(folder: Path, text: str) -> Path:
    (folder / "seeded.sp").write_text(text)
    return folder / "seeded.sp"


# A relay that contradicts itself from 1.5 us on: no value of c is a solution, whatever the step.
RELAY = "c1 b 0 1n\nbx c 0 v = time > 1.5e-6 ? (v(c) > 0.5 ? 0 : 1) : 0.2"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (RC.format(stop="3u", late="9u"), "did not measure v_late.*out of interval"),
        (RIGHT.replace("r1 a b 1k", "xr a b no_such_block"), "did not measure"),
        (PEAK.replace("vecmax(v(b))", "vecmax(no_such)"), "measure v_peak"),
        (NEVER, "did not measure t_never"),
        (NEVER.replace("run\nquit", "quit"), "did not measure v_half"),
        (RC.format(stop="3", late="2"), r"not done after 0\.5 s"),
        (
            RC.format(stop="3u", late="1.2u").replace("c1 b 0 1n", RELAY),
            r"(?i)step too small.*1\.5\d*e-06.*\b(c|bx)\b",
        ),
    ],
    ids=["out of interval", "no such block", "no such vector", "never", "not run", "time limit", "abort"],
)
def test_a_deck_that_does_not_measure_is_an_error_though_ngspice_exits_with_0(
    tmp_path: Path, text: str, said: str
) -> None:
    with pytest.raises(SimulatorError, match=said) as caught:
        run(deck(tmp_path, text), limit_s=0.5 if "not done" in said else 60.0)
    assert Path(caught.value.log).is_file()


def test_what_a_control_section_prints_by_name_is_returned(tmp_path: Path) -> None:
    # ngspice's default reltol of 1e-3 on 1 - exp(-3 us / 1 us).
    assert run(deck(tmp_path, PEAK))["v_peak"] == pytest.approx(0.9502, abs=1e-3)


@pytest.mark.parametrize("name", BENCHES)
def test_a_bench_keeps_the_seven_sections_in_order(name: str) -> None:
    text = (SPICE / "bench" / f"{name}.sp").read_text().lower()
    found = [m for m in re.findall(r"(?m)^\* (\w+)", text) if m in SECTIONS]
    assert found == list(SECTIONS)


@pytest.mark.parametrize("name", BENCHES)
def test_a_bench_measures_all_it_names_with_the_physical_defaults(measure: Callable, name: str) -> None:
    assert len(measure(name)) >= 3


def test_every_block_has_a_bench() -> None:
    blocks = {p.stem for p in (SPICE / "behavioural").glob("*.sp")}
    decks = "\n".join(p.read_text() for p in (SPICE / "bench").glob("*.sp"))
    used = {b for b in blocks if re.search(rf"(?m)^xdut\w* .*\b{b}\b", decks)}
    inside = {"conveyor_multi"}  # a DUT of channel_multi_output_conveyor__dc only as part of it
    assert blocks - used <= inside


# Its gate over time, volts at most, and seconds beyond 3.64 V and what has no time, 0.11 V.
BEYOND = {
    # What an outsider found to be overlooked: rises slower than a step.
    "slow": ("0 0 0.4m 5 2m 5", "1u 1m", 5.0, 0.7e-3),
    "slow and low": ("0 0 100u 4 2m 4", "100n 1m", 4.0, 906.25e-6),
    "edges apart in a low stretch": (
        "0 3.6 1u 3.6 1.01u 4.2 1.11u 4.2 1.12u 3.7 3u 3.7 3.01u 4.2 3.06u 4.2 3.07u 3.7", "1n 5u", 4.2, 116.5e-9
    ),
    "late": ("0 3.6 24.1485m 3.6 24.14851m 4.2 24.14861m 4.2 24.14862m 3.6", "100u 25m", 4.2, 115e-9),
    "from the start": ("0 4.2", "1u 10u", 4.2, math.inf),
}  # fmt: skip


@pytest.mark.parametrize("case", BEYOND)
def test_how_long_a_device_is_beyond_its_class_is_read_from_the_steps(case: str) -> None:
    gate, steps, volts, seconds = BEYOND[case]
    body = (
        f"vg g 0 pwl({gate})\nvd d 0 0.1\nxn d g 0 0 nmos w=5 l=0.5\n.tran {steps}\n.meas tran x max v(g)\n"
    )
    exceeded = runs.simulate(runs.resolved(benches.deck(body, benches.Condition())), 60.0).exceeded
    (bulk,) = [found for name, found in exceeded.items() if name.endswith("Vgb")]
    # A step of ngspice at either end of an edge is 2 ns of 116; two edges together would be half as much again.
    assert bulk == (pytest.approx(volts), pytest.approx(seconds, rel=0.05))
    assert any("Vgb" in said for said in sky130.outside_class(exceeded))
