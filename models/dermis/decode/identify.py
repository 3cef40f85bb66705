# SPDX-License-Identifier: Apache-2.0
"""Identify chip, network, sheet and memory from measurements, each with its uncertainty."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr
from scipy.stats import f as f_distribution
from scipy.stats import theilslopes

from dermis.array.array import Network
from dermis.decode import crosstalk, law
from dermis.decode.calibration import COVERAGE_SIGMA, UNKNOWN_PART, UNSEEN_DECADES, Calibration, Mode
from dermis.decode.memory import MemoryLaw, SheetMemory
from dermis.ndarrays import Bools, Floats

NETWORK_START = {
    "r_row_driven_ohm": 1.0, "r_column_ohm": 0.5, "g_lateral_row_s": 1e-4, "r_trace_row_ohm": 0.05,
    "r_trace_column_ohm": 0.05,
}  # fmt: skip
"""Parameters of the network that loads can identify, and the start of the search."""
Taxels = Iterable[tuple[int, int]]
PLATES = "is less certain than that: most loads press all taxels alike; add loads on parts of the sheet"
"""Remark on the network, which was up to 40 of its standard uncertainties off with plates alone."""
NETWORK_PRIOR = 100.0
"""Standard deviation of these parameters before loads are read, in units of that start: what loads do not show has no
value beyond any sheet."""
OFFSET_PRIOR_V = 5e-4
"""Standard deviation of the offset voltage of a column before loads are read; the design allows 0.2 mV."""
RESISTOR_PRIOR = 0.01
"""The same of the logarithm of a divider's resistor. Loads whose readings show more tell it all the same."""
TRACES = ("r_trace_row_ohm", "r_trace_column_ohm")
"""Parameters that stay at their known value unless the loads show them: decoding with traces is slower."""
SHOWN = 3.0
"""A trace resistance is shown if it is this many standard uncertainties above 0."""
INFLATED = 3.0
"""Two parameters are confused if the one that is held fixed makes the other this many times more certain."""
RIDGE = 1e-9
"""Of the scaled normal equations: no parameter counts as more than 3e4 times less certain than it is alone."""
OWN_SHARE = 1e-3
"""Chance that a taxel with the shared law is given its own: the level of the F test."""
TAXELS = 16
"""The most loaded ones tell hysteresis and creep."""
LEAST_CODE = 10
"""Readings below are not used for a fit: half a code is more than 5 % of them."""
STUCK = 0.8
"""Share of the largest reading that no crosstalk makes of an unpressed taxel in every load."""
FORCES = 64
"""Up to this number of different forces each has its own effect while wrong loads are looked for."""
LEVELS = 12
"""More forces are compared at this many levels, with straight lines of logarithms between them."""
BAD_LOAD = 5.0
"""A load is bad if its rms residual is this many times the median of all loads."""
RESIDUAL_MIN = 1 / np.sqrt(12) / 50
"""Relative rms residual that every load may have: rounding of a reading of 50 codes."""
CONDUCTANCES_S = 1e-9, crosstalk.SHORT_S
"""Conductances that a taxel may have."""
PAIRS = 4
"""Pairs of opposite random errors by which the pull of rounding and noise on the network is found."""
PULLED = 2.0
"""Standard uncertainties up to which the pull is proportional to the error, and is taken out."""
HALVINGS = 60
"""From a network in which the readings are impossible back to the fit."""
CURRENTS_OFF = 0.03
"""Share of the full scale by which readings of test currents may differ from a straight line: any mismatch is less."""
CYCLE_OFF = 5.0
"""Roundings and noises that the readings of a cycle may be off, rms: 1.3 where forces and codes belong together."""
DRIFT_SURE = 0.999
"""Confidence in the sign of a drift from load to load."""
FEW_LOADS = 8
"""Loads below which a large residual may be that of a fit that does not find the network."""
SHARE_BAD = 0.34
"""Share of bad loads from which on no fit can tell the good from the bad."""


class ContradictionError(ValueError):
    """Measurements that contradict each other, or that leave a parameter open."""


@dataclass(frozen=True)
class Load:
    """Codes of one load [frames, rows, cols] and the force in newtons on every taxel, [rows, cols]; NaN: unknown."""

    name: str
    codes: NDArray[np.integer]
    force_n: Floats


def fit_chip(calibration: Calibration, codes: ArrayLike, current_a: ArrayLike) -> Calibration:
    """Fit the step and the start of every column to test currents.

    `codes` are [currents, readings, cols]; `current_a` [currents] in ampere flow into every column, and 0 is a dark
    frame. Each column needs two different currents that read between 0 and full scale; else, or if its codes fall with
    current, ContradictionError. The other fields of the calibration are kept.
    """
    codes, current = np.asarray(codes, dtype=float), np.asarray(current_a, dtype=float)
    step, start, step_part, start_sigma = np.empty((4, calibration.cols))
    for c in range(calibration.cols):
        mean = codes[:, :, c].mean(axis=1)
        # A mean near an end may hide what the counter cuts off.
        used = (mean >= 1) & (mean <= calibration.code_max - 1)
        if np.unique(current[used]).size < 2:
            raise ContradictionError(f"column {c} has fewer than 2 test currents between 0 and full scale")
        matrix = np.stack([np.ones(used.sum()), current[used]], axis=1)
        (start[c], slope), *_ = np.linalg.lstsq(matrix, mean[used], rcond=None)
        if slope <= 0:
            raise ContradictionError(f"codes of column {c} fall with the test current")
        # Rounding of a steady current does not average out: 1/sqrt(12) of a code for each.
        off = float(np.std(mean[used] - matrix @ [start[c], slope]))
        if off > CURRENTS_OFF * calibration.code_max:
            raise ContradictionError(f"test currents of column {c} are {off:.3g} codes off a straight line")
        sigma = max(1 / np.sqrt(12), off)
        covariance = sigma**2 * np.linalg.inv(matrix.T @ matrix)
        step[c], step_part[c] = 1 / slope, np.sqrt(covariance[1, 1]) / slope
        start_sigma[c] = np.sqrt(covariance[0, 0])
    errors = {"step_part": step_part, "start_sigma_code": start_sigma}
    return dataclasses.replace(calibration, step_a=step, start_code=start, **errors)


