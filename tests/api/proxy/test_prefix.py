"""The station under a path of a reverse proxy, in every way in which the proxy may say so."""

from __future__ import annotations

import json
import re
import ssl
from collections.abc import Iterator
from typing import Any
from urllib.parse import urljoin

import httpx2

from tests.api.proxy.conftest import Prefixed
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
            # docs/build_site makes the documents; without them the station says so.
            assert client.get(address).status_code == (404 if file == "help" else 200), address


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
