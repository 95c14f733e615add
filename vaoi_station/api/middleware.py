"""What every request passes before the application, in three steps (`guards`).

1. `Addressed`: requests to a host name that is not the station's are refused, and so are those whose end or address is
   ambiguous: a proxy and the station could disagree about it, so that the rest would count as a request of another
   caller. The prefix and the caller that a proxy states become those of the request. Replies get security headers:
   pages may load nothing from other sites, and a reply about which no route says anything to caches is not kept.
2. `Permitted`: commands and refusals are in the audit log. Without a check of the Content-Type any web page could send
   commands from an operator's browser, and an image on it could make the station render pictures: browsers state where
   a request comes from, programs state nothing. Each request needs the scope of its address.
3. `Bodies`: bodies are limited in size and time, and in the memory that they take, in total and for each caller. A key
   that appears twice in an object is refused, because JSON readers differ in which value they take. The API accepts
   JSON only, so a body counts as JSON whatever its Content-Type is: the HTTP libraries of LabVIEW, Delphi and C, and
   curl, send none or a wrong one. A command that is repeated with the same Idempotency-Key acts once. A reply to HEAD
   is that to GET without its body, and an event stream whose reader has gone ends without an error.
"""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from functools import partial
from http import HTTPStatus

import anyio
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vaoi_station.api.access import AccessControl
from vaoi_station.api.addresses import addressed, allowed_names, as_addressed, path_of, prefix_fault, root_of
from vaoi_station.api.limits import Seats, ThreadLimit, caller_in, set_caller
from vaoi_station.api.problems import SAFE, STREAM, problem_response
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
_LINK = {"sec-fetch-mode": "navigate", "sec-fetch-dest": "document", "sec-fetch-user": "?1"}
"""Headers of a browser in which a person followed a link to the address."""

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
    return [
        Middleware(Addressed, names=allowed_names(names), root_path=root_path),
        Middleware(Permitted, access=access),
        Middleware(Bodies),
    ]


def is_head(scope: Scope) -> bool:
    """Return whether a request that is handled as GET was a HEAD, so that the body of its reply is not read."""
    return scope.get(_HEAD) is True


class Addressed:
    """Refuses requests that do not clearly address the station; notes caller and prefix of the others."""

    def __init__(self, app: ASGIApp, names: frozenset[str], root_path: str) -> None:
        self._app, self._names, self._root_path = app, names, root_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        fault = _ambiguous(headers) or prefix_fault(scope)
        scope = as_addressed(scope, self._root_path)
        set_caller(scope)
        answer: ASGIApp = self._app
        if fault is not None:
            answer = problem_response(scope, "malformed", fault, headers=_CLOSE)
        elif not addressed(headers.get("host", ""), self._names):
            detail = f"The request was addressed to {headers['host']!r:.100}, which is not a name of this station."
            answer = problem_response(scope, "unknown-host", detail)
        elif not path_of(scope) and scope["method"] in SAFE:
            # The page names its files relative to its own address, which therefore ends with a slash.
            answer = RedirectResponse(f"{root_of(scope)}/", HTTPStatus.TEMPORARY_REDIRECT)
        await answer(scope, receive, partial(_send_safely, send))


async def _send_safely(send: Send, message: Message) -> None:
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
    await send({**message, "body": body} if "body" in message else message)


