# SPDX-License-Identifier: Apache-2.0
"""Each entry of the registry: off it leaves no trace, its example acts, alone and among all others, and every engine
takes it as the codes of engine event have it or refuses it by name.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_plans import made

from dermis import engines, records
from dermis.effects import EFFECTS
from dermis.engines import closed, event
from dermis.errors import InputError
from dermis.scene.design import TOPOLOGIES, load

OHM = 510 * 60 ** np.random.default_rng(5).random((3, 3, 4))


def examples(topology: str, *names: str) -> dict[str, Any]:
    return {name: EFFECTS[name].example(topology) for name in names if topology in EFFECTS[name].topologies}


def at_thresholds() -> np.ndarray:
    """Duties a millionth of a packet below that of the next code: any noise moves some of them."""
    codes = np.random.default_rng(6).integers(1, 255, OHM.shape)
    design = load()
    unit_ohm = design.interface.v_bias_v / (design.interface.k * design.converter.i0_a)
    return unit_ohm * design.timing.gate_clocks / (codes - 0.5 - 1e-6)


@pytest.mark.paper
@pytest.mark.parametrize("name", EFFECTS)
def test_an_example_moves_a_code(name: str, tmp_path: Path) -> None:
    effect = EFFECTS[name]
    ohm = at_thresholds() if effect.random else OHM
    without = event.run(made(tmp_path, ohm, {**effect.needs})).codes.astype(int)
    got = event.run(made(tmp_path, ohm, {**effect.needs, name: effect.example()})).codes
    if np.abs(got - without).max() < 1:
        # What is left out as long as it has no effect: a thousand times as strong it is refused.
        strong = {key: 1e3 * value for key, value in effect.example().items()}
        with pytest.raises(InputError, match=f"effects.{name}.*engine cosim"):
            event.run(made(tmp_path, ohm, {**effect.needs, name: strong}))


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_sets_its_own_fields_and_off_it_leaves_no_trace(name: str, tmp_path: Path) -> None:
    effect = EFFECTS[name]
    plan = made(tmp_path, OHM, {name: effect.example()}, effect.topologies[-1])
    assert list(plan.on) == [name]
    active = plan.active_fields()
    assert all(plan.effects_of_field(field) == (name,) for field in active)
    assert active <= event.HONOURS
    off = made(tmp_path, OHM, {name: False}, effect.topologies[-1])
    assert off.active_fields() == frozenset()
    assert np.array_equal(off.resistance_ohm, OHM)
    assert np.array_equal(off.converter.gain, made(tmp_path, OHM, {}, effect.topologies[-1]).converter.gain)


@pytest.mark.parametrize("name", EFFECTS)
def test_closed_reads_what_event_reads_and_who_cannot_says_so_by_name(name: str, tmp_path: Path) -> None:
    effect = EFFECTS[name]
    for topology in effect.topologies:
        plan = made(tmp_path, OHM, {name: effect.example(topology)}, topology)
        for engine in records.ENGINES:
            if engines.refused(plan, engine):
                with pytest.raises(InputError, match=rf"effects\.{name}"):
                    engines.check(replace(plan, engine=engine))
        if not engines.refused(plan, "closed"):
            assert np.array_equal(closed.run(plan).codes, event.run(plan).codes)


@pytest.mark.parametrize("name", [name for name in EFFECTS if "spread" in EFFECTS[name].range()])
def test_spread_is_drawn_from_the_seed_and_by_nothing_else(name: str, tmp_path: Path) -> None:
    def codes(seed: int, **more: object) -> np.ndarray:
        plan = made(tmp_path, OHM, {name: EFFECTS[name].example(), **more}, seed=seed)
        return plan.converter.gain

    assert (codes(1) == codes(1, lateral=True, offset_current=True)).all()
    assert (codes(1) != codes(2)).all()


@pytest.mark.paper
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_all_examples_go_together(topology: str, tmp_path: Path) -> None:
    event.run(made(tmp_path, OHM, examples(topology, *EFFECTS), topology))
