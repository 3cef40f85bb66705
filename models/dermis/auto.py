# SPDX-License-Identifier: Apache-2.0
"""[effects] auto: which effects a scene needs, which engine is the cheapest that can do them, and what is certain.

models/dermis/bounds.py says how far each effect can move a decision; docs/auto.md why that bounds the codes.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from dermis import bounds, effects, engines
from dermis.bounds import Extent, Total
from dermis.effects import EFFECTS, AutoTable
from dermis.errors import InputError
from dermis.schema import Strict
from dermis.vfc import W_PRESET, code

if TYPE_CHECKING:
    from dermis.engines import Result
    from dermis.plan import Plan
    from dermis.scene import Scene

Floats = NDArray[np.float64]

# Engines a plan may choose for itself, and nanoseconds a conversion of each without effects; what an effect adds
# stands with it (Effect.cost_ns). `dermis plan --costs` measures both; only the order of magnitude enters the choice.
ENGINE_COST_NS = {"closed": 40.0, "event": 350.0}
# One solve serves all of these, so leaving one out saves nothing while another is in.
_SOLVE = frozenset({"row_driver", "column_input", "column_offset", "mux_leakage", "trace"})

# Rounding and approximation: 1e-9 of a current (array), 5e-5 packets in the course of a current over a frame with
# motion (event), some 1e-12 of the states.
ROUNDING_LSB = 1e-4

# Inputs that change inside a gate (event_input.FIELDS).
_UNSTEADY = frozenset({"ripple", "motion", "q_mirror_c", "c_row_f", "c_column_f", "c_taxel_f"})
_RANDOM_FIELDS = (
    "v_comp_noise_v",
    "t_meta_s",
    "t_jitter_s",
    "kt_noise_j",
    "q_shot_c",
    "v_preset_noise_v",
    "packet_flicker",
)


@dataclass(frozen=True)
class Choice:
    """What a plan simulates.

    `on` names of effects; `engine`; `margin_lsb` [cols] for the certified codes: what is left out, what is
    random, and what kept effects add; `left_out_lsb` the largest sum of what is left out; `bound_lsb` and `why`
    for every effect that was considered.
    """

    on: tuple[str, ...]
    engine: str
    margin_lsb: Floats
    left_out_lsb: float
    bound_lsb: dict[str, float]
    why: dict[str, str]


def candidates(world: Scene) -> dict[str, Strict]:
    """What auto would consider in a scene: what it names, and every further effect with physical defaults."""
    table = world.table.effects.model_copy(update={"auto": AutoTable()})
    return effects.resolve_effects(table, effects.Setting.of(world.table, world.design, _no_rng), world.path)


def with_auto(world: Scene, auto: AutoTable | None = None) -> Scene:
    """The same scene as if it said [effects] auto."""
    chosen = world.table.effects.model_copy(update={"auto": auto or AutoTable()})
    table = world.table.model_copy(
        update={"effects": chosen, "run": world.table.run.model_copy(update={"engine": None})}
    )
    return dataclasses.replace(world, table=table, effects=candidates(world))


def _no_rng(name: str) -> Any:
    raise AssertionError(f"{name}: no random number is drawn here")


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
            self.kept = {
                name: np.broadcast_to(bounds.kept(name, e), felt.shape)[felt]
                for name in bounds.KEPT
                if name in self.on
            }
        self.bound = {
            name: self._largest(lsb if self.total.bounds[name].level else np.minimum(lsb, self.cap))
            for name, lsb in self.lsb.items()
        }
        self.fields = {name: _fields(plan, name) for name in self.on}

    def _cells(self, names: Iterable[str], kept: Iterable[str] = ()) -> Floats:
        """Packets by which effects that are left out (or random) may move a decision, beside others that are kept."""
        inputs = levels = squares = 0.0
        for name in names:
            bound, lsb = self.total.bounds[name], self.lsb[name]
            if bound.gauss:
                squares = squares + lsb * lsb
            elif bound.level:
                levels = levels + lsb
            else:
                inputs = inputs + lsb
        for name in kept:
            levels = levels + self.kept[name]
        moved = np.minimum(inputs, self.cap)
        if "mirror_lag" in self.on and "mirror_lag" not in names and np.any(moved > 0):
            whole = np.zeros(self.total.felt.shape)
            whole[self.where] = moved
            moved = moved + bounds.lag_slack(whole, self.extent)[self.where[2]]
        return moved + levels + np.sqrt(squares)

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
        if any(self.bound[name] > budget for name in out):
            return False
        return self._largest(self._cells(out, self.kept.keys() - out)) <= budget

    def margin(self, out: set[str], random: Iterable[str] = ()) -> Floats:
        """Packets [cols] by which leaving `out` out, and noise of `random`, may move a decision."""
        names = out | set(random)
        whole = np.zeros(self.total.felt.shape)
        if names:
            whole[self.where] = self._cells(names, self.kept.keys() - out)
        return np.nan_to_num(whole.max(axis=(0, 1)), nan=np.inf)


def _fields(plan: Plan, name: str) -> frozenset[str]:
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
            cost = _cost(name, set(names) - out)
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
    left = float(weighing.margin(out).max()) if out else 0.0
    why = {}
    for n in names:
        if n in out:
            why[n] = f"all left out: {left:.3g} of {auto.budget_lsb:g} LSB"
        elif n in sheet:
            why[n] = "changes the frames themselves"
        elif weighing.bound[n] > auto.budget_lsb:
            why[n] = "above the budget"
        else:
            why[n] = "what is left of the budget is less"
    on = tuple(n for n in names if n not in out)
    return Choice(on, chosen, _certain(weighing, out), left, weighing.bound, why)


def _certain(weighing: _Weighing, out: set[str]) -> Floats:
    random = [n for n in weighing.on if EFFECTS[n].random and n not in out]
    margin = weighing.margin(out, random) if out or random else np.zeros(weighing.extent.cols)
    return np.where(margin > 0, margin + ROUNDING_LSB, 0.0)


def random_margin(plan: Plan) -> Floats:
    """Margin [cols] of a plan in which nothing is left out: what is random in it."""
    if not any(EFFECTS[n].random for n in plan.scene.effects):
        return np.zeros(plan.cols)
    return _certain(_Weighing(plan, AutoTable()), set())


def _cost(engine: str, on: set[str]) -> float:
    solve = max((EFFECTS[n].cost_ns for n in on & _SOLVE), default=0.0)
    return ENGINE_COST_NS.get(engine, 0.0) + solve + sum(EFFECTS[n].cost_ns for n in on - _SOLVE)


def _start(plan: Plan) -> tuple[Floats, Floats, Floats]:
    c = plan.converter
    return (
        W_PRESET + c.preset_error_v / c.packet_v(),
        1.0 + c.packet_error,
        c.v_comp_offset_v / c.packet_v(),
    )


# --- certified codes ---------------------------------------------------------------------------------------------


def certified(plan: Plan, result: Result) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Codes between which the chip's lie: the plan without noise, its levels moved by the margin either way."""
    margin = np.broadcast_to(plan.margin_lsb, (plan.cols,))
    if not margin.any():
        return result.codes, result.codes
    margin = np.minimum(margin, 2.0 * plan.timing.code_max)
    silent = dataclasses.replace(plan.converter, **dict.fromkeys(_RANDOM_FIELDS, 0.0))
    # The duty of the run serves again where it is the same in every clock and no converter acts back on it.
    steady = not plan.active_fields() & _UNSTEADY and plan.topology != "direct"
    x = result.info.get("x") if plan.engine == "closed" or steady else None
    ends = []
    for sign in (1.0, -1.0):
        moved = silent.v_comp_offset_v + sign * margin * silent.packet_v()
        end = dataclasses.replace(
            plan, converter=dataclasses.replace(silent, v_comp_offset_v=moved), margin_lsb=0.0, engine="event"
        )
        if not engines.refused(end, "closed"):
            end = dataclasses.replace(end, engine="closed")
        if x is None:
            run = engines.run(end)
            x = run.info.get("x") if end.engine == "closed" or steady else None
            ends.append(run.codes)
        elif end.engine == "closed":
            ends.append(_closed_codes(end, x))
        else:
            ends.append(_event_codes(end, x))
    low, high = ends
    return low, high


