# SPDX-License-Identifier: Apache-2.0
"""Decks in transistors: each block from the folder of its view, refusals, columns apart, and what steps cost."""

import functools
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import dermis
from dermis import engines
from dermis import plan as planning
from dermis.chip import netlist
from dermis.chip.split import SplitHalf, Workers
from dermis.engines import cosim
from dermis.errors import InputError
from dermis.lockstep import ladder
from dermis.lockstep.ngspice import Deck, NgspiceHalf
from dermis.processes import pool
from dermis.records import Plan
from dermis.scene import scene
from dermis.scene.design import TOPOLOGIES
from dermis.scene.views import BLOCKS
from tb.model.made_plans import refused
from tb.reference.chip import Synchronizer

Table = dict[str, object]

UNIT_OHM = 250.0  # V_b / (k i0), so x = 250 / R
LSB = 1 / 510  # of the packets of a gate

LIGHT_OHM = 16e3
"""Code 8: few packets, which are what a deck in transistors takes its time for."""


def make(
    ohm: Sequence[Sequence[float]] | NDArray[np.float64],
    views: object,
    folder: Path,
    effects: Table | None = None,
    interface: Table | None = None,
    engine: str | None = "cosim",
) -> Plan:
    table = np.array(ohm, dtype=float)
    np.save(folder / "taxels.npy", table)
    data = {
        "array": {"rows": table.shape[0], "cols": table.shape[1]},
        "stimulus": {"kind": "resistance", "file": "taxels.npy"},
        "interface": interface or {},
        "effects": effects or {},
        "run": {"views": views, **({"engine": engine} if engine else {})},
    }
    return planning.make(scene.from_data(data, folder / "scene.toml"))


def folders(made: Plan, columns: Sequence[int] | None = None) -> dict[str, str]:
    """By file: the folder of spice/ that a deck includes it from."""
    levels = [0.0] * (made.rows + 1 + made.cols)
    lines = netlist.frame_deck(made, 0, levels, columns=columns).lines
    found = (re.search(r"/spice/(\w+)/(\w+)\.(?:sp|inc)", line) for line in lines if ".include" in line)
    return {match[2]: match[1] for match in found if match}


@pytest.mark.parametrize("block", BLOCKS)
def test_a_block_comes_from_the_folder_of_its_view(block: str, tmp_path: Path) -> None:
    got = folders(make([[500.0]], {"default": "behavioural", block: "sky130"}, tmp_path))
    assert {name for name in BLOCKS if got[name] == "sky130"} == {block}
    channel = "channel_switched" if block == "conveyor" else "channel_conveyor_mirror"
    assert got["mirror"] == got["conveyor"] == got[channel]
    assert got["vfc"] == "behavioural"


MODELS = {"blocks": "behavioural"}


def test_views_of_all_blocks_and_of_some_columns(tmp_path: Path) -> None:
    assert set(folders(make([[500.0]], "sky130", tmp_path)).values()) == {"sky130"}
    assert folders(make([[500.0]], "behavioural", tmp_path)) == MODELS
    made = make([[500.0] * 4], {"columns": [2]}, tmp_path)
    assert netlist.parts(made) == ((), (2,), (0, 1, 3))
    assert folders(made, (2,))["integrator"] == "sky130"
    assert folders(made, (0, 1, 3)) == MODELS
    got = folders(made, ())
    assert (got["row_driver"], got["integrator"], got["conveyor"]) == ("sky130", "behavioural", "behavioural")


def test_columns_are_apart_only_behind_conveyors_without_lateral_resistors(tmp_path: Path) -> None:
    ohm = [[500.0] * 3]
    assert netlist.parts(make(ohm, "sky130", tmp_path)) == ((), (0,), (1,), (2,))
    models = {"default": "sky130", "row_driver": "behavioural"}
    assert netlist.parts(make(ohm, models, tmp_path)) == ((0,), (1,), (2,))
    # Rows that move while a gate is open stay with the columns.
    assert netlist.parts(make(ohm, "sky130", tmp_path, {"supply_ripple": True})) == ((0,), (1,), (2,))
    assert netlist.parts(make(ohm, "behavioural", tmp_path)) == ((0, 1, 2),)
    assert netlist.parts(make(ohm, "sky130", tmp_path, {"lateral": True})) == ((0, 1, 2),)
    assert netlist.parts(make(ohm, "sky130", tmp_path, interface={"topology": "direct"})) == ((0, 1, 2),)


def test_the_conditions_reach_the_deck_and_the_resolved_scene(tmp_path: Path) -> None:
    views = {"corner": "ss", "temperature_c": -40.0, "supply_scale": 0.9}
    made = make([[500.0]], views, tmp_path)
    lines = netlist.frame_deck(made, 0, [1.0, 1.0, 0.0]).lines
    assert any(re.search(r'\.include ".*/ss_\w+\.spice"', line) for line in lines)
    assert ".temp -40.0" in lines
    supplies = {line.split()[0]: float(line.split()[-1]) for line in lines if re.match(r"v(dd|ss) ", line)}
    assert supplies == pytest.approx({"vdd": 1.485, "vss": -1.485})
    (tmp_path / "again.toml").write_text(made.resolved_toml(tmp_path))
    again = planning.load(tmp_path / "again.toml")
    assert (again.views, again.engine) == (made.views, "cosim")


