"""By which names the station may be addressed.

A web page may give its own name the station's address (DNS rebinding); to the browser the station is then
that page's own server, and Origin and Host agree. But the request still carries the page's name. Callers that
use a bare address are no browsers that were fooled by a name.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable


def allowed_names(configured: Iterable[str] = ()) -> frozenset[str]:
    """Names that are the station's: loopback, the machine's own as it knows it, and those of station.toml."""
    own = socket.gethostname().lower().rstrip(".")
    short = own.partition(".")[0]
    return frozenset({"localhost", own, short, f"{short}.local", *(name.lower().rstrip(".") for name in configured)})


def addressed(host: str, names: frozenset[str]) -> bool:
    """Whether a Host header names the station, by a name of its own or by any address; absent: no browser sent it."""
    name = host.strip().lower()
    if not name:
        return True
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.rstrip(".") in names
    return True
