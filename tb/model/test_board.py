# SPDX-License-Identifier: Apache-2.0
"""Boards with dividers or amplifiers and an ADC: counts of an independent nodal solve come back as forces."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import decoded, failed, read_array
from tomli_w import dumps

import dermis
from dermis.decode import calibration
from dermis.decode.decoder import SATURATED, UNSOLVED, ZERO, Decoder
from dermis.errors import InputError
from dermis.report import calibrate
from dermis.skin import Skin
from tb.programs.decode.board import Board, touches
from tb.programs.decode.session import rectangles, write_tables

ROWS, COLS = 6, 8


def board(**changes: Any) -> Board:
    """A board of 12 bits with exact dividers and equal taxels."""
    given: dict[str, Any] = {
        "rows": ROWS, "cols": COLS, "bits": 12, "divider_ohm": np.full(COLS, 200.0), "lateral_ohm": 2e3,
        "factor": np.ones((ROWS, COLS)), "multiplexer_ohm": 5.0,
    }  # fmt: skip
    return Board(**given | changes)


def scene(made: Board, **front_end: Any) -> dict[str, Any]:
    """Its scene with everything known."""
    data = made.scene(200.0)
    data["front_end"] |= {"multiplexer_ohm": made.multiplexer_ohm, **front_end}
    return data | {"effects": {"lateral": {"r_ohm": made.lateral_ohm}}}


@pytest.mark.parametrize(
    ("changes", "median_n"),
    [
        ({}, 0.2),
        ({"side": "supply"}, 0.2),
        ({"reference_v": 1.1}, 0.2),
        ({"multiplexer_ohm": 0.0}, 0.2),
        ({"divider_ohm": np.full(COLS, 5e3), "lateral_ohm": 1e9}, 3.0),
        ({"idle_rows": "open", "lateral_ohm": 1e9}, np.inf),
    ],
)
def test_counts_of_a_dense_solve_are_those_of_a_skin_and_come_back(changes: dict, median_n: float) -> None:
    made, rng = board(**changes), np.random.default_rng(2)
    force = np.concatenate([touches(rng, 10, ROWS, COLS), rng.uniform(0, 12, (4, ROWS, COLS))])
    counts = made.counts(force, rng)
    skin = Skin(scene(made, resistor_ohm=made.divider_ohm.tolist()))
    assert np.array_equal(skin.read(force), counts)
    found = skin.decode(counts)
    assert not (found.flags & UNSOLVED).any()
    assert found.holds(force).all()
    assert np.median(found.high_n - found.low_n) < median_n
    # Without the decoder a taxel's force is wrong by far more.
    error, before = (np.sqrt(np.mean((f - force) ** 2)) for f in (found.force_n, made.force_of(counts)))
    assert error < before / 5


@pytest.mark.parametrize("side", ["ground", "supply"])
def test_a_session_calibrates_a_board_and_the_command_reads_its_counts(tmp_path: Path, side: str) -> None:
    rng = np.random.default_rng(5)
    parts = {"divider_ohm": 200 * (1 + 0.01 * rng.uniform(-1, 1, COLS)), "side": side, "noise_counts": 0.3}
    made = board(factor=np.exp(0.1 * rng.standard_normal((ROWS, COLS))), **parts)
    session = made.session(tmp_path, rectangles(rng, np.geomspace(1, 12, 25), ROWS, COLS), 200.0, rng)
    known, _ = calibrate.session(session)
    known.save(tmp_path / "sheet.toml")
    again = calibration.load(tmp_path / "sheet.toml")
    curve = replace(known.curve, coefficients=-known.curve.coefficients)
    replace(known, curve=curve).save(tmp_path / "no.toml")
    with pytest.raises(InputError, match="no force at any"):
        calibration.load(tmp_path / "no.toml")
    assert (again.falling, again.divider, again.code_max) == (side == "supply", True, 4095)
    with pytest.raises(InputError, match="of another board"):
        Skin(scene(made, resistor_ohm=330.0), calibration=again)
    # Four readings of a count each.
    assert again.noise_code == pytest.approx(0.3, rel=0.2)
    force = touches(rng, 12, ROWS, COLS)
    counts = made.counts(force, rng)
    assert read_array(tmp_path, counts, "--calibration", tmp_path / "sheet.toml", unit="codes")[0] == 0
    found = decoded(tmp_path / "out")
    off = made.alone(found.force_n) - made.alone(force)
    # Rounding and noise of a count; laterals of 0.6 of the dividers make them 2.4 times as large, a quarter is the fit.
    assert np.sqrt(np.mean(off**2)) < 1.25 * np.hypot(1 / np.sqrt(12), 0.3) * np.hypot(2.2, 0.6 * np.sqrt(2))
    assert found.holds(force).mean() > 0.999


def test_dividers_of_five_per_cent_are_found_by_the_crosstalk_that_they_make(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    ohm = 1e3 * (1 + 0.05 * rng.standard_normal(COLS))
    factor = np.exp(0.1 * rng.standard_normal((ROWS, COLS)))
    made = board(bits=16, divider_ohm=ohm, lateral_ohm=1e3, factor=factor, noise_counts=0.7)
    session = made.session(tmp_path, rectangles(rng, rng.uniform(0.5, 6, 30), ROWS, COLS), 1e3, rng)
    known, _ = calibrate.session(session)
    found = known.network["r_column_ohm"] / ohm
    assert np.std(found) < 2e-3  # a thirtieth of what they differ
    force = rng.uniform(0.5, 6, (30, ROWS, COLS)) * (rng.random((30, ROWS, COLS)) < 0.6)
    forces = Decoder(known, 0.01).decode(made.counts(force, rng))
    # With the resistors held at 1 kohm 2 of 5 taxels without a force read one, of up to 0.2 N.
    assert forces.holds(force).mean() > 0.999
    assert np.sqrt(np.mean((forces.force_n - force) ** 2)) < 0.005


def test_rounding_does_not_pull_the_network_down(tmp_path: Path) -> None:
    off = []
    for seed in range(8):
        rng = np.random.default_rng([8, seed])
        sheet = {"factor": np.exp(0.1 * rng.standard_normal((ROWS, COLS))), "lateral_ohm": 1e3}
        made = board(bits=10, divider_ohm=np.full(COLS, 100.0), multiplexer_ohm=20.0, **sheet)
        loads = np.zeros((14, ROWS, COLS))
        for load in [*loads, *loads]:
            r, c, more = (*rng.integers(0, (ROWS - 1, COLS - 1)), rng.integers(2, 5))
            load[r : r + more, c : c + 2] = rng.uniform(0.5, 6)
        _, rows = calibrate.session(made.session(tmp_path, loads, 100.0, rng))
        told = {row["name"]: row for row in rows}
        pairs = (told["calibrate.r_row_driven_ohm"], 20.0), (told["calibrate.g_lateral_row_s"], 1e-3)
        off.append([(t["value"] - true) / float(t["note"].split()[2].rstrip(";")) for t, true in pairs])
    # In standard uncertainties, whose mean of 8 is 0.35 off by chance; least squares alone give -1.1 and -1.6.
    assert np.abs(np.mean(off, axis=0)).max() < 0.8, off


def test_an_amplifier_reads_both_ways_and_an_adc_may_round_down() -> None:
    force = touches(np.random.default_rng(3), 5, ROWS, COLS)
    amplifier = {"circuit": "transimpedance", "resistor_ohm": 500.0, "full_scale": 1023, "supply_v": 1.0}
    common = {"reference_v": 3.3, "idle_rows": "held"}
    volts = 500.0 * force / 7500.0 * 1024 / 3.3  # columns at one level, drivers of no resistance
    for counts, zero in (("rise", 100.0), ("fall", 900.0)):
        sign = 1 if counts == "rise" else -1
        made = {"front_end": amplifier | common | {"counts": counts, "zero_count": zero}}
        skin = Skin({"array": {"rows": ROWS, "cols": COLS}, "sensor": {"k_force_n_ohm": 7500.0}} | made)
        assert np.array_equal(skin.read(force), np.clip(np.floor(zero + sign * volts + 0.5), 0, 1023))
        # Half a count is 3.3 / 1024 / 500 / 2 / 1 V x 7500 N ohm = 0.024 N, and the zero is half a count off.
        assert skin.decode(skin.read(force)).force_n == pytest.approx(force, abs=0.06)
        assert (skin.decode(np.full((ROWS, COLS), int(zero))).flags & ZERO).all()
        # Far on the other side of the zero nothing is known.
        assert np.isinf(skin.decode(np.full((ROWS, COLS), int(zero) - sign * 50)).high_n).all()
    for side in ("ground", "supply"):
        made = board(side=side, lateral_ohm=1e9, multiplexer_ohm=0.0)
        skin = Skin(scene(made, rounding="down"))
        part = np.array([made.column_volts(frame) for frame in force]) * (4096 / 3.3)
        counts = np.clip(np.floor(part if side == "ground" else 4096 - part), 0, 4095).astype(int)
        found = skin.decode(counts)
        assert found.holds(force).all()
        # Rounding leaves a quarter of a count in the middle; the other way round it would be three quarters.
        assert np.abs((made.alone(found.force_n) - made.alone(force))[counts % 4095 > 0]).mean() < 0.5


GOOD = board().scene(200.0)["front_end"]


@pytest.mark.parametrize(
    ("changes", "beside", "key"),
    [
        ({"side": None}, {}, "front_end.side"),
        ({"idle_rows": None}, {}, "front_end.idle_rows"),
        ({"resistor_ohm": [1.0, 2.0]}, {}, "front_end.resistor_ohm"),
        ({"resistor_ohm": -5.0}, {}, "front_end.resistor_ohm"),
        ({"full_scale": 0}, {}, "front_end.full_scale"),
        ({"supply_v": float("nan")}, {}, "front_end.supply_v"),
        ({"idle_columns": "open"}, {}, "front_end.idle_columns"),
        ({"zero_count": 3.0}, {}, "front_end.zero_count"),
        ({"circuit": "transimpedance", "side": None}, {}, "front_end.zero_count"),
        ({"side": "supply", "reference_v": 1.1}, {}, "front_end.reference_v"),
        ({"gain": 2.0}, {}, "front_end.gain"),
        ({}, {"interface": {"k": 80}}, "interface.k"),
        ({}, {"effects": {"row_driver": True}}, "effects.row_driver"),
        ({}, {"effects": {"mirror_ratio": True}}, "effects.mirror_ratio"),
        ({}, {"effects": {"auto": {}}}, "effects"),
    ],
)
def test_a_board_that_is_not_understood_and_parts_of_the_chip_beside_it_are_refused(
    changes: dict[str, Any], beside: dict[str, Any], key: str
) -> None:
    table = {name: value for name, value in (GOOD | changes).items() if value is not None}
    with pytest.raises(InputError, match=key):
        Skin({"array": {"rows": ROWS, "cols": COLS}, "front_end": table, **beside})


def test_no_engine_of_the_chip_runs_a_board() -> None:
    with pytest.raises(InputError, match="front_end"):
        dermis.simulate({"front_end": GOOD}, force_n=np.zeros((16, 16)))


def test_a_calibration_of_another_read_out_is_not_read_with() -> None:
    own = Skin(scene(board())).decoder.calibration
    skin = Skin(array={"rows": ROWS, "cols": COLS}, calibration=own)
    assert skin.decode(np.zeros((ROWS, COLS), int)).flags.all()
    with pytest.raises(InputError, match="another"):
        skin.read(np.zeros((ROWS, COLS)))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"side": "supply"}, "read.saturated_share"),
        ({"full_scale": 127}, "0..127"),
        ({"resistor_ohm": 2.0, "r_min_ohm": 100.0}, "read.saturated_share"),
    ],
)
def test_a_wrong_board_is_not_read_in_silence(tmp_path: Path, wrong: dict[str, Any], said: str) -> None:
    """The divider on the other side, the full scale of another ADC, another divider."""
    made, rng = board(), np.random.default_rng(6)
    (tmp_path / "board.toml").write_text(dumps(scene(made, **wrong)))
    counts = made.counts(touches(rng, 10, ROWS, COLS), rng)
    given = tmp_path, counts, "--scene", tmp_path / "board.toml"
    if said.startswith("read"):
        assert read_array(*given, unit="codes")[0] == 1
        assert said in failed(tmp_path / "out")
    else:
        with pytest.raises(InputError, match=said):
            read_array(*given, unit="codes")


@pytest.mark.parametrize("side", ["ground", "supply"])
def test_counts_at_both_ends_and_missing_ones(tmp_path: Path, side: str) -> None:
    made, rng = board(side=side), np.random.default_rng(7)
    force = touches(rng, 11, ROWS, COLS)
    counts = made.counts(force, rng).astype(float)
    skin = Skin(scene(made))
    none, full = (0, made.most) if side == "ground" else (made.most, 0)
    assert (skin.decode(np.full((ROWS, COLS), none)).flags == ZERO).all()
    ends = skin.decode(np.full((ROWS, COLS), full))
    assert ((ends.flags & SATURATED) > 0).all()
    assert np.isinf(ends.high_n).all()
    counts[3, 2, 4] = np.nan
    (tmp_path / "board.toml").write_text(dumps(scene(made)))
    assert read_array(tmp_path, counts, "--scene", tmp_path / "board.toml", unit="codes")[0] == 0
    found = decoded(tmp_path / "out")
    assert np.isnan(found.force_n[3, 2, 4])
    assert np.isinf(found.high_n[3, 2, 4])
    assert found.holds(force).all()
    with pytest.raises(ValueError, match="codes must be"):
        Decoder(skin.decoder.calibration, 0.01).decode(np.full((ROWS, COLS), made.most + 1))


def judged(
    tmp_path: Path, loads: np.ndarray, codes: list[np.ndarray]
) -> tuple[calibration.Calibration, dict]:
    """Calibrate with loads and codes; the calibration, and the rows by name."""
    (tmp_path / "board.toml").write_text(dumps(board().scene(200.0)))
    known, rows = calibrate.session(
        write_tables(tmp_path, (ROWS, COLS), 'scene = "board.toml"', loads, codes)
    )
    return known, {row["name"].removeprefix("calibrate."): row for row in rows}


def test_a_short_behind_a_multiplexer_is_named_and_has_no_upper_end(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    loads = rectangles(rng, np.geomspace(1, 12, 25), ROWS, COLS)
    shorted = loads.copy()
    shorted[:, 2, 3] = 300.0  # 25 ohm beside dividers of 200 ohm
    known, rows = judged(tmp_path, loads, [board().counts(force[None], rng) for force in shorted])
    assert rows["bad_taxels"]["note"] == "2 3 reads as a short without a load"
    wanted = "1 taxel without a response to force (row, column 2 3)", "no reading was", "no [[cycle]]"
    assert all(part in said for part, said in zip(wanted, known.doubts(), strict=True))
    high_n = Decoder(known, 0.01).decode(board().counts(shorted[:2], rng)).high_n
    assert np.isinf(high_n[:, 2, 3]).all()
    assert np.isfinite(high_n[:, 3:, 5:]).all()


@pytest.mark.parametrize(("share", "drifts"), [(0.02, 0.0), (0.2, 0.2)])
def test_a_gain_that_drifts_from_load_to_load_fails(tmp_path: Path, share: float, drifts: float) -> None:
    rng = np.random.default_rng(6)
    loads = rectangles(rng, rng.permutation(np.geomspace(1, 12, 25)), ROWS, COLS)
    gain = 1 + share * np.arange(25) / 24
    codes = [np.round(g * board().counts(f[None], rng)).astype(int) for f, g in zip(loads, gain, strict=True)]
    _, rows = judged(tmp_path, loads, codes)
    assert rows["drift"]["status"] == ("FAIL" if drifts else "PASS")
    assert 0.8 * drifts <= rows["drift"]["value"] <= 2 * max(drifts, share)  # a divider makes more of it


def test_kilograms_for_newtons_and_loads_that_changed_places_fail(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    loads = rectangles(rng, np.geomspace(1, 12, 25), ROWS, COLS)
    codes = [board().counts(force[None], rng) for force in loads]
    rows = judged(tmp_path, loads, codes)[1]
    assert (rows["sensitivity_ratio"]["status"], rows["bad_loads"]["value"]) == ("PASS", 0)
    assert judged(tmp_path, loads / 9.80665, codes)[1]["sensitivity_ratio"]["status"] == "FAIL"
    apart = next(n for n in range(6, 25) if not ((loads[n] > 0) & (loads[5] > 0)).any())
    loads[[5, apart]] = loads[[apart, 5]]
    bad = judged(tmp_path, loads, codes)[1]["bad_loads"]
    assert (bad["value"], bad["status"]) == (2, "FAIL")