def _closed_codes(plan: Plan, x: Floats) -> NDArray[np.uint8]:
    start, packet, threshold = _start(plan)
    t = plan.timing
    return code(x, t.gate_clocks, t.code_max, w0=start, packet=packet, threshold=threshold).astype(np.uint8)


def _event_codes(plan: Plan, x: Floats) -> NDArray[np.uint8]:
    from dermis.engines import event

    codes = np.empty(x.shape, dtype=np.uint8)
    step = max(1, (1 << 14) // (plan.rows * plan.cols))
    for first in range(0, plan.frames, step):
        part = slice(first, first + step)
        cells = event.cells_of(plan, x[part], plan.conductance_s(part))
        counts, _ = event.count_cells(cells, plan.timing.gate_clocks, plan.timing.charge_delay_clocks)
        codes[part] = np.minimum(counts, plan.timing.code_max)
    return codes


# --- the table, and what its costs are -----------------------------------------------------------------------------


def print_plan(plan: Plan) -> None:
    """Print what a plan simulates: effect, bound, in or out, why, cost."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=130)
    table = Table(title=None, box=box.SIMPLE_HEAD)
    for heading in ("effect", "bound in LSB", "", "why", "cost in ns"):
        table.add_column(heading, justify="right" if " in " in heading else "left")
    for e in plan.effects:
        if e.bound_lsb is None and not e.on:
            continue
        bound = "" if e.bound_lsb is None else ("none" if e.bound_lsb > 1e300 else f"{e.bound_lsb:.3g}")
        cost = "" if e.cost_ns is None else f"{e.cost_ns:.0f}"
        table.add_row(e.name, bound, "in" if e.on else "out", e.reason, cost)
    console.print(table)
    aside = [e for e in plan.effects if e.bound_lsb is None and not e.on]
    if aside:
        console.print(
            "not considered: " + ", ".join(f"{e.name} ({e.reason})" for e in aside), highlight=False
        )
    margin = float(np.max(plan.margin_lsb))
    console.print(
        f"engine {plan.engine}; left out: {plan.left_out_lsb:.3g} LSB together; certified codes allow for "
        f"{margin:.3g} LSB either way",
        highlight=False,
    )


def measure_costs(frames: int = 32, repeats: int = 5) -> dict[str, float]:
    """Nanoseconds a conversion: of every engine bare, and what each effect alone adds to the cheapest that can."""
    from dermis import plan as planning
    from dermis import scene

    def world(effect: str | None, topology: str) -> Scene:
        stimulus = {"kind": "ramp", "force_n": [0.0, 12.0], "frames": frames}
        data = {
            "stimulus": stimulus,
            "interface": {"topology": topology},
            "effects": {effect: True} if effect else {},
        }
        return scene.from_data(data, Path("costs"))

    def nanoseconds(scene_of: Scene, engine: str) -> float:
        plan = planning.whole(scene_of, engine)
        run = engines.runner(engine)
        run(plan)
        best = min(_timed(run, plan) for _ in range(repeats))
        return 1e9 * best / plan.resistance_ohm.size

    found = {name: nanoseconds(world(None, "conveyor_mirror"), name) for name in ENGINE_COST_NS}
    for name, effect in EFFECTS.items():
        scene_of = world(name, effect.topologies[-1])
        made = planning.whole(scene_of, None)
        if not _fields(made, name):
            continue
        engine = engines.cheapest(made, ENGINE_COST_NS) or "event"
        found[name] = nanoseconds(scene_of, engine) - found[engine]
    return found


def _timed(run: Any, plan: Plan) -> float:
    start = time.process_time()
    run(plan)
    return time.process_time() - start


@click.command("plan")
@click.argument("scene", required=False)
@click.option(
    "--engine", help="closed, event, rtl or cosim; default: the scene's own, or the cheapest that can."
)
@click.option("--auto", "chosen", is_flag=True, help="As if the scene said [effects] auto = {}.")
@click.option("--costs", is_flag=True, help="Measure the costs instead and print them beside the table's.")
def plan_command(scene: str | None, engine: str | None, chosen: bool, costs: bool) -> int:
    """What a scene's plan simulates and leaves out, with bounds and costs; nothing is run."""
    from dermis import plan as planning
    from dermis import scene as scenes

    if costs:
        table = ENGINE_COST_NS | {name: effect.cost_ns for name, effect in EFFECTS.items()}
        for name, value in measure_costs().items():
            click.echo(f"{name:24} {value:10.0f} ns measured {table[name]:10.0f} ns in the table")
        return 0
    if scene is None:
        raise InputError("command line", "SCENE", "nothing", "a scene, or --costs")
    world = scenes.load(scenes.find(scene))
    if chosen and world.table.effects.auto is None:
        world = with_auto(world)
    made = planning.make(world, engine)
    engines.check(made)
    print_plan(made)
    return 0
