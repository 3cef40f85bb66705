# SPDX-License-Identifier: Apache-2.0
"""The engines closed and event: against each other over random scenes, and event against fifty digits."""

import math
from dataclasses import fields, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dermis import bounds, engines, records
from dermis import plan as planning
from dermis.array.array import Network, NoSolution
from dermis.converter.vfc import Converter, count
from dermis.effects import EFFECTS
from dermis.engines import closed, event
from dermis.errors import InputError, SimulatorError
from dermis.records import Drive, Plan
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.design import load as load_design
from tb.reference import exact
from tb.reference.converter_walk import walk_reference

SEEDS = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def made(data: dict[str, Any], engine: str | None = None) -> Plan:
    return planning.make(scene.from_data(data, Path("made.toml")), engine)


def drawn(rng: np.random.Generator, names: list[str], topology: str) -> dict[str, Any]:
    """Some of these effects, at strengths of their ranges and ten times beyond."""
    decades = float(rng.integers(2))
    there = [name for name in names if topology in EFFECTS[name].topologies]
    return {name: EFFECTS[name].draw(rng, decades) for name in there if rng.random() < 0.4}


@settings(max_examples=120, deadline=None)
@given(rng=SEEDS, topology=st.sampled_from(TOPOLOGIES))
def test_closed_and_event_agree_on_every_effect_of_closed(rng: np.random.Generator, topology: str) -> None:
    honoured = [name for name, effect in EFFECTS.items() if effect.bound is bounds.honoured]
    ohm = rng.choice([0.0, math.inf, *rng.uniform(200.0, 1e4, 3), *10 ** rng.uniform(2, 6, 3)], 5)
    values = {"r_ohm": ohm.tolist()} if rng.random() < 0.5 else {"code": rng.integers(0, 256, 5).tolist()}
    data = {
        "array": {"rows": int(rng.integers(1, 7)), "cols": int(rng.integers(1, 7))},
        "stimulus": {"kind": "uniform"} | values,
        "interface": {"topology": topology, "k": int(rng.choice([20, 40, 80, 160]))},
        "effects": drawn(rng, honoured, topology) if rng.random() < 0.8 else {},
        "run": {"seed": int(rng.integers(1000))},
    }
    try:
        plan = made(data)
        codes = closed.run(plan).codes
    except NoSolution:  # a short between an offset column and an ideal row
        with pytest.raises(NoSolution):
            event.run(plan)
        return
    except InputError:  # effects that contradict each other
        assume(False)
    assert plan.active_fields() <= closed.HONOURS
    assert (codes == event.run(plan).codes).all()


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_code_is_read_back_in_every_topology(topology: str) -> None:
    data = {"interface": {"topology": topology}, "stimulus": {"kind": "uniform", "code": list(range(256))}}
    for engine in (closed, event):
        assert (engine.run(made(data)).codes == np.arange(256)[:, None, None]).all()


@pytest.mark.paper
def test_real_frames_are_read_back_as_they_are(gait_csv: Path, tmp_path: Path) -> None:
    path = tmp_path / "gait.toml"
    path.write_text(f'[stimulus]\nkind = "frames"\nfile = "{gait_csv}"\nunit = "codes"\n')
    expected = np.loadtxt(gait_csv, delimiter=",", ndmin=2).reshape(-1, 16, 16)
    for engine in (closed, event):
        assert (engine.run(planning.load(path)).codes == expected).all()


