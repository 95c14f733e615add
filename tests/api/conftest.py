"""The REST service over a station without cameras: in this process, and behind a real socket."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable, Iterator
from typing import NamedTuple

import httpx2
import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from tests.peers.certificates import Certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.app import create_app
from vaoi_station.api.certificate import CertificateFiles
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.api.web_server import IDLE_S, WebServer, open_listener
from vaoi_station.hermes.service import HermesService


class Served:
    """The application behind a real socket on loopback, and a client for it."""

    def __init__(
        self,
        station: HeldStation,
        port: int = 0,
        access: AccessControl | None = None,
        certificate: Certificate | None = None,
        files: StationFiles | None = None,
        root_path: str = "",
        idle_s: int = IDLE_S,
        line: HermesService | None = None,
    ) -> None:
        self.station = station
        self.app = create_app(station, access=access, files=files, root_path=root_path, line=line)
        self._socket = open_listener("127.0.0.1", port, "test")
        self.port = self._socket.getsockname()[1]
        tls = None if certificate is None else CertificateFiles(*certificate)
        self._server = WebServer(self.app, self._socket, threading.Event().set, tls, idle_s)
        self.url = self._server.address
        self._server.start()
        trusted = True if certificate is None else ssl.create_default_context(cafile=str(certificate.certificate))
        self.client = httpx2.Client(base_url=self.url, timeout=60, verify=trusted)
        self.client.get("/healthz")  # answered as soon as the application has started

    def stop(self) -> None:
        """Close the event log, then the server, as the station does."""
        self.station.close()
        self._server.stop()
        self.client.close()
        self._socket.close()


@pytest.fixture
def station() -> HeldStation:
    return HeldStation()


@pytest.fixture
def client(station: HeldStation) -> Iterator[TestClient]:
    app = create_app(station, ["testserver"])
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def untouched_client() -> Iterator[TestClient]:
    """One client for tests that change nothing, over a station that has filmed no board."""
    app = create_app(HeldStation(), ["testserver"])
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def shared_client() -> Iterator[TestClient]:
    """One client for all examples of a property, over a station that has filmed two boards."""
    station = HeldStation()
    station.film()
    station.film()
    with TestClient(create_app(station, ["testserver"]), raise_server_exceptions=False) as client:
        yield client


class Filmed(NamedTuple):
    """A station that has filmed one board, and one under two lights in turn, for tests that read only."""

    client: TestClient
    station: HeldStation
    run: str
    lit: str
    """The run under the lights left and right."""


@pytest.fixture(scope="module")
def filmed() -> Iterator[Filmed]:
    station = HeldStation()
    run = station.film()
    station.lights = ("left", "right")
    lit = station.film()
    with TestClient(create_app(station, ["testserver"]), raise_server_exceptions=False) as client:
        yield Filmed(client, station, run, lit)


@pytest.fixture
def served(station: HeldStation) -> Iterator[Served]:
    server = Served(station)
    yield server
    server.stop()


@pytest.fixture
def serve() -> Callable[..., Served]:
    """Return the server class, for tests that stop a server themselves."""
    return Served
