# SPDX-License-Identifier: Apache-2.0
"""Random worlds: every stimulus, interface and effect, from 1 x 1 up, from defaults to the ends of what is allowed."""

from __future__ import annotations

import functools
import typing
from pathlib import Path
from typing import Any

import numpy as np

from dermis import effects
from dermis.converter.vfc import W_PRESET
from dermis.scene.design import TOPOLOGIES, Design
from dermis.scene.design import load as load_design
from tb.programs import auto_check
from tb.programs.campaign.world import Data, World, lines_of

Rng = np.random.Generator

# Where a default is scaled, so many decades below and above it.
_DECADES = (-2.0, 1.5)
# What extreme parameters are taken from; what a key does not allow is refused, which is an answer too.
_EXTREMES = (0.0, 1e-30, 1e-21, 1e-12, 1e-6, 1.0, 1e3, 1e9, 1e15, 1e21, 1e30)
# Parameters without a default anywhere, and those whose scale is not that of their default.
_USUAL = {
    "column_input.r_ohm": (0.1, 50.0),
    "column_offset.v_v": (1e-5, 5e-3),
    "mirror_ratio.spread": (1e-4, 0.05),
    "offset_current.i_a": (1e-12, 1e-6),
    "integrator_range.v_max_v": (0.55, 1.6),
    "integrator_range.v_min_v": (0.55, 1.6),
    "comparator_hysteresis.v_v": (1e-5, 0.4),
    "comparator_delay.t_s": (1e-11, 1.5e-7),
    "clock_jitter.t_s": (1e-13, 3e-8),
    "metastability.t_aperture_s": (1e-14, 1e-7),
    "preset_error.v_v": (1e-6, 0.45),
    "range_switch.v_overdrive_v": (0.05, 0.5),
    "supply_ripple.frequency_hz": (1.0, 1e7),
    "supply_ripple.phase_deg": (1e-3, 720.0),
    "thermal_noise.temperature_c": (1.0, 125.0),
    "ktc_noise.temperature_c": (1.0, 125.0),
    "sensor_hysteresis.relative": (1e-3, 0.9),
    "sensor_spread.relative": (1e-3, 0.5),
}
_SIGNED = ("v_v", "i_a", "ratio_error", "packet_error", "delta_k", "tc_per_k", "phase_deg", "temperature_c")
_UNSIGNED = ("comparator_hysteresis", "comparator_noise")
# Few effects alone show what others hide: so many scenes have one to four of them, drawn further than the rest.
_FEW = 1 / 6
# There capacitances go so many decades further up, and what bends a current or makes it late.
_FURTHER = {"line_capacitance": 4.5, "range_switch": 1.5, "mirror_lag": 1.5}
_DUTIES = ((0.4, 1e4), (0.45, 0.7), (1e-3, 1.0))
# Clocks that a gate has beyond the two a one takes: none, an odd one, the 511 and 512 of other machines, many.
_BEYOND = (0, 1, 2, 3, 90, 290)


