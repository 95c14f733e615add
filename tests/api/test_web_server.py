"""A web server in a thread: it serves, stops, and reports an unexpected end."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import httpx2
import pytest
from fastapi import FastAPI

from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.errors import DeviceError, InternalError


@pytest.fixture
def ended() -> threading.Event:
    return threading.Event()


@pytest.fixture
def server(ended: threading.Event) -> Iterator[WebServer]:
    app = FastAPI()
    app.get("/")(lambda: "served")
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        made = WebServer(app, listener, ended.set)
        made.start()
        yield made
        made.stop()


def test_it_serves_at_its_address_until_it_is_stopped(server: WebServer, ended: threading.Event) -> None:
    assert httpx2.get(server.address, timeout=20).json() == "served"
    assert not ended.is_set()
    server.stop()
    assert ended.wait(20)
    server.check()


# uvicorn ends its thread with SystemExit when the application does not start.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_unexpected_end_is_reported(ended: threading.Event) -> None:
    app = FastAPI(on_startup=[lambda: 1 / 0])
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set)
        server.start()
        assert ended.wait(20)
        with pytest.raises(InternalError, match="ended unexpectedly"):
            server.check()
        server.stop()


def test_a_port_in_use_is_refused_with_the_source_of_the_address() -> None:
    with open_listener("127.0.0.1", 0, "--port") as listener:
        port = listener.getsockname()[1]
        with pytest.raises(DeviceError, match=f"--port: cannot listen on 127.0.0.1 port {port}") as refusal:
            open_listener("127.0.0.1", port, "--port")
    assert "another port" in refusal.value.action
