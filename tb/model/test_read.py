# SPDX-License-Identifier: Apache-2.0
"""`dermis read`: every format gives the same frames, what is missing is asked for, and a wrong unit does not pass."""

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import decoded, failed, read_array
from made_plans import refused
from numpy.typing import ArrayLike

from dermis.chip.spi_protocol import RowsOfInterest
from dermis.decode import recording
from dermis.decode.calibration import Calibration
from dermis.decode.recording import Layout
from dermis.errors import InputError
from dermis.report import html, output, read
from dermis.scene.design import ROOT
from dermis.scene.schema import write_toml
from dermis.skin import Skin

FRAMES = np.round(np.random.default_rng(0).uniform(0, 9, (7, 4, 6)), 3)
TIME = 100.0 + 0.02 * np.arange(7)


def text(lead: str, cells: Callable[[int], str]) -> str:
    """Return a csv with a frame a line and names; `lead` are those of leading columns."""
    lines = [lead + ",".join(f"taxel_{k}" for k in range(24))]
    lines += [cells(n) + ",".join(f"{v:g}" for v in frame.ravel()) for n, frame in enumerate(FRAMES)]
    return "\n".join(lines) + "\n"


run = functools.partial(commands.run, read.read_command)


def test_the_command_writes_codes_and_forces_with_time(tmp_path: Path) -> None:
    path, out = tmp_path / "touch.csv", tmp_path / "out"
    path.write_text(text("time_s,", lambda n: f"{TIME[n]:.3f},"))
    status, said = run(path, "--rows", 4, "--cols", 6, "--unit", "newtons", "--out", out)
    assert status == 0, said
    found = decoded(out)
    # Half a code of 15 N, and a tenth for the network that is taken back.
    assert np.abs(found.force_n - FRAMES).max() < 0.6 * 15 / 255
    assert found.holds(FRAMES).all()
    table = np.genfromtxt(out / "forces_n.csv", delimiter=",", names=True)
    assert table["time_s"][::4] == pytest.approx(0.02 * np.arange(7))
    # The csv has six digits.
    assert table["c5"].reshape(7, 4) == pytest.approx(found.force_n[:, :, 5], rel=1e-5)
    columns = np.genfromtxt(out / "codes.csv", delimiter=",", names=True)
    assert (columns["c0"].reshape(7, 4) == np.load(out / "codes.npy")[:, :, 0]).all()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["t_frame_s"] == pytest.approx(0.02)
    values = {row["name"]: row["value"] for row in summary["verdicts"]}
    assert values["read.corrected.rms_error_n"] < 0.5 * values["read.uncorrected.rms_error_n"]


def test_nothing_that_was_read_is_written_over(tmp_path: Path) -> None:
    np.save(path := tmp_path / "forces_n.npy", FRAMES)
    before = path.read_bytes()
    with pytest.raises(InputError, match="would replace forces_n"):
        run(path, "--unit", "newtons", "--rate", 50, "--out", tmp_path)
    with pytest.raises(InputError, match="--html"):
        html.reporting("read", path, lambda: 0)
    assert path.read_bytes() == before


def test_replacing_results_of_another_file_warns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read, "BUILD", tmp_path / "build")
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        np.save(tmp_path / side / "touch.npy", FRAMES)
        said = run(tmp_path / side / "touch.npy", "--unit", "newtons", "--rate", 50)[1]
    assert f"replaces the results of {tmp_path / 'left'}" in said


def test_counts_of_a_board_that_runs_the_other_way_fail(tmp_path: Path) -> None:
    board = {"circuit": "transimpedance", "resistor_ohm": 500.0, "full_scale": 1023, "supply_v": 1.0}
    board |= {"reference_v": 3.3, "idle_rows": "held", "zero_count": 50.0}
    scene, counts = tmp_path / "board.toml", np.round(50 + 30 * FRAMES).astype(int)
    for way, status in (("rise", 0), ("fall", 1)):
        scene.write_text(write_toml({"front_end": board | {"counts": way}}))
        done = read_array(tmp_path, counts, "--scene", scene, unit="codes")
        assert done[0] == status, done[1]
    assert "read.below_zero_share" in failed(tmp_path / "out")


@pytest.mark.parametrize(("factor", "row"), [(1000.0, "read.saturated_share"), (0.001, "read.largest_code")])
def test_a_wrong_unit_does_not_pass(tmp_path: Path, factor: float, row: str) -> None:
    assert read_array(tmp_path, FRAMES * factor)[0] == 1
    assert failed(tmp_path / "out") == [row]


