"""Who a caller is, and which requests it may send: keys, the logins of pages, scopes, the station's own machine.

- Programs send `Authorization: Bearer KEY`. The page exchanges a key for a cookie. Scripts cannot read this cookie, and
  browsers send it only from the station's own pages (HttpOnly, SameSite=Strict).
- A command with the cookie must state its origin, which the middleware compares; browsers always state it.
- Callers on loopback may be permitted without a key, by configuration, but not for the scope admin. A request that a
  proxy has forwarded does not count as one from loopback.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import time
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import Any, NamedTuple

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope as Request

from vaoi_station.api.addresses import is_loopback, path_of
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.limits import Caller, caller_in, set_caller
from vaoi_station.api.problems import SAFE, problem_response
from vaoi_station.errors import VaoiError
from vaoi_station.files.access_keys import AccessKey, KeyFile, Scope

SESSION_S = 12 * 3600
"""Longest duration of a login: one shift."""
MOST_SESSIONS = 256
COOKIE = "vaoi-session"
PUBLIC = re.compile(
    r"/?|/docs|/favicon\.ico|/help|/(web|problems|help)/.*|/healthz|/readyz|/api/v1/(openapi\.json|session)"
)
"""Addresses that need no key: the page itself, documentation, health for process supervisors, and the login."""
_ADMIN = re.compile(r"/api/v1/(keys|audit|settings|calibration/(artwork|layout|trial)|cameras/search)(/.*)?")
_COMMANDS: tuple[tuple[re.Pattern[str], Scope], ...] = (
    (re.compile(r"/api/v1/station/(arm|disarm)"), "operate"),
    (re.compile(r"/api/v1/runs/[^/]+/(release|hold|pin|decision|clamped|identity/next-machine)"), "operate"),
    (re.compile(r"/api/v1/orders(/[^/]+)?"), "operate"),
    (re.compile(r"/api/v1/neighbours/boards/.+"), "operate"),
    (re.compile(r"/api/v1/board-(types|data)/.+"), "teach"),
    (re.compile(r"/api/v1/runs/[^/]+/good"), "teach"),
    (re.compile(r"/api/v1/cameras/[^/]+/trial"), "teach"),
)
OPEN_SCOPES = frozenset({"read", "operate", "teach"})
"""Scopes of callers on the station's own machine that have no key. Keys are made with `vaoi keys`."""
_FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-prefix", "x-real-ip", "via")
"""Headers of a request that a proxy made for another."""
_REFUSALS_PER_MINUTE = 60
_ADDRESS_OR_KEY = "Check the address, or use a key with this scope; /docs lists all addresses, vaoi keys list all keys."
_STILL_KNOWN = "still-known"
CHANGED = "changed"
"""Entry of a request's state: names of what a command has changed, for the audit log. Values are never written."""
_CHANGE_NOTHING = frozenset({"/api/v1/settings/check"})
"""Addresses that compute although they take a body."""


def scope_needed(method: str, path: str) -> Scope | None:
    """Return the scope that a request needs; None if it needs no key."""
    if PUBLIC.fullmatch(path):
        return None
    if _ADMIN.fullmatch(path):
        return "admin"
    if method in SAFE:
        return "read"
    # A command that is not listed needs the highest scope, so that a new command is not open by mistake.
    return next((scope for pattern, scope in _COMMANDS if pattern.fullmatch(path)), "admin")


class _Session(NamedTuple):
    key: AccessKey
    until: float


