"""Server-sent events over a real connection."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import pytest

from tests.api.held_station import HeldStation


def messages(response: Any) -> Iterator[dict[str, str]]:
    """Parse the stream as a browser does: fields up to an empty line; comments are skipped."""
    fields: dict[str, str] = {}
    for line in response.iter_lines():
        if not line:
            if fields:
                yield fields
            fields = {}
        elif not line.startswith(":"):
            name, _, value = line.partition(":")
            fields[name] = value.removeprefix(" ")


def news(response: Any, count: int) -> list[dict[str, Any]]:
    found = (m for m in messages(response) if m.get("event") != "heartbeat")
    return [{"id": int(m["id"]), **json.loads(m["data"])} for m in islice(found, count)]


def test_events_arrive_in_order_with_their_numbers(served: Any) -> None:
    with served.client.stream("GET", "/api/v1/events") as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        stream = messages(response)
        assert next(stream)["event"] == "heartbeat"
        run = served.station.film()
        first, second = (json.loads(m["data"]) for m in islice(stream, 2))
    assert (first["number"], first["state"], first["run"]) == (1, "stitching", run)
    assert (second["number"], second["state"], second["run"]) == (2, "ready", run)


@pytest.mark.parametrize("header", [True, False])
def test_a_client_resumes_after_its_last_event(served: Any, header: bool) -> None:
    for _ in range(3):
        served.station.film()
    asked = {"headers": {"Last-Event-ID": "2"}} if header else {"params": {"after": 2}}
    with served.client.stream("GET", "/api/v1/events", **asked) as response:
        assert [m["id"] for m in news(response, 4)] == [3, 4, 5, 6]


def test_heartbeats_come_without_events(served: Any) -> None:
    with served.client.stream("GET", "/api/v1/events") as response:
        beats = list(islice(messages(response), 2))
    assert [b["event"] for b in beats] == ["heartbeat", "heartbeat"]
    assert json.loads(beats[1]["data"])["state"] == "idle"
    assert "id" not in beats[1]


def test_streams_end_when_the_station_stops(served: Any) -> None:
    with served.client.stream("GET", "/api/v1/events") as response:
        stream = messages(response)
        next(stream)
        served.station.publish("station", "Stopping.", state="stopping")
        assert [json.loads(m["data"])["state"] for m in stream] == ["stopping"]


def test_too_many_streams_are_refused_before_the_first_header(served: Any) -> None:
    served.app.state.hub.streams._per_caller = 1
    with served.client.stream("GET", "/api/v1/events") as response:
        stream = messages(response)
        assert next(stream)["event"] == "heartbeat"
        refused = served.client.get("/api/v1/events")
        assert (refused.status_code, refused.json()["code"]) == (503, "busy")
        assert refused.headers["content-type"] == "application/problem+json"
        assert served.app.state.hub.waiting == 1


def test_a_reader_that_goes_without_having_read_is_no_incident(
    station: HeldStation, serve: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(800):
        station.publish("test", "x" * 20_000)
    with caplog.at_level(logging.ERROR):
        served = serve(station)
        with socket.create_connection(("127.0.0.1", served.port)) as reader:
            reader.sendall(b"GET /api/v1/events?after=0 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            # Megabytes more wait than the sockets hold, so that the stream waits for its reader when it goes.
            assert sum(len(reader.recv(4096)) for _ in range(200)) > 100_000
        while served.app.state.hub.waiting:
            assert served.client.get("/api/v1/runs").status_code == 200
        served.stop()  # its requests have ended then
    assert not caplog.records, caplog.text