@pytest.mark.parametrize("engine", records.ENGINES)
@pytest.mark.parametrize("record", ["network", "converter", "drive"])
def test_every_engine_refuses_a_new_field_of_a_record_by_name(
    record: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = replace(made({"stimulus": {"kind": "uniform", "code": 5}}), engine=engine)
    of = {"network": Network, "converter": Converter, "drive": Drive}[record]
    wider = make_dataclass("Wider", [("q_new_c", float, 0.25)], bases=(of,), frozen=True, eq=False)
    if record == "network":
        monkeypatch.setattr(records, "Network", wider)
    else:
        old = getattr(plan, record)
        plan = replace(plan, **{record: wider(**{f.name: getattr(old, f.name) for f in fields(old)})})
    engines.check(plan)  # the new field is at its default
    if record == "network":
        on = replace(plan, surrounding=plan.surrounding | {"q_new_c": 1.0})
    else:
        on = replace(plan, **{record: replace(getattr(plan, record), q_new_c=1.0)})
    for ask in (engines.check, engines.run):
        with pytest.raises(InputError, match=f"q_new_c = not possible with engine {engine}"):
            ask(on)


# --- event against the walk in fifty digits ---------------------------------------------------------------------------

# A loop is compiled for each kind of converter, so not every combination is tried; tb.reference.exact.cell_of
# derives all of them from the circuit.
ALL = "integrator_gain integrator_bandwidth integrator_range comparator_hysteresis comparator_delay".split()
SHIFTS = ["comparator_offset", "preset_error", "charge_packet"]
GATE = 30


def short_gate(effects: dict[str, Any], ohm: list[float], topology: str = "conveyor_mirror") -> Plan:
    """A plan of one taxel a frame whose gate of 30 clocks counts 4 bits."""
    design = load_design().replace(timing={"code_bits": 4, "gate_clocks": GATE})
    data = {"array": {"rows": 1, "cols": 1}, "stimulus": {"kind": "uniform", "r_ohm": ohm}}
    data |= {"interface": {"topology": topology}, "effects": effects}
    return planning.make(scene.from_data(data, Path("made.toml"), design), "event")


def cells(plan: Plan) -> list[dict[str, Any]]:
    """Every frame's converter in packets and clocks, as the circuit has it."""
    on = {name: parameters.model_dump() for name, parameters in plan.scene.effects.items()}
    interface = {"i0_a": 25e-6, "c_int_f": 5e-12}
    if plan.topology == "conveyor_mirror_inverted" and "integrator_range" in on:
        on["integrator_range"] = {
            "v_max_v": -on["integrator_range"]["v_min_v"], "v_min_v": -on["integrator_range"]["v_max_v"]
        }  # fmt: skip
    if plan.topology == "direct":
        interface = {name: 80 * value for name, value in interface.items()}
    found = []
    for ohm, x in zip(plan.resistance_ohm.ravel(), event.run(plan).info["x"].ravel(), strict=True):
        # Two quotients: a few roundings of 1.1e-16.
        assert x == pytest.approx(0.5 / (80 * 25e-6 * ohm), rel=1e-14)
        if plan.topology == "direct" and "integrator_gain" in on:  # the column itself loads the integrator
            r_in_ohm = plan.scene.effects["integrator_gain"].r_in_ohm
            on["integrator_gain"]["r_in_ohm"] = 1 / (1 / r_in_ohm + 1 / ohm)
        found.append(exact.cell_of(x, on, interface))
    return found


@pytest.mark.paper
@pytest.mark.parametrize("topology", ["conveyor_mirror", "conveyor_mirror_inverted", "direct"])
@pytest.mark.parametrize("kind", [*([name] for name in ALL), [], ALL], ids=lambda k: "+".join(k) or "none")
def test_event_is_the_walk_in_fifty_digits_to_1e_12(kind: list[str], topology: str) -> None:
    rng, tried = np.random.default_rng(len(kind)), 0
    # Bandwidth loads the column in a way of its own.
    if topology == "direct" and "integrator_gain" not in kind:
        kind = [name for name in kind if name != "integrator_bandwidth"]
    for _ in range(8):
        on = {name: EFFECTS[name].draw(rng) for name in kind}
        on |= {name: EFFECTS[name].draw(rng) for name in SHIFTS if rng.random() < 0.5}
        try:
            plan = short_gate(on, [250.0 / rng.uniform(0, 0.5), 250.0 / rng.uniform(0, 1.5)], topology)
        # Levels outside the range, or hysteresis that reaches the preset.
        except InputError:
            continue
        result, tried = event.run(plan), tried + 1
        found = zip(cells(plan), result.codes.ravel(), result.info["w_end"].ravel(), strict=True)
        for cell, code, end in found:
            walk = walk_reference(cell, GATE, plan.timing.charge_delay_clocks)
            miss = abs(end - float(walk.charge[-1])) / max(1.0, abs(float(walk.charge[-1])))
            # The accuracy that docs/event.md claims of the charge.
            right = code == min(sum(walk.bits), plan.timing.code_max) and miss <= 1e-12
            # Nearer to a threshold a double cannot tell its side.
            assert right or walk.nearest < 1e-12
    assert tried > 1


def test_formula_and_loop_round_alike_on_every_threshold_and_beside_it() -> None:
    steps = np.concatenate([(np.arange(256) + 0.5) / 510, 0.5 / np.arange(1, 30)])
    for error in (0.0, *np.random.default_rng(7).uniform(-0.2, 0.2, 4)):
        x = np.concatenate([steps * (1 + error) + ulps * np.spacing(steps) for ulps in range(-3, 4)])
        data = {
            "array": {"rows": 1, "cols": 1},
            "stimulus": {"kind": "uniform", "r_ohm": (250.0 / x).tolist()},
        }
        plan = made(data | {"effects": {"charge_packet": {"packet_error": float(error)}}})
        looped = event.run(plan)
        # At 2 x = packet both laws of the formula meet, and a rounding of 1e-16 times 50 chooses.
        near_half = np.abs(2 * looped.info["x"] / (1 + error) - 1) < 1e-14
        assert (closed.run(plan).codes == looped.codes)[~near_half].all()
        # Where a rounding chooses, it moves one count.
        assert np.abs(count(looped.info["x"], 510, packet=1 + error) - looped.codes).max() <= 1


@pytest.mark.parametrize("on", [{}, {"comparator_hysteresis": {"v_v": 0.02}}])
def test_a_charge_that_is_no_number_is_an_error_and_not_an_unpressed_taxel(on: dict[str, Any]) -> None:
    plan = short_gate(on, [5e3])
    broken = replace(plan, converter=replace(plan.converter, gain=np.full(1, np.nan)))
    with pytest.raises(SimulatorError, match="not a finite number"):
        event.run(broken)


# --- what single effects do -------------------------------------------------------------------------------------------


@pytest.mark.paper
@pytest.mark.parametrize(
    ("effects", "codes"),
    [
        ({"mirror_ratio": {"ratio_error": -0.01, "spread": 0.0}}, lambda c: 0.99 * c),
        ({"charge_packet": {"packet_error": 0.01}}, lambda c: c / 1.01),
        # 1 nA of 25 uA over 510 clocks is 0.02 count; 100 nA are 2.
        ({"offset_current": {"i_a": 1e-7}}, lambda c: c + 2.04),
        # Up to half a packet of 1 V, a threshold shifts the start and no more.
        ({"comparator_offset": {"v_v": 0.4}}, lambda c: c - 0.4),
        ({"preset_error": {"v_v": 0.4}}, lambda c: c + 0.4),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_an_error_of_the_converter_shifts_codes_by_its_formula(effects: dict[str, Any], codes: Any) -> None:
    steps = np.arange(0, 250, 5)
    found = event.run(made({"stimulus": {"kind": "uniform", "code": steps.tolist()}, "effects": effects}))
    # Half a count of rounding and a rounding of the sum; no code is below 0.
    assert (np.abs(found.codes[:, 0, 0] - np.maximum(codes(steps), 0)) <= 0.5 + 1e-9).all()


@pytest.mark.paper
def test_direct_interface_needs_a_gain_of_about_4000_on_a_full_column() -> None:
    # 16 taxels of 500 ohm hang on the virtual ground. Plateaus of one LSB ask for R_leak C >= 51 us.
    def worst(gain: float, topology: str) -> int:
        stimulus = {"kind": "uniform", "force_n": [14.5 + 0.01 * i for i in range(50)]}
        data = {"array": {"rows": 16, "cols": 1}, "stimulus": stimulus, "interface": {"topology": topology}}
        ideal = event.run(made(data)).codes.astype(int)
        data["effects"] = {"integrator_gain": {"gain_dc": gain, "r_in_ohm": 1e9}}
        return int(np.abs(event.run(made(data)).codes - ideal).max())

    assert worst(4000, "direct") <= 1
    assert worst(100, "direct") > 1
    assert worst(100, "conveyor_mirror") == 0
