"""The station's end of a pipe to a child process, which never waits for the child.

`Connection.send` blocks while the pipe is full. `Connection.recv` blocks while only a part of a message has arrived. So
a child that hangs, or is stopped in the middle of a large answer, would block the thread whose task is to notice this,
and every thread that waits for a lock of that thread. The bytes in the pipe are those of `Connection`, which the child
uses.
"""

from __future__ import annotations

import pickle
import socket
import struct
import threading
from collections.abc import Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from selectors import EVENT_READ, EVENT_WRITE, PollSelector
from typing import Any

_CHUNK = 1 << 20
"""Largest number of bytes that one system call reads."""
_LENGTH = struct.Struct("!i")
"""Format of the length in front of a message, as `Connection` writes it for less than 2 GiB."""


class PipeEndedError(Exception):
    """The child has closed its end, has died in the middle of a message, or has sent bytes that are no message."""


class MessagePipe:
    """One duplex pipe to a child process. `send` may be called from any thread, `receive` from one thread."""

    def __init__(self, connection: Connection[Any, Any]) -> None:
        """Take over the station's end of a `multiprocessing.Pipe()`. `close` closes it."""
        self._connection = connection
        self._socket = socket.fromfd(connection.fileno(), socket.AF_UNIX, socket.SOCK_STREAM)
        self._lock = threading.Lock()
        self._unsent = bytearray()
        self._received = bytearray()

    def fileno(self) -> int:
        """Return the file descriptor, for `wait_for`."""
        return self._socket.fileno()

    @property
    def unsent(self) -> bool:
        """Whether messages wait, completely or in part, until the child reads. `flush` sends them."""
        return bool(self._unsent)

    def send(self, message: object) -> None:
        """Send a message as far as the pipe has room, and keep the rest for `flush`; to an ended child it is lost."""
        body = ForkingPickler.dumps(message)
        with self._lock:
            self._unsent += _LENGTH.pack(len(body))
            self._unsent += body
            self._flush()

    def flush(self) -> None:
        """Send waiting messages as far as the pipe has room."""
        with self._lock:
            self._flush()

    def receive(self) -> list[Any]:
        """Return the complete messages, without waiting for more; PipeEndedError if none can come any more."""
        ended = False
        while True:
            try:
                data = self._socket.recv(_CHUNK, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                ended = True
                break
            self._received += data
            if len(data) < _CHUNK:
                break
        messages = self._complete()
        if ended and not messages:
            raise PipeEndedError
        return messages

    def close(self) -> None:
        """Close the pipe. The child then reads the end of its input."""
        with self._lock:
            self._unsent.clear()
            self._socket.close()
            self._connection.close()

    def _flush(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: self._socket.send(self._unsent, socket.MSG_DONTWAIT)]
        except BlockingIOError:
            return
        except OSError:
            self._unsent.clear()

    def _complete(self) -> list[Any]:
        messages, at = [], 0
        with memoryview(self._received) as received:
            while len(received) >= (begin := at + _LENGTH.size):
                (size,) = _LENGTH.unpack_from(received, at)
                if size < 0:
                    raise PipeEndedError("a length that cannot be")
                if len(received) < begin + size:
                    break
                messages.append(_unpickled(received[begin : begin + size]))
                at = begin + size
        del self._received[:at]
        return messages


def wait_for(pipes: Sequence[MessagePipe], others: Sequence[int], timeout_s: float) -> set[int]:
    """Wait until a pipe has data or room for its unsent messages, or another descriptor is readable; return which."""
    with PollSelector() as selector:
        for pipe in pipes:
            selector.register(pipe.fileno(), EVENT_READ | (EVENT_WRITE if pipe.unsent else 0))
        for descriptor in others:
            selector.register(descriptor, EVENT_READ)
        return {key.fd for key, _ in selector.select(max(timeout_s, 0.0))}


def _unpickled(body: memoryview) -> Any:
    try:
        return pickle.loads(body)
    except Exception as fault:  # Bytes of a broken child may raise any exception. The caller then ends this child.
        raise PipeEndedError(f"a message that cannot be read: {type(fault).__name__}: {fault}") from fault
