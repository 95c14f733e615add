"""A REST client such as tester software contains: standard library only, one connection per request."""

from __future__ import annotations

import json
import ssl
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.client import HTTPException, HTTPResponse, IncompleteRead
from typing import Any

from numpy.typing import NDArray

from vaoi_station.errors import (
    BusyError,
    DeviceError,
    GoneError,
    InputError,
    InternalError,
    NotFoundError,
    StateError,
    VaoiError,
)
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.files.images import decode

REPLY_TIMEOUT_S = 150.0
"""Longest time to wait for a reply; longer than the longest long poll and the longest import of board data."""
EVENT_TIMEOUT_S = 15.0
"""Longest time between two lines of the event stream, which sends a heartbeat every two seconds."""
ATTEMPTS = 3
"""How often a command is sent at most, if the connection ends before its reply."""
_SHOWN = 200
"""Largest number of bytes of an unusable reply that an error message quotes."""
_ERRORS: dict[int, type[VaoiError]] = {404: NotFoundError, 409: StateError, 410: GoneError, 503: BusyError}


class Client:
    """REST client of one station.

    A refusal by the station is raised here as the same `VaoiError`. A station that does not reply, or whose reply is
    not what a station sends, is a `DeviceError` with the address.
    """

    def __init__(self, address: str, credentials: CallerCredentials | None = None) -> None:
        """Set the address of the station, `http://HOST:PORT` or `https://HOST:PORT`, and how the caller is let in.

        Behind a proxy the address may have a path.
        """
        self.address = address
        self._path = urllib.parse.urlsplit(address).path
        self._base = f"{address}/api/v1"
        credentials = credentials or CallerCredentials()
        # Proxies of the environment are ignored: the service is on loopback or in the factory's own network.
        handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({}), _NoRedirect()]
        if address.startswith("https:"):
            handlers.append(urllib.request.HTTPSHandler(context=credentials.tls_context()))
        self._opener = urllib.request.build_opener(*handlers)
        self._opener.addheaders = [*credentials.headers().items()]

    def get(self, path: str, **query: Any) -> Any:
        """Request a JSON object; return None if the reply has no body."""
        return _parse(self.content(path, **query), self.url(path))

    def post(self, path: str, **fields: Any) -> Any:
        """Send a command with `fields` as its JSON body; return the reply, None if it has no body."""
        return self._act("POST", path, fields)

    def post_under(self, path: str, conditions: dict[str, str]) -> Any:
        """Send a command that acts only under conditions, which are headers; return the reply."""
        return self._act("POST", path, {}, conditions)

    def put(self, path: str, **query: Any) -> Any:
        """Send a PUT request without a body; `query` holds all parameters. Return the reply, None without a body."""
        return self._act("PUT", _with_query(path, query))

    def put_document(self, path: str, document: dict[str, Any], headers: dict[str, str] | None = None) -> Any:
        """Send a PUT request with a JSON body; return the reply, None if it has no body."""
        return self._act("PUT", path, document, headers)

    def delete(self, path: str, headers: dict[str, str] | None = None, **query: Any) -> Any:
        """Send a DELETE request; return the reply, None if it has no body."""
        return self._act("DELETE", _with_query(path, query), headers=headers)

    def upload(self, path: str, content: bytes, **query: Any) -> Any:
        """Send a file by POST; return the reply."""
        headers = {"Content-Type": "application/octet-stream"}
        request = urllib.request.Request(self.url(_with_query(path, query)), content, headers, method="POST")
        return _parse(self._exchange(request), self.url(path))

    def content(self, path: str, **query: Any) -> bytes:
        """Send GET and return the reply's body. `path` is one of those of `url`."""
        return self._exchange(urllib.request.Request(_with_query(self.url(path), query)))

    @contextmanager
    def opened(self, path: str, **query: Any) -> Iterator[HTTPResponse]:
        """Send GET and provide the reply in a `with` block, in which its body is read piece by piece."""
        url = _with_query(self.url(path), query)
        with _translated_errors(url), self._opener.open(url, timeout=REPLY_TIMEOUT_S) as reply:
            yield reply

    def tagged(self, path: str) -> tuple[Any, str]:
        """Request a JSON object; return it with its ETag, by which a change can be bound to what was read."""
        with self.opened(path) as reply:
            content, tag = bytes(reply.read()), reply.headers.get("ETag", "")
        return _parse(content, self.url(path)), tag

    def picture(self, path: str) -> tuple[bytes, NDArray[Any]]:
        """Request a PNG image. Return its bytes and its pixels."""
        content = self.content(path)
        pixels = decode(content)
        if pixels is None:
            raise unusable_reply(self.url(path), f"{len(content)} bytes that are not a picture")
        return content, pixels

    def messages(self, after: int = 0) -> Iterator[dict[str, Any]]:
        """Yield events numbered above `after`, and heartbeats, as they happen, until the station ends."""
        url = self.url(f"/events?after={after}")
        request = urllib.request.Request(url)
        with _translated_errors(url), self._opener.open(request, timeout=EVENT_TIMEOUT_S) as stream:
            for line in stream:
                if line.startswith(b"data:"):
                    yield _parse(line[5:], url) or Reply.of(url)

    def url(self, path: str) -> str:
        """Return the complete address of a path: relative to `/api/v1`, from `/api/` on, or as a reply states it."""
        if self._path and path.startswith(f"{self._path}/api/"):
            return self.address.removesuffix(self._path) + path
        return (self.address if path.startswith("/api/") else self._base) + path

    def _act(
        self, method: str, path: str, body: dict[str, Any] | None = None, headers: dict[str, str] | None = None
    ) -> Any:
        """Send a command with a key of its own; repeat it with the same key if its reply was lost on the way.

        The station performs a command with a key once, and gives a repetition the same reply.
        """
        content = b"" if body is None else json.dumps(body).encode()
        sent = {"Idempotency-Key": f'"{uuid.uuid4().hex}"', **(headers or {})}
        sent |= {"Content-Type": "application/json"} if content else {}
        request = urllib.request.Request(self.url(path), content, sent, method=method)
        until_s, attempts = time.monotonic() + REPLY_TIMEOUT_S, 1
        while True:
            try:
                return _parse(self._exchange(request), self.url(path))
            except _LostReplyError:
                if attempts == ATTEMPTS:
                    raise
                attempts += 1
            except StateError as refusal:
                # The first one has reached the station, which waited for its end as long as it may.
                if attempts == 1 or refusal.code != "request-under-way" or time.monotonic() > until_s:
                    raise

    def _exchange(self, request: urllib.request.Request) -> bytes:
        with _translated_errors(request.full_url), self._opener.open(request, timeout=REPLY_TIMEOUT_S) as reply:
            content, status = bytes(reply.read()), reply.status
        if not content and status != HTTPStatus.NO_CONTENT:
            raise unusable_reply(request.full_url, f"status {status} and no content")
        return content


