# SPDX-License-Identifier: Apache-2.0
"""The slot sequencer against a plain reading of docs/rtl.md, clock by clock."""

import random
from collections.abc import Mapping
from pathlib import Path

import pytest
from rtl_run import changed
from rtl_run import play as run

pytestmark = pytest.mark.timeout(120)

INJECT, DARK, FULL_EVEN, FULL_ODD = 0xF0, 0xF1, 0xF2, 0xF3
SPECIAL = (INJECT, DARK, FULL_EVEN, FULL_ODD)
PACK_CLOCKS = 8

Played = list[tuple[dict[str, int], dict[str, int]]]


INPUTS = "enable continuous shot test dark hold pedestal_mode settle gate row_mask busy".split()
OUTPUTS = """row_select preset gate inject full_even full_odd frame_start scanning slot_done
    done_slot done_first done_last done_test done_dark done_mode done_gate""".split()


def random_inputs(rng: random.Random, rows: int, last: dict[str, int]) -> dict[str, int]:
    """Inputs that dwell, so that whole frames happen as well as every kind of interruption."""
    new = dict(last)
    new["enable_i"] = int(rng.random() < (0.985 if last["enable_i"] else 0.3))
    new["continuous_i"] = int(rng.random() < (0.98 if last["continuous_i"] else 0.01))
    new["shot_i"] = int(rng.random() < 0.01)
    new["test_i"] = int(rng.random() < 0.005)
    new["hold_i"] = int(rng.random() < (0.95 if last["hold_i"] else 0.02))
    new["busy_i"] = int(rng.random() < (0.8 if last["busy_i"] else 0.05))
    if rng.random() < 0.02:
        new["dark_i"] = rng.randint(0, 1)
        new["pedestal_mode_i"] = rng.randrange(4)
        new["settle_i"] = rng.choice([0, 1, 2, 3, 4, 7, 12])
        new["gate_i"] = rng.choice([0, 1, 2, 5, 9])
        new["row_mask_i"] = rng.choice([0, (1 << rows) - 1, rng.getrandbits(rows)])
    return new


def random_steps(rows: int, clocks: int) -> list[dict[str, int]]:
    rng = random.Random(9)
    now = {f"{n}_i": 0 for n in INPUTS} | {"row_mask_i": (1 << rows) - 1, "settle_i": 5, "gate_i": 4}
    return [now := random_inputs(rng, rows, now) for _ in range(clocks)]


def play(simulator: str, shape: Mapping[str, int], steps: list, trap: Path | None = None) -> Played:
    """Return inputs and the outputs after each edge, by port name without its suffix."""
    p = {"PACK_CLOCKS": PACK_CLOCKS, **shape}
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
        self.done = dict.fromkeys(("slot", "first", "last", "test", "dark", "mode", "gate"), 0)

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
            self.done = {"slot": self.slots[0], "first": self.first, "last": int(len(self.slots) == 1)}
            self.done |= {key: self.frame[key] for key in ("test", "dark", "mode", "gate")}
            self.first = 0
            self.slots = self.slots[1:]
            self.age, self.gate_age = 0, None
        starts = 0
        if not i["enable"]:
            self.slots = []
        elif not self.slots and not i["hold"] and (slots := self.list_of(i)):
            starts = 1
            self.slots, self.first, self.age, self.gate_age = slots, 1, 0, None
            self.frame = {
                "settle": max(i["settle"], 2 + self.break_clocks),
                "gate": max(i["gate"], 1),
                "asked": i["gate"],
                "test": self.test,
                "dark": int(DARK in slots),
                "mode": i["pedestal_mode"],
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
def test_each_output_moves_on_its_edge_and_no_other_whatever_the_inputs(simulator: str, shape: dict) -> None:
    played = play(simulator, shape, random_steps(shape["ROWS"], 8000))
    against_the_words(played, shape["ROWS"], shape.get("BREAK_CLOCKS", 1))
    done = [o for _, o in played if o["slot_done"]]
    # Seen often enough to mean something: frames of each kind, slots of each kind, cuts, waits.
    assert {o["done_slot"] for o in done} == {*range(shape["ROWS"]), *SPECIAL}
    assert {(o["done_test"], o["done_dark"]) for o in done} == {(0, 0), (0, 1), (1, 1)}
    assert sum(o["frame_start"] for _, o in played) > 30
    assert any(not i["enable"] and o["slot_done"] for i, o in played)


def test_the_last_of_128_rows_and_a_long_break(simulator: str) -> None:
    still = {f"{n}_i": 0 for n in INPUTS} | {"enable_i": 1, "continuous_i": 1, "settle_i": 30, "gate_i": 4}
    steps = [still | {"row_mask_i": 1 << 127 | 1 << 64 | 1 << n // 100} for n in range(1200)]
    against_the_words(played := play(simulator, {"ROWS": 128, "BREAK_CLOCKS": 20}, steps), 128, 20)
    assert {o["done_slot"] for _, o in played if o["slot_done"]} >= {0, 5, 64, 127}


SEEDED = {
    "no break": ("row_select_q <= {ROWS{1'b0}};\n      inject_q     <= next[0];", "inject_q     <= next[0];"),
    "the last row is lost": ("slots_q      <= next;", "slots_q      <= next & {1'b0, {(SLOTS-1){1'b1}}};"),
    "a shot is served twice": ("(shot_q & ~(frame_load & ~test_q))", "(shot_q & ~(frame_load & test_q))"),
    "no wait for the taker": ("if (!(busy_i & short_q))", "if (1'b1)"),
    "settle not clamped": ("(settle_i < SHORTEST[15:0])", "(settle_i < 16'd2)"),
    "gate not clamped": ("(gate_i == 16'd0)", "(gate_i == 16'd65535)"),
    "settings within a frame": (
        "(frame_load) begin\n        first_q ",
        "(slot_start) begin\n        first_q ",
    ),
    "a test is not held": ("| test_q) & ~hold_i", ") & ~hold_i | test_q"),
    "a mode of another frame": ("done_mode_q  <= mode_q;", "done_mode_q  <= pedestal_mode_i;"),
    "a cut slot is delivered": ("<= slot_end;", "<= slot_end | (active_q & ~enable_i);"),
    "a slot cut by its last edge is lost": ("<= slot_end;", "<= slot_end & enable_i;"),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", SEEDED)
def test_the_reading_finds_a_seeded_fault(fault: str, tmp_path: Path) -> None:
    wrong = changed(tmp_path, "dermis_row_scanner", SEEDED[fault])
    played = play("icarus", SHAPES[0], random_steps(4, 4000), wrong)
    with pytest.raises(AssertionError, match="edge "):
        against_the_words(played, 4, 1)
