# SPDX-License-Identifier: Apache-2.0
"""The plan of a simulation: frames, the records Network, Converter and Drive, and effects with reasons."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dermis import effects, fields
from dermis.array.network import Network
from dermis.converter.vfc import Converter
from dermis.errors import InputError
from dermis.ndarrays import Floats
from dermis.scene.front_end import FrontEnd
from dermis.scene.scene import Scene
from dermis.scene.sensor import Sensor
from dermis.scene.views import Views
from dermis.timing import Timing as Timing

ENGINES = ("closed", "event", "rtl", "cosim")


class EffectState(NamedTuple):
    """Decision on an effect: simulated or not, with the reason."""

    name: str
    on: bool
    reason: str


@cache
def _turns(f_ripple_hz: float, t_frame_s: float, f_clk_hz: float) -> tuple[int, int, int]:
    """Turns a frame and a clock, and one turn, in a common unit."""
    frequency, frame, clock = (Fraction(repr(float(v))) for v in (f_ripple_hz, t_frame_s, f_clk_hz))
    per_frame, per_clock = frequency * frame, frequency / clock
    whole = math.lcm(per_frame.denominator, per_clock.denominator)
    return int(per_frame * whole), int(per_clock * whole), whole


@dataclass(frozen=True)
class Drive:
    """Changes in time: frames of resistances follow each other, each read in t_frame_s seconds.

    The bias is v_bias (1 + ripple sin(2 pi f_ripple t + phase_ripple)), t from the first clock of
    frame 0. With `motion` a conductance runs straight from one frame to the next; without, it holds
    for a frame.
    """

    t_frame_s: float
    ripple: float = 0.0
    f_ripple_hz: float = 0.0
    phase_ripple_rad: float = 0.0
    motion: bool = False

    def turns(self, frame: int, clocks: int, f_clk_hz: float) -> float:
        """Return the phase of the ripple, 0..1 of a turn, `clocks` clocks into a frame, without its own phase.

        In integers, of the decimals that were written: the last frame of any run is as exact as its first.
        """
        return float(self.turns_at([frame], [clocks], f_clk_hz)[0, 0])

    def turns_at(self, frames: Iterable[int], clocks: Iterable[int], f_clk_hz: float) -> Floats:
        """`turns` of every frame at every one of `clocks`, [frames, clocks]."""
        per_frame, per_clock, whole = _turns(self.f_ripple_hz, self.t_frame_s, f_clk_hz)
        begins = [frame * per_frame % whole for frame in frames]
        within = [clock * per_clock % whole for clock in clocks]
        # Integers up to 2^53 and their quotients are exact in doubles.
        kind = np.int64 if whole < 1 << 52 else object
        sums = np.array(begins, dtype=kind)[:, None] + np.array(within, dtype=kind)
        return (sums % whole / whole).astype(float)

    def active_fields(self) -> frozenset[str]:
        """Return the names of the fields that change within a frame."""
        return fields.active(self, _DRIVE_GIVEN)


# Fields of Drive that have no effect by themselves.
_DRIVE_GIVEN = frozenset({"t_frame_s", "f_ripple_hz", "phase_ripple_rad"})


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything an engine, a deck or a report needs; engines are known here by name only."""

    scene: Scene  # resolved
    topology: str  # one of design.TOPOLOGIES
    timing: Timing
    resistance_ohm: Floats  # [frames, rows, cols], 0..inf
    force_n: Floats | None  # [frames, rows, cols] in newtons; None in a worker, whose engine reads none
    sensor: Sensor  # the law that ties the two as long as no effect of the sensor is on
    converter: Converter
    drive: Drive
    engine: str
    seed: int
    views: Views  # of every SPICE block, for engine cosim
    surrounding: dict[str, Any]  # fields of Network other than the taxels and the bias
    # Number of frame 0 in the whole run: a part of a plan keeps its place in time and its random numbers.
    first_frame: int = 0
    next_resistance_ohm: Floats | None = None  # [rows, cols] after the last frame, None if that one holds
    filtered: bool = False  # engine event walks open cells alone (docs/auto.md)
    auto: effects.AutoTable | None = None  # budget of the filter; None without [effects] auto
    front_end: FrontEnd | None = None  # the board in place of the chip; no engine can do it

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
        """Return the conductance in siemens of the frame after each of some frames; the last frame holds."""
        last = self.resistance_ohm[-1] if self.next_resistance_ohm is None else self.next_resistance_ohm
        first, stop, _ = frames.indices(self.frames)
        behind = self.resistance_ohm[first + 1 : stop + 1]
        if stop == self.frames:
            behind = np.concatenate([behind, last[None]])
        with np.errstate(divide="ignore", over="ignore"):
            return np.divide(1.0, behind)

    def part(self, first: int, stop: int) -> Plan:
        """Return frames first..stop-1 as a plan, which gives the same codes as the whole one."""
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

    def parts(self, taxels: int) -> list[slice]:
        """Return slices of whole frames with about so many taxels each, of one frame at least."""
        step = max(1, taxels // (self.rows * self.cols))
        return [slice(first, min(first + step, self.frames)) for first in range(0, self.frames, step)]

    def fullest_frame(self) -> int:
        """The frame with the most conductance; a short counts as much as 1 ohm."""
        return int(np.argmax(np.minimum(self.conductance_s(), 1.0).sum(axis=(1, 2))))

    def most_changing_frame(self) -> int:
        """The frame whose conductance changes most until the next one; a short counts as much as 1 ohm."""
        now, then = (np.minimum(g, 1.0) for g in (self.conductance_s(), self.next_conductance_s()))
        return int(np.argmax(np.abs(then - now).sum(axis=(1, 2))))

    def busiest(self, frames: int) -> Plan:
        """Return at most `frames` consecutive frames as a plan, around the one with the most conductance."""
        if frames >= self.frames:
            return self
        first = min(max(0, self.fullest_frame() - frames // 2), self.frames - frames)
        return self.part(first, first + frames)

    def network(self, frame: int) -> Network:
        """The network of one frame."""
        if frame == 0:
            return self._first_network
        return Network(self.conductance_s(frame), self.v_bias_v, **self.surrounding)

    @functools.cached_property
    def _first_network(self) -> Network:
        return Network(self.conductance_s(0), self.v_bias_v, **self.surrounding)

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
        """Names of the record fields that differ from the ideal."""
        return self._active

    @functools.cached_property
    def _active(self) -> frozenset[str]:
        board = frozenset({"front_end"} if self.front_end is not None else ())
        records = self.network(0), self.converter, self.drive
        return board.union(*(record.active_fields() for record in records))

    def effects_of_field(self, field: str) -> tuple[str, ...]:
        """Names of the effects that set a record field (for an engine that must refuse it)."""
        return tuple(name for name in self.on if field in effects.EFFECTS[name].fields())

    def gate_shares(self) -> Floats:
        """Begin, end, middle, first and third quarter of the gate of each row in parts of the time to the next frame.

        [5, rows], up to 1.
        """
        timing = self.timing
        slot = np.arange(self.rows) * timing.slot_clocks + timing.settle_clocks
        clocks = self.drive.t_frame_s * timing.f_clk_hz
        # The last gate may end with the frame: a rounding of its length there would leave a part of a short over, or
        # less than nothing.
        if abs(clocks - round(clocks)) <= 1e-9 * clocks:
            clocks = float(round(clocks))
        at = np.array([0.0, 1.0, 0.5, 0.25, 0.75])[:, np.newaxis] * timing.gate_clocks + slot
        return np.minimum(at / clocks, 1.0)

    def unsure(self, effect: str, beside: Iterable[str], what: str, most: float, found: float) -> InputError:
        """Return the refusal of an effect that with others leaves codes uncertain by more than `most` LSB."""
        allowed = f"{what} is certain to {most:g} LSB (here {found:.2g}); use engine cosim"
        return InputError(
            self.scene.path, f"effects.{effect}", f"on together with {', '.join(beside)}", allowed
        )

    def resolved_toml(self, directory: Path | None = None) -> str:
        """The scene with every default, and with the engine of this plan; see Scene.to_toml."""
        run = self.scene.table.run.model_copy(update={"engine": self.engine})
        table = self.scene.table.model_copy(update={"run": run})
        return Scene(self.scene.path, table, self.scene.effects, self.scene.design).to_toml(directory)

    @property
    def budget_lsb(self) -> float:
        """Error in LSB that decides a cell without a walk."""
        return 0.0 if self.auto is None else self.auto.budget_lsb

    @property
    def on(self) -> dict[str, Any]:
        """Parameters of every effect that is simulated."""
        return self.scene.effects

    @property
    def effects(self) -> tuple[EffectState, ...]:
        """Every effect there is, on or off, with the reason."""
        return tuple(EffectState(name, name in self.on, self._reason(name)) for name in effects.EFFECTS)

    def _reason(self, name: str) -> str:
        table, effect = self.scene.table, effects.EFFECTS[name]
        if name in self.on:
            return "named in the scene" if self.auto is None else "auto, with every effect that has defaults"
        if self.auto is None:
            return "not named"
        if self.topology not in effect.topologies:
            return f"topology {self.topology} has none"
        if getattr(table.effects, name) is False:
            return "switched off"
        considered = table.effects.auto is None or effect.considered
        return "not named" if considered else "not named, and auto adds none that changes the scene"


def random_of(seed: int) -> Callable[[str], np.random.Generator]:
    """Return the function that gives an effect's own generator by its name."""

    def rng(name: str) -> np.random.Generator:
        word = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        return np.random.default_rng([seed, word])

    return rng


def setting_of(world: Scene) -> effects.Setting:
    return effects.Setting.of(world.table, world.design, random_of(world.table.run.seed))
