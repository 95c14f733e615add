"""The host names in a request that the station accepts.

A web page can point its own name at the station's address (DNS rebinding). The browser then takes the station for the
server of that page, and the headers Origin and Host agree. But Host contains the page's name, so the station refuses
names that are not allowed. A request to an IP address cannot come from such a page.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

from starlette.types import Scope


def allowed_names(configured: Iterable[str] = ()) -> frozenset[str]:
    """Return the station's names: loopback, the machine's host name, and the names from station.toml."""
    own = socket.gethostname().lower().rstrip(".")
    short = own.partition(".")[0]
    return frozenset({"localhost", own, short, f"{short}.local", *(name.lower().rstrip(".") for name in configured)})


def addressed(host: str, names: frozenset[str]) -> bool:
    """Return whether a Host header contains one of the allowed `names` or an IP address."""
    # Every browser sends Host (RFC 9112, section 3.2), so a request without one comes from a program.
    name = host.strip().lower()
    if not name:
        return True
    # "[::1]:8350" and "name:8350" contain a port. A bare IPv6 address has several colons.
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.rstrip(".") in names
    return True


def is_loopback(scope: Scope) -> bool:
    """Return whether the connection of a request comes from this machine: from a program, or from a proxy."""
    client = scope.get("client")
    try:
        address = ipaddress.ip_address(client[0] if client else "")
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
