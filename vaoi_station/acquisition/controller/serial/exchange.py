"""Questions and answers over one port: the link of the protocol, kept turning by whoever waits for an answer."""

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
"""Heartbeats and repetitions are looked after this often."""
IDENTIFY_S = 4.0
"""A bootloader swallows the first bytes for one to two seconds."""


class SilentError(DeviceError):
    """The port is there, but nothing answers."""

    code = "controller-silent"


class PortLostError(DeviceError):
    """The port was there, and has gone."""

    code = "port-lost"


class ResetError(DeviceError):
    """The controller has been reset; nothing is configured any more."""

    code = "controller-reset"


class RefusalError(DeviceError):
    """The controller refuses a request."""

    code = "controller-refused"

    nak: Nak

    @classmethod
    def of(cls, nak: Nak) -> RefusalError:
        """Its describe."""
        error = cls(describe(nak), action="Check [line] and [controller] in station.toml.")
        error.nak = nak
        return error


OnNotification = Callable[[EventReceived | EventsLost, float], None]
"""Called with what happened and the host time at which that was heard."""


class Exchange:
    """One port, for one thread; the link outlives it."""

    def __init__(self, port: Port, link: Link, on_notification: OnNotification, name: str) -> None:
        self.port, self.link, self._on_notification, self._name = port, link, on_notification, name
        self._messages_before = link.messages
        self._last_message_s = time.monotonic()

    @property
    def silence_s(self) -> float:
        """For how long nothing has been understood."""
        return time.monotonic() - self._last_message_s

    def request(self, request: Request) -> Replied:
        """Wait for the reply. Raises RefusalError, SilentError, ResetError or PortLostError."""
        self.link.request(request)
        while True:
            for item in self.poll():
                if isinstance(item, Replied):
                    return item
                if isinstance(item, Refused):
                    raise RefusalError.of(item.nak)
                if isinstance(item, Unanswered):
                    raise SilentError(
                        f"The controller at {self._name} does not answer.",
                        action="Check its power and its cable.",
                    )

    def read_status(self) -> Status:
        """As it is now, with every event up to then on_notification."""
        self.request(Request(Type.STATUS))
        while not self.link.up_to_date:
            self.poll()
            self._check_alive()
        assert self.link.status is not None
        return self.link.status

    def poll(self) -> list[Notification]:
        """Send what is due, and take what comes within a moment. Raises ResetError or PortLostError."""
        try:
            if data := self.link.outgoing(time.monotonic()):
                self.port.write(data)
            data = self.port.read(POLL_S)
        except OSError as error:
            raise PortLostError(
                f"The serial port {self._name} has gone ({error.strerror}).",
                action="Plug the controller in again, and check its cable.",
            ) from error
        messages, now_s = self.link.messages, time.monotonic()
        news = self.link.receive(data, now_s)
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
        return news

    def identify(self) -> bytes:
        """Ask who it is until it answers; the payload of its answer, or DeviceError for what does not.

        A reset that is noticed meanwhile changes nothing here: nothing else has been asked of it yet.
        """
        give_up_s = time.monotonic() + IDENTIFY_S
        while time.monotonic() < give_up_s:
            try:
                payload = self.request(Request(Type.IDENT)).payload
                check_ident(payload)
                return payload
            except (SilentError, ResetError):
                continue
        raise self._no_reply()

    def _no_reply(self) -> DeviceError:
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
