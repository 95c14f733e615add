"""The logins of pages: a random cookie replaces the key, because a page must not store the key."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable
from typing import NamedTuple

from vaoi_station.files.access_keys import AccessKey

SESSION_S = 12 * 3600
"""Longest duration of a login: one shift."""
MOST_SESSIONS = 256
COOKIE = "vaoi-session"


class _Session(NamedTuple):
    key: AccessKey
    until: float


class Sessions:
    """The present logins, in memory only: a restart of the station ends them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sessions: dict[str, _Session] = {}

    def begin(self, key: AccessKey) -> str:
        """Begin a login with a key, and return the content of its cookie.

        If there are too many logins, the oldest ends.
        """
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


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
