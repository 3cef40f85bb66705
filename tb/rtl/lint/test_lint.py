# SPDX-License-Identifier: Apache-2.0
"""Claims about `dermis lint`: clean on rtl/, and every tool's row fails on a fault that this tool can see."""

import importlib.util
import re
import shutil
import sys
from pathlib import Path

import pytest

from dermis.errors import InputError, SimulatorError
from scripts import crossings, lint
from scripts.markdown import filled

pytestmark = pytest.mark.timeout(120)
ROOT = Path(__file__).resolve().parents[3]
TOOLS = ("icarus", "verilator", "yosys")
PROGRAMS = ("iverilog", "verilator_bin", "yosys")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of rtl/ to break."""
    shutil.copytree(ROOT / "rtl", tmp_path / "rtl")
    return tmp_path


def edit(root: Path, module: str, old: str, new: str) -> None:
    path = root / "rtl" / f"{module}.v"
    path.write_text(filled(path.read_text(), {old: new}, path.name))


def status(root: Path, *configurations: str) -> dict[str, str]:
    """The rows by name, of the default form only unless others are asked for."""
    return {row["name"]: row["status"] for row in lint.run_lint(root, configurations or ("sync_ff",))}


# `make lint` runs all; the largest takes as long as the rest together.
FORMS = ("sync_ff", "sync_latch", "8x8", "1x16_16bit")


def test_rtl_is_clean_in_every_tool() -> None:
    rows = lint.run_lint(configurations=FORMS) + lint.lint_wrapper()
    assert [row for row in rows if row["status"] != "PASS"] == []
    found = {row["name"]: row["value"] for row in rows}
    assert {f"lint.{tool}.{c}" for tool in TOOLS for c in FORMS} <= set(found)
    header = lint.header_values()
    assert found["lint.yosys.sync_ff.latches"] == 0
    assert found["lint.yosys.sync_latch.latches"] == header["DERMIS_COLS"]
    bytes_, over = (header["DERMIS_CODE_BITS"] + 7) // 8, 1
    assert found["lint.yosys.8x8.memory_bits"] == 2 * 8 * (10 + 12 * (1 + 8 * bytes_ + over))
    assert found["lint.yosys.1x16_16bit.memory_bits"] == 2 * 8 * (10 + 5 * (1 + 2 * 16 + 2))


# What to break, and the rows of the default configuration that must fail. A tool that is not named
# is known to be blind to the fault; that is why there are three.
OUTPUT = ("dermis_row_buffer", "  assign valid_o = valid_q;")
COUNTS = ("dermis_reader", "(counts[c*COUNT_BITS +: COUNT_BITS])")
ALL = {*TOOLS}
FAULTS: dict[str, tuple[tuple[str, str], str, set[str]]] = {
    "port_one_bit_too_wide": (COUNTS, "(counts[c*COUNT_BITS +: COUNT_BITS-1])", ALL),
    "assignment_one_bit_too_narrow": (
        ("dermis_gated_counter", "wire [CODE_BITS-1:0] start;"),
        "wire [CODE_BITS-2:0] start;",
        {"verilator"},
    ),
    "inferred_latch": (
        OUTPUT,
        "reg held;\n  always @* if (load_i) held = valid_q;\n  assign valid_o = held;",
        {"verilator", "yosys", "yosys.latches"},
    ),
    "unused_signal": (OUTPUT, "wire spare = load_i & shift_i;\n  assign valid_o = valid_q;", {"verilator"}),
    "undriven_signal": (OUTPUT, "wire nothing;\n  assign valid_o = valid_q & nothing;", {*TOOLS[1:]}),
    "undeclared_signal": (OUTPUT, "assign valid_o = valid_qq;", ALL),
    "flop_without_reset": (
        OUTPUT,
        "reg late;\n  always @(posedge clk_i) late <= valid_q;\n  assign valid_o = late;",
        {"yosys.flops_without_reset"},
    ),
    "memory_outside_its_cell": (
        OUTPUT,
        "reg late [0:3];\n  always @(posedge clk_i) late[counts_i[1:0]] <= valid_q;\n"
        "  assign valid_o = late[counts_i[3:2]];",
        {"yosys.memory_bits"},
    ),
    "combinational_loop": (
        OUTPUT,
        "wire ring;\n  assign ring = valid_q | (ring & load_i);\n  assign valid_o = ring;",
        {"verilator", "yosys"},
    ),
    "port_not_connected": (("dermis_top", "    .gate_clocks_i   (gate_clocks),\n"), "", ALL),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_seeded_fault_fails_the_tools_that_can_see_it(copy: Path, fault: str) -> None:
    place, new, tools = FAULTS[fault]
    edit(copy, *place, new)
    seen = status(copy)
    rows = {tool: f"{tool}.sync_ff" for tool in TOOLS}
    rows |= {f"yosys.{k}": f"yosys.sync_ff.{k}" for k in ("latches", "flops_without_reset", "memory_bits")}
    failed = {tool for tool, name in rows.items() if seen[f"lint.{name}"] == "FAIL"}
    assert failed == tools


def test_a_waiver_is_needed_and_covers_only_the_latch_of_its_cell(copy: Path) -> None:
    """A second latch in the waived module fails, as does each column's own without the waiver."""
    waivers = copy / lint.WAIVERS
    text = waivers.read_text()
    waivers.write_text(re.sub(r"^lint_off.*$", "", text, flags=re.MULTILINE))
    rows = {row["name"]: row for row in lint.run_lint(copy, ("sync_ff", "sync_latch"))}
    row = rows["lint.verilator.sync_latch"]
    assert (row["status"], row["value"]) == ("FAIL", lint.header_values()["DERMIS_COLS"])
    assert "LATCH" in row["note"]
    assert rows["lint.verilator.sync_ff"]["status"] == "PASS"
    waivers.write_text(text)
    second = "  reg other_q;\n  always @* if (!gate_ni) other_q = d_i;\n  assign q_o = state_q & other_q;"
    edit(copy, "dermis_tech_latch", "  assign q_o = state_q;", second)
    seen = status(copy, "sync_latch")
    assert seen["lint.verilator.sync_latch"] == seen["lint.yosys.sync_latch.latches"] == "FAIL"


