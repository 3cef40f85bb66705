# SPDX-License-Identifier: Apache-2.0
"""Content of a deck: the elements of each effect that is on, nothing of others, and the array."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from system_bench import MakePlan

from dermis import effects
from dermis.array.array import column_currents
from dermis.chip import netlist
from dermis.chip.netlist import frame_deck
from dermis.records import Plan
from dermis.scene.design import TOPOLOGIES

ROWS, COLS = 3, 4
LEVELS = [0.0] * (ROWS + 1 + COLS)

# Two frames: the first moves to the second in all taxels but one. One taxel is open, one a short.
OHM = 510 * 60 ** np.random.default_rng(8).random((2, ROWS, COLS))
OHM[1, 2, 3] = OHM[0, 2, 3]
OHM[0, 0, 1], OHM[0, 1, 2] = np.inf, 0.0

TAXELS = ROWS * COLS - 1  # the open one has no element
MOVING = ROWS * COLS - 1


def names(count: int, *stems: str) -> Counter[str]:
    return Counter(dict.fromkeys(stems, count))


# By effect: the number of elements and parameters that it adds to the deck, each name with # for
# its numbers. A parameter is written element.parameter; `.options` limits the steps to a pole. An
# effect without a row adds anything.
MIRRORED = ("conveyor_mirror", "conveyor_mirror_inverted")
ADDS: dict[str, Counter[str]] = {
    "lateral": names(ROWS * (COLS - 1), "rlat_r#c#"),
    "row_driver": names(ROWS, "xrow#.r_on_ohm", "xrow#.r_ground_ohm"),
    "pad": names(ROWS, "rpad_row#", "xrow#") + names(COLS, "rpad_col#", "xch#"),
    "return": names(ROWS, "xrow#", "xrow#.follow") + names(1, "rreturn"),
    "column_input": names(COLS, "xch#.conv_r_x_ohm"),
    "column_offset": names(COLS, "xch#.conv_v_offset_v"),
    "mirror_ratio": names(COLS, "xch#.mir_ratio_error"),
    "offset_current": names(COLS, "ioffset#"),
    "integrator_gain": names(COLS, "xch#.int_gain_dc", "xch#.int_r_in_ohm"),
    "integrator_range": names(COLS, "xch#.int_v_out_max_v", "xch#.int_v_out_min_v") + names(1, ".options"),
    "comparator_offset": names(COLS, "xch#.comp_v_offset_v"),
    "comparator_hysteresis": names(COLS, "xch#.comp_v_hysteresis_v") + names(1, ".options"),
    "comparator_delay": names(COLS, "xch#.comp_t_delay_s") + names(1, ".options"),
    "charge_packet": names(COLS, "xch#.packet_error"),
    "preset_error": names(COLS, "xch#.v_preset_v"),
    "trace": names(ROWS * COLS, "rtrace_row_r#c#", "rtrace_col_r#c#") + names(TAXELS, "rtaxel_r#c#"),
    "line_capacitance": names(ROWS, "crow#")
    + names(COLS, "ccolumn#")
    + names(ROWS * COLS, "ctaxel_r#c#")
    + names(1, ".options"),
    "mux_leakage": names(COLS, "ileak#"),
    "mirror_output": names(COLS, "xch#.int_r_in_ohm"),
    "mirror_lag": names(COLS, "xch#.out_q_lag_c") + names(1, ".options"),
    "range_switch": names(COLS, "xch#.out_inv_i_range_a"),
    "integrator_bandwidth": names(COLS, "xch#.int_t_gbw_s") + names(1, ".options"),
    "reference_drift": names(COLS, "xch#.packet_error"),
    "supply_ripple": names(1, "vbias") + names(ROWS, "xrow#.follow"),
    "motion": names(MOVING, "btaxel_r#c#"),
}

# There in every deck, at the ideal value or between other nodes where nothing departs from it.
ALWAYS = {
    "xch#", "xrow#", "xch#.v_preset_v", "xrow#.r_on_ohm", "xrow#.r_ground_ohm", "vbias", ".options", "rtaxel_r#c#",
}  # fmt: skip

RANDOM = {name for name, effect in effects.EFFECTS.items() if effect.random}
SENSOR = {name for name in effects.EFFECTS if name.startswith("sensor_")}


def atoms(plan: Plan, frame: int = 0) -> Counter[str]:
    """A deck as a set of elements and of parameters of blocks, each with its value."""
    found: Counter[str] = Counter()
    for line in frame_deck(plan, frame, LEVELS).lines:
        if re.match(r"x(ch|row)\d+ ", line):
            words = line.split()
            found[" ".join(w for w in words if "=" not in w)] += 1
            for word in words:
                if "=" in word:
                    found[f"{words[0]}.{word}"] += 1
        else:
            found[line] += 1
    return found


def kinds(some: Counter[str]) -> Counter[str]:
    """Their names without numbers and values."""
    found: Counter[str] = Counter()
    for atom, count in some.items():
        name = re.sub(r"\d+", "#", re.split(r"[ =]", atom, maxsplit=1)[0])
        found[name] += count
    return found


def scene_of(on: Mapping[str, object]) -> str:
    """Effects as a scene has them: tables of numbers, true or false."""

    def text(value: object) -> str:
        if isinstance(value, Mapping):
            return "{ " + ", ".join(f"{key} = {number!r}" for key, number in value.items()) + " }"
        return str(value).lower()

    return "\n".join(f"{name} = {text(value)}" for name, value in on.items())


def effects_of(topology: str) -> dict[str, object]:
    """Every effect that a deck honours and a topology has, as its example."""
    chosen = [
        e for e in effects.EFFECTS.values() if e.name not in RANDOM | SENSOR and topology in e.topologies
    ]
    return {effect.name: effect.example(topology) for effect in chosen}


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_effects_named_and_switched_off_leave_the_deck_as_it_is_without_them(
    resistance_plan: MakePlan, topology: str
) -> None:
    bare = [frame_deck(resistance_plan(OHM, topology), f, LEVELS) for f in (0, 1)]
    off = resistance_plan(OHM, topology, scene_of(dict.fromkeys(effects.EFFECTS, False)))
    assert [frame_deck(off, f, LEVELS) for f in (0, 1)] == bare


@pytest.mark.parametrize("topology", MIRRORED)
@pytest.mark.parametrize("name", sorted(effects.EFFECTS.keys() - RANDOM - SENSOR))
def test_an_effect_alone_adds_exactly_its_own_elements(
    resistance_plan: MakePlan, topology: str, name: str
) -> None:
    bare, got = (
        atoms(resistance_plan(OHM, topology)),
        atoms(resistance_plan(OHM, topology, scene_of({name: True}))),
    )
    added = kinds(got - bare)
    assert added == ADDS.get(name, added)
    assert added, "no element and no parameter"
    # what goes is replaced: a value that is always written, the taxels that trace and motion write
    # in another way
    gone = kinds(bare - got)
    assert gone.keys() <= ({"rtaxel_r#c#"} if name in ("trace", "motion") else ALWAYS - {"rtaxel_r#c#"})
    assert name != "motion" or gone == names(MOVING - 1, "rtaxel_r#c#"), (
        "the open taxel had no element before"
    )


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_an_effect_switched_off_among_all_takes_every_element_of_its_own_along(
    resistance_plan: MakePlan, topology: str
) -> None:
    on = effects_of(topology)
    full = atoms(resistance_plan(OHM, topology, scene_of(on)))
    for name in on:
        rest = {n: value for n, value in on.items() if n != name}
        without = atoms(resistance_plan(OHM, topology, scene_of(rest)))
        others = set().union(*(ADDS.get(n, {}) for n in rest)) | ALWAYS
        own = {kind for kind in ADDS.get(name, {}) if kind not in others}
        assert not own & kinds(without).keys(), name
        assert full - without, f"{name}: no element and no value of it in the deck of all"


def test_shared_values_are_sums_of_what_each_effect_adds(resistance_plan: MakePlan) -> None:
    both = (
        "integrator_gain = { gain_dc = 1e3, r_in_ohm = 2e6 }\nmirror_output = { r_out_ohm = 6e6 }\n"
        "charge_packet = { packet_error = 0.01 }\nreference_drift = { tc_per_k = 1e-4, delta_k = 20.0 }\n"
    )
    line = next(li for li in frame_deck(resistance_plan(OHM, effects=both), 0, LEVELS).lines if "xch2 " in li)
    value = {k: float(v) for k, v in (w.split("=") for w in line.split() if "=" in w)}
    # A deck has 15 digits of a number, and a parallel of two is three roundings.
    assert value["int_r_in_ohm"] == pytest.approx(1.5e6, rel=1e-12)
    assert value["packet_error"] == pytest.approx(0.012, rel=1e-12)


def test_random_effects_are_refused_and_sensor_effects_are_only_other_resistances(
    resistance_plan: MakePlan,
) -> None:
    for name in RANDOM:
        fields = resistance_plan(OHM, effects=f"{name} = true").active_fields()
        assert fields - netlist.HONOURS, name
    bare = kinds(atoms(resistance_plan(OHM)))
    for name in SENSOR:
        assert kinds(atoms(resistance_plan(OHM, effects=f"{name} = true"))) == bare, name


def test_the_ripple_carries_on_from_frame_to_frame(resistance_plan: MakePlan) -> None:
    text = "supply_ripple = { relative = 0.01, frequency_hz = 1234.5, phase_deg = 30.0 }"
    made = resistance_plan(OHM, effects=text)
    for plan, frame, number in ((made, 0, 0), (made, 1, 1), (replace(made, first_frame=7), 1, 8)):
        line = next(li for li in frame_deck(plan, frame, LEVELS).lines if li.startswith("vbias "))
        level, swing, hertz, *_, degrees = map(float, re.findall(r"[-+.e\d]+", line.split("sin")[1]))
        assert (level, swing, hertz) == (0.5, pytest.approx(0.005), 1234.5)
        # A deck starts where row 0 is driven, a break behind the frame's first instant.
        begin_s = number * ROWS * made.timing.slot_s + made.timing.break_clocks / made.timing.f_clk_hz
        turns = 30 / 360 + 1234.5 * begin_s
        # Some hundred turns in doubles, written in degrees: 1e-13 of them; a clock is 2e-4 turns.
        assert degrees / 360 % 1 == pytest.approx(turns % 1, abs=1e-9)


def test_moving_taxels_end_where_the_next_frame_begins_and_the_last_frame_holds(
    resistance_plan: MakePlan,
) -> None:
    made = resistance_plan(OHM, effects="motion = true")
    seconds = made.drive.t_frame_s
    late = made.timing.break_clocks / made.timing.f_clk_hz  # a deck starts where row 0 is driven
    floor = made.scene.design.array.r_floor_ohm
    source = re.compile(r"btaxel_r(\d)c(\d) r\1 c\2 i = v\(r\1,c\2\)\*\((\S+) \+ \((\S+)\)\*time\)")
    found = {}
    for line in frame_deck(made, 0, LEVELS).lines:
        if match := source.fullmatch(line):
            found[int(match[1]), int(match[2])] = (float(match[3]), float(match[4]))
    assert len(found) == MOVING
    for (r, c), (start, slope) in found.items():
        # Numbers of 15 digits in the deck; where a difference cancels, digits of what it started
        # from.
        assert start - slope * late == pytest.approx(1 / max(OHM[0, r, c], floor), rel=1e-12)
        # As above.
        assert start + slope * (seconds - late) == pytest.approx(
            1 / OHM[1, r, c], rel=1e-12, abs=1e-15 * start
        )
    assert "btaxel" not in "\n".join(frame_deck(made, 1, LEVELS).lines)
    onward = replace(made, next_resistance_ohm=OHM[0])
    assert "btaxel" in "\n".join(frame_deck(onward, 1, LEVELS).lines)


# ---- the array, read back from the deck ----


def solve_deck(lines: tuple[str, ...] | list[str], driven: int) -> NDArray[np.float64]:
    """Column currents of a deck's array with row `driven` at 1 V, all else at 0 V: plain nodal analysis."""
    inside = lines[lines.index(".subckt array") + 1 : lines.index(".ends array")]
    resistors = [line.split() for line in inside if line[0] == "r"]
    held = {f"r{r}": float(r == driven) for r in range(ROWS)} | {f"c{c}": 0.0 for c in range(COLS)}
    free = sorted({node for r in resistors for node in r[1:3]} - held.keys())
    place = {node: i for i, node in enumerate(free)}
    matrix, right = np.zeros((len(free), len(free))), np.zeros(len(free))
    for _, a, b, ohm in resistors:
        for here, there in ((a, b), (b, a)):
            if here in place:
                matrix[place[here], place[here]] += 1 / float(ohm)
                if there in place:
                    matrix[place[here], place[there]] -= 1 / float(ohm)
                else:
                    right[place[here]] += held[there] / float(ohm)
    volts = held | dict(zip(free, np.linalg.solve(matrix, right), strict=True))
    current = np.zeros(COLS)
    for _, a, b, ohm in resistors:
        for here, there in ((a, b), (b, a)):
            if here.startswith("c"):
                current[int(here[1:])] += (volts[there] - volts[here]) / float(ohm)
    return current


