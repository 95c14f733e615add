"""What every request passes first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from vaoi_station.api.edge import MAX_BODY_BYTES

ARM = "/api/v1/station/arm"
ORDER = '{"board_type": "demo-board", "board_id": "B1"}'


@pytest.mark.parametrize("content_type", [None, "text/plain", "application/x-www-form-urlencoded", "application/json"])
def test_json_is_understood_whatever_it_is_called(client: Any, content_type: str | None) -> None:
    headers = {"content-type": content_type} if content_type else {}
    answer = client.post(ARM, content=ORDER, headers=headers)
    assert answer.json()["armed_with"].items() >= {"board_type": "demo-board", "board_id": "B1"}.items()


@pytest.mark.parametrize("path", ["/", "/docs", "/healthz", "/api/v1/station", "/nowhere", "/web/app.js"])
def test_pages_may_load_nothing_from_elsewhere(client: Any, path: str) -> None:
    headers = client.get(path).headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://testserver:81", "https://testserver.evil"])
def test_commands_from_pages_of_others_are_refused(client: Any, station: Any, origin: str) -> None:
    answer = client.post(ARM, content=ORDER, headers={"origin": origin})
    assert (answer.status_code, answer.json()["code"]) == (403, "foreign-origin")
    assert station.armed is None


@pytest.mark.parametrize("headers", [{"origin": "http://testserver"}, {}, {"sec-fetch-site": "same-origin"}])
def test_commands_from_the_own_page_and_from_programs_pass(client: Any, headers: dict[str, str]) -> None:
    assert client.post(ARM, content=ORDER, headers=headers).status_code == 200


def test_foreign_pages_without_an_origin_are_known_by_what_the_browser_says(client: Any) -> None:
    assert client.post(ARM, content=ORDER, headers={"sec-fetch-site": "cross-site"}).status_code == 403


def test_bodies_are_bounded_whether_announced_or_not(client: Any) -> None:
    def drops() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65536 + 1):
            yield b" " * 65536

    for body in (b" " * (MAX_BODY_BYTES + 1), drops()):
        answer = client.put("/api/v1/board-types/x", content=body)
        assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
        assert str(MAX_BODY_BYTES) in answer.json()["detail"]


def test_an_absurd_length_is_refused(client: Any) -> None:
    answer = client.put("/api/v1/board-types/x", content=b"{}", headers={"content-length": "9" * 5000})
    assert answer.status_code == 413
