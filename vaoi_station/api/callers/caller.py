"""The caller of a request: the unit to which limits apply."""

from __future__ import annotations

from dataclasses import dataclass

from fastapi import Request
from starlette.types import Scope

from vaoi_station.api.listener.connections import caller_address
from vaoi_station.files.access_keys import AccessKey

_KEY = "caller"


@dataclass(frozen=True)
class Caller:
    """The sender of a request."""

    address: str
    """IP address (for IPv6 the network) by which the caller is counted."""
    key: str | None = None
    """Name of the caller's key; None without a key."""
    scopes: frozenset[str] = frozenset()
    """Scopes that the caller has."""
    access_key: AccessKey | None = None
    """The key itself, as it was when the request began."""

    @property
    def name(self) -> str:
        """Name under which the caller's use of resources is counted."""
        return self.address if self.key is None else f"key {self.key}"


def set_caller(scope: Scope, caller: Caller | None = None) -> Caller:
    """Store the caller of a request in its scope, and return it; by default one without a key."""
    client = scope.get("client")
    if caller is None:
        caller = Caller(caller_address(client[0]) if client else "local")
    scope.setdefault("state", {})[_KEY] = caller
    return caller


def caller_in(scope: Scope) -> Caller:
    """Return the caller that `set_caller` has stored in the scope of a request."""
    caller: Caller = scope["state"][_KEY]
    return caller


def caller_of(request: Request) -> Caller:
    """Return the caller of a request."""
    return caller_in(request.scope)
