# SPDX-License-Identifier: Apache-2.0
"""From a scene to what is simulated: frames, records of network and converter, effects with their reasons."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dermis import effects, scene
from dermis.array import Network
from dermis.design import Design
from dermis.errors import InputError
from dermis.scene import Scene
from dermis.sensor import Sensor, SensorState, age, make_sensor
from dermis.stimulus import Surroundings, make_frames
from dermis.vfc import Converter
from dermis.views import Views

if TYPE_CHECKING:
    from dermis.accuracy.choice import Chosen

Floats = NDArray[np.float64]

ENGINES = ("closed", "event", "rtl", "cosim")


class EffectState(NamedTuple):
    """Whether an effect is simulated, and why; what it could do at most (LSB) and costs (ns a conversion)."""

    name: str
    on: bool
    reason: str
    bound_lsb: float | None = None
    cost_ns: float | None = None


@dataclass(frozen=True)
class Timing:
    """Clocks of one row slot: preset for settle_clocks, then count for gate_clocks.

    Through the first break_clocks of the settle clocks no row is driven. A frame begins settled where row 0 is
    driven, break_clocks into its first slot.
    """

    f_clk_hz: float
    slot_clocks: int
    settle_clocks: int
    gate_clocks: int
    code_max: int
    rows: int
    # A one decided at clock n pulls its packet out between clocks n + delay and n + delay + 1: the second
    # flip-flop.
    charge_delay_clocks: float = 1.0
    break_clocks: int = 0

    @property
    def slot_s(self) -> float:
        """Length of a row slot in seconds."""
        return self.slot_clocks / self.f_clk_hz

    @property
    def frame_s(self) -> float:
        """Length of a frame in seconds."""
        return self.rows * self.slot_s


@cache
def _turns(f_ripple_hz: float, t_frame_s: float, f_clk_hz: float) -> tuple[int, int, int]:
    """Turns a frame and a clock, and one turn, in a common unit."""
    frequency, frame, clock = (Fraction(repr(float(v))) for v in (f_ripple_hz, t_frame_s, f_clk_hz))
    per_frame, per_clock = frequency * frame, frequency / clock
    whole = math.lcm(per_frame.denominator, per_clock.denominator)
    return int(per_frame * whole), int(per_clock * whole), whole


@dataclass(frozen=True)
class Drive:
    """What changes in time: one frame of resistances after the other, each read in t_frame_s seconds.

    The bias is v_bias (1 + ripple sin(2 pi f_ripple t + phase_ripple)), t from the first clock of frame 0. With
    `motion` a conductance runs straight from one frame to the next; without, it holds for a frame.
    """

    t_frame_s: float
    ripple: float = 0.0
    f_ripple_hz: float = 0.0
    phase_ripple_rad: float = 0.0
    motion: bool = False

    def turns(self, frame: int, clocks: int, f_clk_hz: float) -> float:
        """Part of a turn, 0..1, in which the ripple stands `clocks` clocks into a frame, without its own phase.

        In integers, of the decimals that were written: however long a run is, its last frame is as exact as its first.
        """
        per_frame, per_clock, whole = _turns(self.f_ripple_hz, self.t_frame_s, f_clk_hz)
        return (frame * per_frame + clocks * per_clock) % whole / whole

    def active_fields(self) -> frozenset[str]:
        """Names of the fields that make something change inside a frame."""
        return frozenset(n for n in ("ripple", "motion") if getattr(self, n))


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything an engine, a deck or a report needs; engines are known here by name only.

    Attributes
    ----------
    scene : Scene
        The resolved scene.
    topology : str
        One of design.TOPOLOGIES.
    timing : Timing
    resistance_ohm : ndarray
        [frames, rows, cols], 0..inf.
    force_n : ndarray or None
        [frames, rows, cols] in newtons; None where a stimulus has none.
    sensor : Sensor
        The law that ties the two as long as no effect of the sensor is on.
    converter : Converter
    drive : Drive
    effects : tuple of EffectState
        Every effect there is, on or off, with the reason.
    engine, seed : str, int
    views : Views
        View of every SPICE block, for engine cosim.
    margin_lsb : ndarray or float
        [cols] how far the chip's decisions may lie from those simulated here, in packets (docs/auto.md).
    unsure_lsb : ndarray or float
        [rows, cols] packets a gate below which a cell that reads full scale may read less in the chip, by the margin.
    left_out_lsb : float
        What of that the plan leaves out may come to in a code, largest of all (docs/auto.md).
    moved_lsb : ndarray or float
        [cols] packets by which the levels of all decisions are moved, for certified codes alone: what the columns of
        the direct interface do to each other stays as it is.
    surrounding : dict
        Fields of Network other than the taxels and the bias.
    first_frame : int
        Number of frame 0 in the whole run: a part of a plan keeps its place in time and its random numbers.
    next_resistance_ohm : ndarray or None
        [rows, cols] of the frame behind the last one, which it moves to; None where it holds.
    """

    scene: Scene
    topology: str
    timing: Timing
    resistance_ohm: Floats
    force_n: Floats | None
    sensor: Sensor
    converter: Converter
    drive: Drive
    effects: tuple[EffectState, ...]
    engine: str
    seed: int
    views: Views
    surrounding: dict[str, Any]
    first_frame: int = 0
    next_resistance_ohm: Floats | None = None
    margin_lsb: Floats | float = 0.0
    unsure_lsb: Floats | float = 0.0
    left_out_lsb: float = 0.0
    accuracy: Chosen | None = None
    moved_lsb: Floats | float = 0.0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.resistance_ohm.shape[0]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.resistance_ohm.shape[1]

    @property
    def cols(self) -> int:
        """Number of columns."""
        return self.resistance_ohm.shape[2]

    @property
    def v_bias_v(self) -> float:
        """Bias of the driven row in volt."""
        return self.scene.table.interface.v_bias_v

    def conductance_s(self, frames: slice | int = slice(None)) -> Floats:
        """Taxel conductance of some frames in siemens; inf where the resistance is 0."""
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(1.0, self.resistance_ohm[frames])

    def next_conductance_s(self, frames: slice = slice(None)) -> Floats:
        """Conductance of the frame behind each of some frames in siemens; the last frame of a run holds."""
        last = self.resistance_ohm[-1] if self.next_resistance_ohm is None else self.next_resistance_ohm
        first, stop, _ = frames.indices(self.frames)
        behind = self.resistance_ohm[first + 1 : stop + 1]
        if stop == self.frames:
            behind = np.concatenate([behind, last[None]])
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(1.0, behind)

    def part(self, first: int, stop: int) -> Plan:
        """Frames first..stop-1 as a plan of their own, which gives the codes they have in the whole one."""
        if not 0 <= first < stop <= self.frames:
            raise ValueError(f"frames {first}..{stop} of {self.frames}")
        return replace(
            self,
            resistance_ohm=self.resistance_ohm[first:stop],
            force_n=None if self.force_n is None else self.force_n[first:stop],
            first_frame=self.first_frame + first,
            next_resistance_ohm=self.next_resistance_ohm
            if stop == self.frames
            else self.resistance_ohm[stop],
        )

    def fullest_frame(self) -> int:
        """The frame with the most conductance; a short counts as much as 1 ohm."""
        return int(np.argmax(np.minimum(self.conductance_s(), 1.0).sum(axis=(1, 2))))

    def network(self, frame: int) -> Network:
        """The network of one frame."""
        return Network(self.conductance_s(frame), self.v_bias_v, **self.surrounding)

    def networks(self) -> Iterator[Network]:
        """The network of every frame."""
        return (self.network(frame) for frame in range(self.frames))

    def duty_ideal(self) -> Floats:
        """x = V_b / (k i0 R) without any effect, [frames, rows, cols]."""
        with np.errstate(over="ignore"):
            return self.v_bias_v * self.conductance_s() / (self.converter.k * self.converter.i0_a)

    def force_of_duty(self, x: Floats) -> Floats:
        """Force in newtons whose ideal duty is x (last axis: columns)."""
        return self.sensor.force_n(self.ohm_of_duty(x))

    def ohm_of_duty(self, x: Floats) -> Floats:
        """Resistance in ohm whose ideal duty is x (last axis: columns); 0 gives inf."""
        with np.errstate(divide="ignore", over="ignore"):
            return self.v_bias_v / (self.converter.k * self.converter.i0_a) / (np.asarray(x) + 0.0)

    def active_fields(self) -> frozenset[str]:
        """Names of the record fields that are away from the ideal."""
        return self._active

    @functools.cached_property
    def _active(self) -> frozenset[str]:
        return self.network(0).active_fields() | self.converter.active_fields() | self.drive.active_fields()

    def effects_of_field(self, field: str) -> tuple[str, ...]:
        """Names of the effects that set a record field (for an engine that must refuse it)."""
        return tuple(
            name
            for name, parameters in self.on.items()
            for part in [effects.EFFECTS[name].contribute(parameters, self.setting())]
            if field in part.network or field in part.converter or field in part.drive
        )

    def resolved_toml(self, directory: Path | None = None) -> str:
        """The scene with every default, and with the engine of this plan; see Scene.to_toml."""
        # An accuracy or a time will choose it again.
        update = {} if self.accuracy else {"engine": self.engine}
        run = self.scene.table.run.model_copy(update=update)
        table = self.scene.table.model_copy(update={"run": run})
        return Scene(self.scene.path, table, self.scene.effects, self.scene.design).to_toml(directory)

    @property
    def on(self) -> dict[str, Any]:
        """Parameters of every effect that is simulated."""
        return {e.name: self.scene.effects[e.name] for e in self.effects if e.on}

    def setting(self) -> effects.Setting:
        """What effects may look at in this scene."""
        return _setting(self.scene)


