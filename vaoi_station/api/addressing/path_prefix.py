"""The path under which a reverse proxy offers the station, such as `/aoi`.

As ASGI demands, `root_path` of a request's scope holds the prefix, and `path` begins with it. So every address that a
reply derives from the path of its request is one that the caller can use.
"""

from __future__ import annotations

from starlette.types import Scope

from vaoi_station.api.addressing.hosts import is_loopback
from vaoi_station.model.root_path import IN_WORDS, LONGEST, is_root_path

HEADER, SCHEME = "X-Forwarded-Prefix", "X-Forwarded-Proto"


def as_addressed(scope: Scope, root_path: str) -> Scope:
    """Return the scope of a request with the path and the scheme that its caller has used.

    Args:
        scope: the request as it arrives.
        root_path: the prefix of paths that a proxy passes on unchanged, from station.toml; empty if there is none.

    A proxy that removes the prefix states it in a header. Headers count only from this machine: elsewhere every caller
    could send them.
    """
    path = scope["path"]
    if _forwarded(scope, SCHEME) == "https":
        scope = {**scope, "scheme": "https"}
    if root_path and f"{path}/".startswith(f"{root_path}/"):
        return {**scope, "root_path": root_path}
    prefix = _stated(scope)
    return {**scope, "root_path": prefix, "path": prefix + path} if is_root_path(prefix) else scope


def prefix_fault(scope: Scope) -> str | None:
    """Return a message if the proxy states something that is no prefix, else None."""
    prefix = _stated(scope)
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


def _stated(scope: Scope) -> str:
    """Return the prefix that a proxy on this machine states; empty without one."""
    return _forwarded(scope, HEADER).rstrip("/")


def _forwarded(scope: Scope, header: str) -> str:
    """Return a header of a proxy on this machine; empty without one."""
    name = header.lower().encode()
    found = [value.decode("latin-1") for key, value in scope["headers"] if key == name]
    return ", ".join(found) if found and is_loopback(scope) else ""
