"""Exchange requests and replies over one serial port, and date what the controller reports.

The tick counter restarts every 35.8 minutes, which the host's time resolves, and with each reset, which begins a new
interval of one time axis, far enough from the last one that a clock fit notices the jump.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import termios
import time
from collections.abc import Callable
from dataclasses import replace

import serial

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.protocol import (
    TICK_S,
    EventReceived,
    EventsLost,
    Link,
    Nak,
    Notification,
    Refused,
    Replied,
    Request,
    Restarted,
    Status,
    Type,
    Unanswered,
    check_ident,
    describe,
)
from vaoi_station.errors import DeviceError

_WRAP = 1 << 32
BOOT_SPACING_S = 3600.0
"""Time, s, between the end of one boot and the beginning of the next, on the time axis that covers all boots."""
BITS_PER_BYTE = 10
REQUEST_BYTES, REPLY_BYTES = 10, 14


class Timebase:
    """Converts the controller's ticks to seconds on one time axis across all resets, based on replies to CLOCK."""

    def __init__(self, baud: int) -> None:
        byte_s = BITS_PER_BYTE / baud
        self._request_s, self._reply_s = REQUEST_BYTES * byte_s, REPLY_BYTES * byte_s
        self.model = ClockModel("controller")
        """The fit of the seconds since the latest reset."""
        self._origin_s = self._latest_s = 0.0

    def restart(self) -> None:
        """Begin a new interval of the time axis after a reset of the controller."""
        self.model = ClockModel("controller")
        self._origin_s = self._latest_s + BOOT_SPACING_S

    def add_reply(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """Add a reply to CLOCK. Return it as a clock reading whose device time is on the time axis."""
        # The tick was read after the whole request had arrived and before the reply began, which narrows the bound.
        earliest_s, latest_s = sent_s + self._request_s, received_s - self._reply_s
        # A reply faster than the baud rate allows comes from a pseudo terminal or native USB, where byte times do not
        # apply.
        if earliest_s > latest_s:
            earliest_s, latest_s = sent_s, received_s
        # The midpoint is used, with half the round trip as bound: the split of the delay between both ways is unknown.
        host_s, bound_s = (earliest_s + latest_s) / 2, (latest_s - earliest_s) / 2
        reading = ClockReading(self._since_boot_s(tick, host_s), host_s, bound_s)
        self.model.add(reading)
        return replace(reading, device_s=self._at(reading.device_s))

    def time_s(self, tick: int, near_host_s: float) -> float:
        """Return the time on the axis for a tick that occurred within 17 minutes of a host time."""
        return self._at(self._since_boot_s(tick, near_host_s))

    def _since_boot_s(self, tick: int, near_host_s: float) -> float:
        # Before the first reading, any count of restarts of the counter will do, because the fit finds the offset.
        if math.isinf(self.model.read_s):
            return tick * TICK_S
        expected = self.model.device_s(near_host_s) / TICK_S
        return (tick + _WRAP * round((expected - tick) / _WRAP)) * TICK_S

    def _at(self, since_boot_s: float) -> float:
        time_s = self._origin_s + since_boot_s
        self._latest_s = max(self._latest_s, time_s)
        return time_s


WRITE_S = 1.0
"""Longest time for which a port may not accept a few bytes. After it, the port has failed."""


class Waker:
    """A pipe by which another thread ends the present, or the next, `Port.read`. `poll` can wait for a pipe."""

    def __init__(self) -> None:
        self.handle, self._write_end = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    def wake(self) -> None:
        """End the present read, or the next one. Any thread may call this method."""
        # A full pipe wakes the reader too.
        with contextlib.suppress(BlockingIOError):
            os.write(self._write_end, b"\0")

    def clear(self) -> None:
        """Remove the wake-ups from the pipe, after a read has ended."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.handle, 4096)

    def close(self) -> None:
        """Close both ends of the pipe."""
        os.close(self.handle)
        os.close(self._write_end)


class Port:
    """An open serial port. Its methods raise OSError if the device has disappeared."""

    def __init__(self, name: str, baud: int, waker: Waker) -> None:
        try:
            self._serial = serial.Serial(name, baud, exclusive=True)
            _keep_dtr(self._serial.fileno())
        except (OSError, ValueError, termios.error) as error:
            raise _open_error(name, error) from error
        self._waker = waker
        self._incoming, self._outgoing = select.poll(), select.poll()
        self._incoming.register(self._serial.fileno(), select.POLLIN)
        self._incoming.register(waker.handle, select.POLLIN)
        self._outgoing.register(self._serial.fileno(), select.POLLOUT)
        self.received = 0

    def read(self, wait_s: float) -> bytes:
        """Return the bytes that have arrived; none if `wait_s` passes, or if another thread wakes this call."""
        ready = {handle for handle, _ in self._incoming.poll(wait_s * 1000)}
        if self._waker.handle in ready:
            self._waker.clear()
        if self._serial.fileno() not in ready:
            return b""
        data = os.read(self._serial.fileno(), 4096)
        # End of file: the USB bridge was unplugged. Further reads would return at once, in an endless loop.
        if not data:
            raise OSError(errno.EIO, "the device has hung up")
        self.received += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Write all bytes to the serial port."""
        # pyserial's own write is not used: it measures its timeout over the whole call, so a process that was stopped
        # (SIGSTOP) within it would report a blocked port.
        while data:
            if not self._outgoing.poll(WRITE_S * 1000):
                raise OSError(errno.ETIMEDOUT, "the device takes no bytes")
            data = data[os.write(self._serial.fileno(), data) :]

    def close(self) -> None:
        """Close the serial port."""
        with contextlib.suppress(OSError, termios.error):  # the port may have gone already
            self._serial.close()


def _keep_dtr(handle: int) -> None:
    # An edge of DTR resets boards like the Arduino Nano (pyserial #124, grbl #160). The kernel drops it at the last
    # close if HUPCL is set in the control flags.
    flags = termios.tcgetattr(handle)
    flags[2] &= ~termios.HUPCL
    termios.tcsetattr(handle, termios.TCSANOW, flags)


def _open_error(name: str, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        action = "Plug the controller in; deploy/71-vaoi-controller.rules gives it the name /dev/vaoi-trigger."
        return DeviceError(f"There is no serial port {name}.", action=action, code="port-absent")
    if number in (errno.EACCES, errno.EPERM):
        action = "Add the user to the group of the port (ls -l shows it; often dialout), and start again."
        what = f"The serial port {name} may not be opened by this user."
        return DeviceError(what, action=action, code="port-forbidden")
    if number in (errno.EBUSY, errno.EAGAIN):
        action = f"End that program (fuser -v {name} names it)."
        return DeviceError(f"The serial port {name} is in use by another program.", action=action, code="port-in-use")
    action = "Check `port` and `baud` under [controller] in station.toml."
    return DeviceError(f"{name} cannot be used as a serial port: {error}.", action=action, code="port-unusable")


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


class Exchange:
    """Sends requests over one open port and waits for the replies. Used by one thread.

    The protocol's `link` is kept when the port is closed and opened again.
    """

    def __init__(self, port: Port, link: Link, on_notification: OnNotification, name: str) -> None:
        self.port, self.link, self._on_notification, self._name = port, link, on_notification, name
        self._messages_before = link.messages
        self._last_message_s = time.monotonic()

    def request(self, request: Request) -> Replied:
        """Send a request and wait for its reply."""
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
            if time.monotonic() - self._last_message_s > IDENTIFY_S:
                raise self._no_reply()
        assert self.link.status is not None
        return self.link.status

    def poll(self) -> list[Notification]:
        """Send the bytes that are due, and process those that arrive within `POLL_S`."""
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
        """Request IDENT until the controller replies, and return the content of the reply."""
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
