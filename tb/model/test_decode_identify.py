# SPDX-License-Identifier: Apache-2.0
"""Identification: a session of a simulated sheet gives back its own parameters, and blames what is wrong in it."""

import dataclasses
import functools
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import commands
import numpy as np
import pytest
from made_plans import refused

from dermis.array.array import column_currents
from dermis.decode import calibration, identify
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Decoder
from dermis.errors import InputError
from dermis.report import calibrate
from dermis.skin import Skin
from tb.programs.decode import command, session

SIZE = 8
EFFECTS = {
    "row_driver": {"r_ohm": 4.0}, "column_input": {"r_ohm": 1.5}, "lateral": {"r_ohm": 2000.0},
    "mirror_ratio": {"ratio_error": 0.0, "spread": 0.02}, "offset_current": {"i_a": 1e-7}, "sensor_spread": True,
}  # fmt: skip
TRUE = {"r_row_driven_ohm": 4.0, "r_column_ohm": 1.5, "g_lateral_row_s": 5e-4}


@cache
def skin(memory: bool = False, trace_ohm: float = 0.0, offset_v: float = 0.0) -> Skin:
    effects = EFFECTS | ({"sensor_hysteresis": True, "sensor_creep": True} if memory else {})
    if trace_ohm:
        effects["trace"] = {"r_row_ohm": trace_ohm, "r_column_ohm": trace_ohm}
    if offset_v:
        effects["column_offset"] = {"v_v": [offset_v, -offset_v] * (SIZE // 2)}
    return Skin(array={"rows": SIZE, "cols": SIZE}, effects=effects)


def weights(force: np.ndarray, codes: np.ndarray) -> list[identify.Load]:
    """Loads of forces [loads, SIZE, SIZE] that read as codes, one frame each."""
    pairs = enumerate(zip(force, codes, strict=True))
    return [identify.Load(f"weight {n}", code[None].astype(int), one) for n, (one, code) in pairs]


@cache
def loads(trace_ohm: float = 0.0) -> list[identify.Load]:
    rng = np.random.default_rng(0)
    force = session.rectangles(rng, rng.choice([2.0, 5.0, 8.0, 12.0], 24), SIZE, SIZE)
    return weights(force, skin(trace_ohm=trace_ohm).read(force))


def blank() -> Calibration:
    """What is known before a session: the design, without drivers, inputs, laterals and spread."""
    true = Calibration.of_plan(skin().plan)
    return dataclasses.replace(true, network={}, factor=1.0, step_a=true.step_a.mean(), start_code=0.0)


@cache
def fitted() -> Calibration:
    current, codes = session.currents(Calibration.of_plan(skin().plan), 9)
    return identify.fit_chip(blank(), codes, current)


def test_gains_and_offsets_come_from_test_currents() -> None:
    true, found = Calibration.of_plan(skin().plan), fitted()
    # Four of the fit's own standard deviations, over 16 columns.
    assert np.abs(found.step_a / true.step_a - 1).max() < 4 * found.step_part.max() < 0.01
    # The same for the offsets.
    assert np.abs(found.start_code - true.start_code).max() < 4 * found.start_sigma_code.max()
    assert np.abs(true.step_a / true.step_a.mean() - 1).max() > 0.02


def test_loads_tell_the_network_the_taxels_and_the_law() -> None:
    fit = identify.fit_sheet(fitted(), loads(), "linear")
    assert fit.bad == ()
    for name, true in TRUE.items():
        value, sigma = fit.values[name]
        assert abs(value - true) < max(4 * sigma, 0.03 * true), name
        # The offset voltages of the columns are unknown as well.
        assert sigma < 0.4 * true
    for name in identify.TRACES:
        assert fit.values[name][0] == 0
        assert "do not show it" in fit.remarks[name] or "cannot tell it" in fit.remarks[name]
    rng = np.random.default_rng(5)
    force = rng.uniform(1, 12, (30, SIZE, SIZE))
    codes = skin().read(force)
    found = Decoder(fit.calibration, 2e-3).decode(codes)
    lsb_n = 15 / 255
    assert np.sqrt(np.mean((found.force_n - force) ** 2)) < 1.0 * lsb_n
    before = Decoder(blank(), 2e-3).decode(codes)
    assert np.sqrt(np.mean((before.force_n - force) ** 2)) > 5 * lsb_n
    assert found.holds(force).mean() >= 0.999


def test_an_interval_holds_the_uncertainty_of_offset_voltages() -> None:
    sheet = skin(offset_v=4e-4)
    true = Calibration.of_plan(sheet.plan)
    known = dataclasses.replace(true, network=dict(true.network) | {"v_column_offset_v": 0.0})
    # Independent offsets of 0.2 mV: those of the sheet are at two standard uncertainties.
    unsure = dataclasses.replace(known, offset_v2=np.array([[4e-8], [0.0], [0.0]]))
    force = np.random.default_rng(9).uniform(1, 12, (20, SIZE, SIZE))
    codes = sheet.read(force)
    inside = [Decoder(one, 2e-3).decode(codes).holds(force).mean() for one in (known, unsure)]
    assert inside[0] < 0.5
    assert inside[1] == 1


def test_loads_tell_traces_from_drivers() -> None:
    """A trace costs taxels far from the driver more; 0.4 ohm over 8 pitches is as much as the driver."""
    fit = identify.fit_sheet(fitted(), loads(0.4), "linear")
    for name, true in (TRUE | dict.fromkeys(identify.TRACES, 0.4)).items():
        value, sigma = fit.values[name]
        # Four of the fit's own standard deviations.
        assert abs(value - true) < 4 * sigma, name
        # The two traces are alike in many loads.
        assert sigma < 0.35 * true, name


def test_a_trace_that_loads_cannot_tell_is_named_and_held() -> None:
    """Loads on one column alone meet each row line at one place: driver and trace are one resistance."""
    force = np.zeros((8, SIZE, SIZE))
    force[:, :, 4] = np.random.default_rng(3).choice([0.0, 5.0, 8.0, 12.0], (8, SIZE))
    fit = identify.fit_sheet(fitted(), weights(force, skin(trace_ohm=0.4).read(force)), "linear")
    assert fit.values["r_trace_row_ohm"][0] == 0
    assert "r_row_driven_ohm" in fit.remarks["r_trace_row_ohm"]
    assert any("r_trace_row_ohm" in note for note in fit.calibration.notes)


def test_a_taxel_with_another_law_gets_its_own(tmp_path: Path) -> None:
    """Two taxels follow F^0.8; the others share one power law."""
    true, rng = Calibration.of_plan(skin().plan), np.random.default_rng(4)
    odd = [(1, 2), (6, 5)]
    force = session.rectangles(rng, rng.uniform(2, 12, 40), SIZE, SIZE)
    g = true.factor * force / 7500.0
    for r, c in odd:
        g[:, r, c] = (force[:, r, c] / 12) ** 0.8 * 12 / 7500.0
    codes = true.codes_of(column_currents(true.array(), g))
    blind = dataclasses.replace(true, factor=1.0)
    fit = identify.fit_sheet(blind, weights(force, codes), "power").calibration
    assert sorted(fit.own) == odd
    # Half a code of 30 at the least force is 1.7 % of it, at one end of the curve.
    assert fit.curve.coefficients[0, 1] == pytest.approx(1.0, rel=0.02)
    fit.save(tmp_path / "sheet.toml")
    fit = calibration.load(tmp_path / "sheet.toml")
    with_own, shared = (Decoder(c, 2e-3).decode(codes) for c in (fit, dataclasses.replace(fit, own={})))
    for place in odd:
        # The same for the readings of one taxel alone.
        assert fit.own[place].coefficients[0, 1] == pytest.approx(1 / 0.8, rel=0.03)
        pressed = (slice(None), *place)
        used = force[pressed] > 0
        ratios = (f.force_n[pressed][used] / force[pressed][used] for f in (with_own, shared))
        error = [np.abs(ratio - 1).max() for ratio in ratios]
        # Half a code of 50 and the fit; a factor alone is off by 12^0.2 from end to end.
        assert error[0] < 0.03 < 0.1 < error[1]


def test_a_load_that_is_wrong_is_named() -> None:
    bad = list(loads())
    bad[3] = dataclasses.replace(bad[3], force_n=bad[3].force_n * 1.4)
    assert identify.fit_sheet(fitted(), bad, "linear").bad == ("weight 3",)


def test_as_many_frames_as_rows_are_frames(tmp_path: Path) -> None:
    path = write_session(tmp_path)
    codes = np.load(tmp_path / "codes_0.npy")
    np.save(tmp_path / "codes_0.npy", np.repeat(codes, SIZE, axis=0))
    assert run(path, "--out", tmp_path / "sheet.toml")[0] == 0


@pytest.mark.parametrize("crosstalk", [0, 12])
def test_a_dead_taxel_that_reads_its_neighbours_blames_no_load(crosstalk: int) -> None:
    made = []
    for load in loads():
        codes = load.codes.copy()
        codes[:, 2, 3] = np.minimum(codes[:, 2, 3], crosstalk)
        made.append(dataclasses.replace(load, codes=codes))
    fit = identify.fit_sheet(fitted(), made, "linear")
    assert fit.bad_taxels == {(2, 3): "does not respond to loads"}
    assert fit.bad == ()


def test_the_force_from_which_a_sheet_conducts_comes_from_loads() -> None:
    ideal = Calibration.of_plan(Skin(array={"rows": 4, "cols": 4}).plan)
    force = np.array([0.3, 0.6, 0.95, 1.05, 2.0, 4.0, 8.0])[:, None, None] * np.ones((7, 4, 4))
    codes = ideal.codes_of(column_currents(ideal.array(), np.where(force < 1.0, 0.0, force / 7500.0)))
    fit = identify.fit_sheet(ideal, weights(force, codes), "linear").calibration
    assert fit.curve.force_on_n == 1.05
    assert Decoder(fit, 2e-3).decode(codes).holds(force).all()


def test_a_few_light_taxels_tell_the_force_from_which_a_sheet_conducts() -> None:
    ideal = Calibration.of_plan(Skin(array={"rows": 4, "cols": 4}).plan)
    force = np.random.default_rng(3).uniform(1.5, 9.0, (25, 4, 4))
    force[:, 1, :3] = np.geomspace(0.2, 3.0, 25)[:, None]
    codes = ideal.codes_of(column_currents(ideal.array(), np.where(force < 1.0, 0.0, force / 7500.0)))
    fit = identify.fit_sheet(ideal, weights(force, codes), "linear").calibration
    assert 1.0 <= fit.curve.force_on_n < 1.1
    assert Decoder(fit, 2e-3).decode(codes).holds(force).all()


def test_dead_and_stuck_taxels_are_named() -> None:
    made = []
    for load in loads():
        codes = load.codes.copy()
        codes[:, 2, 3], codes[:, 5, 6] = 0, 255
        made.append(dataclasses.replace(load, codes=codes))
    fit = identify.fit_sheet(fitted(), made, "linear")
    assert fit.bad_taxels == {(2, 3): "does not respond to loads", (5, 6): "reads full scale without a load"}
    assert any("taxel 2 3" in note for note in fit.calibration.notes)
    found = Decoder(fit.calibration, 2e-3).decode(np.zeros((SIZE, SIZE), int))
    assert found.high_n[2, 3] > 1e3 > found.high_n[2, 4]  # newton: it says nothing of the force


def test_loads_that_contradict_each_other_are_refused() -> None:
    rng = np.random.default_rng(2)
    wrong = [dataclasses.replace(load, force_n=load.force_n * rng.uniform(0.4, 2.5)) for load in loads()]
    with pytest.raises(identify.ContradictionError, match="contradict"):
        identify.fit_sheet(fitted(), wrong, "linear")
    with pytest.raises(identify.ContradictionError, match="at least 3"):
        identify.fit_sheet(fitted(), loads()[:2], "linear")


@pytest.mark.parametrize("count", [3, 8])
def test_plates_on_an_ideal_sheet_give_a_calibration(count: int) -> None:
    """Uniform loads show no lateral: its bound before they are read is what is known of it."""
    ideal = Skin(array={"rows": SIZE, "cols": SIZE})
    known = Calibration.of_plan(ideal.plan)
    force = np.ones((SIZE, SIZE)) * np.linspace(1.0, 10.0, count)[:, None, None]
    fit = identify.fit_sheet(known, weights(force, ideal.read(force)), "linear")
    force = np.random.default_rng(8).uniform(1, 12, (10, SIZE, SIZE))
    assert Decoder(fit.calibration, 2e-3).decode(ideal.read(force)).holds(force).mean() >= 0.999


def test_the_network_is_that_of_the_least_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    """A single search, with the offsets of columns, ends beside it on this sheet: without a lateral."""
    monkeypatch.setattr(identify, "_pull", lambda score, error_a: score(0.0 * error_a) * 0.0)
    rng = np.random.default_rng(10)
    row, column, lateral = rng.uniform((1, 0.5, 300), (10, 10, 5000))
    ohm = {"row_driver": row, "column_input": column, "lateral": lateral}
    effects = {name: {"r_ohm": float(r)} for name, r in ohm.items()} | {"sensor_spread": True}
    sheet = Skin(array={"rows": SIZE, "cols": SIZE}, effects=effects)
    known = dataclasses.replace(Calibration.of_plan(sheet.plan), network={}, factor=1.0)
    plates = np.full((8, SIZE, SIZE), 1.0) * np.linspace(1, 12, 8)[:, None, None]
    parts = session.rectangles(rng, rng.choice([2.0, 5.0, 8.0, 12.0], 4), SIZE, SIZE)
    force = np.concatenate([plates, parts])
    fit = identify.fit_sheet(known, weights(force, sheet.read(force)), "linear")
    # A standard uncertainty is 35 %; without the cure it is 0.
    assert fit.calibration.network["g_lateral_row_s"] == pytest.approx(1 / lateral, rel=0.1)
    assert fit.remarks["g_lateral_row_s"] == identify.PLATES


@pytest.mark.parametrize("pair", [(2, 9), (0, 1), (5, 12)])
def test_two_loads_that_are_swapped_are_named_or_refused(pair: tuple[int, int]) -> None:
    made = list(loads())
    for here, there in (pair, pair[::-1]):
        made[here] = dataclasses.replace(made[here], force_n=loads()[there].force_n)
    try:
        fit = identify.fit_sheet(fitted(), made, "linear")
        said = str((fit.bad, fit.elsewhere))
    except identify.ContradictionError as error:
        said = str(error)
    assert all(f"weight {n}" in said for n in pair)


def test_test_currents_off_a_straight_line_are_refused() -> None:
    current, codes = session.currents(Calibration.of_plan(skin().plan), 9)
    current[[3, 6]] = current[[6, 3]]
    with pytest.raises(identify.ContradictionError, match="off a straight line"):
        identify.fit_chip(blank(), codes, current)


@pytest.mark.parametrize(
    ("found", "put", "said"),
    [
        (r"current_a = (\S+)", lambda m: f"current_a = {1e3 * float(m[1])}", "A a code: amperes"),
        (r"\[\[current\]\]\n.*\n.*\n", lambda m: "", "at least two test currents"),
    ],
    ids=["in milliamperes", "none"],
)
def test_a_session_of_the_chip_needs_its_test_currents_in_ampere(
    tmp_path: Path, found: str, put: Callable[[re.Match[str]], str], said: str
) -> None:
    path = write_session(tmp_path)
    path.write_text(re.sub(found, put, path.read_text()))
    with pytest.raises(InputError, match=said):
        run(path)


@pytest.mark.parametrize(
    ("factor", "sensor", "status", "words"),
    [
        (102.0, "", 1, r"sensitivity_ratio .* FAIL"),  # grams
        (0.2248, "", 0, r"warning: .* no \[sensor\]"),  # pounds
        (0.2248, "[sensor]\n", 0, r"warning: .*conducts 4\.\d+ times"),
    ],
)
def test_another_unit_for_newtons_is_noticed(
    tmp_path: Path, factor: float, sensor: str, status: int, words: str
) -> None:
    path = write_session(tmp_path)
    for file in tmp_path.glob("force_*.npy"):
        np.save(file, np.load(file) * factor)
    (tmp_path / "start.toml").write_text(sensor)
    path.write_text(path.read_text().replace("[start]", '[start]\nscene = "start.toml"'))
    found, said = run(path, "--out", tmp_path / "sheet.toml")
    assert found == status, said
    assert re.search(words, said)


def test_one_cycle_tells_hysteresis_and_creep() -> None:
    force, codes = session.cycle(skin(memory=True), 11.0)
    known = command.without_memory(Calibration.of_plan(skin(memory=True).plan))
    found, values = identify.fit_memory(known, codes, force, session.T_FRAME_S)
    # Half a code of 170 at the turn of the loop is 0.003 of it; creep is fitted from the same readings.
    assert values["hysteresis"][0] == pytest.approx(0.1, abs=0.003)
    assert values["creep_per_decade"][0] == pytest.approx(0.05, abs=0.003)
    assert found.memory.radius.size == 1
    shifted, late = np.roll(force, 50, axis=0), force[force[:, 0, 0].argmax() :]
    with pytest.raises(identify.ContradictionError, match="of the same frames"):
        identify.fit_memory(known, codes, shifted, session.T_FRAME_S)
    with pytest.raises(identify.ContradictionError, match="let go"):
        identify.fit_memory(known, codes[-len(late) :], late, session.T_FRAME_S)
    with pytest.raises(identify.ContradictionError, match="let go"):
        identify.fit_memory(known, np.zeros((5, SIZE, SIZE)), np.zeros((5, SIZE, SIZE)), 2e-3)


def test_the_uncertainty_of_creep_is_that_of_few_taxels_and_no_factor_moves_it() -> None:
    """Roundings of a taxel at rest are alike; an error of its factor looked like creep: 8 sigma for 0.5 %."""
    effects = {"sensor_hysteresis": True, "sensor_creep": True}
    true = Skin(array={"rows": SIZE, "cols": SIZE}, effects=effects)
    known = command.without_memory(Calibration.of_plan(true.plan))
    rng, pulls = np.random.default_rng(5), []
    rise = np.r_[np.linspace(0, 1, 125), np.ones(250), np.linspace(1, 0, 125)]
    for _ in range(4):
        force = np.zeros((rise.size, SIZE, SIZE))
        force[:, 1, 2], force[:, 2, 3] = (9 + rng.random()) * rise, (6 + rng.random()) * rise
        true.reset()
        codes = true.read(force, session.T_FRAME_S)
        off = dataclasses.replace(
            known, factor=known.factor * np.exp(5e-3 * rng.standard_normal((SIZE, SIZE)))
        )
        fits = (identify.fit_memory(one, codes, force, session.T_FRAME_S)[1] for one in (known, off))
        (creep, sigma), moved = (values["creep_per_decade"] for values in fits)
        # A search ends within a thousandth of a standard uncertainty.
        assert moved[0] == pytest.approx(creep, abs=0.01 * sigma)
        pulls.append((creep - 0.05) / sigma)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.3, pulls


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.2, 0.5, 2.0])
def test_noise_is_found_below_and_above_the_step_of_a_code(sigma: float) -> None:
    rng = np.random.default_rng(1)
    exact = rng.uniform(0, 200, 4000)
    codes = np.round(exact + sigma * rng.standard_normal((10, exact.size)))
    # 40 000 readings give a sigma to 0.4 %; rounding to codes adds some per cent below one code.
    assert identify.fit_noise(codes) == pytest.approx(sigma, rel=0.05, abs=1e-3)


