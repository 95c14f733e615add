"""Run ids, which are unique and sort by time, and times: their format, RFC 3339 in UTC, and the last midnight."""

from __future__ import annotations

import secrets
import time
from datetime import UTC, datetime, timedelta

_DIGITS = "0123456789abcdefghjkmnpqrstvwxyz"
"""The digits of Crockford's base 32, in ASCII order. The letters i, l, o and u are not used."""
_TIME_DIGITS, _RANDOM_DIGITS = 10, 6

FIRST, LAST = datetime(2, 1, 1, tzinfo=UTC), datetime(9998, 1, 1, tzinfo=UTC)
"""Times beyond these cannot be converted to UTC from every zone."""


def utc(moment: datetime | None = None) -> str:
    """Format a time in UTC as RFC 3339 with milliseconds; None formats the present time."""
    return (moment or datetime.now(UTC)).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def in_utc(moment: datetime) -> datetime:
    """Return a time that a caller states, in UTC; the first or last one that is possible if it is beyond."""
    return min(max(moment, FIRST), LAST).astimezone(UTC)


def last_midnight(now: datetime | None = None) -> datetime:
    """Return in UTC when the day of a local time, by default of the present one, began in the machine's time zone."""
    # An administrator may have set another time zone while the station runs.
    time.tzset()
    # The offset of midnight, not the present one: summer time may have begun or ended since. `timestamp`, because
    # `astimezone` is wrong by an hour if the clock was put forward at midnight itself.
    midnight = (now or datetime.now()).replace(hour=0, minute=0, second=0, microsecond=0, fold=0)
    return datetime.fromtimestamp(midnight.timestamp(), UTC)


def utc_of_host(host_s: float) -> str:
    """Format a recent host time, a value of time.monotonic(), as RFC 3339 in UTC."""
    # The two clocks are compared now. If the wall clock was set since `host_s`, the returned time is wrong by that
    # step.
    return utc(datetime.now(UTC) - timedelta(seconds=time.monotonic() - host_s))


class RunIds:
    """Generator of run ids. An id is the time in milliseconds since 1970, then a random part, both in base 32.

    Each id sorts after the one before. An id is assigned when memory is granted, which may be long before the board
    comes, so its time is not that of the board. The order of the ids is the order of the boards.
    """

    def __init__(self, last: str | None = None) -> None:
        self._last_ms = _number(last.partition("-")[0]) if last else 0

    def next(self) -> str:
        """Return a new id, which sorts after the previous one even if the machine's clock was set back."""
        self._last_ms = max(self._last_ms + 1, time.time_ns() // 1_000_000)
        # The random part makes ids unique across stations, and after the database of a station was replaced.
        chance = _text(secrets.randbelow(32**_RANDOM_DIGITS), _RANDOM_DIGITS)
        return f"{_text(self._last_ms, _TIME_DIGITS)}-{chance}"


def is_run_id(text: str) -> bool:
    """Return whether a text has the form of a run id."""
    first, dash, last = text.partition("-")
    lengths = (len(first), dash, len(last)) == (_TIME_DIGITS, "-", _RANDOM_DIGITS)
    return lengths and set(first + last) <= set(_DIGITS)


def earliest_id(time_s: float) -> str:
    """Return a text that sorts before all run ids assigned from a time (s since 1970) on, and after all earlier ids."""
    return _text(max(int(time_s * 1000), 0), _TIME_DIGITS)


def assigned_s(run: str) -> float:
    """Return when a run id was assigned, in s since 1970."""
    return _number(run.partition("-")[0]) / 1000


def _text(number: int, digits: int) -> str:
    return "".join(_DIGITS[(number >> 5 * k) & 31] for k in reversed(range(digits)))


def _number(text: str) -> int:
    value = 0
    for digit in text:
        value = value * 32 + max(_DIGITS.find(digit), 0)
    return value
