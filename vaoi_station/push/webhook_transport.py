"""Sends messages as signed webhooks (Standard Webhooks specification)."""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from vaoi_station.errors import VaoiError
from vaoi_station.push.http_post import NotDeliveredError, Route, post
from vaoi_station.push.messages import Message
from vaoi_station.push.signing import signatures
from vaoi_station.push.transport import Outcome
from vaoi_station.version import __version__

LIMIT_S = 20.0
"""Longest time for one delivery; the specification recommends 15 to 30 s."""
GONE, MOVED = 410, range(300, 400)


class WebhookTransport:
    """Sends messages to one URL. It is replaced, not changed, when its webhook changes."""

    def __init__(
        self,
        url: str,
        secrets: Callable[[], Sequence[str]],
        networks: Sequence[str] = (),
        ca: Path | None = None,
        limit_s: float = LIMIT_S,
    ) -> None:
        """Prepare a transport.

        Args:
            url: the receiver.
            secrets: returns the secrets that sign at present; it may raise `VaoiError`.
            networks: networks in which the receiver may be; empty for the default.
            ca: PEM file with authorities that are trusted besides those of the system.
            limit_s: longest time for one delivery, s.
        """
        self._url, self._secrets, self._networks, self._ca, self._limit_s = url, secrets, networks, ca, limit_s

    def send(self, message: Message) -> Outcome:
        """Send one message; any status of 200 to 299 accepts it."""
        try:
            keys, context = self._secrets(), self._context()
            now = int(time.time())
            headers = {
                "User-Agent": f"vaoi-station/{__version__}",
                "Content-Type": "application/json",
                "webhook-id": message.id,
                "webhook-timestamp": str(now),
                "webhook-signature": signatures(keys, message.id, now, message.body),
            }
            reply = post(self._url, headers, message.body, Route(context, self._networks, self._limit_s))
        except VaoiError as error:
            return Outcome(False, str(error))
        except NotDeliveredError as error:
            return Outcome(False, f"{error}.")
        if 200 <= reply.status < 300:
            return Outcome(True, f"status {reply.status}")
        note = ": redirects are not followed; give the new URL" if reply.status in MOVED else ""
        detail = f"The receiver answers with status {reply.status}{note}."
        return Outcome(False, detail, reply.retry_after_s, gone=reply.status == GONE)

    def idle(self) -> Outcome | None:
        """Do nothing: each message has a connection of its own."""

    def close(self) -> None:
        """Do nothing: no connection is open between messages."""

    def _context(self) -> ssl.SSLContext | None:
        if not self._url.startswith("https:"):
            return None
        # Made for each message, so that a renewed file of authorities is used without a restart.
        context = ssl.create_default_context()
        if self._ca is not None:
            try:
                context.load_verify_locations(self._ca)
            except (OSError, ssl.SSLError) as error:
                raise NotDeliveredError(f"{self._ca}: cannot be read as PEM certificates ({error})") from error
        return context
