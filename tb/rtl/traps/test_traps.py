# SPDX-License-Identifier: Apache-2.0
"""Run wrong designs next to the right one; each must read its own number (docs/rtl.md, traps)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rtl_run import RTL, changed, simulate

from scripts.lint import header_values
from tb.reference.chip import Duty, code, duty_of_resistance

pytestmark = pytest.mark.timeout(120)

HALF: Duty = (1, 2)  # 500 ohm
BREAK_CLOCKS = header_values()["DERMIS_BREAK_CLOCKS"]


# Each wrong variant is a Verilator build of its own, of ten seconds: the second simulator is for
# the long tests here.
@pytest.fixture(params=["icarus", pytest.param("verilator", marks=pytest.mark.long)])
def simulator(request: pytest.FixtureRequest) -> str:
    return request.param


def read(
    simulator: str,
    x: list[list[Duty]],
    trap: str | Path | None,
    slots: int,
    parameters: dict[str, int],
    gate: int = 510,
    settle: int = 115,
    **more: Any,
) -> Any:
    """Return the result of `slots` slots, by default with default timing, with one wrong module."""
    p = {"ROWS": len(x), "COLS": len(x[0]), **parameters}
    settings = {"gate_i": gate, "settle_i": settle}
    scenario = {
        "x": x,
        "slots": slots,
        "limit": 800 * slots + 50,
        "checks": trap is None,
        "settings": settings,
        **more,
    }
    return simulate(simulator, "bench_reader", "dermis_reader", "frames", p, scenario, trap=trap)


# The counter of a code of 7 bits has 8, with no bit to spare for a pedestal.
EIGHT = {"CODE_BITS": 7}


def first_counts(result: Any) -> list[int]:
    return result["slots"][0]["counts"]


# (a) a counter that wraps at full scale


@pytest.mark.parametrize(("gate", "wrapped"), [(512, 0), (516, 2)])
def test_wrapping_counter_reads_500_ohm_as_almost_nothing(simulator: str, gate: int, wrapped: int) -> None:
    timing = {"gate": gate, "settle": 625 - gate}
    x: list[list[Duty]] = [[HALF, (100, 510)]]
    assert first_counts(read(simulator, x, None, 1, EIGHT, **timing)) == [255, code(x[0][1], gate, 8)]
    wrong = read(simulator, x, "counter_wraps", 1, EIGHT, **timing)
    assert first_counts(wrong) == [wrapped, code(x[0][1], gate, 8)]


# (b) a gate of 511 clocks depends on the phase

PHASES: list[Duty] = [(-n, 16) for n in range(16, 0, -1)]  # stored charge at t0, over a whole packet


def test_510_clocks_read_500_ohm_as_255_at_any_phase_and_511_do_not(simulator: str) -> None:
    x = [[HALF] * 16]
    right = read(simulator, x, None, 1, {}, w_preset=PHASES)
    assert first_counts(right) == [255] * 16
    odd = read(simulator, x, None, 1, {}, gate=511, settle=114, w_preset=PHASES)
    assert first_counts(odd) == [255] * 8 + [256] * 8


@pytest.mark.long
def test_511_clocks_into_a_wrapping_counter_read_255_or_0_by_phase(simulator: str) -> None:
    x = [[HALF] * 16]
    assert first_counts(read(simulator, x, None, 1, EIGHT, w_preset=PHASES)) == [255] * 16
    wrong = read(simulator, x, "counter_wraps", 1, EIGHT, gate=511, settle=114, w_preset=PHASES)
    assert first_counts(wrong) == [255] * 8 + [0] * 8


# (c) two flops on the same clock edge


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


@pytest.mark.long
def test_q_bar_of_the_second_flop_halves_the_edges_and_doubles_their_width(simulator: str) -> None:
    right = read(simulator, [DUTIES], None, 1, {})
    assert first_counts(right) == [255, 200, 100, 10]
    assert right["charge_clocks"] == right["rising_edges"]  # one clock wide
    wrong = read(simulator, [DUTIES], "sync_second_qbar", 1, {})
    assert first_counts(wrong) == [rising_edges_with_wrong_gating(x, 510, first_gates=False) for x in DUTIES]
    assert first_counts(wrong) == [128, 100, 50, 5]
    assert wrong["charge_clocks"] == [2 * edges for edges in wrong["rising_edges"]]


@pytest.mark.long
def test_q_bar_of_both_flops_caps_the_rate_at_a_third(simulator: str) -> None:
    assert first_counts(read(simulator, [DUTIES], None, 1, {})) == [255, 200, 100, 10]
    wrong = read(simulator, [DUTIES], "sync_both_qbar", 1, {})
    assert first_counts(wrong) == [rising_edges_with_wrong_gating(x, 510, first_gates=True) for x in DUTIES]
    assert first_counts(wrong) == [170, 170, 100, 10]


# (d) charge left over from an overloaded row


def counts_without_preset(x_rows: list[Duty], gate_clocks: int, settle_clocks: int) -> list[int]:
    """Counts of successive rows when only the first starts from -1/2 and the converter runs on through each settle."""
    packet = 2
    for _, q in x_rows:
        packet *= q
    w, last, counts = -packet // 2, 0, []
    for row, (p, q) in enumerate(x_rows):
        count = 0
        for n in range(gate_clocks + (settle_clocks if row else 0)):
            driven = row == 0 or n >= BREAK_CLOCKS
            w += (
                p * packet // q if driven else 0
            )  # the row's current flows from the clock edge that drives it
            w -= last * packet
            last = int(w >= 0 and not last)
            counting = n >= settle_clocks or not row
            count += last if counting else 0
        counts.append(min(511, count))
    return counts


def scanner_that_presets_once(directory: Path) -> Path:
    """Write a copy of the row scanner that presets only in the first settle after enable."""
    text = (RTL / "dermis_row_scanner.v").read_text()
    old = "  assign preset_o       = preset_q;\n"
    if text.count(old) != 1:
        raise ValueError("rtl/dermis_row_scanner.v no longer has the line to change")
    new = """  reg gated_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) gated_q <= 1'b0;
    else         gated_q <= active_q & (gated_q | ~preset_q);
  assign preset_o      = preset_q & ~(gated_q & active_q);
