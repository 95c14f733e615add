"""The processes that stand in for devices: how they run, and how they end."""

from __future__ import annotations

import contextlib
import os
import subprocess

AHEAD = -10
"""Niceness; only root may go below 0."""


def go_first(pid: int) -> None:
    """Let a process run before those of the station, as devices do not wait for the computer they are plugged into.

    Without the right to it, it runs among them.
    """
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, AHEAD)


def see_off(process: subprocess.Popen[str], patience_s: float) -> None:
    """Close what a process reads from and wait for its end; whoever does not come to it is killed."""
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # it had ended by itself
        process.stdin.close()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
