"""The document for the C of openapi-generator says the same with texts and objects that this generator can express."""

from __future__ import annotations

import re
from typing import Any

import pytest

from vaoi_station.api.description.for_c import DECIMAL, for_c


def parameter(schema: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"name": "x", "in": "query", "required": False, "schema": {"title": "X", **schema}, **more}


def of_parameter(given: dict[str, Any]) -> dict[str, Any]:
    changed = for_c({"paths": {"/p": {"get": {"parameters": [given]}}}})
    found: dict[str, Any] = changed["paths"]["/p"]["get"]["parameters"][0]
    return found


def test_decimal_parameters_of_the_query_are_texts_with_their_limits_in_words() -> None:
    number = {
        "type": "number",
        "format": "double",
        "minimum": 0,
        "exclusiveMinimum": True,
        "maximum": 1,
        "default": 0.5,
    }
    given = parameter(number, description="Share.", example=0.25)
    found = of_parameter(given)
    assert found["description"] == "Share. Decimal number, greater than 0 and at most 1."
    assert found["example"] == "0.25"
    assert found["schema"] == {
        "type": "string",
        "pattern": DECIMAL,
        "title": "X",
        "description": found["description"],
        "default": "0.5",
    }
    assert given["schema"]["type"] == "number"


def test_other_parameters_are_as_they_were() -> None:
    for given in (
        parameter({"type": "integer"}),
        parameter({"type": "string"}),
        {**parameter({"type": "number"}), "in": "path"},
    ):
        assert of_parameter(given) == given


def test_large_integers_of_the_query_are_texts() -> None:
    found = of_parameter(parameter({"type": "integer", "format": "int64", "maximum": 2**53, "default": 3}))
    assert found["schema"] == {
        "type": "string",
        "pattern": r"^-?[0-9]+$",
        "title": "X",
        "description": "Integer, at most 9007199254740992.",
        "default": "3",
    }


def test_times_of_the_query_are_texts_that_arrive_as_they_are() -> None:
    found = of_parameter(parameter({"type": "string", "format": "date-time"}, description="RFC 3339."))
    assert found["description"] == "RFC 3339. In UTC, with `Z`."
    assert found["schema"] == {"type": "string", "title": "X", "description": found["description"]}


def test_of_a_list_in_the_query_there_is_one_value() -> None:
    found = of_parameter(
        parameter({"type": "array", "items": {"type": "string", "enum": ["a", "b"]}, "maxItems": 2}, example=["b"])
    )
    assert found["example"] == "b"
    assert found["schema"] == {"type": "string", "title": "X", "description": "One value.", "enum": ["a", "b"]}


def test_a_decimal_parameter_without_words_and_limits_is_described() -> None:
    assert of_parameter(parameter({"type": "number"}))["description"] == "Decimal number."


@pytest.mark.parametrize(("text", "fine"), [("20", True), ("-0.5", True), ("2.e1", True), ("1e-3", True), (".5", True)])
def test_the_pattern_allows_decimal_numbers(text: str, fine: bool) -> None:
    assert fine == bool(re.search(DECIMAL, text))
    assert float(text) is not None


@pytest.mark.parametrize("text", ["", "-", ".", "nan", "inf", "2.0e+01", "+1", "1e", "0x10", "1_0", " 1"])
def test_the_pattern_refuses_what_is_no_number_or_would_not_arrive(text: str) -> None:
    assert not re.search(DECIMAL, text)


def test_enumerations_whose_values_make_no_identifiers_are_texts() -> None:
    schemas: dict[str, Any] = {
        "A": {
            "properties": {
                "sign": {
                    "type": "string",
                    "enum": ["≤", "≥"],
                    "x-enum-varnames": ["le", "ge"],
                    "x-enumNames": ["le", "ge"],
                },
                "file": {"type": "string", "enum": ["a.svg", "b"], "description": "A file."},
                "kind": {"type": "string", "enum": ["html-bom", "odb"]},
                "turn": {"type": "integer", "enum": [0, 90]},
            }
        }
    }
    fields = for_c({"paths": {}, "components": {"schemas": schemas}})["components"]["schemas"]["A"]["properties"]
    assert fields == {
        "sign": {"type": "string", "description": "One of: ≤, ≥."},
        "file": {"type": "string", "description": "A file. One of: a.svg, b."},
        "kind": {"type": "string", "enum": ["html-bom", "odb"]},
        "turn": {"type": "integer", "enum": [0, 90]},
    }


def test_a_field_that_may_be_anything_is_an_object() -> None:
    schemas: dict[str, Any] = {"A": {"properties": {"v": {"title": "V"}, "w": {"allOf": [{"$ref": "#/x"}]}}}}
    fields = for_c({"paths": {}, "components": {"schemas": schemas}})["components"]["schemas"]["A"]["properties"]
    assert fields == {"v": {"title": "V", "type": "object"}, "w": {"allOf": [{"$ref": "#/x"}]}}


def test_of_several_maps_in_an_object_each_is_any_object() -> None:
    """The generator gives the variables of both maps the same name, which does not compile."""
    one = {"type": "object", "additionalProperties": {"type": "string"}}
    schemas: dict[str, Any] = {"A": {"properties": {"m": one}}, "B": {"properties": {"m": {**one}, "n": {**one}}}}
    found = for_c({"paths": {}, "components": {"schemas": schemas}})["components"]["schemas"]
    assert found["A"]["properties"] == {"m": one}
    assert found["B"]["properties"] == {"m": {"type": "object"}, "n": {"type": "object"}}
