# SPDX-License-Identifier: Apache-2.0
"""Random numbers, and what they do to codes: against their laws, the reference walk and a plain Monte-Carlo run."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import special, stats

from dermis import plan as planning
from dermis import records
from dermis.converter import noise
from dermis.converter.walk import Cells, Noise, count_cells
from dermis.effects import EFFECTS
from dermis.engines import event
from dermis.scene import scene
from tb.reference.converter_walk import Draws, walk_reference

GATE = 510
RANDOM = [effect.name for effect in EFFECTS.values() if effect.random]


def keys(cells: int, seed: int = 1) -> np.ndarray:
    return noise.cell_keys(seed, 0, (1, 1, cells)).ravel()


def path_of(key: np.uint64, clocks: int) -> np.ndarray:
    """The whole Brownian path of a cell, of which the loops draw only parts."""
    out = np.empty(noise.span_of(clocks) + 1)
    noise.walk_grid(key, out.size - 1, 1, out)
    return out[: clocks + 1]


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
    for seed, another in ((8, stream), (7, noise.COIN)):
        other = noise.normals(noise.cell_keys(seed, 0, (40, 20, 25)), another)
        # Five standard deviations.
        assert abs((drawn * other).mean()) < 5 / math.sqrt(n)


def test_walks_are_brownian() -> None:
    at = np.array([1, 3, 32, 100, 255, 256, 257, 400, 510])
    walks = np.array([path_of(key, GATE) for key in keys(8000)])
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


# --- against the reference walk, path by path ---------------------------------------------------------------------


# A charge that leaks away at once is near the level, whatever the current; the noise must not be as large as that.
SMALL = {"leak": 0.01}


def cell(rng: np.random.Generator, kind: str) -> dict[str, float]:
    on = kind == "all"
    window = rng.uniform(0.0005, 0.05) * SMALL.get(kind, 1.0) if kind != "plain" else 0.0
    leak = 10 ** rng.uniform(1, 6) if kind == "leak" else 0.0
    return {
        "x": rng.choice([rng.uniform(0, 0.5), rng.uniform(0, 0.03), rng.uniform(-0.05, 1.2)]),
        "leak": 1e-4 if on else leak,
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
@pytest.mark.parametrize("kind", ["plain", "hysteresis", "leak", "all"])
def test_bits_with_noise_are_those_of_the_walk_that_draws_everything(kind: str) -> None:
    rng = np.random.default_rng(5)
    clocks, cells = 40, [cell(rng, kind) for _ in range(24)]
    size = 10 ** rng.uniform(-4, -1.5, (4, len(cells))) * SMALL.get(kind, 1.0)
    size *= rng.random(size.shape) < 0.7
    own = keys(len(cells))
    made = Cells(**{name: np.array([c[name] for c in cells]) for name in cells[0]})
    counts, end = count_cells(made, clocks, 1.0, Noise(size, own))
    moved = 0
    for i, one in enumerate(cells):
        path = path_of(own[i], clocks)
        sigma, white, slope, aperture = size[:, i]
        sample = [
            white * noise.normal(own[i], noise.LEVEL, n) + slope * noise.normal(own[i], noise.EDGE, n)
            for n in range(1, clocks + 1)
        ]
        coin = [noise.normal(own[i], noise.COIN, n) < 0.0 for n in range(1, clocks + 1)]
        draws = Draws([sigma * w for w in path[1:]], sample, coin, aperture)
        walk = walk_reference(one, clocks, 1.0, 30, draws=draws)
        assert walk.nearest > 1e-13, "take another seed"
        # The accuracy that docs/event.md claims of the charge.
        assert counts[i] == sum(walk.bits), (i, one, size[:, i])
        assert abs(end[i] - float(walk.charge[-1])) < 1e-12 * max(1.0, abs(end[i]))
        moved += walk.bits != walk_reference(one, clocks, 1.0, 30).bits
    assert moved >= 4, "the noise must be large enough to be seen"


# --- what single effects do to codes: a plain Monte-Carlo run beside it ------------------------------------------


def plan_of(effects: dict[str, object], code: float, frames: int, seed: int = 0) -> records.Plan:
    ohm = 250.0 * GATE / code if code else math.inf
    data = {"array": {"rows": 8, "cols": 16}, "stimulus": {"kind": "uniform", "r_ohm": [ohm] * frames}}
    data |= {"effects": effects, "run": {"seed": seed}}
    return planning.make(scene.from_data(data, Path("made.toml")))


def monte_carlo(x: float, jitter: float = 0.0, charge: float = 0.0, level: float = 0.0) -> np.ndarray:
    """Counts of converters walked clock by clock, every clock with numbers of its own, all from first principles.

    `jitter` rms of every clock edge in clocks: a packet runs from edge to edge, samples are taken at edges.
    `charge` rms of the charge of every clock; `level` rms of every decision.
    """
    rng, runs = np.random.default_rng(3), 8000
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


# 2 kT A / (k^2 f) in C^2 a clock, A = 8 rows of x k i0 / V
THERMAL_C2 = 2 * 1.380649e-23 * 300.15 * 3e4 * 8 * (0.2 * 80 * 25e-6 / 0.5) / (80**2 * 5e6)


@pytest.mark.paper
@pytest.mark.parametrize(
    ("effect", "reference"),
    [
        ({"comparator_noise": {"v_v": 0.02}}, {"level": 0.02}),
        ({"clock_jitter": {"t_s": 1e-9}}, {"jitter": 1e-9 * 5e6}),
        ({"shot_noise": {"factor": 400.0}}, {"charge": math.sqrt(2 * 400 * 1.602176634e-19 / 5e-12 * 0.2)}),
        (
            {"thermal_noise": {"temperature_c": 27.0, "factor": 3e4}},
            {"charge": math.sqrt(THERMAL_C2) / 5e-12},
        ),
    ],
)
def test_codes_beside_a_step_scatter_as_in_a_plain_monte_carlo_run(effect: dict, reference: dict) -> None:
    # x = 0.2: the count of the sure converter changes at 510 x = 101.5
    for away in (0.0, 0.05):
        code = 101.5 + away
        found = event.run(plan_of(effect, code, 60)).codes.astype(float).ravel()
        plain = monte_carlo(code / GATE, **reference)
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

    ktc = math.sqrt(1.380649e-23 * 300.15 / 5e-12)  # of a packet of 1 V
    # A slope through four probits of 6400 codes each is known to 2 %; five of that.
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
