"""A REST client such as tester software contains: standard library only, one connection per request."""

from __future__ import annotations

import json
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPException
from typing import Any

import cv2
import numpy as np
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

REPLY_TIMEOUT_S = 90.0
"""Longest time to wait for a reply; longer than the longest long poll."""
EVENT_TIMEOUT_S = 15.0
"""Longest time between two lines of the event stream, which sends a heartbeat every two seconds."""
_ERRORS: dict[int, type[VaoiError]] = {404: NotFoundError, 409: StateError, 410: GoneError, 422: InputError}


class Client:
    """REST client of one station. A refusal by the station is raised here as the same `VaoiError`."""

    def __init__(self, address: str) -> None:
        """Set the address of the station, `http://HOST:PORT`."""
        self.address = address
        self._base = f"{address}/api/v1"
        # Proxies of the environment are ignored: the service listens on loopback, where a proxy cannot reach it.
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def get(self, path: str, **query: Any) -> Any:
        """Request a JSON document; return None if the reply has no body."""
        content = self.content(path, **query)
        return json.loads(content) if content else None

    def post(self, path: str, **fields: Any) -> Any:
        """Send a command with `fields` as its JSON body."""
        return json.loads(self._exchange(self._command("POST", path, json.dumps(fields).encode())))

    def put(self, path: str, **query: Any) -> Any:
        """Send a PUT request without a body; `query` holds all parameters."""
        return json.loads(self._exchange(self._command("PUT", _with_query(path, query))))

    def content(self, path: str, **query: Any) -> bytes:
        """Send GET and return the reply's body. `path` is relative to `/api/v1`, or begins with `/api/`."""
        url = (self.address if path.startswith("/api/") else self._base) + path
        return self._exchange(urllib.request.Request(_with_query(url, query)))

    def picture(self, path: str) -> tuple[bytes, NDArray[Any]]:
        """Request a PNG image. Return its bytes and its pixels."""
        content = self.content(path)
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        # OpenCV returns None instead of raising for bytes that it cannot decode.
        if pixels is None:
            raise InternalError(f"{path}: the station replied with {len(content)} bytes that are not a picture.")
        return content, np.asarray(pixels)

    def messages(self, after: int = 0) -> Iterator[dict[str, Any]]:
        """Yield events numbered above `after`, and heartbeats, as they happen, until the station ends."""
        request = urllib.request.Request(f"{self._base}/events?after={after}")
        with _translated_errors(), self._opener.open(request, timeout=EVENT_TIMEOUT_S) as stream:
            for line in stream:
                if line.startswith(b"data:"):
                    yield json.loads(line[5:])

    def _command(self, method: str, path: str, body: bytes = b"") -> urllib.request.Request:
        headers = {"Content-Type": "application/json"} if body else {}
        return urllib.request.Request(self._base + path, body, headers, method=method)

    def _exchange(self, request: urllib.request.Request) -> bytes:
        with _translated_errors(), self._opener.open(request, timeout=REPLY_TIMEOUT_S) as reply:
            return bytes(reply.read())


@contextmanager
def _translated_errors() -> Iterator[None]:
    """Convert refusals of the station, and failed connections, to the errors of this package."""
    try:
        yield
    except urllib.error.HTTPError as refusal:
        with refusal:
            raise _error(refusal.code, refusal.read()) from None
    except (OSError, HTTPException) as error:
        raise DeviceError(f"the station does not reply ({error}).", action="Check whether it still runs.") from error


def _with_query(path: str, query: dict[str, Any]) -> str:
    given = {k: v for k, v in query.items() if v is not None}
    return f"{path}?{urllib.parse.urlencode(given)}" if given else path


def _error(status: int, body: bytes) -> VaoiError:
    """Return the error that a refusal's body describes as problem details (RFC 9457)."""
    kind = _ERRORS.get(status, BusyError if status == BusyError.status else InternalError)
    try:
        problem = json.loads(body)
        return kind(problem["detail"], action=problem.get("action", ""), code=problem["code"])
    except (ValueError, KeyError, TypeError):
        return InternalError(f"the station replied {status}: {body[:200]!r}")
