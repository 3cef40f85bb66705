# SPDX-License-Identifier: Apache-2.0
"""The scene, read strictly from TOML, with all defaults."""

import operator
import os
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from dermis.effects import EFFECTS, AutoTable, EffectsTable, Setting, check_together, resolve_effects
from dermis.errors import InputError
from dermis.places import ROOT
from dermis.scene import design as designs
from dermis.scene import extracted, front_end, schema, sensor, stimulus, views
from dermis.scene.design import Design, Topology
from dermis.scene.front_end import EFFECT_FIELDS, FrontEndTable
from dermis.scene.schema import Strict, entry, read_toml
from dermis.scene.sensor import SensorTable
from dermis.scene.stimulus import StimulusTable
from dermis.scene.views import View, Views

SCENES = ROOT / "models" / "scenes"
"""The scenes that come with the package."""

_REMOVED = dict.fromkeys(
    ("run.accuracy_lsb", "run.time_s"), "removed; use [effects] auto = {}, or auto = { budget_lsb = ... }"
) | {"effects.auto.sigma": "removed with the certified codes that it was for; leave it out"}


class ArrayTable(Strict):
    """[array]: the size of the sheet."""

    rows: int | None = entry(None, "Rows, read one after the other", default_from="array.rows", ge=1, le=256)
    cols: int | None = entry(None, "Columns, one converter each", default_from="array.cols", ge=1, le=256)


class InterfaceTable(Strict):
    """[interface]: the circuit between a column and its converter."""

    topology: Topology | None = entry(
        None,
        "direct: Fig. 3; conveyor_mirror: Fig. 5a; conveyor_mirror_inverted: Fig. 5b; "
        "multi_output_conveyor: Fig. 6",
        default_from="interface.topology",
    )
    k: int | None = entry(
        None,
        "The column current is divided by k (direct: the packet is k times larger instead)",
        "one of interface.k_options in models/design.toml",
        default_from="interface.k",
        ge=1,
    )
    k_column: list[int] | None = entry(
        None,
        "k of each column, as RANGE_COLUMN of the chip sets it; forces and codes of a stimulus stay those of k",
        "a list of interface.k_options, one a column; not for direct",
    )
    v_bias_v: float | None = entry(
        None, "Bias of the driven row, in V", default_from="interface.v_bias_v", gt=0, le=10
    )
    i0_a: float | None = entry(
        None, "Reference current of a packet, before k, in A", default_from="converter.i0_a", ge=1e-9, le=1
    )
    c_int_f: float | None = entry(
        None, "Integration capacitor, before k, in F", default_from="converter.c_int_f", ge=1e-15, le=1e-6
    )


class RunTable(Strict):
    """[run]: engine, seed and views."""

    engine: Literal["closed", "event", "rtl", "cosim"] | None = entry(
        None,
        "closed: array solve and count formula; event: clock by clock; rtl: the real Verilog with real-number models; "
        "cosim: the real Verilog with ngspice",
        default_from="the cheapest that can do the scene",
    )
    seed: int = entry(0, "Random seed", "a whole number 0..2^32 - 1", ge=0, le=2**32 - 1)
    views: View | Views = entry(
        "behavioural",
        "View of the SPICE blocks in cosim: models, or transistors (docs/views.md)",
        'a table, or one of "behavioural", "sky130"',
    )


class SceneTable(Strict):
    """A whole scene."""

    title: Annotated[str, Field(max_length=10_000)] = entry(
        "", "Title for reports", "text of at most 10000 characters"
    )
    array: ArrayTable = entry(ArrayTable(), "Size of the sheet")
    sensor: SensorTable = entry(SensorTable(), "Law between force and resistance")
    stimulus: StimulusTable = entry(..., "Forces or resistances of the sheet", "a table with a kind")
    interface: InterfaceTable = entry(InterfaceTable(), "Circuit between column and converter")
    effects: EffectsTable = entry(  # type: ignore[valid-type]
        EffectsTable(), "Departures from the ideal; an effect that is not named is off", "a table of effects"
    )
    run: RunTable = entry(RunTable(), "Engine, seed and views")
    front_end: FrontEndTable | None = entry(
        None, "A board of another kind that reads the sheet instead of the chip", "a table with a circuit"
    )


@dataclass(frozen=True)
class Scene:
    """A scene with every default filled in."""

    path: Path  # its file; file names in it are relative to this
    table: SceneTable  # resolved; its `effects` are as written, except that their effects replace `extracted`
    effects: dict[str, Strict]  # name -> parameters, all of them, of the effects that are on
    design: Design  # source of the defaults

    @property
    def title(self) -> str:
        """Title for reports. It may hold any text, so it must never reach a deck or a shell."""
        return self.table.title

    def to_toml(self, directory: Path | None = None) -> str:
        """Return the scene as TOML with every default; it loads to an identical plan.

        File names become relative to the directory in which the text will be saved, else absolute.
        """
        data = self.table.model_dump()
        data["effects"] = {name: parameters.model_dump() for name, parameters in self.effects.items()}
        if (auto := self.table.effects.auto) is not None:
            off = {name: False for name in EFFECTS if getattr(self.table.effects, name) is False}
            data["effects"] = {"auto": auto.model_dump()} | data["effects"] | off
        data["stimulus"] = {"kind": data["stimulus"].pop("kind")} | data["stimulus"]
        if "file" in data["stimulus"]:
            file = (self.path.parent / data["stimulus"]["file"]).resolve()
            name = file if directory is None else os.path.relpath(file, directory.resolve())
            data["stimulus"]["file"] = str(name)
        return schema.write_toml(data)


