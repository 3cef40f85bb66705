# SPDX-License-Identifier: Apache-2.0
"""The engines closed and event: against each other over random scenes, and event against fifty digits."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, make_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dermis import engines, records
from dermis import plan as planning
from dermis.array.array import Network, NoSolution
from dermis.converter import walk, walk_loops
from dermis.converter.vfc import Converter, count
from dermis.converter.walk import Cells, cells_of, count_cells
from dermis.effects import EFFECTS
from dermis.engines import closed, event, rtl
from dermis.errors import InputError
from dermis.records import Drive
from dermis.scene import scene
from dermis.scene.design import ROOT, TOPOLOGIES
from tb.reference.converter_walk import walk_reference

Write = Callable[..., Path]

CLOSED_EFFECTS = ["lateral", "row_driver", "column_input", "column_offset", "mirror_ratio", "offset_current",
                  "charge_packet", "preset_error", "comparator_offset", "trace", "mux_leakage", "range_switch",
                  "reference_drift", "mirror_output"]  # fmt: skip


IDEAL = {"x": 0.0, "leak": 0.0, "w0": -0.5, "packet": 1.0, "rise": 0.0, "fall": 0.0,
         "low": -np.inf, "high": np.inf, "delay": 0.0, "lag": 0.0, "across": 0.0}  # fmt: skip
"""The cell of an ideal converter."""


def size(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers as a scene takes them: 0 or of a size that means something."""
    # Products of smaller numbers are subnormal and round like nothing in a converter.
    return st.floats(low, high).map(lambda v: v if abs(v) >= 1e-30 else 0.0)


@st.composite
def scenes(draw: st.DrawFn, effects: list[str]) -> dict[str, object]:
    """Random scenes of any topology and size, with any of these effects at random strength."""
    topology = draw(st.sampled_from(TOPOLOGIES))
    rows, cols = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    stimulus = draw(
        st.sampled_from(
            [
                {"kind": "uniform", "r_ohm": draw(st.lists(size(0, 1e6), min_size=1, max_size=3))},
                {"kind": "uniform", "r_ohm": [0.0, float("inf")]},
                {"kind": "uniform", "code": draw(st.lists(st.integers(0, 255), min_size=1, max_size=4))},
                {"kind": "uniform", "force_n": draw(size(0, 20))},
                {
                    "kind": "indenter",
                    "shape": draw(st.sampled_from(["flat", "triangular", "cylindrical"])),
                    "force_n": draw(size(0, 40)),
                    "width": draw(st.floats(1, 9)),
                    "angle_deg": draw(size(-90, 90)),
                },
            ]
        )
    )
    strength: dict[str, dict[str, object]] = {
        "lateral": {"r_ohm": draw(st.floats(1, 1e5))},
        "row_driver": {"r_ohm": draw(size(0, 100)), "grounded_r_ohm": draw(size(0, 100))},
        "column_input": {"r_ohm": draw(size(0, 50))},
        "column_offset": {"v_v": [draw(size(-5e-3, 5e-3)) for _ in range(cols)]},
        "mirror_ratio": {"ratio_error": draw(size(-0.1, 0.1)), "spread": draw(size(0, 0.05))},
        "offset_current": {"i_a": draw(size(-1e-7, 1e-7))},
        "charge_packet": {"packet_error": draw(size(-0.1, 0.1))},
        "preset_error": {"v_v": draw(size(-3, 3))},
        "comparator_offset": {"v_v": draw(size(-0.1, 0.1))},
        "trace": {"r_row_ohm": draw(size(0, 10)), "r_column_ohm": draw(size(0, 10))},
        "mux_leakage": {"i_a": [draw(size(-1e-5, 1e-5)) for _ in range(cols)]},
        "range_switch": {"r_ohm": draw(size(0, 100)), "v_overdrive_v": draw(st.floats(0.05, 1))},
        "reference_drift": {"tc_per_k": draw(size(-1e-3, 1e-3)), "delta_k": draw(size(-50, 50))},
        "mirror_output": {"r_out_ohm": draw(st.floats(1e4, 1e9))},
    }
    on = {name: strength[name] for name in effects if draw(st.booleans())}
    on = {name: value for name, value in on.items() if topology in EFFECTS[name].topologies}
    return {
        "array": {"rows": rows, "cols": cols},
        "stimulus": stimulus,
        "interface": {"topology": topology, "k": draw(st.sampled_from([20, 40, 80, 160]))},
        "effects": on,
        "run": {"seed": draw(st.integers(0, 1000))},
    }


