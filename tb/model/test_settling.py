# SPDX-License-Identifier: Apache-2.0
"""Lines that have not settled when the gate opens: their bound against many digits, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dermis import engines
from dermis import plan as planning
from dermis.array.array import Network
from dermis.array.settling import bound_c
from dermis.errors import InputError
from dermis.records import Plan, Timing
from dermis.scene import scene
from tb.reference.lines_reference import charge_reference

TIMING = Timing(f_clk_hz=5e6, slot_clocks=40, settle_clocks=8, gate_clocks=32, code_max=255, rows=3)


def random_network(rng: np.random.Generator) -> Network:
    """Draw a small array with every kind of driver, input and capacitance there or not."""
    rows, cols = rng.integers(1, 4, 2)
    g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e6), (rows, cols)))
    g[rng.random((rows, cols)) < 0.2] = 0.0
    ohm, capacitance = [0.0, 50.0, 1e3], [0.0, 1e-12, 1e-10]
    return Network(
        g,
        0.5,
        r_row_driven_ohm=rng.choice(ohm),
        r_row_grounded_ohm=rng.choice([*ohm, np.inf]),
        r_column_ohm=rng.choice(ohm, cols),
        v_column_offset_v=rng.choice([0.0, 1e-3], cols),
        g_lateral_row_s=rng.choice([0.0, 1e-4]),
        i_leak_a=rng.choice([0.0, 1e-6], cols),
        c_row_f=rng.choice(capacitance),
        c_column_f=rng.choice(capacitance),
        c_taxel_f=rng.choice([0.0, 1e-12, 1e-10]),
    )


def test_no_charge_exceeds_its_bound() -> None:
    rng, bounded = np.random.default_rng(6), 0
    for draw in range(30):
        network, timing = random_network(rng), replace(TIMING, break_clocks=(0, 1, 3)[draw % 3])
        late = np.abs(charge_reference(network, timing)[..., timing.settle_clocks :]).sum(axis=2).max(axis=0)
        bound = bound_c(network, network.g_taxel_s[np.newaxis], timing)
        # A bound that is met with equality, up to rounding; 1e-25 C is one packet in 5e13.
        assert (late <= bound * (1 + 1e-9) + 1e-25).all()
        # As above: less is nothing to bound.
        bounded += bool(np.isfinite(bound).all() and late.max() > 1e-25)
    assert bounded > 4, "few bounds that say something beside something to bound"


def made(engine: str, effects: dict[str, Any]) -> Plan:
    data = {"stimulus": {"kind": "uniform", "r_ohm": [600.0, 5000.0]}, "effects": effects}
    return planning.make(scene.from_data(data, Path("lines.toml")), engine)


SERIES = {"row_driver": {"r_ohm": 1e3}, "column_input": {"r_ohm": 1e3}}
SLOW = SERIES | {"line_capacitance": {"c_row_f": 2e-5}}
FELT = {
    "row_driver": {"r_ohm": 100.0},
    "line_capacitance": {"c_row_f": 1e-8, "c_column_f": 0.0, "c_taxel_f": 0.0},
    "mirror_lag": {"q_c": 5e-11},
}


@pytest.mark.parametrize("engine", ["event", "rtl"])
@pytest.mark.parametrize(
    ("effects", "said"),
    [(SLOW, "not settled when the gate opens"), (FELT, "on together with mirror_lag: injected charge")],
)
def test_lines_that_have_not_settled_are_refused(engine: str, effects: dict[str, Any], said: str) -> None:
    plan = made(engine, effects)
    with pytest.raises(InputError, match=f"line_capacitance = {said}.*engine cosim"):
        engines.check(plan)


def test_lines_of_the_chip_settle() -> None:
    plan = made("event", SERIES | {"line_capacitance": True})
    engines.check(plan)
    assert (engines.run(plan).codes == engines.run(made("event", SERIES)).codes).all()
