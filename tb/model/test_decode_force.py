# SPDX-License-Identifier: Apache-2.0
"""Codes to newtons with intervals, and the file that says how: laws, calibrations, decoders."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_plans import refused

from dermis import plan as planning
from dermis import records
from dermis.decode import calibration, law
from dermis.decode.decoder import SATURATED, SHORT, ZERO, Decoder
from dermis.engines import closed
from dermis.errors import InputError
from dermis.scene import scene, sensor
from dermis.skin import Skin

CHIP = {
    "row_driver": {"r_ohm": 2.0}, "column_input": {"r_ohm": 1.0}, "lateral": True, "column_offset": {"v_v": 3e-4},
    "mirror_ratio": {"ratio_error": 0.01, "spread": 0.01}, "sensor_spread": True,
}  # fmt: skip
TOUCH = {"kind": "ramp", "shape": "spherical", "force_n": [0.0, 12.0, 0.0], "frames": 41}
TOUCH |= {"width": 9, "length": 9}


def made(stimulus: dict[str, Any] = TOUCH, effects: dict[str, Any] = CHIP, **tables: Any) -> records.Plan:
    data = {"stimulus": stimulus, "effects": effects, **tables}
    return planning.make(scene.from_data(data, Path("made.toml")), "closed")


def decoder_of(plan: records.Plan) -> Decoder:
    return Decoder(calibration.Calibration.of_plan(plan), plan.drive.t_frame_s)


@given(force=st.floats(0, 50))
@settings(max_examples=100, deadline=None)
def test_curves_are_the_laws_of_the_scene(force: float) -> None:
    inverse = sensor.InverseSensor(7500.0)
    power = sensor.PowerSensor((0.2, 1.0, 10.0, 100.0), (30e3, 6e3, 1e3, 250.0), 0.2, 1e7)
    for made_by in (inverse, power):
        ohm = made_by.resistance_ohm(force)
        with np.errstate(divide="ignore"):
            g = 1 / ohm
        # One formula in two orders: a power and a quotient round to 1e-15 each.
        assert law.of_sensor(made_by).force_n(g) == pytest.approx(float(made_by.force_n(ohm)), rel=1e-12)


def test_brimacombes_laws_are_found_in_their_own_data() -> None:
    """Brimacombe 2009: a cubic fits what a power law misses, and a line misses most."""
    g = np.linspace(1e-5, 2e-3, 40)
    own = {"linear": 7500 * g, "power": 3e4 * g**1.3, "cubic": 5e3 * g - 1e6 * g**2 + 6e8 * g**3}

    def rms_error_n(kind: str, force: np.ndarray) -> float:
        return np.sqrt(np.mean((law.fit(kind, g, force).force_n(g) - force) ** 2))

    for kind, force in own.items():
        curve = law.fit(kind, g, force)
        # A fit of exact points is off by the rounding of least squares, 1e-12 times its condition of 100.
        assert rms_error_n(kind, force) < 1e-9 * force.max()
        # The inverse adds one root, found to the same digits.
        assert curve.conductance_s(force) == pytest.approx(g, rel=1e-9)
    assert rms_error_n("table", own["cubic"]) < 0.01 * own["cubic"].max()
    errors = [rms_error_n(kind, own["cubic"]) for kind in own]
    assert errors[0] > errors[1] > errors[2]


def test_a_table_stays_monotone_between_unequal_loads() -> None:
    g = np.array([1e-4, 2e-4, 3e-4, 8e-4, 9e-4])
    curve = law.fit("table", g, np.array([1.0, 1.1, 5.0, 5.1, 12.0]))
    assert (np.diff(curve.force_n(np.linspace(0, 1.2e-3, 500))) >= 0).all()
    assert curve.force_n(g) == pytest.approx([1.0, 1.1, 5.0, 5.1, 12.0])


FALLING = [3.0, 2.0, 1.0]


@pytest.mark.parametrize(("kind", "force"), [("power", FALLING), ("table", FALLING), ("cubic", [1.0] * 3)])
def test_loads_that_no_law_fits_are_refused(kind: str, force: list[float]) -> None:
    with pytest.raises(law.LawError):
        law.fit(kind, [1e-4, 2e-4, 3e-4], force)


@pytest.mark.paper
def test_every_force_lies_in_its_interval_and_most_are_two_codes_wide() -> None:
    plan = made()
    found = decoder_of(plan).decode(closed.run(plan).codes)
    assert found.holds(plan.force_n).all()
    lsb_n = 15 / 255
    pressed = plan.force_n > lsb_n
    assert np.sqrt(np.mean((found.force_n - plan.force_n)[pressed] ** 2)) < 0.4 * lsb_n
    assert np.median((found.high_n - found.low_n)[pressed]) < 1.2 * lsb_n
    uncorrected = 15 / 255 * closed.run(plan).codes
    assert np.sqrt(np.mean((uncorrected - plan.force_n)[pressed] ** 2)) > 3 * lsb_n


@pytest.mark.paper
def test_a_saturated_taxel_has_an_open_end_and_its_row_is_still_covered() -> None:
    plan = made({"kind": "ramp", "shape": "spherical", "force_n": [0.0, 40.0], "frames": 30})
    codes = closed.run(plan).codes
    found = decoder_of(plan).decode(codes)
    full = codes == 255
    assert full.sum() > 50
    assert ((found.flags & SATURATED > 0) == full).all()
    assert np.isinf(found.high_n[full]).all()
    assert np.isfinite(found.high_n[~full]).all()
    assert found.holds(plan.force_n).all()
    assert ((found.flags & ZERO > 0) == (codes == 0)).all()


@pytest.mark.paper
def test_currents_that_no_sheet_makes_are_flagged() -> None:
    plan = made(effects={"row_driver": {"r_ohm": 100.0}})
    found = decoder_of(plan).decode(np.full((1, 16, 16), 200))
    assert (found.flags & SHORT).any()
    assert np.isinf(found.high_n[found.flags & SHORT > 0]).all()


@pytest.mark.paper
def test_a_reference_taxel_tells_the_temperature() -> None:
    """20 K of 0.3 % a kelvin are 6 % of every force; the corner carries 5 N in every frame."""
    force = np.zeros((20, 16, 16))
    force[:, 4:9, 4:9] = np.linspace(0, 10, 20)[:, None, None]
    force[:, 0, 0] = 5.0
    cold = made(effects={"row_driver": True})
    warm = made(effects={"row_driver": True, "sensor_temperature": {"delta_k": 20}})
    ohm = cold.sensor.resistance_ohm(force) / 1.06
    codes = closed.run(dataclasses.replace(warm, resistance_ohm=ohm, force_n=force)).codes
    known = calibration.Calibration.of_plan(cold)
    blind = Decoder(known, 2e-3).decode(codes)
    decoder = Decoder(dataclasses.replace(known, reference=((0, 0, 5 / 7500),)), 2e-3)
    seeing = decoder.decode(codes)
    assert np.abs(blind.force_n - force).max() > 0.5
    # Half a code of the reference's 90 adds to half a code.
    assert np.abs(seeing.force_n - force).max() < 0.1
    assert seeing.holds(force).all()
    codes[:, 0, 0] = 0  # it lost its force
    assert np.isinf(decoder.decode(codes).high_n).all()


def test_a_calibration_survives_its_file(tmp_path: Path) -> None:
    plan = planning.load("models/scenes/worn_fsr_sheet.toml", "closed")
    true = calibration.Calibration.of_plan(plan)
    known = dataclasses.replace(true, noise_code=0.2, reference=((0, 1, 1e-4),))
    known.save(tmp_path / "sheet.toml")
    again = calibration.load(tmp_path / "sheet.toml")
    assert again.to_toml() == known.to_toml()
    codes = closed.run(plan).codes
    assert (Decoder(again, 2e-3).decode(codes).high_n == Decoder(known, 2e-3).decode(codes).high_n).all()


@pytest.mark.paper
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1", "format = 9", "format = 9"),
        ("rows = 16", "rows = 15", "sheet.factor = shape"),
        ("code_max = 255", "", "chip.code_max"),
        ("v_bias_v = 0.5", 'v_bias_v = "half"', "chip.v_bias_v"),
        ("[network]", "[network]\nr_wire_ohm = 1.0", "network.r_wire_ohm"),
        ("r_row_driven_ohm = 2.0", "r_row_driven_ohm = -2.0", "network = its values"),
        ("v_bias_v = 0.5", "v_bias_v = -0.5", "v_bias_v must be finite and 0 or above"),
        ("law_part = 0.0", "law_part = -1.0", "law_part must be finite and 0 or above"),
        ("noise_code = 0.0", "noise_code = -1.0", "noise_code must be finite and 0 or above"),
        ("step_part = [\n    0.0,", "step_part = [\n    true,", "chip.step_part"),
        ("[chip]", "[chip", "file = "),
    ],
)
def test_a_broken_calibration_is_named_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = calibration.Calibration.of_plan(made()).to_toml()
    assert old in text
    path = tmp_path / "sheet.toml"
    path.write_text(text.replace(old, new, 1))
    assert said in str(refused(calibration.load, path))


def test_intervals_hold_the_creep_of_loads_that_are_not_certain() -> None:
    """Below half a code a load reads 0 and may creep or not; crosstalk reads 1 and is none."""
    skin = Skin({"array": {"rows": 1, "cols": 2}, "effects": {"sensor_creep": True}})
    gaps = np.random.default_rng(19).uniform(0, 12, (4000, 1, 1)) * np.ones(2)
    dip = np.full((1125, 1, 2), 9.0)
    dip[1000:1025] = [0.02, 0.0]
    beside = np.zeros((520, 16, 16))
    beside[:, 5:10, 5:8], beside[500:, 5:10, 8] = 4.0, 8.0
    for sheet, force, t_frame_s in (
        (skin, gaps, 4e-3), (skin, dip, 2e-3), (Skin("single_touch", effects={"sensor_creep": True}), beside, 2e-3),
    ):  # fmt: skip
        sheet.reset()
        assert sheet.decode(sheet.read(force, t_frame_s), t_frame_s).holds(force).all()


@pytest.mark.paper
def test_hysteresis_leaves_the_creep_of_a_faint_load_in_its_interval() -> None:
    """0.74 LSB beside a neighbour whose crosstalk reads a code: at rest by its estimate, but it may be a load."""
    effects: dict[str, Any] = {"column_input": {"r_ohm": 18.7}, "lateral": {"r_ohm": 1670.0}}
    skin = Skin(
        {"array": {"rows": 1, "cols": 2}}, effects=effects | {"sensor_hysteresis": True, "sensor_creep": True}
    )
    force = np.zeros((5, 1, 2))
    force[:, 0, 1], force[2:4, 0, 0], force[4, 0, 0] = 2.48, 0.0434, 7.77
    for t_frame_s in (1.0, 100.0):
        skin.reset()
        found = skin.decode(skin.read(force, t_frame_s), t_frame_s)
        assert found.force_n[3, 0, 0] == 0.0
        assert found.holds(force).all()


@pytest.mark.parametrize("memory", [{}, {"sensor_creep": True}])
def test_neighbours_of_a_missing_code_hold_for_any_code_there(memory: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    force = rng.uniform(6.0, 10.0, (3, 4, 8))
    skin = Skin({"array": {"rows": 4, "cols": 8}}, effects={"row_driver": {"r_ohm": 10.0}} | memory)
    codes, missing = skin.read(force), np.zeros(force.shape, bool)
    missing[1, 1, :6] = True
    kept = [
        skin.decoder.decode(np.where(missing, fill, codes), missing=missing)
        for fill in (0, 100)
        if not skin.reset()
    ]
    for found in kept:
        assert found.holds(force)[~missing].all()
        assert np.isnan(found.force_n).sum() == np.isinf(found.high_n).sum() == 6
    assert (kept[0].low_n == kept[1].low_n).all() or memory
    for wrong in (missing.astype(int), missing[:1], missing[0], missing.tolist()):
        with pytest.raises(
            ValueError, match=r"missing must be a bool array of the shape of the codes, \[3, 4, 8\]"
        ):
            skin.decoder.decode(codes, missing=wrong)


def test_frames_of_another_array_are_refused() -> None:
    decoder = decoder_of(made())
    with pytest.raises(InputError, match="16 x 16"):
        decoder.calibration.check(8, 8, "touch.csv")
    for codes in (np.zeros((1, 8, 8), int), np.zeros((1, 16, 16)), np.full((16, 16), 256)):
        with pytest.raises(ValueError, match="codes must be"):
            decoder.decode(codes)


def test_noise_widens_the_interval_so_far_that_it_holds() -> None:
    """The share outside of a million readings with noise, against the share that half_width_code allows."""
    rng = np.random.default_rng(0)
    plan = made()
    for noise in (0.0, 0.05, 0.2, 1.0):
        cal = dataclasses.replace(calibration.Calibration.of_plan(plan), noise_code=noise)
        exact = rng.uniform(20, 200, 1_000_000)
        read = np.round(exact + noise * rng.standard_normal(exact.size))
        outside = np.mean(np.abs(read - exact) > cal.half_width_code())
        # Three standard deviations of a count of 500.
        assert outside <= calibration.MISSED * 1.15
