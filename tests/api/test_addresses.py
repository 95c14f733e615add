"""Host names by which the station may be addressed, and prefixes that a proxy or station.toml states."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from tests.api.held_station import HeldStation
from vaoi_station.api import create_app
from vaoi_station.api.addresses import HEADER, addressed, allowed_names, as_addressed, is_loopback, path_of, root_of
from vaoi_station.model.root_path import OWN_PATHS

NAMES = frozenset({"localhost", "aoi-3"})


def test_the_machines_names_and_configured_names_are_accepted() -> None:
    own = socket.gethostname().lower()
    names = allowed_names(["AOI-3.plant.example."])
    assert {"localhost", own, f"{own.partition('.')[0]}.local", "aoi-3.plant.example"} <= names
    assert addressed("aoi-3.plant.example:80", names)
    assert not addressed("aoi-4.plant.example", names)


@given(st.ip_addresses(), st.one_of(st.none(), st.integers(1, 65535)))
def test_every_address_is_accepted_with_and_without_a_port(
    address: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int | None
) -> None:
    host = f"[{address}]" if address.version == 6 else str(address)
    assert addressed(host if port is None else f"{host}:{port}", frozenset())


@pytest.mark.parametrize("host", ["", " ", "LocalHost", "localhost.", "AOI-3:8350", "::1"])
def test_names_compare_without_case_port_and_final_dot(host: str) -> None:
    assert addressed(host, NAMES)


@pytest.mark.parametrize("host", ["aoi-3.evil.example", "xaoi-3", "127.0.0.1.evil", "[::1", "[evil]:80", "a:b:c"])
def test_other_names_are_refused(host: str) -> None:
    assert addressed(host, NAMES) is (host == "[::1")


@pytest.mark.parametrize(
    ("client", "expected"),
    [
        (("127.0.0.1", 5), True),
        (("127.8.0.1", 5), True),
        (("::1", 5), True),
        (("::ffff:127.0.0.1", 5), True),
        (("192.0.2.7", 5), False),
        (("::ffff:192.0.2.7", 5), False),
        (("testclient", 5), False),
        (None, False),
    ],
)
def test_connections_of_this_machine_are_known_by_their_address(client: object, expected: bool) -> None:
    assert is_loopback({"client": client}) is expected


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


@pytest.mark.parametrize("path", ["/", "/docs", f"{API}/runs/r000001/components/U1", "/nothing", f"{API}/openapi.json"])
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


@pytest.mark.parametrize("prefix", ["", "/"])
def test_no_prefix_is_none(near: TestClient, prefix: str) -> None:
    shown = near.get(f"{API}/runs/r000001/components/U1", headers={HEADER: prefix})
    assert shown.json()["views"][0]["url"].startswith(f"{API}/runs/")


@pytest.mark.parametrize("prefix", ["/aoi", *WRONG.values()], ids=["/aoi", *WRONG])
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


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_the_root_without_its_slash_leads_to_the_page(method: str) -> None:
    with TestClient(create_app(HeldStation(), ["testserver"], root_path="/aoi"), follow_redirects=False) as client:
        moved = client.request(method, "/aoi")
        assert (moved.status_code, moved.headers["location"]) == (307, "/aoi/")
        assert client.get("/aoi/").status_code == 200
        assert client.post("/aoi").status_code == 404
        assert client.get("/aoix/").status_code == 404
        assert client.get("/AOI/").status_code == 404


def test_a_root_path_must_not_hide_addresses_of_the_station(app: Any) -> None:
    assert {route.path.split("/")[1] for route in app.routes} - {""} == OWN_PATHS


def _scope(path: str, client: str = "127.0.0.1", **headers: str) -> dict[str, Any]:
    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return {"type": "http", "scheme": "http", "path": path, "client": (client, 5), "headers": pairs}


@pytest.mark.parametrize(
    ("path", "root_path", "stated", "expected"),
    [
        ("/api", "", None, ("", "/api")),
        ("/api", "", "/aoi", ("/aoi", "/aoi/api")),
        ("/aoi/api", "", "/aoi", ("/aoi", "/aoi/aoi/api")),
        ("/aoi/api", "/aoi", None, ("/aoi", "/aoi/api")),
        ("/aoi", "/aoi", None, ("/aoi", "/aoi")),
        ("/aoix", "/aoi", None, ("", "/aoix")),
        ("/api", "/aoi", None, ("", "/api")),
        ("/api", "/aoi", "/b", ("/b", "/b/api")),
        ("/aoi/api", "/aoi", "/b", ("/aoi", "/aoi/api")),
    ],
)
def test_root_and_path_are_those_of_the_caller(
    path: str, root_path: str, stated: str | None, expected: tuple[str, str]
) -> None:
    asked = _scope(path) if stated is None else _scope(path, x_forwarded_prefix=stated)
    found = as_addressed(asked, root_path)
    assert (root_of(found), found["path"]) == expected
    assert root_of(found) + path_of(found) == found["path"]


@pytest.mark.parametrize(("client", "scheme"), [("127.0.0.1", "https"), ("::1", "https"), ("192.0.2.7", "http")])
def test_the_scheme_of_a_proxy_counts_from_this_machine(client: str, scheme: str) -> None:
    assert as_addressed(_scope("/", client, x_forwarded_proto="https"), "")["scheme"] == scheme


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


def test_within_a_mounted_folder_the_root_is_that_of_the_application() -> None:
    scope = {"path": "/aoi/web/app.js", "root_path": "/aoi/web", "app_root_path": "/aoi"}
    assert (root_of(scope), path_of(scope)) == ("/aoi", "/web/app.js")
