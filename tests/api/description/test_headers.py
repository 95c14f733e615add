"""Answers state their headers."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.description.headers import HEADERS, of_answer, of_refusal


def test_headers_of_answers_and_refusals() -> None:
    image: dict[str, Any] = {"content": {"image/png": {}, "application/x-npy": {}}}
    assert {"ETag", "X-Image-Stride"} <= of_answer("get", {"operationId": "get_component_image"}, "200", image).keys()
    assert "X-Frame-Verdict" in of_answer("get", {"operationId": "get_frame"}, "200", image)
    assert "Location" in of_answer("put", {"operationId": "put_board_type"}, "201", {})
    assert "Location" not in of_answer("post", {"operationId": "create_key"}, "201", {})
    assert "ETag" not in of_answer("get", {"operationId": "get_station"}, "200", {})
    assert "Idempotency-Replayed" in of_answer("post", {"operationId": "arm_station"}, "200", {})
    assert "Retry-After" in of_refusal(503)
    assert "WWW-Authenticate" in of_refusal(401)
    assert set(of_refusal(404)) == {"X-Vaoi-Version", "Cache-Control"}
    assert all(header["description"].endswith(".") and "example" in header for header in HEADERS.values())
