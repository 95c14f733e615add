"""Commands that a caller repeats with the same `Idempotency-Key`: they act once, and the reply is given again.

A program that gets no reply does not know whether its command took effect. It sends the command again with the same
key (draft-ietf-httpapi-idempotency-key-header). Replies of success are kept, because a refused command changed nothing
and may be tried again. A command that is repeated while the first one is under way waits for the reply to the first.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from starlette.datastructures import Headers
from starlette.types import Message, Scope, Send

from vaoi_station.api.limits import caller_in
from vaoi_station.api.problems import problem_response

HEADER, REPLAYED = "Idempotency-Key", "Idempotency-Replayed"
KEEP_S = 3600.0
"""Time for which the reply to a command is kept, s."""
WAIT_S = 10.0
"""Longest time for which a repeated command waits for the first one, s."""
MOST_OF_CALLER, MOST_BYTES, MOST_BYTES_OF_CALLER = 200, 16 * 2**20, 2 * 2**20
"""Number of commands of one caller, and total size of all replies in bytes, that are kept; the oldest go first."""
_MOST_CALLERS = 64
_KEY = re.compile(r'"[\x20-\x21\x23-\x5b\x5d-\x7e]{1,200}"|[\x21\x23-\x2b\x2d-\x3a\x3c-\x5b\x5d-\x7e]{1,200}')
"""A key: a text in quotes, as the draft defines it, or the same without quotes."""

Work = Callable[[Send], Awaitable[None]]
"""Function that performs a request, and sends its reply by the given function."""


class _Name(NamedTuple):
    caller: tuple[str, str]
    key: str


@dataclass
class _Kept:
    """A command under its key: what it asked, when it began, and its reply as soon as there is one."""

    fingerprint: bytes
    since_s: float
    reply: list[Message] = field(default_factory=list)
    size: int = 0
    ended: asyncio.Event = field(default_factory=asyncio.Event)


class RepeatedRequests:
    """The replies to commands with a key. Used from the event loop only."""

    def __init__(self, keep_s: float = KEEP_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._keep_s, self._clock = keep_s, clock
        self._kept: OrderedDict[_Name, _Kept] = OrderedDict()

    async def serve(self, scope: Scope, body: bytes, work: Work, send: Send) -> None:
        """Perform a command, or give the reply of the same command again.

        Args:
            scope: the request, whose caller is known.
            body: its body.
            work: performs the command.
            send: sends the reply.
        """
        given = Headers(scope=scope).getlist(HEADER)
        if not given:
            await work(send)
            return
        if len(given) > 1 or not _KEY.fullmatch(given[0]):
            detail = f"{HEADER} is {given[0]!r:.80}, but must be one text in quotes of 1 to 200 ASCII characters."
            await problem_response(scope, "malformed", detail)(scope, _no_body, send)
            return
        self._forget_old()
        name = _Name(_identity(scope), given[0].strip('"'))
        fingerprint = _fingerprint(scope, body)
        known = await self._ended(name, fingerprint)
        if known is None:
            await self._perform(name, _Kept(fingerprint, self._clock()), work, send)
        elif known.fingerprint != fingerprint:
            detail = f"{HEADER} {name.key!r:.80} was sent before with another command or other values."
            answer = problem_response(scope, code="key-of-another-request", detail=detail, status=422, action=_NEW_KEY)
            await answer(scope, _no_body, send)
        elif not known.reply:
            detail = f"The command with {HEADER} {name.key!r:.80} is still under way."
            answer = problem_response(scope, code="request-under-way", detail=detail, status=409, action=_AGAIN)
            await answer(scope, _no_body, send)
        else:
            for message in known.reply:
                await send(message)

    async def _ended(self, name: _Name, fingerprint: bytes) -> _Kept | None:
        """Return the command of a key, as soon as it has ended or `WAIT_S` later; None if a command is to be performed.

        A command that was refused leaves its key: of those that waited for it, one takes its place.
        """
        until_s = asyncio.get_running_loop().time() + WAIT_S
        while (known := self._kept.get(name)) is not None and known.fingerprint == fingerprint and not known.reply:
            try:
                async with asyncio.timeout_at(until_s):
                    await known.ended.wait()
            except TimeoutError:
                return known
        return known

    async def _perform(self, name: _Name, kept: _Kept, work: Work, send: Send) -> None:
        self._kept[name] = kept
        messages: list[Message] = []

        async def keeping(message: Message) -> None:
            messages.append(message)
            await send(message)

        try:
            await work(keeping)
        finally:
            # Also if the caller has gone: it will repeat the command, which has taken effect.
            if messages and messages[0].get("status", 500) < 300 and not messages[-1].get("more_body"):
                start = {**messages[0], "headers": [*messages[0]["headers"], (REPLAYED.lower().encode(), b"true")]}
                kept.reply = [start, *messages[1:]]
                kept.size = sum(len(m.get("body", b"")) for m in messages)
                self._make_room(name.caller)
            else:
                del self._kept[name]
            kept.ended.set()

    def _forget_old(self) -> None:
        now_s = self._clock()
        for name, kept in list(self._kept.items()):
            if now_s - kept.since_s > self._keep_s and kept.reply:
                del self._kept[name]

    def _make_room(self, caller: tuple[str, str]) -> None:
        """Forget the oldest replies: of this caller beyond its number and size, of all beyond their size."""
        own = [name for name, kept in self._kept.items() if name.caller == caller and kept.reply]
        spent = sum(self._kept[name].size for name in own)
        for left, name in zip(range(len(own), 0, -1), own, strict=True):
            if left <= MOST_OF_CALLER and spent <= MOST_BYTES_OF_CALLER:
                break
            spent -= self._kept.pop(name).size
        done = [name for name, kept in self._kept.items() if kept.reply]
        spare = len(done) - _MOST_CALLERS * MOST_OF_CALLER
        size = sum(kept.size for kept in self._kept.values())
        for name in done:
            if size <= MOST_BYTES and spare <= 0:
                break
            size, spare = size - self._kept[name].size, spare - 1
            del self._kept[name]


_NEW_KEY = "Send a new key with every new command, and the same key only to repeat one."
_AGAIN = "Send the same command with the same key again: the station then waits for the reply."


def _identity(scope: Scope) -> tuple[str, str]:
    """Return by whom a command was sent: a key that was rotated since is another caller."""
    caller = caller_in(scope)
    return caller.name, "" if caller.access_key is None else caller.access_key.id


def _fingerprint(scope: Scope, body: bytes) -> bytes:
    asked = hashlib.sha256()
    for part in (scope["method"].encode(), scope["path"].encode(), scope["query_string"], body):
        asked.update(len(part).to_bytes(8, "big"))
        asked.update(part)
    # A change under another condition is another command.
    headers = Headers(scope=scope)
    for name in ("if-match", "if-none-match"):
        asked.update(f"{name}:{headers.get(name, '')}\n".encode())
    return asked.digest()


async def _no_body() -> Message:
    return {"type": "http.request", "body": b"", "more_body": False}
