# SPDX-License-Identifier: Apache-2.0
"""Every deterministic effect through ngspice against the event engine: alone, all together, and through the Verilog."""

import re
from dataclasses import replace

import numpy as np
import pytest
from deck_bench import DeckReader, levels_of
from system_bench import OF_THE_CHIP, MakePlan, effects_of, scene_of

from dermis import effects
from dermis.chip.netlist import frame_deck
from dermis.engines import cosim, event
from dermis.errors import InputError, SimulatorError
from dermis.lockstep.ngspice import Deck
from dermis.scene.design import TOPOLOGIES

OHM = 510 * 60 ** np.random.default_rng(5).random((2, 3, 4))

Parameters = dict[str, object]

# Where the example of the registry moves codes by 1 LSB or less: the LSB that a code moves by at least, stronger
# parameters, and the company that they need.
STRONGER: dict[str, tuple[int, Parameters, dict[str, Parameters]]] = {
    "lateral": (3, {"r_ohm": 500.0}, {"column_input": {"r_ohm": 5.0}}),
    "column_offset": (5, {"v_v": 8e-3}, {}),
    "integrator_gain": (2, {"gain_dc": 50.0, "r_in_ohm": 5e4}, {}),
    "comparator_offset": (3, {"v_v": 3.3}, {}),
    "comparator_hysteresis": (1, {"v_v": 0.9}, {}),  # below one packet, so below one count
    "comparator_delay": (1, {"t_s": 1.9e-7}, {}),  # below one clock
    "preset_error": (3, {"v_v": 3.3}, {}),
    "trace": (5, {"r_row_ohm": 5.0, "r_column_ohm": 7.0}, {}),
    "return": (1, {"r_ohm": 100.0}, {"column_input": {"r_ohm": 20.0}}),
    "integrator_bandwidth": (1, {"gbw_hz": 5e4}, {}),  # an eighth of the settle time
}
OF_TOPOLOGY: dict[tuple[str, str], Parameters] = {
    ("pad", "direct"): {"r_row_ohm": 5.0, "r_column_ohm": 0.0},
    ("return", "direct"): {"r_ohm": 20.0},  # with 40 ohm ngspice needs a rung of the ladder
    ("offset_current", "direct"): {"i_a": 4e-5},  # the packet is k times larger
    ("integrator_range", "direct"): {"v_max_v": 0.6, "v_min_v": -0.25},
    ("integrator_range", "conveyor_mirror_inverted"): {"v_max_v": 0.25, "v_min_v": -0.6},
}


def alone(name: str, topology: str = "conveyor_mirror") -> tuple[int, Parameters, dict[str, Parameters]]:
    """LSB that an effect moves a code by at least, its parameters, and what must be on for it to act."""
    effect = effects.EFFECTS[name]
    found = STRONGER.get(name, (2, effect.example(topology), dict(effect.needs)))
    return found[0], OF_TOPOLOGY.get((name, topology), found[1]), found[2]


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("name", sorted({*OF_THE_CHIP} - {"line_capacitance"}))
def test_an_effect_alone_reads_as_in_the_event_engine(
    resistance_plan: MakePlan, reader: DeckReader, name: str, topology: str
) -> None:
    if topology not in effects.EFFECTS[name].topologies:
        with pytest.raises(InputError, match="topology"):
            resistance_plan(OHM, topology, f"{name} = true")
        return
    least, value, company = alone(name, topology)
    ohm = OHM[: 2 if name in ("motion", "supply_ripple") else 1, 1:]
    made = resistance_plan(ohm, topology, scene_of(company | {name: value}))
    got = reader.codes(made)
    # A count may fall either side of a half in another engine's rounding.
    assert np.abs(got - event.run(made).codes).max() <= 1
    without = event.run(resistance_plan(ohm, topology, scene_of(company))).codes.astype(int)
    assert np.abs(got - without).max() >= least, "the effect must be large enough to be seen"