def load(scene_path: str | Path, engine: str | None = None, design: Design | None = None) -> Plan:
    """Read a scene and plan it.

    Parameters
    ----------
    scene_path : path
        The TOML file.
    engine : str, optional
        Overrides run.engine of the scene.
    design : Design, optional
        Other than models/design.toml.

    Raises
    ------
    InputError
        Anything wrong with the scene or the files it names.
    """
    return make(scene.load(scene_path, design), engine)


def make(world: Scene, engine: str | None = None, auto: effects.AutoTable | None = None) -> Plan:
    """Plan a resolved scene: everything it names, or what `auto` keeps of all it considers.

    Where neither `engine` nor the scene names one it is the cheapest that can do what is kept. With `auto` the plan
    leaves out what fits its budget of the effects that the scene names; so does run.accuracy_lsb or run.time_s.
    """
    from dermis import auto as chooser
    from dermis import engines

    if auto is None and (world.table.run.accuracy_lsb is not None or world.table.run.time_s is not None):
        from dermis.accuracy import choice

        if engine is not None:
            allowed = "none beside run.accuracy_lsb or run.time_s, which choose it"
            raise InputError("command line", "engine", engine, allowed)
        made, chosen = choice.choose(world)
        return replace(made, accuracy=chosen)
    auto = world.table.effects.auto if auto is None else auto
    engine = world.table.run.engine if engine is None else engine
    everything = whole(world, engine)
    if auto is None:
        if engine is None:
            everything = replace(everything, engine=engines.cheapest(everything) or everything.engine)
        return replace(everything, margin_lsb=chooser.random_margin(everything))
    choice = chooser.choose(everything, auto, engine)
    kept = effects.gather({name: world.effects[name] for name in choice.on}, _setting(world))
    states = []
    for state in everything.effects:
        effect, bound = effects.EFFECTS[state.name], choice.bound_lsb.get(state.name)
        if bound is None:
            if everything.topology not in effect.topologies:
                why = f"topology {everything.topology} has none"
            elif getattr(world.table.effects, state.name) is False:
                why = "switched off"
            elif world.table.effects.auto is None:
                why = "not named"
            elif effect.considered:
                why = "no default for this topology"
            else:
                why = "not named, and not considered unless it is"
            states.append(state._replace(reason=why))
        else:
            why = choice.why[state.name]
            states.append(EffectState(state.name, state.name in choice.on, why, bound, effect.cost_ns))
    return replace(
        everything,
        converter=_converter(world, kept.converter),
        drive=Drive(t_frame_s=everything.drive.t_frame_s, **kept.drive),
        surrounding=dict(kept.network),
        effects=tuple(states),
        engine=choice.engine,
        margin_lsb=choice.margin_lsb,
        unsure_lsb=choice.unsure_lsb,
        left_out_lsb=choice.left_out_lsb,
    )