def fit_noise(codes: ArrayLike) -> float:
    """Return the standard deviation of noise in codes from readings [readings, ...] that should be equal.

    The variance of rounded readings, averaged over where they lie between two codes, is inverted: it is
    sigma / sqrt(pi) for little noise and sigma^2 + 1/12 for much.
    """
    measured = float(np.mean(np.var(np.asarray(codes, dtype=float), axis=0, ddof=1)))
    sigma = np.geomspace(1e-3, 30, 200)
    edges = np.arange(-150, 151)[:, None, None] - 0.5
    phase = (np.arange(20) + 0.5)[:, None] / 20 - 0.5
    share = np.diff(ndtr((edges - phase) / sigma), axis=0)
    number = np.arange(-150, 150)[:, None, None]
    mean = (share * number).sum(axis=0)
    variance = ((share * number**2).sum(axis=0) - mean**2).mean(axis=0)
    return 0.0 if measured < variance[0] else float(np.interp(measured, variance, sigma))


@dataclass(frozen=True)
class SheetFit:
    """A calibration with its values and standard uncertainties by name, and remarks on them.

    `bad` names loads that were left out, `bad_taxels` taxels that do not read a force, with the reason; `elsewhere`
    says where a taxel is pressed without a force, or the reverse. `drift` is by how much forces of the last load read
    more than those of the first, relative; 0 where it may be chance.
    """

    calibration: Calibration
    values: dict[str, tuple[float, float]]
    remarks: dict[str, str]
    bad: tuple[str, ...]
    bad_taxels: dict[tuple[int, int], str] = dataclasses.field(default_factory=dict)
    elsewhere: tuple[str, ...] = ()
    drift: float = 0.0


def fit_sheet(calibration: Calibration, loads: list[Load], kind: str) -> SheetFit:
    """Fit network, taxels and law to known loads.

    For given resistances every load is solved backwards. The logarithm of a conductance is then an effect of the
    force, the same for all taxels, plus an effect of the taxel; the fit minimizes the residual over the resistances.
    It needs no law, and overlapping loads are enough: the same force on the same taxel must read the same whatever
    else is pressed. A load whose residual is far above the others is left out and named, and so is a taxel that reads
    no force. A taxel with enough loads gets its own law if that fits better (`_own_laws`). ContradictionError if loads
    are too few, or contradict each other so much that no load can be blamed.
    """
    if len(loads) < 3:
        raise ContradictionError(f"{len(loads)} loads; at least 3 are needed")
    bad_taxels = _bad_taxels(calibration, loads)
    unread = np.zeros(calibration.factor.shape, dtype=bool)
    for place in bad_taxels:
        unread[place] = True
    # What they read blames no load.
    loads = [dataclasses.replace(one, force_n=np.where(unread, np.nan, one.force_n)) for one in loads]
    fit, by_load = _fit_loads(calibration, loads, kind)
    drift = fit.drift  # of all loads
    middle = np.median(list(by_load.values()))
    bad = [name for name, rms in by_load.items() if rms > BAD_LOAD * max(middle, RESIDUAL_MIN)]
    if len(bad) > SHARE_BAD * len(loads) or middle > 0.2:
        worst = ", ".join(sorted(by_load, key=lambda n: -by_load[n])[:4])
        said = f"loads contradict each other by {middle:.0%} of a reading"
        said += (
            f", or {len(loads)} are too few to tell the network from them" if len(loads) < FEW_LOADS else ""
        )
        said += ", or the sheet is not linear (law in [start])" if kind == "linear" else ""
        odd = "".join(f"; taxel {r} {c} {reason}" for (r, c), reason in [*bad_taxels.items()][:4])
        raise ContradictionError(f"{said}; largest: {worst}{odd}")
    good = [load for load in loads if load.name not in bad]
    own = fit.calibration.own if len(fit.calibration.own) < fit.calibration.factor.size / 2 else ()
    forces = np.unique([load.force_n for load in good])
    if bad or fit.calibration.own or forces.size > LEVELS:  # else it is this fit once more
        # Now that the wrong loads are out, neighbouring forces tell the droop of a load from its force.
        fit, _ = _fit_loads(calibration, good, kind, own, LEVELS)
    # Under a plate neighbouring taxels read nearly the same, and so do their roundings, which the uncertainties take
    # for independent of each other.
    plates = sum(np.nanmin(load.force_n) == np.nanmax(load.force_n) for load in good)
    remarks = {n: PLATES for n in NETWORK_START if n in fit.values and plates > len(good) / 2} | fit.remarks
    dark = [f"row {r}" for r in np.flatnonzero(unread.all(axis=1))]
    if dark := ", ".join([*dark, *(f"column {c}" for c in np.flatnonzero(unread.all(axis=0)))]):
        remarks |= dict.fromkeys(
            fit.values, f"is less certain than that: {dark} may carry what nothing reads"
        )
    notes = [f"load {name} was left out: it contradicts the others" for name in bad]
    notes += [f"{name}: {remark}" for name, remark in remarks.items()]
    notes += [f"taxel {r} {c} {reason}" for (r, c), reason in bad_taxels.items()]
    part = np.where(unread, UNKNOWN_PART, fit.calibration.factor_part)
    made = dataclasses.replace(fit.calibration, factor_part=part, notes=(*calibration.notes, *notes))
    currents = made.step_a * (np.array([np.median(load.codes, axis=0) for load in good]) - made.start_code)
    g = _conductances(made, made.array(), currents)
    made = _turn_on(made, g / made.factor, np.nan_to_num([load.force_n for load in good]))
    odd = list(_elsewhere(made, good, g, bad_taxels))
    bad += [f"{name} (forces at other places)" for name, _, most in odd if most]
    places = tuple(f"{name}: {place}" for name, place, _ in odd)
    return SheetFit(made, fit.values, remarks, tuple(bad), bad_taxels, places, drift)


