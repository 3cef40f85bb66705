# SPDX-License-Identifier: Apache-2.0
"""Stimuli: the profiles they promise, the files they read, and what is said about files that are wrong."""

from __future__ import annotations

import io
import math
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dermis import plan as planning
from dermis import stimulus
from dermis.errors import InputError
from dermis.sensor import InverseSensor

Write = Callable[..., Path]


def forces(write_scene: Write, text: str, **files: str | bytes) -> NDArray[np.float64]:
    force = planning.load(write_scene(text, **files)).force_n
    assert force is not None
    return force


def indenter(shape: str, more: str = "") -> str:
    return f'[stimulus]\nkind = "indenter"\nshape = "{shape}"\nforce_n = 10.0\n{more}'


def frames(
    unit: str = "codes", more: str = "", file: str = "frames.csv", rows: int = 2, cols: int = 3
) -> str:
    return (
        f'[array]\nrows = {rows}\ncols = {cols}\n[stimulus]\nkind = "frames"\nfile = "{file}"\n'
        f'unit = "{unit}"\n{more}'
    )


def ohms(file: str = "r.csv", rows: int = 2, cols: int = 3) -> str:
    return f'[array]\nrows = {rows}\ncols = {cols}\n[stimulus]\nkind = "resistance"\nfile = "{file}"\n'


