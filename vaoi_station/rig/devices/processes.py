"""Priority and end of the processes that stand in for devices."""

from __future__ import annotations

import contextlib
import os
import subprocess

DEVICE_NICENESS = -10
"""Niceness of device processes; only root may go below 0."""


def raise_priority(pid: int) -> None:
    """Let a process run before those of the station; without the right to do so, leave its priority as it is."""
    # Real devices do not wait for the computer they are connected to.
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, DEVICE_NICENESS)


def stop_process(process: subprocess.Popen[str], timeout_s: float) -> None:
    """Close the standard input of a process and wait for its end; after the timeout, kill it."""
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # it had ended by itself
        process.stdin.close()
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