def _elsewhere(
    made: Calibration, loads: list[Load], conductances: Floats, bad_taxels: Taxels
) -> Iterator[tuple[str, str, bool]]:
    """Yield where a taxel that is good conducts as if pressed without a force, or a tenth of that with one.

    Load, place, and once a load if most of its strong forces are such places.
    """
    for load, solved in zip(loads, conductances, strict=True):
        g, force = solved.copy(), load.force_n
        for place in bad_taxels:
            g[place] = np.nan
        pressed, known = force > 0, np.isfinite(g) & np.isfinite(force)
        if not (pressed & known).any() or made.v_bias_v * np.nanmax(g) < 2 * LEAST_CODE * made.step_a.max():
            continue
        # Where all forces are at wrong places their taxels read nothing.
        typical = max(np.median(g[pressed & known]), 0.25 * g[known].max())
        strong = pressed & (force >= np.median(force[pressed]))
        lost = known & strong & (g < 0.1 * typical)
        most = 2 * lost.sum() > (known & strong).sum()
        for n, (r, c) in enumerate(np.argwhere(lost | (known & ~pressed & (g > 0.5 * typical)))):
            said = f"row {r}, column {c} reads {'no ' if pressed[r, c] else 'a '}force"
            yield load.name, said, most and n == 0


def _bad_taxels(calibration: Calibration, loads: list[Load]) -> dict[tuple[int, int], str]:
    """Return taxels that do not read a force, with the reason.

    One is dead if it reads below `LEAST_CODE` above its start, or a fifth of what others read, in every load that
    presses it as hard as most and under which most of the hard pressed taxels read twice that code. One is stuck if it
    reads full scale in every load, and in one at least where most taxels of that force do not; or `STUCK` of the
    largest reading, and in two at least without a force: a short behind a multiplexer reads no full scale.
    """
    codes = np.array([np.median(load.codes, axis=0) for load in loads])
    force = np.array([load.force_n for load in loads])
    pressed = force > 0
    hard = [p & (f >= np.median(f[p])) if p.any() else p for f, p in zip(force, pressed, strict=True)]
    above = codes - calibration.start_code
    typical = [np.median(c[h]) if h.any() else 0.0 for c, h in zip(above, hard, strict=True)]
    typical = np.array(typical)[:, None, None]
    telling = hard & (typical >= 2 * LEAST_CODE)
    dead = telling.any(axis=0) & ~(telling & (above >= np.maximum(LEAST_CODE, 0.2 * typical))).any(axis=0)
    full = calibration.full_code
    stuck = (codes >= full).all(axis=0) & (~pressed | (typical < full.min())).any(axis=0)
    # One load without a force may have a wrong map.
    short = (codes >= max(STUCK * codes.max(), LEAST_CODE)).all(axis=0) & ((force == 0).sum(axis=0) > 1)
    reasons = {"does not respond to loads": dead, "reads as a short without a load": short}
    reasons["reads full scale without a load"] = stuck
    return {(int(r), int(c)): said for said, taxels in reasons.items() for r, c in np.argwhere(taxels)}


def _conductances(calibration: Calibration, network: Network, currents: Floats) -> Floats:
    """Return the conductances [frames, rows, cols] of currents in a network; dividers may need the slow solve."""
    part = calibration.current_part(network)
    return crosstalk.solve(network, currents * part, None, calibration.divider).conductance_s