class Sessions:
    """The present logins, in memory only: a restart of the station ends them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sessions: dict[str, _Session] = {}

    def begin(self, key: AccessKey) -> str:
        """Begin a login, and return the content of its cookie. If there are too many logins, the oldest ends."""
        now = self._clock()
        self._sessions = {t: s for t, s in self._sessions.items() if s.until > now}
        while len(self._sessions) >= MOST_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        token = secrets.token_urlsafe(32)
        self._sessions[_hash(token)] = _Session(key, now + SESSION_S)
        return token

    def key_of(self, token: str, keys: tuple[AccessKey, ...]) -> AccessKey | None:
        """Return the key of a login; None if the login has ended, or if its key was rotated or revoked since."""
        session = self._sessions.get(_hash(token))
        if session is None or session.until <= self._clock() or session.key not in keys:
            return None
        return session.key

    def end(self, token: str) -> None:
        """End a login."""
        self._sessions.pop(_hash(token), None)


class AccessControl:
    """The keys, the logins and the audit log of one station."""

    def __init__(self, keys: KeyFile, audit: AuditLog, *, open_loopback: bool = True) -> None:
        self.keys, self.audit, self.sessions = keys, audit, Sessions()
        self._open_loopback = open_loopback
        self._minute, self._refused = 0, 0

    def refusal(self, scope: Request) -> Response | None:
        """Identify the caller and store it in the request; return a refusal if the request is not permitted."""
        headers, path, method = Headers(scope=scope), path_of(scope), scope["method"]
        try:
            caller, with_cookie = self._caller(scope, headers)
        except VaoiError as error:
            return problem_response(scope, error.code, error.message, status=error.status, action=error.action)
        needed = scope_needed(method, path)
        if caller is None:
            if needed is None:
                return None
            detail = f"{method} {path} needs a key with the scope {needed}; the request has no valid one."
            return problem_response(scope, "no-key", detail, headers={"WWW-Authenticate": 'Bearer realm="vaoi"'})
        set_caller(scope, caller)
        scope["state"][_STILL_KNOWN] = lambda: self._still_known(caller)
        states_origin = "origin" in headers or "sec-fetch-site" in headers
        if with_cookie and not states_origin and method not in SAFE:
            return problem_response(scope, "foreign-origin", "The command with a cookie does not state its origin.")
        if needed is not None and needed not in caller.scopes:
            scopes = ", ".join(sorted(caller.scopes))
            detail = f"{method} {path} needs the scope {needed}; {caller.name} has {scopes or 'none'}."
            # Commands to addresses that do not exist need this scope too, so that the address may be wrong.
            action = _ADDRESS_OR_KEY if needed == "admin" else ""
            return problem_response(scope, "missing-scope", detail, action=action)
        return None

    def log_in(self, scope: Request, key: AccessKey) -> tuple[Caller, str]:
        """Begin the login of a page, name its key in the audit log, and return caller and token of its cookie."""
        caller = self._with_login(scope, key)
        set_caller(scope, caller)
        return caller, self.sessions.begin(key)

    def note(self, scope: Request, status: int, begun: float) -> None:
        """Write a command, or a refusal because of a missing key, to the audit log."""
        if status in (401, 403):
            minute = int(time.monotonic() // 60)
            self._minute, self._refused = minute, self._refused + 1 if minute == self._minute else 1
            if self._refused > _REFUSALS_PER_MINUTE:
                return
        elif scope["method"] in SAFE or path_of(scope) in _CHANGE_NOTHING:
            return
        caller = caller_in(scope)
        entry: dict[str, Any] = {
            "key": caller.key or ("loopback" if caller.scopes else "none"),
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

    def _caller(self, scope: Request, headers: Headers) -> tuple[Caller | None, bool]:
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
                return self._with_login(scope, key), True
        return (Caller(address, scopes=OPEN_SCOPES) if self._is_open(scope) else None), False

    def _is_open(self, scope: Request) -> bool:
        """Return whether the caller may do without a key: it is on this machine, and that is open."""
        headers = Headers(scope=scope)
        return self._open_loopback and not any(name in headers for name in _FORWARDED) and is_loopback(scope)

    def _with_login(self, scope: Request, key: AccessKey) -> Caller:
        # A login takes nothing away that is permitted without one.
        return _with_key(caller_in(scope).address, key, OPEN_SCOPES if self._is_open(scope) else frozenset())

    def _still_known(self, caller: Caller) -> bool:
        try:
            return caller.access_key is None or caller.access_key in self.keys.entries()
        except VaoiError:
            return False


def still_known(scope: Request) -> bool:
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


def _with_key(address: str, key: AccessKey, open_scopes: frozenset[str] = frozenset()) -> Caller:
    # Every key may read: a program that arms the line must also see the state.
    return Caller(address, key.name, frozenset({"read", *key.scopes}) | open_scopes, key)


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
