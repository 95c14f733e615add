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
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

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
_MOST = 64 * MOST_OF_CALLER
_KEY = re.compile(r'"[\x20-\x21\x23-\x5b\x5d-\x7e]{1,200}"|[\x21\x23-\x2b\x2d-\x3a\x3c-\x5b\x5d-\x7e]{1,200}')
"""A key: a text in quotes, as the draft defines it, or the same without quotes."""

Work = Callable[[Send], Awaitable[None]]
"""Function that performs a request, and sends its reply by the given function."""
Name = tuple[str, str, str]
"""Name of the caller, id of its access key (one that was rotated since is another caller), and key of the command."""


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
        self._kept: dict[Name, _Kept] = {}

    async def serve(self, scope: Scope, body: bytes, work: Work, send: Send) -> None:
        """Perform a command with this body by `work`, or give the reply of the same command again."""
        given = Headers(scope=scope).getlist(HEADER)
        if not given:
            await work(send)
            return
        if len(given) > 1 or not _KEY.fullmatch(given[0]):
            detail = f"{HEADER} is {given[0]!r:.80}, but must be one text in quotes of 1 to 200 ASCII characters."
            await problem_response(scope, "malformed", detail)(scope, _no_body, send)
            return
        now_s = self._clock()
        self._forget(lambda kept: now_s - kept.since_s > self._keep_s)
        caller, key = caller_in(scope), given[0].strip('"')
        name = caller.name, caller.access_key.id if caller.access_key else "", key
        fingerprint = _fingerprint(scope, body)
        known = await self._ended(name, fingerprint)
        if known is None:
            await self._perform(name, _Kept(fingerprint, now_s), work, send)
        elif known.reply and known.fingerprint == fingerprint:
            for message in known.reply:
                await send(message)
        elif known.fingerprint != fingerprint:
            detail = f"{HEADER} {key!r:.80} was sent before with another command or other values."
            action = "Send a new key with every new command, and the same key only to repeat one."
            answer = problem_response(scope, code="key-of-another-request", detail=detail, status=422, action=action)
            await answer(scope, _no_body, send)
        else:
            detail = f"The command with {HEADER} {key!r:.80} is still under way."
            action = "Send the same command with the same key again: the station then waits for the reply."
            answer = problem_response(scope, code="request-under-way", detail=detail, status=409, action=action)
            await answer(scope, _no_body, send)

    async def _ended(self, name: Name, fingerprint: bytes) -> _Kept | None:
        """Return the command of a key, as soon as it has ended or `WAIT_S` later; None if a command is to be performed.

        A command that was refused leaves its key: of those that waited for it, one takes its place.
        """
        known = None
        try:
            async with asyncio.timeout(WAIT_S):
                while (known := self._kept.get(name)) and known.fingerprint == fingerprint and not known.reply:
                    await known.ended.wait()
        except TimeoutError:
            pass
        return known

    async def _perform(self, name: Name, kept: _Kept, work: Work, send: Send) -> None:
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
                self._make_room(lambda other: other[:2] == name[:2], MOST_OF_CALLER, MOST_BYTES_OF_CALLER)
                self._make_room(lambda _: True, _MOST, MOST_BYTES)
            else:
                del self._kept[name]
            kept.ended.set()

    def _forget(self, is_old: Callable[[_Kept], bool]) -> None:
        self._kept = {name: kept for name, kept in self._kept.items() if not kept.reply or not is_old(kept)}

    def _make_room(self, counts: Callable[[Name], bool], most: int, most_bytes: int) -> None:
        """Forget the oldest replies among those that count, until number and size are within their limits."""
        done = [name for name, kept in self._kept.items() if kept.reply and counts(name)]
        size = sum(self._kept[name].size for name in done)
        for left, name in zip(range(len(done), 0, -1), done, strict=True):
            if left <= most and size <= most_bytes:
                break
            size -= self._kept.pop(name).size


def _fingerprint(scope: Scope, body: bytes) -> bytes:
    headers = Headers(scope=scope)
    # A change under another condition is another command.
    conditions = "".join(f"{name}:{headers.get(name, '')}\n" for name in ("if-match", "if-none-match"))
    asked = hashlib.sha256()
    for part in (scope["method"].encode(), scope["path"].encode(), scope["query_string"], body, conditions.encode()):
        asked.update(len(part).to_bytes(8, "big"))
        asked.update(part)
    return asked.digest()


async def _no_body() -> Message:
    return {"type": "http.request", "body": b"", "more_body": False}
