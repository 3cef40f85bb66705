# SPDX-License-Identifier: Apache-2.0
"""Many sheets in one call: each is the plain skin of its seed, bit by bit, with its own memory, draws and resets."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import dermis
from dermis.decode.memory import MemoryLaw, SheetMemory
from dermis.decode.sheets import PULSES, Sheets, apply_sheet
from dermis.errors import InputError
from dermis.skin import Skin

SIZE = {"array": {"rows": 5, "cols": 7}}
WORN = {"sensor_hysteresis": True, "sensor_creep": True, "sensor_spread": True, "row_driver": True}
WORLDS: dict[str, dict[str, Any]] = {
    "droop": {"row_driver": {"r_ohm": 9.0}, "column_offset": {"v_v": -1e-3}, "sensor_spread": True},
    "worn": WORN,
    "worn, inputs": WORN | {"column_input": {"r_ohm": 20.0}, "lateral": True},
    "worn, traces": WORN | {"trace": {"r_row_ohm": 0.5, "r_column_ohm": 0.5}},
}
ENVS = 3


def touches(frames: int, *shape: int, seed: int = 1) -> np.ndarray:
    """Forces that come and go, [frames, *shape]."""
    rng = np.random.default_rng(seed)
    rise = np.abs(np.sin(np.linspace(0, 9, frames)))[(...,) + (None,) * len(shape)]
    return rise * rng.uniform(0, 14, shape) * (rng.random((frames, *shape)) < 0.9)


@pytest.mark.parametrize("world", WORLDS)
def test_every_sheet_is_the_plain_skin_of_its_seed(world: str) -> None:
    made = {"effects": WORLDS[world], **SIZE}
    many = Skin(made, envs=ENVS, seed=11)
    force = touches(30, ENVS, 5, 7)
    codes = np.concatenate([many.read(force[:20]), many.read(force[20], 0.05)[None]])
    plain = [Skin(made, seed=np.int64(11 + e)) for e in range(ENVS)]
    assert len(np.unique(codes)) > 50
    for e, one in enumerate(plain):
        assert np.array_equal(one.read(force[:20, e]), codes[:20, e])
        assert np.array_equal(one.read(force[20, e], 0.05), codes[20, e])
    many.reset([1, 1])  # once
    plain[1] = Skin(made, seed=11 + 1 + ENVS)
    again = many.read(force[21:].astype(np.float32))
    for e, one in enumerate(plain):
        assert np.array_equal(one.read(force[21:, e].astype(np.float32)), again[:, e])


def test_decoding_is_that_of_one_sheet_after_another() -> None:
    made = {"effects": WORN, **SIZE}
    many, force = Skin(made, envs=ENVS), touches(12, ENVS, 5, 7)
    one = Skin(made, calibration=many.decoder.calibration)
    codes = many.read(force, 0.01)
    found = many.decode(codes, 0.01)
    for e in range(ENVS):
        one.reset()
        alone = one.decode(codes[:, e], 0.01)
        for name in ("force_n", "low_n", "high_n"):
            assert np.array_equal(getattr(alone, name), getattr(found, name)[:, e])
    many.reset(np.array([False, True, False]))
    assert np.array_equal(many.decode(codes[0], 0.01).high_n[1], found.high_n[0, 1])
    # The spread of the sheets is not known one by one: it is in the intervals.
    inside = (found.low_n <= force * (1 + 1e-9)) & (force <= found.high_n * (1 + 1e-9))
    assert inside.mean() > 0.999


def test_copies_and_pickles_go_on_with_a_state_of_their_own() -> None:
    skin, force = Skin({"effects": WORN, **SIZE}, envs=ENVS, stuck=0.1, threads=2), touches(9, ENVS, 5, 7)
    skin.decode(skin.read(force[:4]))
    others = [pickle.loads(pickle.dumps(skin)), copy.deepcopy(skin), copy.copy(skin)]
    codes = skin.read(force[4:])
    found = skin.decode(codes)
    for other in others:
        assert np.array_equal(other.read(force[4:]), codes)
        assert np.array_equal(other.decode(codes).high_n, found.high_n)


def test_dead_and_stuck_taxels_are_drawn_at_a_reset() -> None:
    skin = Skin(SIZE, envs=200, dead=0.1, stuck=0.2)
    full, none = np.full((200, 5, 7), 12.0), np.zeros((200, 5, 7))
    pressed, idle = skin.read(full), skin.read(none)
    assert ((pressed == 0) | (pressed != idle) | (idle > 0)).all()
    # Binomial shares of 7000: five standard deviations.
    assert (pressed == 0).mean() == pytest.approx(0.1, abs=0.02)
    assert (idle > 0).mean() == pytest.approx(0.2, abs=0.025)
    assert (pressed[idle > 0] == idle[idle > 0]).all()
    skin.reset(np.arange(100))
    after = skin.read(full)
    assert np.array_equal(after[100:], pressed[100:])
    assert (after[:100] != pressed[:100]).any(axis=(1, 2)).mean() > 0.9


def test_a_skin_is_made_of_tables_and_keywords() -> None:
    force = touches(3, 16, 16)
    effects = {"row_driver": {"r_ohm": np.float64(5.0)}}
    result = dermis.simulate("single_touch", force_n=force, effects=effects, engine="closed")
    assert np.array_equal(Skin("single_touch", effects=effects).read(force), result.codes)
    assert np.array_equal(Skin({"effects": effects}).read(force), Skin(effects=effects).read(force))


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda s: s.read(np.zeros((4, 5, 7))), r"forces_n must be \[3, 5, 7\] or \[frames, 3, 5, 7\]"),
        (lambda s: s.read(np.zeros((5, 7))), "forces_n must be"),
        (lambda s: s.read(np.full((3, 5, 7), np.nan, np.float32)), "finite"),
        (lambda s: s.read(np.full((3, 5, 7), np.inf)), "finite"),
        (lambda s: s.read(np.full((3, 5, 7), -1.0)), "0 or above"),
        (lambda s: s.read(np.zeros((3, 5, 7)), out=np.zeros((3, 5, 7))), "out must be"),
        (lambda s: s.read(np.zeros((3, 5, 7)), [1.0, 2.0]), r"t_frame_s must be .*\[3\]"),
        (lambda s: s.read(np.zeros((3, 5, 7)), -1.0), "backwards"),
        (lambda s: s.decode(np.zeros((3, 7, 5), int)), "codes must be"),
        (lambda s: s.decode(np.zeros((3, 5, 7))), "codes must be integers"),
        (lambda s: s.reset([3]), "which must be"),
        (lambda s: s.reset([-1]), "which must be"),
        (lambda s: s.reset([0.5]), "which must be"),
        (lambda s: s.reset([0, 1, 1]), "a mask of bool"),
        (lambda s: s.reset(np.array([1, 0, 0], np.uint8)), "a mask of bool"),
        (lambda s: s.reset(np.ones(4, bool)), "which must be"),
    ],
)
def test_wrong_arrays_are_refused(call: Any, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        call(Skin(SIZE, envs=3))


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"envs": 0}, "envs"),
        ({"envs": 2.0}, "envs"),
        ({"dead": 0.7, "stuck": 0.6}, "dead, stuck"),
        ({"effects": {"no_such": True}}, "effects.no_such"),
        ({"envs": 2, "effects": {"mirror_ratio": {"spread": 0.01}}}, "mirror_ratio.spread"),
        ({"effects": {"row_driver": None}}, "effects.row_driver"),
        ({"calibration": "no_such.toml"}, "no_such.toml"),
        ({"scene": 5}, "scene"),
        ({"colour": 1}, "colour"),
        ({"scene": Skin(SIZE).plan, "seed": 3}, "scene"),
    ],
)
def test_wrong_skins_are_refused_by_name(given: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError, match=key):
        Skin(**given)


@pytest.mark.parametrize(("frames", "loads", "error"), [(400, PULSES - 1, 1e-10), (3000, 300, 1e-3)])
def test_the_short_state_of_a_sheet_follows_the_sum_over_rates(frames: int, loads: int, error: float) -> None:
    """Exact up to PULSES loads of a taxel; loads that were merged move a conductance by far less than half a code."""
    law = MemoryLaw.of_effects(0.1, 0.05, 10e-3)
    rng = np.random.default_rng(3)
    edges = np.sort(rng.integers(1, frames, (2 * loads, 40)), axis=0)
    on = (np.searchsorted(edges[:, 0], np.arange(frames), side="right")[:, None] + np.arange(40)) % 2
    g = np.where(on, 1e-3 * (1 + 0.5 * np.sin(np.arange(frames) / 7))[:, None], 0.0)
    dt = rng.uniform(1e-3, 1e-1, frames)
    stream, sheets = SheetMemory(law, 40), Sheets(law, 2, 40)
    worst = 0.0
    for frame, dt_s in zip(g, dt, strict=True):
        reference, mine = stream.apply(frame, dt_s), frame.copy()
        apply_sheet(mine, sheets.arrays(), sheets.law, 1, dt_s)
        off = mine / np.where(reference > 0, reference, 1) - (reference > 0)
        worst = max(worst, float(np.abs(off).max()))
    assert worst < error
