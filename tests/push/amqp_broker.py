"""A small broker of AMQP 1.0 on loopback, on Qpid Proton's own container: queues by address, kept over restarts.

With a password it stands behind a gate that speaks the SASL of a real broker, which the container does not.
"""

from __future__ import annotations

import json
import socket
import socketserver
import sys
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.needs import lacking
from tests.peers.certificates import Certificate
from vaoi_station.acquisition.cameras.aravis.library import SYSTEM_PACKAGES
from vaoi_station.errors import DeviceError
from vaoi_station.push import proton_library

try:
    proton_library.load()
    from proton import Delivery, Message, SSLDomain
    from proton.handlers import MessagingHandler
    from proton.reactor import ApplicationEvent, Container, EventInjector

    ABSENT = ""
except DeviceError as error:
    ABSENT, MessagingHandler = f"{error.message} {error.action}", object

USER, PASSWORD = "station", "not-a-secret"
WAIT_S = 30.0
_HEADER = b"AMQP\x03\x01\x00\x00"
_MECHANISMS = b"\x00\x53\x40\xc0\x08\x01\xa3\x05PLAIN"


def need_proton() -> None:
    """Require Qpid Proton; the distribution has it for its own version of Python only."""
    built = [path.name for path in SYSTEM_PACKAGES.glob("_cproton.cpython-*.so")]
    if ABSENT and built and not any(f"-{sys.version_info[0]}{sys.version_info[1]}-" in name for name in built):
        pytest.skip(f"platform: {ABSENT}")
    if ABSENT:
        lacking(ABSENT)


class Broker(MessagingHandler):  # type: ignore[misc]
    """Takes messages, and gives them to those who receive from the same address."""

    def __init__(self, certificate: Certificate | None = None, clients: Path | None = None) -> None:
        """Prepare a broker; `clients` is the authority whose certificates it asks for."""
        super().__init__(auto_accept=False)
        self.port, self._certificate, self._clients = free_port(), certificate, clients
        self.arrived: list[tuple[str, Any]] = []
        """All messages that were accepted, with their addresses, also before a restart."""
        self.silent = threading.Event()
        """Set: nothing is accepted any more."""
        self.released = False
        """Whether messages are given back, as if no process received them."""
        self.longest = 0
        self.refused = ""
        """At a sender to this address the broker ends the connection; it gives again what was not accepted."""
        self.given: list[Any] = []
        """All messages that went to receivers, also repeatedly."""
        self._changed, self._thread = threading.Condition(), threading.Thread()

    def start(self) -> None:
        self._queues: dict[str, deque[Any]] = {}
        self._receivers: dict[str, list[Any]] = {}
        self._open: dict[tuple[str, str], tuple[str, Any]] = {}
        """Address and message of what no receiver has accepted yet, by link and tag of the delivery."""
        self._ready = threading.Event()
        self._connections: list[Any] = []
        self._container, self._injector = Container(self), EventInjector()
        self._container.selectable(self._injector)
        self._thread = threading.Thread(target=self._container.run)
        self._thread.start()
        assert self._ready.wait(WAIT_S)

    def stop(self) -> None:
        """End without a farewell, as a broker that is killed."""
        if not self._thread.is_alive():
            return
        self._injector.trigger(ApplicationEvent("killed"))
        self._injector.close()
        self._thread.join(WAIT_S)
        assert not self._thread.is_alive()

    def on_killed(self, _: Any) -> None:
        self._acceptor.close()
        for connection in self._connections:
            if (transport := connection.transport) is not None:
                transport.close_tail()
                transport.close_head()

    def on_connection_opening(self, event: Any) -> None:
        self._connections.append(event.connection)

    def on_start(self, event: Any) -> None:
        domain = None
        if self._certificate is not None:
            domain = SSLDomain(SSLDomain.MODE_SERVER)
            domain.set_credentials(str(self._certificate.certificate), str(self._certificate.private_key), None)
            if self._clients is not None:
                domain.set_trusted_ca_db(str(self._clients))
                domain.set_peer_authentication(SSLDomain.VERIFY_PEER, str(self._clients))
        scheme = "amqp" if domain is None else "amqps"
        self._acceptor = event.container.listen(f"{scheme}://127.0.0.1:{self.port}", domain)
        self._ready.set()

    def on_link_opening(self, event: Any) -> None:
        link = event.link
        if link.is_receiver and self.refused == link.remote_target.address:
            self._receivers.clear()
            for address, message in reversed(self._open.values()):
                self._queues[address].appendleft(message)
            self._open.clear()
            event.transport.close_tail()
            event.transport.close_head()
        elif link.is_sender:
            link.source.address = link.remote_source.address
            self._receivers.setdefault(link.source.address, []).append(link)
        else:
            link.target.address = link.remote_target.address
            if self.longest:
                link.max_message_size = self.longest

    def on_message(self, event: Any) -> None:
        address = event.receiver.target.address
        if self.silent.is_set():
            return
        if self.released:
            self.settle(event.delivery, Delivery.RELEASED)
            return
        self._queues.setdefault(address, deque()).append(event.message)
        self.accept(event.delivery)
        with self._changed:
            self.arrived.append((address, event.message))
            self._changed.notify_all()
        self._serve(address)

    def on_accepted(self, event: Any) -> None:
        self._open.pop((event.link.name, event.delivery.tag), None)

    def on_sendable(self, event: Any) -> None:
        self._serve(event.sender.source.address)

    def _serve(self, address: str) -> None:
        queue = self._queues.get(address, deque())
        for link in self._receivers.get(address, ()):
            while queue and link.credit > 0:
                self.given.append(queue.popleft())
                self._open[link.name, link.send(self.given[-1]).tag] = address, self.given[-1]

    def messages(self, count: int, address: str = "cfx") -> list[Any]:
        """Wait until `count` messages have come to an address; return all of them."""

        def found() -> list[Any]:
            return [message for where, message in self.arrived if where == address]

        with self._changed:
            assert self._changed.wait_for(lambda: len(found()) >= count, WAIT_S), [m.subject for m in found()]
            return found()

    def documents(self, count: int, address: str = "cfx") -> list[dict[str, Any]]:
        """Wait for messages as `messages` does; return their documents."""
        return [json.loads(bytes(message.body)) for message in self.messages(count, address)]