def npy(array: NDArray[np.generic]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(**arrays: NDArray[np.generic]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def complaint(write_scene: Write, text: str, **files: str | bytes) -> InputError:
    with pytest.raises(InputError) as caught:
        planning.load(write_scene(text, **files))
    assert "\n" not in str(caught.value)
    return caught.value


def test_flat_presses_evenly_inside_and_not_outside(write_scene: Write) -> None:
    force = forces(write_scene, indenter("flat", "width = 8\nlength = 4\n"))[0]
    assert (force[6:10, 4:12] == 10.0).all()
    assert force.sum() == 10.0 * 32


def test_triangular_is_a_straight_ridge(write_scene: Write) -> None:
    more = "width = 8\nlength = 3\ncenter_row = 7\ncenter_col = 8\n"
    force = forces(write_scene, indenter("triangular", more))[0]
    assert force[7, 4:13] == pytest.approx([0, 2.5, 5, 7.5, 10, 7.5, 5, 2.5, 0])
    assert (force[6:9] == force[7]).all()
    assert not force[5].any()


def test_cylindrical_is_the_half_ellipse_of_hertz(write_scene: Write) -> None:
    more = "width = 10\nlength = 1\ncenter_row = 3\ncenter_col = 8\n"
    force = forces(write_scene, indenter("cylindrical", more))[0]
    expected = [10 * math.sqrt(1 - (u / 5) ** 2) for u in range(-5, 6)]
    assert force[3, 3:14] == pytest.approx(expected)
    # the load of a half ellipse is pi/4 of its box
    fine = forces(
        write_scene, "[array]\nrows = 1\ncols = 256\n" + indenter("cylindrical", "width = 250\nlength = 1\n")
    )
    assert fine.sum() / (10 * 250) == pytest.approx(math.pi / 4, rel=1e-3)


@pytest.mark.parametrize("shape", ["flat", "triangular", "cylindrical"])
def test_a_right_angle_turns_rows_into_columns_exactly(shape: str, write_scene: Write) -> None:
    straight = forces(write_scene, indenter(shape, "width = 8\nlength = 4\n"))[0]
    turned = forces(write_scene, indenter(shape, "width = 8\nlength = 4\nangle_deg = 90\n"))[0]
    assert turned == pytest.approx(straight.T, abs=1e-6)
    assert (turned > 0).sum() == (straight > 0).sum()


def test_an_angle_turns_the_width_towards_rising_rows(write_scene: Write) -> None:
    force = forces(write_scene, indenter("flat", "width = 8\nlength = 1.2\nangle_deg = 45\n"))[0]
    # 8 pitches across the diagonal reach 2.8 rows and columns to either side of (7.5, 7.5)
    assert np.argwhere(force).tolist() == [[i, i] for i in range(5, 11)]


def test_a_list_of_forces_makes_one_frame_each(write_scene: Write) -> None:
    text = '[stimulus]\nkind = "indenter"\nshape = "flat"\nforce_n = [0, 5, 15]\n'
    assert forces(write_scene, text).max(axis=(1, 2)) == pytest.approx([0, 5, 15])


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
    assert plan.duty_ideal()[:, 0, 0] == pytest.approx(np.arange(256) / 510, rel=1e-14, abs=0)
    assert plan.force_n is not None
    assert plan.force_n[255, 0, 0] == pytest.approx(7500 / (2 * v_bias_v / (k * 25e-6)), rel=1e-12)


def test_uniform_resistance_takes_shorts_and_opens(write_scene: Write) -> None:
    plan = planning.load(write_scene('[stimulus]\nkind = "uniform"\nr_ohm = [0, 500, inf]\n'))
    assert plan.resistance_ohm[:, 0, 0].tolist() == [0, 500, np.inf]
    assert plan.force_n is not None
    assert plan.force_n[:, 3, 3].tolist() == [np.inf, 15.0, 0]


def test_force_is_k_over_r_with_its_limits() -> None:
    sensor = InverseSensor(7500.0)
    assert sensor.resistance_ohm([15.0, 0.0, -0.0, np.inf, 1e-320]).tolist() == [
        500.0,
        np.inf,
        np.inf,
        0.0,
        np.inf,
    ]
    assert sensor.force_n([500.0, np.inf, 0.0, -0.0]).tolist() == [15.0, 0.0, np.inf, np.inf]


def test_csv_with_a_frame_a_line_and_with_a_row_a_line_read_the_same(write_scene: Write) -> None:
    a = forces(write_scene, frames(), frames__csv="0,1,2,3,4,255\n6,7,8,9,10,11\n")
    b = forces(write_scene, frames(), frames__csv="0,1,2\n3,4,255\n\n6, 7 ,8\r\n9,10,11")
    assert a.shape == (2, 2, 3)
    assert (a == b).all()
    assert a[0].ravel() == pytest.approx(15.0 * np.array([0, 1, 2, 3, 4, 255]) / 255)


def test_npy_npz_and_csv_read_the_same(write_scene: Write) -> None:
    codes = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    csv = forces(write_scene, frames(), frames__csv="0,1,2,3,4,5\n6,7,8,9,10,11\n")
    for name, data, more in (
        ("f.npy", npy(codes), ""),
        ("f.npy", npy(np.asfortranarray(codes.astype(">i4"))), ""),
        ("f.npz", npz(codes=codes), ""),
        ("f.npz", npz(other=codes + 1, codes=codes.astype(float)), 'key = "codes"\n'),
    ):
        got = forces(write_scene, frames(file=name, more=more), **{name.replace(".", "__"): data})
        assert (got == csv).all()
    single = forces(write_scene, frames(file="f.npy"), f__npy=npy(codes[1]))
    assert (single == csv[1:]).all()


def test_newtons_scale_and_selection(write_scene: Write) -> None:
    data = "1,2,3,4,5,6\n7,8,9,10,11,12\n0,0,0,0,0,0.5\n"
    for more, picked in (("", [1, 7, 0]), ('select = "first"\n', [1]), ('select = "last"\n', [0]),
                         ("select = [2, 0, 0]\n", [0, 1, 1])):  # fmt: skip
        force = forces(write_scene, frames("newtons", "scale = 0.5\n" + more), frames__csv=data)
        assert force[:, 0, 0] == pytest.approx(0.5 * np.array(picked))


def test_resistance_frames_are_taken_as_they_are(write_scene: Write) -> None:
    plan = planning.load(write_scene(ohms(), r__csv="0,inf,500\n1e3,1e9,0.5\n"))
    assert plan.resistance_ohm[0].ravel().tolist() == [0, np.inf, 500, 1e3, 1e9, 0.5]


def test_real_frames_read_one_a_line(gait_csv: Path, tmp_path: Path) -> None:
    path = tmp_path / "gait.toml"
    path.write_text(f'[stimulus]\nkind = "frames"\nfile = "{gait_csv}"\nunit = "codes"\n')
    plan = planning.load(path)
    lines = gait_csv.read_text().splitlines()
    assert plan.frames == len(lines)
    first = np.array(lines[0].split(","), dtype=float).reshape(16, 16)
    assert plan.duty_ideal()[0] == pytest.approx(first / 510, rel=1e-14, abs=0)


WRONG_CSV = [
    ("", "lines", "at least one line"),
    ("\n\n", "lines", "at least one line"),
    ("1,2,3,4\n", "line 1", "6 values"),
    ("1,2,3,4,5,6\n1,2,3\n", "line 2", "6 values, as"),
    ("1,2,3\n1,2,3\n4,5,6\n", "lines", "whole frames"),
    ("1,2,3,4,5,x\n", "line 1, value 6", "a number"),
    ("1,2,3,4,5,\n", "line 1, value 6", "a number"),
    ("1,2,3,4,5,1_0\n", "line 1, value 6", "a number"),
    ("1;2;3;4;5;6\n", "line 1", "6 values"),
    ("1,2,3,4,5,nan\n", "frame 0, row 1, column 2", "0..255"),
    ("1,2,3,4,5,inf\n", "frame 0, row 1, column 2", "0..255"),
    ("1,2,3,4,-1,6\n", "frame 0, row 1, column 1", "0..255"),
    ("1,2,3,4,5,6\n1,2,256,4,5,6\n", "frame 1, row 0, column 2", "0..255"),
    ("1,2,3,4,5,1.5\n", "frame 0, row 1, column 2", "whole number"),
    ("1,2,3,4,5,6\x00\n", "line 1, value 6", "a number"),
    ("1,2,3,4,5,٣\n", "byte 10", "numbers separated by commas"),
    ("a,b,c,d,e,f\n1,2,3,4,5,6\n", "line 1, value 1", "a number"),
    ("1,2,3,4,5,.control\n", "line 1, value 6", "a number"),
]


@pytest.mark.parametrize(("text", "key", "allowed"), WRONG_CSV)
def test_a_wrong_csv_is_one_line_that_names_the_place(
    text: str, key: str, allowed: str, write_scene: Write
) -> None:
    error = complaint(write_scene, frames(), frames__csv=text)
    assert (error.file, error.key) == ("frames.csv", key)
    assert allowed in error.allowed


def test_newtons_and_ohms_have_their_own_limits(write_scene: Write) -> None:
    assert "newtons" in complaint(write_scene, frames("newtons"), frames__csv="1,2,3,4,5,inf").allowed
    assert "newtons" in complaint(write_scene, frames("newtons"), frames__csv="1,2,3,4,5,-1e-9").allowed
    assert "ohm" in complaint(write_scene, ohms(), r__csv="1,2,3,4,5,-1").allowed
    assert "ohm" in complaint(write_scene, ohms(), r__csv="1,2,3,4,5,nan").allowed
    over = complaint(write_scene, frames("newtons", "scale = 1e300\n"), frames__csv="1,2,3,4,5,1e300")
    assert over.key == "stimulus.scale"


CODES = np.zeros((2, 2, 3), dtype=np.uint8)


def _claims_a_petabyte() -> bytes:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 2, 3), }"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(48)


