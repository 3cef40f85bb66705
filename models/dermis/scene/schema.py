# SPDX-License-Identifier: Apache-2.0
"""Parts of a schema: strict models, documented keys, strict reading and writing of TOML."""

import json
import math
import operator
import os
import re
import stat
import tomllib
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from pydantic.fields import FieldInfo

from dermis.errors import InputError, quoted

# A scene is written by hand; a larger file was given by mistake.
SCENE_BYTES_MAX = 1 << 20


# Range of every quantity of the field; products and ratios of a few such numbers do not overflow.
SIZE_MIN, SIZE_MAX = 1e-30, 1e30
_SIZES = f"0 or a size from {SIZE_MIN:g} to {SIZE_MAX:g}"


class Strict(BaseModel):
    """A table; unknown keys, text for numbers, NaN, infinity and absurd sizes are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    @field_validator("*", mode="after")
    @classmethod
    def _of_a_size(cls, value: Any) -> Any:
        values = value if isinstance(value, list) else [value]
        for v in values:
            if type(v) in (int, float) and v not in (0, math.inf) and not SIZE_MIN <= abs(v) <= SIZE_MAX:
                raise ValueError(_SIZES)
        # 0.0 for -0.0: a resistance of -0.0 would be a conductance of -inf.
        values = [v + 0.0 if isinstance(v, float) else v for v in values]
        return values if isinstance(value, list) else values[0]


def entry(default: Any, meaning: str, allowed: str = "", *, default_from: str = "", **limits: Any) -> Any:
    """Declare one key of a scene.

    Parameters
    ----------
    default : `...` for a required key; None with `default_from` for a value of design.toml
    meaning : one line for the table in docs/scenes.md
    allowed : allowed values, for that table and for errors, where type and limits alone do not say it
    default_from : source of a default that is not a constant, such as "interface.k"
    limits : ge, gt, le, lt, min_length ... of pydantic
    """
    extra = {"allowed": allowed, "default_from": default_from}
    return Field(default, description=meaning, json_schema_extra=extra, **limits)


def filled(table: Any, defaults: Mapping[str, Any]) -> Any:
    """Return a table with values for those of its keys that have none."""
    missing = {key: value for key, value in defaults.items() if getattr(table, key) is None}
    return table.model_copy(update=missing)


def allowed_of(field: FieldInfo) -> str:
    """Return the allowed values of a key in words: as declared, or from its type and limits."""
    extra = field.json_schema_extra
    said = extra.get("allowed") if isinstance(extra, dict) else ""
    return str(said) if said else _in_words(field.annotation, field.metadata)


def _in_words(kind: Any, metadata: Sequence[Any]) -> str:
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _in_words(parts[0], (*metadata, *parts[1:]))
    if origin in (types.UnionType, typing.Union):
        return ", or ".join(_in_words(part, metadata) for part in parts if part is not type(None))
    if origin is typing.Literal:
        return "one of " * (len(parts) > 1) + ", ".join(f'"{word}"' for word in parts)
    if kind is int or kind is float:
        return _number_in_words(kind, metadata)
    if list in (origin, kind):
        sizes = {getattr(m, end) for m in metadata for end in ("min_length", "max_length") if hasattr(m, end)}
        return "a list" + (f" of {sizes.pop()}" if len(sizes) == 1 else "")
    return {bool: "true or false", str: "text"}.get(kind, "a table")


_LIMITS = {"ge": ">= ", "gt": "> ", "lt": "below ", "le": "at most "}


def _number_in_words(kind: type, metadata: Sequence[Any]) -> str:
    limits = [limit for item in metadata for limit in getattr(item, "metadata", [item])]
    given = {key: getattr(limit, key) for limit in limits for key in _LIMITS if hasattr(limit, key)}
    said = {key: re.sub(r"e([+-])0", r"e\1", f"{value:.12g}") for key, value in given.items()}
    infinite = any(getattr(limit, "allow_inf_nan", False) for limit in limits)
    head = "a whole number" if kind is int else "a number" if infinite else "a finite number"
    if said.keys() >= {"ge", "le"}:
        tail = f" {said['ge']}..{said['le']}" if kind is int else f" from {said['ge']} to {said['le']}"
    else:
        tail = ",".join(f" {_LIMITS[key]}{said[key]}" for key in _LIMITS if key in said)
    return head + tail + " (inf is legal)" * infinite


def read_bytes(path: Path, limit: int, told_by: tuple[Path | str, str, Any]) -> bytes:
    """Read a regular file of at most `limit` bytes, or raise InputError; `told_by` is the (file, key, value) in it."""
    file, key, value = *told_by[:2], quoted(told_by[2])
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            # Reading a pipe or a device could block.
            raise InputError(file, key, value, "a regular file")
        if status.st_size > limit:
            allowed = f"a file of at most {limit} bytes (this one has {status.st_size})"
            raise InputError(file, key, value, allowed)
        if not status.st_size:  # or of unknown size: reading /proc/kmsg, a regular file, never ends
            return b""
        with open(path, "rb") as stream:
            # Only the size seen above: reading `limit` bytes would allocate all of them.
            data = stream.read(status.st_size + 1)
    except OSError as error:
        raise InputError(file, key, value, f"a readable file ({error.strerror or error})") from None
    except ValueError as error:  # a NUL in the name
        raise InputError(file, key, value, f"a file name ({error})") from None
    if len(data) > status.st_size:
        allowed = f"a file that keeps its size of {status.st_size} bytes while it is read"
        raise InputError(file, key, value, allowed)
    return data


# tomllib takes time quadratic in the parts of a dotted key: 14 s for 20 000 parts. No table here is five deep.
KEY_PARTS_MAX = 32
_LONG_KEY = re.compile(
    rf"""(?<![A-Za-z0-9_-])(?>(?>[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){{{KEY_PARTS_MAX}}}"""
)


def read_toml(path: Path, name: Path | str | None = None) -> dict[str, Any]:
    """Read a TOML file strictly (duplicate keys are errors in TOML), or raise InputError, which calls it `name`."""
    file = path if name is None else name
    data = read_bytes(path, SCENE_BYTES_MAX, (file, "file", path.name))
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(file, f"byte {error.start}", data[error.start], "text in UTF-8") from None
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise InputError(file, f"line {line}", quoted(found[0]), f"keys of fewer than {KEY_PARTS_MAX} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        # An error at the end of the file has no number.
        lines, number = text.splitlines() or [""], re.search(r"line (\d+)", str(error))
        line = lines[min(int(number[1]), len(lines)) - 1 if number else -1]
        raise InputError(file, "TOML", line, f"valid TOML ({error})") from None
    except RecursionError:
        raise InputError(file, "TOML", "nested too deeply", "valid TOML of a few levels") from None
    except (ValueError, OverflowError) as error:  # impossible dates, integers of thousands of digits
        raise InputError(file, "TOML", "a value out of range", f"valid TOML ({error})") from None


def validate(
    model: type[BaseModel],
    data: Any,
    file: Path | str,
    prefix: str = "",
    refused: Mapping[str, str] | None = None,
) -> Any:
    """Build a model from data of a file; raise InputError for the first error.

    Errors name the file and, as `prefix`, the table in it that holds `data`; for unknown keys in `refused` they say
    what to do instead.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        found = error.errors(include_url=False)
    except RecursionError:
        raise InputError(file, prefix or "scene", "nested too deeply", "a few levels of tables") from None
    except OverflowError:
        start = (prefix,) if prefix else ()
        place, value = next(_too_large(data, start), ((prefix or "scene",), "an integer"))
        raise InputError(file, ".".join(place), value, _SIZES) from None
    # Report an unknown key first: it is often the misspelt form of a missing one.
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    # Among alternative types of one value, report the one that matched furthest.
    place = _place(data, first["loc"])
    inside = [e for e in found if _place(data, e["loc"])[: len(place)] == place]
    first = max(inside, key=lambda e: len(_place(data, e["loc"])))
    key, value, allowed = _complaint(model, data, first)
    key = ".".join(part for part in (prefix, key) if part) or "scene"
    if first["type"] == "extra_forbidden":
        allowed = (refused or {}).get(key, allowed)
    raise InputError(file, key, value, allowed)


def refuse(wrong: Iterable[tuple[str, str]], table: Any, file: Path | str, prefix: str = "") -> None:
    """Raise InputError for the first pair of a key, dotted in nested tables, and what is allowed; none is right."""
    for key, allowed in wrong:
        value = operator.attrgetter(key)(table)
        raise InputError(file, prefix + key, "nothing" if value is None else quoted(value), allowed)


def _too_large(data: Any, place: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], int]]:
    """Yield integers too large for a double, with their place."""
    if isinstance(data, int) and abs(data) >= 1 << 1023:
        yield place, data
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _too_large(value, (*place, str(key)))