LINES = OHM.copy()
LINES[0, 1, 2] = 400.0  # no short: the two solves round one differently
WIRED = "trace = { r_row_ohm = 2.0, r_column_ohm = 3.0 }\nlateral = { r_ohm = 300.0 }"


def check_array(plan: Plan, change: Callable[[list[str]], list[str]] = lambda lines: lines) -> None:
    lines = change(list(frame_deck(plan, 0, LEVELS).lines))
    want = column_currents(replace(plan.network(0), v_bias_v=1.0))
    got = np.array([solve_deck(lines, r) for r in range(ROWS)])
    # Plain nodal analysis in doubles: its rounding times the condition, 1e6; 1e-15 A where nothing
    # flows.
    assert got == pytest.approx(want, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        WIRED,
        "trace = { r_row_ohm = 2.0, r_column_ohm = 0.0 }\nlateral = { r_ohm = 300.0 }",
        "trace = { r_row_ohm = 0.0, r_column_ohm = 3.0 }\nlateral = { r_ohm = 300.0 }",
        "trace = { r_row_ohm = 2.0, r_column_ohm = 3.0 }",
        "lateral = { r_ohm = 300.0 }",
    ],
)
def test_the_array_of_a_deck_is_the_network_of_the_solver(resistance_plan: MakePlan, text: str) -> None:
    check_array(resistance_plan(LINES, effects=text))