def _claims_more_than_it_has() -> bytes:
    return npy(CODES)[:-1]


def _bomb() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("codes.npy", bytes(stimulus.VALUES_MAX * 8 + 5000))
    return stream.getvalue()


def _pickled() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([[print]], dtype=object), allow_pickle=True)
    return stream.getvalue()


WRONG_NUMPY = [
    ("npy", b"", "file", "readable npy"),
    ("npy", b"\x93NUMPY\x01\x00\xff\xff{", "file", "readable npy"),
    ("npy", b"not numpy at all" * 10, "file", "readable npy"),
    ("npy", _claims_a_petabyte(), "shape", "at most"),
    ("npy", _claims_more_than_it_has(), "shape", "as many values"),
    ("npy", _pickled(), "dtype", "integers or floating"),
    ("npy", npy(CODES.astype(complex)), "dtype", "integers or floating"),
    ("npy", npy(CODES.astype(bool)), "dtype", "integers or floating"),
    ("npy", npy(CODES.astype("U3")), "dtype", "integers or floating"),
    ("npy", npy(np.zeros((2, 3, 2))), "shape", "[2, 3]"),
    ("npy", npy(np.zeros((0, 2, 3))), "shape", "[2, 3]"),
    ("npy", npy(np.zeros(6)), "shape", "[2, 3]"),
    ("npy", npy(np.full((2, 3), np.nan)), "frame 0, row 0, column 0", "0..255"),
    ("npz", b"PK\x03\x04" + bytes(100), "file", "readable npz"),
    ("npz", npz(a=CODES, b=CODES), "key", "a, b"),
    ("npz", _bomb(), "codes", "at most"),
]


