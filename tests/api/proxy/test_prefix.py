"""The station under a path of a reverse proxy, in every way in which the proxy may say so."""

from __future__ import annotations

import json
import re
import ssl
from collections.abc import Iterator
from typing import Any
from urllib.parse import urljoin

import httpx2
import pytest

from tests.api.held_station import BOARD
from tests.api.proxy.conftest import Prefixed
from tests.board_data.readers import samples
from vaoi_station import connect
from vaoi_station.api.middleware import CSP

API = "/api/v1"


def addresses(content: Any) -> Iterator[str]:
    """Yield every text of a document that is the address of something of the station."""
    if isinstance(content, dict | list):
        for value in content.values() if isinstance(content, dict) else content:
            yield from addresses(value)
    elif isinstance(content, str) and ("/api/" in content or "/problems/" in content or "://" in content):
        yield content


def test_the_page_and_every_file_of_it_are_found(prefixed: Prefixed) -> None:
    client, prefix = prefixed.client, prefixed.prefix
    moved = client.get(prefix)
    assert moved.is_redirect
    assert urljoin(f"{prefixed.url}", moved.headers["location"]) == f"{prefixed.url}/"
    for name in ("/", "/docs"):
        shown = client.get(f"{prefix}{name}")
        assert (shown.status_code, shown.headers["content-security-policy"]) == (200, CSP)
        files = re.findall(r'(?:href|src)="(.+?)"', shown.text)
        assert len(files) > 3
        for file in files:
            address = urljoin(f"{prefixed.url}{name}", file)
            assert address.startswith(f"{prefixed.url}/")
            assert client.get(address).status_code == 200, address


def test_addresses_in_replies_lead_to_what_they_name(prefixed: Prefixed) -> None:
    client, base = prefixed.client, f"{prefixed.prefix}{API}"
    run = client.get(f"{base}/runs/latest").json()["id"]
    documents = {
        name: client.get(f"{base}/runs/{run}/{name}").json()
        for name in ("components", "components/U1", "merged?component=U1", "mosaics")
    }
    documents["images"] = json.loads(
        re.findall(r'\{"address".*\}', client.get(f"{base}/runs/{run}/images?component=U1&format=raw").text)[0]
    )
    found = [address for document in documents.values() for address in addresses(document)]
    assert len(found) > 10
    for address in found:
        assert address.startswith(f"{base}/runs/{run}/"), address
        assert client.get(address).status_code == 200, address
    (mosaic, *_) = documents["mosaics"]["mosaics"]
    tiles = mosaic["dzi"].removesuffix(".dzi")
    assert client.get(f"{tiles}_files/0/0_0.jpg").headers["content-type"] == "image/jpeg"


def test_what_is_new_has_a_location_that_can_be_read(prefixed: Prefixed) -> None:
    client, base = prefixed.client, f"{prefixed.prefix}{API}"
    stored = client.put(f"{base}/board-types/new", json=BOARD | {"name": "new"})
    assert (stored.status_code, stored.headers["location"]) == (201, f"{base}/board-types/new")
    upload = client.post(f"{base}/board-data/previews?filename=b.kicad_pcb", content=samples.KICAD.encode())
    assert upload.status_code == 201, upload.text
    assert upload.headers["location"] == f"{base}/board-data/previews/{upload.json()['id']}"
    for address in (stored.headers["location"], upload.headers["location"], *addresses(upload.json())):
        assert address.startswith(f"{base}/"), address
        assert client.get(address).status_code == 200, address
    client.delete(stored.headers["location"])
    client.delete(upload.headers["location"])


def test_the_openapi_document_has_the_prefix_in_their_server(prefixed: Prefixed) -> None:
    document = prefixed.client.get(f"{prefixed.prefix}{API}/openapi.json").json()
    (server,) = document["servers"]
    assert server["url"] == prefixed.prefix
    path = next(path for path in document["paths"] if path.endswith("/station"))
    assert prefixed.client.get(server["url"] + path).status_code == 200
    assert prefixed.served.client.get(f"{API}/openapi.json").json()["servers"][0]["url"] == "/"


def test_a_login_is_valid_below_the_prefix_only(prefixed: Prefixed) -> None:
    base, address = f"{prefixed.prefix}{API}", prefixed.client.base_url
    origin = {"origin": str(address).rstrip("/")}
    with httpx2.Client(base_url=address, verify=ssl._create_unverified_context()) as page:
        login = page.post(f"{base}/session", json={"key": prefixed.secret}, headers=origin)
        assert f"Path={prefixed.prefix};" in f"{login.headers['set-cookie']};"
        assert ("Secure" in login.headers["set-cookie"]) == (address.scheme == "https")
        assert page.get(f"{base}/station").status_code == 200
        arm = page.post(f"{base}/station/arm?board_type=demo-board", headers=origin)
        assert arm.status_code == 200
        assert prefixed.audit.newest(1)[0]["path"] == f"{API}/station/arm"
        logout = page.delete(f"{base}/session", headers=origin)
        assert f"Path={prefixed.prefix};" in f"{logout.headers['set-cookie']};"
        assert page.get(f"{base}/station").status_code == 401


@pytest.mark.parametrize("slash", ["", "/"])
def test_the_library_works_with_an_address_that_has_a_path(
    prefixed: Prefixed, tmp_path_factory: pytest.TempPathFactory, slash: str
) -> None:
    station = connect(prefixed.url + slash, key=prefixed.secret, ca=prefixed.ca)
    assert station.snapshot()["state"]
    run = station.run()
    (component, *_) = run.refs
    assert run.component(component)[0].pixels.size
    assert run.merged(component)[0].radiance.size
    assert [pictures.address for pictures in run.pictures(component)] == [component]
    target = tmp_path_factory.mktemp("mosaic") / "board.tif"
    run.save_mosaic(run.mosaics()[0].name, target)
    assert target.stat().st_size
