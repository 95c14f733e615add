"""Set the priority of processes that emulate devices, and stop these processes."""

from __future__ import annotations

import contextlib
import os
import subprocess

DEVICE_NICENESS = -10
"""Niceness (scheduling priority) of device processes. Only root may set a value below 0."""


def raise_priority(pid: int) -> None:
    """Give a process priority over the station's processes. Without the right to do so, change nothing."""
    # Real devices do not wait for the station's CPU. So emulated devices should wait as little as possible.
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, DEVICE_NICENESS)


def stop_process(process: subprocess.Popen[str], timeout_s: float) -> None:
    """Close the standard input of a process and wait for its end. Kill the process after the timeout."""
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # the process has ended by itself
        process.stdin.close()
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
