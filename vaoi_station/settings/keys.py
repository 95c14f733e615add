"""The keys of station.toml and of other documents, with type, unit, limits, default and text, read from the model.

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
from typing import Any, Literal

from pydantic import BaseModel, Field
from pydantic.json_schema import GenerateJsonSchema

from vaoi_station.config import StationConfig

Kind = Literal["text", "path", "number", "integer", "truth", "choice", "list", "map"]

UNITS = {
    "_px_per_mm": "px/mm",
    "_per_mm": "1/mm",
    "_mbit_s": "Mbit/s",
    "_mm_s": "mm/s",
    "_deg_s": "°/s",
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
_KINDS: dict[str, Kind] = {
    "number": "number",
    "integer": "integer",
    "boolean": "truth",
    "array": "list",
    "object": "map",
}
_LIMITS = {"minimum": "minimum", "exclusiveMinimum": "above", "maximum": "maximum", "exclusiveMaximum": "below"}
_LIMITLESS = 1e12
"""Beyond it are limits of number formats, which no person has to know."""


class Setting(BaseModel):
    """One key of station.toml, as the configuration model describes it."""

    key: str = Field(description="`line.tail_s`; `cameras[].width` in arrays, `controller.lights.NAME.on_us` by name.")
    table: str = Field(description="The table that has it; empty for the file's own level.")
    kind: Kind
    required: bool = Field(description="Whether its table needs it.")
    default: str | None = Field(default=None, description="As TOML; absent: none.")
    unit: str | None = None
    choices: list[str] = []
    minimum: float | None = None
    above: float | None = Field(default=None, description="The value must be above it.")
    maximum: float | None = None
    below: float | None = Field(default=None, description="The value must be below it.")
    description: str
    optional_table: bool = Field(description="Whether the whole table may be absent.")


class _Schema(GenerateJsonSchema):
    """A schema in which a matrix, for which JSON Schema has no type, is a list."""

    def handle_invalid_for_json_schema(self, schema: Any, error_info: str) -> dict[str, Any]:  # noqa: ARG002
        """Return the schema of a type that JSON Schema cannot describe."""
        return {"type": "array"}


@cache
def keys(root: type[BaseModel] = StationConfig) -> tuple[Setting, ...]:
    """Return all keys of a document, by default of station.toml, in the order of its model."""
    schema = root.model_json_schema(schema_generator=_Schema)
    return tuple(_walk(schema, schema, "", (root, root), optional=False))


def _walk(
    schema: dict[str, Any],
    table: dict[str, Any],
    prefix: str,
    of: tuple[type[BaseModel], type[BaseModel]],
    *,
    optional: bool,
) -> Iterator[Setting]:
    root, model = of

    def resolved(field: Any) -> dict[str, Any]:
        field = field if isinstance(field, dict) else {}
        return {**field, **schema["$defs"][field["$ref"].rsplit("/", 1)[1]]} if "$ref" in field else field

    texts = documentation(model)
    tables = []
    for name, field in table["properties"].items():
        given = [choice for choice in field.get("anyOf", ()) if choice.get("type") != "null"]
        absent = len(given) == 1 and len(field["anyOf"]) == 2
        inside = resolved({**field, **given[0]} if absent else field)
        elements = resolved(inside.get("items")) if inside.get("type") == "array" else {}
        named = resolved(inside.get("additionalProperties")) if inside.get("type") == "object" else {}
        where = f"{prefix}.{name}" if prefix else name
        if "properties" in inside:
            tables.append((inside, where, absent))
        elif "properties" in elements:
            tables.append((elements, f"{where}[]", True))
        elif "properties" in named:
            tables.append((named, f"{where}.NAME", True))
        else:
            required, default = name in table.get("required", ()), field.get("default")
            choices = inside.get("enum", [inside["const"]] if "const" in inside else [])
            kind: Kind = "choice" if choices else "path" if inside.get("format") == "path" else "text"
            limits = {ours: inside[theirs] for theirs, ours in _LIMITS.items() if theirs in inside}
            yield Setting(
                key=where,
                table=prefix,
                kind=_KINDS.get(inside.get("type", ""), kind) if kind == "text" else kind,
                required=required,
                default=None if default is None or required else _as_toml(default),
                unit=next((unit for end, unit in UNITS.items() if f"_{name}".endswith(end)), None),
                choices=list(map(str, choices)),
                description=texts.get(name) or field.get("description", ""),
                optional_table=optional,
                **{limit: value for limit, value in limits.items() if abs(value) < _LIMITLESS},
            )
    for inside, where, absent in tables:
        yield from _walk(schema, inside, where, (root, models_of(root)[inside["title"]]), optional=optional or absent)


def _as_toml(value: Any) -> str:
    from tomlkit import inline_table, item  # here, because most starts need no text

    return (inline_table() if value == {} else item(value)).as_string()


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
        if isinstance(node, ast.ClassDef):
            for field, text in zip(node.body, node.body[1:], strict=False):
                match field, text:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str() as said)):
                        # For readers of the file, in which what is None is not written.
                        said = re.sub(r"\s+", " ", said).strip().replace("`", "")
                        said = re.sub(r"(^|[.] )None\b", r"\1Empty", said)
                        found.setdefault(node.name, {})[name] = re.sub(r"\bNone\b", "empty", said)
    return found


@cache
def models_of(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Return the models of all tables of a document, by name."""
    found: dict[str, type[BaseModel]] = {model.__name__: model}
    left = [field.annotation for field in model.model_fields.values()]
    while left:
        part = left.pop()
        if isinstance(part, type) and issubclass(part, BaseModel):
            found |= models_of(part)
        left += getattr(part, "__args__", ())
    return found
