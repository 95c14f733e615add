"""Requests to the station on this machine: with a key, and by TLS with the certificate of the configuration."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.peers.certificates import make_authority, make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.config import ApiConfig
from vaoi_station.doctor.checks.running_station import ask
from vaoi_station.doctor.station_connection import address_of, request
from vaoi_station.errors import InputError
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[tuple[ApiConfig, str]]:
    """The configuration of a station with TLS that asks for a key on loopback too, and a key."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    made = make_certificate(tmp_path)
    served = Served(HeldStation(), access=AccessControl(keys, audit, open_loopback=False), certificate=made)
    served.client.close()  # its open connection would have 5 s to end
    api = ApiConfig(port=served.port, certificate=made.certificate, private_key=made.private_key, open_loopback=False)
    yield api, keys.create("reader", ["read"]).secret
    served.stop()
    audit.close()


def test_the_certificate_of_the_configuration_is_trusted_and_no_other(
    closed: tuple[ApiConfig, str], tmp_path: Path
) -> None:
    api, secret = closed
    assert request(api, "/healthz", 20, 1000, CallerCredentials(secret))[0] == 200
    other = make_authority(tmp_path, "other").certificate
    with pytest.raises(ssl.SSLError, match=r"(?i)verify.failed"):
        request(api, "/healthz", 20, 1000, CallerCredentials(secret, other))


def test_a_station_that_asks_for_a_key_is_reported_as_such(closed: tuple[ApiConfig, str]) -> None:
    api, secret = closed
    assert ask(api, CallerCredentials(secret))["state"] == "idle"
    with pytest.raises(InputError, match="--key-file"):
        ask(api)


def test_a_station_that_listens_everywhere_is_asked_on_loopback() -> None:
    everywhere = ApiConfig(host="0.0.0.0", port=1)  # noqa: S104  (an address to connect to)
    assert address_of(everywhere) == ("127.0.0.1", 1)
    assert address_of(ApiConfig(host="10.0.0.1")) == ("10.0.0.1", 8350)