"""
    wrong = directory / "scanner_that_presets_once.v"
    wrong.write_text(text.replace(old, new))
    return wrong


@pytest.mark.long
def test_charge_of_a_312_ohm_taxel_is_counted_in_the_next_row_without_preset(
    simulator: str, tmp_path: Path
) -> None:
    overload, two = duty_of_resistance((312, 1)), (2, 510)
    x = [[overload], [two], [two]]
    assert [s["counts"] for s in read(simulator, x, None, 4, {})["slots"]] == [[255], [2], [2], [255]]
    wrong = [s["counts"][0] for s in read(simulator, x, scanner_that_presets_once(tmp_path), 5, {})["slots"]]
    assert wrong == counts_without_preset([overload, two, two, overload, two], 510, 115)
    # 98 after 510 clocks of overload (the first row is preset in its settle), 133 after 624, a slot
    # without its break.
    assert wrong == [255, 98, 2, 255, 133]


@pytest.mark.long
def test_charge_of_a_312_ohm_taxel_fakes_100_counts_with_a_gate_of_512_clocks(
    simulator: str, tmp_path: Path
) -> None:
    """Read 100 with a gate of 512 clocks; a start above the preset would give up to 102."""
    overload, two = duty_of_resistance((312, 1)), (2, 510)
    timing = {"gate": 512, "settle": 113}
    x = [[overload], [two], [two]]
    right = read(simulator, x, None, 2, {}, **timing)
    assert [s["counts"] for s in right["slots"]] == [[256], [2]]
    wrong = read(simulator, x, scanner_that_presets_once(tmp_path), 2, {}, **timing)
    assert [s["counts"][0] for s in wrong["slots"]] == [256, 100]
    assert counts_without_preset([overload, two], 512, 113) == [256, 100]


# (e) no second buffer for the serial output


def test_128_bits_read_at_one_a_clock_are_torn_without_the_second_buffer(simulator: str) -> None:
    x: list[list[Duty]] = [[HALF] * 16, [(0, 1)] * 16]
    serial = {"shift_clocks": 8, "busy": False}
    right = read(simulator, x, None, 2, EIGHT, **serial)
    assert [s["counts"] for s in right["slots"]] == [[255] * 16, [0] * 16]
    wrong = [s["counts"] for s in read(simulator, x, "buffer_single", 2, EIGHT, **serial)["slots"]]
    # 115 bits are out when the counters start again: 14 counts and three bits of the 15th; the 16th
    # is lost.
    assert wrong[0] == [255] * 14 + [0b111, 0]
    # Row 1 is empty, but its last 13 bits are those of row 0, counted again: one pulse every second
    # clock from t1.
    counted_again = [(1 + (k - 115) // 2) >> (k % 8) & 1 for k in range(115, 128)]
    bits = [0] * 115 + counted_again
    assert wrong[1] == [sum(bits[8 * c + b] << b for b in range(8)) for c in range(16)]


# (f) the shortest settle


@pytest.mark.long
@pytest.mark.parametrize(
    ("sync_latch", "counts_of_60"), [(0, [2, 1, 1, 1]), (1, [2, 1, 2, 1])], ids=["sync_ff", "sync_latch"]
)
def test_preset_of_one_clock_charges_the_next_slot_for_the_last_sample(
    simulator: str, tmp_path: Path, sync_latch: int, counts_of_60: list[int]
) -> None:
    """A scanner that opens the gate with the row: the packet of a one in the last sample falls behind preset."""
    opens = ("clocks_q     <= settle_q;", "clocks_q     <= gate_q - 1'b1; preset_q <= 1'b0;")
    wrong = changed(tmp_path, "dermis_row_scanner", opens)
    # Duty 1/40: ones at samples 20, 60, 100... of a slot that starts from the preset.
    x: list[list[Duty]] = [[(1, 40)]]
    p = {"SYNC_LATCH": sync_latch}
    for gate, rest in ((20, 1), (19, 0)):
        right = read(simulator, x, None, 3, p, gate=gate, settle=3)
        assert [s["counts"] for s in right["slots"]] == [[rest]] * 3
    # Gate of 20: the only one is the last sample. The slot behind it misses its own one, and the
    # next has it again.
    short = read(simulator, x, wrong, 4, p, gate=20)
    assert [s["counts"] for s in short["slots"]] == [[1], [0], [1], [0]]
    # Gate of 60, which ends with a one as well: a whole packet lost puts the next slot's only one
    # at sample 60 again, half a packet (the latch form) at sample 40, so that the slot after it is
    # right.
    long = read(simulator, x, wrong, 4, p, gate=60)
    assert [s["counts"] for s in long["slots"]] == [[c] for c in counts_of_60]
