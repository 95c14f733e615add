"""The service as a separate process, over HTTP: refusals and recovery from faults."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tests.clients import bare_connection, make_plain_calls
from tests.system.conftest import config_of
from vaoi_station.config import ReplayConfig
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import to_toml
from vaoi_station.demo.waiting import wait_until_idle
from vaoi_station.errors import BusyError
from vaoi_station.simulation import Twin

TIMEOUT_S = 150.0


@pytest.fixture(scope="module")
def service(twin: Twin, recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A service that replays boards of the small scenario without end; it ends in order and leaves no shared memory."""
    directory = tmp_path_factory.mktemp("service")
    replay = ReplayConfig(recordings=recordings, pace="original", pause_s=0.4)
    path = directory / "station.toml"
    path.write_text(to_toml(config_of(twin, directory, "replay", replay=replay)), encoding="utf-8")
    with Service(path) as started:
        yield Client(started.address)
    assert list((directory / "shm").iterdir()) == []


@pytest.fixture
def client(service: Client) -> Iterator[Client]:
    """The service, idle before and after each test."""
    wait_until_idle(service)
    yield service
    service.post("/station/disarm")
    assert any(service.get("/station")["state"] == "idle" for _ in service.messages())


def until(client: Client, kind: str, *states: str, after: int, run: str | None = None) -> dict[str, Any]:
    """Wait for an event on the stream that is numbered above `after`."""
    for message in client.messages(after):
        if message.get("kind") == kind and message.get("state") in states and run in (None, message.get("run")):
            return message
    raise AssertionError("the stream ended")


def arm_until_filming(client: Client, **order: str) -> dict[str, Any]:
    """Arm and return the event of the first board that passes."""
    seen = client.get("/station")["last_event"]
    client.post("/station/arm", board_type="small", **order)
    return until(client, "run", "filming", after=seen)


def result_of(client: Client, begun: dict[str, Any]) -> dict[str, Any]:
    """Wait until the run of an event has ended."""
    run: str = begun["run"]
    until(client, "run", "ready", "degraded", "failed", after=begun["number"], run=run)
    document: dict[str, Any] = client.get(f"/runs/{run}")
    return document


def problem(client: Client, method: str, path: str, **query: Any) -> dict[str, Any]:
    """Send a request that is refused; return the problem document after a check of its general form."""
    answer = httpx2.request(method, f"{client.address}/api/v1{path}", params=query, timeout=TIMEOUT_S)
    assert answer.headers["content-type"] == "application/problem+json"
    content: dict[str, Any] = answer.json()
    assert content["status"] == answer.status_code
    assert content["detail"].endswith(".")
    assert content["action"].endswith(".")
    return content


def test_the_calls_for_labview_work_over_a_bare_connection(client: Client) -> None:
    with bare_connection(client.address) as connection:
        answers = make_plain_calls(connection, "small")
    assert {call: a.status for call, a in answers.items()} == dict.fromkeys(answers, 200)
    assert len(answers) == 11
    [raw] = [a for call, a in answers.items() if call.endswith("format=raw")]
    assert len(raw.body) == int(raw.headers["x-image-width"]) * int(raw.headers["x-image-height"])
    assert any(a.body.startswith(b"\x89PNG") for a in answers.values())


def test_arming_is_refused_with_the_holders_names_if_all_bays_are_held(client: Client) -> None:
    begun, held = arm_until_filming(client), list[str]()
    for holder in ("tester", "review", "archive"):
        if held:
            begun = until(client, "run", "filming", after=begun["number"])
        client.act("PUT", f"/runs/{begun['run']}/hold", holder=holder, purpose="AOI")
        held.append(begun["run"])
    until(client, "station", "blocked", after=begun["number"])
    client.post("/station/disarm")
    refusal = problem(client, "POST", "/station/arm", board_type="small")
    assert (refusal["status"], refusal["type"]) == (503, "/problems/busy")
    assert all(holder in refusal["detail"] for holder in ("tester", "review", "archive")), refusal
    assert result_of(client, begun)["state"] == "ready"
    assert all(client.get(f"/runs/{run}")["frames_available"] for run in held)
    with pytest.raises(BusyError, match="tester"):
        client.post("/station/arm", board_type="small")
    refusal = problem(client, "POST", f"/runs/{held[0]}/release")
    assert (refusal["status"], refusal["code"]) == (409, "held")
    for run, holder in zip(held, ("tester", "review", "archive"), strict=True):
        client.post(f"/runs/{run}/release?holder={holder}")
