"""Identifies the caller of a request, and decides whether the request is permitted.

The caller is known by a key, by the login of a page, or by an address of the station's own machine.

- Programs send `Authorization: Bearer KEY`. The page exchanges a key for a cookie. Scripts cannot read this cookie, and
  browsers send it only from the station's own pages (HttpOnly, SameSite=Strict).
- A command with the cookie must state its origin, which `RequestGuard` compares; browsers always state it.
- Callers on loopback may be permitted without a key, by configuration, but not for the scope admin. A request that a
  proxy has forwarded does not count as one from loopback.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

from vaoi_station.api.access.audit import AuditLog
from vaoi_station.api.access.scopes import scope_needed
from vaoi_station.api.access.sessions import COOKIE, Sessions
from vaoi_station.api.addressing.hosts import is_loopback
from vaoi_station.api.addressing.path_prefix import path_of
from vaoi_station.api.callers.caller import Caller, caller_in, set_caller
from vaoi_station.api.problems import problem_response
from vaoi_station.errors import VaoiError
from vaoi_station.files.access_keys import AccessKey, KeyFile

OPEN_SCOPES = frozenset({"read", "operate", "teach"})
"""Scopes of callers on the station's own machine that have no key. Keys are made with `vaoi keys`."""
LOCAL = "loopback"
_FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-prefix", "x-real-ip", "via")
"""Headers of a request that a proxy made for another."""
_REFUSALS_PER_MINUTE = 60
_ADDRESS_OR_KEY = "Check the address, or use a key with this scope; /docs lists all addresses, vaoi keys list all keys."
_STILL_KNOWN = "still-known"
CHANGED = "changed"
"""Entry of a request's state: names of what a command has changed, for the audit log. Values are never written."""
_CHANGE_NOTHING = frozenset({"/api/v1/settings/check"})
"""Addresses that compute although they take a body."""


class AccessControl:
    """The keys, the logins and the audit log of one station."""

    def __init__(self, keys: KeyFile, audit: AuditLog, *, open_loopback: bool = True) -> None:
        self.keys, self.audit, self.sessions = keys, audit, Sessions()
        self._open_loopback = open_loopback
        self._minute, self._refused = 0, 0

    def refusal(self, scope: Scope) -> Response | None:
        """Identify the caller and store it in the request.

        Return a refusal if the request is not permitted, else None.
        """
        headers, path = Headers(scope=scope), path_of(scope)
        try:
            caller, with_cookie = self._caller(scope, headers)
        except VaoiError as error:
            return problem_response(scope, error.code, error.message, status=error.status, action=error.action)
        needed = scope_needed(scope["method"], path)
        if caller is None:
            if needed is None:
                set_caller(scope)
                return None
            detail = f"{scope['method']} {path} needs a key with the scope {needed}; the request has no valid one."
            return problem_response(scope, "no-key", detail, headers={"WWW-Authenticate": 'Bearer realm="vaoi"'})
        set_caller(scope, caller)
        scope["state"][_STILL_KNOWN] = lambda: self._still_known(caller)
        states_origin = "origin" in headers or "sec-fetch-site" in headers
        if with_cookie and not states_origin and scope["method"] not in ("GET", "HEAD", "OPTIONS"):
            return problem_response(scope, "foreign-origin", "The command with a cookie does not state its origin.")
        if needed is not None and needed not in caller.scopes:
            scopes = ", ".join(sorted(caller.scopes))
            detail = f"{scope['method']} {path} needs the scope {needed}; {caller.name} has {scopes or 'none'}."
            # Commands to addresses that do not exist need this scope too, so that the address may be wrong.
            action = _ADDRESS_OR_KEY if needed == "admin" else ""
            return problem_response(scope, "missing-scope", detail, action=action)
        return None

    def log_in(self, scope: Scope, key: AccessKey) -> tuple[Caller, str]:
        """Begin the login of a page, name its key in the audit log, and return caller and token of its cookie."""
        caller = self._logged_in(scope, Headers(scope=scope), caller_in(scope).address, key)
        set_caller(scope, caller)
        return caller, self.sessions.begin(key)

    def _still_known(self, caller: Caller) -> bool:
        """Return whether the key of a caller is the same as when its request began; a reply may last for hours."""
        try:
            return caller.access_key is None or caller.access_key in self.keys.entries()
        except VaoiError:
            return False

    def note(self, scope: Scope, status: int, begun: float) -> None:
        """Write a command, or a refusal because of a missing key, to the audit log."""
        if status in (401, 403):
            minute = int(time.monotonic() // 60)
            self._minute, self._refused = minute, self._refused + 1 if minute == self._minute else 1
            if self._refused > _REFUSALS_PER_MINUTE:
                return
        elif scope["method"] in ("GET", "HEAD", "OPTIONS") or path_of(scope) in _CHANGE_NOTHING:
            return
        caller: Caller = scope["state"]["caller"]
        entry: dict[str, Any] = {
            "key": caller.key or (LOCAL if caller.scopes else "none"),
            "address": caller.address,
            "method": scope["method"],
            "path": path_of(scope)[:300],
            "query": scope["query_string"].decode("latin-1")[:300],
            "status": status,
            "ms": round((time.monotonic() - begun) * 1000),
        }
        if (changed := scope["state"].get(CHANGED)) is not None:
            entry["changed"] = changed
        self.audit.add(**entry)

    def _caller(self, scope: Scope, headers: Headers) -> tuple[Caller | None, bool]:
        """Return the caller of a request (None if unknown), and whether a cookie identified the caller."""
        address = set_caller(scope).address
        authorization = headers.get("authorization")
        if authorization is not None:
            kind, _, secret = authorization.partition(" ")
            key = self.keys.find(secret.strip()) if kind.lower() == "bearer" else None
            return (None if key is None else _with_key(address, key)), False
        if (token := session_token(headers)) is not None:
            key = self.sessions.key_of(token, self.keys.entries())
            if key is not None:
                return self._logged_in(scope, headers, address, key), True
        if self._is_open(scope, headers):
            return Caller(address, scopes=OPEN_SCOPES), False
        return None, False

    def _is_open(self, scope: Scope, headers: Headers) -> bool:
        """Return whether the caller may do without a key: it is on this machine, and that is open."""
        return self._open_loopback and not any(name in headers for name in _FORWARDED) and is_loopback(scope)

    def _logged_in(self, scope: Scope, headers: Headers, address: str, key: AccessKey) -> Caller:
        """Return the caller of a page that has logged in. A login takes nothing away that is permitted without one."""
        caller = _with_key(address, key)
        return replace(caller, scopes=caller.scopes | OPEN_SCOPES) if self._is_open(scope, headers) else caller


def still_known(scope: Scope) -> bool:
    """Return whether the caller of a request that is under way may still read; it may not when its key was revoked."""
    check: Callable[[], bool] = scope["state"].get(_STILL_KNOWN, lambda: True)
    return check()


def session_token(headers: Headers) -> str | None:
    """Return the content of the cookie of a login; None if the request has none."""
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return None if cookie is None else cookie.value


def _with_key(address: str, key: AccessKey) -> Caller:
    # Every key may read: a program that arms the line must also see the state.
    return Caller(address, key.name, frozenset({"read", *key.scopes}), key)