def made(data: dict[str, object]) -> records.Plan:
    return planning.make(scene.from_data(data, Path("made.toml")))


@settings(max_examples=120, deadline=None)
@given(data=scenes([]))
def test_closed_and_event_agree_to_the_last_bit_on_ideal_scenes(data: dict[str, object]) -> None:
    plan = made(data)
    assert plan.active_fields() == frozenset()
    assert (closed.run(plan).codes == event.run(plan).codes).all()


@settings(max_examples=120, deadline=None)
@given(data=scenes(CLOSED_EFFECTS))
def test_closed_and_event_agree_with_every_effect_that_closed_does(data: dict[str, object]) -> None:
    plan = made(data)
    assert plan.active_fields() <= closed.HONOURS
    try:
        codes = closed.run(plan).codes
    except NoSolution:  # a short between an offset column and an ideal row
        with pytest.raises(NoSolution):
            event.run(plan)
        return
    assert (codes == event.run(plan).codes).all()


def test_formula_and_loop_round_alike_on_every_threshold_and_beside_it() -> None:
    rng = np.random.default_rng(7)
    places = []
    for packet, start in (
        (1.0, 0.5),
        *zip(rng.uniform(0.8, 1.2, 20), rng.uniform(0.05, 0.8, 20), strict=True),
    ):
        # x where the one number m comes exactly at clock 510; above packet/2, where the first comes at clock n
        x = np.concatenate([(start + np.arange(256) * packet) / 510, start / np.arange(1, 30)])
        for ulps in range(-3, 4):
            places += [IDEAL | {"x": v + ulps * np.spacing(v), "packet": packet, "w0": -start} for v in x]
    cells = cells_from(places)
    looped, _ = count_cells(cells, 510, 1.0)
    # At 2 x = packet both laws of the formula meet, and a rounding of 1e-16 times 50 chooses.
    near_half = np.abs(2 * cells.x / cells.packet - 1) < 1e-14
    formula = count(cells.x, 510, w0=cells.w0, packet=cells.packet)
    assert (formula[~near_half] == looped[~near_half]).all()
    # Where a rounding chooses, it moves one count.
    assert np.abs(formula - looped).max() <= 1


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_code_is_read_back_in_every_topology(topology: str) -> None:
    plan = made(
        {"interface": {"topology": topology}, "stimulus": {"kind": "uniform", "code": list(range(256))}}
    )
    for engine in (closed, event):
        assert (engine.run(plan).codes == np.arange(256)[:, None, None]).all()


@pytest.mark.paper
def test_shorts_read_255_and_opens_read_0() -> None:
    plan = planning.load(ROOT / "models" / "scenes" / "extremes.toml")
    for engine in (closed, event):
        codes = engine.run(plan).codes
        assert (codes[plan.resistance_ohm == 0] == 255).all()
        assert (codes[np.isinf(plan.resistance_ohm)] == 0).all()
        assert (codes[plan.resistance_ohm <= 500] == 255).all()


@pytest.mark.paper
def test_real_frames_are_read_back_as_they_are(gait_csv: Path, tmp_path: Path) -> None:
    path = tmp_path / "gait.toml"
    path.write_text(f'[stimulus]\nkind = "frames"\nfile = "{gait_csv}"\nunit = "codes"\n')
    plan = planning.load(path)
    expected = np.loadtxt(gait_csv, delimiter=",", ndmin=2).reshape(-1, 16, 16)
    assert (closed.run(plan).codes == expected).all()
    assert (event.run(plan).codes == expected).all()