def _fit_network(
    calibration: Calibration,
    currents: Floats,
    error_code2: Floats,
    residual_of: Callable[[Floats], Floats],
    freedom: int,
) -> tuple[Network, dict[str, tuple[float, float]], dict[str, str], list[dict[str, Any]], Floats]:
    """Fit the network to currents [loads, rows, cols]; `residual_of` rates conductances, in codes.

    `error_code2` is the variance of a reading in codes, as `currents`, 0 where nothing is read.
    Returns the network, values with standard uncertainties, remarks on values that the loads do not tell, independent
    errors of one standard uncertainty, and `Calibration.offset_v2`.
    """
    known = calibration.array()
    cols = calibration.cols

    def fields(names: list[str], x: Floats) -> dict[str, Any]:
        values = {n: (v - 1) * NETWORK_START[n] for n, v in zip(names, x, strict=False)}
        if "r_row_driven_ohm" in values and np.isfinite(known.r_row_grounded_ohm):
            values["r_row_grounded_ohm"] = values["r_row_driven_ohm"]
        if x.size > len(names):
            own = x[len(names) :] - 1
            if calibration.divider:
                # Voltages do not tell ohms: with all resistances twice as large they are the same.
                values["r_column_ohm"] = known.r_column_ohm * np.exp(RESISTOR_PRIOR * (own - own.mean()))
            else:
                values["v_column_offset_v"] = known.v_column_offset_v + OFFSET_PRIOR_V * own
        return values

    def residual_at(names: list[str], x: Floats, moved_a: Floats | float = 0.0) -> Floats:
        network = dataclasses.replace(known, **fields(names, x))
        return residual_of(_conductances(calibration, network, currents + moved_a))

    def search(names: list[str], first: Floats) -> tuple[Floats, Floats, float]:
        """Return parameters, their Jacobian and the variance of a residual; those after `names` are the columns' own.

        The last rows of the Jacobian are those of what is known before, one a parameter.
        """
        prior = np.where(np.arange(first.size) < len(names), NETWORK_PRIOR, 1.0)

        def residual(x: Floats) -> Floats:
            return np.r_[residual_at(names, x), (x - 1) / prior]

        # x - 1 is relative to the start value, so that a step of differences is never 0.
        low = np.where(np.arange(first.size) < len(names), 1.0, -199.0)
        found = least_squares(residual, first, bounds=(low, 201), diff_step=1e-4)
        spread = max(float(found.fun @ found.fun) / max(freedom - len(names), 1), 1e-12)
        return found.x, found.jac, spread

    # What is a column's own is its offset, or a divider's resistor, whose tolerance would pass for a trace. It and the
    # resistances come first: traces, which are slow, are looked for with it held.
    held_by_board = ("r_column_ohm", *TRACES) if calibration.divider else ()
    every = [n for n in NETWORK_START if n not in held_by_board]
    plain = [n for n in every if n not in TRACES]
    # Without them at first: a search for all at once may end beside the least residual.
    x, _, _ = search(plain, np.full(len(plain), 2.0))
    x, _, _ = search(plain, np.r_[x, np.ones(cols)])
    own = x[len(plain) :]
    known_before = known
    known = dataclasses.replace(known, **fields([], own))
    names, remarks, values = list(every), {}, {}
    first = dict(zip(plain, x, strict=False)) | dict.fromkeys(TRACES, 1.1)
    while True:
        x, jac, spread = search(names, np.array([first[n] for n in names]))
        jac = jac[: -x.size]  # what the loads alone tell
        first = dict(zip(names, x, strict=True))
        length = np.maximum(np.linalg.norm(jac, axis=0), 1e-30)
        # Two parameters with one effect make a singular matrix, up to rounding: the ridge gives them a large sigma.
        inverse = np.linalg.inv((jac / length).T @ (jac / length) + RIDGE * np.eye(length.size))
        covariance = inverse / np.outer(length, length) * spread
        sigma = np.sqrt(np.diag(covariance))
        alone = np.sqrt(spread) / length
        # Residuals are in codes: a parameter that moves no reading by 1/1000 code at its start value is not seen.
        blind = np.linalg.norm(jac, axis=0) < 1e-3
        for k, name in enumerate(names):
            start = NETWORK_START[name]
            values[name] = ((x[k] - 1) * start, np.inf if blind[k] else sigma[k] * start)
            remarks.pop(name, None)
            if blind[k]:
                remarks[name] = "no load shows it"
            elif sigma[k] > INFLATED * alone[k] and abs(x[k] - 1) < SHOWN * sigma[k]:
                shared = np.abs(covariance[k]) / np.maximum(sigma * sigma[k], 1e-300)
                shared[k] = 0.0
                remarks[name] = f"the loads cannot tell it from {names[int(shared.argmax())]}"
        excess = {n: values[n][0] / max(values[n][1], 1e-300) for n in names if n in TRACES}
        weakest = min(excess, key=excess.__getitem__, default="")
        if not weakest or excess[weakest] >= SHOWN:
            break
        names.remove(weakest)
        held = float(getattr(known, weakest))
        remarks[weakest] = f"held at {held:g}: " + remarks.get(weakest, "the loads do not show it")
        values[weakest] = (held, values[weakest][1])
    known = known_before
    x, jac, spread = search(names, np.r_[[first[n] for n in names], own])
    size = len(names)
    # Blind parameters, as above, have no mode.
    blind = np.linalg.norm(jac[: -x.size, :size], axis=0) < 1e-3
    jac[:, :size][:, blind] = 0.0
    inverse = np.linalg.pinv(jac.T @ jac)
    covariance = inverse * max(spread, 1.0)

    def score(moved_a: Floats) -> Floats:
        """Return the derivatives of half the sum of squares by the shared parameters, with currents moved."""
        off, step = residual_at(names, x, moved_a), 1e-4 * x[:size]
        moved = x + np.eye(size, x.size) * step[:, np.newaxis]
        return np.array([(residual_at(names, one, moved_a) - off) @ off for one in moved]) / step

    error_a = calibration.step_a * np.sqrt(np.minimum(spread / 12.0, error_code2))
    pulled, variance = inverse[:, :size] @ _pull(score, error_a), np.diag(covariance)
    if far := [n for n, d, v in zip(names, pulled, variance, strict=False) if d**2 > PULLED**2 * v]:
        remarks |= dict.fromkeys(far, "is less certain than that: rounding and noise of these loads hide it")
    else:
        x = x + pulled
        x[:size] = np.maximum(x[:size], 1.0)
    # The mean of a divider's resistors is not known, only how they differ.
    scale = calibration.divider * RESISTOR_PRIOR * max(1.0, float(np.std(x[size:]))) / np.sqrt(cols)
    for k, name in enumerate(names):
        start = NETWORK_START[name]
        value, sigma_x = (x[k] - 1) * start, np.inf if blind[k] else float(np.sqrt(covariance[k, k]))
        values[name] = value, float(np.hypot(sigma_x * start, scale * value))
    shared, mixed = covariance[:size, :size], covariance[size:, :size]
    variance, direction = np.linalg.eigh(shared)
    given = mixed @ np.linalg.pinv(shared)
    modes = []
    for v, d in zip(variance, direction.T, strict=True):
        if v > 1e-12 * max(variance.max(), 1e-300):
            # The sign that moves the largest part upwards: resistances are not negative.
            d = d * np.sign(d[np.abs(d).argmax()]) * np.sqrt(v)
            modes.append(fields(names, np.r_[np.maximum(x[:size] + d, 1.0), x[size:] + given @ d]))
    left, band = covariance[size:, size:] - given @ mixed.T, np.zeros((3, cols))
    if calibration.divider:
        # A resistor moves the taxels of its own column alone: one mode has the independent errors of all, but for what
        # they have in common. It has two signs, as `fields` takes out their mean.
        alike = left.mean(axis=0)
        error2 = np.maximum(np.diag(left) - 2 * alike + alike.mean(), 0.0)
        modes.append(fields(names, np.r_[x[:size], x[size:] + np.sqrt(error2) * (-1.0) ** np.arange(cols)]))
    else:
        for k in range(min(3, cols)):
            band[k, : cols - k] = np.diag(left, k) * OFFSET_PRIOR_V**2
    return dataclasses.replace(known, **fields(names, x)), values, remarks, modes, band