def test_lines_that_do_not_settle_are_left_to_ngspice(resistance_plan: MakePlan, reader: DeckReader) -> None:
    around = "row_driver = { r_ohm = 50.0, grounded_r_ohm = 50.0 }\ncolumn_input = { r_ohm = 50.0 }\n"
    lines = "line_capacitance = { c_row_f = 1e-6, c_column_f = 1e-6, c_taxel_f = 1e-8 }\n"
    made, without = (resistance_plan(OHM[:1], effects=text) for text in (around + lines, around))
    assert np.abs(reader.codes(made) - event.run(without).codes).max() >= 5
    with pytest.raises(InputError, match="not settled when the gate opens"):
        event.run(made)


# By effect: a line of its deck as it is, and wrong.
FAULTS = {
    "trace_from_the_far_end": ("trace", r"(rtrace_row_r(\d)c0) r\d u_r\dc0", r"\1 r\2 u_r\2c3"),
    "trace_of_columns_missing": ("trace", r"(rtrace_col\S+ \S+ \S+) 7\.0", r"\1 1e-9"),
    "mirror_of_a_third_of_the_charge": ("mirror_lag", r"out_q_lag_c=4e-11", "out_q_lag_c=1e-11"),
    "mirror_in_time": ("mirror_lag", r"out_q_lag_c=4e-11", ""),
    "leak_outwards": ("mux_leakage", r"(ileak\d) 0 (col\d)", r"\1 \2 0"),
    "ripple_out_of_phase": ("supply_ripple", r"(vbias .*) 30\.2\d*\)", r"\1 210.0)"),
    "motion_backwards": ("motion", r" \+ (\(\S+\))\*time\)", r" - \1*time)"),
    "switch_that_does_not_compress": ("range_switch", r"out_inv_i_range_a=\S+", ""),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.paper
def test_codes_show_a_wrong_element(resistance_plan: MakePlan, reader: DeckReader, fault: str) -> None:
    name, right, wrong = FAULTS[fault]
    _, value, company = alone(name)
    made = resistance_plan(OHM, effects=scene_of(company | {name: value}))
    deck = frame_deck(made, 0, levels_of(made))
    lines = tuple(re.sub(right, wrong, line) for line in deck.lines)
    assert lines != deck.lines
    got = reader.deck(replace(deck, lines=lines), made)
    assert np.abs(got - event.run(made).codes[0]).max() > 1


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_all_effects_together_at_their_defaults_read_as_in_the_event_engine(
    resistance_plan: MakePlan, reader: DeckReader, topology: str
) -> None:
    on: dict[str, object] = dict.fromkeys(effects_of(topology), True)
    if topology == "direct":
        on["column_input"] = {"r_ohm": 0.5}
    made = resistance_plan(OHM, topology, scene_of(on))
    # As above.
    assert np.abs(reader.codes(made) - event.run(made).codes).max() <= 1


def test_a_deck_reads_the_same_without_the_verilog(resistance_plan: MakePlan, reader: DeckReader) -> None:
    """Ties the chip of deck_bench, which all of the above is read with, to the real one; motion over two frames."""
    on = effects_of("conveyor_mirror") | {"mirror_lag": {"q_c": 1e-11}}
    made = resistance_plan(OHM[:, :2, :2], effects=scene_of(on))
    assert np.array_equal(cosim.run(made).codes, reader.codes(made))


@pytest.mark.paper
def test_the_exact_half_refuses_what_it_would_ignore(resistance_plan: MakePlan) -> None:
    for name in OF_THE_CHIP:
        made = resistance_plan(OHM, effects=scene_of({name: alone(name)[1]}))
        if name in ("lateral", "mirror_output"):  # alone they change nothing
            continue
        with pytest.raises(InputError, match=rf"effects\.{name} = .*exact analog half"):
            cosim.run(made, analog="exact")


def test_a_deck_that_ngspice_gives_up_spoils_no_other(resistance_plan: MakePlan, reader: DeckReader) -> None:
    made = resistance_plan(OHM[:1])
    before = reader.codes(made)
    broken = Deck(("no such block", "x1 a b nothing"), (), (), (), ("a",))
    with pytest.raises(SimulatorError):
        reader.deck(broken, made)
    assert np.array_equal(reader.codes(made), before)
