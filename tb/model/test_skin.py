# SPDX-License-Identifier: Apache-2.0
"""The sensor layer: code by code what engine closed reads, in any batch, thread and order of calls."""

import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import dermis
from dermis.decode.decoder import Forces
from dermis.errors import InputError
from dermis.skin import Skin

# Every effect alone and among others: test_edges.py.
WORLDS: dict[str, dict[str, Any]] = {
    "ideal": {},
    "crosstalk": {
        "effects": {
            "row_driver": {"r_ohm": 25.0}, "column_input": {"r_ohm": 10.0}, "lateral": True,
            "column_offset": {"v_v": -1e-3}, "mirror_ratio": {"ratio_error": 0.01, "spread": 0.02},
        },
    },
    "worn": {
        "sensor": {"law": "power"},
        "effects": {
            "sensor_hysteresis": True, "sensor_creep": True, "sensor_temperature": True, "column_input": True,
        },
    },
    "worn on ideal columns": {
        "sensor": {"law": "power"},
        "effects": {"sensor_hysteresis": True, "sensor_creep": True, "row_driver": True},
    },
    "another size": {"array": {"rows": 5, "cols": 9}, "effects": {"row_driver": True, "column_input": True}},
}  # fmt: skip


def world(name: str) -> tuple[Skin, np.ndarray, np.ndarray]:
    """A skin, forces [frames, rows, cols] and the codes that engine closed reads of them."""
    table, rng = {"array": {"rows": 16, "cols": 16}, **WORLDS[name]}, np.random.default_rng(7)
    shape = (40, table["array"]["rows"], table["array"]["cols"])
    forces = rng.uniform(0, 18, shape) * (rng.random(shape) < 0.5)
    if name.startswith("worn"):  # a sheet that remembers is pressed and let go over several frames
        forces = np.abs(np.sin(np.linspace(0, 6, 40)))[:, None, None] * forces[:1]
    result = dermis.simulate(table, force_n=forces, engine="closed")
    return Skin(result.plan), forces, result.codes


@pytest.mark.parametrize("name", WORLDS)
def test_codes_are_those_of_engine_closed_and_forces_come_back(name: str) -> None:
    skin, forces, codes = world(name)
    # Two ways to round a duty may differ where it lies on a threshold to 1e-12: none of 10 000 random ones.
    assert (skin.read(forces) == codes).all()
    assert len(np.unique(codes)) > 50
    skin.reset()
    assert (np.array([skin.read(frame) for frame in forces]) == codes).all()
    whole = skin.decode(codes)
    # Forces on the edge of an interval round by some 1e-15 either way.
    inside = (whole.low_n <= forces * (1 + 1e-9)) & (forces <= whole.high_n * (1 + 1e-9))
    assert inside.mean() >= 0.999
    skin.reset()
    assert np.array_equal(np.array([skin.decode(frame).high_n for frame in codes]), whole.high_n)


def test_threads_and_batches_change_nothing() -> None:
    skin, forces, codes = world("crosstalk")
    many = Skin(skin.plan, threads=3)
    # Arrays of the caller are filled.
    out, places = np.empty(forces.shape, codes.dtype), Forces.empty(forces.shape)
    for one in (skin, many):
        assert one.read(forces, out=out) is out
        assert (out == codes).all()
        assert one.decode(codes, out=places) is places
        assert np.array_equal(places.force_n, skin.decode(codes).force_n)
    with ThreadPoolExecutor(4) as pool:
        read = list(pool.map(skin.read, forces))
        back = list(pool.map(lambda frame: skin.decode(frame).force_n, codes))
    assert (np.array(read) == codes).all()
    assert np.array_equal(np.array(back), skin.decode(codes).force_n)


@pytest.mark.paper
def test_a_scene_by_name_and_what_it_cannot_do() -> None:
    assert Skin("single_touch").read(np.zeros((16, 16))).shape == (16, 16)
    with pytest.raises(InputError, match="not possible with engine closed"):
        Skin("noisy_channel")
    with pytest.raises(InputError, match="calibration"):
        Skin("single_touch", calibration=world("another size")[0].decoder.calibration)


def test_frames_allocate_nothing() -> None:
    """On ideal columns a thousand calls with `out` keep no memory, and a batch needs none of the size of its frames."""
    skin, force, codes = world("worn on ideal columns")
    forces = np.ascontiguousarray(np.resize(force, (1000, *force.shape[1:])))
    out = np.empty(forces.shape, codes.dtype)
    places, single = Forces.empty(forces.shape), Forces.empty(force.shape[1:])

    def calls() -> None:
        for n in range(1000):
            skin.read(forces[n], 1e-3, out=out[n])
            skin.decode(out[n], 1e-3, out=single)

    def batch() -> None:
        skin.read(forces, 1e-3, out=out)
        skin.decode(out, 1e-3, out=places)

    for work in (calls, batch):
        work()  # compiles, and makes the scratch arrays of this thread
        tracemalloc.start()
        try:
            before = tracemalloc.get_traced_memory()[0]
            work()
            after, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        # Python keeps up to 2000 freed tuples of a size, 72 bytes each. One frame of doubles has 2 kB, 1000 have 2 MB.
        assert after - before < 200_000, work.__name__
        assert peak - before < 200_000, work.__name__
