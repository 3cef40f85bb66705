# SPDX-License-Identifier: Apache-2.0
"""Stimuli: the profiles they promise, the files they read, and what is said about files that are wrong."""

import io
import math
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_plans import refused
from numpy.typing import NDArray

import dermis
from dermis import engines
from dermis import plan as planning
from dermis.errors import InputError
from dermis.report.output import npy_bytes as npy
from dermis.scene import design, stimulus

T = 2e-3  # frame time of the chip with its 16 rows

Write = Callable[..., Path]


def forces(write_scene: Write, text: str, **files: str | bytes) -> NDArray[np.float64]:
    force = planning.load(write_scene(text, **files)).force_n
    assert force is not None
    return force


def indenter(shape: str, more: str = "") -> str:
    return f'[stimulus]\nkind = "indenter"\nshape = "{shape}"\nforce_n = 10.0\n{more}'


GRID = "[array]\nrows = 2\ncols = 3\n[stimulus]\n"
OHMS = GRID + 'kind = "resistance"\nfile = "frames.csv"\n'


def frames(unit: str = "codes", more: str = "", file: str = "frames.csv") -> str:
    return f'{GRID}kind = "frames"\nfile = "{file}"\nunit = "{unit}"\n{more}'


tapping = '[stimulus]\nkind = "tapping"\nshape = "round"\nforce_n = 10.0\n{}'.format
ramp = '[stimulus]\nkind = "ramp"\n{}'.format
recorded = '[stimulus]\nkind = "uniform"\nforce_n = [0, 4, 12]\n{}'.format


