"""The examples of the OpenAPI document: of parameters, of bodies and of answers, from a station on the twin."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

_FILE = Path(__file__).with_name("examples.json")


@cache
def examples() -> dict[str, dict[str, Any]]:
    """Return the examples: values of parameters by name or `operation.name`, bodies and answers by operation."""
    read: dict[str, dict[str, Any]] = json.loads(_FILE.read_text(encoding="utf-8"))
    return read


def add_examples(operation: dict[str, Any]) -> None:
    """Add the examples of one operation to its parameters, its body and its answers, in place."""
    known, name = examples(), operation["operationId"]
    for parameter in operation.get("parameters", ()):
        for key in (parameter["name"], f"{name}.{parameter['name']}"):
            value = known["parameters"].get(key)
            # A general example does not fit a parameter of the same name with other values.
            if value is not None and value in parameter.get("schema", {}).get("enum", [value]):
                parameter["example"] = value
    for kind in operation.get("requestBody", {}).get("content", {}).values():
        if name in known["bodies"]:
            kind["example"] = known["bodies"][name]
    for status, answer in operation["responses"].items():
        content = answer.get("content", {}).get("application/json")
        if content is not None and status in ("200", "201", "202") and name in known["answers"]:
            content["example"] = known["answers"][name]
