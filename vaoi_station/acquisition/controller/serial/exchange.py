"""Exchange requests and replies over one serial port, and date what the controller reports.

The tick counter restarts every 35.8 minutes, which the host's time resolves, and with each reset, which begins a new
interval of one time axis, far enough from the last one that a clock fit notices the jump.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import time
from collections.abc import Callable

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
"""Number of ticks after which the controller's 32-bit counter restarts from 0."""


class TickClock:
    """The fit of the controller's clock, from one reset of the controller to the next."""

    def __init__(self, name: str = "controller") -> None:
        self.model = ClockModel(name)
        self._known = False

    def add(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """Add a reply to CLOCK. Its tick was read at a host time between `sent_s` (first request) and `received_s`."""
        # The midpoint is used, with half the round trip as bound: the split of the delay between both ways is unknown.
        host_s = (sent_s + received_s) / 2
        reading = ClockReading(self.device_s(tick, host_s), host_s, (received_s - sent_s) / 2)
        self.model.add(reading)
        self._known = True
        return reading

    def device_s(self, tick: int, near_host_s: float) -> float:
        """Return the seconds since the controller's reset for a tick that occurred within 17 minutes of a host time."""
        # Before the first reading, there is no time from which restarts of the counter could be counted. Any origin
        # will do, because the fit finds the offset.
        if not self._known:
            return tick * TICK_S
        expected = self.model.device_s(near_host_s) / TICK_S
        return (tick + _WRAP * round((expected - tick) / _WRAP)) * TICK_S


BOOT_SPACING_S = 3600.0
"""Time, s, between the end of one boot and the beginning of the next, on the time axis that covers all boots."""
BITS_PER_BYTE = 10
"""Bits on the serial line for one byte: one start bit, eight data bits, one stop bit."""
REQUEST_BYTES = 10
REPLY_BYTES = 14
"""Bytes of the frame of a CLOCK request, and of the frame of its reply."""


class Timebase:
    """Converter from the controller's ticks to seconds on the time axis, based on replies to CLOCK."""

    def __init__(self, baud: int) -> None:
        byte_s = BITS_PER_BYTE / baud
        self._request_s, self._reply_s = REQUEST_BYTES * byte_s, REPLY_BYTES * byte_s
        self._clock = TickClock()
        self._origin_s = self._latest_s = 0.0

    def restart(self) -> None:
        """Begin a new interval of the time axis after a reset of the controller."""
        self._clock = TickClock()
        self._origin_s = self._latest_s + BOOT_SPACING_S

    def add_reply(self, tick: int, sent_s: float, received_s: float) -> ClockReading:
        """Add a reply to CLOCK. Return it as a clock reading whose device time is on the time axis."""
        # The tick was read after the whole request had arrived and before the reply began, which narrows the bound.
        earliest_s, latest_s = sent_s + self._request_s, received_s - self._reply_s
        # A reply faster than the baud rate allows comes from a pseudo terminal or native USB, where byte times do not
        # apply.
        if earliest_s > latest_s:
            earliest_s, latest_s = sent_s, received_s
        reading = self._clock.add(tick, earliest_s, latest_s)
        return ClockReading(self._at(reading.device_s), reading.host_s, reading.bound_s)

    def time_s(self, tick: int, near_host_s: float) -> float:
        """Return the time, s, on the one time axis across all resets, for a tick that occurred within 17 minutes of a
        host time."""
        return self._at(self._clock.device_s(tick, near_host_s))

    def drift_ppm(self) -> float:
        """Return how much slower the controller's clock runs than the host's, in ppm."""
        return self._clock.model.drift_ppm

    def bound_s(self) -> float:
        """Return the largest error of the clock fit, in s."""
        return self._clock.model.bound_s()

    def _at(self, since_boot_s: float) -> float:
        time_s = self._origin_s + since_boot_s
        self._latest_s = max(self._latest_s, time_s)
        return time_s


WRITE_S = 1.0
"""Longest time for which a port may not accept a few bytes. After it, the port has failed."""
_CONTROL_FLAGS = 2
"""Index of the control flags (c_cflag) in the list that `termios.tcgetattr` returns."""


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
        """Open a port."""
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
        """Count of bytes received since the port was opened."""

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
    """Keep the signal DTR set when the port is closed, because some boards reset when it changes."""
    # An edge of DTR resets boards like the Arduino Nano (pyserial #124, grbl #160). The kernel drops it at the last
    # close if HUPCL is set.
    flags = termios.tcgetattr(handle)
    flags[_CONTROL_FLAGS] &= ~termios.HUPCL
    termios.tcsetattr(handle, termios.TCSANOW, flags)


def _open_error(name: str, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return DeviceError(
            f"There is no serial port {name}.",
            action="Plug the controller in; deploy/71-vaoi-controller.rules gives it the name /dev/vaoi-trigger.",
            code="port-absent",
        )
    if number in (errno.EACCES, errno.EPERM):
        return DeviceError(
            f"The serial port {name} may not be opened by this user.",
            action="Add the user to the group of the port (ls -l shows it; often dialout), and start again.",
            code="port-forbidden",
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return DeviceError(
            f"The serial port {name} is in use by another program.",
            action=f"End that program (fuser -v {name} names it).",
            code="port-in-use",
        )
    return DeviceError(
        f"{name} cannot be used as a serial port: {error}.",
        action="Check `port` and `baud` under [controller] in station.toml.",
        code="port-unusable",
    )


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
            self._check_alive()
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

    def _check_alive(self) -> None:
        if self.silence_s > IDENTIFY_S:
            raise self._no_reply()
