# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis synth`: the small chip passes, and each row fails on the fault it is there for."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from dermis.chip.sources import rtl_sources
from dermis.errors import SimulatorError
from dermis.report import verdict
from dermis.scene.design import load as load_design
from scripts.synth import cells as synth_cells
from scripts.synth import command as synth
from scripts.synth import map as synth_map
from scripts.synth import timing as synth_timing
from scripts.synth.cells import TECHNOLOGIES, areas, cells, mapping_liberty
from scripts.synth.equivalence import Proof, prove
from scripts.synth.map import RAM, Netlist, Size, map_design, map_once
from scripts.synth.timing import Timing

pytestmark = pytest.mark.timeout(240)
LIBRARY = synth_cells.OSU035 / "osu035_stdcells.lib"
needs_osu035 = pytest.mark.skipif(not LIBRARY.is_file(), reason="qflow-tech-osu035 of Debian is not there")
needs_sta = pytest.mark.skipif(shutil.which("sta") is None, reason="opensta of Debian is not installed")
OSU035 = TECHNOLOGIES["osu035"]
COUNTER = "dermis_gated_counter"
SYNC = "dermis_sync_latch"
SIZE = Size(2, 2)

Edit = Callable[[str], str]
Chip = tuple[list[verdict.Row], Netlist]


def block(tmp_path: Path, module: str = COUNTER, edit: Edit = lambda text: text) -> Netlist:
    """One module mapped in osu035, of files of which one is changed."""
    files = []
    for path in rtl_sources():
        new = tmp_path / path.name
        new.write_text(edit(path.read_text()) if path.stem == module else path.read_text())
        files.append(new)
    return map_design(OSU035, {}, tmp_path / "out", top=module, sources=files)


def status(rows: list[verdict.Row]) -> dict[str, str]:
    return {row["name"].split(".")[1]: row["status"] for row in rows}


def judged(netlist: Netlist, latches: int = 0) -> dict[str, str]:
    size = Size(1, max(latches, 1), sync_latch=latches > 0)
    return status(synth.netlist_rows(netlist, size, "x", memory=False))


@pytest.fixture(scope="module")
def chip(tmp_path_factory: pytest.TempPathFactory) -> Chip:
    """A small chip after all that `dermis synth` does with it."""
    directory = tmp_path_factory.mktemp("chip")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synth, "place", lambda technology, size, what="": directory / f"{size.name}{what}")
        rows = synth.synthesise(OSU035, SIZE)
        return rows, map_once(OSU035, SIZE.parameters, synth.place(OSU035, SIZE))


@pytest.mark.long
@needs_osu035
@needs_sta
def test_a_small_chip_maps_is_proved_equal_and_meets_its_clocks(chip: Chip) -> None:
    rows, flat = chip
    assert [row for row in rows if row["status"] != "PASS"] == []
    found = set(status(rows))
    assert {"latch_count_error", "unreset_flop_error", "not_equivalent"} <= found
    assert {"setup_slack_ns", "hold_slack_ns", "crossing_slack_ns"} <= found
    assert flat.latches == SIZE.memory_bits
    assert flat.unreset == SIZE.memory_flops
    assert flat.fanout[0] > 4


@needs_osu035
def test_a_block_passes_every_count_and_its_latch_is_the_library_s(tmp_path: Path) -> None:
    made = block(tmp_path)
    assert set(judged(made).values()) == {"PASS"}
    assert made.flops == load_design().timing.code_bits + 2
    assert made.area_um2 > made.flops * 704
    made = block(tmp_path, SYNC)
    assert made.kinds["LATCH"] == made.latches == 1
    assert set(judged(made, latches=1).values()) == {"PASS"}
    assert [judged(made, latches=n)["latch_count_error"] for n in (0, 2)] == ["FAIL", "FAIL"]
    # Liberty says 0 of it; its LEF does not.
    assert areas(OSU035, cells(OSU035.liberty("typical")))["LATCH"] == pytest.approx(11.2 * 20)


@pytest.mark.parametrize(("module", "latch"), [(COUNTER, 0), (SYNC, 1)])
def test_a_block_maps_to_sky130_and_is_proved_equal(tmp_path: Path, module: str, latch: int) -> None:
    sky130 = TECHNOLOGIES["sky130"]
    made = map_design(sky130, {}, tmp_path, top=module)
    assert made.kinds["sky130_fd_sc_hd__dlrtn_1"] == made.latches == latch
    assert made.kinds["sky130_fd_sc_hd__dfrtp_1"] == made.flops
    assert set(judged(made, latches=latch).values()) == {"PASS"}
    assert prove(made, {}, tmp_path / "proof", top=module).proved is True


@needs_osu035
@pytest.mark.parametrize(
    ("stored", "row"),
    [
        ("always @* if (gate_i) stored = pulse_i;", "inferred_latches"),
        ("always @(posedge clk_i) stored <= pulse_i;", "unreset_flop_error"),
    ],
)
def test_a_latch_and_a_flop_without_reset_are_seen(tmp_path: Path, stored: str, row: str) -> None:
    def fault(verilog: str) -> str:
        used = "assign count_o = count_q ^ {CODE_BITS{stored}};"
        changed = verilog.replace("assign count_o = count_q;", used)
        return changed.replace("endmodule", f"reg stored; {stored}\nendmodule")

    assert judged(block(tmp_path, edit=fault))[row] == "FAIL"


