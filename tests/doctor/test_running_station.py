"""Find the running station, and ask it."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.doctor.conftest import assert_problem, at_port
from tests.peers.certificates import make_authority, make_certificate
from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.config import ApiConfig, StationConfig
from vaoi_station.doctor import running_station
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext, RunningProcess, ask, request
from vaoi_station.errors import InputError
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials


@pytest.fixture
def owned(config: StationConfig) -> Iterator[StationConfig]:
    """The configuration while this process owns its ring."""
    with Ring.create(ring_path(config), RingLayout.of(config)):
        yield config


@contextmanager
def replying(status: int, body: bytes) -> Iterator[int]:
    """Serve the same reply to every request, at the port that is returned."""

    class Handler(ScriptedHandler):
        def do_GET(self) -> None:  # noqa: N802  (the name is that of the base class)
            self.send(status, body)

    with serving(Handler) as address:
        yield int(address.rpartition(":")[2])


@pytest.mark.parametrize(
    ("status", "body"), [(200, b"hello"), (404, b'{"state": "idle"}'), (200, b"[]"), (200, b'{"status": "ok"}')]
)
def test_reply_of_another_program_is_not_taken_for_a_station(owned: StationConfig, status: int, body: bytes) -> None:
    with replying(status, body) as port:
        found = running_station.find(at_port(owned, port))
    assert found is not None
    assert found.no_reply_reason.startswith(("ValueError", "JSONDecodeError"))


def test_reasons_and_warnings_of_the_station_become_findings(config: StationConfig) -> None:
    snapshot = {
        "state": "faulted",
        "reasons": [{"code": "camera-absent", "message": "camera left is absent.", "action": "Check its cable."}],
        "warnings": [{"code": "calibration-drift", "message": "camera right has moved.", "action": "Calibrate."}],
    }
    state, fault, warning = running_station.station(CheckContext(config, Machine(), RunningProcess(4711, snapshot)))
    assert state.level is Level.OK
    assert_problem(fault, Level.FAULT, "camera left is absent")
    assert fault.subject == "camera-absent"
    assert_problem(warning, Level.WARNING, "camera right has moved")


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
