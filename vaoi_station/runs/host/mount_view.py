"""How a directory is mounted where this process sees it, and a service that must start again to see it writable.

A service of systemd has mounts of its own: copies that are made when it starts. A copy of a mount that was read-only
then stays read-only, although the disk is made writable afterwards (`mount -o remount,rw`). Only a new start helps.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from vaoi_station.errors import DeviceError
from vaoi_station.store.storage_trouble import READ_ONLY

_log = logging.getLogger(__name__)
MOUNTS = Path("/proc/self/mountinfo")


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
    """Starts the service again once the disk, which was read-only at its start, is writable for other processes."""

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
