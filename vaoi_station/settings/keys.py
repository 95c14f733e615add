"""The keys of station.toml with type, unit, limits, default and documentation, all of them read from the model.

The documentation is the text below each attribute of the model, as in the source. A key is written as
docs/configuration.md writes it: `cameras[].width` in the tables of an array, `controller.lights.NAME.on_us` in tables
with names of their own.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from types import ModuleType
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from vaoi_station.config import StationConfig

Kind = Literal["text", "path", "number", "integer", "truth", "choice", "list", "map"]

UNITS = {
    "_px_per_mm": "px/mm",
    "_per_mm": "1/mm",
    "_mbit_s": "Mbit/s",
    "_mm_s": "mm/s",
    "_mb_s": "MB/s",
    "_mm": "mm",
    "_us": "µs",
    "_s": "s",
    "_px": "px",
    "_db": "dB",
    "_deg": "°",
    "_gb": "GB",
    "_bytes": "bytes",
    "_days": "days",
}
"""Units by the ends of names, the longest first where one ends with another."""


_LIMITLESS = 1e12


class Key(NamedTuple):
    """One key of station.toml. What does not apply is None."""

    key: str
    table: str
    """The table that has it, as a header: empty for the file's own level, `cameras[]` for each camera."""
    kind: Kind
    required: bool
    """Whether its table needs it."""
    default: Any
    unit: str
    choices: tuple[str, ...]
    limits: dict[str, float]
    """By `minimum`, `above`, `maximum`, `below`."""
    description: str
    optional_table: bool
    """Whether the whole table may be absent."""


@cache
def keys() -> tuple[Key, ...]:
    """Return all keys, in the order of the model."""
    schema = StationConfig.model_json_schema()
    return tuple(_walk(schema, schema, "", StationConfig, optional=False))


def _walk(schema: dict[str, Any], table: dict[str, Any], prefix: str, model: Any, *, optional: bool) -> Iterator[Key]:
    texts = documentation(model)
    later = []
    for name, field in table["properties"].items():
        inner, absent = _without_null(field)
        where = f"{prefix}.{name}" if prefix else name
        inside = _resolved(schema, inner)
        elements = _resolved(schema, inside.get("items", {})) if inside.get("type") == "array" else {}
        named = _resolved(schema, inside.get("additionalProperties") or {}) if inside.get("type") == "object" else {}
        if "properties" in inside:
            later.append((inside, where, absent))
        elif "properties" in elements:
            later.append((elements, f"{where}[]", True))
        elif "properties" in named:
            later.append((named, f"{where}.NAME", True))
        else:
            yield Key(
                where,
                prefix,
                _kind(inside),
                name in table.get("required", ()),
                field.get("default"),
                unit_of(name),
                _choices(inside),
                _limits(inside),
                texts.get(name, ""),
                optional,
            )
    for inside, where, absent in later:
        yield from _walk(schema, inside, where, _class(inside["title"]), optional=optional or absent)


def _without_null(field: dict[str, Any]) -> tuple[dict[str, Any], bool]:
    """Return the schema of a value that is given, and whether it may be absent (None)."""
    choices = field.get("anyOf", ())
    given = [c for c in choices if c.get("type") != "null"]
    if len(given) == 1 and len(choices) == 2:
        return {**field, **given[0]}, True
    return field, False


def _resolved(schema: dict[str, Any], field: Any) -> dict[str, Any]:
    if not isinstance(field, dict):
        return {}
    if "$ref" in field:
        return {**field, **schema["$defs"][field["$ref"].rsplit("/", 1)[1]]}
    return field


def _kind(field: dict[str, Any]) -> Kind:
    if "enum" in field or "const" in field:
        return "choice"
    if field.get("format") == "path":
        return "path"
    kinds: dict[str, Kind] = {
        "number": "number",
        "integer": "integer",
        "boolean": "truth",
        "array": "list",
        "object": "map",
    }
    return kinds.get(field.get("type", ""), "text")


def _choices(field: dict[str, Any]) -> tuple[str, ...]:
    return tuple(map(str, field.get("enum", [field["const"]] if "const" in field else ())))


def _limits(field: dict[str, Any]) -> dict[str, float]:
    names = {"minimum": "minimum", "exclusiveMinimum": "above", "maximum": "maximum", "exclusiveMaximum": "below"}
    # Beyond it are limits of number formats, which no person has to know.
    return {ours: field[theirs] for theirs, ours in names.items() if abs(field.get(theirs, _LIMITLESS)) < _LIMITLESS}


def unit_of(name: str) -> str:
    """Return the unit that the end of a name states; an empty text if it states none."""
    return next((unit for end, unit in UNITS.items() if f"_{name}".endswith(end)), "")


@cache
def documentation(model: type[BaseModel]) -> dict[str, str]:
    """Return the texts below the attributes of a model and of its bases, on one line each."""
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        module = inspect.getmodule(base)
        if module is not None and issubclass(base, BaseModel) and module.__name__.startswith(__package__.split(".")[0]):
            texts |= _texts(module).get(base.__name__, {})
    return texts


@cache
def _texts(module: ModuleType) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if not isinstance(node, ast.ClassDef):
            continue
        for field, text in zip(node.body, node.body[1:], strict=False):
            match field, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str() as said)):
                    found.setdefault(node.name, {})[name] = _for_a_person(said)
    return found


def _for_a_person(said: str) -> str:
    """Return a text of the source for readers of the file, in which what is None is not written."""
    text = re.sub(r"\s+", " ", said).strip().replace("`", "")
    text = re.sub(r"(^|[.] )None\b", r"\1Empty", text)
    return re.sub(r"\bNone\b", "empty", text)


@cache
def _models(model: type[BaseModel] = StationConfig) -> dict[str, type[BaseModel]]:
    """Return all models of the tables, by name."""
    found: dict[str, type[BaseModel]] = {model.__name__: model}
    left = [field.annotation for field in model.model_fields.values()]
    while left:
        part = left.pop()
        if isinstance(part, type) and issubclass(part, BaseModel):
            found |= _models(part)
        left += getattr(part, "__args__", ())
    return found


def _class(name: str) -> type[BaseModel]:
    return _models()[name]
