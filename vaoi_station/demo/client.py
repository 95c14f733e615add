"""The REST interface as tester software uses it: standard library only, one connection per request."""

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

PATIENCE_S = 90.0
"""For an answer; longer than the longest poll."""
SILENCE_S = 15.0
"""The event stream says something every two seconds."""
_ERRORS: dict[int, type[VaoiError]] = {404: NotFoundError, 409: StateError, 410: GoneError, 422: InputError}


class Client:
    """Talks to one station; every refusal becomes the error the station itself raised."""

    def __init__(self, address: str) -> None:
        """`address` is `http://HOST:PORT`; proxies of the environment are not asked."""
        self.address = address
        self._base = f"{address}/api/v1"
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def get(self, path: str, **query: Any) -> Any:
        """The JSON of an answer; None if it is empty."""
        content = self.content(path, **query)
        return json.loads(content) if content else None

    def post(self, path: str, **fields: Any) -> Any:
        """Command the station; `fields` are the JSON body."""
        return json.loads(self._exchange(self._command("POST", path, json.dumps(fields).encode())))

    def put(self, path: str, **query: Any) -> Any:
        """The same, where the query says everything."""
        return json.loads(self._exchange(self._command("PUT", _with_query(path, query))))

    def content(self, path: str, **query: Any) -> bytes:
        """The body of an answer; `path` is below `/api/v1`, or an absolute one the station gave."""
        url = (self.address if path.startswith("/api/") else self._base) + path
        return self._exchange(urllib.request.Request(_with_query(url, query)))

    def picture(self, path: str) -> tuple[bytes, NDArray[Any]]:
        """A PNG as it came, and its pixels."""
        content = self.content(path)
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            raise InternalError(f"{path}: the station answered {len(content)} bytes that are no picture.")
        return content, np.asarray(pixels)

    def messages(self, after: int = 0) -> Iterator[dict[str, Any]]:
        """Events behind number `after` as they happen, heartbeats among them, until the station ends."""
        request = urllib.request.Request(f"{self._base}/events?after={after}")
        with _answered(), self._opener.open(request, timeout=SILENCE_S) as stream:
            for line in stream:
                if line.startswith(b"data:"):
                    yield json.loads(line[5:])

    def _command(self, method: str, path: str, body: bytes = b"") -> urllib.request.Request:
        headers = {"Content-Type": "application/json"} if body else {}
        return urllib.request.Request(self._base + path, body, headers, method=method)

    def _exchange(self, request: urllib.request.Request) -> bytes:
        with _answered(), self._opener.open(request, timeout=PATIENCE_S) as answer:
            return bytes(answer.read())


@contextmanager
def _answered() -> Iterator[None]:
    """Refusals become errors; so does a station that does not answer."""
    try:
        yield
    except urllib.error.HTTPError as refusal:
        with refusal:
            raise _error(refusal.code, refusal.read()) from None
    except (OSError, HTTPException) as error:
        raise DeviceError(f"the station does not answer ({error}).", action="See whether it still runs.") from error


def _with_query(path: str, query: dict[str, Any]) -> str:
    given = {k: v for k, v in query.items() if v is not None}
    return f"{path}?{urllib.parse.urlencode(given)}" if given else path


def _error(status: int, body: bytes) -> VaoiError:
    """The error behind problem details (RFC 9457)."""
    kind = _ERRORS.get(status, BusyError if status == BusyError.status else InternalError)
    try:
        problem = json.loads(body)
        return kind(problem["detail"], action=problem.get("action", ""), code=problem["code"])
    except (ValueError, KeyError, TypeError):
        return InternalError(f"the station answered {status}: {body[:200]!r}")
