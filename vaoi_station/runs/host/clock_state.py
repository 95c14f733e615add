"""State of the machine's clock: whether it is synchronised, its largest error, and the time zone."""

from __future__ import annotations

import ctypes
import os
import time
from dataclasses import dataclass
from pathlib import Path

LOCAL_TIME = Path("/etc/localtime")
_UNSYNCHRONISED = 5
"""State TIME_ERROR of adjtimex(2): no program synchronises the clock, or its largest error is unknown."""


@dataclass(frozen=True)
class ClockState:
    """State of the wall clock at one moment."""

    synchronised: bool | None
    """Whether the kernel states that a program such as chrony keeps the clock synchronised; None if not known."""
    max_error_s: float | None
    """Largest error of the clock by the kernel's estimate, s; None if it is not synchronised."""
    time_zone: str
    """Name of the time zone, or its abbreviation if the machine has no name for it."""
    utc_offset_s: int
    """Local time minus UTC, s."""


class _Timex(ctypes.Structure):
    """The beginning of the C structure `struct timex`. The rest of it is not read."""

    _fields_ = [
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("frequency", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_byte * 256),
    ]


def clock_state() -> ClockState:
    """Return the present state of the machine's clock."""
    # Otherwise the offset would be that of the time zone at the start, beside the name of the present one.
    time.tzset()
    local = time.localtime()
    synchronised, max_error_s = _kernel_state()
    return ClockState(synchronised, max_error_s, _zone_name() or local.tm_zone, local.tm_gmtoff)


def _kernel_state() -> tuple[bool | None, float | None]:
    """Read the clock's state from the kernel: whether it is synchronised, and its largest error in s; None if unknown.

    The call changes nothing: with modes 0 it needs no privilege.
    """
    timex = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):  # This C library has no such function.
        return None, None
    if state < 0:
        return None, None
    synchronised = state != _UNSYNCHRONISED
    return synchronised, timex.maxerror * 1e-6 if synchronised else None


def _zone_name() -> str | None:
    """Return the name of the time zone, such as Europe/Berlin; None if TZ and /etc/localtime do not name one."""
    if name := os.environ.get("TZ", "").removeprefix(":"):
        return name
    _, found, name = str(LOCAL_TIME.resolve()).partition("/zoneinfo/")
    return name if found else None