@pytest.mark.paper
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "--unit codes"),
        (["--unit", "kpa"], "--area"),
        (["--unit", "newtons", "--rate", "5000"], "at most 2000 frames"),
        (["--unit", "newtons", "--scene", "wide_sheet"], "as the recording has"),
        (["--unit", "newtons", "--mask", "gone.npy"], "--mask"),
        (["--unit", "newtons", "--mask", "touch.npy"], "4 x 6 values, 0 where"),
        (["--unit", "newtons", "--mask", "zero.npy"], "no taxel"),
        (["--unit", "newtons", "--out", "touch.npy"], "a directory that can be written"),
        (["--unit", "newtons", "--calibration", "gone.toml"], "gone.toml"),
        (["--unit", "newtons", "--area", "25"], "--area"),
        (["--unit", "newtons", "--taxels", "9"], "--taxels"),
        (["--unit", "newtons", "--axes", "rows,frames"], "--axes"),
        (["--unit", "newtons", "--missing", "perhaps"], "a number, refuse or hold"),
        (["--unit", "codes"], "--through-chip"),
        (["--unit", "codes", "--scale", "2"], "--through-chip"),
    ],
)
def test_open_questions_are_asked_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("touch.npy", FRAMES)
    np.save("zero.npy", np.zeros((4, 6), dtype=bool))
    rate = [] if "--rate" in arguments else ["--rate", "50"]
    assert said in str(refused(run, "touch.npy", *rate, *arguments))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["touch.npy", "zero.npy"]


def test_a_mask_and_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    mask = np.ones((4, 6), int)
    mask[1, 2] = 0
    np.savetxt(tmp_path / "mask.csv", mask, delimiter=",", fmt="%d")
    assert read_array(tmp_path, FRAMES, "--mask", tmp_path / "mask.csv", "--hdf5")[0] == 0
    with h5py.File(tmp_path / "out/forces.h5") as file:
        assert (file["present"][()] == (mask == 1)).all()
        assert (file["forces_n"][:, 1, 2] == 0).all()
    found = recording.load(tmp_path / "out/forces.h5", Layout(key="forces_n", time_key="time_s"))
    assert found.t_frame_s == pytest.approx(0.02)
    # A second run without --hdf5 leaves no file of the first one.
    read_array(tmp_path, FRAMES)
    assert not (tmp_path / "out/forces.h5").exists()


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_of_its_own_is_read_back(tmp_path: Path, storage: str) -> None:
    mask = np.arange(24).reshape(4, 6) != 8
    np.save(tmp_path / "mask.npy", mask)
    assert read_array(tmp_path, FRAMES, "--mask", tmp_path / "mask.npy", "--bag", storage)[0] == 0
    found = recording.load(tmp_path / "out/forces_bag", Layout(key="/dermis/force_n"))
    assert (found.values == np.load(tmp_path / "out/forces_n.npy")).all()
    assert (found.present == mask).all()
    # Whole nanoseconds.
    assert found.time_s == pytest.approx(0.02 * np.arange(7), abs=1e-9)
    # A second run without --bag leaves no bag of the first one.
    read_array(tmp_path, FRAMES)
    assert not (tmp_path / "out/forces_bag").exists()


def test_a_bag_has_the_times_of_what_was_read(tmp_path: Path) -> None:
    stamps = np.datetime64("2026-03-04T10:00:00.123456789") + 20_000_000 * np.arange(7)
    np.savez(tmp_path / "touch.npz", force=FRAMES, time=stamps)
    options = *"--rows 4 --cols 6 --unit newtons --bag mcap --out".split(), tmp_path / "out"
    assert run(tmp_path / "touch.npz", *options)[0] == 0
    found = recording.load(tmp_path / "out/forces_bag", Layout(key="/dermis/force_n"))
    assert found.start_ns == 1_772_618_400_123_456_789  # date -u -d 2026-03-04T10:00:00 +%s
    assert json.loads((tmp_path / "out/summary.json").read_text())["start_ns"] == found.start_ns


def test_a_mask_is_no_header(tmp_path: Path) -> None:
    (tmp_path / "mask.csv").write_text("0,1\n1,1\n")
    assert read_array(tmp_path, np.full((3, 2, 2), 4.0), "--mask", tmp_path / "mask.csv")[0] == 0
    assert np.argwhere(np.load(tmp_path / "out/forces_n.npy")[0] == 0).tolist() == [[0, 0]]


