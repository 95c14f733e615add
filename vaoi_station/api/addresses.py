"""How callers address the station: the host names that it accepts, and the path of a reverse proxy, such as `/aoi`.

A web page can point its own name at the station's address (DNS rebinding). The browser then takes the station for the
server of that page, and the headers Origin and Host agree. But Host contains the page's name, so the station refuses
names that are not allowed. A request to an IP address cannot come from such a page.

As ASGI demands, `root_path` of a request's scope holds the prefix of a proxy, and `path` begins with it. So every
address that a reply derives from the path of its request is one that the caller can use.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

from starlette.types import Scope

from vaoi_station.model.root_path import IN_WORDS, LONGEST, is_root_path

HEADER, SCHEME, CALLER = "X-Forwarded-Prefix", "X-Forwarded-Proto", "X-Forwarded-For"


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
    return _address(name) is not None or name.rstrip(".") in names


def is_loopback(scope: Scope) -> bool:
    """Return whether the connection of a request comes from this machine: from a program, or from a proxy."""
    client = scope.get("client")
    address = _address(client[0] if client else "")
    return address is not None and (getattr(address, "ipv4_mapped", None) or address).is_loopback


def as_addressed(scope: Scope, root_path: str) -> Scope:
    """Return the scope of a request with the path, the scheme and the caller that a proxy states.

    `root_path` is the prefix, from station.toml, of paths that a proxy passes on unchanged. A proxy that removes the
    prefix states it in a header. Headers count only from this machine: elsewhere every caller could send them. A
    request that a proxy has passed on is none of this machine any more.
    """
    path, prefix = scope["path"], _forwarded(scope, HEADER).rstrip("/")
    if _forwarded(scope, SCHEME) == "https":
        scope = {**scope, "scheme": "https"}
    if _address(caller := _forwarded(scope, CALLER).rpartition(",")[2].strip()) is not None:
        scope = {**scope, "client": (caller, 0)}
    if root_path and f"{path}/".startswith(f"{root_path}/"):
        return {**scope, "root_path": root_path}
    return {**scope, "root_path": prefix, "path": prefix + path} if is_root_path(prefix) else scope


def prefix_fault(scope: Scope) -> str | None:
    """Return a message if the proxy states something that is no prefix, else None."""
    prefix = _forwarded(scope, HEADER).rstrip("/")
    if not prefix or is_root_path(prefix):
        return None
    return f"{HEADER} is {prefix!r:.100}, but must be {IN_WORDS}, at most {LONGEST} characters."


def root_of(scope: Scope) -> str:
    """Return the prefix of a request; empty without one."""
    # Within a mounted folder, `root_path` is the folder's.
    root: str = scope.get("app_root_path", scope.get("root_path", ""))
    return root


def path_of(scope: Scope) -> str:
    """Return the path of a request without the prefix: the station's own address."""
    path: str = scope["path"]
    return path[len(root_of(scope)) :]


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def _forwarded(scope: Scope, header: str) -> str:
    """Return a header of a proxy on this machine; empty without one."""
    name = header.lower().encode()
    found = [value.decode("latin-1") for key, value in scope["headers"] if key == name]
    return ", ".join(found) if found and is_loopback(scope) else ""