def test_engines_list_only_fields_that_exist() -> None:
    there = {f.name for record in (Network, Converter, Drive) for f in fields(record)}
    for engine in records.ENGINES:
        assert engines.honours(engine) < there
    assert closed.HONOURS < event.HONOURS
    assert rtl.HONOURS == event.HONOURS - walk.RANDOM


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


@pytest.mark.paper
def test_progress_ends_at_the_last_row_slot() -> None:
    plan = made({"stimulus": {"kind": "uniform", "code": [5] * 300}})
    for engine in (closed, event):
        seen: list[int] = []
        engine.run(plan, seen.append)
        assert seen == sorted(seen)
        assert seen[-1] == 300 * 16
        assert len(seen) > 1


# --- event against the walk in 50 digits ---------------------------------------------------------------------------


# Kinds of cells: a loop is compiled for each, so not every combination is drawn.
ALL = ("leak", "bandwidth", "range", "hysteresis", "delay")
KINDS = [
    *((kind,) for kind in ALL),
    ("leak", "bandwidth"),
    ("bandwidth", "hysteresis"),
    ("bandwidth", "range"),
    ALL,
]


@st.composite
def cell(draw: st.DrawFn) -> dict[str, float]:
    """One converter with anything on, in packets and clocks."""
    kind = draw(st.sampled_from(KINDS))
    shifted = draw(st.booleans())
    offset = draw(st.floats(-0.2, 0.2)) if shifted else 0.0
    window = draw(st.floats(0.001, 0.4)) if "hysteresis" in kind else 0.0
    low = draw(st.floats(-1.5, -0.6)) if "range" in kind else -np.inf
    high = draw(st.floats(0.3, 1.5)) if "range" in kind else np.inf
    across = 10 ** draw(st.floats(-6, 1)) if "leak" in kind else 0.0
    return {
        "x": draw(st.one_of(st.floats(0, 0.5), st.floats(-0.1, 1.5))),
        "leak": min(10 ** draw(st.floats(-6, -0.5)), across) if "leak" in kind else 0.0,
        "w0": min(max(-0.5 + (draw(st.floats(-0.3, 0.3)) if shifted else 0.0), low), high),
        "packet": draw(st.floats(0.9, 1.1)) if shifted else 1.0,
        "rise": offset + window / 2,
        "fall": offset - window / 2,
        "low": low,
        "high": high,
        "delay": draw(st.floats(0.001, 0.9)) if "delay" in kind else 0.0,
        "lag": 10 ** draw(st.floats(-3, 1)) if "bandwidth" in kind else 0.0,
        "across": across,
    }


def cells_from(made_cells: list[dict[str, float]]) -> Cells:
    return Cells(**{f.name: np.array([c[f.name] for c in made_cells]) for f in fields(Cells)})


@pytest.mark.long
@settings(max_examples=80, deadline=None)
@given(one=cell(), latch=st.booleans(), clocks=st.integers(1, 50))
def test_event_is_the_walk_in_fifty_digits_to_1e_12(one: dict[str, float], latch: bool, clocks: int) -> None:
    # The latch takes half a clock less; another loop is compiled for it, so not with every kind.
    late = 0.5 if latch and (one["delay"] > 0 or one["leak"] > 0) else 1.0
    counts, w_end = count_cells(cells_from([one]), clocks, late)
    bits, charge, nearest = walk_reference(one, clocks, late)
    miss = abs(w_end[0] - float(charge[-1])) / max(1.0, abs(float(charge[-1])))
    # Beside a threshold by less than the accuracy that is claimed of the walk.
    if nearest < 1e-12 and (counts[0] != sum(bits) or miss > 1e-12):
        return  # the walk itself stands on a threshold: a double cannot tell which side
    # The accuracy that docs/event.md claims of the charge.
    assert counts[0] == sum(bits)
    assert miss <= 1e-12


