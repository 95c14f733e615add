"""What every request passes before the application: one class for each concern, outermost first in `guards`.

- `SafetyHeaders`: pages may load nothing from other sites (Content-Security-Policy); a reply about which no route has
  said anything to caches holds for no other moment.
- `Addressed`: requests to a host name that is not the station's are refused, and so are those whose end or address is
  ambiguous: a proxy and the station could disagree about it, so that the rest would count as a request of another
  caller. The prefix and the caller that a proxy states become those of the request.
- `Audited`: commands and refusals are in the audit log.
- `SameOrigin`: without a check of the Content-Type any web page could send commands from an operator's browser, and an
  image on it could make the station render pictures. Browsers state where a request comes from; programs state nothing.
- `Permitted`: each request needs the scope of its address.
- `HeadAsGet`: a reply to HEAD is that to GET without its body.
- `Streams`: an event stream whose reader has gone ends without an error.
- `Bodies`: bodies are limited in size and time, and in the memory that they take, in total and for each caller. A key
  that appears twice in an object is refused, because JSON readers differ in which value they take. The API accepts JSON
  only, so a body counts as JSON whatever its Content-Type is: the HTTP libraries of LabVIEW, Delphi and C, and curl,
  send none or a wrong one. A command that is repeated with the same Idempotency-Key acts once.
"""

from __future__ import annotations

import asyncio
import json
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from functools import partial
from http import HTTPStatus

import anyio
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vaoi_station.api.access import AccessControl
from vaoi_station.api.addresses import addressed, allowed_names, as_addressed, path_of, prefix_fault, root_of
from vaoi_station.api.limits import Seats, ThreadLimit, caller_in, set_caller
from vaoi_station.api.problems import STREAM, problem_response
from vaoi_station.api.repeated_requests import RepeatedRequests
from vaoi_station.errors import BusyError, InputError
from vaoi_station.files.documents import DuplicateKeyError, refuse_duplicate_keys
from vaoi_station.version import __version__

MAX_BODY_BYTES = 8 * 1024 * 1024
"""Largest accepted body with a board type. One of 20,000 components has about 3 MB."""
MAX_COMMAND_BYTES = 64 * 1024
"""Largest accepted body of all other requests."""
BODIES_OF_CALLER, BODIES = 2 * MAX_BODY_BYTES, 4 * MAX_BODY_BYTES
"""Limits of the bodies that are in memory at the same time, in bytes: of one caller, and in total."""
PIECE_BYTES = 128 * 1024
"""Largest piece in which a reply is passed to its connection, bytes."""
BODY_LIMIT_S = 20.0
"""Longest accepted time until a body has arrived. On a slow network 8 MB take a second."""
SAFE = ("GET", "HEAD", "OPTIONS")
BOARD_TYPE = re.compile(r"/api/v1/board-types/[^/]+")
UPLOAD = "/api/v1/board-data/previews"
"""Path of the uploads of board data. They are written to a file while they arrive, and are no JSON."""
MAX_UPLOAD_BYTES = 128 * 1024 * 1024
"""Largest upload. The largest known design, IPC-2581 case 10, has 59 MB."""
UPLOAD_LIMIT_S = 300.0
"""Longest accepted time until an upload has arrived."""
API = "/api/"
_DECIDING = ("Host", "Origin", "Authorization", "Sec-Fetch-Site", "Sec-Fetch-Mode", "Sec-Fetch-Dest", "Sec-Fetch-User")
"""Headers by which a request is permitted or refused."""
_CLOSE = {"Connection": "close"}
_HEAD = "vaoi.head"

CSP = "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'"
SAFETY = {
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Vaoi-Version": __version__,
}