def npz(**arrays: NDArray[np.generic]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def complaint(write_scene: Write, text: str, **files: str | bytes) -> InputError:
    return refused(planning.load, write_scene(text, **files))


@pytest.mark.paper
@pytest.mark.parametrize(
    ("shape", "profile", "load"),
    [
        ("flat", lambda u, v: 1.0, 1.0),
        ("triangular", lambda u, v: 1 - abs(u), 1 / 2),
        # Hertz: the half ellipse, the half ellipsoid.
        ("cylindrical", lambda u, v: math.sqrt(1 - u * u), math.pi / 4),
        ("spherical", lambda u, v: math.sqrt(max(1 - u * u - v * v, 0.0)), math.pi / 6),
        ("round", lambda u, v: float(u * u + v * v < 1), math.pi / 4),
    ],
)
def test_a_body_presses_with_its_profile_and_load(
    shape: str, profile: Callable[[float, float], float], load: float, write_scene: Write
) -> None:
    more = "width = 10.6\nlength = 6.4\ncenter_row = 7\ncenter_col = 8\n"
    force = forces(write_scene, indenter(shape, more))[0]
    for (row, col), found in np.ndenumerate(force):
        u, v = (col - 8) / 5.3, (row - 7) / 3.2
        expected = 10 * profile(u, v) if -1 < u < 1 and -1 < v < 1 else 0.0
        # The square root near the rim: five digits fewer than the sixteen.
        assert found == pytest.approx(expected, abs=1e-9)
    fine = "[array]\nrows = 200\ncols = 100\n" + indenter(shape, "width = 90\nlength = 180\n")
    total = fine.replace("force_n = 10.0", "total_force_n = [10.0, 0, 25]")
    assert forces(write_scene, total).sum(axis=(1, 2)) == pytest.approx([10, 0, 25])
    # Taxels of the rim are in or out: 430 of them, each wrong by up to a half, mostly cancelling.
    assert forces(write_scene, fine).sum() / (10 * 90 * 180) == pytest.approx(load, rel=2e-3)


@pytest.mark.paper
@pytest.mark.parametrize("shape", ["flat", "triangular", "cylindrical"])
def test_an_angle_turns_the_width_towards_rising_rows(shape: str, write_scene: Write) -> None:
    straight = forces(write_scene, indenter(shape, "width = 8\nlength = 4\n"))[0]
    turned = forces(write_scene, indenter(shape, "width = 8\nlength = 4\nangle_deg = 90\n"))[0]
    # The rim of a half ellipse is a square root: a rounding of 1e-16 in x is 1e-8 of the peak there.
    assert turned == pytest.approx(straight.T, abs=1e-6)
    thin = forces(write_scene, indenter("flat", "width = 8\nlength = 1.2\nangle_deg = 45\n"))[0]
    # 8 pitches across the diagonal reach 2.8 rows and columns to either side of (7.5, 7.5)
    assert np.argwhere(thin).tolist() == [[i, i] for i in range(5, 11)]


def test_more_samples_feel_a_body_between_taxels(write_scene: Write) -> None:
    thin = "width = 0.5\nlength = 4\ncenter_row = 7.5\ncenter_col = 7.5\n"
    assert not forces(write_scene, indenter("flat", thin)).any()
    felt = forces(write_scene, indenter("flat", thin + "samples = 8\n"))[0]
    # half a pitch over the border of two taxels: a quarter of each
    assert felt[6:10, 7:9] == pytest.approx(2.5)
    assert felt.sum() == pytest.approx(20)


def slip(more: str, body: str = "flat", force: str = "force_n = 10.0") -> str:
    return f'[stimulus]\nkind = "slip"\nshape = "{body}"\n{force}\nwidth = 2\nlength = 2\n{more}'


@pytest.mark.paper
def test_a_slipping_body_moves_at_its_speed_in_its_direction(write_scene: Write) -> None:
    more = "speed_pitch_per_s = 50\ndirection_deg = 30\nstart_s = 0.01\nduration_s = 0.05\nsamples = 16\n"
    wide = slip(more, "spherical").replace("width = 2\nlength = 2", "width = 6\nlength = 6")
    force = forces(write_scene, wide)
    assert force.shape[0] == 25
    grid = np.indices(force.shape[1:])
    place = np.array([[(g * f).sum() / f.sum() for g in grid] for f in force])
    way = 50 * np.maximum(np.arange(25) * T - 0.01, 0)
    # Taxels enter and leave at the rim one by one, 16 samples a pitch: a fiftieth of a pitch of the centre.
    assert place[:, 1] == pytest.approx(7.5 + way * math.cos(math.radians(30)), abs=0.02)
    assert place[:, 0] == pytest.approx(7.5 + way * math.sin(math.radians(30)), abs=0.02)
    assert (force[:6] == force[0]).all()  # it rests until it starts


@pytest.mark.paper
def test_tapping_is_a_half_sine_in_its_share_of_the_period(write_scene: Write) -> None:
    force = forces(write_scene, tapping("frequency_hz = 25\nduty = 0.4\nduration_s = 0.2\n")).max(axis=(1, 2))
    assert force.size == 100
    period = force.reshape(5, 20)
    # Time in seconds is a product of frames: 1e-16 of 0.2 s is 1e-13 of a period, a sine near its zero.
    assert period == pytest.approx(np.tile(period[0], (5, 1)), abs=1e-6)
    assert period[0, :9] == pytest.approx(10 * np.sin(np.pi * np.arange(9) / 8), abs=1e-9)
    assert not period[:, 9:].any()


@pytest.mark.paper
@pytest.mark.parametrize(
    ("text", "peaks"),
    [
        (slip("speed_pitch_per_s = 0\n", force="force_n = [1, 2, 4]"), [1, 2, 4]),
        (tapping('frequency_hz = 100\nduty = 0.4\nprofile = "square"\nframes = 5\n'), [10, 10, 0, 0, 0]),
        (ramp("force_n = [2, 12]\nframes = 5\n"), [2, 4.5, 7, 9.5, 12]),
        (ramp("force_n = [0, 6, 6, 0]\nduration_s = 0.018\n"), [0, 2, 4, 6, 6, 6, 6, 4, 2, 0]),
        # A duration that is no whole number of frames still ends where it should.
        (ramp("force_n = [0, 5]\nduration_s = 0.005\n"), [0, 2, 4, 5]),
    ],
)
def test_peaks_follow_each_other_as_written(text: str, peaks: list[float], write_scene: Write) -> None:
    assert forces(write_scene, text).max(axis=(1, 2)) == pytest.approx(peaks)


SEVERAL = """
[stimulus]
kind = "several"
[[stimulus.parts]]
kind = "indenter"
shape = "flat"
force_n = 3.0
width = 2
length = 2
[[stimulus.parts]]
kind = "ramp"
shape = "round"
force_n = [0.0, 5.0]
frames = 3
center_row = 3
"""


def test_forces_of_several_bodies_add_and_the_shorter_holds(write_scene: Write) -> None:
    force = forces(write_scene, SEVERAL)
    alone = forces(write_scene, indenter("flat", "width = 2\nlength = 2\n"))[0] * 0.3
    press = forces(write_scene, ramp('shape = "round"\nforce_n = [0.0, 5.0]\nframes = 3\ncenter_row = 3\n'))
    assert force.shape[0] == 3
    for n in range(3):
        assert force[n] == pytest.approx(alone + press[n])


WRONG = [
    (indenter("flat", "total_force_n = 3\n"), "stimulus", "exactly one of force_n, total_force_n"),
    (slip("frames = 3\n"), "stimulus.speed_pitch_per_s", ">= 0"),
    (slip("speed_pitch_per_s = 1\nframes = 9999999\n"), "stimulus.frames", "131072 frames"),
    (slip("speed_pitch_per_s = 1\nframes = 3\nt_frame_s = 1\n"), "stimulus.t_frame_s", "unknown key"),
    (tapping("frequency_hz = 5\n"), "stimulus", "exactly one of frames, duration_s"),
    (ramp("force_n = [3, 4]\nframes = 1\n"), "stimulus.frames", "2..2^25"),
    ('[stimulus]\nkind = "several"\nparts = []\n', "stimulus.parts", "1 to 64 tables"),
    (SEVERAL.replace("width = 2", "widht = 2"), "stimulus.parts.0.widht", "width"),
    (SEVERAL.replace('"ramp"', '"uniform"'), "stimulus.parts.1.kind", "indenter"),
    (SEVERAL.replace("force_n = 3.0", "total_force_n = 3.0\ncenter_row = 99"), "stimulus.parts.0.total_force_n",
     "touches no taxel"),
    (SEVERAL.replace("force_n = 3.0", "force_n = 3.0\nt_frame_s = 1"), "stimulus.parts.1.t_frame_s", "the same"),
    (f'[array]\nrows = 256\ncols = 256\n[stimulus]\nkind = "uniform"\ncode = {[1] * 600}\n', "stimulus.code",
     "at most")
]  # fmt: skip


@pytest.mark.paper
@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("", [0, 4, 12]),
        ("t_frame_s = 0.032\n", [0, 4, 12]),
        ("t_frame_s = 0.008\nresample = 'hold'\n", [0] * 4 + [4] * 4 + [12] * 4),
        ("t_frame_s = 0.008\nresample = 'linear'\n", [0, 1, 2, 3, 4, 6, 8, 10, 12]),
        ("t_frame_s = 0.001\nresample = 'hold'\n", [0, 12]),
    ],
)
def test_a_recording_is_read_at_its_own_rate(more: str, expected: list[float], write_scene: Write) -> None:
    plan = planning.load(write_scene(recorded(more)))
    assert plan.force_n[:, 0, 0] == pytest.approx(expected)
    assert plan.drive.t_frame_s == (0.032 if "0.032" in more else T)
    assert plan.timing.frame_s == T


