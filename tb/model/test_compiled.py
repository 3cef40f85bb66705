# SPDX-License-Identifier: Apache-2.0
"""Every compiled function that Python calls is listed with what checks its arguments; none reads foreign memory."""

import ast
import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dermis
from dermis.array.array import Network, column_currents
from dermis.converter import noise, vfc
from dermis.decode import crosstalk, law
from dermis.decode.calibration import Calibration
from dermis.decode.decoder import Forces
from dermis.decode.memory import MemoryLaw, SheetMemory
from dermis.errors import InputError
from dermis.scene import sensor
from dermis.skin import Skin

PACKAGE = Path(dermis.__file__).parent
PLAN = "arrays of a plan"
"""The caller makes every array itself from a plan, whose scene and stimulus are validated."""
GUARDS = {
    "array.star_mesh": dict.fromkeys(
        ("add_between", "chain", "down", "ladder", "miss", "sum_of_others", "up", "worst_code"),
        "column_currents",
    ),
    "converter.course": {"charges": PLAN},
    "converter.decide": {"decide_cells": PLAN, "remembered": PLAN},
    "converter.noise": {"_keys": "chosen_keys", "_normals": PLAN},
    "converter.vfc_loops": {"count_all": "count"},
    "converter.walk_loops": dict.fromkeys(("grid_step", "modes_of", "plain", "walk"), PLAN),
    "decode.crosstalk": {"_solve_frames": "crosstalk.solve", "known_voltages": "crosstalk.solve"},
    "decode.decoder": {"_decode_frames": "Skin.decode", "currents_of": "Decoder.conductances"},
    "decode.law": {"_forces": "Curve"},
    "decode.memory": {"apply_frame": "SheetMemory", "undo_frame": "SheetMemory"},
    "scene.sensor_loops": {"advance_creep": "creep_decades"},
    "skin": {"_read_frames": "Skin.read", "_taxels": "Skin.read"},
    # C: lockstep.c and clock_loop.c.
    "lockstep": {
        "lockstep_advance": "itself, in lockstep.c",
        "lockstep_open": "Deck",
        **dict.fromkeys(("loop_net", "loop_output"), "ClockLoop"),
        "loop_clock": "numbers and text alone",
    },
}


def compiled(tree: ast.Module) -> set[ast.FunctionDef]:
    """Functions of a module that numba compiles, by a decorator or by a name for one."""
    makers = {"njit", "jit"}
    for node in tree.body:
        if isinstance(node, ast.Assign) and "jit(" in ast.unparse(node.value):
            makers |= {target.id for target in node.targets if isinstance(target, ast.Name)}

    def marked(mark: ast.expr) -> bool:
        return ast.unparse(mark.func if isinstance(mark, ast.Call) else mark).rpartition(".")[2] in makers

    return {f for f in tree.body if isinstance(f, ast.FunctionDef) and any(map(marked, f.decorator_list))}


def python_calls(tree: ast.AST, loops: set[ast.FunctionDef]) -> Iterator[str]:
    """Functions that code outside the compiled functions names, as it names them."""
    if tree in loops:
        return
    if isinstance(tree, ast.Name | ast.Attribute):
        yield ast.unparse(tree)
    for node in ast.iter_child_nodes(tree):
        yield from python_calls(node, loops)


def entries(package: Path) -> set[tuple[str, str]]:
    """Module and name of every compiled function that Python code of the package may call."""
    trees, found = {}, set()
    for path in package.rglob("*.py"):
        name = ".".join(path.relative_to(package).with_suffix("").parts)
        trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    loops = {name: compiled(tree) for name, tree in trees.items()}
    every = {f"{module}.{f.name}": (module, f.name) for module, functions in loops.items() for f in functions}
    for module, tree in trees.items():
        imported = {f.name: f"{module}.{f.name}" for f in loops[module]}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(package.name):
                inside = node.module.removeprefix(package.name).lstrip(".")
                imported |= {a.asname or a.name: f"{inside}.{a.name}".lstrip(".") for a in node.names}
        for name in python_calls(tree, loops[module]):
            first, dot, rest = name.partition(".")
            full = imported.get(first, first) + dot + rest
            found |= {every[full]} if full in every else set()
    return found


def test_every_compiled_entry_point_is_listed_with_its_guard(tmp_path: Path) -> None:
    listed = {(module, name) for module, names in GUARDS.items() for name in names if module != "lockstep"}
    assert entries(PACKAGE) == listed
    text = "".join(path.read_text(encoding="utf-8") for path in (PACKAGE / "lockstep").glob("*.py"))
    assert set(re.findall(r"\b_?lib\.(lo\w+)\((?!\))", text)) == GUARDS["lockstep"].keys()
    new = "_fast = numba.njit(cache=True)\n@_fast\ndef loop(x): ...\ndef use(x): loop(x)\n"
    (tmp_path / "new.py").write_text(new)
    assert entries(tmp_path) == {("new", "loop")}, "a new one is seen"


WORN = {"sensor_hysteresis": True, "sensor_creep": True, "row_driver": True}
SKIN = Skin(array={"rows": 2, "cols": 3}, effects=WORN)
KNOWN = SKIN.decoder.calibration
NETWORK = Network(np.ones((2, 3)), 0.5, 1.0, 1.0, 1.0)  # type: ignore[arg-type]
LAW = MemoryLaw.of_effects(0.1, 0.05, 1e-2)
ONES, BYTES = np.ones((4, 2, 3)), np.ones((4, 2, 3), np.uint8)
HALF = np.ones((4, 2, 6))[:, :, ::2]


