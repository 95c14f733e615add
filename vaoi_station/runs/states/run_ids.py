"""Names and times of runs: ids that sort by time and are never given twice, RFC 3339 in UTC."""

from __future__ import annotations

import secrets
import time
from datetime import UTC, datetime, timedelta

_DIGITS = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford's base 32, in ASCII order: no i, l, o, u."""
_TIME_DIGITS, _RANDOM_DIGITS = 10, 6


def utc(moment: datetime | None = None) -> str:
    """RFC 3339 with milliseconds; without a moment, now."""
    return (moment or datetime.now(UTC)).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_of_host(host_s: float) -> str:
    """RFC 3339 of a recent time.monotonic()."""
    return utc(datetime.now(UTC) - timedelta(seconds=time.monotonic() - host_s))


class RunIds:
    """Makes run ids: milliseconds since 1970 and some chance, in base 32; each above the one before.

    An id is given when memory is granted, which may be long before the board comes; the order of the
    ids is the order of the boards.
    """

    def __init__(self, last: str | None = None) -> None:
        self._last_ms = _number(last.partition("-")[0]) if last else 0

    def next(self) -> str:
        """A new id; also above the last one if the clock was set back."""
        self._last_ms = max(self._last_ms + 1, time.time_ns() // 1_000_000)
        chance = _text(secrets.randbelow(32**_RANDOM_DIGITS), _RANDOM_DIGITS)
        return f"{_text(self._last_ms, _TIME_DIGITS)}-{chance}"


def _text(number: int, digits: int) -> str:
    return "".join(_DIGITS[(number >> 5 * k) & 31] for k in reversed(range(digits)))


def _number(text: str) -> int:
    value = 0
    for digit in text:
        value = value * 32 + max(_DIGITS.find(digit), 0)
    return value
