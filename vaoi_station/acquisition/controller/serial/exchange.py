"""Questions and answers over one port: the link of the protocol, kept turning by whoever waits for an answer."""

from __future__ import annotations

import time
from collections.abc import Callable

from vaoi_station.acquisition.controller.protocol.link import (
    EventsLost,
    Happened,
    Link,
    News,
    Refused,
    Replied,
    Restarted,
    Unanswered,
)
from vaoi_station.acquisition.controller.protocol.messages import Nak, Request, Status, Type
from vaoi_station.acquisition.controller.protocol.refusals import check_ident, sentence
from vaoi_station.acquisition.controller.serial.port import Port
from vaoi_station.errors import DeviceError

TURN_S = 0.05
"""Heartbeats and repetitions are looked after this often."""
PATIENCE_S = 4.0
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
        """Its sentence."""
        error = cls(sentence(nak), action="Check [line] and [controller] in station.toml.")
        error.nak = nak
        return error


Told = Callable[[Happened | EventsLost, float], None]
"""Called with what happened and the host time at which that was heard."""


class Line:
    """One port, for one thread; the link outlives it."""

    def __init__(self, port: Port, link: Link, told: Told, name: str) -> None:
        self.port, self.link, self._told, self._name = port, link, told, name
        self._before = link.messages
        self._heard_s = time.monotonic()

    @property
    def silence_s(self) -> float:
        """For how long nothing has been understood."""
        return time.monotonic() - self._heard_s

    def ask(self, request: Request) -> Replied:
        """Wait for the reply. Raises RefusalError, SilentError, ResetError or PortLostError."""
        self.link.ask(request)
        while True:
            for item in self.turn():
                if isinstance(item, Replied):
                    return item
                if isinstance(item, Refused):
                    raise RefusalError.of(item.nak)
                if isinstance(item, Unanswered):
                    raise SilentError(
                        f"The controller at {self._name} does not answer.",
                        action="Check its power and its cable.",
                    )

    def status(self) -> Status:
        """As it is now, with every event up to then told."""
        self.ask(Request(Type.STATUS))
        while not self.link.up_to_date:
            self.turn()
            self._must_live()
        assert self.link.status is not None
        return self.link.status

    def turn(self) -> list[News]:
        """Send what is due, and take what comes within a moment. Raises ResetError or PortLostError."""
        try:
            if data := self.link.send(time.monotonic()):
                self.port.write(data)
            data = self.port.read(TURN_S)
        except OSError as error:
            raise PortLostError(
                f"The serial port {self._name} has gone ({error.strerror}).",
                action="Plug the controller in again, and check its cable.",
            ) from error
        messages, now_s = self.link.messages, time.monotonic()
        news = self.link.receive(data, now_s)
        if self.link.messages > messages:
            self._heard_s = now_s
        for item in news:
            if isinstance(item, Happened | EventsLost):
                self._told(item, now_s)
            elif isinstance(item, Restarted):
                self.link.abandon()
                raise ResetError(
                    f"The controller was reset (its start number {item.boots}).",
                    action="Nothing: it is being configured again.",
                )
        return news

    def identify(self) -> bytes:
        """Ask who it is until it answers; the payload of its answer, or DeviceError for what does not.

        A reset that is noticed meanwhile changes nothing here: nothing else has been asked of it yet.
        """
        give_up_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up_s:
            try:
                payload = self.ask(Request(Type.IDENT)).payload
                check_ident(payload)
                return payload
            except (SilentError, ResetError):
                continue
        raise self._nobody()

    def _nobody(self) -> DeviceError:
        if self.port.received and self.link.messages == self._before:
            return DeviceError(
                f"What is at {self._name} sends bytes, but no message of the trigger controller's protocol.",
                action="Check which device the port leads to, its baud rate, and that our firmware is on it.",
                code="foreign-device",
            )
        return SilentError(
            f"Nothing at {self._name} answers as a trigger controller.",
            action="Check its power and its cable, and that our firmware is on it.",
        )

    def _must_live(self) -> None:
        if self.silence_s > PATIENCE_S:
            raise self._nobody()
