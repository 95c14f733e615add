"""A process that the station watches and ends by a pidfd, also if another process is its parent."""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress

MS_PER_S = 1000.0


class ChildProcess:
    """One process. Its pidfd stands for this process alone, also after its pid was given to another one."""

    def __init__(self, pid: int, pidfd: int) -> None:
        """Take over a pidfd. `close` closes it."""
        self.pid = pid
        self._pidfd = pidfd
        self.exit_code: int | None = None
        """Its exit code, negative for the number of a signal; None while it is unknown."""

    def fileno(self) -> int:
        """Return the pidfd, which is readable when the process has ended."""
        return self._pidfd

    def has_ended(self, timeout_s: float = 0.0) -> bool:
        """Wait until the process has ended, at most `timeout_s`, and return whether it has."""
        poll = select.poll()
        poll.register(self._pidfd, select.POLLIN)
        return bool(poll.poll(max(timeout_s, 0.0) * MS_PER_S))

    def kill(self) -> None:
        """Kill the process at once. A process that has ended is left alone."""
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)

    def close(self) -> None:
        """Close the pidfd. The process goes on if it still runs."""
        os.close(self._pidfd)