def test_a_file_list_that_is_not_the_design_fails(copy: Path) -> None:
    """The tools read only what is listed and below the top; anything else would pass unread."""
    (copy / "rtl" / "dermis_stray.v").write_text("module dermis_stray ();\nendmodule\n")
    (copy / "rtl" / "dermis_alone.v").write_text("module dermis_alone ();\nendmodule\n")
    path, listed = copy / "rtl" / "dermis_tech_dff.v", copy / lint.FILE_LIST
    path.write_text(path.read_text() + "\nmodule dermis_second ();\nendmodule\n")
    text = listed.read_text().replace("rtl/dermis_tech_latch.v\n", "")
    listed.write_text(text + "rtl/dermis_alone.v\n")
    rows = {row["name"]: row for row in lint.run_lint(copy, ("sync_latch",))}
    # Verilator finds a module next to the header by name.
    assert [rows[f"lint.{tool}.sync_latch"]["status"] for tool in ("icarus", "yosys")] == ["FAIL", "FAIL"]
    assert rows["lint.file_list"]["status"] == "FAIL"
    for said in (
        "dermis_stray.v is not in rtl/files.f",
        "dermis_tech_latch.v is not in rtl/files.f",
        "dermis_tech_dff.v holds dermis_tech_dff, dermis_second",
        "nothing instantiates dermis_alone",
    ):
        assert said in rows["lint.file_list"]["note"]


@pytest.mark.parametrize(
    ("parameter", "rule"),
    [
        (("SETTLE_CLOCKS", 2), "dermis_error_settle_clocks_must_be_break_clocks_and_2_to_65535"),
        (("GATE_CLOCKS", 0), "dermis_error_gate_clocks_must_be_1_to_65535"),
        (("BREAK_CLOCKS", 0), "dermis_error_break_clocks_must_be_1_or_more"),
        (("COLS", 129), "dermis_error_rows_and_cols_must_be_1_to_128"),
        (("ROWS", 129), "dermis_error_rows_and_cols_must_be_1_to_128"),
        (("CODE_BITS", 17), "dermis_error_code_bits_must_be_1_to_16"),
    ],
)
def test_impossible_parameters_stop_every_tool_by_name(
    monkeypatch: pytest.MonkeyPatch, parameter: tuple[str, int], rule: str
) -> None:
    monkeypatch.setattr(lint, "CONFIGURATIONS", {"impossible": dict([parameter])})
    outputs: dict[str, str] = {}
    run = lint.output_of

    def recorded(command: list[str], *rest: object) -> object:
        code, output = run(command, *rest)
        outputs[Path(command[0]).name] = output
        return code, output

    monkeypatch.setattr(lint, "output_of", recorded)
    rows = {row["name"]: row["status"] for row in lint.run_lint()}
    assert [rows[f"lint.{tool}.impossible"] for tool in TOOLS] == ["FAIL"] * 3
    assert set(outputs) == set(PROGRAMS)
    for name, output in outputs.items():
        assert rule in output, name