@pytest.mark.parametrize("kind", [(), ALL])
def test_a_charge_that_changes_every_clock_is_the_walk_in_fifty_digits_too(kind: tuple[str, ...]) -> None:
    rng = np.random.default_rng(11)
    clocks, cells = 60, []
    for _ in range(12):
        window = 0.01 if "hysteresis" in kind else 0.0
        cells.append(
            IDEAL
            | {
                "w0": rng.uniform(-0.6, -0.4),
                "packet": rng.uniform(0.9, 1.1),
                "rise": window,
                "fall": -window,
            }
            | ({"leak": 1e-3, "across": 0.2} if "leak" in kind else {})
            | ({"lag": rng.uniform(0.01, 0.5)} if "bandwidth" in kind else {})
            | ({"low": -1.1, "high": 0.6} if "range" in kind else {})
            | ({"delay": rng.uniform(0.01, 0.3)} if "delay" in kind else {})
        )
    x = rng.uniform(0, 0.6, len(cells)) * (1 + 0.2 * np.sin(0.3 * np.arange(clocks))[:, None])
    counts, end = np.empty(len(cells), dtype=np.int64), np.empty(len(cells))
    walk.walk_cells(
        clocks, 1.0, None, x, walk.rows_of(cells_from(cells), 1.0), None, 0, len(cells), counts, end
    )
    for i, one in enumerate(cells):
        exact = walk_reference(one, clocks, 1.0, vary=list(x[:, i]))
        assert exact.nearest > 1e-12, "take another seed"
        # The accuracy that docs/event.md claims of the charge.
        assert counts[i] == sum(exact.bits)
        assert abs(end[i] - float(exact.charge[-1])) <= 1e-12 * max(1.0, abs(end[i]))


@pytest.mark.parametrize(("row", "by"), [("KEEP", 1e-9), ("GAIN", 1e-9), ("TAKE", 1e-9)])
def test_the_tie_sees_a_coefficient_that_is_off_by_a_billionth(row: str, by: float) -> None:
    one = IDEAL | {"x": 0.37, "leak": 1e-3, "lag": 0.05, "across": 0.1, "w0": -0.47}
    rows = walk.rows_of(cells_from([one]), 1.0)
    rows.slow[getattr(walk_loops, row)] *= 1 + by
    counts, end = np.empty(1, dtype=np.int64), np.empty(1)
    walk.walk_cells(40, 1.0, np.array([one["x"]]), None, rows, None, 0, 1, counts, end)
    # Ten times what the tie above allows: the fault would be seen.
    assert abs(end[0] - float(walk_reference(one, 40, 1.0).charge[-1])) > 1e-11


