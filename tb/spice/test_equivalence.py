# SPDX-License-Identifier: Apache-2.0
"""The files of models/extracted against the circuit, how a scene takes them, and the gate on one short column."""

import dataclasses
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import dermis
from dermis import engines, plan
from dermis.array.array import column_currents
from dermis.chip import netlist
from dermis.converter import walk
from dermis.converter.coupling import on_columns
from dermis.errors import InputError
from dermis.report import verdict
from dermis.scene import extracted, scene
from dermis.scene.schema import read_toml
from scripts.characterise.benches import BENCHES
from tb.programs.equivalence import columns, command, faults, gate
from tb.programs.equivalence.gate import Case
from tb.reference.converter_walk import walk_reference

pytestmark = pytest.mark.paper  # the circuits are drawn and measured for it

TYPICAL = {"corner": "tt", "temperature_c": 27.0}


def world(effects: dict, **tables: dict) -> scene.Scene:
    data = {"array": {"rows": 2, "cols": 2}, "stimulus": {"kind": "uniform", "code": 100}, "effects": effects}
    return scene.from_data(data | tables, Path("chip.toml"))


@pytest.fixture
def longer_mirror(tmp_path: Path) -> Path:
    """A copy of spice/sky130 with a remark more and a device longer."""
    shutil.copytree(extracted.CIRCUIT, tmp_path, dirs_exist_ok=True)
    mirror = tmp_path / "mirror.sp"
    mirror.write_text(mirror.read_text().replace("w=30 l=12", "w=30 l=13", 1))
    ota = tmp_path / "ota.sp"
    ota.write_text(ota.read_text() + "* a remark\n\n")
    return tmp_path


# ---- files ---------------------------------------------------------------------------------------------------


def test_no_file_is_missing_or_older_than_the_circuit() -> None:
    row = command.stale_row()
    assert row["status"] == "PASS", row["note"]


def test_a_change_of_a_netlist_is_reported_by_its_name_but_a_remark_is_not(longer_mirror: Path) -> None:
    said = extracted.stale(extracted.path_of("tt", 27.0), longer_mirror)
    assert "mirror.sp" in said
    assert "ota.sp" not in said
    assert extracted.AGAIN in said


def test_a_scene_warns_of_values_that_are_older_than_the_circuit(
    longer_mirror: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extracted.stale, "__defaults__", (longer_mirror, True))
    with pytest.warns(UserWarning, match=r"changed since \(mirror.sp\)"):
        world({"extracted": TYPICAL})


def test_a_scene_has_the_values_of_the_file_and_its_resolved_copy_the_same() -> None:
    made = world({"extracted": TYPICAL})
    table = read_toml(extracted.path_of("tt", 27.0))["conveyor_mirror_k80"]
    for name, values in table.items():
        assert values.items() <= made.effects[name].model_dump().items()
    assert made.effects.keys() == table.keys()
    again = scene.from_data(tomllib.loads(made.to_toml()), Path("chip.toml"))
    assert again.effects == made.effects
    without = world({"extracted": TYPICAL, "row_driver": False}).effects
    assert table.keys() - without.keys() == {"row_driver"}


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


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("converter", "c_int_f", 1e-11), ("converter", "f_clk_hz", 10e6), ("supply", "vdd_v", 1.8)],
)
def test_a_design_that_the_circuit_was_not_measured_with_is_refused(
    section: str, key: str, value: float
) -> None:
    data = {"array": {"rows": 1, "cols": 1}, "stimulus": {"kind": "uniform", "r_ohm": [1000.0]}}
    with pytest.raises(
        InputError, match=f"{key} = .* with effects.extracted: the circuit was measured with it"
    ):
        dermis.simulate(data | {"effects": {"extracted": TYPICAL}}, design={section: {key: value}})


def test_values_written_by_hand_are_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = shutil.copy(extracted.path_of("tt", 27.0), tmp_path)
    text = Path(path).read_text()
    Path(path).write_text(text.replace("packet_error = -", "packet_error = ", 1))
    monkeypatch.setattr(extracted, "FOLDER", tmp_path)
    with pytest.warns(UserWarning, match="values were written by hand"):
        world({"extracted": TYPICAL})


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
    """The estimate of the gate on a column whose codes are known: short gate, event engine, 510 clocks."""
    case = Case()
    made = gate.model(case)
    counts = gate.counts(gate.read(gate.model_slots(made, case.clocks)))
    codes = engines.run(made).codes.ravel()
    # A level is known to the distance of the charges that were decided on either side, some hundredths of a packet.
    assert np.all(np.abs(counts - 0.5 - codes) <= 0.6), (counts, codes)


