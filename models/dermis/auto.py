# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: which effects a scene needs, which engine can do them cheapest, and by how much codes may miss.

models/dermis/bounds.py says how far each effect can move a decision; docs/auto.md why that bounds the codes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dermis import bounds, engines
from dermis.bounds import Extent, Total
from dermis.effects import EFFECTS, AutoTable
from dermis.scene import scene
from dermis.scene.schema import Strict

if TYPE_CHECKING:
    from dermis.records import Plan
    from dermis.scene.scene import Scene

Floats = NDArray[np.float64]

# Engines a plan may choose for itself, and nanoseconds a conversion of each without effects; what an effect adds
# stands with it (Effect.cost_ns). `dermis plan --costs` measures both; only the order of magnitude enters the choice.
ENGINE_COST_NS = {"closed": 40.0, "event": 350.0}
# One solve serves all of these, so leaving one out saves nothing while another is in.
_SOLVE = frozenset({"row_driver", "column_input", "column_offset", "mux_leakage", "trace"})

# Rounding and approximation: 1e-9 of a current (array), 5e-5 packets in the course of a current over a frame with
# motion (event), some 1e-12 of the states.
ROUNDING_LSB = 1e-4


@dataclass(frozen=True)
class Choice:
    """What a plan simulates.

    `on` names of effects; `engine`; `margin_lsb` [cols] for the certified codes: what is left out, what is
    random, and what kept effects add; `unsure_lsb` [rows, cols] as Plan has it; `left_out_lsb` the largest sum of
    what is left out; `bound_lsb` and `why` for every effect that was considered.
    """

    on: tuple[str, ...]
    engine: str
    margin_lsb: Floats
    unsure_lsb: Floats
    left_out_lsb: float
    bound_lsb: dict[str, float]
    why: dict[str, str]


def with_auto(world: Scene) -> Scene:
    """The same scene as if it said [effects] auto = {}."""
    return scene.with_effects(world, world.table.effects.model_copy(update={"auto": AutoTable()}), None)


def candidates(world: Scene) -> dict[str, Strict]:
    """What auto would consider in a scene: what it names, and every further effect with physical defaults."""
    return with_auto(world).effects


class _Weighing:
    """Bounds of all effects of a plan on the cells that can feel them, and sums over what is left out."""

    def __init__(self, plan: Plan, auto: AutoTable) -> None:
        self.on = plan.scene.effects
        self.extent = e = Extent(plan, auto.sigma)
        functions = {name: EFFECTS[name].bound for name in self.on}
        with np.errstate(invalid="ignore", over="ignore"):
            self.total = Total(e, bounds.of_effects(self.on, functions, e))
            felt = self.total.felt
            self.where = np.nonzero(felt)
            self.cap = self.total.cap[felt]
            self.lsb = {name: np.ascontiguousarray(lsb[felt]) for name, lsb in self.total.lsb.items()}
            self.beside = {
                name: {by: part[felt] for by, part in parts.items()}
                for name, parts in self.total.beside.items()
            }
            self.kept = {
                name: np.broadcast_to(bounds.kept(name, e), felt.shape)[felt]
                for name in bounds.KEPT
                if name in self.on
            }
        # A packet is counted by its size, and bounds are in ideal ones.
        self.counts = 1.0 / e.packet_low[self.where[2]]
        self.bound = {name: self.alone(name, set()) for name in self.on}
        self.fields = {name: fields_of(plan, name) for name in self.on}

    def alone(self, name: str, out: Set[str]) -> float:
        """Codes by which an effect may move any, beside others that are not `out`."""
        lsb = self.lsb[name]
        lsb = np.minimum(lsb, self.cap) if self.total.bounds[name].steady else lsb
        with np.errstate(over="ignore"):
            return self._largest((lsb + self._on_top(name, out)) * self.counts)

    def _on_top(self, name: str, out: Set[str]) -> ArrayLike:
        """Packets by which an effect moves levels beside others that are not `out`."""
        return sum((part for by, part in self.beside[name].items() if by not in out), 0.0)

    def _inputs(self, names: Set[str]) -> Floats:
        """Packets by which steady currents of cells are off where effects are left out, full scale or not."""
        inputs = np.zeros(self.cap.shape)
        for name in filter(names.__contains__, self.on):
            if self.total.bounds[name].steady:
                inputs = inputs + self.lsb[name]
        return inputs

    def _cells(self, names: Set[str], kept: Set[str]) -> Floats:
        """Packets by which effects that are left out (or random) may move a decision, beside others that are kept."""
        moved = np.minimum(self._inputs(names), self.cap)
        levels = squares = 0.0
        fastest = moved
        # In the scene's order: that of a set differs from process to process, and with it a sum's last digit.
        for name in filter(names.__contains__, self.on):
            bound, lsb = self.total.bounds[name], self.lsb[name]
            if bound.gauss:
                squares = squares + lsb * lsb
            elif not bound.steady:
                levels = levels + lsb
            if bound.rate is not None:
                fastest = fastest + np.broadcast_to(bound.rate, self.total.felt.shape)[self.where]
            levels = levels + self._on_top(name, names)
        if "mirror_lag" in self.on and "mirror_lag" not in names and np.any(fastest > 0):
            whole = np.zeros(self.total.felt.shape)
            whole[self.where] = fastest
            moved = moved + bounds.lag_slack(whole, self.extent)[self.where[2]]
        cells = moved + levels + np.sqrt(squares)
        # Where nothing moves a cell all runs are one.
        beside = sum((self.kept[name] for name in filter(kept.__contains__, self.kept)), 0.0)
        return np.where(cells <= 0, 0.0, cells + beside)

    @staticmethod
    def _largest(cells: Floats) -> float:
        largest = float(cells.max(initial=0.0))
        return largest if largest == largest else float("inf")  # infinite less infinite: nothing is known

    def fits(self, out: set[str], budget: float) -> bool:
        """Whether all of these may be left out together."""
        if not out:
            return True
        if "mirror_lag" in out:
            budget = min(budget, self.extent.lag_room)
        # Asked for many sets: that of nothing on top is the same beside any.
        if any((self.alone(name, out) if self.beside[name] else self.bound[name]) > budget for name in out):
            return False
        return self.off(out) <= budget

    def off(self, out: set[str]) -> float:
        """Codes by which leaving these out together may move any, at most."""
        if not out:
            return 0.0
        grown = bounds.grown(self.on.keys() - out, self.total.bounds, self.extent)
        times, plus = (part[self.total.felt] for part in grown)
        cells = self._cells(out, self.kept.keys() - out)
        with np.errstate(over="ignore", invalid="ignore"):
            return self._largest(np.where(cells <= 0, 0.0, (cells * times + plus) * self.counts))

    def margin(self, out: set[str], random: Iterable[str] = ()) -> Floats:
        """Packets [cols] by which leaving `out` out, and noise of `random`, may move a decision."""
        names = out | set(random)
        whole = np.zeros(self.total.felt.shape)
        if names:
            whole[self.where] = self._cells(names, self.kept.keys() - out)
        return np.nan_to_num(whole.max(axis=(0, 1)), nan=np.inf)

    def unsure(self, out: set[str], margin: Floats) -> Floats:
        """N x [rows, cols] below which a cell may read less than full scale in the chip though it does so here.

        0 where the margin [cols] holds all that currents are off by. Elsewhere it ends where full scale begins.
        """
        whole = np.zeros(self.total.felt.shape)
        if out:
            inputs, col = self._inputs(out), self.where[2]
            whole[self.where] = np.where(inputs > margin[col], self.total.sure[col] + inputs, 0.0)
        return whole.max(axis=0)


