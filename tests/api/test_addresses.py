"""Host names by which the station may be addressed, and prefixes that a proxy or station.toml states."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from vaoi_station.api.addresses import HEADER, addressed, allowed_names, as_addressed
from vaoi_station.api.app import create_app

NAMES = frozenset({"localhost", "aoi-3"})


def test_the_machines_names_and_configured_names_are_accepted() -> None:
    own = socket.gethostname().lower()
    names = allowed_names(["AOI-3.plant.example."])
    assert {"localhost", own, f"{own.partition('.')[0]}.local", "aoi-3.plant.example"} <= names
    assert addressed("aoi-3.plant.example:80", names)
    assert not addressed("aoi-4.plant.example", names)


@pytest.mark.parametrize("host", ["aoi-3.evil.example", "xaoi-3", "127.0.0.1.evil", "[::1", "[evil]:80", "a:b:c"])
def test_other_names_are_refused(host: str) -> None:
    assert addressed(host, NAMES) is (host == "[::1")


API = "/api/v1"
WRONG = {
    "other host": "//evil.example",
    "other host behind a path": "/a//evil.example",
    "whole address": "https://evil.example",
    "upwards": "/..",
    "upwards inside": "/aoi/../../x",
    "hidden name": "/.well-known",
    "control character": "/a\tb",
    "quote": "/a'b",
    "markup": '/a"><script>alert(1)</script>',
    "script": "javascript:alert(1)",
    "backslash": "/\\evil.example",
    "backslash first": "\\\\evil.example",
    "escape": "/%2e%2e",
    "query": "/a?b",
    "fragment": "/a#b",
    "without slash": "aoi",
    "space": "/a b",
    "several": "/a, /b",
    "letter beyond ASCII": "/ä",
    "10,000 characters": "/" + "a" * 9_999,
    "201 characters": "/" + "a" * 200,
}


@pytest.fixture(scope="module")
def app() -> Any:
    station = HeldStation()
    station.film()
    return create_app(station, ["testserver"])


@pytest.fixture(scope="module")
def near(app: Any) -> Iterator[TestClient]:
    """A proxy on the station's machine."""
    with TestClient(app, client=("127.0.0.1", 50_000), follow_redirects=False) as client:
        yield client


@pytest.mark.parametrize("path", ["/", f"{API}/runs/r000001/components/U1"])
@pytest.mark.parametrize("prefix", WRONG.values(), ids=WRONG)
def test_a_prefix_that_is_no_path_is_refused(near: TestClient, prefix: str, path: str) -> None:
    refused = near.get(path, headers={HEADER.encode(): prefix.encode()})
    assert refused.status_code == 400
    problem = refused.json()
    assert refused.headers["content-type"] == "application/problem+json"
    assert (problem["code"], problem["instance"], problem["type"]) == ("malformed", path, "/problems/malformed")
    assert problem["detail"].startswith(f"{HEADER} is ")
    assert "a path such as /aoi" in problem["detail"]
    assert len(refused.text) < 700
    assert "location" not in refused.headers
    assert "set-cookie" not in refused.headers


@pytest.mark.parametrize("prefix", ["/aoi", "//evil.example"])
def test_a_prefix_from_another_machine_does_not_count(app: Any, near: TestClient, prefix: str) -> None:
    far = TestClient(app, client=("192.0.2.7", 50_000))
    path = f"{API}/runs/r000001/components/U1"
    assert far.get(path, headers={HEADER.encode(): prefix.encode()}).content == near.get(path).content


@pytest.mark.parametrize("path", ["//evil.example", "/aoi//evil.example", "/%2F%2Fevil.example"])
@pytest.mark.parametrize("root_path", ["", "/aoi"])
def test_no_path_leads_to_another_host(root_path: str, path: str) -> None:
    with TestClient(create_app(HeldStation(), ["testserver"], root_path=root_path), follow_redirects=False) as client:
        refused = client.get(f"http://testserver{path}")
    assert refused.status_code == 404
    assert "location" not in refused.headers


def _scope(path: str, client: str = "127.0.0.1", **headers: str) -> dict[str, Any]:
    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return {"type": "http", "scheme": "http", "path": path, "client": (client, 5), "headers": pairs}


@pytest.mark.parametrize(
    ("client", "stated", "caller"),
    [
        ("127.0.0.1", "192.0.2.9", "192.0.2.9"),
        ("127.0.0.1", "203.0.113.5, 192.0.2.9", "192.0.2.9"),
        ("::1", "fd00::1", "fd00::1"),
        ("127.0.0.1", "not an address", "127.0.0.1"),
        ("192.0.2.7", "192.0.2.9", "192.0.2.7"),
    ],
)
def test_the_caller_that_a_proxy_of_this_machine_states_is_the_caller(client: str, stated: str, caller: str) -> None:
    assert as_addressed(_scope("/", client, x_forwarded_for=stated), "")["client"][0] == caller