def test_the_charge_of_the_model_is_that_of_the_slow_reference_clock_by_clock() -> None:
    case = Case(codes=(64, 240), clocks=24)
    made = gate.model(case)
    g = made.conductance_s()
    cells = walk.cells_of(made, made.converter.duty(column_currents(made.network(0), g)), on_columns(g))
    for row, slot in enumerate(gate.model_slots(made, case.clocks)):
        cell = {f.name: float(getattr(cells, f.name)[0, row, 0]) for f in dataclasses.fields(cells)}
        exact = walk_reference(cell, case.clocks, made.timing.charge_delay_clocks, digits=20)
        assert exact.bits == slot.bits.tolist()
        # What doubles sum up over so few clocks, many times over.
        assert np.allclose(np.array(exact.charge, dtype=float), slot.stored_v[1:], atol=1e-9)


@pytest.fixture(scope="module")
def column(tmp_path_factory: pytest.TempPathFactory) -> list[columns.Slot]:
    """A short column in transistors."""
    found = columns.records([faults.LOOP.column()], 1, work=tmp_path_factory.mktemp("columns"))[0]
    assert not isinstance(found, str), found
    return found


def test_a_channel_in_transistors_counts_as_the_model_extracted_from_it(column: list[columns.Slot]) -> None:
    row = command.gate_row(faults.LOOP, column)
    assert row["status"] == "PASS", row
    assert command.fault_row("none", column)["status"] == "SKIP"
    assert command.fault_row("none", "hangs: ended after 600 s")["status"] == "ERROR"


def test_the_gate_sees_one_device_of_the_mirror_more(column: list[columns.Slot]) -> None:
    made = gate.model(faults.LOOP)
    off = dataclasses.replace(made.converter, gain=made.converter.gain * 80 / 79)
    slots = gate.model_slots(dataclasses.replace(made, converter=off), faults.LOOP.clocks)
    apart = np.abs(gate.counts(gate.read(column)) - gate.counts(gate.read(slots)))
    assert verdict.judge("equivalence.counts_apart", apart.max())["status"] == "FAIL"
    assert command.fault_row("none", slots)["status"] == "PASS"


def test_a_column_of_another_circuit_is_another_column(longer_mirror: Path, tmp_path: Path) -> None:
    """A record is looked up by the text of the netlists, not by their place."""
    ours, other = (faults.LOOP.column(blocks).name for blocks in (None, longer_mirror))
    faulty = {faults.LOOP.column(faults.written(kind, tmp_path)).name for kind in faults.FAULTS}
    assert len({ours, other, *faulty}) == 2 + len(faults.FAULTS)
    shutil.copy(extracted.CIRCUIT / "mirror.sp", longer_mirror)
    assert faults.LOOP.column(longer_mirror).name == ours


# ---- faults by rule ------------------------------------------------------------------------------------------


def test_every_rule_makes_a_change_of_one_line() -> None:
    found = faults.by_rule()
    kinds = {re.sub(r"\d", "", fault.kind) for fault in found}
    assert kinds == {"missing", "half", "oxide", "bulk", "rail", "neighbour"}
    assert len({fault.name for fault in found}) == len(found) > 400
    for fault in found:
        assert fault.wrong != fault.line
        assert fault.wrong == "" or fault.wrong.split()[0] == fault.line.split()[0]


# What an outsider found to pass everything, the slow ones last.
FOUND = (
    "level_down.xfirst.oxide", "dermis_analog_front_end.xbias.rail1", "bias_line.xc_line.rail2",
    "bias.xc_gate.rail1", "conveyor.xc_amp.rail2", "dermis_analog_front_end.xr_high.half",
    "dermis_analog_front_end.xsense0.neighbour1", "dermis_analog_front_end.xcolumn0.neighbour1",
    "test_current.xs_taxel.rail5",
)  # fmt: skip


@pytest.mark.parametrize("name", [FOUND[0], *(pytest.param(n, marks=pytest.mark.long) for n in FOUND[1:])])
def test_what_an_outsider_seeded_is_noticed(name: str, tmp_path: Path) -> None:
    (fault,) = [fault for fault in faults.by_rule() if fault.name == name]
    assert faults.noticed(fault, tmp_path).partition(":")[0] in BENCHES
