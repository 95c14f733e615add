"""What every request passes first, and every answer last: limits, names, origin, headers of safety.

- Requests that call the station by a name that is not its own are refused (`hosts.py`).
- Bodies are bounded in size and time. A key that appears twice in an object would be read one way here and another way
  elsewhere, so it is refused. The API takes JSON only, so a body counts as JSON whatever its Content-Type says:
  the HTTP libraries of LabVIEW, Delphi or C, and curl, send none or a wrong one.
- That lenience would let any web page send commands from an operator's browser. Browsers say where a
  request comes from (Origin), so commands from foreign pages are refused; programs send no Origin.
- Pages may load nothing from elsewhere (Content-Security-Policy).
"""

from __future__ import annotations

import asyncio
import json

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vaoi_station.api.hosts import addressed, allowed_names
from vaoi_station.api.problems import problem_response
from vaoi_station.files.documents import DuplicateKeyError, refuse_duplicate_keys
from vaoi_station.version import __version__

MAX_BODY_BYTES = 8 * 1024 * 1024
"""A board type of twenty thousand components has about 3 MB."""
BODY_LIMIT_S = 20.0
"""For a body to arrive whole; 8 MB take a second on a slow line."""
SAFE = ("GET", "HEAD", "OPTIONS")
STREAM = "/api/v1/events"
"""Has no end, so there is no telling its headers without it."""

CSP = "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'"
SAFETY = {
    "Content-Security-Policy": CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Vaoi-Version": __version__,
}


class RequestGuard:
    """ASGI middleware around the whole application."""

    def __init__(
        self,
        app: ASGIApp,
        names: frozenset[str] | None = None,
        max_body_bytes: int = MAX_BODY_BYTES,
        body_limit_s: float = BODY_LIMIT_S,
    ) -> None:
        """`names`: by which callers may address the station; by default loopback and the machine's own."""
        self._app = app
        self._names = allowed_names() if names is None else names
        self._max_body_bytes, self._body_limit_s = max_body_bytes, body_limit_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check, pass on, and add the headers."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SAFETY.items():
                    headers[name] = value
            await send(message)

        await self._checked(scope, receive, send_safely)

    async def _checked(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, send)
        elif scope["method"] == "HEAD" and scope["path"] != STREAM:
            await self._app({**scope, "method": "GET"}, receive, _without_body(send))
        elif scope["method"] in SAFE:
            await self._app(scope, receive, send)
        else:
            body = await self._body(scope, receive)
            if isinstance(body, bytes):
                await self._app(_as_json(scope), _replay(body, receive), send)
            else:
                await body(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        """Why a request is refused whatever it carries."""
        headers, path = Headers(scope=scope), scope["path"]
        if not addressed(headers.get("host", ""), self._names):
            detail = f"The request was addressed to {headers['host']!r:.100}, which is no name of this station."
            return problem_response(path, "unknown-host", detail)
        if scope["method"] not in SAFE and _foreign(headers):
            page = f"{headers.get('origin', 'another site'):.100}"
            detail = f"The command came from a page of {page}, not of this station."
            return problem_response(path, "foreign-origin", detail)
        return None

    async def _body(self, scope: Scope, receive: Receive) -> bytes | Response:
        """The whole body, or why it is refused."""
        path = scope["path"]
        try:
            async with asyncio.timeout(self._body_limit_s):
                body = await self._read(Headers(scope=scope), receive)
        except TimeoutError:
            detail = f"The body had not arrived after {self._body_limit_s:g} s."
            return problem_response(path, "too-slow", detail, headers={"Connection": "close"})
        if body is None:
            return problem_response(path, "too-large", f"The body is larger than {self._max_body_bytes} bytes.")
        if (twin := _twin_in(body)) is not None:
            return problem_response(path, "malformed", f"body: {twin}.")
        return body

    async def _read(self, headers: Headers, receive: Receive) -> bytes | None:
        """The whole body; None if it is too large, which a Content-Length tells before it is read."""
        announced = headers.get("content-length", "")
        if announced.isdecimal() and (len(announced) > 15 or int(announced) > self._max_body_bytes):
            return None
        body = bytearray()
        while True:
            message = await receive()
            body += message.get("body", b"")
            if len(body) > self._max_body_bytes:
                return None
            if message["type"] == "http.disconnect" or not message.get("more_body", False):
                return bytes(body)


def _foreign(headers: Headers) -> bool:
    """Whether a browser says that the command comes from a page of another origin."""
    origin = headers.get("origin")
    if origin is None:
        return headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
    return origin.lower().partition("://")[2] != headers.get("host", "").lower()


def _twin_in(body: bytes) -> str | None:
    """What key appears twice in an object of a JSON body; what else may be wrong with it is told by its reader."""
    try:
        json.loads(body, object_pairs_hook=refuse_duplicate_keys)
    except DuplicateKeyError as twin:
        return str(twin)
    except (ValueError, RecursionError):
        return None
    return None


def _without_body(send: Send) -> Send:
    """The answer to GET, headers only: what HEAD is answered with."""

    async def headers_only(message: Message) -> None:
        if message["type"] == "http.response.body":
            message = {**message, "body": b""}
        await send(message)

    return headers_only


def _as_json(scope: Scope) -> Scope:
    headers = MutableHeaders(raw=list(scope["headers"]))
    headers["content-type"] = "application/json"
    return {**scope, "headers": headers.raw}


def _replay(body: bytes, receive: Receive) -> Receive:
    """A receive that hands out the body that was read already, then whatever follows."""
    pending = [body]

    async def again() -> Message:
        if pending:
            return {"type": "http.request", "body": pending.pop(), "more_body": False}
        return await receive()

    return again
