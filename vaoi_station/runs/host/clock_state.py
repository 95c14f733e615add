"""State of the machine's clock: whether it is synchronised, its largest error, and the time zone."""

from __future__ import annotations

import ctypes
import os
import time
from dataclasses import dataclass
from pathlib import Path

LOCAL_TIME = Path("/etc/localtime")
_UNSYNCHRONISED = 5
"""TIME_ERROR of adjtimex(2): no program keeps the clock right, or its largest error is unknown."""


@dataclass(frozen=True)
class ClockState:
    """State of the wall clock at one moment."""

    synchronised: bool | None
    """Whether the kernel knows that a program such as chrony keeps the clock right; None if that is not known."""
    max_error_s: float | None
    """Largest error of the clock by the kernel's estimate, s; None if it is not synchronised."""
    time_zone: str
    """Name of the time zone, or its abbreviation if the machine has no name for it."""
    utc_offset_s: int
    """Local time minus UTC, s."""


class _Timex(ctypes.Structure):
    """The beginning of `struct timex`; the rest is not read."""

    _fields_ = [
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("frequency", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("rest", ctypes.c_byte * 256),
    ]


def clock_state() -> ClockState:
    """Return the present state of the machine's clock."""
    local = time.localtime()
    synchronised, max_error_s = _kernel_state()
    return ClockState(synchronised, max_error_s, _zone_name() or local.tm_zone, local.tm_gmtoff)


def _kernel_state() -> tuple[bool | None, float | None]:
    """Ask the kernel, without changing anything (modes 0 needs no privilege)."""
    timex = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):  # no such function in this C library
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