def find(name: str) -> Path:
    """Return the path of a scene, given by path or by name; raise InputError if no scene has this name."""
    known = names()
    if name in known and os.path.isfile(name):
        allowed = f"./{name} for the file of that name here; in another directory it is the stored scene"
        raise InputError("command line", "SCENE", name, allowed)
    if name.endswith(".toml") or "/" in name or (name not in known and os.path.exists(name)):
        return Path(name)
    if name not in known:
        allowed = f"a path to a .toml file, or one of {', '.join(known)}"
        raise InputError("command line", "SCENE", name, allowed)
    return SCENES / f"{name}.toml"


def names() -> list[str]:
    """Return the names of the scenes that come with the package."""
    return sorted(path.stem for path in SCENES.glob("*.toml"))


def tables_of(scene: Any, caller: str, allowed: str) -> tuple[Path, dict[str, Any]]:
    """Return the tables of a scene by path, name or dict, and the path that errors name; nothing is an empty scene.

    Raises InputError if it is something else, with `caller` and `allowed` in the line, or cannot be read.
    """
    if isinstance(scene, str | os.PathLike):
        path = find(os.fspath(scene))
        return path, read_toml(path)
    if scene is None or isinstance(scene, Mapping):
        return Path(caller), schema.plain(scene or {})
    raise InputError(caller, "scene", f"a {type(scene).__name__}", allowed)