class _LostReplyError(DeviceError):
    """The connection ended after the request was sent: whether the command took effect is not known."""


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: a station sends none, and another server would get the key."""

    def redirect_request(self, *_: Any) -> None:
        """Return None, which means that the redirect is not followed. The caller then gets it as a refusal."""


class Reply(dict[str, Any]):
    """A JSON object of a station's reply. A key that it lacks is a fault of the station, not of the caller."""

    # An attribute and not an argument, because libraries copy dictionaries by `type(d)(pairs)`.
    url = ""
    """The address from which the reply came, for error messages."""

    @classmethod
    def of(cls, url: str, pairs: Iterable[tuple[str, Any]] = ()) -> Reply:
        """Build a reply from its address and its entries."""
        reply = cls(pairs)
        reply.url = url
        return reply

    def __missing__(self, key: str) -> Any:
        raise unusable_reply(self.url, f"a document without the key {key!r}")


def unusable_reply(url: str, received: str) -> DeviceError:
    """Return the error for a reply that no station of this version sends; `received` describes the reply."""
    return DeviceError(
        f"{url}: the station replied with {received}.",
        action="Check that a station of this version runs at this address, and that no other program replies there.",
        code="unusable-reply",
    )


def _parse(content: bytes, url: str) -> Reply | None:
    """Parse the JSON object of a reply; None if it is empty."""
    if not content:
        return None
    try:
        reply = json.loads(content, object_pairs_hook=partial(Reply.of, url))
    except (ValueError, RecursionError) as error:
        raise unusable_reply(url, f"something that is not JSON: {content[:_SHOWN]!r}") from error
    if not isinstance(reply, Reply):
        raise unusable_reply(url, f"something that is not a JSON object: {content[:_SHOWN]!r}")
    return reply


@contextmanager
def _translated_errors(url: str) -> Iterator[None]:
    """Convert refusals of the station, and failed connections, to the errors of this package."""
    try:
        try:
            yield
        except urllib.error.HTTPError as refusal:
            with refusal:
                raise _error(refusal.code, refusal.read(), url) from None
    # The outer block also covers a connection that ends while the body of a refusal is read.
    except (OSError, HTTPException) as error:
        cause = error.reason if isinstance(error, urllib.error.URLError) else error
        lost = isinstance(cause, ConnectionResetError | BrokenPipeError | IncompleteRead)
        raise (_LostReplyError if lost else DeviceError)(
            f"{url}: the station does not reply ({error or type(error).__name__}).",
            action=_remedy(url, cause),
        ) from error


def _remedy(url: str, cause: object) -> str:
    """Return what to do about a connection that failed."""
    if isinstance(cause, ssl.SSLCertVerificationError):
        return "Name its certificate by --ca or VAOI_CA, and use a host name or address that the certificate has."
    # A station with TLS ends a connection that speaks plain HTTP without a reply.
    return "Check whether it still runs." + ("" if url.startswith("https:") else " With TLS its address is https://….")


def _with_query(path: str, query: dict[str, Any]) -> str:
    given = {k: v for k, v in query.items() if v is not None}
    return f"{path}?{urllib.parse.urlencode(given, doseq=True)}" if given else path


def _error(status: int, body: bytes, url: str) -> VaoiError:
    """Return the error that a refusal's body describes as problem details (RFC 9457)."""
    # Other refusals below 500 are for the caller to mend: a key is missing, or it has not the scope.
    kind = _ERRORS.get(status, InputError if status < HTTPStatus.INTERNAL_SERVER_ERROR else InternalError)
    try:
        problem = json.loads(body)
        detail, action, code = problem["detail"], problem.get("action", ""), problem["code"]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return unusable_reply(url, f"status {status} without problem details: {body[:_SHOWN]!r}")
    if not all(isinstance(part, str) for part in (detail, action, code)):
        return unusable_reply(url, f"status {status} and problem details that are not text: {body[:_SHOWN]!r}")
    return kind(detail, action=action, code=code)
