"""A serial port: one thread reads, other threads can wake it. The controller is not reset when the port is closed.

pyserial only opens and configures the port. Reading and writing go through the descriptor, so that one `poll` waits for
bytes and for a wake-up.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios

import serial

from vaoi_station.errors import DeviceError

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
        """Open a port.

        Raises:
            DeviceError: the port cannot be opened; the error says why, and what to do.
        """
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
