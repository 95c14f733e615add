"""Processes that tests start, or wait for."""

from __future__ import annotations

import os
import select
import subprocess
from pathlib import Path

from vaoi_station.rig.network import NAMESPACE_VARIABLE, isolation_command

ROOT = Path(__file__).resolve().parents[1]


def ends_within(pid: int, timeout_s: float) -> bool:
    """Wait for the end of a process that need not be a child of this one; return whether it came in time."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([handle], [], [], timeout_s)[0])
    finally:
        os.close(handle)


def run_in_own_network(*command: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a new network namespace and return its exit code and output."""
    return subprocess.run(
        [*isolation_command(), *command],
        cwd=ROOT,
        env=os.environ | {NAMESPACE_VARIABLE: "1"},
        check=False,
        timeout=280,
        capture_output=True,
        text=True,
    )
