# SPDX-License-Identifier: Apache-2.0
"""Random numbers, and what they do to codes: against their laws, the reference walk and a plain Monte-Carlo run."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats

from dermis import bounds, records
from dermis import plan as planning
from dermis.converter import noise, walk, walk_loops
from dermis.converter.walk import Cells, Noise, count_cells
from dermis.effects import EFFECTS
from dermis.engines import event, filter
from dermis.scene import scene
from tb.reference.converter_walk import Draws, walk_reference

GATE = 510
RANDOM = [effect.name for effect in EFFECTS.values() if effect.random]


def keys(cells: int, seed: int = 1) -> np.ndarray:
    return noise.cell_keys(seed, 0, (1, 1, cells)).ravel()


# --- the numbers ---------------------------------------------------------------------------------------------------


def test_normals_are_the_inverse_of_the_distribution_function() -> None:
    p = np.concatenate([np.random.default_rng(0).uniform(size=3000), 10.0 ** -np.arange(1, 17), [0.5, 0.075]])
    got = np.array([noise.inverse_normal(v) for v in p])
    # AS241 claims 1e-16 relative; the logarithm and the polynomial add a dozen roundings. 1e-300 for p = 1/2.
    assert got == pytest.approx(special.ndtri(p), rel=3e-15, abs=1e-300)


@pytest.mark.parametrize("stream", [noise.PRESET, noise.WALK, noise.EDGE])
def test_draws_are_standard_normal_and_independent(stream: int) -> None:
    drawn = noise.normals(noise.cell_keys(7, 0, (40, 20, 25)), stream)
    n = drawn.size
    # Five standard deviations of each statistic: one seed in two million fails.
    assert abs(drawn.mean()) < 5 / math.sqrt(n)
    assert abs(drawn.var() - 1) < 5 * math.sqrt(2 / n)
    assert abs((drawn**4).mean() - 3) < 5 * math.sqrt(96 / n)
    assert stats.kstest(drawn.ravel(), "norm").pvalue > 1e-4
    for axis in range(3):  # frame, row and column all lead to numbers of their own
        a, b = np.delete(drawn, -1, axis).ravel(), np.delete(drawn, 0, axis).ravel()
        # Five standard deviations.
        assert abs((a * b).mean()) < 5 / math.sqrt(a.size)
    other = noise.normals(noise.cell_keys(8, 0, (40, 20, 25)), stream)
    # Five standard deviations.
    assert abs((drawn * other).mean()) < 5 / math.sqrt(n)
    assert abs(
        (drawn * noise.normals(noise.cell_keys(7, 0, (40, 20, 25)), noise.COIN)).mean()
    ) < 5 / math.sqrt(n)


def test_numbers_of_one_cell_are_uniform_over_its_clocks() -> None:
    key = keys(1)[0]
    drawn = np.array([noise.uniform(key, noise.COIN, n) for n in range(40_000)])
    # A fixed seed that a right generator fails once in 10 000; five standard deviations.
    assert stats.kstest(drawn, "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 5 / math.sqrt(drawn.size)


def test_a_key_is_that_of_its_frame_wherever_the_batch_begins() -> None:
    whole = noise.cell_keys(3, 0, (9, 4, 5))
    assert (noise.cell_keys(3, 6, (3, 4, 5)) == whole[6:]).all()
    assert np.unique(whole).size == whole.size
    wider = noise.cell_keys(3, 0, (9, 7, 8))  # the numbers of a taxel do not hang on the size of the array
    assert (wider[:, :4, :5] == whole).all()


def test_walks_are_brownian() -> None:
    at = np.array([1, 3, 32, 100, 255, 256, 257, 400, 510])
    walks = np.array([noise.path(key, GATE) for key in keys(8000)])
    assert (walks[:, 0] == 0).all()
    found = np.cov(walks[:, at].T)
    expected = np.minimum(at[:, None], at)
    spread = np.sqrt((expected**2 + np.outer(at, at)) / walks.shape[0])
    # Five standard deviations of each of 45 covariances.
    assert (np.abs(found - expected) < 5 * spread).all()
    steps = np.diff(walks, axis=1)
    # A fixed seed that a right generator fails once in 10 000; five standard deviations.
    assert stats.kstest(steps.ravel()[::37], "norm").pvalue > 1e-4
    assert abs((steps[:, :-1] * steps[:, 1:]).mean()) < 5 / math.sqrt(steps.size)


@pytest.mark.parametrize("clocks", [1, 2, 3, 7, 300, 509, 510, 511, 512])
@pytest.mark.parametrize("fall", [0.0, 0.02, 0.3])
def test_the_end_of_a_walk_and_what_is_above_it_are_those_of_the_whole_walk(clocks: int, fall: float) -> None:
    n = np.arange(clocks)
    exact = 0
    for key in keys(200):
        whole = 0.01 * noise.path(key, clocks)
        end, above = noise.walk_end(key, clocks, 0.01, fall)
        assert end == whole[-1]
        true = (whole[:-1] - whole[-1] - fall * (clocks - n)).max()
        # A dozen roundings of paths up to 100.
        assert true - 1e-12 <= above <= true + 0.04 * math.sqrt(256)
        exact += (above > 0) == (true > 0)
    assert exact == 200 or fall < 0.1


def test_a_walk_met_in_pieces_is_the_whole_walk() -> None:
    for key in keys(5):
        whole = noise.path(key, GATE)
        for step in (8, 64, 512):
            grid = np.empty(512 // step + 1)
            noise.walk_grid(key, 512, step, grid)
            assert (grid[:-1] == np.append(whole, whole[-1])[: GATE + 1 : step][: grid.size - 1]).all()
            for n in range(1, GATE + 1):
                left, right = n // step, -(-n // step)
                got = noise.walk_between(
                    key, n, left * step, right * step, grid[left], grid[right], 1.0, -1e9, 1e9
                )
                assert got == whole[n]
            # far above a level nothing more is drawn: the mean of the ends
            between = noise.walk_between(key, 3, 0, step, grid[0], grid[1], 1e-9, -1.0, -0.5)
            # One product and a division: a few roundings of 1.1e-16.
            assert between == pytest.approx(grid[1] * 3 / step, rel=1e-12)


# --- against the reference walk, path by path ---------------------------------------------------------------------


def cell(rng: np.random.Generator, kind: str) -> dict[str, float]:
    on = kind == "all"
    window = rng.uniform(0.0005, 0.05) if on or kind == "hysteresis" else 0.0
    return {
        "x": rng.choice([rng.uniform(0, 0.5), rng.uniform(0, 0.03), rng.uniform(-0.05, 1.2)]),
        "leak": 1e-4 if on else 0.0,
        "w0": -0.5,
        "packet": rng.uniform(0.95, 1.05),
        "rise": window / 2,
        "fall": -window / 2,
        "low": -1.2 if on else -np.inf,
        "high": 0.9 if on else np.inf,
        "delay": 0.03 if on else 0.0,
        "lag": 0.016 if on else 0.0,
        "across": 1e-2 if on else 0.0,
    }


@pytest.mark.long
@pytest.mark.parametrize("kind", ["plain", "hysteresis", "all"])
def test_bits_with_noise_are_those_of_the_walk_that_draws_everything(kind: str) -> None:
    rng = np.random.default_rng(5)
    clocks, cells = 40, [cell(rng, kind) for _ in range(24)]
    size = 10 ** rng.uniform(-4, -1.5, (4, len(cells)))
    size *= rng.random(size.shape) < 0.7
    own = keys(len(cells))
    made = Cells(**{name: np.array([c[name] for c in cells]) for name in cells[0]})
    counts, end = count_cells(made, clocks, 1.0, Noise(size, own))
    moved = 0
    for i, one in enumerate(cells):
        path = noise.path(own[i], clocks)
        sigma, white, slope, aperture = size[:, i]
        sample = [
            white * noise.normal(own[i], noise.LEVEL, n) + slope * noise.normal(own[i], noise.EDGE, n)
            for n in range(1, clocks + 1)
        ]
        coin = [noise.uniform(own[i], noise.COIN, n) < 0.5 for n in range(1, clocks + 1)]
        draws = Draws([sigma * w for w in path[1:]], sample, coin, aperture)
        walk = walk_reference(one, clocks, 1.0, 30, draws=draws)
        assert walk.nearest > 1e-13, "take another seed"
        # The accuracy that docs/event.md claims of the charge.
        assert counts[i] == sum(walk.bits), (i, one, size[:, i])
        assert abs(end[i] - float(walk.charge[-1])) < 1e-12 * max(1.0, abs(end[i]))
        moved += walk.bits != walk_reference(one, clocks, 1.0, 30).bits
    assert moved >= 4, "the noise must be large enough to be seen"


@pytest.mark.parametrize("step", [8, 64])
@pytest.mark.parametrize("lag", [0.0, 0.016])
def test_noise_of_a_charge_that_stands_at_its_limit_is_all_there(
    monkeypatch: pytest.MonkeyPatch, step: int, lag: float
) -> None:
    """A current of ten packets a clock would be far above every level, were it not for the limit."""
    monkeypatch.setattr(walk_loops, "grid_step", lambda *_: step)
    clocks, own = 64, keys(12)
    one = {"x": 10.0, "leak": 1e-4, "w0": -0.5, "packet": 1.0, "rise": 0.01, "fall": -0.01, "low": -1.2, "high": 0.9,
           "delay": 0.03, "lag": lag, "across": 1e-2}  # fmt: skip
    made = Cells(**{name: np.full(12, value) for name, value in one.items()})
    # Paths of some packets, or samples of packets of their own.
    sizes = np.repeat([[2.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1e-3, 1e-3]], 6, axis=1)
    counts, _ = count_cells(made, clocks, 1.0, Noise(sizes, own))
    for i, (sigma, white, _, aperture) in enumerate(sizes.T):
        sample = [white * noise.normal(own[i], noise.LEVEL, n) for n in range(1, clocks + 1)]
        coin = [noise.uniform(own[i], noise.COIN, n) < 0.5 for n in range(1, clocks + 1)]
        draws = Draws([sigma * w for w in noise.path(own[i], clocks)[1:]], sample, coin, aperture)
        walk = walk_reference(one, clocks, 1.0, 30, draws=draws)
        assert walk.nearest > 1e-13, "take another seed"
        assert counts[i] == sum(walk.bits), (i, sigma, white)
    assert min(len(set(counts[:6])), len(set(counts[6:]))) > 1, "the noise must be large enough to be seen"


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(step=st.sampled_from([8, 16, 32, 128, 512]), first=st.integers(0, 150))
def test_codes_do_not_hang_on_the_grid_or_on_neighbours(step: int, first: int) -> None:
    rng = np.random.default_rng(2)
    cells = [cell(rng, "all") | {"x": v} for v in rng.uniform(0, 0.5, 300)]
    made = Cells(**{name: np.array([c[name] for c in cells]) for name in cells[0]})
    size, own = np.full((4, 300), 1e-3), keys(300)
    expected = count_cells(made, GATE, 1.0, Noise(size, own))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walk_loops, "grid_step", lambda *_: step)
        part = Cells(**{name: np.array([c[name] for c in cells[first:]]) for name in cells[0]})
        got = count_cells(part, GATE, 1.0, Noise(size[:, first:], own[first:]))
    assert (got[0] == expected[0][first:]).all()
    assert (got[1] == expected[1][first:]).all()


# --- what single effects do to codes: a plain Monte-Carlo run beside it ------------------------------------------


def plan_of(effects: dict[str, object], code: float, frames: int, seed: int = 0) -> records.Plan:
    ohm = 250.0 * GATE / code if code else math.inf
    data = {
        "array": {"rows": 8, "cols": 16},
        "stimulus": {"kind": "uniform", "r_ohm": [ohm] * frames},
        "effects": effects,
        "run": {"seed": seed},
    }
    return planning.make(scene.from_data(data, Path("made.toml")))


def monte_carlo(
    x: float,
    runs: int,
    rng: np.random.Generator,
    *,
    jitter: float = 0.0,
    charge: float = 0.0,
    level: float = 0.0,
) -> np.ndarray:
    """Counts of converters walked clock by clock, every clock with numbers of its own, all from first principles.

    `jitter` rms of every clock edge in clocks: a packet runs from edge to edge, samples are taken at edges.
    `charge` rms of the charge of every clock; `level` rms of every decision.
    """
    w, last, before = np.full(runs, -0.5), np.zeros(runs), np.zeros(runs)
    count = np.zeros(runs)
    late_edge = jitter * rng.standard_normal(runs)
    for _ in range(GATE):
        edge = jitter * rng.standard_normal(runs)
        # The charge at the nominal edge; a packet that began at the edge before and ends at this one is as wide as they
        # stand apart. The input flows all the time, so a sample that is late sees more of it.
        w += x + charge * rng.standard_normal(runs) - before * (1.0 + edge - late_edge)
        sample = w + x * edge + level * rng.standard_normal(runs)
        before, last = last, ((sample >= 0) & (last == 0)).astype(float)
        count += last
        late_edge = edge
    return count


@pytest.mark.paper
@pytest.mark.parametrize(
    ("effect", "reference"),
    [
        ({"comparator_noise": {"v_v": 0.02}}, {"level": 0.02}),
        ({"clock_jitter": {"t_s": 1e-9}}, {"jitter": 1e-9 * 5e6}),
        ({"shot_noise": {"factor": 400.0}}, {"charge": math.sqrt(2 * 400 * 1.602176634e-19 / 5e-12 * 0.2)}),
        (
            {"thermal_noise": {"temperature_c": 27.0, "factor": 3e4}},
            # 2 kT A / (k^2 f) in C^2 a clock, A = 8 rows of x k i0 / V
            {
                "charge": math.sqrt(
                    2 * 1.380649e-23 * 300.15 * 3e4 * 8 * (0.2 * 80 * 25e-6 / 0.5) / (80**2 * 5e6)
                )
                / 5e-12
            },
        ),
    ],
)
def test_codes_beside_a_step_scatter_as_in_a_plain_monte_carlo_run(effect: dict, reference: dict) -> None:
    # x = 0.2: the count of the sure converter changes at 510 x = 101.5
    for away in (0.0, 0.05):
        code = 101.5 + away
        found = event.run(plan_of(effect, code, 60)).codes.astype(float).ravel()
        plain = monte_carlo(code / GATE, 8000, np.random.default_rng(3), **reference)
        spread = math.sqrt(max(plain.var(), 0.02) * (1 / found.size + 1 / plain.size))
        # Five standard deviations of the means; the variance of 0.25 is known to 0.006 from so many codes,
        # six of that.
        assert abs(found.mean() - plain.mean()) < 5 * spread
        assert abs(found.var() - plain.var()) < 0.04
        assert away or found.var() > 0.1, "noise must be seen"


@pytest.mark.paper
def test_noise_of_a_count_is_as_large_as_first_principles_say() -> None:
    # Standard deviation in counts, from how the mean code passes over a step: a probit of it is straight.
    def sigma(effects: dict[str, object], code: float, guess: float) -> float:
        points = []
        for away in (-1.0, -0.5, 0.5, 1.0):
            mean = event.run(plan_of(effects, code + 0.5 + away * guess, 25)).codes.mean() - code
            points.append((away * guess, special.ndtri(min(max(mean, 1e-3), 1 - 1e-3))))
        at, probit = np.array(points).T
        return 1.0 / np.polyfit(at, probit, 1)[0]

    packets, shot = 250.0, 1.602176634e-19 / 5e-12
    jitter = 1e-9 * 5e6
    # width of every packet and the last sample
    expected = math.sqrt(2 * jitter**2 * packets + (jitter * 0.5) ** 2)
    # A slope through four probits of 6400 codes each is known to 2 %; five of that.
    assert sigma({"clock_jitter": {"t_s": 1e-9}}, 250, 0.11) == pytest.approx(expected, rel=0.1)
    # As above.
    assert sigma({"shot_noise": True}, 250, 0.004) == pytest.approx(math.sqrt(2 * shot * packets), rel=0.1)
    # 1 ns of jitter is 0.11 count: two digits.
    assert expected == pytest.approx(0.11, rel=0.02)
    ktc = math.sqrt(1.380649e-23 * 300.15 / 5e-12)  # of a packet of 1 V
    # As above.
    assert sigma({"ktc_noise": True}, 250, ktc) == pytest.approx(ktc, rel=0.1)
    # One digit is known.
    assert ktc == pytest.approx(3e-5, rel=0.05)
    # As above.
    assert sigma({"flicker_noise": {"relative": 1e-4}}, 250, 0.025) == pytest.approx(250 * 1e-4, rel=0.1)


@pytest.mark.paper
def test_a_coin_decides_inside_the_aperture_and_costs_at_most_one_clock() -> None:
    # One clock away from the threshold at every second clock: x = 1/2 exactly meets it again and again.
    aperture = 1.9e-7
    ideal = event.run(plan_of({}, 100, 10)).codes
    found = event.run(plan_of({"metastability": {"t_aperture_s": aperture}}, 100, 10)).codes.astype(int)
    # The claim itself: one clock later is one count less at most.
    assert (np.abs(found - ideal) <= 1).all()
    none = event.run(plan_of({"metastability": {"t_aperture_s": 0.0}}, 100, 10)).codes
    assert (none == ideal).all()


def test_numbers_hang_on_the_seed_alone() -> None:
    on = dict.fromkeys(RANDOM, True) | {"clock_jitter": {"t_s": 1e-9}}
    plan = plan_of(on, 101.5, 6, seed=4)
    whole = event.run(plan).codes
    assert (whole == event.run(plan).codes).all()
    assert (whole[2:5] == event.run(plan.part(2, 5)).codes).all()
    assert (whole != event.run(plan_of(on, 101.5, 6, seed=5)).codes).any()


def test_no_number_is_drawn_where_nothing_is_random(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[tuple] = []
    walk = walk_loops.walk
    monkeypatch.setattr(walk_loops, "walk", lambda *a: (taken.append(a), walk(*a)))
    for name in ("cell_keys", "normals", "normal", "uniform", "walk_grid"):
        monkeypatch.setattr(noise, name, lambda *_: pytest.fail("a number was drawn"))
    effects = {"integrator_gain": True, "comparator_hysteresis": True, "supply_ripple": True}
    event.run(plan_of(effects, 101.5, 2))
    assert taken
    # noise rows, keys, step; None has no hash to read, whatever the loop would do with it
    assert all(a[12] is None and a[13] is None and a[14] is None for a in taken)


def test_the_compiled_loop_of_a_sure_converter_holds_no_random_number() -> None:
    # Compiled here, since numba shows no code that comes from its cache.
    ideal = {"leak": 1e-3, "packet": 1.0, "low": -np.inf, "high": np.inf}
    leaky = Cells(**{f.name: np.full(1, ideal.get(f.name, 0.0)) for f in dataclasses.fields(Cells)})
    fresh = numba.njit(error_model="numpy")(walk_loops.walk.py_func)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walk_loops, "walk", fresh)
        count_cells(leaky, 10, 1.0)
        count_cells(leaky, 10, 1.0, Noise(np.full((4, 1), 1e-3), keys(1)))
    sure, noisy = (fresh.inspect_llvm(kind) for kind in fresh.signatures)
    assert "converter5noise" not in sure
    assert "converter5noise" in noisy


def test_thermal_noise_passes_the_mirror_as_the_current_does(tmp_path: Path) -> None:
    variances = []
    for ratio_error in (0.0, 1.0):
        effects = {"thermal_noise": True, "mirror_ratio": {"ratio_error": ratio_error, "spread": 0.0}}
        data = {"stimulus": {"kind": "uniform", "code": 50}, "effects": effects}
        plan = planning.whole(scene.from_data(data, tmp_path / "made.toml"), "event")
        variances.append(walk._noise_variance(plan, plan.conductance_s()))
        # The bound is as many standard deviations of the path at the end of the gate.
        most = bounds.SIGMAS * np.sqrt(plan.timing.gate_clocks * variances[-1].max())
        # The same product in two orders.
        assert filter.largest(plan)["thermal_noise"] == pytest.approx(most, rel=1e-12)
    # As above.
    assert variances[1] == pytest.approx(4.0 * variances[0], rel=1e-12)