@pytest.mark.parametrize(("suffix", "data", "key", "allowed"), WRONG_NUMPY)
def test_a_wrong_array_file_is_one_line(
    suffix: str, data: bytes, key: str, allowed: str, write_scene: Write
) -> None:
    error = complaint(write_scene, frames(file=f"f.{suffix}"), **{f"f__{suffix}": data})
    assert error.key == key
    assert allowed in error.allowed


def test_a_key_that_is_not_in_the_npz_is_named(write_scene: Write) -> None:
    error = complaint(write_scene, frames(file="f.npz", more='key = "x"\n'), f__npz=npz(codes=CODES))
    assert (error.key, error.value) == ("key", '"x"')


def test_truncated_and_flipped_array_files_never_escape(write_scene: Write) -> None:
    rng = np.random.default_rng(0)
    for suffix, whole in (("npy", npy(CODES)), ("npz", npz(codes=CODES))):
        for _ in range(150):
            data = bytearray(whole)
            for at in rng.integers(0, len(data), rng.integers(1, 4)):
                data[at] = rng.integers(0, 256)
            if rng.random() < 0.3:
                data = data[: rng.integers(0, len(data))]
            path = write_scene(frames(file=f"f.{suffix}"), **{f"f__{suffix}": bytes(data)})
            try:
                assert planning.load(path).resistance_ohm.shape[1:] == (2, 3)
            except InputError as error:
                text = str(error)
            else:
                text = ""
            assert "\n" not in text


def test_a_selection_beyond_the_file_is_refused(write_scene: Write) -> None:
    error = complaint(write_scene, frames(more="select = [0, 2]\n"), frames__csv="1,2,3,4,5,6\n1,2,3,4,5,6\n")
    assert (error.key, error.value) == ("stimulus.select", 2)
    assert "0..1" in error.allowed


def test_files_that_are_no_files_are_refused(write_scene: Write, tmp_path: Path) -> None:
    (tmp_path / "frames.csv").mkdir()
    assert "regular file" in complaint(write_scene, frames()).allowed
    (tmp_path / "huge.csv").touch()
    with open(tmp_path / "huge.csv", "r+b") as stream:
        stream.truncate(stimulus.FILE_BYTES_MAX + 1)
    assert "at most" in complaint(write_scene, frames(file="huge.csv")).allowed


def test_too_many_values_are_refused_before_they_are_made(write_scene: Write) -> None:
    many = ", ".join(["1"] * 600)
    error = complaint(
        write_scene, f'[array]\nrows = 256\ncols = 256\n[stimulus]\nkind = "uniform"\ncode = [{many}]\n'
    )
    assert error.key == "stimulus.code"
    assert "at most" in error.allowed
