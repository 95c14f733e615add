"""One POST request of which everything is bounded: addresses, time, and the size of the answer.

The time limit holds for the whole exchange, however slowly the receiver sends. Redirects are not followed. Only status
and `Retry-After` of the answer are kept. Resolving a name is limited by the resolver of the system.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import ssl
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple
from urllib.parse import urlsplit

LARGEST_HEAD = 16 * 1024
"""Largest head of an answer, bytes."""
LARGEST_BODY, DRAIN_S = 64 * 1024, 1.0
"""How much of an answer's content is read, and for how long, before the connection is closed."""
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")
MOST_ADDRESSES, CONNECT_S = 4, 5.0
"""Addresses of one name that are tried, and the longest wait for each, s."""
_STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: [^\r\n]*)?\r\n")
_RETRY_AFTER = re.compile(rb"\r\nretry-after:[ \t]*(\d{1,9})[ \t]*\r\n", re.IGNORECASE)


class NotDeliveredError(Exception):
    """The request has no answer; the text says why."""


class Reply(NamedTuple):
    """What is kept of an answer."""

    status: int
    retry_after_s: float


class Route(NamedTuple):
    """How receivers are reached."""

    context: ssl.SSLContext | None
    """For https; None for http."""
    networks: Sequence[str]
    """Networks in which receivers may be; empty for the default."""
    limit_s: float
    """Longest time for one request and its answer, s."""


def post(url: str, headers: Mapping[str, str], body: bytes, route: Route) -> Reply:
    """Send a POST request; return what its answer states.

    Raises:
        NotDeliveredError: there is no answer, or none that can be understood.
    """
    deadline = time.monotonic() + route.limit_s
    parts = urlsplit(url)
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    lines = [f"POST {path} HTTP/1.1", f"Host: {parts.netloc}", *(f"{k}: {v}" for k, v in headers.items())]
    head = "\r\n".join([*lines, f"Content-Length: {len(body)}", "Connection: close", "", ""])
    port = parts.port or (443 if parts.scheme == "https" else 80)
    try:
        connection = _connected(parts.hostname or "", port, route.networks, deadline)
        with connection:
            connection.settimeout(_left(deadline))
            if route.context is not None:
                # The time limit of the socket holds for the whole handshake.
                connection = route.context.wrap_socket(connection, server_hostname=parts.hostname)
            with connection:
                connection.sendall(head.encode("ascii") + body)
                return _reply(connection, deadline)
    except ssl.SSLCertVerificationError as error:
        raise NotDeliveredError(
            f"the certificate of {parts.hostname} is not trusted ({error.verify_message})"
        ) from error
    except TimeoutError as error:
        raise NotDeliveredError(f"no answer within {route.limit_s:.0f} s") from error
    except OSError as error:
        raise NotDeliveredError(f"{parts.hostname}: {error.strerror or error}") from error


def refusal(address: str, networks: Sequence[str]) -> str:
    """Return why nothing is sent to an address; empty if it is permitted."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(ip, ipaddress.IPv6Address):
        ip = ip.ipv4_mapped or ip.sixtofour or _behind_nat64(ip) or ip
    if networks:
        inside = any(ip in ipaddress.ip_network(network) for network in networks)
        return "" if inside else f"{ip} is in none of push.networks"
    # Cameras and the services of clouds have link-local addresses; no receiver of a plant does.
    if ip.is_link_local or ip.is_multicast or ip.is_unspecified:
        return f"{ip} is link-local, multicast or unspecified, which only push.networks can permit"
    return ""


def _behind_nat64(ip: ipaddress.IPv6Address) -> ipaddress.IPv4Address | None:
    """Return the IPv4 address to which a gateway translates an address (RFC 6052, section 2.1); None for others."""
    return ipaddress.IPv4Address(int(ip) & 0xFFFFFFFF) if ip in _NAT64 else None


def _connected(host: str, port: int, networks: Sequence[str], deadline: float) -> socket.socket:
    """Connect to the first permitted address that accepts. The address that was checked is the one that is used."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise NotDeliveredError(f"the name {host} has no address ({getattr(error, 'strerror', error)})") from error
    fault = NotDeliveredError(f"the name {host} has no address")
    for family, kind, protocol, _, address in found[:MOST_ADDRESSES]:
        if why := refusal(str(address[0]), networks):
            fault = NotDeliveredError(why)
            continue
        connection = socket.socket(family, kind, protocol)
        try:
            connection.settimeout(min(CONNECT_S, _left(deadline)))
            connection.connect(address)
        except OSError as error:
            connection.close()
            why = "no connection in time" if isinstance(error, TimeoutError) else error.strerror or str(error)
            fault = NotDeliveredError(f"{address[0]} port {port}: {why}")
        else:
            return connection
    raise fault


def _reply(connection: socket.socket, deadline: float) -> Reply:
    received = b""
    while True:
        head, end, received_rest = received.partition(b"\r\n\r\n")
        if end:
            status = _STATUS.match(head + b"\r\n")
            if status is None:
                raise NotDeliveredError("the answer is not HTTP/1.1")
            if not status[1].startswith(b"1"):
                break
            received = received_rest  # an interim answer: the one that counts follows
            continue
        if len(received) > LARGEST_HEAD:
            raise NotDeliveredError(f"the head of the answer is larger than {LARGEST_HEAD // 1024} KiB")
        connection.settimeout(_left(deadline))
        more = connection.recv(4096)
        if not more:
            raise NotDeliveredError("the connection was closed before the answer")
        received += more
    _drain(connection, min(deadline, time.monotonic() + DRAIN_S))
    after = _RETRY_AFTER.search(head + b"\r\n")
    return Reply(int(status[1]), float(after[1]) if after else 0.0)


def _drain(connection: socket.socket, deadline: float) -> None:
    """Read what follows, a little: closing at once would reset the connection while the receiver still sends."""
    size = 0
    with suppress(OSError):
        while size < LARGEST_BODY and (more := _limited(connection, deadline).recv(4096)):
            size += len(more)


def _limited(connection: socket.socket, deadline: float) -> socket.socket:
    connection.settimeout(_left(deadline))
    return connection


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left