# What walk_loops.walk is handed for an effect alone; the rest is None and leaves no trace in the compiled loop.
HANDED = {
    "integrator_gain": {"x"},
    "integrator_bandwidth": {"x", "fast", "lag"},
    "integrator_range": {"x", "limits"},
    "comparator_hysteresis": {"x", "window"},
    "comparator_delay": {"x", "early"},
    "supply_ripple": {"vary"},
    "motion": {"vary"},
    "mirror_lag": {"vary"},
    "comparator_noise": {"x", "noise", "keys", "step"},
    "metastability": {"x", "noise", "keys", "step"},
    "clock_jitter": {"x", "noise", "keys", "step"},
    "thermal_noise": {"x", "noise", "keys", "step"},
    "shot_noise": {"x", "noise", "keys", "step"},
}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_reaches_the_loop_with_its_own_parameters_and_no_others(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    handed: list[set[str]] = []
    names = list(inspect.signature(walk_loops.walk.py_func).parameters)

    def spy(*given: object) -> None:
        handed.append({n for n, value in zip(names, given, strict=True) if value is not None} - always)
        given[-2][:], given[-1][:] = 0, 0.0  # type: ignore[index]

    always = {"clocks", "late", "slow", "rise", "begin", "stop", "counts", "end"}
    monkeypatch.setattr(walk_loops, "walk", spy)
    value = {"r_ohm": 1.0} if name == "column_input" else True
    event.run(made({"stimulus": {"kind": "uniform", "code": 5}, "effects": {name: value}}))
    assert all(got == HANDED[name] for got in handed)
    assert bool(handed) == (name in HANDED)


def test_the_reference_is_charge_balance_when_nothing_is_on() -> None:
    for c in (0, 1, 100, 254, 255):
        for late in (1.0, 0.5):
            assert sum(walk_reference(IDEAL | {"x": c / 510}, 510, late).bits) == c


def test_event_takes_the_same_way_through_all_loops_when_effects_are_tiny() -> None:
    x = np.concatenate([np.arange(256) / 510, np.random.default_rng(0).uniform(0, 0.6, 500)])
    expected = count_cells(cells_from([IDEAL | {"x": v} for v in x]), 510, 1.0)
    tiny = (
        {"leak": 1e-18},
        {"delay": 1e-13},
        {"rise": 1e-13},
        {"low": -1e9},
        {"leak": 1e-18, "delay": 1e-13},
    )
    for effect in tiny:
        got = count_cells(cells_from([IDEAL | effect | {"x": v} for v in x]), 510, 1.0)
        # The tiny effects themselves: 1e-13 clock of delay and 1e-18 of leak, over 510 clocks.
        assert (got[0] == expected[0]).all()
        assert np.abs(got[1] - expected[1]).max() < 1e-9


def test_both_synchronizers_give_equal_codes_for_ideal_converters() -> None:
    plan = made(
        {"stimulus": {"kind": "uniform", "force_n": [0.01 * i for i in range(1700)]}, "array": {"rows": 1}}
    )
    cells = cells_of(plan, closed.run(plan).info["x"], plan.conductance_s())
    assert (count_cells(cells, 510, 1.0)[0] == count_cells(cells, 510, 0.5)[0]).all()


@pytest.mark.paper
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_converters_become_cells_as_their_formulas_say(topology: str) -> None:
    effects = {
        "comparator_offset": {"v_v": 0.03},
        "comparator_hysteresis": {"v_v": 0.02},
        "comparator_delay": {"t_s": 5e-9},
        "preset_error": {"v_v": 0.1},
        "charge_packet": {"packet_error": 0.01},
        "integrator_gain": {"gain_dc": 99.0, "r_in_ohm": 1e6},
        "integrator_range": {"v_max_v": 1.2, "v_min_v": -1.4},
    }
    k, i0_a, c_int_f, f_clk_hz = 40, 20e-6, 8e-12, 5e6
    plan = made(
        {
            "array": {"rows": 3, "cols": 2},
            "stimulus": {"kind": "uniform", "r_ohm": 1000.0},
            "interface": {"topology": topology, "k": k, "i0_a": i0_a, "c_int_f": c_int_f},
            "effects": effects,
        }
    )
    cells = cells_of(plan, np.full((1, 3, 2), 0.3), plan.conductance_s())
    packet_v = i0_a / f_clk_hz / c_int_f
    across_s = 1e-6 + (3 / 1000 if topology == "direct" else 0.0)
    times = k if topology == "direct" else 1
    output = 1 / (1 + 1 / 99)  # of the amplifier, over the voltage on the capacitor
    expected = {
        "x": 0.3,
        "leak": across_s / (times * c_int_f * (99 + 1)) / f_clk_hz,
        "w0": -0.5 + 0.1 / packet_v,
        "packet": 1.01,
        "rise": (0.03 + 0.01) / packet_v / output,
        "fall": (0.03 - 0.01) / packet_v / output,
        "low": (-1.4 if topology == "conveyor_mirror_inverted" else -1.2) / packet_v / output,
        "high": (1.2 if topology == "conveyor_mirror_inverted" else 1.4) / packet_v / output,
        "delay": 5e-9 * f_clk_hz,
    }
    for name, value in expected.items():
        # Four products: a few roundings of 1.1e-16.
        assert getattr(cells, name) == pytest.approx(np.full((1, 3, 2), value), rel=1e-12), name


@pytest.mark.parametrize("late", [1.0, 0.5])
@pytest.mark.parametrize("q", [3, 4, 5])
def test_leak_locks_the_rate_on_a_plateau_of_the_known_width(q: int, late: float) -> None:
    # Contracted rotation (Laurent & Nogueira 2018): the plateau 1/q is lam^(q-2) (1-lam)^2 / (1-lam^q) wide when the
    # packet leaves at once. It leaves `late` clocks afterwards and has that much less time to decay.
    lam = 0.95
    width = lam ** (q - 2) * (1 - lam) ** 2 / (1 - lam**q) * lam**-late
    x = np.linspace(1 / q - 0.02, 1 / q + 0.02, 8001)
    leaky = [IDEAL | {"x": v, "leak": -np.log(lam)} for v in x]
    counts, _ = count_cells(cells_from(leaky), 6000 * q, late)
    # Ends of the gate: at most a dozen packets of the 6000 q clocks are not yet locked.
    locked = x[np.abs(counts - 6000) <= 12]
    # The grid of x has steps of 5e-6; the ends of the plateau are approached in 6000 q clocks only to some
    # steps.
    assert locked[-1] - locked[0] == pytest.approx(width, abs=3e-5)


# --- what single effects do ----------------------------------------------------------------------------------------


def codes(effects: dict[str, object], topology: str = "conveyor_mirror", **stimulus: object) -> np.ndarray:
    stimulus = stimulus or {"code": list(range(0, 256, 5))}
    data = {
        "array": {"rows": 2, "cols": 3},
        "stimulus": {"kind": "uniform", **stimulus},
        "interface": {"topology": topology},
        "effects": effects,
    }
    return event.run(made(data)).codes.astype(int)


def test_mirror_and_packet_errors_are_gain_errors() -> None:
    steps = np.arange(0, 256, 5)
    gain = codes({"mirror_ratio": {"ratio_error": -0.01}})[:, 0, 0]
    packet = codes({"charge_packet": {"packet_error": 0.01}})[:, 0, 0]
    # Rounding of a code is half a count; 0.01 is what the last bit of a gain error moves it.
    assert (np.abs(gain - steps * 0.99) <= 0.51).all()
    assert (np.abs(packet - steps / 1.01) <= 0.51).all()
    assert steps[-1] - packet[-1] == 3  # 1 % of mismatch is 2.5 codes at full scale


@pytest.mark.paper
def test_offset_current_adds_its_share_of_i0() -> None:
    # 1 nA of 25 uA over 510 clocks is 0.02 count; 100 nA are 2
    assert (codes({"offset_current": {"i_a": 1e-7}}, code=[0, 100]).max(axis=(1, 2)) == [2, 102]).all()


@pytest.mark.paper
@pytest.mark.parametrize(
    ("small", "large"),
    [
        ({"comparator_offset": {"v_v": 0.01}}, {"comparator_offset": {"v_v": 0.6}}),
        (
            {"comparator_hysteresis": {"v_v": 0.02}},
            {"comparator_hysteresis": {"v_v": 0.9}, "preset_error": {"v_v": -0.1}},
        ),
        ({"comparator_delay": {"t_s": 5e-9}}, {"comparator_delay": {"t_s": 190e-9}}),
        ({"preset_error": {"v_v": -0.01}}, {"preset_error": {"v_v": -0.6}}),
    ],
)
def test_threshold_delay_and_preset_only_shift_the_start(small: dict, large: dict) -> None:
    steps = np.arange(0, 256, 5)[:, None, None]
    assert (codes(small) == steps).all()
    shift = codes(large) - steps
    assert np.abs(shift).max() == 1


@pytest.mark.paper
def test_range_below_a_packet_loses_charge_and_a_wide_one_does_nothing() -> None:
    steps = np.arange(0, 256, 5)[:, None, None]
    assert (codes({"integrator_range": True}) == steps).all()
    for topology, side in (("conveyor_mirror", "v_min_v"), ("conveyor_mirror_inverted", "v_max_v")):
        sign = -1 if side == "v_min_v" else 1
        tight = codes({"integrator_range": {side: sign * 0.3}}, topology)
        assert (tight <= steps).all()
        assert tight[-1, 0, 0] < 250


def test_direct_interface_leaks_through_its_column_and_conveyors_do_not() -> None:
    steps = np.arange(0, 256, 5)[:, None, None]
    effects = {"integrator_gain": {"gain_dc": 20}}
    assert (codes(effects) == steps).all()
    assert np.abs(codes(effects, "direct") - steps).max() > 1
    assert (codes({"integrator_gain": {"gain_dc": 1e5}}, "direct") == steps).all()


@pytest.mark.paper
def test_direct_interface_needs_a_gain_of_about_4000_on_a_full_column() -> None:
    # 16 taxels of 500 ohm hang on the virtual ground. Plateaus of one LSB ask for R_leak C >= 51 us.
    def worst(gain: float) -> int:
        data = {
            "stimulus": {"kind": "uniform", "force_n": [14.5 + 0.01 * i for i in range(50)]},
            "array": {"rows": 16, "cols": 1},
            "interface": {"topology": "direct"},
        }
        ideal = event.run(made(data)).codes.astype(int)
        data["effects"] = {"integrator_gain": {"gain_dc": gain}}
        return int(np.abs(event.run(made(data)).codes - ideal).max())

    assert worst(4000) <= 1
    assert worst(100) > 1


@pytest.mark.paper
def test_columns_of_the_direct_interface_that_move_each_other_by_counts_are_refused() -> None:
    data = {
        "stimulus": {"kind": "uniform", "r_ohm": 500.0},
        "interface": {"topology": "direct"},
        "effects": {"integrator_gain": {"gain_dc": 100.0}, "lateral": {"r_ohm": 100.0}},
    }
    with pytest.raises(InputError, match=r"integrator_gain.*lateral.*cosim"):
        event.run(made(data))
    data["effects"]["integrator_gain"] = True
    data["effects"]["lateral"] = True
    event.run(made(data))


@pytest.mark.paper
def test_closed_and_event_start_from_packets_above_and_below_the_threshold() -> None:
    for volt in (-2.3, -0.7, 0.5, 0.7, 3.1):
        effects = {"preset_error": {"v_v": volt}, "comparator_offset": {"v_v": 0.3 * volt}}
        data = {"stimulus": {"kind": "uniform", "code": list(range(256))}, "effects": effects}
        expected = event.run(made(data)).codes
        assert (closed.run(made(data)).codes == expected).all()
        # Rounding twice: of the expectation and of the count.
        assert abs(int(expected[100].max()) - 100 - round(0.7 * volt)) <= 1


def test_an_effect_that_is_off_leaves_the_records_and_the_loop_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk_loops, "walk", lambda *_: pytest.fail("an ideal scene took a loop with effects"))
    event.run(made({"stimulus": {"kind": "uniform", "code": [0, 255]}}))


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_on_says_so_and_sets_only_its_own_fields(name: str) -> None:
    value = {"r_ohm": 1.0} if name == "column_input" else True
    plan = made({"stimulus": {"kind": "uniform", "code": 5}, "effects": {name: value}})
    assert [effect.name for effect in plan.effects if effect.on] == [name]
    active = plan.active_fields()
    # The sheet's effects change resistances before any engine sees them, and a conductance across an input that stands
    # still carries nothing.
    assert bool(active) == (not name.startswith("sensor_") and name != "mirror_output")
    for field in active:
        assert plan.effects_of_field(field) == (name,)
    assert active <= event.HONOURS


def test_spread_is_drawn_from_the_seed_and_by_nothing_else() -> None:
    def gain(seed: int, **more: object) -> np.ndarray:
        effects = {"mirror_ratio": {"ratio_error": 0.0, "spread": 0.01}, **more}
        plan = made({"stimulus": {"kind": "uniform", "code": 5}, "effects": effects, "run": {"seed": seed}})
        return plan.converter.gain

    assert (gain(1) == gain(1)).all()
    assert (gain(1) == gain(1, lateral=True, offset_current=True)).all()
    assert (gain(1) != gain(2)).all()
    assert 0.003 < gain(1).std() < 0.03