def guards(names: Iterable[str] = (), access: AccessControl | None = None, root_path: str = "") -> list[Middleware]:
    """Return the classes for an application, outermost first.

    Args:
        names: host names by which the station may be addressed, besides loopback and those of the machine.
        access: keys and audit log; without them every caller may send every request.
        root_path: prefix of paths that a proxy passes on unchanged.
    """
    checked = [Middleware(SafetyHeaders), Middleware(Addressed, names=allowed_names(names), root_path=root_path)]
    if access is None:
        permitted = [Middleware(SameOrigin)]
    else:
        permitted = [Middleware(Audited, access=access), Middleware(SameOrigin), Middleware(Permitted, access=access)]
    return [*checked, *permitted, Middleware(HeadAsGet), Middleware(Streams), Middleware(Bodies)]


def is_head(scope: Scope) -> bool:
    """Return whether a request that is handled as GET was a HEAD, so that the body of its reply is not read."""
    return scope.get(_HEAD) is True


class HttpMiddleware(ABC):
    """Base of the classes: passes on what is no request."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        await (self.handle if scope["type"] == "http" else self.app)(scope, receive, send)

    @abstractmethod
    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""


class SafetyHeaders(HttpMiddleware):
    """Adds security headers to each reply, and passes large ones to their connection piece by piece."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                # A route may set a stricter policy for a document that may contain anything, such as a picture.
                headers.setdefault("Content-Security-Policy", CSP)
                headers.update(SAFETY)
                headers.setdefault("Cache-Control", "no-store")
                if message["status"] == HTTPStatus.NO_CONTENT:
                    del headers["Content-Type"]
            body = message.get("body", b"")
            # Each piece waits until most of the one before was read, so that an unread reply takes little memory.
            while len(body) > PIECE_BYTES:
                await send({**message, "body": body[:PIECE_BYTES], "more_body": True})
                body = body[PIECE_BYTES:]
            await send(message if body is message.get("body", body) else {**message, "body": body})

        await self.app(scope, receive, send_safely)


class Addressed(HttpMiddleware):
    """Refuses requests that do not clearly address the station; notes caller and prefix of the others."""

    def __init__(self, app: ASGIApp, names: frozenset[str], root_path: str) -> None:
        super().__init__(app)
        self._names, self._root_path = names, root_path

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check the headers of a request, then pass it on as its caller has addressed it."""
        headers = Headers(scope=scope)
        fault = _ambiguous(headers) or prefix_fault(scope)
        scope = as_addressed(scope, self._root_path)
        set_caller(scope)
        answer: ASGIApp = self.app
        if fault is not None:
            answer = problem_response(scope, "malformed", fault, headers=_CLOSE)
        elif not addressed(headers.get("host", ""), self._names):
            detail = f"The request was addressed to {headers['host']!r:.100}, which is not a name of this station."
            answer = problem_response(scope, "unknown-host", detail)
        elif not path_of(scope) and scope["method"] in SAFE:
            # The page names its files relative to its own address, which therefore ends with a slash.
            answer = RedirectResponse(f"{root_of(scope)}/", HTTPStatus.TEMPORARY_REDIRECT)
        await answer(scope, receive, send)


class Audited(HttpMiddleware):
    """Notes requests and what became of them in the audit log."""

    def __init__(self, app: ASGIApp, access: AccessControl) -> None:
        super().__init__(app)
        self._access = access

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        begun = time.monotonic()

        async def noting(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._access.note(scope, message["status"], begun)
            await send(message)

        await self.app(scope, receive, noting)


class SameOrigin(HttpMiddleware):
    """Refuses commands from pages of other sites, and everything of the API that such a page would show."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check where a request comes from."""
        headers, answer = Headers(scope=scope), self.app
        if _foreign(headers):
            if scope["method"] not in SAFE:
                page = f"{headers.get('origin', 'another site'):.100}"
                detail = f"The command came from a page of {page}, not from this station's page."
                answer = problem_response(scope, "foreign-origin", detail)
            elif path_of(scope).startswith(API) and not _followed_link(headers):
                detail = "The request came from a page of another site, not from this station's page."
                answer = problem_response(scope, "foreign-origin", detail)
        await answer(scope, receive, send)


