# SPDX-License-Identifier: Apache-2.0
"""Wrong results that were found from outside, each with its small case."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import dermis
from dermis import plan as planning
from dermis.array import array
from dermis.decode.decoder import SATURATED, Forces
from dermis.effects import EFFECTS
from dermis.engines import event, filter
from dermis.errors import InputError
from dermis.scene import scene
from dermis.skin import Skin
from tb.programs.campaign import command, search


def made(data: dict[str, Any], engine: str) -> Any:
    data = {"stimulus": {"kind": "uniform", "force_n": 0.0}} | data
    return planning.make(scene.from_data(data, Path("made.toml")), engine)


def test_auto_starts_a_frame_with_the_current_before_the_gate() -> None:
    onset = {"kind": "uniform", "r_ohm": [42677758.519134, 49752.52597152885]}
    on = {"mirror_lag": True, "column_offset": True, "motion": True}
    plan = made({"array": {"rows": 1, "cols": 1}, "stimulus": onset, "effects": on}, "event")
    assert event.run(plan).codes.ravel().tolist() == [1, 3]
    assert filter.run(plan).codes.ravel().tolist() == [1, 3]


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        ("onset", 39),  # a slow mirror that starts below every current of the gate
        ("pairs", 917),
        ("pairs", 869),  # a duty that is clipped, and a packet that flicker makes larger
    ],
)
def test_scenes_of_the_search_that_were_wrong(kind: str, number: int) -> None:
    assert search.filter_counts(kind, 0, number)["wrong"] == 0


@pytest.mark.parametrize("kind", search.FILTER_KINDS)
def test_search_notices_a_bound_that_is_missing(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("motion", "comparator_hysteresis", "integrator_gain", "comparator_noise"):
        free = replace(EFFECTS[name].bound, factor=0.0)
        monkeypatch.setitem(EFFECTS, name, replace(EFFECTS[name], bound=free))
    assert command.run_scenes(kind, 0, 3, 12)["counts"]["wrong"] > 0


@pytest.mark.parametrize("kind", search.SKIN_KINDS)
def test_skin_and_intervals_over_every_effect(kind: str) -> None:
    counts = command.run_scenes(kind, 1, 0, 12)["counts"]
    assert counts["wrong"] == 0
    # The limit of decode.interval_coverage.
    assert counts["missed"] <= 1e-3 * counts["cells"]
    assert counts["cells"] > 0


def test_skin_carries_a_shared_return() -> None:
    on = {"return": {"r_ohm": 30.0}, "column_input": {"r_ohm": 20.0}, "row_driver": {"r_ohm": 5.0}}
    world = {"array": {"rows": 8, "cols": 8}, "effects": on}
    force = np.random.default_rng(0).uniform(0.0, 8.0, (20, 8, 8))
    skin, codes = Skin(made(world, "closed")), dermis.simulate(world, force_n=force, engine="closed").codes
    assert (skin.read(force) == codes).all()
    found = skin.decode(codes)
    kept = found.flags == 0
    assert ((found.low_n <= force) & (force <= found.high_n))[kept].mean() >= 0.999


def test_skin_takes_the_direct_solve_where_sweeps_do_not_converge() -> None:
    on = {"column_input": {"r_ohm": 1e3}, "lateral": {"r_ohm": 1.0}}
    world = {"array": {"rows": 8, "cols": 8}, "effects": on}
    force = np.random.default_rng(0).uniform(0.0, 8.0, (20, 8, 8))
    skin = Skin(made(world, "closed"))
    assert (skin.read(force) == dermis.simulate(world, force_n=force, engine="closed").codes).all()


def test_a_full_cell_that_starts_late_is_saturated() -> None:
    on = {"comparator_offset": {"v_v": 0.3}, "preset_error": {"v_v": -0.2}}
    on |= {"charge_packet": {"packet_error": -0.05}}
    skin = Skin(made({"effects": on}, "closed"))
    force = np.linspace(12.0, 20.0, 256).reshape(1, 16, 16)
    codes = skin.read(force)
    ohm = skin.plan.sensor.resistance_ohm(force)
    assert (codes == dermis.simulate({"effects": on}, resistance_ohm=ohm, engine="closed").codes).all()
    found = skin.decode(codes)
    assert (codes == 254).any()
    assert (found.flags[codes >= 254] & SATURATED).all()
    # A force on the edge between two codes is off by the roundings of the law.
    assert ((found.low_n <= force * (1 + 1e-12)) & (force * (1 - 1e-12) <= found.high_n)).all()


@pytest.mark.parametrize(
    "out",
    [
        np.empty((1, 16, 16), np.uint8),
        np.empty((20, 16, 16), np.int8),
        np.empty((20, 16, 32), np.uint8)[:, :, ::2],
        np.broadcast_to(np.uint8(0), (20, 16, 16)),
        [0],
    ],
)
def test_an_array_to_fill_must_fit(out: Any) -> None:
    skin, force = Skin("single_touch"), np.full((20, 16, 16), 3.0)
    said = r"out must be a writable, contiguous uint8 array of shape \[20, 16, 16\]"
    with pytest.raises(ValueError, match=said):
        skin.read(force, out=out)
    forces = Forces(*(np.empty((20, 16, 16)) for _ in range(3)), out)
    with pytest.raises(ValueError, match=r"out\.flags must be"):
        skin.decode(np.zeros((20, 16, 16), np.uint8), out=forces)


@pytest.mark.parametrize("time", [np.nan, -1.0, np.inf, [0.01, np.nan], [0.01, 0.01, 0.01]])
def test_times_of_a_stream_are_checked_before_its_state_changes(time: Any) -> None:
    skin = Skin(made({"effects": {"sensor_creep": True}}, "closed"))
    force = np.full((2, 16, 16), 3.0)
    before = skin.read(force)
    with pytest.raises(ValueError, match="t_frame_s"):
        skin.read(force, t_frame_s=time)
    with pytest.raises(ValueError, match="t_frame_s"):
        skin.decode(before, t_frame_s=time)
    assert (skin.read(force) > 0).all()


def test_a_start_above_the_level_leaves_a_negative_current_open() -> None:
    on = {"comparator_offset": {"v_v": -0.6}, "offset_current": {"i_a": -2e-7}}
    skin = Skin(made({"array": {"rows": 1, "cols": 1}, "effects": on}, "closed"))
    force = np.array([0.0, 0.02, 0.1, 0.2, 0.5, 2.0]).reshape(-1, 1, 1)
    codes = skin.read(force)
    assert codes[0] == 1
    found = skin.decode(codes)
    assert ((found.low_n <= force) & (force <= found.high_n)).all()
    assert found.high_n[0] < 0.35


def test_skin_reads_a_taxel_below_a_milliohm_as_simulate_does() -> None:
    world = {"array": {"rows": 1, "cols": 2}, "effects": {"row_driver": {"r_ohm": 7.5e-4}}}
    skin = Skin(made(world, "closed"))
    for force in ([[1e7, 2.0]], [[1e300, 2.0]], [[3.0, 2.0]]):
        assert (skin.read(force) == dermis.simulate(world, force_n=force, engine="closed").codes[0]).all()


MASKED = np.ma.masked_less([[1.0, 2.0]], 1.5)


@pytest.mark.parametrize("forces", [MASKED, [[True, False]], [["1", "2"]], [[1.0 + 1j, 2.0]]])
def test_forces_that_are_no_real_numbers_are_refused(forces: Any) -> None:
    world = {"array": {"rows": 1, "cols": 2}}
    with pytest.raises(ValueError, match="forces_n"):
        Skin(made(world, "closed")).read(forces)
    with pytest.raises(InputError):
        dermis.simulate(world, force_n=forces)


def test_the_array_solve_uses_one_blas_thread() -> None:
    with array._one_thread(128):
        assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {1}


def test_keys_of_a_stimulus_count_beside_an_array() -> None:
    force = np.random.default_rng(0).uniform(0.0, 8.0, (6, 4, 4))
    world = {"effects": {"sensor_creep": True}, "stimulus": {"t_frame_s": 0.008}}
    codes = dermis.simulate(world, force_n=force).codes
    other = dermis.simulate({"effects": world["effects"]}, force_n=force, stimulus={"t_frame_s": 0.008}).codes
    assert (codes == other).all()
    assert (codes != dermis.simulate({"effects": world["effects"]}, force_n=force).codes).any()
