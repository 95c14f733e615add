"""Messages to systemd for a unit with `Type=notify`: ready, watchdog, status, stopping.

Outside of systemd, the environment variable NOTIFY_SOCKET is not set, and no message is sent.
"""

from __future__ import annotations

import os
import socket


def notify(state: str) -> bool:
    """Send a message such as `READY=1` to systemd (sd_notify(3)); return False if it was not delivered."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    # In the address of an abstract socket, "@" stands for the zero byte (unix(7)).
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
        try:
            channel.sendto(state.encode(), address)
        except OSError:
            # The service must not fail because systemd has gone.
            return False
    return True


def notify_watchdog() -> None:
    """Report to systemd's watchdog that the station is alive."""
    notify("WATCHDOG=1")


class StatusNotice:
    """Sends systemd the line that `systemctl status` shows, after each change. Used by one thread."""

    def __init__(self) -> None:
        self._sent = ""

    def __call__(self, status: str) -> None:
        """Send a status if it differs from the last one; only its first line is shown."""
        if status != self._sent and notify(f"STATUS={status.splitlines()[0] if status else ''}"):
            self._sent = status
