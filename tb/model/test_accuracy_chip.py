# SPDX-License-Identifier: Apache-2.0
"""Resolution of the chip against conversion time: the measure is right, and each reader gains its bits."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest

from dermis.records import Plan
from dermis.scene.design import load
from tb.programs.accuracy import chip
from tb.programs.accuracy.points import to_csv

PAPER = chip.gate_of(chip.PAPER_BITS)


@pytest.mark.parametrize("bits", [3, 8, 13])
def test_an_ideal_quantiser_is_worth_its_bits(bits: int) -> None:
    duty = chip.random_duty(1, frames=40)
    step = chip.HALF / 2**bits
    # Gain and offset are a calibration's, and are not counted.
    read = 1.03 * (np.floor(duty / step) + 0.5) * step - 0.01
    # The mean square of 10 240 errors spread evenly is known to 1 %: 0.01 bit; at 3 bits the line bends into the steps.
    assert chip.judge(duty, read) == pytest.approx(bits, abs=0.05)


@pytest.mark.paper
def test_full_scale_counts_to_the_highest_code_in_the_gate_of_its_bits() -> None:
    assert PAPER == load().timing.gate_clocks
    duty = np.full((1, 1, 1), 0.5)
    for bits in (3, 8, 15):
        read = chip.counts(chip.plan_at(duty, {}, gate_clocks=chip.gate_of(bits)))
        assert read * chip.gate_of(bits) == 2**bits - 1


def test_the_paper_s_point_has_eight_bits_and_its_slot() -> None:
    point = chip.measured("", {}, PAPER)
    assert point.slot_s == pytest.approx(125e-6)
    assert chip.frame_hz(16, point.slot_s) == pytest.approx(500.0)
    # 512 random forces know their mean square to 4 %, 0.03 bit; three of that
    assert point.bits == pytest.approx(8.0, abs=0.1)
    assert point.newtons == pytest.approx(15 / 2**point.bits)


def test_noise_by_formula_is_noise_by_simulation() -> None:
    """With a reference a hundred times noisier than the design's, so that nothing else counts."""
    design = load().replace(charge={"flicker": 5e-3})
    duty = chip.random_duty(1)
    made = chip.plan_at(duty, {"flicker_noise": {"relative": 5e-3}}, gate_clocks=PAPER, seed=1)
    power = 1 / 12 + (design.charge.flicker * duty * PAPER) ** 2
    expected = chip.bits_of(float(np.sqrt(np.mean(power))) / PAPER / chip.HALF)
    # 512 draws know their power to 6 %: 0.05 bit; two and a half of that
    assert chip.judge(duty, chip.counts(made)) == pytest.approx(expected, abs=0.12)


def bits(read: object, gate: int = 126, effects: dict | None = None) -> float:
    return chip.measured("", effects or {}, gate, seeds=(1,), read=read).bits


def test_each_way_to_read_is_worth_what_is_said() -> None:
    plain = bits(chip.counts)
    # Differences of two mean squares of 512 errors: 0.06 bit; three of that.
    assert bits(chip.with_residue(4)) - plain == pytest.approx(4.0, abs=0.2)
    assert plain - bits(chip.without_preset) == pytest.approx(
        0.5, abs=0.2
    )  # two uniform errors instead of one


def test_a_residue_that_forgets_the_packet_under_way_is_seen() -> None:
    def forgets(made: Plan) -> np.ndarray:
        found = chip.event.run(made)
        return (found.codes + np.asarray(found.info["w_end"]) + chip.HALF) / made.timing.gate_clocks

    assert bits(forgets) < bits(chip.counts)


@pytest.mark.long
def test_residue_holds_with_noise_at_the_threshold() -> None:
    noisy = chip.NOISE | {"comparator_noise": {"v_v": 5e-3}}
    # The noise itself, 5e-3 packet at the last decision only, is below a sixteenth.
    assert bits(chip.with_residue(4), effects=noisy) > bits(chip.counts, effects=noisy) + 3


def test_droop_is_put_back() -> None:
    gate = 2046
    points = {p.curve: p.bits for p in chip.read_points(chip.DROOP, [gate], chip.frame_duty)}
    assert points["as read"] < points["no series resistance"] - 1.5
    # the roundings of fifteen others each pass on a per cent
    assert points["row droop corrected"] == pytest.approx(points["no series resistance"], abs=0.1)


