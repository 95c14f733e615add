"""A neighbour that is played by hand: `vaoi line send` sends messages to a station and prints what it answers."""

from __future__ import annotations

import errno
import socket
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import closing

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.hermes.framing import Framing
from vaoi_station.hermes.messages import MESSAGES, Message, ProtocolError, message_of_text, read_message
from vaoi_station.hermes.session import COMPLETE, Role, Session

WAIT = "wait:"


class PlayedNeighbour:
    """Plays a machine: as `sender` it listens and has boards, as `receiver` it connects and gets them."""

    def __init__(
        self, role: Role, address: tuple[str, int], lane: int, limit_s: float, show: Callable[[str], object]
    ) -> None:
        """Prepare; `limit_s` is the longest wait for a connection or a message, `show` prints a line."""
        self._role, self._address, self._limit_s, self._show = role, address, limit_s, show
        self._session = Session(role, "played by hand", lane, time.monotonic())
        self._framing, self._came = Framing(), list[Message]()
        self._board = str(uuid.uuid4())

    def play(self, steps: Sequence[str]) -> None:
        """Send the messages in turn; `wait:NAME` waits for one of the station.

        Raises:
            InputError: a step is no message.
            DeviceError: the station is not reached, ends the connection, or does not send what is waited for.
        """
        messages = [step if _is_wait(step) else message_of_text(step) for step in steps]
        with closing(self._connected()) as connection:
            if self._role == "receiver":
                self._send(connection, self._session.hello())
            self._until(connection, "ServiceDescription")
            for step in messages:
                if isinstance(step, Message):
                    self._send(connection, self._filled(step))
                else:
                    self._until(connection, step.removeprefix(WAIT))

    def _connected(self) -> socket.socket:
        try:
            if self._role == "receiver":
                return socket.create_connection(self._address, self._limit_s)
            with socket.create_server(self._address) as server:
                server.settimeout(self._limit_s)
                self._show(f"waiting for the station at {self._address[0]}:{self._address[1]}")
                connection, (host, *_) = server.accept()
                self._show(f"connected by {host}")
                return connection
        except OSError as error:
            where = f"{self._address[0]}:{self._address[1]}"
            action = "Check the table [hermes] of the station, and the address."
            if error.errno == errno.EADDRINUSE:
                raise DeviceError(
                    f"{where} is in use on this machine.", action="Give another port with --address, and as upstream."
                ) from None
            raise DeviceError(
                f"{where}: the station is not reached: {error.strerror or error}.", action=action
            ) from None

    def _filled(self, message: Message) -> Message:
        """Return a message with the attributes that it must have; the board is that of this call."""
        board = message.get("BoardId") or self._session.board or self._board
        usual = {"BoardId": board, "BoardIdCreatedBy": "played by hand", "TransferState": COMPLETE}
        usual |= dict.fromkeys(("FailedBoard", "FlippedBoard"), "0")
        usual |= {"NotificationCode": "0", "Severity": "4", "Command": "1"}
        must, _ = MESSAGES[message.tag]
        return Message(message.tag, {n: usual[n] for n in sorted(must) if n in usual} | dict(message.values))

    def _send(self, connection: socket.socket, message: Message) -> None:
        if self._session.may_send(message.tag):
            self._session.sent(message)
        # What the state does not allow is sent as well: the station has to answer to it.
        self._show(f"  → {message}")
        connection.sendall(message.to_bytes())

    def _until(self, connection: socket.socket, tag: str) -> None:
        """Wait for a message; those that come before it are shown as well."""
        until_s = time.monotonic() + self._limit_s
        while True:
            while self._came:
                if self._came.pop(0).tag == tag:
                    return
            connection.settimeout(max(until_s - time.monotonic(), 0.01))
            try:
                data = connection.recv(65_536)
            except TimeoutError:
                raise DeviceError(
                    f"{tag} did not come within {self._limit_s:g} s.", action="See docs/line.md."
                ) from None
            except OSError as error:
                raise DeviceError(f"The connection broke: {error.strerror}.", action="See the station's log.") from None
            if not data:
                raise DeviceError(f"The station ended the connection before {tag}.", action="See the station's log.")
            self._read(connection, data)

    def _read(self, connection: socket.socket, data: bytes) -> None:
        try:
            read = [message for raw in self._framing.feed(data) if (message := read_message(raw)) is not None]
        except ProtocolError as error:
            raise DeviceError(f"The station sent what is no message: {error}.", action="Report it.") from None
        for message in read:
            self._show(f"  ← {message}")
            answer = self._session.received(message, time.monotonic())
            for reply in answer.send:
                self._send(connection, reply)
            self._came.append(message)


def _is_wait(step: str) -> bool:
    if not step.startswith(WAIT):
        return False
    if (tag := step.removeprefix(WAIT)) not in MESSAGES:
        raise InputError.field("line send", "wait", tag, f"one of {', '.join(MESSAGES)}")
    return True