def number(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform, low and high above 0."""
    return float(low * (high / low) ** rng.random())


def world(seed: int, index: int, engines: str, scratch: Path) -> World:
    """World number `index` of a campaign with this seed, the same whatever runs before it."""
    few = np.random.default_rng([seed, index, 1])
    if few.random() < _FEW:
        return _world_of_few(few, engines)
    rng = np.random.default_rng([seed, index])
    analog = _spice(engines)
    rows, cols = _size(rng, engines)
    design = _design(rng) if not analog else {}
    topology = str(rng.choice(TOPOLOGIES))
    interface = _interface(rng, topology, design)
    scene: Data = {"array": {"rows": rows, "cols": cols}}
    if rng.random() < 0.2:
        scene["sensor"] = {"law": "power"}
    stimulus, files = _stimulus(rng, rows, cols, interface, design, engines, scratch)
    scene |= {"stimulus": stimulus, "interface": interface}
    on = _effects(rng, topology, cols, engines)
    if engines == "auto,cosim" or (engines == "closed,event" and rng.random() < 0.15):
        budgets = [0.0, 0.05, 0.25, 0.5, 2.0]
        budget = float(rng.choice(budgets[engines == "auto,cosim" :]))  # none leaves nothing out to compare
        on = {"auto": {"budget_lsb": budget, "sigma": 6.0}} | on
    if engines == "auto,cosim":  # what is not named auto takes at its default: no deck draws random numbers
        on |= {effect.name: False for effect in effects.EFFECTS.values() if effect.random}
    scene["effects"] = on
    scene["run"] = {"seed": int(rng.integers(1 << 32))}
    return World(scene, design, files)


def _world_of_few(rng: Rng, engines: str) -> World:
    """One to four effects, all others off beside auto; duties about full scale and far above it."""
    rows, cols = _size(rng, engines) if engines == "rtl" else (int(n) for n in rng.integers(1, 4, 2))
    design = _design(rng, longest_break=300) if not _spice(engines) else {}
    topology = str(rng.choice(TOPOLOGIES))
    interface = _interface(rng, topology, design)
    frames = 1 if _spice(engines) else int(rng.integers(1, 4))
    low, high = _DUTIES[int(rng.choice(len(_DUTIES), p=[0.5, 0.2, 0.3]))]
    duty = low * (high / low) ** rng.random((frames, rows, cols))
    units = {
        name: values
        for name, values in _units(topology)
        if not effects.EFFECTS[name].random and not name.startswith("sensor_") and name != "motion"
    }
    chosen = rng.choice(sorted(units), size=int(rng.integers(1, 5)), replace=False)
    on: Data = {}
    if engines in ("auto,cosim", "closed,event"):
        on["auto"] = {"budget_lsb": float(rng.choice([0.05, 0.25, 0.5, 1.0, 2.0])), "sigma": 6.0}
        on |= {effect.name: False for effect in effects.EFFECTS.values() if effect.considered}
    for name in chosen:
        given = {key: _value(rng, name, key, default) for key, default in units[name]}
        for key in given if name in _FURTHER else ():
            given[key] *= 10.0 ** rng.uniform(0, _FURTHER[name])
        if name == "supply_ripple":
            given["relative"] = number(rng, 1e-2, 1.0)
            fastest = 3.0 * _f_clk_hz(design)
            given["frequency_hz"] = number(rng, 1.0 if rng.random() < 0.5 else 1e-2 * fastest, fastest)
        on[str(name)] = given
    if rng.random() < 0.2:
        on["motion"] = True
    scene = {
        "array": {"rows": rows, "cols": cols},
        "stimulus": {"kind": "resistance", "file": "taxels.csv"},
        "interface": interface,
        "effects": on,
        "run": {"seed": int(rng.integers(1 << 32))},
    }
    return World(scene, design, {"taxels.csv": lines_of(_unit_ohm(interface) / duty)})


def _spice(engines: str) -> bool:
    return engines.endswith("cosim")


def _size(rng: Rng, engines: str) -> tuple[int, int]:
    kind = rng.random()
    if _spice(engines):
        return int(rng.integers(1, 4)), int(rng.integers(1, 4))
    if engines == "rtl":
        # A build serves one size: few sizes, so that a campaign is not spent compiling.
        sizes = [(1, 1), (1, 5), (4, 1), (2, 3), (3, 3), (5, 4), (8, 8)]
        return sizes[int(rng.integers(len(sizes)))]
    if kind < 0.55:
        return int(rng.integers(1, 5)), int(rng.integers(1, 5))
    if kind < 0.95:
        return int(rng.integers(1, 10)), int(rng.integers(1, 10))
    if kind < 0.995:
        return int(rng.integers(1, 21)), int(rng.integers(1, 21))
    return [(1, 256), (256, 1), (64, 3), (3, 64), (32, 32)][int(rng.integers(5))]


def _design(rng: Rng, longest_break: int = 5) -> dict[str, dict[str, Any]]:
    if rng.random() < 0.6:
        return {}
    base = load_design()
    bits = int(rng.choice([1, 2, 3, 5, 7, 8, 8, 8, 9, 10]))
    gate = 2 * (2**bits - 1) + int(rng.choice(_BEYOND))
    pause = int(rng.integers(1, 6))
    if longest_break > 5 and rng.random() < 0.5:
        pause = int(number(rng, 5, longest_break))
    settle = pause + int(rng.choice([2, 3, 10, 115]))
    f_clk_hz = base.converter.f_clk_hz * float(rng.choice([0.01, 0.2, 1.0, 1.0, 4.0]))
    slot = gate + settle
    return {
        # The frame is that of the design's own array: a slot has so many clocks, whatever the scene's size is.
        "timing": {"gate_clocks": gate, "code_bits": bits, "break_clocks": pause,
                   "frame_s": slot * base.array.rows / f_clk_hz},
        "converter": {"f_clk_hz": f_clk_hz, "c_int_f": base.converter.i0_a / f_clk_hz, "t_edge_s": 1e-3 / f_clk_hz},
        "comparator": {"t_delay_s": 0.02 / f_clk_hz, "t_aperture_s": 1e-5 / f_clk_hz},
    }  # fmt: skip


def _f_clk_hz(design: dict[str, dict[str, Any]]) -> float:
    return design.get("converter", {}).get("f_clk_hz", load_design().converter.f_clk_hz)


def _interface(rng: Rng, topology: str, design: dict[str, dict[str, Any]]) -> Data:
    base = load_design()
    found: Data = {"topology": topology}
    if rng.random() < 0.4:
        found["k"] = int(rng.choice(base.interface.k_options))
    if rng.random() < 0.3:
        found["v_bias_v"] = number(rng, 1e-3, 10.0)
    if rng.random() < 0.2:
        found["i0_a"] = number(rng, 1e-9, 1e-2)
        # A packet of 0.1 to 1.4 V.
        found["c_int_f"] = found["i0_a"] / _f_clk_hz(design) / number(rng, 0.1, 1.4)
    return found


def _unit_ohm(interface: Data) -> float:
    """R x of a taxel: the resistance of a duty of 1."""
    base = load_design()
    return interface.get("v_bias_v", base.interface.v_bias_v) / (
        interface.get("k", base.interface.k) * interface.get("i0_a", base.converter.i0_a)
    )


@functools.cache
def _units(topology: str) -> tuple[tuple[str, tuple[tuple[str, float | None], ...]], ...]:
    design: Design = load_design()
    found = []
    for effect in effects.EFFECTS.values():
        if topology in effect.topologies:
            values = effect.table().model_dump() | effect.defaults(design, topology)
            found.append((effect.name, tuple(values.items())))
    return tuple(found)


def _effects(rng: Rng, topology: str, cols: int, engines: str) -> Data:
    often = float(rng.choice([0.0, 0.05, 0.15, 0.4, 0.8]))
    strength = str(rng.choice(["default", "scaled", "scaled", "extreme"]))
    if engines != "closed,event" and strength == "extreme":
        strength = "scaled"
    on: Data = {}
    for name, values in _units(topology):
        effect = effects.EFFECTS[name]
        if rng.random() >= often * (0.4 if effect.random else 1.0):
            continue
        if engines != "closed,event" and effect.random:
            continue
        if strength == "default" and None not in dict(values).values():
            on[name] = True
            continue
        given = {}
        for key, default in values:
            value = _value(rng, name, key, default)
            if strength == "extreme" and rng.random() < 0.3:
                value = float(rng.choice(_EXTREMES))
                if key in _SIGNED and rng.random() < 0.5:
                    value = -value
                if key == "v_min_v":
                    value = -value
            if _listed(name, key) and rng.random() < 0.3:
                value = [float(value * rng.uniform(-1, 1)) if key in _SIGNED else value for _ in range(cols)]
            given[key] = value
        on[name] = given
    return on


def _listed(name: str, key: str) -> bool:
    annotation = effects.EFFECTS[name].table.model_fields[key].annotation
    return any("list" in str(a) for a in typing.get_args(annotation))


def _value(rng: Rng, name: str, key: str, default: float | None) -> float:
    usual = _USUAL.get(f"{name}.{key}")
    if usual is not None:
        value = number(rng, *usual)
    else:
        value = float(default or 1.0) * 10.0 ** rng.uniform(*_DECADES)
    if key == "spread" or (name, key) == ("flicker_noise", "relative"):
        value = min(value, 0.1)
    if key == "v_min_v":
        return -value
    negative = key in _SIGNED and name not in _UNSIGNED and rng.random() < 0.5
    return -value if negative else value


def _stimulus(
    rng: Rng,
    rows: int,
    cols: int,
    interface: Data,
    design: dict[str, dict[str, Any]],
    engines: str,
    scratch: Path,
) -> tuple[Data, dict[str, list[list[float]]]]:
    base = load_design()
    frames = 1 if _spice(engines) else int(rng.choice([1, 1, 2, 3, 5]))
    kind = rng.random()
    if kind < 0.35 and engines == "closed,event":
        named = str(rng.choice(["indenter", "slip", "tapping", "ramp", "several", "uniform"]))
        return auto_check.stimulus(rng, named, rows, cols, max(frames, 2), scratch), {}
    shape = (frames, rows, cols)
    unit = _unit_ohm(interface)
    gate = design.get("timing", {}).get("gate_clocks", base.timing.gate_clocks)
    way = rng.random()
    if way < 0.45:
        ohm = unit / (0.55 * 200.0 ** -rng.random(shape))
    elif way < 0.6:  # on a threshold between two codes, or an ulp beside it
        ohm = unit * gate / (rng.integers(0, 257, shape) - W_PRESET)
        ohm = ohm * (1.0 + rng.integers(-2, 3, shape) * 2.0**-52)
    elif way < 0.75:  # x = p/q
        q = rng.integers(1, 13, shape)
        ohm = unit * q / np.maximum(rng.integers(0, 13, shape), 1)
    elif way < 0.9 or engines != "closed,event":
        ohm = unit * 10.0 ** rng.uniform(-1, 5, shape)
    else:
        ohm = 10.0 ** rng.uniform(-3, 15, shape)
    if rng.random() < 0.3 and engines == "closed,event":
        ohm = np.where(
            rng.random(shape) < rng.choice([0.05, 0.3, 0.9]), rng.choice([0.0, np.inf], shape), ohm
        )
    return {"kind": "resistance", "file": "taxels.csv"}, {"taxels.csv": lines_of(ohm)}