def test_the_end_of_waiting_is_found() -> None:
    flat = [8.0, 9.0, 10.0, 10.2, 10.3]
    points = [chip.Point(chip.FULL, "event", 1e6, 2**k, 0.0, b, b, b) for k, b in enumerate(flat, 4)]
    assert chip.waiting_ends(points, 1e6).gate_clocks == 2**6


def test_a_slot_is_divided_without_a_clock_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[float, float, int, float]] = []
    monkeypatch.setattr(
        chip, "measured", lambda curve, on, gate, f, settle_s, seeds: asked.append((f, gate, settle_s))
    )
    list(chip.split())
    slots = set(chip.SLOTS_S.values())
    assert len(asked) == 2 * len(slots) * 3 * 9
    for f, gate, settle_s in asked:
        assert gate >= chip.gate_of(3) - 1
        # The rest of a clock that a gate leaves is lost.
        assert any(0 <= (slot_s - settle_s) * f - gate < 1 + 1e-9 for slot_s in slots)


@pytest.mark.paper
def test_the_floor_of_energy_is_that_of_the_declared_currents() -> None:
    # 0.5 mA of taxel at a quarter of the clock rate, its 80th part and 25 uA from 3.3 V for 125 us
    assert chip.energy_j(125e-6) == pytest.approx(3.3 * (0.5e-3 + 0.5e-3 / 80 + 25e-6) * 125e-6)


@pytest.mark.paper
def test_energy_takes_a_measured_current_or_says_why_there_is_none() -> None:
    # As above, and 500 uA of a channel.
    assert chip.energy_j(125e-6, 500e-6) == pytest.approx(3.3 * (1e-3 + 0.5e-3 / 80 + 25e-6) * 125e-6)
    bits = {14: 3.0, PAPER: 8.0, 65534: 10.0}
    points = [
        chip.Point(chip.FULL, "event", chip.PAPER_HZ, gate, chip.SETTLE_S, b, b, b)
        for gate, b in bits.items()
    ]
    rows = {row["name"]: row for row in chip.energy_rows(points, None, "no models here")}
    assert {(row["value"], row["status"], row["note"]) for row in rows.values()} == {
        (None, "SKIP", "no models here")
    }
    current = chip.ChannelCurrent(500e-6, 400e-6, 600e-6)
    rows = {row["name"]: row for row in chip.energy_rows(points, current, "")}
    whole = 1e9 * chip.energy_j(125e-6, 500e-6)
    assert rows["accuracy_chip.energy_nj"]["value"] == pytest.approx(whole)
    # 0.5 mA of 1.031 mA
    assert "48 % of it for the sensor" in rows["accuracy_chip.energy_nj"]["note"]
    assert "500 uA" in rows["accuracy_chip.energy_nj"]["note"]
    assert rows["accuracy_chip.energy_per_bit_nj"]["value"] == pytest.approx(whole / 8)


def test_the_gate_for_an_accuracy_lies_between_its_points() -> None:
    points = [
        chip.Point("c", "event", chip.PAPER_HZ, 2**k, 0.0, b, b, b) for k, b in ((4, 3.0), (6, 5.0), (8, 5.5))
    ]
    assert chip.gate_for(points, "c", 4.0) == pytest.approx(2**5)
    assert chip.gate_for(points, "c", 6.0) is None
    assert chip.bits_at(points, "c", 2**5) == pytest.approx(4.0)


def test_a_gate_beyond_the_register_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.\.65536"):
        chip.plan_at(np.full((1, 1, 1), 0.1), {}, gate_clocks=65537)


def test_the_table_holds_every_point() -> None:
    point = chip.measured("a, b", {}, PAPER, seeds=(1,))
    text = to_csv([chip.cells(p, None) for p in (point, replace(point, gate_clocks=14))])
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [r["curve"] for r in rows] == ["a, b", "a, b"]
    assert float(rows[0]["frames_per_s_16x16"]) == pytest.approx(500.0)
    assert math.isclose(float(rows[0]["bits"]), point.bits, abs_tol=5e-4)  # three decimals