def ask(port: int, address: str, document: dict[str, Any], reply_to: str) -> None:
    """Send a request to an address."""
    from proton.utils import BlockingConnection

    connection = BlockingConnection(f"amqp://127.0.0.1:{port}", timeout=WAIT_S, allowed_mechs="ANONYMOUS")
    body = json.dumps(document).encode()
    connection.create_sender(address).send(Message(body, inferred=True, reply_to=reply_to))
    connection.close()


class Gate(socketserver.ThreadingTCPServer):
    """Asks for the password by SASL PLAIN, then passes everything on to a broker."""

    allow_reuse_address, daemon_threads = True, True

    def __init__(self, to: int) -> None:
        super().__init__(("127.0.0.1", 0), _Login)
        self.to, self.port = to, self.server_address[1]
        self.thread = threading.Thread(target=self.serve_forever, args=(0.05,))
        self.thread.start()

    def close(self) -> None:
        self.shutdown()
        self.thread.join(WAIT_S)
        self.server_close()


class _Login(socketserver.StreamRequestHandler):
    server: Gate

    def handle(self) -> None:
        if self.rfile.read(8) != _HEADER:
            return
        self.wfile.write(_HEADER + _frame(_MECHANISMS))
        size = int.from_bytes(self.rfile.read(4), "big")
        right = f"\0{USER}\0{PASSWORD}".encode() in self.rfile.read(size - 4)
        self.wfile.write(_frame(b"\x00\x53\x44\xc0\x03\x01\x50" + (b"\x00" if right else b"\x01")))
        if not right:
            return
        with socket.create_connection(("127.0.0.1", self.server.to)) as broker:
            back = threading.Thread(target=_copy, args=(broker, self.request))
            back.start()
            _copy(self.request, broker)
            back.join()


def _frame(body: bytes) -> bytes:
    """Return a frame of SASL."""
    return (len(body) + 8).to_bytes(4, "big") + b"\x02\x01\x00\x00" + body


def _copy(source: socket.socket, target: socket.socket) -> None:
    with suppress(OSError):
        while content := source.recv(65536):
            target.sendall(content)
    with suppress(OSError):
        target.shutdown(socket.SHUT_RDWR)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        return port