def test_negative_values_need_an_option(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--clip-negative"):
        read_array(tmp_path, FRAMES - 0.5)
    assert read_array(tmp_path, FRAMES - 0.5, "--clip-negative")[0] == 0
    clipped = np.maximum(FRAMES - 0.5, 0)
    # Half a code of 15 N, and a tenth of a code for the correction of the array.
    assert np.abs(np.load(tmp_path / "out/forces_n.npy") - clipped).max() < 0.6 * 15 / 255


def test_a_calibration_of_another_chip_fails(tmp_path: Path) -> None:
    true = Calibration.of_plan(read.chip_of(4, 6, None))
    step = true.step_a * np.where(np.arange(6) == 2, 1.2, 1.0)
    dataclasses.replace(true, step_a=step).save(tmp_path / "other.toml")
    status, said = read_array(tmp_path, FRAMES, "--calibration", tmp_path / "other.toml")
    assert status == 1
    assert "column 2" in said


# ---- codes, and values that are missing

WEAK = """[stimulus]
kind = "uniform"
force_n = 0.0
[effects]
row_driver = {r_ohm = 25.0}
column_input = {r_ohm = 20.0}
lateral = {r_ohm = 1000.0}
"""
"""Drivers and inputs that take 2.3 N of 8 N away."""


def test_codes_are_decoded_as_by_skin(tmp_path: Path) -> None:
    (tmp_path / "chip.toml").write_text(WEAK + "[array]\nrows = 8\ncols = 8\n")
    skin = Skin(tmp_path / "chip.toml")
    force = np.full((3, 8, 8), 8.0)
    codes = skin.read(force)
    wanted = skin.decode(codes)
    skin.decoder.calibration.save(tmp_path / "known.toml")
    chips = ("--scene", tmp_path / "chip.toml"), ("--calibration", tmp_path / "known.toml")
    for chip in chips:
        status, said = read_array(tmp_path, codes, *chip, unit="codes")
        assert status == 0, said
        found = decoded(tmp_path / "out")
        assert (found.force_n == wanted.force_n).all()
        # Half a code of 15 N.
        assert np.abs(found.force_n - 8).max() < 0.5 * 15 / 255 * 1.5
        assert found.holds(force).all()
        assert (np.load(tmp_path / "out/codes.npy") == codes).all()
    # Taken as forces of an ideal chip they are 2 N less.
    assert read_array(tmp_path, codes, *chips[0], "--through-chip", unit="codes")[0] == 0
    assert np.abs(decoded(tmp_path / "out").force_n - 8).max() > 1
    assert "--scene or --calibration" in read_array(tmp_path, codes, unit="codes")[1]


@pytest.mark.parametrize("unit", ["newtons", "codes"])
def test_a_missing_value_opens_its_own_interval_only(tmp_path: Path, unit: str) -> None:
    skin = Skin(read.chip_of(4, 6, None))
    values = FRAMES if unit == "newtons" else skin.read(FRAMES).astype(float)
    read_array(tmp_path, values, unit=unit)
    whole = decoded(tmp_path / "out").force_n
    gap = values.copy()
    gap[2, 1, 3] = np.nan
    status, said = read_array(tmp_path, gap, unit=unit)
    assert status == 0, said
    found = decoded(tmp_path / "out")
    assert np.argwhere(np.isnan(found.force_n)).tolist() == [[2, 1, 3]]
    assert (found.low_n[2, 1, 3], found.high_n[2, 1, 3]) == (0, np.inf)
    others = ~np.isnan(found.force_n)
    # A code of another taxel moves these by the droop that its current makes: less than a code of 15 N.
    assert np.abs(found.force_n - whole)[others].max() < 15 / 255
    assert np.isfinite(found.high_n[others]).all()
    assert found.holds(FRAMES).all()
    with pytest.warns(UserWarning, match="1 missing value in 1 frame,"):
        back = recording.load(tmp_path / "out/forces_n.csv", Layout())
    # The csv has six digits.
    assert back.values == pytest.approx(found.force_n, rel=1e-5, nan_ok=True)
    assert np.isnan(recording.load(tmp_path / "out/codes.csv", Layout()).values).sum() == 1
    assert read_array(tmp_path, gap, "--missing", "hold", unit=unit)[0] == 0
    assert np.isfinite(decoded(tmp_path / "out").force_n).all()
    with pytest.raises(InputError, match="frame 2, row 1, column 3"):
        read_array(tmp_path, gap, "--missing", "refuse", unit=unit)


def test_the_command_prints_what_it_understood(tmp_path: Path) -> None:
    path = tmp_path / "touch.csv"
    path.write_text(text("sum,time_ms,", lambda n: f"7,{20 * n},"))
    said = run(path, "--rows", 4, "--cols", 6, "--unit", "newtons", "--out", tmp_path / "out")[1]
    rate = "50 frames/s, time from time_ms, in ms"
    for line in ("4 rows x 6 columns", rate, "by names, taxel_0", "ignored  sum"):
        assert line in said
    assert json.loads((tmp_path / "out/summary.json").read_text())["understood"]["rate"] == rate
    pressed = np.zeros((2, 40, 70))
    pressed[1, 39, 69] = 3.0
    head, *lines = read.touch_map(pressed)
    assert head.startswith("frame 1, 3 N in all")
    assert (len(lines), len(lines[0]), lines[-1][-1], lines[0][0]) == (20, 35, "@", ".")
    words, frame = read.strongest(np.where(pressed[1] > 0, pressed, np.nan), 64, 64)
    assert words == head.removesuffix(":")
    assert frame.shape == (40, 35)
    assert np.nansum(frame) == frame[39, 34] == 3
    words, frame, unit = output.MAPS[-1]
    assert (frame.shape, unit) == ((4, 6), "N")
    assert words.split(",")[0] == said[said.index("frame ") :].split(",")[0]


# ---- rows of interest


def plain_waits(masks: list[np.ndarray], peaks: np.ndarray) -> list[int]:
    """Frames from the moment a row is touched to the first frame that has the row, one by one."""
    waits = []
    for row in range(peaks.shape[1]):
        for frame in range(len(peaks)):
            if peaks[frame, row] >= 8 and (frame == 0 or peaks[frame - 1, row] < 8):
                wait = 0
                while frame + wait < len(peaks) and not masks[frame + wait][row]:
                    wait += 1
                waits.append(wait)
    return waits


@pytest.mark.parametrize("late", [0, 1])
def test_rows_of_interest_are_followed_as_frame_by_frame(late: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    codes = rng.integers(0, 30, (200, 12, 5)) * (rng.random((200, 12, 1)) < 0.05)
    given = []

    class Noted(RowsOfInterest):
        def next(self, slots: ArrayLike, values: ArrayLike) -> np.ndarray:
            given.append(super().next(slots, values))
            return given[-1]

    monkeypatch.setattr(read, "RowsOfInterest", Noted)
    saved, delay = read.interest_rows(codes, 0.002 * np.arange(200), 0.002, late)
    masks = [np.ones(12, bool)] * (1 + late) + given
    waits = plain_waits(masks, codes.max(axis=2))
    assert saved["value"] == pytest.approx(1 - np.mean(masks[:200]))
    assert delay["value"] == max(waits) > 5
    assert delay["note"].startswith(f"{sum(w > 0 for w in waits)} of {len(waits)} late; ")


def test_a_recording_of_years_is_followed_for_its_beginning() -> None:
    codes = np.zeros((3, 4, 4), int)
    codes[2] = 9
    saved, delay = read.interest_rows(codes, np.array([0.0, 1.0, 1e9]), 0.002)
    assert saved["note"] == "20000 frames of 0.002 s"
    assert (saved["status"], delay["value"]) == ("PASS", 0)
    assert read.interest_rows(codes[:1], np.zeros(1), 0.002)[0]["note"] == "1 frame of 0.002 s"


@pytest.mark.paper
def test_the_page_has_the_rows_of_the_recordings(tmp_path: Path, gait_csv: Path) -> None:
    page = (ROOT / "docs" / "spi.md").read_text(encoding="utf-8")
    touch = [str(ROOT / "models/scenes/recorded_touch.csv"), "--unit", "newtons", "--rate", "100"]
    found = [(*touch, "--rows", "16", "--cols", "16")]
    if gait_csv.name == "fscan_gait_16x16.csv":
        found.append((str(gait_csv), "--unit", "codes", "--rate", "31.25", "--through-chip"))
    for arguments in found:
        assert run(*arguments, "--out", tmp_path / "out")[0] == 0
        summary = json.loads((tmp_path / "out/summary.json").read_text())
        rows = {row["name"]: row for row in summary["verdicts"]}
        saved, delay = rows["read.rows_saved"], rows["read.touch_delay_frames"]
        late, missed = delay["note"].removesuffix(" readings missed").split(" late; ")
        shown = f"{saved['value']:.0%}".replace("%", " %"), f"{delay['value']}", late, missed
        assert f"| {' | '.join(shown)} |" in page.replace("22 401", "22401")
