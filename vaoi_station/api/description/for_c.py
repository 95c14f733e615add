"""The OpenAPI document for the C of openapi-generator, which cannot express all of the others.

Its functions take decimal numbers and integers of 64 bits by value: these cannot be left out, and the sign of an
exponent is sent without escape, so that it arrives as a space. In the query, times are one character, and lists are
read as one name with its value. The generator makes identifiers of the values of enumerations, also of those with a dot
or a sign, of "any value" a type that it does not declare, and of two maps in an object two variables of one name. Texts
and objects have none of these faults.
"""

from __future__ import annotations

import copy
import re
from typing import Any

# Without a plus sign: the client sends texts as they are, and there a plus is a space.
DECIMAL = r"^-?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE]-?[0-9]+)?$"
# A hyphen becomes an underscore in the name of the constant, and is sent as a hyphen.
_NAMED = re.compile(r"[A-Za-z0-9_-]+")
_KINDS = ("type", "$ref", "allOf", "anyOf", "oneOf", "enum")
INTEGER = r"^-?[0-9]+$"
_BOUNDS = (
    ("minimum", "exclusiveMinimum", "at least", "greater than"),
    ("maximum", "exclusiveMaximum", "at most", "less than"),
)


def for_c(document: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a document of OpenAPI 3.0 as one of which a C client can be made: the same addresses."""
    changed = copy.deepcopy(document)
    for operations in changed["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                if parameter["in"] == "query":
                    _take_text(parameter)
    _simplify(changed)
    return changed


def _take_text(parameter: dict[str, Any]) -> None:
    """Make a query parameter a text if the generator would take it by value or cannot send it, in place."""
    schema = parameter["schema"]
    if schema.get("type") == "number":
        form, said = {"pattern": DECIMAL}, f"Decimal number{_limits(schema)}."
    elif schema.get("format") == "int64":
        form, said = {"pattern": INTEGER}, f"Integer{_limits(schema)}."
    elif schema.get("format") == "date-time":
        form, said = {}, "In UTC, with `Z`."
    elif schema.get("type") == "array":
        form, said = {key: schema["items"][key] for key in ("enum",) if key in schema["items"]}, "One value."
    else:
        return
    described = f"{parameter['description']} {said}" if "description" in parameter else said
    text = {"type": "string", "title": schema["title"], "description": described, **form}
    if "default" in schema:
        text["default"] = str(schema["default"])
    parameter |= {"description": described, "schema": text}
    if "example" in parameter:
        example = parameter["example"]
        parameter["example"] = str(example[0] if isinstance(example, list) else example)


def _limits(schema: dict[str, Any]) -> str:
    found = []
    for key, exclusive, inclusive_words, exclusive_words in _BOUNDS:
        if key in schema:
            found.append(f"{exclusive_words if schema.get(exclusive) else inclusive_words} {schema[key]:.16g}")
    return f", {' and '.join(found)}" if found else ""


def _simplify(part: Any) -> None:
    """Make texts of enumerations without identifiers, and objects of any value and of several maps, in place."""
    if isinstance(part, list):
        for inner in part:
            _simplify(inner)
    if not isinstance(part, dict):
        return
    for key, inner in part.items():
        if key == "properties":
            several = sum("additionalProperties" in field for field in inner.values()) > 1
            for field in inner.values():
                if not any(kind in field for kind in _KINDS):
                    field["type"] = "object"
                if several:
                    field.pop("additionalProperties", None)
                _simplify(field)
        elif key not in ("example", "examples", "default", "enum"):
            _simplify(inner)
    values = part.get("enum", ())
    if not all(_NAMED.fullmatch(str(value)) for value in values):
        listed = f"One of: {', '.join(values)}."
        part["description"] = f"{part['description']} {listed}" if "description" in part else listed
        for key in ("enum", "x-enum-varnames", "x-enumNames"):
            part.pop(key, None)