@pytest.mark.paper
def test_between_frames_conductance_runs_straight_under_every_law(write_scene: Write) -> None:
    text = recorded("t_frame_s = 0.008\nresample = 'linear'\n") + '[sensor]\nlaw = "power"\n'
    g = 1 / planning.load(write_scene(text)).resistance_ohm[:, 0, 0]
    # Codes are whole: they are the recording's own rounding.
    assert np.diff(g[:5]) == pytest.approx([g[4] / 4] * 4, rel=1e-3)
    text = text.replace("force_n = [0, 4, 12]", "r_ohm = [inf, 1000, inf, 0, 500]").replace("0.008", "0.004")
    ohm = planning.load(write_scene(text)).resistance_ohm[:, 0, 0]
    assert ohm.tolist() == [np.inf, 2000, 1000, 2000, np.inf, 0, 0, 0, 500]
    error = complaint(write_scene, recorded("t_frame_s = 0.001\n"))
    assert error.key == "stimulus.t_frame_s"
    assert "0.002 s" in error.allowed


@pytest.mark.paper
@pytest.mark.parametrize("topology", ["direct", "conveyor_mirror", "conveyor_mirror_inverted"])
@pytest.mark.parametrize(("k", "v_bias_v"), [(80, 0.5), (20, 0.3), (160, 1.1)])
def test_a_code_means_the_force_whose_duty_is_c_over_510(
    topology: str, k: int, v_bias_v: float, write_scene: Write
) -> None:
    text = (
        f'[array]\nrows = 1\ncols = 1\n[interface]\ntopology = "{topology}"\nk = {k}\nv_bias_v = {v_bias_v}\n'
        f'[stimulus]\nkind = "uniform"\ncode = {list(range(256))}\n'
    )
    plan = planning.load(write_scene(text))
    # To a resistance and back: a few roundings of 1.1e-16.
    assert plan.duty_ideal()[:, 0, 0] == pytest.approx(np.arange(256) / 510, rel=1e-14, abs=0)
    assert plan.force_n is not None
    # Four products: a few roundings of 1.1e-16.
    assert plan.force_n[255, 0, 0] == pytest.approx(7500 / (2 * v_bias_v / (k * 25e-6)), rel=1e-12)