def _ambiguous(headers: Headers) -> str | None:
    """Return what makes the end or the address of a request ambiguous; None if both are clear."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return "The request has both Content-Length and Transfer-Encoding; send one of them."
    # A proxy may decide by one of them, the station by the other.
    twice = next((name for name in _DECIDING if len(headers.getlist(name)) > 1), None)
    return None if twice is None else f"The request has several headers {twice}; send one."


class Permitted:
    """Refuses requests of pages of other sites, and those whose caller lacks the scope; keeps the audit log."""

    def __init__(self, app: ASGIApp, access: AccessControl | None) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        access, begun = self._access, time.monotonic()
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def noting(message: Message) -> None:
            if access is not None and message["type"] == "http.response.start":
                access.note(scope, message["status"], begun)
            await send(message)

        refusal = _of_another_site(scope) or (access.refusal(scope) if access else None)
        await (refusal or self._app)(scope, receive, noting)


def _of_another_site(scope: Scope) -> Response | None:
    """Return the refusal of a command from a page of another site, or of anything of the API that it would show."""
    headers = Headers(scope=scope)
    # With some requests older browsers send Sec-Fetch-Site but no Origin. Programs send neither.
    origin = headers.get("origin")
    if origin is None:
        foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
    else:
        foreign = origin.lower().partition("://")[2] != headers.get("host", "").lower()
    if not foreign:
        return None
    if scope["method"] not in SAFE:
        page = f"{headers.get('origin', 'another site'):.100}"
        detail = f"The command came from a page of {page}, not from this station's page."
        return problem_response(scope, "foreign-origin", detail)
    if path_of(scope).startswith(API) and any(headers.get(name) != value for name, value in _LINK.items()):
        detail = "The request came from a page of another site, not from this station's page."
        return problem_response(scope, "foreign-origin", detail)
    return None


class Bodies:
    """Reads the body of each command within limits, and performs a command that is repeated with its key once."""

    def __init__(self, app: ASGIApp, max_body_bytes: int = MAX_BODY_BYTES, body_limit_s: float = BODY_LIMIT_S) -> None:
        self._app, self._max_body_bytes, self._body_limit_s = app, max_body_bytes, body_limit_s
        self._bodies = Seats("bytes of requests in memory", BODIES, BODIES_OF_CALLER)
        self._parsing = ThreadLimit(1)
        self._repeated = RepeatedRequests()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif path_of(scope) == STREAM and scope["method"] in SAFE:
            # FastAPI raises an error if the reader has disconnected while messages waited for it.
            try:
                await self._app(scope, receive, send)
            except* anyio.BrokenResourceError:
                pass
        elif scope["method"] == "HEAD":

            async def headers_only(message: Message) -> None:
                await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

            await self._app({**scope, "method": "GET", _HEAD: True}, receive, headers_only)
        elif scope["method"] in SAFE:
            await self._app(scope, receive, send)
        elif scope["method"] == "POST" and path_of(scope) == UPLOAD:
            await self._upload(scope, receive, send)
        else:
            await self._command(scope, receive, send)

    async def _upload(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an upload on as it arrives, if it is announced with an accepted size."""
        announced = Headers(scope=scope).get("content-length", "")
        if (size := _size(announced)) is None or size > MAX_UPLOAD_BYTES:
            known = f"{announced:.20} bytes" if announced else "not stated"
            detail = f"The size of the upload (Content-Length) is {known}; it must be at most {MAX_UPLOAD_BYTES} bytes."
            await problem_response(scope, "too-large", detail, headers=_CLOSE)(scope, receive, send)
            return
        deadline = asyncio.get_running_loop().time() + UPLOAD_LIMIT_S

        async def receive_in_time() -> Message:
            try:
                async with asyncio.timeout_at(deadline):
                    return await receive()
            except TimeoutError:
                # The connection is closed after the refusal, because the rest of its body was not read.
                late = f"The upload did not arrive within {UPLOAD_LIMIT_S:g} s."
                raise InputError(late, code="upload-too-slow") from None

        performed = False

        async def work(send: Send) -> None:
            nonlocal performed
            performed = True
            await self._app(scope, receive_in_time, send)

        async def send_after_body(message: Message) -> None:
            # A caller whose upload is not performed again still sends it, and would not read the reply before its end.
            if not performed and message["type"] == "http.response.start":
                with suppress(InputError):
                    while (await receive_in_time()).get("more_body", False):
                        pass
            await send(message)

        # The file itself is not compared, because it is not kept: one of the same size is the same command.
        await self._repeated.serve(scope, announced.encode(), work, send_after_body)

    async def _command(self, scope: Scope, receive: Receive, send: Send) -> None:
        limit = self._max_body_bytes if BOARD_TYPE.fullmatch(path_of(scope)) else MAX_COMMAND_BYTES
        announced = Headers(scope=scope).get("content-length", "")
        size = _size(announced)
        with ExitStack() as memory:
            try:
                # Short bodies are not counted, so that large ones cannot prevent a caller's commands.
                if MAX_COMMAND_BYTES < (limit if size is None else size) <= limit:
                    memory.enter_context(self._bodies.take(caller_in(scope).name, limit if size is None else size))
                # The header may be wrong, so bytes are counted too.
                too_large = announced.isdecimal() and (size is None or size > limit)
                async with asyncio.timeout(self._body_limit_s):
                    body = None if too_large else await _read(receive, limit)
            except BusyError as busy:
                answer: Response | None = problem_response(
                    scope, "busy", busy.message, action=busy.action, headers=_CLOSE
                )
            except TimeoutError:
                detail = f"The body did not arrive within {self._body_limit_s:g} s."
                # Closed, because the rest of the body may still arrive, and would be read as the next request.
                answer = problem_response(scope, "too-slow", detail, headers=_CLOSE)
            else:
                answer = await self._refusal(scope, body, limit)
            if answer is not None:
                await answer(scope, receive, send)
                return
            assert body is not None
            headers = MutableHeaders(raw=list(scope["headers"]))
            headers["content-type"] = "application/json"
            work = partial(self._app, {**scope, "headers": headers.raw}, _replay(body, receive))
            await self._repeated.serve(scope, body, work, send)

    async def _refusal(self, scope: Scope, body: bytes | None, limit: int) -> Response | None:
        if body is None:
            return problem_response(scope, "too-large", f"The body is larger than {limit} bytes.")
        # A large body is parsed in a thread, so that other requests are answered meanwhile.
        large = len(body) > MAX_COMMAND_BYTES
        twin = await self._parsing.ask(_repeated_key, body) if large else _repeated_key(body)
        return None if twin is None else problem_response(scope, "malformed", f"body: {twin}.")


def _size(announced: str) -> int | None:
    # More than 15 digits are not converted, since `int` is slow on very long numbers.
    return int(announced) if announced.isdecimal() and len(announced) <= 15 else None


async def _read(receive: Receive, limit: int) -> bytes | None:
    """Read the whole body; return None if it is larger than `limit` bytes."""
    body = bytearray()
    while True:
        message = await receive()
        body += message.get("body", b"")
        if len(body) > limit:
            return None
        if message["type"] == "http.disconnect" or not message.get("more_body", False):
            return bytes(body)


def _repeated_key(body: bytes) -> str | None:
    """Return a message if a key appears twice in a JSON object. Other faults are found by later parsing."""
    with suppress(ValueError, RecursionError):
        try:
            json.loads(body, object_pairs_hook=refuse_duplicate_keys)
        except DuplicateKeyError as twin:
            return str(twin)
    return None


def _replay(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` function that delivers the body that was already read, then the messages that follow."""
    pending = [body]

    async def again() -> Message:
        if pending:
            return {"type": "http.request", "body": pending.pop(), "more_body": False}
        return await receive()

    return again
