"""What OpenAPI 3.0 and 3.1 permit in each of their objects, as far as the station's document uses them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

_WORDS = (
    "$ref title description type format enum default properties required additionalProperties items minItems maxItems "
    "uniqueItems minimum maximum exclusiveMinimum exclusiveMaximum minLength maxLength pattern anyOf oneOf allOf not "
    "example minProperties maxProperties readOnly writeOnly deprecated discriminator"
)
_SCHEMA = frozenset(_WORDS.split())
KEYS: dict[str, dict[str, frozenset[str]]] = {
    "3.1": {"schema": _SCHEMA | {"const", "examples", "prefixItems", "propertyNames", "patternProperties"}},
    "3.0": {"schema": _SCHEMA | {"nullable"}},
}
_SAME = {
    "document": "openapi info servers paths components security tags externalDocs",
    "info": "title version description termsOfService contact license",
    "path": "summary description servers parameters get put post delete options head patch trace $ref",
    "operation": "tags summary description externalDocs operationId parameters requestBody responses callbacks "
    "deprecated security servers",
    "parameter": "name in description required deprecated allowEmptyValue style explode allowReserved schema example "
    "examples content",
    "body": "description content required",
    "answer": "description headers content links $ref",
    "header": "description required deprecated style explode schema example examples content $ref",
    "content": "schema example examples encoding",
    "components": "schemas responses parameters examples requestBodies headers securitySchemes links callbacks",
}
for _version in KEYS.values():
    _version.update({name: frozenset(keys.split()) for name, keys in _SAME.items()})
_METHODS = ("get", "put", "post", "delete", "patch")


def faults(document: dict[str, Any]) -> list[str]:
    """Return every key that the document's version of OpenAPI does not know, with its place."""
    return list(_Walk(document["openapi"][:3]).document(document))


def fits(value: Any, schema: dict[str, Any], document: dict[str, Any]) -> bool:
    """Return whether a JSON value matches a schema; covers the JSON Schema that the document uses in replies."""
    if "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in schema:
        return any(fits(value, s, document) for s in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return value in schema.get("enum", [schema.get("const")])
    kind = schema.get("type")
    if kind == "object":
        known, more = schema.get("properties", {}), schema.get("additionalProperties", True)
        return (
            isinstance(value, dict)
            and set(schema.get("required", [])) <= value.keys()
            and (more is not False or value.keys() <= known.keys())
            and all(
                fits(v, known.get(k, more), document)
                for k, v in value.items()
                if k in known or more not in (True, False)
            )
        )
    if kind == "array":
        fewest, most = schema.get("minItems", 0), schema.get("maxItems", sys.maxsize)
        listed = isinstance(value, list) and fewest <= len(value) <= most
        return listed and all(fits(v, schema.get("items", {}), document) for v in value)
    python: dict[str, Any] = {
        "string": str,
        "integer": int,
        "number": (int, float),
        "boolean": bool,
        "null": type(None),
    }
    # In Python a truth value is a number as well.
    return kind is None or (isinstance(value, python[kind]) and (kind == "boolean" or not isinstance(value, bool)))


class _Walk:
    """Goes through a document; each method yields the faults of one kind of object."""

    def __init__(self, version: str) -> None:
        self._keys = KEYS[version]

    def document(self, found: dict[str, Any]) -> Iterator[str]:
        yield from self._known("document", found, "")
        yield from self._known("info", found["info"], "info")
        yield from self._known("components", found["components"], "components")
        for path, item in found["paths"].items():
            yield from self._known("path", item, path)
            for method in item.keys() & set(_METHODS):
                yield from self._operation(item[method], f"{method} {path}")
        for name, schema in found["components"].get("schemas", {}).items():
            yield from self._schema(schema, name)
        for name, answer in found["components"].get("responses", {}).items():
            yield from self._answer(answer, name)
        for name, header in found["components"].get("headers", {}).items():
            yield from self._holder("header", header, name)

    def _operation(self, found: dict[str, Any], where: str) -> Iterator[str]:
        yield from self._known("operation", found, where)
        if not found.get("responses"):
            yield f"{where}: no responses"
        for parameter in found.get("parameters", ()):
            yield from self._holder("parameter", parameter, f"{where} {parameter.get('name')}")
            if parameter["in"] == "path" and (not parameter["required"] or f"{{{parameter['name']}}}" not in where):
                yield f"{where}: path parameter {parameter['name']}"
        if "requestBody" in found:
            yield from self._known("body", found["requestBody"], where)
            yield from self._contents(found["requestBody"], where)
        for status, answer in found.get("responses", {}).items():
            yield from self._answer(answer, f"{where} {status}")

    def _answer(self, found: dict[str, Any], where: str) -> Iterator[str]:
        yield from self._known("answer", found, where)
        if "description" not in found and "$ref" not in found:
            yield f"{where}: no description"
        yield from self._contents(found, where)
        for name, header in found.get("headers", {}).items():
            yield from self._holder("header", header, f"{where} {name}")

    def _contents(self, found: dict[str, Any], where: str) -> Iterator[str]:
        for kind, content in found.get("content", {}).items():
            yield from self._holder("content", content, f"{where} {kind}")

    def _holder(self, kind: str, found: dict[str, Any], where: str) -> Iterator[str]:
        """Check an object that holds a schema."""
        yield from self._known(kind, found, where)
        if "example" in found and "examples" in found:
            yield f"{where}: example and examples"
        yield from self._schema(found.get("schema", {}), where)

    def _schema(self, found: Any, where: str) -> Iterator[str]:
        if isinstance(found, bool):
            return
        yield from self._known("schema", found, where)
        if not isinstance(found.get("type", ""), str):
            yield f"{where}: several types"
        for name, field in found.get("properties", {}).items():
            yield from self._schema(field, f"{where}.{name}")
        for key in ("items", "additionalProperties", "not", "propertyNames"):
            if key in found:
                yield from self._schema(found[key], f"{where}.{key}")
        for key in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for choice in found.get(key, ()):
                yield from self._schema(choice, f"{where}.{key}")

    def _known(self, kind: str, found: dict[str, Any], where: str) -> Iterator[str]:
        for key in found:
            if key not in self._keys[kind] and not key.startswith("x-"):
                yield f"{where}: a {kind} has no {key}"
