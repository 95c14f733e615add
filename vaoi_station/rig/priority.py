"""Devices do not wait for the computer they are plugged into: what stands in for them goes first, if it may."""

from __future__ import annotations

import contextlib
import os

AHEAD = -10
"""Niceness; only root may go below 0."""


def go_first(pid: int) -> None:
    """Let a process run before those of the station; without the right to it, among them."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, AHEAD)