@needs_osu035
def test_a_combinational_loop_is_an_error_and_no_netlist(tmp_path: Path) -> None:
    fault = lambda text: text.replace(  # noqa: E731
        "assign rising = pulse_i & ~pulse_q;",
        "wire ring; assign ring = pulse_i & ~(ring & pulse_q); assign rising = ring;",
    )
    with pytest.raises(SimulatorError, match="check -assert"):
        block(tmp_path, edit=fault)


@needs_osu035
def test_the_memory_can_stay_a_black_box_and_the_hierarchy_be_kept(tmp_path: Path) -> None:
    def made(place: str, **options: bool) -> Netlist:
        return map_design(OSU035, {"BANK_BYTES": 9}, tmp_path / place, top="dermis_frame_buffer", **options)

    bare, whole, split = made("bare", black_box_memory=True), made("whole"), made("split", hierarchical=True)
    assert (bare.kinds[RAM], bare.unreset, bare.unmapped) == (2, 0, {})
    assert "#(" not in bare.verilog.read_text()
    assert whole.unreset == whole.flops - bare.flops == 2 * (1 + 4 + 8)
    assert (whole.latches, bare.latches) == (2 * 9 * 8, 0)
    memory, top = split.blocks[RAM], split.blocks["dermis_frame_buffer"]
    assert (memory["instances"], memory["latches"], top["flops"]) == (2, 2 * 9 * 8, whole.flops)
    assert top["area_um2"] == split.area_um2 > memory["area_um2"]


@needs_osu035
@pytest.mark.parametrize(
    ("module", "faults"),
    [
        (
            COUNTER,
            [
                ("  NAND2X1 ", "  NOR2X1 "),
                (".R(rst_ni)", ".R(1'b1)"),
                (".R(rst_ni),\n    .S(1'b1)", ".R(1'b1),\n    .S(rst_ni)"),
                (".CLK(clk_i)", ".CLK(gate_i)"),
            ],
        ),
        (SYNC, [("  NAND2X1 ", "  AND2X1 ")]),
    ],
)
def test_a_netlist_is_proved_equal_and_a_changed_one_not(tmp_path: Path, module: str, faults: list) -> None:
    made, changed = block(tmp_path, module), tmp_path / "changed.v"
    right = made.verilog.read_text()
    for old, new in [("", ""), *faults]:
        assert old in right
        changed.write_text(right.replace(old, new, 1))
        proof = prove(dataclasses.replace(made, verilog=changed), {}, tmp_path / "proof", top=module)
        assert proof.proved is (old == new), old


def test_an_undecided_proof_is_an_error_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(synth, "prove", lambda *a, **k: Proof(None, 1, 0, 1, "Networks are UNDECIDED"))
    netlist = Netlist(OSU035, tmp_path, tmp_path / "n.v", tmp_path / "n.json")
    assert synth.equivalence_row(netlist, SIZE, "x")["status"] == "ERROR"


PATH_TEXT = """\
Startpoint: a_reg (rising edge-triggered flip-flop clocked by clk)
Endpoint: b_reg (rising edge-triggered flip-flop clocked by clk)
Path Group: clk
Path Type: max

   0.0000    0.0000 ^ a_reg/CLK (DFFSR)
   0.5000    0.5000 ^ a_reg/Q (DFFSR)
   0.2000    0.7000 v _1_/Y (NAND2X1)
   0.0000    0.7000 v b_reg/D (DFFSR)
             0.7000   data arrival time
---------
             {slack}   slack (MET)
"""


@needs_osu035
@pytest.mark.parametrize(
    "says",
    [
        PATH_TEXT.format(slack="12.5000") + "sta ended",
        "Error: no such file",
        "Warning: net a has no driver\nsta ended",
    ],
)
def test_a_report_without_all_paths_is_an_error_and_no_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, says: str
) -> None:
    program = tmp_path / "sta"
    program.write_text(f"#!/bin/sh\ncat <<'end'\n{says}\nend\n")
    program.chmod(0o755)
    monkeypatch.setattr(synth_timing, "tool", lambda *names: str(program))
    netlist = Netlist(OSU035, tmp_path, tmp_path / "n.v", tmp_path / "n.json")
    rows: list[verdict.Row] = []
    with synth.attempt(rows, "synth.timing.x"):
        synth.timing_rows(netlist, "x")
    assert [row["status"] for row in rows] == ["ERROR"]


