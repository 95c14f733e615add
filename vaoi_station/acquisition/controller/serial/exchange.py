"""Exchange requests and replies over one serial port: run the protocol's `Link` while a caller awaits a reply."""

from __future__ import annotations

import time
from collections.abc import Callable

from vaoi_station.acquisition.controller.protocol.link import (
    EventReceived,
    EventsLost,
    Link,
    Notification,
    Refused,
    Replied,
    Restarted,
    Unanswered,
)
from vaoi_station.acquisition.controller.protocol.messages import Nak, Request, Status, Type
from vaoi_station.acquisition.controller.protocol.refusals import check_ident, describe
from vaoi_station.acquisition.controller.serial.port import Port
from vaoi_station.errors import DeviceError

POLL_S = 0.05
"""Longest wait for bytes, and so the precision of heartbeats and retries."""
IDENTIFY_S = 4.0
"""Time for which IDENT is repeated, s: a bootloader swallows the first bytes for 1 to 2 s after a reset."""


class SilentError(DeviceError):
    """The serial port exists, but no controller replies there."""

    code = "controller-silent"


class PortLostError(DeviceError):
    """The serial port disappeared while it was open."""

    code = "port-lost"


class ResetError(DeviceError):
    """The controller was reset, and has lost its configuration."""

    code = "controller-reset"


class RefusalError(DeviceError):
    """The controller refused the request."""

    code = "controller-refused"

    nak: Nak

    @classmethod
    def of(cls, nak: Nak) -> RefusalError:
        """Return the error that describes a refusal (NAK message) of the controller."""
        error = cls(describe(nak), action="Check [line] and [controller] in station.toml.")
        error.nak = nak
        return error


OnNotification = Callable[[EventReceived | EventsLost, float], None]
"""Callback with an event, or a count of lost ones, and the host time of its arrival."""


class Exchange:
    """Sends requests over one open port and waits for the replies. Used by one thread.

    The protocol's `link` is kept when the port is closed and opened again.
    """

    def __init__(self, port: Port, link: Link, on_notification: OnNotification, name: str) -> None:
        self.port, self.link, self._on_notification, self._name = port, link, on_notification, name
        self._messages_before = link.messages
        self._last_message_s = time.monotonic()

    @property
    def silence_s(self) -> float:
        """Time since the last valid message of the controller, in s."""
        return time.monotonic() - self._last_message_s

    def request(self, request: Request) -> Replied:
        """Send a request and wait for its reply.

        Raises:
            RefusalError: the controller refuses the request.
            SilentError: no try had a reply.
            ResetError: the controller was reset meanwhile.
            PortLostError: the port has gone.
        """
        self.link.request(request)
        while True:
            for item in self.poll():
                if isinstance(item, Replied):
                    return item
                if isinstance(item, Refused):
                    raise RefusalError.of(item.nak)

    def read_status(self) -> Status:
        """Read the present status. All events that occurred before it are passed on first."""
        self.request(Request(Type.STATUS))
        while not self.link.up_to_date:
            self.poll()
            self._check_alive()
        assert self.link.status is not None
        return self.link.status

    def poll(self) -> list[Notification]:
        """Send the bytes that are due, and process those that arrive within `POLL_S`.

        Raises:
            SilentError: a request had no reply; this may be a heartbeat, which no caller requested.
            ResetError: the controller was reset.
            PortLostError: the port has gone.
        """
        begun_s = time.monotonic()
        try:
            if data := self.link.outgoing(begun_s):
                self.port.write(data)
            data = self.port.read(POLL_S)
        except OSError as error:
            raise PortLostError(
                f"The serial port {self._name} has gone ({error.strerror}).",
                action="Plug the controller in again, and check its cable.",
            ) from error
        # The time is taken after the wait, directly after the read: it limits when the reply arrived, for the clock
        # fit.
        messages, now_s = self.link.messages, time.monotonic()
        # This process may have waited for the CPU after the read, while a reply arrived. So the time before the read
        # decides whether a reply is missing.
        news = self.link.receive(data, now_s, begun_s)
        if self.link.messages > messages:
            self._last_message_s = now_s
        for item in news:
            if isinstance(item, EventReceived | EventsLost):
                self._on_notification(item, now_s)
            elif isinstance(item, Restarted):
                self.link.drop_requests()
                raise ResetError(
                    f"The controller was reset (its start number {item.boots}).",
                    action="Nothing: it is being configured again.",
                )
            elif isinstance(item, Unanswered):
                # The request of the caller may still be queued. If it were sent later, its reply
                # would be taken for the reply to another request.
                self.link.drop_requests()
                raise SilentError(
                    f"The controller at {self._name} does not answer.",
                    action="Check its power and its cable.",
                )
        return news

    def identify(self) -> bytes:
        """Request IDENT until the controller replies, and return the content of the reply.

        Raises:
            DeviceError: the controller does not reply in time.
        """
        give_up_s = time.monotonic() + IDENTIFY_S
        while time.monotonic() < give_up_s:
            try:
                payload = self.request(Request(Type.IDENT)).payload
                check_ident(payload)
                return payload
            # A reset is normal here: opening a port resets many boards (pyserial #124). Nothing else is pending yet.
            except (SilentError, ResetError):
                continue
        raise self._no_reply()

    def _no_reply(self) -> DeviceError:
        # Bytes without one valid message: another device, or another baud rate.
        if self.port.received and self.link.messages == self._messages_before:
            return DeviceError(
                f"What is at {self._name} sends bytes, but no message of the trigger controller's protocol.",
                action="Check which device the port leads to, its baud rate, and that our firmware is on it.",
                code="foreign-device",
            )
        return SilentError(
            f"Nothing at {self._name} answers as a trigger controller.",
            action="Check its power and its cable, and that our firmware is on it.",
        )

    def _check_alive(self) -> None:
        if self.silence_s > IDENTIFY_S:
            raise self._no_reply()
