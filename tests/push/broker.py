"""A real MQTT broker (mosquitto) on loopback, and a subscriber."""

from __future__ import annotations

import queue
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tests.needs import need, program
from tests.peers.certificates import make_authority, make_certificate

WAIT_S = 30.0
USER, PASSWORD = "station", "not-a-secret"


class Published(NamedTuple):
    """A message that a subscriber got."""

    topic: str
    body: bytes
    retained: bool


class Broker:
    """Mosquitto with two listeners: one that is open, and one with TLS and a password."""

    def __init__(self, folder: Path) -> None:
        need("mosquitto")
        self._folder = folder
        self._program: Any = None
        authority = make_authority(folder)
        made = make_certificate(folder, authority=authority)
        self.ca = authority.certificate
        passwords = folder / "passwords"
        tool = program("mosquitto_passwd")
        assert tool is not None
        subprocess.run([tool, "-b", "-c", str(passwords), USER, PASSWORD], check=True, capture_output=True)
        self.port, self.tls_port = _free_port(), _free_port()
        lines = [
            "per_listener_settings true",
            f"listener {self.port} 127.0.0.1",
            "allow_anonymous true",
            f"listener {self.tls_port} 127.0.0.1",
            f"password_file {passwords}",
            f"certfile {made.certificate}",
            f"keyfile {made.private_key}",
        ]
        # Started as root, mosquitto would change to a user that cannot read the folder of a test.
        lines.insert(0, "user root")
        (folder / "mosquitto.conf").write_text("\n".join(lines) + "\n")

    def start(self) -> None:
        server = program("mosquitto")
        assert server is not None
        command = [server, "-c", str(self._folder / "mosquitto.conf")]
        self._program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + WAIT_S
        while not (_takes_connections(self.port) and _takes_connections(self.tls_port)):
            assert self._program.poll() is None, "mosquitto has ended"
            assert time.monotonic() < deadline, "mosquitto takes no connections"
            threading.Event().wait(0.01)

    def stop(self) -> None:
        if self._program is not None:
            self._program.terminate()
            self._program.wait(WAIT_S)
            self._program = None


class Subscriber:
    """A client that subscribes to everything."""

    def __init__(self, port: int) -> None:
        self.got: queue.Queue[Published] = queue.Queue()
        ready = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = lambda _c, _d, m: self.got.put(Published(m.topic, bytes(m.payload), bool(m.retain)))
        self._client.on_subscribe = lambda *_: ready.set()
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert ready.wait(WAIT_S)

    def next(self) -> Published:
        return self.got.get(timeout=WAIT_S)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def _takes_connections(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), WAIT_S):
            return True
    except ConnectionRefusedError:
        return False


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        return port
