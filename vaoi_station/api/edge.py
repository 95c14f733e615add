"""What every request passes first, and every answer last: limits, origin, headers of safety.

- Bodies are bounded. The API takes JSON only, so a body counts as JSON whatever its Content-Type says:
  the HTTP libraries of LabVIEW, Delphi or C, and curl, send none or a wrong one.
- That lenience would let any web page send commands from an operator's browser. Browsers say where a
  request comes from (Origin), so commands from foreign pages are refused; programs send no Origin.
- Pages may load nothing from elsewhere (Content-Security-Policy).
"""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vaoi_station import __version__
from vaoi_station.api.problems import problem_response

MAX_BODY_BYTES = 8 * 1024 * 1024
"""A board type of twenty thousand components has about 3 MB."""

CSP = "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'"
SAFETY = {
    "Content-Security-Policy": CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Vaoi-Version": __version__,
}


class Edge:
    """ASGI middleware around the whole application."""

    def __init__(self, app: ASGIApp, max_body_bytes: int = MAX_BODY_BYTES) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes

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
        headers, path = Headers(scope=scope), scope["path"]
        if scope["method"] in ("GET", "HEAD", "OPTIONS"):
            await self._app(scope, receive, send)
            return
        if _foreign(headers):
            detail = (
                f"The command came from a page of {headers.get('origin', 'another site'):.100}, not of this station."
            )
            await problem_response(path, "foreign-origin", detail)(scope, receive, send)
            return
        body = await self._body(headers, receive)
        if body is None:
            detail = f"The body is larger than {self._max_body_bytes} bytes."
            await problem_response(path, "too-large", detail)(scope, receive, send)
            return
        await self._app(_as_json(scope), _replay(body, receive), send)

    async def _body(self, headers: Headers, receive: Receive) -> bytes | None:
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