def fields_of(plan: Plan, name: str) -> frozenset[str]:
    part = EFFECTS[name].contribute(plan.scene.effects[name], plan.setting())
    return frozenset(part.network) | frozenset(part.converter) | frozenset(part.drive)


def choose(plan: Plan, auto: AutoTable, engine: str | None) -> Choice:
    """Decide for a plan with every candidate on; `engine` if one was asked for."""
    weighing = _Weighing(plan, auto)
    names = list(weighing.on)
    sheet = {n for n in names if not weighing.fields[n]}  # they changed the frames themselves already
    best: tuple[float, str, set[str]] | None = None
    for name in [engine] if engine else ENGINE_COST_NS:
        honours = engines.honours(name)
        cannot = {n for n in names if weighing.fields[n] - honours}
        for network in (set(), {"trace"}, _SOLVE):
            out = cannot | (network & set(names))
            if not weighing.fits(out, auto.budget_lsb):
                continue
            cost = cost_ns(name, set(names) - out)
            if best is None or cost < best[0]:
                best = (cost, name, out)
    if best is None:  # the engine asked for cannot; engines.check says so
        best = (0.0, engine or "event", set())
    _, chosen, out = best
    rest = [n for n in names if n not in out and n not in sheet]
    rest.sort(key=lambda n: weighing.bound[n] / (1.0 + EFFECTS[n].cost_ns))
    for name in rest * 2:  # leaving some out makes room for others, which need not allow for them any more
        if name not in out and weighing.fits(out | {name}, auto.budget_lsb):
            out.add(name)
    left = weighing.off(out)
    why = {}
    for n in names:
        if n in out:
            why[n] = f"all left out: {left:.3g} of {auto.budget_lsb:g} LSB"
        elif n in sheet:
            why[n] = "changes the frames themselves"
        elif weighing.alone(n, out) > auto.budget_lsb:
            why[n] = "above the budget"
        elif math.isinf(weighing.off(out | {n})):
            why[n] = "beside a limit in reach, or a leak, nothing is small"
        else:
            why[n] = "what is left of the budget is less"
    on = tuple(n for n in names if n not in out)
    margin = _certain(weighing, out)
    return Choice(on, chosen, margin, weighing.unsure(out, margin), left, weighing.bound, why)


def _certain(weighing: _Weighing, out: set[str]) -> Floats:
    random = [n for n in weighing.on if EFFECTS[n].random and n not in out]
    margin = weighing.margin(out, random) if out or random else np.zeros(weighing.extent.cols)
    return np.where(margin > 0, margin + ROUNDING_LSB, 0.0)


def random_margin(plan: Plan) -> Floats:
    """Margin [cols] of a plan in which nothing is left out: what is random in it."""
    if not any(EFFECTS[n].random for n in plan.scene.effects):
        return np.zeros(plan.cols)
    return _certain(_Weighing(plan, AutoTable()), set())


def cost_ns(engine: str, on: set[str]) -> float:
    """Nanoseconds a conversion that an engine is reckoned to cost with these effects on."""
    solve = max((EFFECTS[n].cost_ns for n in on & _SOLVE), default=0.0)
    return ENGINE_COST_NS.get(engine, 0.0) + solve + sum(EFFECTS[n].cost_ns for n in sorted(on - _SOLVE))