def swap(pattern: str, new: str, count: int | None = None) -> Callable[[list[str]], list[str]]:
    """A fault: lines that match are written otherwise, "" leaves them out."""

    def change(lines: list[str]) -> list[str]:
        hit = [bool(re.fullmatch(pattern, line)) for line in lines]
        assert sum(hit) == (count or sum(hit)) > 0
        out = [re.sub(pattern, new, line) if h else line for line, h in zip(lines, hit, strict=True)]
        return [line for line in out if line]

    return change


FAULTS = {
    "row_driven_from_the_far_end": swap(
        r"(rtrace_row_r(\d)c0) r\d u_r\dc0 (.*)", rf"\1 r\2 u_r\2c{COLS - 1} \3", ROWS
    ),
    "column_read_at_the_far_end": swap(
        rf"(rtrace_col_r{ROWS - 1}c(\d)) v_r\dc\d c\d (.*)", r"\1 v_r0c\2 c\2 \3", COLS
    ),
    "first_segment_of_a_row_missing": swap(r"(rtrace_row_r1c0) (.*) 2\.0", r"\1 \2 1e-9", 1),
    "last_segment_of_a_column_missing": swap(rf"(rtrace_col_r{ROWS - 1}c2) (.*) 3\.0", r"\1 \2 1e-9", 1),
    "segment_open": swap(r"rtrace_col_r1c2 .*", "", 1),
    "segments_of_rows_and_columns_swapped": swap(r"(rtrace_row\S+) (.*) 2\.0", r"\1 \2 3.0", ROWS * COLS),
    "taxel_at_the_next_node": swap(r"(rtaxel_r1c0 \S+) v_r1c0 (.*)", r"\1 v_r2c0 \2", 1),
    "lateral_between_row_lines": swap(r"(rlat_r1c0) v_r1c0 v_r1c1 (.*)", r"\1 u_r1c0 u_r1c1 \2", 1),
    "lateral_along_a_column_missing": swap(r"rlat_col_r0c3 .*", "", 1),
    "lateral_along_a_row_missing": swap(r"rlat_r2c0 .*", "", 1),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_wire_is_caught(resistance_plan: MakePlan, fault: str) -> None:
    made = resistance_plan(LINES, effects=WIRED)
    check_array(made)
    with pytest.raises((AssertionError, np.linalg.LinAlgError)):
        check_array(made, FAULTS[fault])


def test_blocks_of_a_deck_go_by_the_clock_of_its_plan(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM)
    fast = replace(plan, timing=replace(plan.timing, f_clk_hz=4.0 * plan.timing.f_clk_hz))
    for made in (plan, fast):
        lines = frame_deck(made, 0, LEVELS).lines
        given = [i for i, line in enumerate(lines) if line.startswith(".param converter_f_clk_hz=")]
        include = next(i for i, line in enumerate(lines) if "design.inc" in line)
        # ngspice takes the last one.
        assert len(given) == 1
        assert given[0] > include
        assert float(lines[given[0]].partition("=")[2]) == made.timing.f_clk_hz


BITES = "integrator_range = { v_max_v = 0.69, v_min_v = -0.56 }"


def abstol(plan: Plan, columns: tuple[int, ...] | None = None) -> float:
    line = next(li for li in frame_deck(plan, 0, LEVELS, columns=columns).lines if li.startswith(".options"))
    return float(dict(w.split("=") for w in line.split()[1:])["abstol"])


def test_a_clamp_that_bites_asks_for_short_edges_and_another_does_not(resistance_plan: MakePlan) -> None:
    plan = resistance_plan(OHM, effects=BITES)
    # 5e-6 clock of 200 ns; products of two numbers, written with 15 digits.
    assert frame_deck(plan, 0, LEVELS).longest_edge_s == pytest.approx(1e-12, rel=1e-12)
    assert abstol(plan) == pytest.approx(1e-13, rel=1e-12)
    for text in ("", "integrator_range = { v_max_v = 1.6, v_min_v = -1.6 }"):
        assert frame_deck(resistance_plan(OHM, effects=text), 0, LEVELS).longest_edge_s == np.inf


def test_abstol_beside_a_clamp_is_of_the_largest_reference_current_in_the_deck(
    resistance_plan: MakePlan,
) -> None:
    plan = resistance_plan(OHM, effects=BITES)
    unlike = replace(plan, converter=replace(plan.converter, i0_a=np.array([3e-9, 25e-6, 12e-6, 3e-9])))
    # Products of two numbers, written with 15 digits.
    assert abstol(unlike) == pytest.approx(1e-13, rel=1e-12)
    assert abstol(unlike, (0, 2)) == pytest.approx(4.8e-14, rel=1e-12)
    assert abstol(unlike, (0, 3)) == pytest.approx(1.2e-17, rel=1e-12)


@pytest.mark.paper
def test_a_comparator_late_by_a_good_part_of_a_clock_is_looked_at_earlier(resistance_plan: MakePlan) -> None:
    """Beyond a twentieth of a clock the block leaves its delay out, which alone sets no step limit."""
    bare = frame_deck(resistance_plan(OHM), 0, LEVELS, record=True)
    assert bare.late_s == ()
    late = frame_deck(
        resistance_plan(OHM, effects="comparator_delay = { t_s = 6e-8 }"),
        0,
        LEVELS,
        record=True,
        columns=(1, 3),
    )
    same = frame_deck(resistance_plan(OHM), 0, LEVELS, record=True, columns=(1, 3))
    more = [line.replace(" comp_t_delay_s=6e-08", "") for line in late.lines]
    more.remove(".param comparator_early_s=1e-08")
    assert tuple(more) == same.lines
    assert late.probes == same.probes
    assert late.late_s == (6e-8, 6e-8, 0.0, 0.0)
    pole = frame_deck(resistance_plan(OHM, effects="comparator_delay = { t_s = 1e-8 }"), 0, LEVELS)
    assert pole.late_s == ()
    assert sum("comp_t_delay_s=1e-08" in line for line in pole.lines) == COLS


@pytest.mark.parametrize(("late_s", "clocks"), [(1.9e-9, 0.0475), (2.1e-9, 0.0525)])
def test_the_twentieth_is_of_the_clock_of_the_plan(
    resistance_plan: MakePlan, late_s: float, clocks: float
) -> None:
    plan = resistance_plan(OHM, effects=f"comparator_delay = {{ t_s = {late_s} }}")
    fast = replace(plan, timing=replace(plan.timing, f_clk_hz=clocks / late_s))
    assert bool(frame_deck(fast, 0, LEVELS).late_s) == (clocks > 0.05)
