# SPDX-License-Identifier: Apache-2.0
"""The blocks of spice/sky130 by themselves, at three corners: what a channel made of them rests on."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from dermis import spice_batch, verdict
from dermis.characterise import benches
from dermis.characterise.benches import BENCHES, Condition

CORNERS = (("tt", 27.0), ("ss", -40.0), ("ff", 125.0))
# One corner in every test run, the others in the long one: each run of ngspice is a second or two.
AT = [
    pytest.param(*at, marks=pytest.mark.long if n else (), id=f"{at[0]}_{at[1]:g}")
    for n, at in enumerate(CORNERS)
]
corners = pytest.mark.parametrize(("corner", "celsius"), AT)


def measure(
    tmp_path: Path, bench: benches.Bench, corner: str, celsius: float, **condition: object
) -> dict[str, float]:
    """Run a bench of the sky130 view and return what ngspice found."""
    deck = tmp_path / "bench.sp"
    deck.write_text(benches.deck(bench.body, Condition(corner, celsius, **condition)))
    # Operating points of transistors start from gmin stepping, the ladder's second rung.
    return dict(spice_batch.run(deck, limit_s=bench.limit_s).values)


def quantities(
    tmp_path: Path, name: str, corner: str, celsius: float, **condition: object
) -> dict[str, float]:
    """Run a bench and return the quantities that it is for."""
    bench = BENCHES[name]
    return bench.values(measure(tmp_path, bench, corner, celsius, **condition))


def within(found: dict[str, float]) -> None:
    for name, value in found.items():
        row = verdict.judge(f"sky130.{name}", value)
        assert row["status"] == "PASS", (
            f"{name} = {row['value']} {row['unit']}, allowed {row['min']} .. {row['max']}"
        )


@corners
@pytest.mark.parametrize("supply", [0.9, 1.1])
def test_the_reference_line_makes_its_current_at_every_supply(tmp_path, corner, celsius, supply) -> None:
    within(quantities(tmp_path, "reference", corner, celsius, supply=supply))


@corners
def test_the_amplifier_has_gain_bandwidth_and_phase_margin(tmp_path, corner, celsius) -> None:
    within(quantities(tmp_path, "amplifier", corner, celsius))


@corners
def test_conveyor_and_mirror_are_linear_and_hold_the_column(tmp_path, corner, celsius) -> None:
    within(quantities(tmp_path, "chain_k80", corner, celsius))


@pytest.mark.parametrize("k", [20, 40, 80, 160])
def test_the_pins_choose_the_ratio(tmp_path: Path, k: int) -> None:
    bench = dataclasses.replace(BENCHES["chain_k80"], body=benches.chain_by_pins_body(k))
    lsb = benches.chain_lsb(measure(tmp_path, bench, *CORNERS[0]))
    within({"chain_gain_error": (lsb[-1] - lsb[0]) / 255.0 - 1.0})


# Each packet at the corner where its source has least room, or the pair leaks most.
@pytest.mark.parametrize(
    ("corner", "celsius", "side"),
    [
        (*CORNERS[0], "sink"),
        *(
            pytest.param(*at, side, marks=pytest.mark.long)
            for at, side in ((CORNERS[1], "source"), (CORNERS[2], "sink"), (CORNERS[2], "source"))
        ),
    ],
)
def test_preset_integral_decision_and_packet(tmp_path, corner, celsius, side) -> None:
    bench = BENCHES[f"vfc_{side}"]
    found = measure(tmp_path, bench, corner, celsius)
    within(bench.values(found))
    assert found["comp_0"] < 0.0, "while it is preset no decision stands"
    assert found["comp_1"] > 0.0, "0.6 V of charge are past the level"
    assert found["comp_2"] < 0.0, "a packet takes them back"


@corners
def test_the_comparator_decides_within_a_fifth_of_a_clock(tmp_path, corner, celsius) -> None:
    within(quantities(tmp_path, "comparator", corner, celsius))


@corners
@pytest.mark.parametrize("side", ["driven", "held"])
def test_a_row_driver_is_an_ohm_either_way(tmp_path, corner, celsius, side) -> None:
    within(quantities(tmp_path, f"row_driver_{side}", corner, celsius))


def test_a_wrong_device_is_noticed(tmp_path: Path) -> None:
    """One device of the mirror's 80 forgotten: 1.2 % of gain, six times what the circuit has by itself."""
    bench = BENCHES["chain_k80"]
    short = dataclasses.replace(bench, body=benches.chain_body(80, devices=79))
    lsb, fault = (benches.chain_lsb(measure(tmp_path, b, *CORNERS[0])) for b in (bench, short))
    assert (fault[-1] - fault[0]) / (lsb[-1] - lsb[0]) == pytest.approx(
        80 / 79, rel=1e-3
    )  # r_out of the output


def test_mismatch_gives_every_chip_its_own_offset(tmp_path: Path) -> None:
    """Three seeds, three offsets of the amplifier: some millivolts, where without mismatch there is none."""
    own, *drawn = (
        quantities(tmp_path, "amplifier_offset", *CORNERS[0], sample=n)["amplifier_offset_v"]
        for n in (None, 1, 2, 3)
    )
    assert len(set(drawn)) == len(drawn)
    # One sigma of a pair of 80 um2 is about 1 mV: five of them bound it, a tenth is far above what is systematic.
    assert all(abs(own) < 1e-4 < abs(v - own) < 5e-3 for v in drawn), (own, drawn)
