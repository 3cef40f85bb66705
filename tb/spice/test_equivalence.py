# SPDX-License-Identifier: Apache-2.0
"""The files of models/extracted against the circuit, how a scene takes them, and the gate on one short column."""

from __future__ import annotations

import dataclasses
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from dermis import engines, plan
from dermis.array.array import column_currents
from dermis.chip import netlist
from dermis.engines import event
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import design as design_module
from dermis.scene import extracted, scene
from dermis.scene.schema import read_toml
from tb.programs.equivalence import cases, command, faults, gate, loop
from tb.programs.equivalence.gate import Case
from tb.reference.converter_walk import walk_reference

TYPICAL = {"corner": "tt", "temperature_c": 27.0}
SHORT = Case(codes=(0, 64, 240), clocks=48)


def world(effects: dict, **tables: dict) -> scene.Scene:
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": {"kind": "uniform", "code": 100}, "effects": effects}
    return scene.from_data(data | tables, Path("chip.toml"))


# ---- files ---------------------------------------------------------------------------------------------------


def test_no_file_is_missing_or_older_than_the_circuit() -> None:
    row = command.stale_row()
    assert row["status"] == "PASS", row["note"]


def test_a_change_of_a_netlist_is_told_by_its_name_and_a_remark_is_none(tmp_path: Path) -> None:
    shutil.copytree(extracted.CIRCUIT, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "as_now.toml"
    path.write_text(extracted.text_of("tt", 27.0, {}))
    mirror = tmp_path / "mirror.sp"
    mirror.write_text(mirror.read_text() + "* a remark\n\n")
    assert extracted.stale(path, tmp_path) == ""
    mirror.write_text(mirror.read_text().replace("w=30 l=12", "w=30 l=13", 1))
    said = extracted.stale(path, tmp_path)
    assert "mirror.sp" in said
    assert "ota.sp" not in said
    assert extracted.AGAIN in said


def test_a_scene_has_the_values_of_the_file_and_its_resolved_copy_the_same() -> None:
    made = world({"extracted": TYPICAL})
    table = read_toml(extracted.path_of("tt", 27.0))["conveyor_mirror_k80"]
    assert {name: p.model_dump() for name, p in made.effects.items() if name != "mirror_ratio"} == {
        name: values for name, values in table.items() if name != "mirror_ratio"
    }
    assert made.effects["mirror_ratio"].ratio_error == table["mirror_ratio"]["ratio_error"]
    again = scene.from_data(tomllib.loads(made.to_toml()), Path("chip.toml"))
    assert again.effects == made.effects


def test_false_leaves_one_out_of_what_was_extracted() -> None:
    both = world({"extracted": TYPICAL}).effects
    without = world({"extracted": TYPICAL, "row_driver": False}).effects
    assert both.keys() - without.keys() == {"row_driver"}


@pytest.mark.parametrize(
    ("effects", "tables", "key"),
    [
        ({"extracted": TYPICAL, "charge_packet": {"packet_error": 0.001}}, {}, "effects.charge_packet"),
        ({"extracted": TYPICAL, "charge_packet": True}, {}, "effects.charge_packet"),
        ({"extracted": {"corner": "tt", "temperature_c": 26.0}}, {}, "effects.extracted"),
        ({"extracted": TYPICAL}, {"interface": {"topology": "direct", "k": 40}}, "effects.extracted"),
        ({"extracted": TYPICAL}, {"interface": {"i0_a": 20e-6}}, "interface.i0_a"),
        ({"extracted": TYPICAL}, {"interface": {"c_int_f": 6e-12}}, "interface.c_int_f"),
    ],
)
def test_what_contradicts_the_file_is_refused_by_its_key(effects: dict, tables: dict, key: str) -> None:
    with pytest.raises(InputError) as refused:
        world(effects, **tables)
    assert refused.value.key == key


def test_no_engine_but_the_closed_one_refuses_any_of_them_and_the_deck_has_their_values() -> None:
    made = plan.make(world({"extracted": TYPICAL}))
    assert not any(engines.refused(made, name) for name in ("event", "rtl", "cosim"))
    lines = netlist.frame_deck(made, 0, [0.0] * (2 + 1 + 2)).lines
    channel = next(line for line in lines if line.startswith("xch0 "))
    for effect, parameter, word in (
        ("mirror_ratio", "ratio_error", "mir_ratio_error"),
        ("charge_packet", "packet_error", "packet_error"),
        ("comparator_delay", "t_s", "comp_t_delay_s"),
        ("column_offset", "v_v", "conv_v_offset_v"),
    ):
        written = float(re.search(rf"\b{word}=(\S+)", channel)[1])
        # 1 + error - 1 has lost what is below 1e-16, and a deck says a dozen digits.
        assert written == pytest.approx(getattr(made.on[effect], parameter), rel=1e-9, abs=1e-15)


@pytest.mark.long
@pytest.mark.parametrize("engine", ["rtl", "cosim"])
def test_every_engine_reads_them_as_it_reads_what_a_scene_says_by_hand(engine: str) -> None:
    # 64, and 0.03 above the step to 241 of an ideal channel: parameters of transistors move that code.
    ohm = [250 * 510 / 64, 250 * 510 / 240.53]
    made = world({"extracted": TYPICAL}, stimulus={"kind": "uniform", "r_ohm": ohm})
    by_event = engines.run(plan.make(made, "event")).codes
    assert (by_event[1] != 241).any(), "the extracted parameters move no code, so nothing is compared"
    # The pole that stands for the comparator's delay in a deck is late by the same time on a ramp (docs/scenes.md).
    assert np.array_equal(engines.run(plan.make(made, engine)).codes, by_event)


# ---- the gate ------------------------------------------------------------------------------------------------


def test_the_lines_of_a_column_foresee_the_codes_of_the_event_engine() -> None:
    """The estimate behind the gate on a column whose codes are known: short gate, event engine, 510 clocks."""
    design, case = design_module.load(), Case()
    made = gate.model(case, design)
    counts = gate.read(gate.model_slots(made, case.clocks)).counts()
    codes = engines.run(made).codes.ravel()
    # A level is known to the distance of the charges that were decided on either side, some hundredths of a packet.
    assert np.all(np.abs(counts - 0.5 - codes) <= 0.6), (counts, codes)


def test_the_charge_of_the_model_is_that_of_the_slow_reference_clock_by_clock() -> None:
    design, case = design_module.load(), Case(codes=(64, 240), clocks=24)
    made = gate.model(case, design)
    g = made.conductance_s()
    cells = event.cells_of(made, made.converter.duty(column_currents(made.network(0), g)), g)
    for row, slot in enumerate(gate.model_slots(made, case.clocks)):
        cell = {f.name: float(getattr(cells, f.name)[0, row, 0]) for f in dataclasses.fields(cells)}
        walk = walk_reference(cell, case.clocks, made.timing.charge_delay_clocks, digits=20)
        assert walk.bits == slot.bits.tolist()
        # What doubles sum up over so few clocks, many times over.
        assert np.allclose(np.array(walk.charge, dtype=float), slot.stored_v[1:], atol=1e-9)


@pytest.fixture(scope="module")
def column(tmp_path_factory) -> list[loop.Slot]:
    """A short column in transistors, which the tests below look at."""
    found = cases.shown([(SHORT, None)], 1, work=tmp_path_factory.mktemp("columns"))[0]
    assert not isinstance(found, str), found
    return found


def test_a_calibrated_model_forgives_a_gain_and_a_start_and_no_bend() -> None:
    slope = np.array([0.0, 20.0, 64.0, 200.0]) / 510
    model = gate.Reading(slope, np.zeros(4), 1.0, 0.0)
    draw = gate.Reading(1.02 * slope, np.full(4, 3.0), 1.0, 0.0)
    bent = dataclasses.replace(draw, slope=draw.slope + np.array([0.0, 0.0, 2.0, 0.0]) / 510)
    apart = [one.counts() - model.like(one, 1, 3).counts() for one in (draw, bent)]
    # Roundings of counts of 200.
    assert np.round(apart, 9).tolist() == [[0.0] * 4, [0.0, 0.0, 2.0, 0.0]]


def test_a_channel_in_transistors_counts_as_the_model_extracted_from_it(column) -> None:
    row = verdict.judge("equivalence.counts_apart", gate.compare(SHORT, column)["worst"])
    assert row["status"] == "PASS", row


def test_the_gate_sees_one_device_of_the_mirror_more(column) -> None:
    design = design_module.load()
    made = gate.model(SHORT, design)
    off = dataclasses.replace(made.converter, gain=made.converter.gain * 80 / 79)
    counts = gate.read(gate.model_slots(dataclasses.replace(made, converter=off), SHORT.clocks)).counts()
    apart = np.abs(gate.read(column).counts() - counts)
    assert verdict.judge("equivalence.counts_apart", apart.max())["status"] == "FAIL"


def test_a_column_of_another_circuit_is_another_column(tmp_path: Path) -> None:
    """What is kept is looked up by what the netlists say, not by where they lie."""
    shutil.copytree(extracted.CIRCUIT, tmp_path, dirs_exist_ok=True)
    assert cases.deck(SHORT, tmp_path).lines == cases.deck(SHORT).lines
    mirror = tmp_path / "mirror.sp"
    mirror.write_text(mirror.read_text().replace("w=30 l=12", "w=30 l=13", 1))
    assert cases.deck(SHORT, tmp_path).lines != cases.deck(SHORT).lines


# ---- seeded faults -------------------------------------------------------------------------------------------


def test_faults_are_many_and_each_is_one_change() -> None:
    every = faults.all_faults()
    assert len(every) >= 40
    assert len({f.name for f in every}) == len(every)
    for fault in every:
        line = (extracted.CIRCUIT / fault.file).read_text().splitlines()[fault.line]
        assert fault.text.split() != line.split(), fault


@pytest.mark.long
def test_a_bench_notices_a_wrong_number_in_the_mirror(tmp_path: Path) -> None:
    fault = next(f for f in faults.all_faults() if f.name == "wrong_ratio.mirror_fixed.xin")
    found = faults.bench(fault, tmp_path)
    assert found.caught
    assert "ratio_error" in found.said


def test_what_is_as_it_should_be_is_not_noticed_and_what_is_not_is() -> None:
    should = {"supply": {"mirror": -226e-6}, "vfc": {"fast_held": 0.5, "slow_comp_to": -1.65}}
    assert not any(faults.at_rest(bench, should[bench], should[bench]) for bench in should)
    for bench, name, value in (
        ("supply", "mirror", -226e-6 * 1.04),
        ("vfc", "fast_held", 0.38),
        ("vfc", "slow_comp_to", 1.65),
    ):
        assert name in faults.at_rest(bench, should[bench] | {name: value}, should[bench])
    values = [extracted.Measured(*name.split("."), 1.0, "") for name in faults.TOLERANCES]
    assert faults.moved(values, values) == ""
    for n, value in enumerate(values):
        absolute, relative = faults.TOLERANCES[f"{value.effect}.{value.parameter}"]
        if np.isfinite(absolute):
            off = dataclasses.replace(value, value=1.0 + 1.1 * (absolute + relative))
            assert value.effect in faults.moved([*values[:n], off, *values[n + 1 :]], values)


@pytest.mark.parametrize(
    ("said", "caught"),
    [
        ("SimulatorError: ngspice at 0 s: singular matrix; tried: plain", True),
        ("ngspice, characterise: did not measure late: out of interval", True),
        ("ngspice, characterise: not done after 90 s", None),
        ("ngspice, characterise: ended by signal 9", None),
        ("hangs: ended after 600 s", None),
    ],
)
def test_what_the_circuit_is_innocent_of_is_not_called_caught(said: str, caught: bool | None) -> None:
    assert faults.loop(said).caught is caught


def test_the_table_of_faults_tells_caught_from_not_noticed_and_not_measured() -> None:
    some = faults.all_faults()[:3]
    found = [
        faults.Found("vfc", "x", True),
        faults.Found("closed loop", "y", False),
        faults.Found("vfc", "z", None),
    ]
    rows = faults.rows_of(some, found)
    assert [row["status"] for row in rows] == ["PASS", "SKIP", "ERROR", "FAIL"]
    assert rows[-1]["value"] == 0.5
