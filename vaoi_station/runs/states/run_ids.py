"""Run ids, which sort by time and are unique, and times as RFC 3339 in UTC."""

from __future__ import annotations

import secrets
import time
from datetime import UTC, datetime, timedelta

_DIGITS = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford's base 32, in ASCII order: no i, l, o, u."""
_TIME_DIGITS, _RANDOM_DIGITS = 10, 6


def utc(moment: datetime | None = None) -> str:
    """Format a moment (now, if None) as RFC 3339 with milliseconds."""
    return (moment or datetime.now(UTC)).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_of_host(host_s: float) -> str:
    """Format a recent time.monotonic() as RFC 3339."""
    # The clocks are compared at this moment only: an old moment would include every step of the wall clock since.
    return utc(datetime.now(UTC) - timedelta(seconds=time.monotonic() - host_s))


class RunIds:
    """Generator of run ids: milliseconds since 1970 and a random part, in base 32; each is above the one before.

    An id is assigned when memory is granted, which may be long before the board comes; the order of the ids is the
    order of the boards.
    """

    def __init__(self, last: str | None = None) -> None:
        self._last_ms = _number(last.partition("-")[0]) if last else 0

    def next(self) -> str:
        """Return a new id, above the last one even if the clock was set back."""
        self._last_ms = max(self._last_ms + 1, time.time_ns() // 1_000_000)
        # The random part separates the ids of two stations, or of one whose database was replaced.
        chance = _text(secrets.randbelow(32**_RANDOM_DIGITS), _RANDOM_DIGITS)
        return f"{_text(self._last_ms, _TIME_DIGITS)}-{chance}"


def _text(number: int, digits: int) -> str:
    return "".join(_DIGITS[(number >> 5 * k) & 31] for k in reversed(range(digits)))


def _number(text: str) -> int:
    value = 0
    for digit in text:
        value = value * 32 + max(_DIGITS.find(digit), 0)
    return value
