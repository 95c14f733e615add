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
from vaoi_station.api.event_hub import EVENTS_AT_ONCE
from vaoi_station.api.limits import Seats
from vaoi_station.runs.states.schemas import EventRecord


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


def test_a_long_log_is_read_in_parts(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream that is not read keeps no more than one part of the log in memory."""
    station, parts = served.station, []
    for number in range(2 * EVENTS_AT_ONCE + 1):
        station.publish("trouble", str(number), code="cable")

    def read(after: int, timeout_s: float, limit: int = 1000) -> tuple[EventRecord, ...]:
        records = HeldStation.events(station, after, timeout_s, limit)
        parts.append(len(records) if timeout_s == 0 else 0)
        return records

    monkeypatch.setattr(station, "events", read)
    with served.client.stream("GET", "/api/v1/events", params={"after": 0}) as response:
        assert [m["id"] for m in news(response, len(station.log))] == list(range(1, len(station.log) + 1))
    assert max(parts) == EVENTS_AT_ONCE


def test_the_header_has_precedence_over_the_query(served: Any) -> None:
    served.station.film()
    served.station.film()
    headers = {"Last-Event-ID": "3"}
    with served.client.stream("GET", "/api/v1/events", params={"after": 0}, headers=headers) as response:
        assert [m["id"] for m in news(response, 1)] == [4]


def test_a_number_beyond_the_newest_starts_at_the_newest(served: Any) -> None:
    served.station.film()
    with served.client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": "9000"}) as response:
        stream = messages(response)
        assert json.loads(next(stream)["data"])["last_event"] == 2
        served.station.film()
        assert next(stream)["id"] == "3"


def test_heartbeats_come_without_events(served: Any) -> None:
    with served.client.stream("GET", "/api/v1/events") as response:
        beats = list(islice(messages(response), 2))
    assert [b["event"] for b in beats] == ["heartbeat", "heartbeat"]
    assert json.loads(beats[1]["data"])["state"] == "idle"
    assert "id" not in beats[1]


@pytest.mark.parametrize("wrong", ["x", "-1", "1.5", "9" * 40])
def test_an_invalid_event_id_is_refused(client: Any, wrong: str) -> None:
    answer = client.get("/api/v1/events", headers={"Last-Event-ID": wrong})
    assert answer.status_code == 422
    assert "Last-Event-ID" in answer.json()["detail"]


def test_streams_end_when_the_station_stops(served: Any) -> None:
    with served.client.stream("GET", "/api/v1/events") as response:
        stream = messages(response)
        next(stream)
        served.station.publish("station", "Stopping.", state="stopping")
        assert [json.loads(m["data"])["state"] for m in stream] == ["stopping"]


def test_too_many_streams_are_refused_before_the_first_header(served: Any) -> None:
    served.app.state.hub.streams = Seats("event streams", 1, 1)
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


def test_a_refused_stream_asks_nothing_of_the_coordinator(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A flood of streams over the limit costs the thread that decides for the line no time."""
    asked, snapshot = [], served.station.snapshot

    def count() -> Any:
        asked.append(1)
        return snapshot()

    monkeypatch.setattr(served.station, "snapshot", count)
    monkeypatch.setattr(served.app.state.hub, "streams", Seats("event streams", 1, 0))
    assert served.client.get("/api/v1/events").status_code == 503
    assert asked == []
