"""The service as a separate process, over HTTP: refusals and recovery from faults."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx2
import pytest

from vaoi_station.config import StationConfig
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import to_toml
from vaoi_station.demo.waiting import wait_for_run, wait_until_idle
from vaoi_station.errors import BusyError, NotFoundError

TIMEOUT_S = 60.0
Serve = Callable[[StationConfig], Client]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Start a service; after the test it ends in order and leaves nothing in shared memory."""
    with ExitStack() as services:

        def start(config: StationConfig) -> Client:
            path = tmp_path / "station.toml"
            path.write_text(to_toml(config), encoding="utf-8")
            client = Client(services.enter_context(Service(path)).address)
            wait_until_idle(client)
            return client

        yield start
    assert list((tmp_path / "shm").iterdir()) == []


@pytest.fixture
def client(serve: Serve, replay_config: Callable[..., StationConfig]) -> Client:
    """Return a client of a station that replays boards of the small scenario without end."""
    return serve(replay_config(pace="original", pause_s=0.4))


def until(client: Client, kind: str, state: str, after: int = 0, run: str | None = None) -> int:
    """Wait for an event on the stream; return its number."""
    for message in client.messages(after):
        if (message.get("kind"), message.get("state")) == (kind, state) and run in (None, message.get("run")):
            return int(message["number"])
    raise AssertionError("the stream ended")


def problem(client: Client, method: str, path: str, **query: Any) -> dict[str, Any]:
    """Send a request that is refused; return the problem document after a check of its general form."""
    answer = httpx2.request(method, f"{client.address}/api/v1{path}", params=query, timeout=TIMEOUT_S)
    assert answer.headers["content-type"] == "application/problem+json"
    content: dict[str, Any] = answer.json()
    assert content["status"] == answer.status_code
    assert content["detail"].endswith(".")
    assert content["action"].endswith(".")
    return content


def test_arming_again_while_a_board_passes_is_refused_and_the_board_is_filmed(client: Client) -> None:
    client.post("/station/arm", board_type="small", job_id="first")
    until(client, "run", "filming")
    refusal = problem(client, "POST", "/station/arm", board_type="small", job_id="second")
    assert (refusal["status"], refusal["type"]) == (409, "/problems/wrong-state")
    assert refusal["detail"] == "The station is filming; arm is not possible now."
    run = wait_for_run(client, None)
    assert (run["verdict"], run["job_id"], run["counts"]["missing"]) == ("ok", "first", 0)


def test_unknown_board_type_is_refused(client: Client) -> None:
    refusal = problem(client, "POST", "/station/arm", board_type="absent")
    assert (refusal["status"], refusal["code"]) == (404, "unknown-board-type")
    assert "'absent'" in refusal["detail"]
    assert client.get("/station")["state"] == "idle"
    with pytest.raises(NotFoundError, match="absent"):
        client.post("/station/arm", board_type="absent")


def test_killed_worker_is_restarted_and_the_run_is_complete(client: Client) -> None:
    client.post("/station/arm", board_type="small")
    until(client, "run", "filming")
    [killed] = [p["pid"] for p in client.get("/station")["processes"] if p["name"] == "worker 1"]
    os.kill(killed, signal.SIGKILL)
    run = wait_for_run(client, None)
    assert (run["verdict"], run["counts"]) == ("ok", {"ok": 12, "incomplete": 0, "missing": 0}), run["reasons"]
    matrices = client.get(f"/runs/{run['id']}/matrices")
    assert matrices["status"] == "ok"
    [after] = [p for p in client.get("/station")["processes"] if p["name"] == "worker 1"]
    assert after["restarts"] == 1
    assert after["pid"] != killed


def test_arming_is_refused_with_the_holders_names_if_all_bays_are_held(client: Client) -> None:
    client.post("/station/arm", board_type="small")
    seen, held = 0, []
    for holder in ("tester", "review", "archive"):
        seen = until(client, "run", "filming", seen)
        run = client.get("/station")["filming"]
        client.put(f"/runs/{run}/hold", holder=holder, purpose="AOI")
        held.append(run)
    until(client, "station", "blocked", seen)
    client.post("/station/disarm")
    refusal = problem(client, "POST", "/station/arm", board_type="small")
    assert (refusal["status"], refusal["type"]) == (503, "/problems/busy")
    assert all(holder in refusal["detail"] for holder in ("tester", "review", "archive")), refusal
    until(client, "run", "ready", run=held[-1])
    assert all(client.get(f"/runs/{run}")["frames_available"] for run in held)
    with pytest.raises(BusyError, match="tester"):
        client.post("/station/arm", board_type="small")
    client.post(f"/runs/{held[0]}/release")
