"""What this machine states of itself: its addresses, its clock, and how a directory is mounted."""

from __future__ import annotations

import ctypes
import errno
import ipaddress
import logging
import os
import re
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from vaoi_station.errors import DeviceError
from vaoi_station.store.storage_trouble import READ_ONLY

_log = logging.getLogger(__name__)
MOUNTS = Path("/proc/self/mountinfo")
LOCAL_TIME = Path("/etc/localtime")
_UNSYNCHRONISED = 5
"""State TIME_ERROR of adjtimex(2): no program synchronises the clock, or its largest error is unknown."""


def is_present(host: str) -> bool:
    """Return whether an interface has an IP address now. For a host name, return True without looking it up."""
    try:
        version = ipaddress.ip_address(host).version
    except ValueError:
        return True
    with socket.socket(socket.AF_INET6 if version == 6 else socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, 0))
        except OSError as error:
            return error.errno != errno.EADDRNOTAVAIL
    return True


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
        ("modes", ctypes.c_uint),  # 0: the call changes nothing, and needs no privilege
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
    """Return whether the kernel's clock is synchronised, and its largest error in s; None if unknown."""
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


class MountView(NamedTuple):
    """What prevents writing to a file system."""

    mount_read_only: bool
    """Whether the mount is read-only where this process sees it."""
    disk_read_only: bool
    """Whether the file system itself is read-only, for every process."""


def mount_view(path: Path, mounts: Path = MOUNTS) -> MountView | None:
    """Return how the file system of a path is mounted; None if this is not known."""
    try:
        lines = mounts.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return None
    view, longest, wanted = None, -1, Path(os.path.realpath(path))
    for line in lines:
        # proc(5): id, parent, device, root, mount point, options, fields of any number, "-", type, source, options.
        own, _, file_system = line.partition(" - ")
        fields, last = own.split(" "), file_system.split(" ")
        if len(fields) < 6 or len(last) < 3:
            continue
        # Blanks and other special characters are octal numbers.
        point = Path(re.sub(r"\\(\d{3})", lambda code: chr(int(code[1], 8)), fields[4]))
        # Of two mounts at one place, the later one is seen.
        if wanted.is_relative_to(point) and len(point.parts) >= longest:
            longest = len(point.parts)
            view = MountView("ro" in fields[5].split(","), "ro" in last[2].split(","))
    return view


class RemountWatch:
    """Starts the service again once the disk, which was read-only at its start, is writable for other processes.

    A service of systemd has mounts of its own: copies that are made when it starts. A copy of a mount that was
    read-only then stays read-only, although the disk is made writable afterwards (`mount -o remount,rw`).
    """

    def __init__(self, path: Path, start_again: Callable[[], object], mounts: Path = MOUNTS) -> None:
        self._path, self._start_again, self._mounts = path, start_again, mounts
        self._was_read_only = False

    def check(self, at_risk: int = 0) -> None:
        """Check the mount; `at_risk` is the number of runs that a new start would lose.

        Raises:
            DeviceError: only a new start helps, and a person must decide on it: it would lose runs, or the mount has
                been read-only since before this service began, so that it may be meant so.
        """
        view = mount_view(self._path, self._mounts)
        if view is None or not view.mount_read_only:
            self._was_read_only = False
        elif view.disk_read_only:
            self._was_read_only = True
        elif self._was_read_only and not at_risk:
            _log.warning("%s: is writable again; the service starts again, to see it so", self._path)
            self._start_again()
        else:
            lost = f"; {at_risk} runs that wait in memory or are under way are lost by it" if at_risk else ""
            raise DeviceError(
                f"{self._path}: its disk is writable, but mounted read-only where the service sees it.",
                action=f"systemctl restart vaoi-station{lost}. If that does not help, remove the read-only mount.",
                code=READ_ONLY,
            )