def _pull(score: Callable[[Floats], Floats], error_a: Floats) -> Floats:
    """Return by how much errors of currents move the mean of a score, which is 0 at the least sum of squares.

    A reading's own error is in the current that droops its row, too: least squares pull the resistances down. Errors of
    standard deviations `error_a` on top of those of the readings show by how much: opposite ones cancel but for that.
    """
    rng, none = np.random.default_rng(0), score(np.zeros_like(error_a))
    moved_a = error_a * rng.standard_normal((PAIRS, *error_a.shape))
    return np.mean([0.5 * (score(one) + score(-one)) for one in moved_a], axis=0) - none


def _fit_loads(
    calibration: Calibration, loads: list[Load], kind: str, odd: Taxels | None = None, most: int = FORCES
) -> tuple[SheetFit, dict[str, float]]:
    """Fit all loads; return the fit and the relative residual of every load.

    Taxels in `odd` have an exponent of their own and no part in the shared law: they do not bend the others, and no
    other taxel gets a law of its own. Up to `most` forces each have their own effect.
    """
    odd_taxels = [r * calibration.cols + c for r, c in odd or ()]
    codes = np.array([load.codes.mean(axis=0) for load in loads])
    force = np.array([load.force_n for load in loads])
    used = (codes >= LEAST_CODE) & (codes < calibration.full_code) & (force > 0)
    taxel = np.broadcast_to(np.arange(codes[0].size).reshape(codes[0].shape), codes.shape)[used]
    which = np.nonzero(used)[0]
    if used.sum() < 10:
        said = f"{used.sum()} readings of known loads from code {LEAST_CODE} on"
        raise ContradictionError(f"{said}; at least 10 are needed")
    names, at = np.unique(taxel, return_inverse=True)
    log_force = np.log(force[used])
    effects = _hats(log_force, most)
    mine = [taxel == t for t in odd_taxels]
    slopes = [np.where(m, log_force - log_force[m].mean(), 0.0) for m in mine]
    matrix = np.column_stack([np.eye(names.size)[at], effects, *slopes])
    # Half a code in a small reading counts less; of the two sets of effects one constant is free.
    weight = _weight(calibration, codes)[used]
    left, size, _ = np.linalg.svd(weight[:, None] * matrix, full_matrices=False)
    # The free constant is 1e-16 of the largest direction by rounding; the least that loads determine is above 1e-4.
    basis = left[:, size > 1e-9 * size[0]]
    currents = calibration.step_a * (codes - calibration.start_code)

    def logs(g: Floats) -> Floats:
        return np.log(np.clip(g[used], *CONDUCTANCES_S))

    def residual(g: Floats) -> Floats:
        r = weight * logs(g)
        return r - basis @ (basis.T @ r)

    freedom = int(used.sum()) - basis.shape[1]
    frames = np.array([len(load.codes) for load in loads])[:, np.newaxis, np.newaxis]
    error_code2 = (codes > 0) * (1 / 12 + calibration.noise_code**2 / frames)
    fitted = _fit_network(calibration, currents, error_code2, residual, freedom)
    network, values, remarks, off_networks, offset_v2 = fitted

    def taxels(network: Network) -> tuple[Floats, Floats, Floats]:
        """Return conductances, effects of taxels and factors [rows x cols] with a network."""
        g = _conductances(calibration, network, currents)
        solution = np.linalg.lstsq(weight[:, None] * matrix, weight * logs(g), rcond=None)[0]
        factor = np.ones(codes[0].size)
        factor[names] = np.exp(solution[: names.size] - solution[: names.size].mean())
        return g, solution[: names.size], factor

    g, effect, factor = taxels(network)
    modes = []
    for mode in off_networks:
        for _ in range(HALVINGS):
            g_off, _, factor_off = taxels(dataclasses.replace(network, **mode))
            if (np.clip(g_off[used], *CONDUCTANCES_S) == g_off[used]).all():
                break
            # So far from the fit no taxel would read what it reads: the network is nearer.
            mode = {name: 0.5 * (off + getattr(network, name)) for name, off in mode.items()}
        # The forces are the same, so the law keeps its level.
        level = np.exp(np.mean(logs(g_off) - np.log(factor_off[taxel]) - logs(g) + np.log(factor[taxel])))
        modes.append(Mode(mode, (factor_off * level / factor - 1).reshape(codes[0].shape)))
    count = np.bincount(at)
    part = np.full(factor.size, float(np.std(effect)))
    off = residual(g) / weight
    rms = float(np.sqrt(np.mean(off**2)))
    part[names] = np.sqrt(np.bincount(at, off**2) / np.maximum(count - 1, 1)) / np.sqrt(count)
    part = np.maximum(part, rms / np.sqrt(count.max()))
    by_law = np.exp(logs(g)) / factor[taxel]
    alike = ~np.isin(taxel, odd_taxels)
    try:
        curve = _robust_law(kind, by_law[alike], force[used][alike], which[alike])
    except law.LawError as error:
        raise ContradictionError(str(error)) from None
    misfit = curve.force_n(by_law) / force[used] - 1
    own = _own_laws(kind, curve, by_law, force[used], taxel, np.unique(taxel) if odd is None else odd_taxels)
    for t, own_curve in own.items():
        mine = taxel == t
        misfit[mine] = own_curve.force_n(by_law[mine]) / force[used][mine] - 1
        off[mine] = misfit[mine]
        parameters = law.PARAMETERS[kind]
        part[t] = np.sqrt(np.mean(misfit[mine] ** 2) * parameters / max(mine.sum() - parameters, 1))
    # An upper bound: the fit takes more from the scatter without a law than from that with it.
    law_part = float(np.sqrt(max(np.mean(misfit**2) - np.mean(off**2), 0.0)))
    # A wrong force of a whole load is a level of its own, which the law does not meet.
    square = off**2 + misfit**2
    by_load = {loads[n].name: float(np.sqrt(np.mean(square[which == n]))) for n in np.unique(which)}
    found = (*NETWORK_START, "r_row_grounded_ohm", "v_column_offset_v")
    made = dataclasses.replace(
        calibration,
        step_a=calibration.step_a * calibration.current_part(network),
        network=calibration.network | {n: getattr(network, n) for n in found},
        modes=tuple(modes),
        offset_v2=offset_v2,
        factor=factor.reshape(codes[0].shape),
        factor_part=part.reshape(codes[0].shape),
        curve=curve,
        own={divmod(t, calibration.cols): c for t, c in own.items()},
        law_part=law_part,
    )
    return SheetFit(made, values, remarks, (), drift=_drift(misfit, which)), by_load


