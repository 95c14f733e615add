"""The client of a station's REST interface: refusals and failed connections are raised as errors of this package."""

from __future__ import annotations

import io
import json
import time
import urllib.parse
import uuid
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

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
from vaoi_station.files.documents import describe
from vaoi_station.files.images import decode

if TYPE_CHECKING:
    import httpx2

M = TypeVar("M", bound=BaseModel)
REPLY_TIMEOUT_S = 150.0
"""Longest time to wait for a reply; longer than the longest long poll and the longest import of board data."""
EVENT_TIMEOUT_S = 15.0
"""Longest time between two lines of the event stream, which sends a heartbeat every two seconds."""
ATTEMPTS = 3
"""How often a request is sent at most, if the connection ends before its reply."""
_SHOWN = 200
"""Largest number of bytes of an unusable reply that an error message quotes."""
_ERRORS: dict[int, type[VaoiError]] = {404: NotFoundError, 409: StateError, 410: GoneError, 503: BusyError}


class Client:
    """Client of one station, for use in any thread.

    A refusal by the station is raised here as the same `VaoiError`. A station that does not reply, or whose reply is
    not what a station sends, is a `DeviceError` with the address.
    """

    def __init__(self, address: str, credentials: CallerCredentials | None = None) -> None:
        """Set the address of the station, `http://HOST:PORT` or `https://HOST:PORT`, and how the caller is let in.

        Behind a proxy the address may have a path.
        """
        import httpx2  # here, because most commands ask no station

        self.address = address
        self._path = urllib.parse.urlsplit(address).path
        self._base = f"{address}/api/v1"
        credentials = credentials or CallerCredentials()
        # Redirects are not followed: a station sends none, and another server would get the key. Proxies of the
        # environment are ignored: the service is on loopback or in the factory's own network.
        self._http = httpx2.Client(
            headers={**credentials.headers(), "Accept-Encoding": "identity"},
            verify=credentials.tls_context() if address.startswith("https:") else False,
            timeout=REPLY_TIMEOUT_S,
            trust_env=False,
        )
        weakref.finalize(self, self._http.close)

    def get(self, path: str, **query: Any) -> Any:
        """Request a JSON object; return None if the reply has no body."""
        return _parse(self.content(path, **query), self.url(path))

    def read(self, model: type[M], path: str, **query: Any) -> M:
        """Request a document."""
        return checked(model, self.get(path, **query), self.url(path))

    def post(self, path: str, **fields: Any) -> Any:
        """Send a command with `fields` as its JSON body; return the reply, None if it has no body."""
        return self.act("POST", path, fields)

    def act(
        self,
        method: Literal["POST", "PUT", "PATCH", "DELETE"],
        path: str,
        document: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
        **query: Any,
    ) -> Any:
        """Send a command, with a JSON body if a document is given; return the reply, None if it has no body.

        It has a key of its own, and is repeated with the same key if its reply was lost on the way: the station
        performs a command with a key once, and gives a repetition the same reply.
        """
        sent = {"Idempotency-Key": f'"{uuid.uuid4().hex}"', **(headers or {})}
        content = b""
        if document is not None:
            try:
                content, sent["Content-Type"] = json.dumps(document).encode(), "application/json"
            except (TypeError, ValueError) as error:
                raise InputError(f"{self.url(path)}: a value cannot be sent: {error}.") from error
        url = with_query(self.url(path), query)
        return _parse(self._exchange(method, url, content=content, headers=sent), self.url(path))

    def write(
        self,
        model: type[M],
        method: Literal["POST", "PUT", "PATCH", "DELETE"],
        path: str,
        document: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
        **query: Any,
    ) -> M:
        """Send a command as `act` does; return the document of its reply."""
        return checked(model, self.act(method, path, document, headers, **query), self.url(path))

    def upload(self, path: str, content: bytes, **query: Any) -> Any:
        """Send a file by POST; return the reply."""
        headers = {"Content-Type": "application/octet-stream"}
        url = with_query(self.url(path), query)
        return _parse(self._exchange("POST", url, 1, content=content, headers=headers), url)

    def content(self, path: str, **query: Any) -> bytes:
        """Send GET and return the reply's body. `path` is one of those of `url`."""
        return self._exchange("GET", with_query(self.url(path), query))

    @contextmanager
    def opened(self, path: str, **query: Any) -> Iterator[io.BufferedReader]:
        """Send GET and provide the body of the reply in a `with` block, in which it is read piece by piece."""
        with self._reply("GET", with_query(self.url(path), query)) as reply:
            yield io.BufferedReader(_Body(reply.iter_bytes()), 1 << 16)

    def tagged(self, path: str) -> tuple[Any, str]:
        """Request a JSON object; return it with its ETag, by which a change can be bound to what was read."""
        with self._reply("GET", self.url(path)) as reply:
            return _parse(reply.read(), self.url(path)), reply.headers.get("ETag", "")

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
        with self._reply("GET", url, timeout=EVENT_TIMEOUT_S) as stream:
            # Not `iter_lines`, which also divides at U+2028 and other characters that a text in JSON may have.
            for line in io.BufferedReader(_Body(stream.iter_bytes()), 1 << 16):
                if line.startswith(b"data:"):
                    yield _parse(line[5:], url) or Reply.of(url)

    def url(self, path: str) -> str:
        """Return the complete address of a path: relative to `/api/v1`, from `/api/` on, or as a reply states it."""
        if self._path and path.startswith(f"{self._path}/api/"):
            return self.address.removesuffix(self._path) + path
        return (self.address if path.startswith("/api/") else self._base) + path

    def _exchange(self, method: str, url: str, most_attempts: int = ATTEMPTS, **sent: Any) -> bytes:
        """Return the body of a reply; send the request again if the connection ends before the reply."""
        until_s, attempts = time.monotonic() + REPLY_TIMEOUT_S, 1
        while True:
            try:
                with self._reply(method, url, **sent) as reply:
                    content, status = reply.read(), reply.status_code
                break
            except _LostReplyError:
                if attempts == most_attempts:
                    raise
                attempts += 1
            except StateError as refusal:
                # The first one has reached the station, which waited for its end as long as it may.
                if attempts == 1 or refusal.code != "request-under-way" or time.monotonic() > until_s:
                    raise
        if not content and status != HTTPStatus.NO_CONTENT:
            raise unusable_reply(url, f"status {status} and no content")
        return content

    @contextmanager
    def _reply(self, method: str, url: str, **sent: Any) -> Iterator[httpx2.Response]:
        """Provide a reply; raise the refusal of the station, or the failure of the connection, as an error of ours."""
        import httpx2

        try:
            with self._http.stream(method, url, **sent) as reply:
                if not reply.is_success:
                    raise _refusal(reply.status_code, reply.read(), url)
                yield reply
        except (httpx2.HTTPError, httpx2.InvalidURL) as error:
            lost = isinstance(error, httpx2.ReadError | httpx2.WriteError | httpx2.RemoteProtocolError)
            raise (_LostReplyError if lost else DeviceError)(
                f"{url}: the station does not reply ({type(error).__name__}: {error}).", action=_remedy(url, error)
            ) from error