DIRECT = {"topology": "direct"}


@pytest.mark.parametrize(
    ("views", "effects", "interface", "key"),
    [
        *(({}, {name: True}, {}, f"effects.{name}") for name in ("mirror_ratio", "integrator_range",
          "comparator_offset", "charge_packet", "row_driver", "column_input")),
        ({"charge_source": "behavioural"}, {"charge_packet": True}, {}, "effects.charge_packet"),
        ({}, {}, {"i0_a": 20e-6}, "interface.i0_a"),
        ({"row_driver": "sky130", "default": "behavioural"}, {}, {"v_bias_v": 1.7}, "interface.v_bias_v"),
        ({}, {}, {"c_int_f": 10e-12}, "interface.c_int_f"),
        ({}, {}, DIRECT | {"k": 40}, "interface.k"),
        ({"comparator": "behavioural"}, {}, DIRECT, "run.views.comparator"),
        ({"columns": [0]}, {}, DIRECT, "run.views.columns"),
        ({"columns": [0]}, {"lateral": True}, {}, "run.views.columns"),
        ({"default": "behavioural", "corner": "ss"}, {}, {}, "run.views.corner"),
        ({"default": "behavioural", "supply_scale": 0.9}, {}, {}, "run.views.supply_scale"),
        ({"default": "behavioural", "columns": [0]}, {}, {}, "run.views.columns"),
        ({"default": "behavioural", "conveyor": "sky130", "corner": "ss"}, {}, DIRECT, "run.views.corner"),
    ],
)  # fmt: skip
@pytest.mark.paper
def test_what_transistors_cannot_do_is_refused_by_name(
    views: Table, effects: Table, interface: Table, key: str, tmp_path: Path
) -> None:
    for engine in ("cosim", None):
        given = [[500.0, 500.0]], views, tmp_path, effects, interface, engine
        assert refused(lambda given=given: engines.check(make(*given))).key == key


