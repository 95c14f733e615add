"""Every example of the document is one that its schema allows; every operation with JSON has one."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.description.examples import add_examples, examples


def test_examples_are_added_where_they_belong() -> None:
    operation: dict[str, Any] = {
        "operationId": "arm_station",
        "parameters": [{"name": "board_type"}, {"name": "unknown"}],
        "requestBody": {"content": {"application/json": {}}},
        "responses": {"200": {"content": {"application/json": {}}}, "404": {}},
    }
    add_examples(operation)
    assert operation["parameters"] == [{"name": "board_type", "example": "demo"}, {"name": "unknown"}]
    assert operation["requestBody"]["content"]["application/json"]["example"] == examples()["bodies"]["arm_station"]
    assert operation["responses"]["200"]["content"]["application/json"]["example"]["state"] == "armed"
