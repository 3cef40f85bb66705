# SPDX-License-Identifier: Apache-2.0
"""Claims about the slot sequencer: each against a plain reading of docs/rtl.md, and one by one."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from rtl_run import changed, simulate
from rtl_run import play as run

pytestmark = pytest.mark.timeout(120)

INJECT, DARK, FULL_EVEN, FULL_ODD = 0xF0, 0xF1, 0xF2, 0xF3
SPECIAL = (INJECT, DARK, FULL_EVEN, FULL_ODD)
PACK_CLOCKS = 8

Played = list[tuple[dict[str, int], dict[str, int]]]


INPUTS = "enable continuous shot test dark settle gate row_mask busy".split()
OUTPUTS = """row_select preset gate inject full_even full_odd frame_start scanning slot_done
    done_slot done_first done_last done_test done_dark done_gate""".split()


def random_inputs(rng: random.Random, rows: int, last: dict[str, int]) -> dict[str, int]:
    """Inputs that dwell, so that whole frames happen as well as every kind of interruption."""
    new = dict(last)
    new["enable_i"] = int(rng.random() < (0.995 if last["enable_i"] else 0.3))
    new["continuous_i"] = int(rng.random() < (0.98 if last["continuous_i"] else 0.01))
    new["shot_i"] = int(rng.random() < 0.01)
    new["test_i"] = int(rng.random() < 0.005)
    new["busy_i"] = int(rng.random() < (0.8 if last["busy_i"] else 0.05))
    if rng.random() < 0.02:
        new["dark_i"] = rng.randint(0, 1)
        new["settle_i"] = rng.choice([0, 1, 2, 3, 4, 7, 12])
        new["gate_i"] = rng.choice([0, 1, 2, 5, 9])
        new["row_mask_i"] = rng.choice([0, (1 << rows) - 1, rng.getrandbits(rows)])
    return new


def play(
    simulator: str,
    parameters: dict[str, int] | None = None,
    trap: Path | None = None,
    *,
    clocks: int,
    inputs: Mapping[str, int] | None = None,
    changes: Sequence[tuple[int, Mapping[str, int]]] | None = None,
) -> Played:
    """Inputs and outputs of each edge, by port name without its suffix; random inputs if none are given.

    `changes` are (clock, inputs from then on); a shot and a test last a clock.
    """
    p = {"ROWS": 4, "PACK_CLOCKS": PACK_CLOCKS} | (parameters or {})
    rng, rows, later = random.Random(9), p["ROWS"], dict(changes or ())
    now = {f"{n}_i": 0 for n in INPUTS} | {"row_mask_i": (1 << rows) - 1, "settle_i": 5, "gate_i": 4}
    now |= inputs or {}
    steps = []
    for clock in range(clocks):
        now = random_inputs(rng, rows, now) if inputs is None else now | later.get(clock, {})
        steps.append(now)
        now = now | {"shot_i": 0, "test_i": 0}
    seen = run(simulator, "dermis_row_scanner", steps, [f"{n}_o" for n in OUTPUTS], p, trap)
    return [
        tuple({name[:-2]: value for name, value in ports.items()} for ports in (step, high))
        for step, (high, _) in zip(steps, seen, strict=True)
    ]


class Scanner:
    """Reference of docs/rtl.md: one step a clock, without counters and flip-flops."""

    def __init__(self, rows: int, break_clocks: int) -> None:
        self.rows, self.break_clocks = rows, break_clocks
        self.slots: list[int] = []  # of this frame, the one that runs first; none when idle
        self.age = 0  # clocks since e0
        self.gate_age: int | None = None  # clocks since t0, None in preset
        self.shot = self.test = 0
        self.frame: dict[str, int] = {}
        self.first = 0
        self.done = {"slot": 0, "first": 0, "last": 0, "test": 0, "dark": 0, "gate": 0}

    def list_of(self, i: Mapping[str, int]) -> list[int]:
        rows = [r for r in range(self.rows) if i["row_mask"] >> r & 1]
        if self.test:
            return [*SPECIAL, *rows]
        if i["continuous"] or self.shot:
            return [DARK, *rows] if i["dark"] else rows
        return []

    def step(self, i: Mapping[str, int]) -> dict[str, int]:
        """Outputs behind the edge at which the inputs are `i`."""
        ends = False
        if self.slots:
            self.age += 1
            if self.gate_age is not None:
                self.gate_age += 1
                ends = self.gate_age == self.frame["gate"]
            elif self.age >= self.frame["settle"] and not (i["busy"] and self.frame["asked"] < PACK_CLOCKS):
                self.gate_age = 0
        if ends:
            self.done = {
                "slot": self.slots[0],
                "first": self.first,
                "last": int(len(self.slots) == 1),
                "test": self.frame["test"],
                "dark": self.frame["dark"],
                "gate": self.frame["gate"],
            }
            self.first = 0
            self.slots = self.slots[1:]
            self.age, self.gate_age = 0, None
        starts = 0
        if not i["enable"]:
            self.slots = []
        elif not self.slots and (slots := self.list_of(i)):
            starts = 1
            self.slots, self.first, self.age, self.gate_age = slots, 1, 0, None
            self.frame = {
                "settle": max(i["settle"], 2 + self.break_clocks),
                "gate": max(i["gate"], 1),
                "asked": i["gate"],
                "test": self.test,
                "dark": int(DARK in slots),
            }
        if starts and self.test:
            self.test = 0
        elif starts:
            self.shot = 0
        self.shot = int(i["enable"] and (self.shot or i["shot"]))
        self.test = int(i["enable"] and (self.test or i["test"]))
        slot = self.slots[0] if self.slots else None
        preset = int(slot is None or self.gate_age is None)
        driven = slot is not None and slot not in SPECIAL and self.age >= self.break_clocks
        return {
            "row_select": 1 << slot if driven else 0,
            "preset": preset,
            "gate": 1 - preset,
            "inject": int(slot == INJECT),
            "full_even": int(slot == FULL_EVEN),
            "full_odd": int(slot == FULL_ODD),
            "frame_start": starts,
            "scanning": int(slot is not None),
            "slot_done": int(ends),
            **{f"done_{key}": value for key, value in self.done.items()},
        }


def against_the_words(played: Played, rows: int, break_clocks: int) -> None:
    scanner = Scanner(rows, break_clocks)
    for n, (inputs, outputs) in enumerate(played):
        assert outputs == scanner.step(inputs), f"edge {n}, {inputs}"


SHAPES = [{"ROWS": 4}, {"ROWS": 1}, {"ROWS": 3, "BREAK_CLOCKS": 3}]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: "_".join(map(str, s.values())))
def test_each_output_moves_on_its_edge_and_no_other_whatever_the_inputs(
    simulator: str, shape: dict[str, int]
) -> None:
    played = play(simulator, shape, clocks=4000)
    against_the_words(played, shape["ROWS"], shape.get("BREAK_CLOCKS", 1))
    done = [o for _, o in played if o["slot_done"]]
    # Seen often enough to mean something: frames of each kind, slots of each kind, cuts, waits.
    assert {o["done_slot"] for o in done} == {*range(shape["ROWS"]), *SPECIAL}
    assert {(o["done_test"], o["done_dark"]) for o in done} == {(0, 0), (0, 1), (1, 1)}
    assert sum(o["frame_start"] for _, o in played) > 30
    assert any(not i["enable"] and o["slot_done"] for i, o in played)


SEEDED = {
    "no break": ("row_select_q <= {ROWS{1'b0}};\n      inject_q     <= next[0];", "inject_q     <= next[0];"),
    "the last row is lost": ("slots_q      <= next;", "slots_q      <= next & {1'b0, {(SLOTS-1){1'b1}}};"),
    "a shot is served twice": ("(shot_q & ~(frame_load & ~test_q))", "(shot_q & ~(frame_load & test_q))"),
    "no wait for the taker": ("if (!(busy_i & short_q))", "if (1'b1)"),
    "settle not clamped": ("(settle_i < SHORTEST[15:0])", "(settle_i < 16'd2)"),
    "gate not clamped": ("(gate_i == 16'd0)", "(gate_i == 16'd65535)"),
    "settings taken over within a frame": (
        "if (frame_load) begin\n        first_q ",
        "if (slot_start) begin\n        first_q ",
    ),
    "a cut slot is delivered": (
        "slot_done_q <= slot_end;",
        "slot_done_q <= slot_end | (active_q & ~enable_i);",
    ),
    "a slot cut by its last edge is lost": (
        "slot_done_q <= slot_end;",
        "slot_done_q <= slot_end & enable_i;",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", SEEDED)
def test_the_reading_finds_a_seeded_fault(fault: str, tmp_path: Path) -> None:
    wrong = changed(tmp_path, "dermis_row_scanner", SEEDED[fault])
    played = play("icarus", trap=wrong, clocks=4000)
    with pytest.raises(AssertionError, match="edge "):
        against_the_words(played, 4, 1)


def slots_of(played: Played) -> list[int]:
    return [o["done_slot"] for _, o in played if o["slot_done"]]


def on(**more: int) -> dict[str, int]:
    return {f"{key}_i": value for key, value in {"enable": 1, "continuous": 1, **more}.items()}


def test_one_row_at_a_time_with_a_clock_of_none_between(simulator: str) -> None:
    for shape, clocks in ((SHAPES[0], 1), (SHAPES[2], 3)):
        played = play(simulator, shape, clocks=120, inputs=on(settle=10))
        rows = [o["row_select"] for _, o in played]
        assert set(rows) == {0, *(1 << r for r in range(shape["ROWS"]))}
        runs = re.findall(r"1(0+)(?=[1])", "".join("01"[bool(r)] for r in rows))
        assert {len(r) for r in runs} == {clocks}
        assert all(b in (0, a) for a, b in pairwise(rows) if a)


@pytest.mark.parametrize(
    ("mask", "dark", "wanted"),
    [(0b1010, 0, [1, 3]), (0b0100, 1, [DARK, 2]), (0b1111, 1, [DARK, 0, 1, 2, 3]), (0, 1, [DARK])],
)
def test_a_frame_has_the_rows_of_the_mask_behind_its_dark_slot(
    simulator: str, mask: int, dark: int, wanted: list[int]
) -> None:
    played = play(simulator, clocks=150, inputs=on(row_mask=mask, dark=dark))
    slots = slots_of(played)
    assert len(slots) > 10
    assert slots == (wanted * 20)[: len(slots)]
    # No gap: a slot is settle 5 and gate 4.
    ends = [n for n, (_, o) in enumerate(played) if o["slot_done"]]
    assert {b - a for a, b in pairwise(ends)} == {9}


def test_an_empty_list_is_no_frame_and_a_shot_waits_for_a_row(simulator: str) -> None:
    changes = [[2, {"shot_i": 1}], [60, {"row_mask_i": 0b10}]]
    played = play(simulator, clocks=120, inputs=on(continuous=0, row_mask=0), changes=changes)
    assert not any(o["scanning"] for _, o in played[:60])
    assert slots_of(played) == [1]


def test_a_shot_is_one_frame_and_continuous_low_ends_behind_the_frame(simulator: str) -> None:
    played = play(simulator, clocks=120, inputs=on(continuous=0), changes=[[5, {"shot_i": 1}]])
    assert slots_of(played) == [0, 1, 2, 3]
    played = play(simulator, clocks=120, inputs=on(), changes=[[40, {"continuous_i": 0}]])
    assert slots_of(played) == [0, 1, 2, 3, 0, 1, 2, 3]
    assert played[-1][1] == {**played[-1][1], "row_select": 0, "preset": 1, "scanning": 0}


def test_a_test_is_one_frame_of_special_slots_and_rows_between_two_frames(simulator: str) -> None:
    played = play(simulator, clocks=150, inputs=on(), changes=[[12, {"test_i": 1}]])
    slots = slots_of(played)
    assert slots[:16] == [0, 1, 2, 3, *SPECIAL, 0, 1, 2, 3, 0, 1, 2, 3]
    assert [o["done_test"] for _, o in played if o["slot_done"]][:16] == [0] * 4 + [1] * 8 + [0] * 4
    for name, slot in (("inject", INJECT), ("full_even", FULL_EVEN), ("full_odd", FULL_ODD)):
        clocks = [n for n, (_, o) in enumerate(played) if o[name]]
        done = next(n for n, (_, o) in enumerate(played) if o["slot_done"] and o["done_slot"] == slot)
        assert clocks == list(range(done - 9, done)), name  # the whole slot, from e0 to the next
    assert not any(o["row_select"] and (o["inject"] or o["full_even"] or o["full_odd"]) for _, o in played)


def test_a_shot_and_a_test_asked_together_are_both_served(simulator: str) -> None:
    changes = [[5, {"shot_i": 1, "test_i": 1}]]
    played = play(simulator, clocks=150, inputs=on(continuous=0), changes=changes)
    assert slots_of(played) == [*SPECIAL, 0, 1, 2, 3, 0, 1, 2, 3]


def test_enable_low_forgets_a_pending_shot_and_test(simulator: str) -> None:
    changes = [[5, {"shot_i": 1, "test_i": 1}], [8, {"enable_i": 0}], [9, {"enable_i": 1}]]
    played = play(simulator, clocks=80, inputs=on(continuous=0, row_mask=0b11), changes=changes)
    assert slots_of(played) == []
    assert not any(o["scanning"] for _, o in played[8:])


@pytest.mark.parametrize(
    ("settle", "gate", "shape", "clocks"),
    [(0, 0, 0, 4), (3, 1, 0, 4), (4, 0, 0, 5), (2, 3, 2, 8), (6, 3, 2, 9)],
)
def test_settle_is_at_least_break_and_two_and_gate_at_least_one(
    simulator: str, settle: int, gate: int, shape: int, clocks: int
) -> None:
    played = play(simulator, SHAPES[shape], clocks=80, inputs=on(settle=settle, gate=gate))
    ends = [n for n, (_, o) in enumerate(played) if o["slot_done"]]
    assert {b - a for a, b in pairwise(ends)} == {clocks}
    assert {o["done_gate"] for _, o in played if o["slot_done"]} == {max(gate, 1)}


def test_the_longest_settle_and_gate_are_65535_clocks_and_the_shortest_3_and_1(simulator: str) -> None:
    settings = {f"{name}_i": 0 for name in INPUTS} | on(settle=65535, gate=65535, row_mask=1)
    p = {"ROWS": 1, "PACK_CLOCKS": PACK_CLOCKS}
    clocks = simulate(
        simulator, "bench_row_scanner", "dermis_row_scanner", "lengths", p, {"inputs": settings}
    )
    assert clocks == [65535, 65535, 3, 1]


def test_a_short_slot_waits_in_preset_for_the_taker_and_a_long_one_does_not(simulator: str) -> None:
    changes = [[3, {"busy_i": 1}], [40, {"busy_i": 0}]]
    for gate, t0 in ((PACK_CLOCKS - 1, 40), (PACK_CLOCKS, 5)):
        played = play(simulator, clocks=60, inputs=on(gate=gate), changes=changes)
        assert next(n for n, (_, o) in enumerate(played) if not o["preset"]) == t0