def _drift(misfit: Floats, which: NDArray[np.integer]) -> float:
    """Return the drift of a `SheetFit` from relative errors of readings of the loads `which`, in order of time."""
    loads = np.unique(which)
    if loads.size < 3:
        return 0.0
    levels = [np.median(misfit[which == n]) for n in loads]
    slope, _, low, high = theilslopes(levels, loads, alpha=DRIFT_SURE)
    return float(slope * np.ptp(loads)) if low * high > 0 else 0.0


def _weight(calibration: Calibration, codes: Floats) -> Floats:
    """Return one over the standard deviation of the logarithm of a conductance by rounding, of codes [..., cols].

    A divider's resistor takes voltage from the taxel: a count at u of the bias is 1 / (1 - u) times as much.
    """
    lost_v = calibration.divider * codes * calibration.step_a * calibration.array().r_column_ohm
    return codes * np.sqrt(12) * np.maximum(1.0 - lost_v / calibration.v_bias_v, 1e-3)


def _robust_law(kind: str, g: Floats, force_n: Floats, which: NDArray[np.integer]) -> law.Curve:
    """Fit a law to readings of the loads `which`, without loads that the law of the others does not meet.

    A wrong force bends the law towards itself: the worst load is judged by a law that is fitted without it.
    """
    kept = np.ones(which.size, dtype=bool)
    loads = left = np.unique(which)

    def misfits(curve: law.Curve) -> Floats:
        """Return the relative rms difference between a law and the readings of each load that is left."""
        off = (curve.force_n(g) / force_n - 1) ** 2
        return np.array([np.sqrt(off[which == n].mean()) for n in left])

    while True:
        curve = law.fit(kind, g[kept], force_n[kept])
        left = np.unique(which[kept])
        if left.size <= (1 - SHARE_BAD) * loads.size:
            return curve
        worst = left[np.argmax(misfits(curve))]
        others = kept & (which != worst)
        try:
            off = misfits(law.fit(kind, g[others], force_n[others]))
        except law.LawError:  # the load is needed
            return curve
        if off[left == worst][0] <= BAD_LOAD * max(np.median(off), RESIDUAL_MIN):
            return curve
        kept = others


