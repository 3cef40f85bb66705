# SPDX-License-Identifier: Apache-2.0
"""What is left of a slot's transient in the gate, against the nodal equations integrated in many digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dermis.array import settling, star_mesh
from dermis.array.array import Network, column_currents
from dermis.array.settling import Unsupported, bound_c, transients
from dermis.errors import SimulatorError
from dermis.records import Timing
from tb.reference.lines_reference import charge_reference

TIMING = Timing(f_clk_hz=5e6, slot_clocks=40, settle_clocks=8, gate_clocks=32, code_max=255, rows=3)


def random_network(rng: np.random.Generator) -> Network:
    """Draw a small array with every kind of driver, input and capacitance there or not."""
    rows, cols = rng.integers(1, 4, 2)
    g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e6), (rows, cols)))
    g[rng.random((rows, cols)) < 0.2] = 0.0
    ohm = [0.0, 50.0, 1e3, 5e3]
    capacitance = [0.0, 1e-12, 1e-10, 1e-9]
    grounded = rng.choice([*ohm, np.inf])
    c_taxel = rng.choice([0.0, 1e-12, 1e-10])
    if grounded == np.inf and c_taxel:
        g[g == 0] = 1e-7  # the isolated row has its own test
    return Network(
        g,
        0.5,
        r_row_driven_ohm=rng.choice(ohm),
        r_row_grounded_ohm=grounded,
        r_column_ohm=rng.choice(ohm, cols),
        v_column_offset_v=rng.choice([0.0, 1e-3], cols),
        g_lateral_row_s=rng.choice([0.0, 1e-4]),
        i_leak_a=rng.choice([0.0, 1e-6], cols),
        c_row_f=rng.choice(capacitance),
        c_column_f=rng.choice(capacitance),
        c_taxel_f=c_taxel,
    )


def test_modes_are_the_matrix_exponential_and_stay_within_the_bound() -> None:
    rng = np.random.default_rng(6)
    solved = bounded = missed = 0
    for draw in range(45):
        network, timing = random_network(rng), replace(TIMING, break_clocks=(0, 1, 3)[draw % 3])
        reference = charge_reference(network, timing)[..., timing.settle_clocks :]
        largest = np.abs(reference).max()

        def extra(timing: Timing) -> NDArray[np.float64]:
            found = transients(network, network.g_taxel_s[np.newaxis], timing, 1e-30)  # noqa: B023
            return np.zeros_like(reference) if found is None else found.per_clock(timing.gate_clocks)[0]  # noqa: B023

        # 1e-25 C is one packet in 5e13; the modes' own rounding is a part of the largest charge that flows.
        assert np.abs(extra(timing) - reference).max() <= 1e-12 * largest + 1e-25
        bound = bound_c(network, network.g_taxel_s[np.newaxis], timing)
        # A bound that is met with equality, up to rounding; 1e-25 C is one packet in 5e13.
        assert (np.abs(reference).sum(axis=2).max(axis=0) <= bound * (1 + 1e-9) + 1e-25).all()
        # One packet in 5e8: a transient that matters to nobody's code.
        solved += largest > 1e-20
        # One packet in 5e13, as above.
        bounded += bool(np.isfinite(bound).all() and largest > 1e-25)
        # A row that is driven while the one before is let go, as a fault.
        at_once = np.abs(extra(replace(timing, break_clocks=0)) - reference).max()
        # A fault of a ten-thousandth of the charge is a hundred million times what the tie allows.
        missed += bool(timing.break_clocks and largest > 1e-20 and at_once > 1e-4 * largest)
    assert solved > 15  # transients that matter did occur,
    assert bounded > 2  # bounds that say something beside something to bound,
    assert missed > 8  # and breaks that matter


PACKET_C = 1.6e-14  # 80 packets of 0.2 fC: what moves a code by one


def stiff_network(rng: np.random.Generator) -> Network:
    """Draw a small array whose time constants lie anywhere from femtoseconds to ages."""
    rows, cols = rng.integers(1, 4, 2)

    def farad() -> float:
        return rng.choice([0.0, 10 ** rng.uniform(-15, 0)])

    return Network(
        10 ** -rng.uniform(2, 15, (rows, cols)),
        0.5,
        10 ** rng.uniform(-1, 12),
        rng.choice([10 ** rng.uniform(0, 12), np.inf]),
        10 ** rng.uniform(-2, 12, cols),
        rng.choice([0, 1e-3], cols),
        rng.choice([0, 10 ** rng.uniform(-9, 4)]),
        i_leak_a=rng.choice([0, 1e-6], cols),
        c_row_f=farad(),
        c_column_f=farad(),
        c_taxel_f=farad(),
    )


# What plain dense matrices missed by most of 600 draws, without a word: by 748, 6.1, 3.7, 3.1 and 1.3 codes. Most of
# them hold coulombs, of which a double does not tell a packet.
@pytest.mark.parametrize(
    ("seed", "followed"), [(431, False), (234, False), (360, False), (536, True), (183, False)]
)
def test_time_constants_over_many_decades_cost_no_code(seed: int, followed: bool) -> None:
    network, timing = stiff_network(np.random.default_rng(seed)), replace(TIMING, break_clocks=1)
    g = network.g_taxel_s[np.newaxis]
    # As for the array solve (solve_error.LIMIT_LSB).
    bearable_c = 1e-3 * PACKET_C
    if not followed:
        with pytest.raises(Unsupported, match=r"rounding error .* C\); smaller capacitances"):
            transients(network, g, timing, 1e-30, bearable_c=bearable_c)
    reference = charge_reference(network, timing)[..., timing.settle_clocks :]
    found = transients(network, g, timing, 1e-30, bearable_c=bearable_c if followed else np.inf)
    got = np.zeros_like(reference) if found is None else found.per_clock(timing.gate_clocks)[0]
    error = np.abs(got - reference).sum(axis=2).max()
    slots = settling._Slots(network, g, timing)
    slots.transients(1e-30, None)
    assert error <= slots.rounding_c
    assert (error < bearable_c) or not followed


@pytest.mark.parametrize("pause", [0, 1, 3])
def test_what_flows_before_the_gate_is_the_matrix_exponential_too(pause: int) -> None:
    rng, timing = np.random.default_rng(8), replace(TIMING, break_clocks=pause)
    for grounded in (50.0, 400.0, np.inf):
        g = 1 / np.exp(rng.uniform(np.log(100), np.log(1e5), (3, 2)))
        ohm = {"r_row_driven_ohm": 50.0, "r_row_grounded_ohm": grounded, "r_column_ohm": [30.0, 2e3]}
        farad = {"c_row_f": 4e-10, "c_column_f": 1e-9, "c_taxel_f": 1e-10 if pause else 0.0}
        network = Network(g, 0.5, **ohm, v_column_offset_v=1e-3, i_leak_a=1e-6, g_lateral_row_s=1e-5, **farad)
        reference = charge_reference(network, timing)
        found = transients(network, None, timing, 1e-35, 1e-35)
        assert found is not None
        n = np.arange(TIMING.slot_clocks)
        got = np.matmul(found.driven_c, found.decay[..., None] ** np.maximum(n - pause, 0))[0]
        got[..., :pause] = np.matmul(found.break_c, found.break_decay[..., None] ** n[:pause])[0]
        largest = np.abs(reference).max()
        # There is something to compare, a fifth of a packet; the modes' own rounding is a part of the largest
        # charge.
        assert largest > 1e-12
        assert np.abs(got - reference).max() < 1e-12 * largest
        assert np.abs(reference[1:, :, :pause]).max(initial=largest if pause == 0 else 0.0) > 1e-3 * largest


def test_one_column_behind_a_resistance_settles_as_a_textbook_rc() -> None:
    r, c = 4e3, 3e-9
    g = np.array([[1e-3], [2e-3]])
    network = Network(g, 0.5, r_column_ohm=r, c_column_f=c)
    found = transients(network, g[np.newaxis], TIMING, 1e-25)
    total = g.sum() + 1 / r  # both rows are sources
    tau = c / total
    jump = 0.5 * (g[0, 0] - g[1, 0]) / total  # where row 0 left the column, less where it goes
    t = (TIMING.settle_clocks + np.arange(TIMING.gate_clocks + 1)) / TIMING.f_clk_hz
    # the first row starts settled
    expected = np.stack([np.zeros(32), -np.diff(np.exp(-t / tau)) * jump * tau / r])
    assert found is not None
    # exp(-t / tau) of t / tau up to 1e2 loses two digits, the difference of clocks four; 1e-27 C where all is
    # gone.
    assert found.per_clock(TIMING.gate_clocks)[0, :, 0] == pytest.approx(expected, rel=1e-9, abs=1e-27)


def test_frames_do_not_see_each_other() -> None:
    g = 1 / np.random.default_rng(2).uniform(500, 5000, (3, 2, 4))
    network = Network(g[0], 0.5, 1e3, 2e3, 500.0, c_row_f=1e-10, c_column_f=3e-9)
    together = transients(network, g, TIMING, 1e-25)
    assert together is not None
    for frame in range(3):
        alone = transients(network, g[frame : frame + 1], TIMING, 1e-25)
        assert alone is not None
        # Eigenvectors of a frame alone and in a batch may round otherwise; 1e-25 C is what transients leave
        # out.
        assert together.per_clock(32)[frame] == pytest.approx(alone.per_clock(32)[0], rel=1e-9, abs=1e-25)


def test_the_chip_as_it_is_settles_without_a_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settling, "_Slots", lambda *_: pytest.fail("there was a solve"))
    timing = Timing(5e6, 625, 115, 510, 255, 16)
    g = np.full((1, 16, 16), 1 / 500)
    lines = {"c_row_f": 1e-10, "c_column_f": 1e-10, "c_taxel_f": 1e-11}
    traces = {"r_trace_row_ohm": 0.1, "r_trace_column_ohm": 0.1}
    for kind in (lines, lines | traces, lines | {"r_row_grounded_ohm": np.inf}, {}):
        network = Network(g[0], 0.5, **({"r_row_driven_ohm": 5.0, "r_row_grounded_ohm": 5.0} | kind))
        assert transients(network, g, timing, 1e-18 * 80 * 5e-12) is None


def test_what_cannot_be_followed_is_refused_by_name() -> None:
    g = np.full((1, 3, 2), 1e-3)
    slow = {"r_row_driven_ohm": 1e4, "r_column_ohm": 1e4, "c_column_f": 1e-9}
    with pytest.raises(Unsupported, match=r"line_capacitance .* trace"):
        transients(Network(g[0], 0.5, **slow, r_trace_row_ohm=1.0), g, TIMING, 1e-25)
    g[0, 1] = 0.0
    alone = Network(g[0], 0.5, **slow, r_row_grounded_ohm=np.inf, c_taxel_f=1e-12)
    with pytest.raises(Unsupported, match=r"line_capacitance .* floating row"):
        transients(alone, g, TIMING, 1e-25)


def test_capacitances_move_no_direct_current() -> None:
    g = 1 / np.random.default_rng(2).uniform(500, 5000, (2, 3))
    kind = {"r_row_driven_ohm": 1.0, "r_column_ohm": 2.0}
    loaded = Network(g, 0.5, **kind, c_row_f=1e-9, c_column_f=1e-9, c_taxel_f=1e-9)
    assert (column_currents(loaded) == column_currents(Network(g, 0.5, **kind))).all()
    assert loaded.active_fields() >= {"c_row_f", "c_column_f", "c_taxel_f"}


def test_a_wrong_mode_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    g = 1 / np.random.default_rng(2).uniform(500, 5000, (1, 2, 4))
    network = Network(g[0], 0.5, 1e3, 2e3, 500.0, c_row_f=1e-10, c_column_f=3e-9)
    eigh = np.linalg.eigh

    def broken(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        tau, vectors = eigh(matrix)
        return tau * (1 + 1e-4), vectors

    monkeypatch.setattr(np.linalg, "eigh", broken)
    with pytest.raises(Unsupported, match=r"too far apart"):
        transients(network, g, TIMING, 1e-25)


def test_a_voltage_that_is_not_a_number_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    g = 1 / np.random.default_rng(2).uniform(500, 5000, (1, 2, 4))
    network = Network(g[0], 0.5, 1e3, 2e3, 500.0, c_row_f=1e-10, c_column_f=3e-9)
    up = star_mesh.up

    def broken(work: NDArray[np.float64], *arguments: Any) -> None:
        up(work, *arguments)
        work[0, 0, -1] = np.nan

    monkeypatch.setattr(star_mesh, "up", broken)
    with pytest.raises(SimulatorError, match="settling of the lines: a voltage"):
        transients(network, g, TIMING, 1e-25)


def test_absurd_values_are_bounded_solved_or_refused() -> None:
    rng = np.random.default_rng(3)
    ohm, farad = [0, 1e-30, 1e-6, 1, 1e4, 1e9, 1e300], [0, 1e-30, 1e-12, 1e-9, 1.0, 1e300]
    solved = 0
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for _ in range(200):
            rows, cols = rng.integers(1, 4, 2)
            network = Network(
                rng.choice([0, 1e-300, 1e-9, 1e-3, 1, 1e9, np.inf], (rows, cols)),
                0.5,
                rng.choice(ohm),
                rng.choice([*ohm, np.inf]),
                rng.choice(ohm, cols),
                rng.choice([0, 1e-3, -1e3], cols),
                rng.choice(ohm),
                i_leak_a=rng.choice([0, 1e-9], cols),
                **dict(zip(("c_row_f", "c_column_f", "c_taxel_f"), rng.choice(farad, 3), strict=True)),
            )
            g = network.g_taxel_s[np.newaxis]
            assert not np.isnan(bound_c(network, g, TIMING)).any()
            try:
                found = transients(network, g, TIMING, 1e-28)
            # Refusing is an answer; what is not refused is checked.
            except Unsupported:
                continue
            if found is not None:
                solved += 1
                assert np.isfinite(found.charge_c).all()
    assert solved > 5
