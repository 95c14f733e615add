"""Host names by which the station may be addressed."""

from __future__ import annotations

import ipaddress
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.api.addressing.hosts import addressed, allowed_names, is_loopback

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