def _hats(log_force: Floats, most: int = 0) -> Floats:
    """Return hat functions of the force [readings, levels]: at each force up to `most`, else at `LEVELS`."""
    levels = np.unique(log_force)
    if levels.size > most:
        levels = np.unique(np.quantile(log_force, np.linspace(0, 1, LEVELS)))
    return np.stack([np.interp(log_force, levels, row) for row in np.eye(levels.size)], axis=1)


def _turn_on(calibration: Calibration, g: Floats, force_n: Floats) -> Calibration:
    """Set the force below which the sheet does not conduct, from conductances over factors; keep it if none tells.

    Those of less than half of the law lie below it, and others above, with as few exceptions as can be, for some taxels
    may be broken. It is then the least force above that conducts. Forces whose law is below a code and a half tell
    nothing.
    """
    curve = dataclasses.replace(calibration.curve, force_on_n=0.0)
    by_law = curve.conductance_s(force_n)
    told = calibration.v_bias_v * by_law > 1.5 * calibration.step_a.max()
    order = np.argsort(force_n[told], kind="stable")
    force, silent = force_n[told][order], (g < 0.5 * by_law)[told][order]
    exceptions = np.append(0, np.cumsum(np.where(silent, -1, 1)))  # more than with none below it
    if (below := int(np.argmin(exceptions))) == 0:
        return calibration
    curve = dataclasses.replace(curve, force_on_n=float(force[min(below, force.size - 1)]))
    return dataclasses.replace(calibration, curve=curve)


def _own_laws(
    kind: str, shared: law.Curve, conductance_s: Floats, force_n: Floats, taxel: NDArray, among: Iterable[int]
) -> dict[int, law.Curve]:
    """Return the laws of those taxels in `among`, by number, whose readings the shared law does not fit.

    A taxel needs `law.ENOUGH` forces, and its own law must lower the sum of squares significantly (F test).
    """
    found: dict[int, law.Curve] = {}
    parameters = law.PARAMETERS[kind]
    for t in among:
        g, force = conductance_s[taxel == t], force_n[taxel == t]
        if np.unique(force).size < law.ENOUGH.get(kind, np.inf):
            continue
        try:
            mine = law.fit(kind, g, force)
        except law.LawError:  # readings that no law of its own fits stay with the shared one
            continue
        before, after = (float(np.sum((c.force_n(g) / force - 1) ** 2)) for c in (shared, mine))
        freedom = g.size - parameters
        ratio = (before - after) / parameters / max(after / freedom, 1e-300)
        if f_distribution.sf(ratio, parameters, freedom) < OWN_SHARE:
            found[int(t)] = mine
    return found


def _sigma_of_cycle(jac: Floats, residual: Floats, spread: float, used: Bools) -> Floats:
    """Return standard uncertainties of parameters from residuals, of variance `spread`, of the readings `used` [frames,
    taxels].

    A rounding stays alike for as long as a code does: covariances of a taxel's residuals count up to a hundredth of the
    cycle apart, as Newey and West weigh them (Econometrica 55, 1987). It is never less than that of independent ones.
    """
    inverse = np.linalg.pinv(jac.T @ jac)
    score = np.zeros((*used.shape, jac.shape[1]))
    score[used] = jac * residual[:, np.newaxis]
    most, frames, inner = len(used) // 100, len(used), np.zeros_like(inverse)
    for apart in range(most + 1):
        product = np.tensordot(score[: frames - apart], score[apart:], axes=([0, 1], [0, 1]))
        inner += (1 - apart / (most + 1)) * (product if apart == 0 else product + product.T)
    return np.sqrt(np.maximum(np.diag(inverse) * spread, np.diag(inverse @ inner @ inverse)))