@pytest.mark.paper
@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"converter": {"i0_a": 20e-6}, "interface": {"v_bias_v": 0.4}},
            r"i0_a = 2e-05: 2\.5e-05, the size of",
        ),
        ({"interface": {"topology": "direct", "k": 160}}, "k = 160: 80, the size of the sky130 channel"),
    ],
)
def test_transistors_are_those_that_are_drawn_whatever_the_design(
    changed: Table, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "drawn.toml"
    path.write_text(
        '[array]\nrows = 1\ncols = 1\n[stimulus]\nkind = "uniform"\nr_ohm = [1e3]\n[run]\nviews = "sky130"'
    )
    with pytest.raises(InputError, match=said):
        dermis.simulate(path, engine="cosim", design=changed)


def test_a_block_that_is_a_model_takes_its_effects(tmp_path: Path) -> None:
    views = {"default": "behavioural", "row_driver": "sky130"}
    engines.check(make([[500.0]], views, tmp_path, {"charge_packet": True, "column_input": True}))
    engines.check(make([[500.0]], {"row_driver": "behavioural"}, tmp_path, {"row_driver": True}))


def test_only_decks_have_views(tmp_path: Path) -> None:
    """Left to choose, a plan takes cosim; another engine is refused rather than read as ideal blocks."""
    assert make([[500.0]], "sky130", tmp_path, engine=None).engine == "cosim"
    for name in ("closed", "event", "rtl"):
        made = make([[500.0]], "sky130", tmp_path, engine=name)
        assert refused(engines.run, made).key == "run.engine"
    assert scene.with_views(made.scene, "behavioural").table.run.views == "behavioural"
    table = make([[500.0]], {"comparator": "behavioural"}, tmp_path)
    assert refused(scene.with_views, table.scene, "behavioural").key == "--views"


@pytest.mark.paper
def test_verilog_reads_a_column_in_transistors_beside_a_model(tmp_path: Path) -> None:
    """Lock-step with the Verilog in two processes of ngspice. The offset of the channel may be some LSB
    (sky130.chain_offset_lsb), its gain 2 %: code 8 is 7 to 10."""
    made = make([[LIGHT_OHM, LIGHT_OHM]], {"columns": [1]}, tmp_path)
    result = cosim.run(made)
    model, transistors = (int(code) for code in result.codes[0, 0])
    assert model == 8
    assert 7 <= transistors <= 10
    # the start of transistors is on record, never silent
    assert [retry["next"] for retry in result.info["retries"]["frame 0"]] == ["gmin_stepping"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("topology", "views"),
    [(topology, "sky130") for topology in TOPOLOGIES]
    + [("conveyor_mirror", {"default": "behavioural", block: "sky130"}) for block in BLOCKS],
)
def test_every_interface_and_block_in_transistors_reads(topology: str, views: object, tmp_path: Path) -> None:
    made = make([[2e3]], views, tmp_path, interface={"topology": topology})
    assert abs(int(cosim.run(made).codes[0, 0, 0]) - 64) <= 3  # 2 % of gain and some LSB of offset


CLOCKS = 100
SETTLE = 20
"""Clocks of preset: nothing has to settle before the first row."""


def charge(decks: dict[tuple[int, ...], Deck], made: Plan, folder: Path) -> NDArray[np.float64]:
    """Charge that has flown into every integrator, in packets, [CLOCKS, cols]; NaN while a packet flows out.

    What has flown in is what was drawn plus what is on the capacitor, so two
    solutions can be compared to far below a count, and where they decide differently as well.
    """
    cols, t_clk = made.cols, 1.0 / made.timing.f_clk_hz
    workers = Workers()
    times = {"t_edge_s": 1e-9, "t_max_step_s": 1e-6, "t_stop_s": CLOCKS * t_clk}
    options = {"log": folder / "ngspice.log", "record": True, "level": ladder.Level(start=1)}
    half = SplitHalf(decks, made.rows, workers, **times, **options)
    edges: list[tuple[float, int, float]] = []
    low = np.zeros(cols, dtype=bool)
    flops = Synchronizer(low)
    drawn, busy = np.zeros((CLOCKS, cols)), np.zeros((CLOCKS, cols), dtype=bool)
    total = np.zeros(cols)
    for clock in range(1, CLOCKS + 1):
        now = clock * t_clk
        comparator = half.advance(now, edges) > 0.0
        busy[clock - 1] = old = flops.charge
        total = total + old
        drawn[clock - 1] = total
        flops.clock(comparator if clock >= SETTLE else low)
        switch = flops.charge
        edges = [(now, made.rows + 1 + int(c), float(switch[c])) for c in np.flatnonzero(switch != old)]
        if clock == SETTLE:
            edges.append((now, made.rows, 0.0))
    time, waves = half.waveform()
    half.close()
    workers.close()
    at = np.arange(1, CLOCKS + 1) * t_clk
    v_int = np.stack([np.interp(at, time, waves[f"xch{c}.xvfc.v_int"]) for c in range(cols)], axis=1)
    return np.where(busy, np.nan, drawn - v_int / made.converter.packet_v())


def decks(made: Plan, parts: Sequence[tuple[int, ...] | None]) -> dict[tuple[int, ...], Deck]:
    """A circuit of each part, or one of all."""
    levels = [1.0] + [0.0] * (made.rows - 1) + [1.0] + [0.0] * made.cols
    every = tuple(range(made.cols))
    deck = functools.partial(netlist.frame_deck, made, 0, levels, record=True)
    return {every if part is None else part: deck(columns=part) for part in parts}


def error_lsb(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Largest difference of two charges at the end of a gate of 510 clocks, by a straight line through those here."""
    worst = 0.0
    for difference in (one - other)[SETTLE:].T:
        known = np.flatnonzero(np.isfinite(difference))
        slope, start = np.polyfit(known, difference[known], 1)
        worst = max(worst, abs(start), abs(start + slope / LSB))
    return float(worst)


SPLIT_LSB = 0.1
"""Twice what steps leave in either solution, 0.02 LSB, and the virtual grounds' 0.003 (netlist._far_column)."""


@pytest.mark.long
@pytest.mark.timeout(900)  # a minute of an idle core
def test_columns_apart_are_as_columns_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two columns and a driver in one circuit and in three; and without what both draw from the row the check fails."""
    made = make([[500.0, 1e3]], "sky130", tmp_path)
    parts = netlist.parts(made)
    assert len(parts) == 3
    whole = charge(decks(made, [None]), made, tmp_path)
    assert error_lsb(charge(decks(made, parts), made, tmp_path), whole) <= SPLIT_LSB
    monkeypatch.setattr(netlist, "_far_column", lambda plan, network, c: [f"rfar{c} col{c} 0 1e12"])
    assert error_lsb(charge(decks(made, parts), made, tmp_path), whole) > SPLIT_LSB


def _start(deck: Deck, log: Path) -> list[float]:
    os.chdir(log.parent)  # the transistor model writes a file in its working directory
    half = NgspiceHalf(deck, t_edge_s=1e-9, t_max_step_s=2e-7, t_stop_s=1e-6, log=log)
    return half.advance(0.0, []).tolist()


@pytest.mark.parametrize("corner", [{"corner": "ss", "supply_scale": 0.9}, {"corner": "tt"}])
def test_row_drivers_start_where_leakage_is_least(tmp_path: Path, corner: Table) -> None:
    """At -40 C a node between open transistors had no operating point, by any method."""
    made = make([[1e3, 2e3], [505.0, 64e3]], {"temperature_c": -40.0} | corner, tmp_path)
    deck = netlist.frame_deck(made, 0, [0.5, 0.0, 1.0, 0.0, 0.0], columns=())
    with pool.workers(1) as executor:
        rows = executor.submit(_start, deck, tmp_path / "ngspice.log").result()
    assert rows == pytest.approx([0.5, 0.0], abs=5e-3)  # 2 mA of both taxels through 1 ohm
