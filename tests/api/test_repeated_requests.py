"""A command that is repeated with the same Idempotency-Key acts once."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from starlette.types import Message, Send

from vaoi_station.api import repeated_requests
from vaoi_station.api.limits import Caller, set_caller
from vaoi_station.api.repeated_requests import KEEP_S, RepeatedRequests
from vaoi_station.files.access_keys import AccessKey

KEY = '"8e03978e"'


class Service:
    """A service that counts what it does."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.repeated = RepeatedRequests(clock=lambda: self.now_s)
        self.done, self.status, self.size = 0, 200, 0

    async def work(self, send: Send) -> None:
        self.done += 1
        content = f"{self.done}".ljust(self.size).encode()
        await send({"type": "http.response.start", "status": self.status, "headers": []})
        await send({"type": "http.response.body", "body": content})

    async def asked(self, *keys: str, body: bytes = b"", caller: Caller | None = None, **more: Any) -> tuple[int, str]:
        headers = [(b"idempotency-key", key.encode("latin-1")) for key in keys]
        headers += [(name.lower().encode(), value.encode()) for name, value in more.pop("headers", {}).items()]
        scope = {"type": "http", "method": "POST", "path": "/arm", "query_string": b"", "headers": headers, **more}
        set_caller(scope, caller or Caller("192.0.2.1"))
        sent: list[Message] = []

        async def send(message: Message) -> None:
            sent.append(message)

        await self.repeated.serve(scope, body, self.work, send)
        text = b"".join(m.get("body", b"") for m in sent[1:]).decode()
        self.replayed = (b"idempotency-replayed", b"true") in sent[0]["headers"]
        return sent[0]["status"], json.loads(text)["code"] if text.startswith("{") else text.strip()

    def ask(self, *keys: str, **more: Any) -> tuple[int, str]:
        return asyncio.run(self.asked(*keys, **more))


@pytest.fixture
def service() -> Service:
    return Service()


def test_a_command_acts_once_and_its_reply_is_given_again(service: Service) -> None:
    assert (service.ask(KEY), service.replayed) == ((200, "1"), False)
    assert (service.ask(KEY), service.replayed) == ((200, "1"), True)
    assert service.ask("8e03978e") == (200, "1"), "the same key without quotes"
    assert service.ask('"another"') == (200, "2")
    assert service.ask() == (200, "3"), "without a key every command acts"


def test_a_key_belongs_to_one_command(service: Service) -> None:
    service.ask(KEY, body=b"1")
    other: list[dict[str, Any]] = [
        {"body": b"2"}, {"path": "/disarm"}, {"method": "PUT"}, {"query_string": b"runs=1"},
        {"headers": {"If-Match": "x"}},
    ]  # fmt: skip
    for change in other:
        assert service.ask(KEY, **{"body": b"1", **change}) == (422, "key-of-another-request"), change
    assert service.done == 1


def test_a_key_belongs_to_its_caller(service: Service) -> None:
    """Also one whose access key was rotated since is another caller."""
    first, second = (
        AccessKey(name="tester", id=name * 6, scopes=("operate",), sha256="0" * 64, created="2026-01-01T00:00:00Z")
        for name in ("a1", "b2")
    )
    callers = [Caller("192.0.2.1"), Caller("192.0.2.2")]
    callers += [Caller("192.0.2.1", "tester", frozenset(), key) for key in (first, second)]
    assert [service.ask(KEY, caller=caller) for caller in callers] == [(200, str(k)) for k in range(1, 5)]


@pytest.mark.parametrize("status", [404, 409, 500, 503])
def test_a_refused_command_may_be_tried_again(service: Service, status: int) -> None:
    service.status = status
    assert service.ask(KEY)[0] == status
    service.status = 200
    assert service.ask(KEY) == (200, "2")


class SlowService(Service):
    """A service whose command lasts until it may end."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.may_end = asyncio.Event(), asyncio.Event()

    async def work(self, send: Send) -> None:
        self.begun.set()
        await self.may_end.wait()
        await super().work(send)


@pytest.mark.parametrize(("status", "replies"), [(200, [(200, "1")] * 3), (409, [(409, "1"), (409, "2"), (409, "3")])])
def test_a_repetition_waits_for_the_command_under_way(status: int, replies: list[tuple[int, str]]) -> None:
    """If it was refused, one of those that waited acts in its place, and the next one after it."""

    async def three() -> list[tuple[int, str]]:
        service = SlowService()
        service.status = status
        tasks = [asyncio.create_task(service.asked(KEY)) for _ in replies]
        await service.begun.wait()
        other = await service.asked(KEY, body=b"other")
        assert other == (422, "key-of-another-request"), "another command is refused at once"
        service.may_end.set()
        return await asyncio.gather(*tasks)

    assert sorted(asyncio.run(three())) == replies


def test_replies_are_kept_for_a_time_a_number_and_a_size(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    service.ask(KEY)
    service.now_s = KEEP_S + 1
    assert service.ask(KEY) == (200, "2")
    monkeypatch.setattr(repeated_requests, "MOST_OF_CALLER", 3)
    for k in range(3):
        service.ask(f"n{k}")
    assert service.ask(KEY) == (200, "6"), "the oldest went"
    assert service.ask("n2") == (200, "5")
    monkeypatch.setattr(repeated_requests, "MOST_BYTES", 100)
    service.size = 60
    service.ask("big", caller=Caller("192.0.2.9"))
    service.ask("bigger", caller=Caller("192.0.2.8"))
    assert service.ask("big", caller=Caller("192.0.2.9"))[1] == "9"
