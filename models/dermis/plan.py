# SPDX-License-Identifier: Apache-2.0
"""From a scene to a plan: frames, records of network and converter, effects with their reasons."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dermis import effects, engines
from dermis.converter.vfc import Converter
from dermis.errors import InputError
from dermis.ndarrays import Floats
from dermis.records import ENGINES, Drive, Plan, Timing, setting_of
from dermis.scene import scene
from dermis.scene.design import Design
from dermis.scene.front_end import FrontEnd
from dermis.scene.scene import Scene
from dermis.scene.sensor import SensorState, age, make_sensor
from dermis.scene.stimulus import Surroundings, make_frames
from dermis.scene.views import Views


def load(scene_path: str | Path, engine: str | None = None, design: Design | None = None) -> Plan:
    """Read a scene and plan it; an `engine` overrides run.engine, and a design models/design.toml.

    Raises InputError for anything wrong with the scene or the files it names.
    """
    return make(scene.load(scene_path, design), engine)


def make(world: Scene, engine: str | None = None) -> Plan:
    """Plan a resolved scene.

    Where neither `engine` nor the scene names an engine it is the cheapest that can do all of it.
    With `auto` every effect with defaults is on, and engine event walks only the cells that its
    bounds leave open.
    """
    auto = world.table.effects.auto
    engine = world.table.run.engine if engine is None else engine
    # Only cosim has transistors; what else the scene asks for does not change that.
    transistors = Views.of(world.table.run.views).in_transistors(world.table.interface.topology)
    usual = "cosim" if transistors else "closed" if auto is None else "event"
    made = whole(world, engine or usual, auto)
    if auto is None:
        return replace(made, engine=engine or engines.cheapest(made) or usual)
    if engine is None and not transistors and not engines.refused(made, "closed"):
        made = replace(made, engine="closed", filtered=False)
    return made


def _converter(world: Scene, fields: Mapping[str, Any]) -> Converter:
    interface, cols = world.table.interface, world.table.array.cols
    direct = interface.topology == "direct"
    return Converter(
        k=np.full(cols, 1.0 if direct else (interface.k_column or float(interface.k))),
        i0_a=np.full(cols, interface.i0_a * (interface.k if direct else 1)),
        c_int_f=np.full(cols, interface.c_int_f * (interface.k if direct else 1)),
        f_clk_hz=world.design.converter.f_clk_hz,
        v_sign=1.0 if interface.topology == "conveyor_mirror_inverted" else -1.0,
        **fields,
    )


def whole(world: Scene, engine: str, auto: effects.AutoTable | None = None) -> Plan:
    """Plan a scene with every effect it has for an engine, whatever that can do; with `auto` it is filtered."""
    table, design = world.table, world.design
    if engine not in ENGINES:
        raise InputError("command line", "engine", engine, "one of " + ", ".join(ENGINES))
    rows, cols, interface = table.array.rows, table.array.cols, table.interface
    t, f_clk_hz = design.timing, design.converter.f_clk_hz
    clocks = t.slot_clocks, t.settle_clocks, t.gate_clocks
    timing = Timing(f_clk_hz, *clocks, t.code_max, rows, break_clocks=t.break_clocks)
    contribution = effects.gather(world.effects, setting_of(world))
    sensor = make_sensor(table.sensor)
    unit_ohm = interface.v_bias_v / (interface.k * interface.i0_a)

    def ohm_of_code(code: Floats) -> Floats:
        with np.errstate(divide="ignore"):
            return unit_ohm * timing.gate_clocks / (code + 0.0)

    about = Surroundings(world.path, rows, cols, sensor, ohm_of_code, timing.frame_s, t.code_max)
    made = make_frames(table.stimulus, about)
    board = None if table.front_end is None else FrontEnd.of_table(table.front_end, cols)
    aging = SensorState(**contribution.sensor), design.sensor.creep_start_s, setting_of(world).rng
    resistance_ohm = age(sensor, made.resistance_ohm, made.t_frame_s, *aging)
    for array in (resistance_ohm, made.force_n):
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
        engine=engine,
        seed=table.run.seed,
        views=Views.of(table.run.views),
        surrounding=dict(contribution.network) | ({} if board is None else board.network),
        filtered=auto is not None and engine in ("event", "cosim"),
        auto=auto,
        front_end=board,
    )
