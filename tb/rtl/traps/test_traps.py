# SPDX-License-Identifier: Apache-2.0
"""The traps of FACTS 1.3 to 1.6: the right design beside the wrong one, each with the number it must read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from rtl_reference import Duty, code, duty_of_resistance
from rtl_run import ROOT, simulate

pytestmark = pytest.mark.timeout(120)

HALF: Duty = (1, 2)  # 500 ohm


def read(
    simulator: str,
    x: list[list[Duty]],
    trap: str | Path | None,
    slots: int,
    parameters: dict[str, int],
    **more: Any,
) -> Any:
    """Result of `slots` slots of the default timing, with one module replaced by its wrong variant."""
    p = {"ROWS": len(x), "COLS": len(x[0]), **parameters}
    scenario = {"x": x, "slots": slots, "limit": 800 * slots + 50, "checks": trap is None, **more}
    return simulate(simulator, "bench_top", "dermis_top", "frames", p, scenario, trap=trap)


def first_codes(result: Any) -> list[int]:
    return result["slots"][0]["codes"]


# (a) FACTS 1.3


@pytest.mark.parametrize(("gate", "wrapped"), [(512, 0), (516, 2)])
def test_wrapping_counter_reads_500_ohm_as_almost_nothing(simulator: str, gate: int, wrapped: int) -> None:
    timing = {"GATE_CLOCKS": gate, "SETTLE_CLOCKS": 625 - gate}
    x: list[list[Duty]] = [[HALF, (100, 510)]]
    assert first_codes(read(simulator, x, None, 1, timing)) == [255, code(x[0][1], gate, 8)]
    assert first_codes(read(simulator, x, "counter_wraps", 1, timing)) == [wrapped, code(x[0][1], gate, 8)]


# (b) FACTS 1.3

PHASES: list[Duty] = [(-n, 16) for n in range(16, 0, -1)]  # stored charge at t0, over a whole packet


def test_510_clocks_read_500_ohm_as_255_at_any_phase_and_511_do_not(simulator: str) -> None:
    x = [[HALF] * 16]
    right = read(simulator, x, None, 1, {"CODE_BITS": 9}, w_preset=PHASES)
    assert first_codes(right) == [255] * 16
    odd = read(
        simulator, x, None, 1, {"CODE_BITS": 9, "GATE_CLOCKS": 511, "SETTLE_CLOCKS": 114}, w_preset=PHASES
    )
    assert first_codes(odd) == [255] * 8 + [256] * 8


def test_511_clocks_into_a_wrapping_counter_read_255_or_0_by_phase(simulator: str) -> None:
    x = [[HALF] * 16]
    assert first_codes(read(simulator, x, None, 1, {}, w_preset=PHASES)) == [255] * 16
    wrong = read(
        simulator, x, "counter_wraps", 1, {"GATE_CLOCKS": 511, "SETTLE_CLOCKS": 114}, w_preset=PHASES
    )
    assert first_codes(wrong) == [255] * 8 + [0] * 8


# (c) FACTS 1.5


def rising_edges_with_wrong_gating(x: Duty, gate_clocks: int, first_gates: bool) -> int:
    """Rising edges of two flops on one clock edge with the second's Q-bar (and the first's, if `first_gates`)."""
    p, q = x
    w, first, second, edges = -q + 2 * p, 0, 0, 0  # in 1/(2q) packets, -1/2 + x at t1
    for _ in range(gate_clocks):
        sample = int(w >= 0 and not second and not (first and first_gates))
        edges += sample and not first
        first, second = sample, first
        w += 2 * p - 2 * q * second
    return edges


DUTIES: list[Duty] = [HALF, (200, 510), (100, 510), (10, 510)]


def test_q_bar_of_the_second_flop_halves_the_edges_and_doubles_their_width(simulator: str) -> None:
    right = read(simulator, [DUTIES], None, 1, {})
    assert first_codes(right) == [255, 200, 100, 10]
    assert right["charge_clocks"] == right["rising_edges"]  # one clock wide
    wrong = read(simulator, [DUTIES], "sync_second_qbar", 1, {})
    assert first_codes(wrong) == [rising_edges_with_wrong_gating(x, 510, first_gates=False) for x in DUTIES]
    assert first_codes(wrong) == [128, 100, 50, 5]
    assert wrong["charge_clocks"] == [2 * edges for edges in wrong["rising_edges"]]


def test_q_bar_of_both_flops_caps_the_rate_at_a_third(simulator: str) -> None:
    assert first_codes(read(simulator, [DUTIES], None, 1, {})) == [255, 200, 100, 10]
    wrong = read(simulator, [DUTIES], "sync_both_qbar", 1, {})
    assert first_codes(wrong) == [rising_edges_with_wrong_gating(x, 510, first_gates=True) for x in DUTIES]
    assert first_codes(wrong) == [170, 170, 100, 10]


# (d) FACTS 1.4


def codes_without_preset(x_rows: list[Duty], gate_clocks: int, settle_clocks: int) -> list[int]:
    """Codes of successive rows when only the first starts from -1/2 and the converter runs on through each settle."""
    packet = 2
    for _, q in x_rows:
        packet *= q
    w, last, codes = -packet // 2, 0, []
    for row, (p, q) in enumerate(x_rows):
        count = 0
        for n in range(gate_clocks + (settle_clocks if row else 0)):
            w += p * packet // q  # the row's current flows from the clock edge that drives it
            w -= last * packet
            last = int(w >= 0 and not last)
            counting = n >= settle_clocks or not row
            count += last if counting else 0
        codes.append(min(255, count))
    return codes


def test_charge_of_a_312_ohm_taxel_is_counted_in_the_next_row_without_preset(simulator: str) -> None:
    overload, two = duty_of_resistance((312, 1)), (2, 510)
    x = [[overload], [two], [two]]
    assert [s["codes"] for s in read(simulator, x, None, 4, {})["slots"]] == [[255], [2], [2], [255]]
    wrong = [s["codes"][0] for s in read(simulator, x, "scanner_presets_once", 5, {})["slots"]]
    assert wrong == codes_without_preset([overload, two, two, overload, two], 510, 115)
    # 98 after 510 clocks of overload (the first row is preset in its settle), 133 after a whole slot of 625 of them.
    assert wrong == [255, 98, 2, 255, 133]


def test_charge_of_a_312_ohm_taxel_fakes_100_counts_with_a_gate_of_512_clocks(simulator: str) -> None:
    """The gate FACTS 1.4 seems to have been computed for: its 102 needs 512 clocks and a start above the preset."""
    overload, two = duty_of_resistance((312, 1)), (2, 510)
    timing = {"GATE_CLOCKS": 512, "SETTLE_CLOCKS": 113}
    x = [[overload], [two]]
    assert [s["codes"] for s in read(simulator, x, None, 2, timing)["slots"]] == [[255], [2]]
    wrong = [s["codes"][0] for s in read(simulator, x, "scanner_presets_once", 2, timing)["slots"]]
    assert wrong == [255, 100] == codes_without_preset([overload, two], 512, 113)


# (e) FACTS 1.6


def test_128_bits_read_at_one_a_clock_are_torn_without_the_second_buffer(simulator: str) -> None:
    scenario = {"x": [[HALF] * 16, [(0, 1)] * 16], "slots": 2, "limit": 800}
    p = {"ROWS": 2, "COLS": 16}
    right = simulate(simulator, "bench_traps", "dermis_top", "serial_readout", p, scenario)
    assert right == [[255] * 16, [0] * 16]
    wrong = simulate(
        simulator, "bench_traps", "dermis_top", "serial_readout", p, scenario, trap="buffer_single"
    )
    # 115 bits are out when the counters start again: 14 codes and three bits of the 15th; the 16th is lost.
    assert wrong[0] == [255] * 14 + [0b111, 0]
    # Row 1 is empty, but its last 13 bits are those of row 0, counted again: one pulse every second clock from t1.
    counted_again = [(1 + (k - 115) // 2) >> (k % 8) & 1 for k in range(115, 128)]
    bits = [0] * 115 + counted_again
    assert wrong[1] == [sum(bits[8 * c + b] << b for b in range(8)) for c in range(16)]


# (f) the shortest settle


@pytest.mark.parametrize(
    ("sync_latch", "codes_of_60"), [(0, [2, 1, 1, 1]), (1, [2, 1, 2, 1])], ids=["sync_ff", "sync_latch"]
)
def test_settle_of_one_clock_charges_the_next_slot_for_the_last_sample(
    simulator: str, tmp_path: Path, sync_latch: int, codes_of_60: list[int]
) -> None:
    """The check in dermis_top taken out: the packet of a one in the last sample falls behind preset, whole or half."""
    top = (ROOT / "rtl" / "dermis_top.v").read_text()
    unchecked, checks = re.subn(r"if \(SETTLE_CLOCKS < 2\) begin.*?end\n", "", top, flags=re.DOTALL)
    assert checks == 1
    wrong = tmp_path / "top_unchecked.v"
    wrong.write_text(unchecked)
    # Duty 1/40: ones at samples 20, 60, 100... of a slot that starts from the preset.
    x: list[list[Duty]] = [[(1, 40)]]
    for gate, rest in ((20, 1), (19, 0)):
        timing = {"GATE_CLOCKS": gate, "SETTLE_CLOCKS": 2, "SYNC_LATCH": sync_latch}
        assert [s["codes"] for s in read(simulator, x, None, 3, timing)["slots"]] == [[rest]] * 3
    # Gate of 20: the only one is the last sample. The slot behind it misses its own one, and the next has it again.
    timing = {"GATE_CLOCKS": 20, "SETTLE_CLOCKS": 1, "SYNC_LATCH": sync_latch}
    assert [s["codes"] for s in read(simulator, x, wrong, 4, timing)["slots"]] == [[1], [0], [1], [0]]
    # Gate of 60, which ends with a one as well: a whole packet lost puts the next slot's only one at sample 60 again,
    # half a packet (the latch form) at sample 40, so that the slot after it is right.
    timing = {"GATE_CLOCKS": 60, "SETTLE_CLOCKS": 1, "SYNC_LATCH": sync_latch}
    assert [s["codes"] for s in read(simulator, x, wrong, 4, timing)["slots"]] == [[c] for c in codes_of_60]