class _LostReplyError(DeviceError):
    """The connection ended after the request was sent: whether a command took effect is not known."""


class _Body(io.RawIOBase):
    """The body of a reply as a file."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces, self._left = pieces, b""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Copy the next bytes; return their number, 0 at the end."""
        self._left = self._left or next(self._pieces, b"")
        size = min(len(buffer), len(self._left))
        buffer[:size], self._left = self._left[:size], self._left[size:]
        return size


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


def checked(model: type[M], reply: Any, url: str) -> M:
    """Validate a reply, which may have keys of a newer station; raise DeviceError with its address if it is wrong."""
    # Documents that the station writes itself are closed; a newer station may have added keys to them.
    extra: Literal["ignore"] | None = "ignore" if model.model_config.get("extra") != "allow" else None
    try:
        return model.model_validate(reply, extra=extra)
    except ValidationError as error:
        raise unusable_reply(url, f"another document than expected: {describe(error, 'reply').rstrip('.')}") from error


def unusable_reply(url: str, received: str) -> DeviceError:
    """Return the error for a reply that no station of this version sends; `received` describes the reply."""
    return DeviceError(
        f"{url}: the station replied with {received}.",
        action="Check that a station of this version runs at this address, and that no other program replies there.",
        code="unusable-reply",
    )


def with_query(path: str, query: dict[str, Any]) -> str:
    """Return an address with its parameters; those that are None are left out."""
    given = {k: v for k, v in query.items() if v is not None}
    return f"{path}?{urllib.parse.urlencode(given, doseq=True)}" if given else path


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


def _remedy(url: str, error: Exception) -> str:
    """Return what to do about a connection that failed."""
    if "certificate verify failed" in str(error).lower():
        return "Name its certificate by --ca or VAOI_CA, and use a host name or address that the certificate has."
    # A station with TLS ends a connection that speaks plain HTTP without a reply.
    return "Check whether it still runs." + ("" if url.startswith("https:") else " With TLS its address is https://….")


def _refusal(status: int, body: bytes, url: str) -> VaoiError:
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