class Permitted(HttpMiddleware):
    """Refuses requests whose caller lacks the scope that they need."""

    def __init__(self, app: ASGIApp, access: AccessControl) -> None:
        super().__init__(app)
        self._access = access

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check the key of a request."""
        await (self._access.refusal(scope) or self.app)(scope, receive, send)


class HeadAsGet(HttpMiddleware):
    """Handles HEAD as GET, except for the event stream, which would start and never end."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and drop the body of a reply to HEAD."""
        if scope["method"] != "HEAD" or path_of(scope) == STREAM:
            await self.app(scope, receive, send)
            return

        async def headers_only(message: Message) -> None:
            await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

        await self.app({**scope, "method": "GET", _HEAD: True}, receive, headers_only)


class Streams(HttpMiddleware):
    """Ends an event stream whose reader has disconnected while messages waited for it: FastAPI raises an error then."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if path_of(scope) != STREAM:
            await self.app(scope, receive, send)
            return
        try:
            await self.app(scope, receive, send)
        except* anyio.BrokenResourceError:
            pass


class Bodies(HttpMiddleware):
    """Reads the body of each command within limits, and performs a command that is repeated with its key once."""

    def __init__(self, app: ASGIApp, max_body_bytes: int = MAX_BODY_BYTES, body_limit_s: float = BODY_LIMIT_S) -> None:
        super().__init__(app)
        self._max_body_bytes, self._body_limit_s = max_body_bytes, body_limit_s
        self._bodies = Seats("bytes of requests in memory", BODIES, BODIES_OF_CALLER)
        self._parsing = ThreadLimit(1)
        self._repeated = RepeatedRequests()

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Read the body of a command, then pass it on."""
        if scope["method"] in SAFE:
            await self.app(scope, receive, send)
        elif scope["method"] == "POST" and path_of(scope) == UPLOAD:
            await self._upload(scope, receive, send)
        else:
            await self._command(scope, receive, send)

    async def _upload(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an upload on as it arrives, if it is announced with an accepted size."""
        announced = Headers(scope=scope).get("content-length", "")
        if not announced.isdecimal() or len(announced) > 15 or int(announced) > MAX_UPLOAD_BYTES:
            known = f"{announced:.20} bytes" if announced else "not stated"
            detail = f"The size of the upload (Content-Length) is {known}; it must be at most {MAX_UPLOAD_BYTES} bytes."
            await problem_response(scope, "too-large", detail, headers=_CLOSE)(scope, receive, send)
            return
        deadline = time.monotonic() + UPLOAD_LIMIT_S

        async def receive_in_time() -> Message:
            try:
                async with asyncio.timeout(max(0.0, deadline - time.monotonic())):
                    return await receive()
            except TimeoutError:
                # The connection is closed after the refusal, because the rest of its body was not read.
                late = f"The upload did not arrive within {UPLOAD_LIMIT_S:g} s."
                raise InputError(late, code="upload-too-slow") from None

        performed = False

        async def work(send: Send) -> None:
            nonlocal performed
            performed = True
            await self.app(scope, receive_in_time, send)

        async def send_after_body(message: Message) -> None:
            # A caller whose upload is not performed again still sends it, and would not read the reply before its end.
            if not performed and message["type"] == "http.response.start":
                await _discard(receive_in_time)
            await send(message)

        # The file itself is not compared, because it is not kept: one of the same size is the same command.
        await self._repeated.serve(scope, announced.encode(), work, send_after_body)

    async def _command(self, scope: Scope, receive: Receive, send: Send) -> None:
        limit = self._max_body_bytes if BOARD_TYPE.fullmatch(path_of(scope)) else MAX_COMMAND_BYTES
        announced = Headers(scope=scope).get("content-length", "")
        # More than 15 digits are not converted, since `int` is slow on very long numbers.
        size = int(announced) if announced.isdecimal() and len(announced) <= 15 else limit
        with ExitStack() as memory:
            # Short bodies are not counted, so that large ones cannot prevent a caller's commands.
            if MAX_COMMAND_BYTES < size <= limit:
                try:
                    memory.enter_context(self._bodies.take(caller_in(scope).name, size))
                except BusyError as busy:
                    answer = problem_response(scope, "busy", busy.message, action=busy.action, headers=_CLOSE)
                    await answer(scope, receive, send)
                    return
            body = await self._body(scope, receive, limit)
            if isinstance(body, bytes):
                work = partial(self.app, _as_json(scope), _replay(body, receive))
                await self._repeated.serve(scope, body, work, send)
            else:
                await body(scope, receive, send)

    async def _body(self, scope: Scope, receive: Receive, limit: int) -> bytes | ASGIApp:
        """Return the whole body of a request, or a refusal if the body is too slow, too large or has a repeated key."""
        try:
            async with asyncio.timeout(self._body_limit_s):
                body = await _read(Headers(scope=scope), receive, limit)
        except TimeoutError:
            detail = f"The body did not arrive within {self._body_limit_s:g} s."
            # The rest of the body may still arrive. If the connection stayed open, it would be read as the next
            # request.
            return problem_response(scope, "too-slow", detail, headers=_CLOSE)
        if body is None:
            return problem_response(scope, "too-large", f"The body is larger than {limit} bytes.")
        # A large body is parsed in a thread, so that other requests are answered meanwhile.
        large = len(body) > MAX_COMMAND_BYTES
        twin = await self._parsing.ask(_repeated_key, body) if large else _repeated_key(body)
        return body if twin is None else problem_response(scope, "malformed", f"body: {twin}.")


async def _discard(receive: Receive) -> None:
    """Read the body of a request to its end, or until it is too late."""
    with suppress(InputError):
        while (message := await receive())["type"] != "http.disconnect" and message.get("more_body", False):
            pass


async def _read(headers: Headers, receive: Receive, limit: int) -> bytes | None:
    """Read the whole body; return None if it is larger than `limit` bytes."""
    # If Content-Length is too large, the body is refused before it is read. The header may be wrong, so bytes are
    # counted too.
    announced = headers.get("content-length", "")
    if announced.isdecimal() and (len(announced) > 15 or int(announced) > limit):
        return None
    body = bytearray()
    while True:
        message = await receive()
        body += message.get("body", b"")
        if len(body) > limit:
            return None
        if message["type"] == "http.disconnect" or not message.get("more_body", False):
            return bytes(body)


def _ambiguous(headers: Headers) -> str | None:
    """Return what makes the end or the address of a request ambiguous; None if both are clear."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return "The request has both Content-Length and Transfer-Encoding; send one of them."
    # A proxy may decide by one of them, the station by the other.
    twice = next((name for name in _DECIDING if len(headers.getlist(name)) > 1), None)
    return None if twice is None else f"The request has several headers {twice}; send one."


def _foreign(headers: Headers) -> bool:
    """Return whether a browser states that a request comes from a page of another origin."""
    # With some requests older browsers send Sec-Fetch-Site but no Origin. Programs send neither.
    origin = headers.get("origin")
    if origin is None:
        return headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
    return origin.lower().partition("://")[2] != headers.get("host", "").lower()


def _followed_link(headers: Headers) -> bool:
    """Return whether a browser states that a person followed a link to this address."""
    wanted = {"sec-fetch-mode": "navigate", "sec-fetch-dest": "document", "sec-fetch-user": "?1"}
    return all(headers.get(name) == value for name, value in wanted.items())


def _repeated_key(body: bytes) -> str | None:
    """Return a message if a key appears twice in a JSON object, else None. Other faults are found by later parsing."""
    try:
        json.loads(body, object_pairs_hook=refuse_duplicate_keys)
    except DuplicateKeyError as twin:
        return str(twin)
    except (ValueError, RecursionError):
        return None
    return None


def _as_json(scope: Scope) -> Scope:
    headers = MutableHeaders(raw=list(scope["headers"]))
    headers["content-type"] = "application/json"
    return {**scope, "headers": headers.raw}


def _replay(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` function that delivers the body that was already read, then the messages that follow."""
    pending = [body]

    async def again() -> Message:
        if pending:
            return {"type": "http.request", "body": pending.pop(), "more_body": False}
        return await receive()

    return again
