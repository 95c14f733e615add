"""The REST service over a station without cameras: in this process, and behind a real socket."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import httpx2
import pytest
import uvicorn
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from vaoi_station.api import create_app


class Served:
    """The application behind a real socket on loopback, and a client for it."""

    def __init__(self, station: HeldStation, port: int = 0) -> None:
        self.station = station
        self.app = create_app(station)
        self._socket = socket.create_server(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        config = uvicorn.Config(self.app, log_level="warning", timeout_graceful_shutdown=5, ws="none")
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True)
        self._thread.start()
        self.client = httpx2.Client(base_url=self.url, timeout=20)
        self.client.get("/healthz")  # answered as soon as the application has started

    def stop(self) -> None:
        """Close the event log, then the server, as the station does."""
        self.station.close()
        self._server.should_exit = True
        self._thread.join(timeout=30)
        self.client.close()
        self._socket.close()


@pytest.fixture
def station() -> HeldStation:
    return HeldStation()


@pytest.fixture
def client(station: HeldStation) -> Iterator[TestClient]:
    with TestClient(create_app(station, ["testserver"]), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def shared_client() -> Iterator[TestClient]:
    """One client for all examples of a property, over a station that has filmed two boards."""
    station = HeldStation()
    station.film()
    station.film()
    with TestClient(create_app(station, ["testserver"]), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def served(station: HeldStation) -> Iterator[Served]:
    server = Served(station)
    yield server
    server.stop()


@pytest.fixture
def serve() -> Callable[..., Served]:
    """Return the server class, for tests that stop a server themselves."""
    return Served