@pytest.mark.long
@pytest.mark.parametrize(("program", "tool"), [*zip(PROGRAMS, TOOLS, strict=True)])
@pytest.mark.parametrize(
    ("script", "note"), [("exit 0", "no result"), ("exit 139", "exit 139"), ("sleep 60", "within")]
)
def test_tool_that_gives_no_result_is_an_error_not_a_pass(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, program: str, tool: str, script: str, note: str
) -> None:
    if note == "within":
        monkeypatch.setattr(lint, "TIME_LIMIT_S", 8.0)
    fake = tmp_path / "bin" / program
    fake.parent.mkdir()
    fake.write_text(f"#!/bin/sh\n{script}\n")
    fake.chmod(0o755)
    if tool == "verilator":
        monkeypatch.setattr(lint, "verilator_root", lambda: tmp_path)
    else:
        monkeypatch.setenv("PATH", f"{fake.parent}:{sys.exec_prefix}/bin:/usr/bin:/bin")
    rows = {row["name"]: row for row in lint.run_lint(configurations=("1x1",))}
    assert rows[f"lint.{tool}.1x1"]["status"] == "ERROR"
    assert note in rows[f"lint.{tool}.1x1"]["note"]
    others = {row["status"] for name, row in rows.items() if not name.startswith(f"lint.{tool}.")}
    assert others == {"PASS"}


@pytest.mark.parametrize("missing", ["iverilog", "yosys", "verilator"])
def test_missing_tool_is_an_input_error_that_names_it(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    for module, name in ((shutil, "which"), (importlib.util, "find_spec")):
        found = getattr(module, name)
        monkeypatch.setattr(module, name, lambda one, found=found: None if one == missing else found(one))
    with pytest.raises(InputError, match=f'environment: {missing} = "?not found"?: .*install'):
        lint.run_lint()


@pytest.mark.parametrize(
    ("change", "tools"),
    [
        ((".d_charge (charge)", ".d_charge (range)"), {*TOOLS}),
        (("    .comp     (comp)", "    .comp     ()"), {*TOOLS[1:]}),
    ],
    ids=["width", "open_pin"],
)
def test_seeded_fault_in_the_wrapper_fails(copy: Path, change: tuple[str, str], tools: set[str]) -> None:
    edit(copy, "harden/user_analog_project_wrapper", *change)
    seen = {row["name"]: row["status"] for row in lint.lint_wrapper(copy)}
    for form in ("wrapper", "wrapper_power_pins"):
        assert {tool for tool in TOOLS if seen[f"lint.{tool}.{form}"] == "FAIL"} == tools


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.long)])
def test_no_path_between_the_clocks_and_no_raw_reset_is_without_its_reason(
    every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Yosys takes a second for each seeded fault: a quarter of them; `make lint` and the long test take all."""
    rules = crossings._rules(ROOT)
    seeded = dict(list(rules["seeded"].items())[::every])
    monkeypatch.setattr(crossings, "_rules", lambda root: rules | {"seeded": seeded})
    found = {row["name"].split(".")[2]: (row["status"], row["note"]) for row in crossings.rows()}
    assert found == dict.fromkeys(("sync_ff", "sync_latch", "seeded_missed"), ("PASS", ""))


@pytest.mark.parametrize(
    ("module", "old", "new", "said"),
    [
        ("dermis_top", "_toggle_i (hold_toggle)", "_toggle_i (hold_toggle & enable)", "gates before"),
        ("dermis_top", "  (row_sense_i)", "  (row_select_o)", "no path for the exception"),
        ("dermis_spi", "assign cipo_o           = cipo_q;", "assign cipo_o = cipo_q; `error", "no netlist"),
    ],
)
def test_what_is_no_synchronizer_is_named(copy: Path, module: str, old: str, new: str, said: str) -> None:
    edit(copy, module, old, new)
    try:
        found = crossings.Netlist(copy, latch=False).findings()
    except SimulatorError as error:
        found = [str(error)]
    assert any(said in line for line in found), found


def test_a_seeded_fault_whose_place_was_edited_is_named_and_no_defect(copy: Path, tmp_path: Path) -> None:
    edit(copy, "dermis_tech_sync", "(first_q),\n    .q_o", "(first_d),\n    .q_o")
    left = [name for name, made in crossings.seeded(copy, tmp_path / "faults") if made is None]
    assert left == ["one_flop (dermis_tech_sync.v has no 'first_q' behind 'u_second')"]