def _path(data: Any, location: tuple[Any, ...]) -> Iterator[tuple[Any, bool, Any]]:
    """Yield each part of a location, whether it is in the data (tags of unions are not), and the value so far."""
    here = data
    for part in location:
        in_list = isinstance(here, list) and isinstance(part, int) and part < len(here)
        if there := in_list or (isinstance(here, dict) and part in here):
            here = here[part]
        yield part, there, here


def _place(data: Any, location: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the part of a location that exists in the data."""
    return tuple(part for part, there, _ in _path(data, location) if there)


def _complaint(model: type[BaseModel], data: Any, error: Any) -> tuple[str, Any, str]:
    """Return key, value and allowed values of an error of pydantic."""
    kind, names, allowed = error["type"], [], ""
    missing = kind == "missing"
    schema: Any = model
    steps = list(_path(data, error["loc"]))
    here = steps[-1][2] if steps else data
    for part, there, _ in steps:
        if not there and not (missing and part == error["loc"][-1]):  # the tag of an alternative
            schema = _alternative(schema, part)
            continue
        names.append(str(part))
        if isinstance(part, str):
            schema = models_of(schema)
            field = next((m.model_fields[part] for m in schema if part in m.model_fields), None)
            if field is not None:
                allowed, schema = allowed_of(field), field.annotation
    key = ".".join(names)
    if kind == "extra_forbidden":
        keys = sorted({k for m in models_of(schema) for k in m.model_fields})
        return key, quoted(here), "unknown key; known here: " + (", ".join(keys) or "none")
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        tag = str(error["ctx"]["discriminator"]).strip("'")
        fields = [m.model_fields[tag] for m in models_of(schema) if tag in m.model_fields]
        kinds = ", ".join(str(word) for field in fields for word in typing.get_args(field.annotation))
        shown = quoted(error["ctx"]["tag"]) if "tag" in error["ctx"] else "nothing"
        return f"{key}.{tag}", shown, f"one of {kinds}"
    if kind == "value_error":
        allowed = f"{allowed}; {_SIZES}"
    return key, "nothing" if missing else quoted(here), allowed or error["msg"]


def models_of(annotation: Any) -> list[type[BaseModel]]:
    """Return every model that an annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    parts = annotation if isinstance(annotation, list) else typing.get_args(annotation)
    return [m for a in parts for m in models_of(a)]


def _alternative(annotation: Any, tag: Any) -> Any:
    """Return the members of a tagged union with `tag`."""
    pairs = (
        (m, typing.get_args(f.annotation)) for m in models_of(annotation) for f in m.model_fields.values()
    )
    return [m for m, words in pairs if tag in words] or annotation  # only a Literal has words


def write_toml(tables: dict[str, Any]) -> str:
    """Write plain data (numbers, booleans, text, lists, tables) as TOML that loads to the same data.

    Keys are bare names of the schema; None is left out. Tables within tables are written inline.
    """
    lines = _toml_pairs({name: value for name, value in tables.items() if not isinstance(value, dict)})
    for name, table in tables.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *_toml_pairs(table)]
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml_pairs(table: dict[str, Any]) -> list[str]:
    return [f"{k} = {_toml_value(v)}" for k, v in table.items() if v is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, bool | str):  # TOML escapes as JSON does, and one more character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    if isinstance(value, dict):
        return f"{{ {', '.join(pairs)} }}" if (pairs := _toml_pairs(value)) else "{}"
    return repr(value)  # numbers


def merged(data: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables with the keys of `changes`; an effect, and a stimulus of another kind, is replaced whole."""
    made = dict(data)
    for name, value in changes.items():
        before = made.get(name)
        add = isinstance(before, dict) and isinstance(value, dict)
        if name == "stimulus" and add:
            add = value.get("kind", before.get("kind")) == before.get("kind")
        made[name] = before | value if add else value
    return made


def plain(value: Any) -> Any:
    """Convert to TOML types: numpy numbers, arrays, tuples and paths become numbers, lists and text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def empty(table: Mapping[str, Any]) -> str:
    """Return the dotted name of the first key that holds None; empty if there is none."""
    for key, value in table.items():
        if value is None:
            return key
        if isinstance(value, Mapping) and (below := empty(value)):
            return f"{key}.{below}"
    return ""