def fit_memory(
    calibration: Calibration, codes: ArrayLike, force_n: ArrayLike, t_frame_s: float
) -> tuple[Calibration, dict[str, tuple[float, float]]]:
    """Fit hysteresis and creep to a load cycle.

    calibration : with network, factors and curve; the level of the factors is fitted again.
    codes, force_n : [frames, rows, cols] from rest, `t_frame_s` seconds apart; at least one rise and fall.

    Returns the calibration, and values with standard uncertainties: width of the loop, share of it that plays, creep a
    decade. ContradictionError if no taxel is pressed from `LEAST_CODE` on, the force never rises or never falls, or
    the readings fit no hysteresis and creep.
    """
    codes, force = np.asarray(codes, dtype=float), np.asarray(force_n, dtype=float)
    currents = calibration.step_a * (codes - calibration.start_code)
    g = _conductances(calibration, calibration.array(), currents) / calibration.factor
    flat_codes, flat_force = codes.reshape(len(codes), -1), force.reshape(len(force), -1)
    peak = flat_codes.max(axis=0)
    # Those that saturate lose the top of the cycle, where creep shows; they come last.
    chosen = np.argsort(np.where(peak < calibration.code_max, -peak, 0.0))[:TAXELS]
    chosen = chosen[peak[chosen] >= LEAST_CODE]
    seen, g = flat_codes[:, chosen], g.reshape(len(codes), -1)[:, chosen]
    force = flat_force[:, chosen]
    full = np.broadcast_to(calibration.full_code, codes.shape[1:]).ravel()[chosen]
    used = (seen >= LEAST_CODE) & (seen < full) & (force > 0)
    moves = np.diff(force, axis=0)
    if not (used.any() and (moves > 0).any() and (moves < 0).any()):
        raise ContradictionError("a cycle needs a taxel that is pressed and let go")
    measured = np.where(used, np.log(np.maximum(g, 1e-12)), 0.0)
    weight = _weight(calibration, codes).reshape(len(codes), -1)[:, chosen][used]

    def law_of(p: Floats) -> MemoryLaw:
        radius, play, creep = p
        start_s = calibration.memory.creep_start_s
        return MemoryLaw(np.array([0.0, radius]), np.array([1 - play, play]), creep, start_s)

    laws = [calibration.law_of(*divmod(int(t), calibration.cols)) for t in chosen]
    by_law = np.stack([one.conductance_s(f) for one, f in zip(laws, force.T, strict=True)], axis=1)
    # A taxel that reads 0 carries no load for the decoder either.
    by_law[seen == 0] = 0.0

    def difference(p: Floats) -> Floats:
        stream = SheetMemory(law_of(p), chosen.size, calibration.curve.g_open_s)
        made = np.log(np.maximum([stream.apply(frame, t_frame_s) for frame in by_law], 1e-12))
        return (measured - made)[used]

    # Errors of the law are the same on the way up and down, those of a factor all the time, and static loads hold some
    # creep: all are taken out.
    taxel = np.broadcast_to(np.arange(chosen.size), used.shape)[used]
    own = taxel[:, np.newaxis] == np.arange(1, chosen.size)
    basis, _ = np.linalg.qr(weight[:, None] * np.hstack([_hats(np.log(force[used])), own]))

    def residual(p: Floats) -> Floats:
        off = difference(p) * weight
        return off - basis @ (basis.T @ off)

    start, most = np.array([0.03, 0.7, 0.02]), [0.3, 1, 0.5]
    found = least_squares(residual, start, bounds=([0, 0, 0], most), diff_step=1e-4, x_scale=[0.05, 1, 0.05])
    spread = float(found.fun @ found.fun / max(found.fun.size - 3, 1))
    sigma = _sigma_of_cycle(found.jac, found.fun, spread, used)
    if (off := np.sqrt(spread)) > CYCLE_OFF * np.hypot(1.0, np.sqrt(12) * calibration.noise_code):
        said = f"readings of the cycle are {off / np.sqrt(12):.2g} codes off any hysteresis and creep"
        asked = "are forces and codes of the same frames? One of a few taxels needs less of the network"
        raise ContradictionError(f"{said}: {asked}")
    radius, play, creep_per_decade = p = found.x
    level = float(np.exp(np.average(difference(p), weights=weight**2)))
    # A share of the loop within its own uncertainty of the whole is the whole.
    memory = law_of(p)
    if play > 1 - max(3 * sigma[1], 0.05):
        memory = MemoryLaw(np.array([radius * play]), np.ones(1), creep_per_decade, memory.creep_start_s)
    # A loop of under 1/1000 of the force is below half a code at full scale, 1/510.
    if radius * play < 1e-3:
        memory = MemoryLaw(np.empty(0), np.empty(0), creep_per_decade, memory.creep_start_s)
    loop_sigma = float(2 * (sigma[0] * play + sigma[1] * radius))
    values = {
        "hysteresis": (float(-np.expm1(-2 * radius * play)), loop_sigma),
        "hysteresis_share": (float(play), float(sigma[1])),
        "creep_per_decade": (float(creep_per_decade), float(sigma[2])),
    }
    modes = []
    for mode in calibration.modes:
        # The cycle sets the level of the factors with every network.
        ratio = _conductances(calibration, calibration.array(mode), currents)
        ratio = ratio.reshape(len(codes), -1)[:, chosen]
        ratio = ratio[used] / (g * ((1 + mode.factor_part) * calibration.factor).ravel()[chosen])[used]
        shift = np.exp(np.average(np.log(np.maximum(ratio, 1e-12)), weights=weight**2))
        modes.append(dataclasses.replace(mode, factor_part=(1 + mode.factor_part) * shift - 1))
    uncertain = COVERAGE_SIGMA * float(np.hypot(loop_sigma / 2, sigma[2]))
    made = dataclasses.replace(
        _turn_on(calibration, g, force),
        memory=memory,
        modes=tuple(modes),
        factor=calibration.factor * level,
        uncorrected_part=UNSEEN_DECADES * creep_per_decade + uncertain,
    )
    return made, values