def _converter(world: Scene, fields: Mapping[str, Any]) -> Converter:
    interface, cols = world.table.interface, world.table.array.cols
    direct = interface.topology == "direct"
    return Converter(
        k=np.full(cols, 1.0 if direct else float(interface.k)),
        i0_a=np.full(cols, interface.i0_a * (interface.k if direct else 1)),
        c_int_f=np.full(cols, interface.c_int_f * (interface.k if direct else 1)),
        f_clk_hz=world.design.converter.f_clk_hz,
        v_sign=1.0 if interface.topology == "conveyor_mirror_inverted" else -1.0,
        **fields,
    )


def whole(world: Scene, engine: str | None) -> Plan:
    """Plan a scene with every effect it has; engine closed where none is named, whatever it can."""
    table, design = world.table, world.design
    engine = "closed" if engine is None else engine
    if engine not in ENGINES:
        raise InputError("command line", "engine", engine, "one of " + ", ".join(ENGINES))
    rows, cols, interface = table.array.rows, table.array.cols, table.interface
    timing = Timing(
        f_clk_hz=design.converter.f_clk_hz,
        slot_clocks=design.timing.slot_clocks,
        settle_clocks=design.timing.settle_clocks,
        gate_clocks=design.timing.gate_clocks,
        code_max=design.timing.code_max,
        rows=rows,
        break_clocks=design.timing.break_clocks,
    )
    contribution = effects.gather(world.effects, _setting(world))
    sensor = make_sensor(table.sensor)
    unit_ohm = interface.v_bias_v / (interface.k * interface.i0_a)

    def ohm_of_code(code: Floats) -> Floats:
        with np.errstate(divide="ignore"):
            return unit_ohm * timing.gate_clocks / (code + 0.0)

    about = Surroundings(world.path, rows, cols, sensor, ohm_of_code, timing.frame_s)
    made = make_frames(table.stimulus, about)
    state = SensorState(**contribution.sensor)
    resistance_ohm = age(
        sensor,
        made.resistance_ohm,
        made.t_frame_s,
        state,
        design.sensor.creep_start_s,
        _setting(world).rng,
    )
    for array in (resistance_ohm, made.force_n):
        if array is not None:
            array.flags.writeable = False
    return Plan(
        scene=world,
        topology=interface.topology,
        timing=timing,
        resistance_ohm=resistance_ohm,
        force_n=made.force_n,
        sensor=sensor,
        converter=_converter(world, contribution.converter),
        drive=Drive(t_frame_s=made.t_frame_s, **contribution.drive),
        effects=tuple(
            EffectState(
                name, name in world.effects, "named in the scene" if name in world.effects else "not named"
            )
            for name in effects.EFFECTS
        ),
        engine=engine,
        seed=table.run.seed,
        views=Views.of(table.run.views),
        surrounding=dict(contribution.network),
    )


def _setting(world: Scene) -> effects.Setting:
    table = world.table

    def rng(name: str) -> np.random.Generator:
        word = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        return np.random.default_rng([table.run.seed, word])

    return effects.Setting.of(table, world.design, rng)