def test_npy_npz_and_csv_read_the_same(write_scene: Write) -> None:
    codes = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    for name, data, more in (
        ("f.csv", "0,1,2,3,4,5\n6,7,8,9,10,11\n", ""),
        ("f.csv", "\ufeff0,1,2\n3,4,5\n\n6, 7 ,8\r\n9,10,11", ""),
        ("f.npy", npy(np.asfortranarray(codes.astype(">i4"))), ""),
        ("f.npz", npz(codes=codes), ""),
        ("f.npz", npz(other=codes + 1, codes=codes.astype(float)), 'key = "codes"\n'),
    ):
        got = forces(write_scene, frames(file=name, more=more), **{name.replace(".", "__"): data})
        assert got == pytest.approx(15.0 * codes / 255)
    single = forces(write_scene, frames(file="f.npy"), f__npy=npy(codes[1]))
    assert single == pytest.approx(15.0 * codes[1:] / 255)


def test_newtons_scale_and_selection(write_scene: Write) -> None:
    data = "1,2,3,4,5,6\n7,8,9,10,11,12\n0,0,0,0,0,0.5\n"
    for more, picked in (("", [1, 7, 0]), ('select = "first"\n', [1]), ('select = "last"\n', [0]),
                         ("select = [2, 0, 0]\n", [0, 1, 1])):  # fmt: skip
        force = forces(write_scene, frames("newtons", "scale = 0.5\n" + more), frames__csv=data)
        assert force[:, 0, 0] == pytest.approx(0.5 * np.array(picked))


WRONG_CSV = [
    ("", "lines", "at least one line"),
    ("1,2,3,4\n", "line 1", "6 values"),
    ("1,2,3,4,5,6\n1,2,3\n", "line 2", "6 values, as"),
    ("1,2,3\n1,2,3\n4,5,6\n", "lines", "whole frames"),
    ("1,2,3,4,5,nan\n", "frame 0, row 1, column 2", "0..255"),
    ("1,2,3,4,5,6\n1,2,256,4,5,6\n", "frame 1, row 0, column 2", "0..255"),
    ("1,2,3,4,5,1.5\n", "frame 0, row 1, column 2", "whole number"),
    ("1,2,3,4,5,٣\n", "byte 10", "numbers separated by commas"),
    # JSON takes some of these.
    *(
        (f"1,2,3,4,5,{cell}\n", "line 1, value 6", "a number")
        for cell in ("x", "1_0", "6\x00", "true", "[1]")
    ),
]


CODES = np.zeros((2, 2, 3), dtype=np.uint8)
HEADER = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 2, 3), }"
PETABYTE = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(HEADER)) + HEADER + bytes(48)


def _bomb() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("codes.npy", bytes(stimulus.VALUES_MAX * 8 + 5000))
    return stream.getvalue()