def changed(
    data: dict[str, Any],
    path: Path,
    tables: Mapping[str, Any] | None,
    run: Mapping[str, Any],
    effects: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return tables with a caller's changes; InputError for a key that holds None."""
    for table in (tables or {}, {"run": run}, {"effects": effects or {}}):
        data = schema.merged(data, schema.plain(table))
    if none := schema.empty(data):
        raise InputError(path, none, "None", "a value; leave the key out for its default")
    return data


def load(path: str | Path, design: Design | None = None) -> Scene:
    """Read a scene and fill in its defaults, or raise InputError: one line "FILE: KEY = VALUE: what is allowed"."""
    path = Path(path)
    return from_data(read_toml(path), path, design)


def from_data(data: dict[str, Any], path: Path, design: Design | None = None) -> Scene:
    """Make a scene from TOML data; `path` is named in errors, and file names are relative to it."""
    return resolve(schema.validate(SceneTable, data, path, refused=_REMOVED), path, design)


def with_effects(world: Scene, table: Any, engine: str | None) -> Scene:
    """Return the scene with another [effects] table and another engine (None: no engine named)."""
    return _again(world, {"engine": engine}, effects=table)


def with_views(world: Scene, views: str) -> Scene:
    """Return the scene with every SPICE block in this view, at default conditions."""
    own = world.table.run.views
    if not isinstance(own, str) and own != Views.of(own.default):
        allowed = "none, because the scene has a table run.views for its blocks"
        raise InputError("command line", "--views", views, allowed)
    return _again(world, {"views": views})


def _again(world: Scene, run: dict[str, Any], **tables: Any) -> Scene:
    """Return the scene with some keys of [run] and some tables changed."""
    tables["run"] = world.table.run.model_copy(update=run)
    return resolve(world.table.model_copy(update=tables), world.path, world.design)


def _wrong(
    interface: InterfaceTable, cols: int, is_extracted: bool, design: Design
) -> Iterator[tuple[str, str]]:
    """Yield keys of a resolved [interface] that the chip does not have, and what is allowed."""
    options, k_column = design.interface.k_options, interface.k_column
    listed = "one of " + ", ".join(map(str, options))
    if interface.k not in options:
        yield "k", listed
    if k_column is not None:
        if interface.topology == "direct":
            yield "k_column", "left out with topology direct, as no mirror divides the current: interface.k"
        if is_extracted:
            yield "k_column", "left out with effects.extracted, whose effects are of one k"
        if len(k_column) != cols:
            yield "k_column", f"a list of {cols}, one a column"
        if not set(k_column) <= set(options):
            yield "k_column", f"each {listed}"
    charge_c = interface.i0_a / design.converter.f_clk_hz
    if charge_c / interface.c_int_f > design.swing_v:
        least_f = charge_c / design.swing_v
        yield "c_int_f", f"at least {least_f:.3g} F, so that a packet stays within {design.swing_v:g} V"


def resolve(table: SceneTable, path: Path, design: Design | None = None) -> Scene:
    """Fill in the defaults of the design, and check keys against each other."""
    design = design or designs.load()
    array, interface, named = _filled(table.array, design), _filled(table.interface, design), table.effects
    board, cols = table.front_end, array.cols
    schema.refuse(_wrong(interface, cols, named.extracted is not None, design), interface, path, "interface.")
    if board is not None:
        said = "left out with [front_end], which reads the sheet instead of the chip"
        given = ((key, said) for key in sorted(table.interface.model_fields_set))
        schema.refuse(given, table.interface, path, "interface.")
        board = front_end.resolve(board, cols, path)
        interface = interface.model_copy(update={"v_bias_v": board.supply_v})
    if named.extracted is not None:
        named = extracted.expanded(named, interface, design, path)
    t_frame_s = array.rows * (design.timing.slot_clocks / design.converter.f_clk_hz)
    parts = {
        "array": array,
        "sensor": sensor.resolve(table.sensor, design.sensor, path),
        "interface": interface,
        "stimulus": stimulus.resolve(table.stimulus, array.rows, cols, t_frame_s),
        "run": table.run.model_copy(
            update={"views": views.resolve(table.run.views, cols, interface.topology, path)}
        ),
        "effects": named,
        "front_end": board,
    }
    resolved = table.model_copy(update=parts)
    on = resolve_effects(named, Setting.of(resolved, design, _no_rng), path)
    packet_v = interface.i0_a / design.converter.f_clk_hz / interface.c_int_f
    check_together(on, interface.topology, packet_v, path)
    # Those that set a field that a board does not have.
    chip = [n for n in on if (e := EFFECTS[n]).converter or e.drive or set(e.network) - EFFECT_FIELDS]
    chip += ["auto"] * (named.auto is not None)
    if board is not None and chip:
        allowed = "off with [front_end]: its keys say what the board does; lateral, trace and sensor_* are the sheet's"
        raise InputError(path, f"effects.{chip[0]}", "on", allowed)
    return Scene(path, resolved, on, design)


def _no_rng(name: str) -> Any:
    raise AssertionError(f"{name}: no random number is drawn while a scene is read")


def _filled(table: Any, design: Design) -> Any:
    """Fill in the keys whose default is a value of the design."""
    fields = type(table).model_fields.items()
    paths = {key: path for key, field in fields if (path := field.json_schema_extra["default_from"])}
    return schema.filled(table, {key: operator.attrgetter(path)(design) for key, path in paths.items()})


def schema_table() -> str:
    """Return the keys of a scene as Markdown tables, one for each section, for docs/scenes.md."""
    lines, section = [], None
    for key, default, allowed, meaning in schema_rows():
        head, _, name = key.rpartition(".")
        if head != section:
            section = head
            lines += ["", f"### `[{head}]`" if head else "### Top level", ""]
            lines += ["| key | default | allowed | meaning |", "|---|---|---|---|"]
        cells = (f"`{name}`", default, allowed, meaning)
        lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return "\n".join(lines).strip("\n") + "\n"


def scenes_table() -> str:
    """Return the table of the package's scenes, for docs/scenes.md."""
    lines = ["| scene | title | stimulus | effects that are on |", "|---|---|---|---|"]
    for path in sorted(SCENES.glob("*.toml")):
        made = load(path)
        stimulus = made.table.stimulus
        kinds = [part.kind for part in getattr(stimulus, "parts", [])] or [stimulus.kind]
        on = ", ".join(f"`{name}`" for name in made.effects)
        lines.append(f"| `{path.stem}` | {made.title} | {', '.join(dict.fromkeys(kinds))} | {on} |")
    return "\n".join(lines) + "\n"


def schema_rows(prefix: str = "", model: type[BaseModel] = SceneTable) -> Iterator[tuple[str, str, str, str]]:
    """Yield (key, default, allowed values, meaning) of every key of a scene, or of one of its tables."""
    inner: dict[str, type[BaseModel]] = {}
    # Keys of the table itself come before keys of its base classes.
    own = [n for c in model.__mro__ if issubclass(c, BaseModel) for n in c.__annotations__]
    for name in sorted(model.model_fields, key=own.index):
        field = model.model_fields[name]
        # Tables of a list are documented where they are alternatives of another key.
        members = [] if typing.get_origin(field.annotation) is list else schema.models_of(field.annotation)
        for member in members:
            tag = ""
            if len(members) > 1:
                tag = f" kind = {typing.get_args(member.model_fields['kind'].annotation)[0]}"
            inner[prefix + name + tag] = member
        parts = typing.get_args(field.annotation)
        other = bool in parts or any(typing.get_origin(part) is Literal for part in parts)
        if not members or other:
            yield prefix + name, _default(field), schema.allowed_of(field), field.description or ""
    for name, member in inner.items():
        yield from schema_rows(name + ".", member)


def _default(field: Any) -> str:
    if field.is_required():
        return "must be given"
    if source := field.json_schema_extra["default_from"]:
        return str(source)
    if field.default is None:
        return "off" if bool in typing.get_args(field.annotation) else "left out"
    return f'"{field.default}"' if isinstance(field.default, str) else str(field.default)


def with_auto(world: Scene) -> Scene:
    """Return the same scene as if it said [effects] auto = {}."""
    return with_effects(world, world.table.effects.model_copy(update={"auto": AutoTable()}), None)