def test_the_shortest_period_is_found_on_a_bent_line(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[float] = []

    def worst(self: Timing, periods: dict[str, float]) -> dict[tuple[str, str], synth_timing.Path_]:
        tried.append(periods["clk"])
        # OpenSTA reports slack with four decimals.
        said = {c: PATH_TEXT.format(slack=f"{min(0.4 * t - 2.0, t - 8.0):.4f}") for c, t in periods.items()}
        return {(clock, "max"): synth_timing.parse(text)["clk", "max"] for clock, text in said.items()}

    monkeypatch.setattr(Timing, "worst", worst)
    timing = Timing(OSU035, "typical", Path(), Path())
    for start in (200.0, 2.0):
        found = timing.highest({"clk": start, "sck": 50.0})
        # The search stops within 0.2 %.
        assert [period_ns for period_ns, _ in found.values()] == pytest.approx([8.0, 8.0], rel=2e-3)
    assert len(tried) < 25


def test_the_constraints_hold_the_design_s_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [row["status"] for row in synth.constraint_rows()] == ["PASS"]
    monkeypatch.setattr(synth, "sdc_periods", lambda: {"clk": 250.0, "sck": 50.0})
    assert [row["status"] for row in synth.constraint_rows()] == ["FAIL"]


@pytest.mark.long
@needs_osu035
@needs_sta
def test_a_crossing_longer_than_a_period_and_derates_are_seen(chip: Chip, tmp_path: Path) -> None:
    plain = Timing(OSU035, "typical", chip[1].verilog, tmp_path)
    found = plain.crossings(synth.sdc_periods() | {"clk": 1.0})
    assert found["clk"].slack_ns < 0 < found["sck"].slack_ns
    assert found["sck"].start.startswith("u_frame_buffer.")
    careful = dataclasses.replace(plain, technology=dataclasses.replace(OSU035, early=0.5, late=1.5))
    slack, derated = (one.worst(synth.sdc_periods()) for one in (plain, careful))
    assert all(derated[key].slack_ns < slack[key].slack_ns - 0.1 for key in slack)


def test_a_netlist_is_mapped_again_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def fake(technology: synth_cells.Technology, parameters: object, directory: Path) -> Netlist:
        made.append(technology.name)
        for name in ("netlist.v", "netlist.json"):
            (directory / name).write_text("{}")
        return Netlist(technology, directory, directory / "netlist.v", directory / "netlist.json")

    def mapped(rows: int = 2, **changes: int) -> bool:
        before = len(made)
        map_once(dataclasses.replace(TECHNOLOGIES["sky130"], **changes), {"ROWS": rows}, tmp_path)
        return len(made) > before

    monkeypatch.setattr(synth_map, "map_design", fake)
    monkeypatch.setattr(synth_map, "read_netlist", lambda *a: None)
    assert [mapped(), mapped(), mapped(rows=3), mapped(fanout=5)] == [True, False, True, True]
    assert [mapped(), mapped()] == [True, False]
    (tmp_path / "netlist.v").write_text("{ }")
    assert mapped()


@needs_osu035
def test_cells_not_to_use_are_gone_from_the_mapping_library(tmp_path: Path) -> None:
    full = cells(OSU035.liberty("typical"))
    left = cells(mapping_liberty(OSU035, tmp_path / "map.lib"))
    assert {"PADINC", "TBUFX1", "LATCH"} <= full.keys() - left.keys()
    assert (left["DFFSR"].flop, left["DFFSR"].asynchronous) == (True, {"R", "S"})
    assert left["NAND2X1"].inputs == {"A", "B"}
    assert full["INVX1"] == left["INVX1"]


def test_a_pin_that_nothing_constrains_is_listed_unless_it_is_argued(tmp_path: Path) -> None:
    at, log = Timing(OSU035, "typical", tmp_path, tmp_path), tmp_path / "sta_typical.log"
    said = "Warning: There is 1 unclocked register/latch pin.\n  u_spi.begun_q_reg/CLK\n"
    log.write_text(f"...\nsetup check\n{said}sta ended\n")
    assert at.untimed() == []
    log.write_text(f"...\nsetup check\n{said}  u_packer.index_q_reg/CLK\nsta ended\n")
    assert at.untimed() == ["u_packer.index_q_reg/CLK"]
    log.write_text(said)
    with pytest.raises(SimulatorError):
        at.untimed()


def test_the_table_of_sizes_has_a_memory_that_is_not_mapped() -> None:
    values = {"cells.t.8x8.no_memory": 40, "flops.t.8x8.no_memory": 9, "area_um2.t.8x8.no_memory": 1e5}
    values |= {"memory_um2.t.8x8": 2e5, "highest_mhz.clk.t.8x8": 30.04, "highest_mhz.sck.t.8x8": 20.0}
    mapped = {"area_um2.t.8x8": 2.5e5, "cells.t.8x8": 99, "flops.t.8x8": 30}
    for more, end in (
        ({}, "0.1000 | 0.3000 | 30.0 | 20.0 | no |"),
        (mapped, "0.1000 | 0.2500 | 30.0 | 20.0 | yes |"),
    ):
        rows = [verdict.report(f"synth.{name}", value, "1") for name, value in (values | more).items()]
        assert synth.sizes_table(rows).splitlines()[2:] == [f"| t | 8x8 | 40 | 9 | {end}"]