def forces(**changed: Any) -> Forces:
    """Arrays to fill, one of them wrong."""
    return dataclasses.replace(Forces.empty((4, 2, 3)), **changed)


def stream(*arrays: Any) -> Any:
    """Undo with arrays of a wrong kind."""
    return SheetMemory(LAW, 6).undo(*arrays, 0.1)


BAD: dict[str, list[Callable[[], Any]]] = {
    "Skin.read": [
        lambda: SKIN.read(np.ones((4, 3, 2))),
        lambda: SKIN.read(ONES * np.nan),
        lambda: SKIN.read(ONES.astype(complex)),
        lambda: SKIN.read(np.ma.masked_equal(ONES, 1.0)),
        lambda: SKIN.read(ONES, out=np.ones((3, 2, 3), np.uint8)),
        lambda: SKIN.read(ONES, out=HALF),
        lambda: SKIN.read(ONES, np.ones(5)),
        lambda: SKIN.read(ONES, np.nan),
    ],
    "Skin.decode": [
        lambda: SKIN.decode(ONES),
        lambda: SKIN.decode(np.ma.masked_equal(BYTES, BYTES.flat[0])),
        lambda: SKIN.decode(BYTES[:, :, :2]),
        lambda: SKIN.decode(BYTES.astype(int) * 300),
        lambda: SKIN.decode(BYTES, out=forces(high_n=HALF)),
        lambda: SKIN.decode(BYTES, out=forces(flags=np.ones((4, 2, 3)))),
        lambda: SKIN.decode(BYTES, out=forces(low_n=np.ones((4, 2, 3), np.float32))),
        lambda: dataclasses.replace(KNOWN, step_a=np.array([1.0, np.nan, 1.0])),
        lambda: dataclasses.replace(KNOWN, factor=np.ones((3, 3))),
        lambda: dataclasses.replace(KNOWN, reference=((0, 5, 1.0),)),
        lambda: dataclasses.replace(KNOWN, own={(2, 0): KNOWN.curve}),
    ],
    "Decoder.conductances": [lambda: SKIN.decoder.conductances(BYTES[:, :, :2], NETWORK)],
    "crosstalk.solve": [
        lambda: crosstalk.solve(NETWORK, ONES[:, :1]),
        lambda: crosstalk.solve(NETWORK, ONES * np.inf),
        lambda: crosstalk.solve(NETWORK, ONES, ONES[:2]),
        lambda: crosstalk.solve(NETWORK, ONES, ONES * np.nan),
    ],
    "column_currents": [
        lambda: column_currents(NETWORK, ONES[:, :1]),
        lambda: column_currents(NETWORK, -ONES),
        lambda: column_currents(NETWORK, ONES * np.nan),
    ],
    "SheetMemory": [
        lambda: SheetMemory(LAW, 6).apply(np.ones(5), 0.1),
        lambda: SheetMemory(LAW, 6).apply(np.full(6, np.nan), 0.1),
        lambda: SheetMemory(LAW, 6).apply(np.ones(6), np.nan),
        lambda: stream(np.ones(6), np.ones(6), np.ones(5)),
        lambda: stream(np.ones(6), np.ones(12)[::2], np.ones(6)),
        lambda: stream(np.ones(6, np.float32), np.ones(6), np.ones(6)),
        lambda: MemoryLaw(np.ones(3), np.ones(2)),
        lambda: MemoryLaw(np.array([np.nan]), np.ones(1)),
    ],
    "Curve": [
        lambda: law.Curve("table", True, np.arange(3.0), np.ones((2, 4))),
        lambda: law.Curve("table", True, np.zeros(0), np.ones((0, 4))),
        lambda: law.Curve("linear", False, np.zeros(1), np.full((1, 4), np.nan)),
    ],
    "chosen_keys": [lambda: noise.chosen_keys(0, 0, (np.arange(3), np.arange(2), np.arange(3)))],
    "count": [
        lambda: vfc.count(np.ones((2, 3)), packet=np.ones(4)),
        lambda: vfc.count(np.ones(3), packet=-1.0),
    ],
    "creep_decades": [
        lambda: sensor.creep_decades(np.ones((3, 2), bool), -1.0, 1e-2),
        lambda: sensor.creep_decades(np.ones((3, 2), bool), np.nan, 1e-2),
    ],
}


def test_every_guard_has_cases() -> None:
    named = {guard for module, names in GUARDS.items() if module != "lockstep" for guard in names.values()}
    assert named - {PLAN} == set(BAD)


@pytest.mark.parametrize(("guard", "n"), [(guard, n) for guard in BAD for n in range(len(BAD[guard]))])
def test_a_guard_refuses(guard: str, n: int) -> None:
    with pytest.raises((ValueError, InputError)):
        BAD[guard][n]()


def test_no_number_stays_no_number() -> None:
    """A conductance that is not known is not 0 N."""
    curve = law.of_sensor(sensor.InverseSensor(7500.0))
    assert np.isnan(curve.force_n(np.nan))
    assert Calibration.of_plan(SKIN.plan).curve.force_n([0.0, 1e-3]).tolist() == [0.0, 7.5]
