"""Requests of the doctor and of the support bundle to the REST service of the station on this machine."""

from __future__ import annotations

import http.client
import ssl
import time
from collections.abc import Callable

from vaoi_station.config import ApiConfig
from vaoi_station.files.caller_credentials import CallerCredentials

_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # noqa: S104  (an address to connect to, not to listen on)
_PIECE = 256 * 1024


def address_of(api: ApiConfig) -> tuple[str, int]:
    """Return host and port at which a station on this machine can be reached."""
    return _EVERYWHERE.get(api.host, api.host), api.port


def request(
    api: ApiConfig,
    path: str,
    timeout_s: float,
    most_bytes: int,
    credentials: CallerCredentials | None = None,
    complete: Callable[[bytes], bool] = lambda _: False,
) -> tuple[int, bytes]:
    """Send GET to the station; return the status and the reply.

    Of the reply at most about `most_bytes` are read. Reading ends early after `timeout_s`, or when `complete` is true
    of what was read: the stream of events has no end.

    Raises:
        OSError, HTTPException: no station replies at this address, or another one than its certificate names.
        InputError: the trusted certificate of the credentials cannot be used.
    """
    credentials = credentials or CallerCredentials()
    if api.certificate is None:
        connection = http.client.HTTPConnection(*address_of(api), timeout=timeout_s)
    else:
        context = _context(api, credentials)
        connection = http.client.HTTPSConnection(*address_of(api), timeout=timeout_s, context=context)
    try:
        connection.request("GET", path, headers=credentials.headers())
        reply = connection.getresponse()
        # Any program may listen at this port: the length that is read is bounded, and the time.
        content, end = bytearray(), time.monotonic() + timeout_s
        while len(content) < most_bytes and time.monotonic() < end and (piece := reply.read1(_PIECE)):
            content += piece
            if complete(bytes(content)):
                break
        return reply.status, bytes(content)
    finally:
        connection.close()


def _context(api: ApiConfig, credentials: CallerCredentials) -> ssl.SSLContext:
    """Return TLS settings that trust the certificate in the configuration, whatever host name it was made for."""
    if credentials.ca is not None:
        return credentials.tls_context()
    context = CallerCredentials(ca=api.certificate).tls_context()
    # The file holds the certificate of this very station, so that its name says nothing more: it is mostly that of the
    # network, and here the address is loopback.
    context.check_hostname = False
    return context