WRONG_NUMPY = [
    ("npy", b"\x93NUMPY\x01\x00\xff\xff{", "file", "readable npy"),
    ("npy", npy(CODES).replace(b"False", b"Fals "), "file", "ast.Name object>"),
    ("npy", PETABYTE, "shape", "at most"),
    ("npy", npy(CODES)[:-1], "shape", "no more values than"),
    ("npy", npy(np.array([[print]], dtype=object)), "dtype", "integers or floating"),
    ("npy", npy(CODES.astype(complex)), "dtype", "integers or floating"),
    ("npy", npy(np.zeros((2, 3, 2))), "shape", "[2, 3]"),
    ("npy", npy(np.full((2, 3), np.nan)), "frame 0, row 0, column 0", "0..255"),
    ("npz", b"PK\x03\x04" + bytes(100), "file", "readable npz"),
    ("npz", npz(a=CODES, b=CODES), "key", "a, b"),
    ("npz", "bomb", "codes", "at most"),
]


LAST = "frame 0, row 1, column 2"
WRONG_NUMBER = [
    (frames("newtons"), "1,2,3,4,5,-1e-9", LAST, "newtons"),
    (OHMS, "1,2,3,4,5,-1", LAST, "ohm"),
    (frames("newtons", "scale = 1e300\n"), "1,2,3,4,5,6", "stimulus.scale", "1e+30"),
    (frames(more="select = [0, 2]\n"), "1,2,3,4,5,6", "stimulus.select", "0..0"),
]


@pytest.mark.parametrize(
    ("text", "content", "key", "allowed"),
    [
        *(pytest.param(text, "", *wrong, marks=pytest.mark.paper) for text, *wrong in WRONG),
        *WRONG_NUMBER,
        *((frames(), *wrong) for wrong in WRONG_CSV),
        *((frames(file=f"f.{suffix}"), *wrong) for suffix, *wrong in WRONG_NUMPY),
    ],
)
def test_a_wrong_stimulus_or_file_is_one_line_that_names_the_place(
    text: str, content: str | bytes, key: str, allowed: str, write_scene: Write
) -> None:
    files = dict.fromkeys(("frames__csv", "f__npy", "f__npz"), _bomb() if content == "bomb" else content)
    error = complaint(write_scene, text, **files)
    assert error.key == key, error
    assert allowed in str(error)


def test_codes_are_those_of_the_design() -> None:
    """A chip of 12 bits counts to 4095 in 8190 clocks."""
    fine = design.load().replace(
        timing={"frame_s": 30e-3, "gate_clocks": 8190, "code_bits": 12},
        sensor={"r_max_ohm": 64e3},
    )
    stimulus = {"kind": "uniform", "code": [0, 128, 4094]}
    codes = dermis.simulate({"stimulus": stimulus}, engine="closed", design=fine).codes
    assert [list(np.unique(frame)) for frame in codes] == [[0], [128], [4094]]
    for design_, code, most in ((fine, 4096, 4095), (None, 256, 255)):
        with pytest.raises(InputError, match=f"stimulus.code = {code}: .*0..{most}"):
            dermis.simulate({"stimulus": stimulus | {"code": code}}, engine="closed", design=design_)


@pytest.mark.paper
@pytest.mark.parametrize("effects", ["", "motion = true"])
def test_a_resistance_of_minus_zero_is_a_short(write_scene: Write, effects: str) -> None:
    """1 / -0.0 is -inf: with motion it read 0, without it ended as a defect."""
    text, codes = f"{OHMS}[effects]\n{effects}\n", []
    for file, zero in (("frames.csv", "-0.0"), ("frames.csv", "0"), ("f.npy", "-0.0")):
        table = f"1e3,1e3,1e3,1e3,1e3,{zero}\n{zero},1e3,1e3,1e3,1e3,1e3\n"
        values = np.array([line.split(",") for line in table.split()], dtype=float).reshape(2, 2, 3)
        content = npy(values) if file == "f.npy" else table
        path = write_scene(text.replace("frames.csv", file), **{file.replace(".", "__"): content})
        codes.append(engines.run(planning.load(path)).codes)
    assert (codes[0] == codes[1]).all()
    assert (codes[0] == codes[2]).all()
    assert effects or codes[0][1, 0, 0] == codes[0][0, 1, 2] == 255
