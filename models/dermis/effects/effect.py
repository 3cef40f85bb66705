# SPDX-License-Identifier: Apache-2.0
"""One non-ideality of a scene: its parameters, the record fields that they become, its bound and its words."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, create_model

from dermis import bounds
from dermis.scene.design import TOPOLOGIES, Design
from dermis.scene.schema import Strict, entry

MIRRORED = tuple(t for t in TOPOLOGIES if t != "direct")


@dataclass(frozen=True)
class Setting:
    """The part of a scene that an effect may read besides its own parameters."""

    cols: int
    topology: str
    c_int_f: float  # of the integrator, k times larger where nothing divides the current
    design: Design
    rng: Callable[[str], np.random.Generator]  # by effect: one more moves no other effect's numbers

    @classmethod
    def of(cls, table: Any, design: Design, rng: Callable[[str], np.random.Generator]) -> Setting:
        """The setting of a scene's resolved tables."""
        interface = table.interface
        c_int_f = interface.c_int_f * (interface.k if interface.topology == "direct" else 1)
        return cls(table.array.cols, interface.topology, c_int_f, design, rng)


class Contribution(NamedTuple):
    """Record fields with their values, by record."""

    network: dict[str, Any]
    converter: dict[str, Any]
    drive: dict[str, Any]
    sensor: dict[str, Any]


RECORDS = Contribution._fields


class Parameter(NamedTuple):
    """A parameter of an effect."""

    meaning: str  # words for docs/scenes.md and errors
    example: float  # a value that moves codes, alone (with `needs`) and among the examples of all effects
    range: tuple[float, float]  # magnitudes between which random scenes draw, evenly in powers of ten
    allowed: str  # words, where type and limits do not say it
    default: float | None  # None for a value of `Effect.design`, or one that must be given
    kind: Any  # with its limits
    limits: dict[str, float]  # ge, gt, le, lt of pydantic


def number(
    meaning: str,
    example: float,
    range: tuple[float, float],
    allowed: str = "",
    *,
    default: float | None = None,
    kind: Any = float,
    **limits: float,
) -> Parameter:
    """Return a parameter that is one number."""
    return Parameter(meaning, example, range, allowed, default, Annotated[kind, Field(**limits)], limits)


def column(
    meaning: str, example: float, range: tuple[float, float], default: float | None = None, **limits: float
) -> Parameter:
    """Return a parameter that is a number or a list of them, one a column."""
    low = f" >= {limits['ge']:g}" if "ge" in limits else f" > {limits['gt']:g}" if limits else ""
    allowed = f"a finite number{low}, or a list of them, one a column"
    one = Annotated[float, Field(allow_inf_nan=False, **limits)]
    kind = one | Annotated[list[one], Field(min_length=1)]
    return Parameter(meaning, example, range, allowed, default, kind, limits)


positive = functools.partial(number, gt=0)
not_negative = functools.partial(number, ge=0)
small = functools.partial(number, allowed="a finite number 0..0.1", ge=0, le=0.1)
"""Standard deviation of a factor 1 + sigma n, which stays positive at six sigma."""
within_clock = functools.partial(number, allowed="a finite number >= 0, below one clock", ge=0)
share = functools.partial(number, allowed="a finite number from 0 to below 1", ge=0, lt=1)
celsius = functools.partial(number, allowed="a finite number above -273.15", gt=-273.15)

Set = Mapping[str, str | Callable[[Any, Setting], Any]]
"""Record field -> parameter, or a function of parameters and setting."""


