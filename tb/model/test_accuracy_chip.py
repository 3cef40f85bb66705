# SPDX-License-Identifier: Apache-2.0
"""Resolution of the chip against conversion time: the measure is right, and each reader gains its bits."""

import numpy as np
import pytest

from dermis.errors import SimulatorError
from dermis.scene.design import load
from tb.programs.accuracy import chip


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
    assert chip.PAPER == load().timing.gate_clocks
    duty = np.full((1, 1, 1), 0.5)
    for bits in (3, 8, 15):
        read = chip.counts(chip.plan_at(duty, {}, chip.gate_of(bits)))
        assert read * chip.gate_of(bits) == 2**bits - 1


def test_noise_by_formula_is_noise_by_simulation() -> None:
    """With a reference a hundred times noisier than the design's, so that nothing else counts."""
    design = load().replace(charge={"flicker": 5e-3})
    duty = chip.random_duty(1)
    made = chip.plan_at(duty, {"flicker_noise": {"relative": 5e-3}}, chip.PAPER, seed=1)
    power = 1 / 12 + (design.charge.flicker * duty * chip.PAPER) ** 2
    expected = chip.bits_of(float(np.sqrt(np.mean(power))) / chip.PAPER / chip.HALF)
    # 512 draws know their power to 6 %: 0.05 bit; two and a half of that
    assert chip.judge(duty, chip.counts(made)) == pytest.approx(expected, abs=0.12)


def test_the_end_of_waiting_is_found() -> None:
    flat = [8.0, 9.0, 10.0, 10.2, 10.3]
    points = [chip.Point(chip.FULL, 1e6, 2**k, b) for k, b in enumerate(flat, 4)]
    assert chip.waiting_ends(points, 1e6).gate_clocks == 2**6


@pytest.mark.paper
def test_energy_takes_a_measured_current_or_says_why_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    # 0.5 mA of a taxel at a quarter of the clock rate, its 80th part, 25 uA, 500 uA of a channel; 3.3 V, 125 us
    whole = 3.3 * (1e-3 + 0.5e-3 / 80 + 25e-6) * 125e-6
    assert chip.energy_j(125e-6, 500e-6) == pytest.approx(whole)
    paper = chip.Point(chip.FULL, chip.PAPER_HZ, chip.PAPER, 8.0)
    monkeypatch.setattr(chip, "channel_current_a", lambda: 500e-6)
    assert [row["value"] for row in chip.energy_rows(paper)] == pytest.approx([1e9 * whole, 1e9 * whole / 8])

    def none() -> float:
        raise SimulatorError("no models here")

    monkeypatch.setattr(chip, "channel_current_a", none)
    assert {row["status"] for row in chip.energy_rows(paper)} == {"SKIP"}


def test_a_gate_beyond_the_register_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.\.65536"):
        chip.plan_at(np.full((1, 1, 1), 0.1), {}, 65537)
