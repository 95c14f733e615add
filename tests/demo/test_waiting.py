"""Wait for a station that is slow, faulted, or faster than the caller."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.demo import waiting
from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError

FAULT = {"state": "faulted", "reasons": [{"message": "Camera 0 is lost.", "action": "Check its cable."}]}


class Station(Client):
    """Client with a list of scripted replies per path; the last reply is repeated."""

    def __init__(self, **answers: list[Any]) -> None:
        super().__init__("http://station")
        self.answers = {f"/{name.replace('_', '/')}": list(reversed(given)) for name, given in answers.items()}
        self.asked: list[tuple[str, dict[str, Any]]] = []

    def get(self, path: str, **query: Any) -> Any:
        self.asked.append((path, query))
        given = self.answers[path]
        answer = given.pop() if len(given) > 1 else given[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    def messages(self, after: int = 0) -> Iterator[dict[str, Any]]:
        while True:
            yield {}


def test_faulted_station_is_an_error_with_its_reasons() -> None:
    with pytest.raises(DeviceError, match=r"faulted. Camera 0 is lost. Check its cable."):
        waiting.wait_until_idle(Station(station=[FAULT]))


def test_station_that_is_never_ready_is_an_error_that_says_what_it_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "START_S", -1.0)
    with pytest.raises(DeviceError, match="not ready"):
        waiting.wait_until_idle(Station(station=[{"state": "starting"}]))
    with pytest.raises(DeviceError, match=r"not ready, without progress for -1 s. 3 of 69 loops. Wait.$"):
        waiting.wait_until_idle(Station(station=[compiled(3)]))


def test_a_start_that_makes_progress_is_awaited_and_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine the workers compile for longer than the limit without progress."""
    now = [0.0]
    monkeypatch.setattr(waiting, "time", SimpleNamespace(monotonic=lambda: now[0]))

    class Slow(Station):
        def messages(self, after: int = 0) -> Iterator[dict[str, Any]]:
            for message in super().messages(after):
                now[0] += 0.7 * waiting.START_S
                yield message

    said: list[str] = []
    waiting.wait_until_idle(Slow(station=[*(compiled(n) for n in range(1, 6)), {"state": "idle"}]), said.append)
    assert said == [f"The station is starting. {n} of 69 loops. Wait." for n in range(1, 6)]
    with pytest.raises(DeviceError, match="5 of 69"):
        waiting.wait_until_idle(Slow(station=[compiled(5)]))


def compiled(loops: int) -> dict[str, Any]:
    warning = {"code": "workers-starting", "message": f"{loops} of 69 loops.", "action": "Wait."}
    return {"state": "starting", "warnings": [warning]}