@dataclass(frozen=True)
class Effect:
    """One non-ideality."""

    name: str  # the word used in TOML, Python, Verilog and SPICE
    meaning: str  # in one line
    parameters: Mapping[str, Parameter]
    # Parameter -> key of models/design.toml for its default, or a pair of keys, the second one for topology direct
    # (None: it must be given there).
    design: Mapping[str, str | tuple[str, str | None]] = field(default_factory=dict)
    # Fields of each record that it sets. The values of several effects in one field add up.
    network: Set = field(default_factory=dict)
    converter: Set = field(default_factory=dict)
    drive: Set = field(default_factory=dict)
    sensor: Set = field(default_factory=dict)
    bound: bounds.Bounding = bounds.unknown  # how far it moves decisions that engine closed made without it
    topologies: tuple[str, ...] = TOPOLOGIES  # where it exists
    random: bool = False  # it draws random numbers during conversion; its bound then has a stated confidence
    considered: bool = True  # by auto, unnamed; False for effects that change the scene itself
    # Effects and parameters that must be on as well, or this one moves no code.
    needs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Parameters of the example in topology direct that take the place of those of `parameters`.
    direct: Mapping[str, Any] = field(default_factory=dict)
    # Parameter -> the one whose given value comes before the default of the design.
    follows: Mapping[str, str] = field(default_factory=dict)
    # Pairs of a parameter with an impossible value and what is allowed.
    wrong: Callable[[Any, Setting], list[tuple[str, str]]] = lambda parameters, setting: []
    # The parameters as a table of a scene, made of them; None marks a default that comes from `defaults`.
    table: type[Strict] = field(default=None, repr=False)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.table is None:
            object.__setattr__(self, "table", self._table())

    def _table(self) -> type[Strict]:
        fields = {}
        for key, p in self.parameters.items():
            kind = p.kind | None if p.default is None else p.kind
            fields[key] = (kind, entry(p.default, p.meaning, p.allowed, default_from=self._default_from(key)))
        made = create_model(f"_{self.name}", __base__=Strict, __module__=__name__, **fields)
        # pickle finds a class by its name in its module.
        globals()[made.__name__] = made
        return made

    def _default_from(self, key: str) -> str:
        path = self.design.get(key, "")
        if isinstance(path, tuple):
            path = f"{path[0]} (topology direct: {path[1] or 'must be given'})"
        other = self.follows.get(key)
        return f"{other}, or {path} when {other} is left out too" if other else path

    def defaults(self, design: Design, topology: str) -> dict[str, Any]:
        """Return the defaults of a design; a parameter without one must be given."""
        found = {}
        for key, path in self.design.items():
            if isinstance(path, tuple):
                path = path[topology == "direct"]
            if path:
                found[key] = operator.attrgetter(path)(design)
        return found

    def fields(self) -> list[str]:
        """Return the names of all record fields that it sets."""
        return [name for record in RECORDS for name in getattr(self, record)]

    def contribute(self, parameters: Any, setting: Setting) -> Contribution:
        """Return the record fields that it sets."""
        return Contribution(
            *(
                {
                    name: getattr(parameters, of) if isinstance(of, str) else of(parameters, setting)
                    for name, of in getattr(self, record).items()
                }
                for record in RECORDS
            )
        )

    def example(self, topology: str = "conveyor_mirror") -> dict[str, Any]:
        """Return parameters that move codes."""
        found = {key: p.example for key, p in self.parameters.items()}
        return found | dict(self.direct) if topology == "direct" else found

    def range(self) -> dict[str, tuple[float, float]]:
        """Return the smallest and the largest magnitude of each parameter in random scenes."""
        return {key: p.range for key, p in self.parameters.items()}

    def signs(self, parameter: str) -> tuple[int, ...]:
        """Return the signs that a parameter may have."""
        limits = self.parameters[parameter].limits
        low = limits.get("ge", limits.get("gt", -math.inf))
        high = limits.get("le", limits.get("lt", math.inf))
        return (-1,) * (low < 0) + (1,) * (high > 0)

    def draw(self, rng: np.random.Generator, decades: float = 0.0) -> dict[str, float]:
        """Draw parameters evenly in powers of ten within `range`, or up to `decades` beyond both ends."""
        found = {}
        for name, (low, high) in self.range().items():
            ratio = high / low * 100.0**decades
            found[name] = float(rng.choice(self.signs(name)) * low * 10.0**-decades * ratio ** rng.random())
        return found


exact_effect = functools.partial(Effect, bound=bounds.honoured)
"""An effect that engine closed takes as it is."""


def below_one_clock(key: str) -> Callable[[Any, Setting], list[tuple[str, str]]]:
    """Return the check of a time that must be below one clock."""

    def wrong(p: Any, setting: Setting) -> list[tuple[str, str]]:
        clock_s = 1.0 / setting.design.converter.f_clk_hz
        return [(key, f"below one clock ({clock_s:g} s)")] if getattr(p, key) >= clock_s else []

    return wrong


def too_warm(p: Any, _: Setting) -> list[tuple[str, str]]:
    """Refuse a temperature at which a factor 1 + tc_per_k delta_k is not above 0."""
    if p.tc_per_k * p.delta_k > -1:
        return []
    side = "above" if p.tc_per_k > 0 else "below"
    return [("delta_k", f"{side} {-1 / p.tc_per_k:g} K, where nothing is left")]