def write_session(directory: Path) -> Path:
    forces = np.random.default_rng(0).choice([2.0, 5.0, 8.0, 12.0], 24)
    path = session.write(directory, skin(), forces)
    path.write_text(path.read_text() + "\n[[reference]]\nrow = 0\ncol = 1\nforce_n = 2.0\n")
    return path


run = functools.partial(commands.run, calibrate.calibrate_command)


def test_the_command_writes_a_calibration_and_sees_a_drift(tmp_path: Path) -> None:
    path = write_session(tmp_path)
    status, said = run(path, "--out", tmp_path / "sheet.toml")
    assert status == 0, said
    made = calibration.load(tmp_path / "sheet.toml")
    # Whole codes at few loads: half a code of the 5 codes that 4 ohm cost, averaged over the taxels.
    assert made.network["r_row_driven_ohm"] == pytest.approx(4.0, rel=0.05)
    assert made.reference[0][:2] == (0, 1)
    drifted = dataclasses.replace(made, step_a=made.step_a * np.where(np.arange(SIZE) == 5, 1.05, 1.0))
    drifted.save(tmp_path / "old.toml")
    status, said = run(path, "--out", tmp_path / "sheet.toml", "--check", tmp_path / "old.toml")
    assert status == 1
    assert "gain_drift.column_5" in said
    assert "column_4" not in said


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rows = 8", "rows = 7", "shape"),
        ('file = "codes_0.npy"', 'file = "gone.npy"', "gone.npy"),
        ("[[reference]]\nrow = 0", "[[reference]]\nrow = 8", "reference.0"),
        ('file = "codes_1.npy"', 'file = "codes_0.npy"', "load.1.file"),
        ('file = "codes_0.npy"', "", "load.0.file"),
        ("current_a = 0.0", "current_a = -1.0", "current.0.current_a"),
        ('force_n = "force_0.npy"', "force_n = -2.0", "load.0.force_n"),
        ('force_n = "force_0.npy"', 'force_n = "minus.npy"', "forces from 0"),
        ('force_n = "force_0.npy"', 'force_n = "kpa.csv"', "in kpa"),
        ('force_n = "force_0.npy"', 'force_n = "two.npy"', "2 frames that differ"),
        ('file = "codes_0.npy"', 'file = "put_on.npy"', "under a steady load"),
    ],
)
def test_a_wrong_session_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = write_session(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    force = loads()[0].force_n
    np.save(tmp_path / "minus.npy", -force)
    np.save(tmp_path / "two.npy", np.array([force, 2 * force]))
    codes = np.load(tmp_path / "codes_0.npy")
    np.save(tmp_path / "put_on.npy", np.concatenate([0 * codes[:1], codes]))
    names = ",".join(f"r{r}c{c} (kPa)" for r, c in np.ndindex(force.shape))
    (tmp_path / "kpa.csv").write_text(f"{names}\n{','.join(map(str, force.ravel()))}\n")
    assert said in str(refused(run, path))


def test_forces_at_other_places_and_a_file_of_another_kind_are_noticed(tmp_path: Path) -> None:
    path = write_session(tmp_path)
    status, said = run(path, "--out", tmp_path / "sheet.toml")
    assert (status, "misplaced_share" in said) == (0, True)
    with pytest.raises(InputError, match="an earlier calibration"):
        run(path, "--out", path)
    for n, load in enumerate(loads()):
        np.save(tmp_path / f"force_{n}.npy", load.force_n[::-1, ::-1])
    try:
        status, said = run(path, "--out", tmp_path / "other.toml")
    except InputError as error:  # the fit itself may see it
        status, said = 2, str(error)
    assert status, said
    assert "contradict" in said or "reads" in said
