"""Questions of GigE Vision's control protocol that anybody may ask: are you there, are you controlled, who is there?

Aravis asks a camera five times half a second before it gives it up, and holds the camera's lock meanwhile; and of two
cameras that call themselves the same it lists one. So we ask by datagrams of our own: READREG of the protocol's version
(bootstrap register 0) and of the control channel's privilege needs no control of the camera, DISCOVERY goes to
everybody.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import time
from dataclasses import dataclass
from enum import Enum
from itertools import count
from typing import cast

from vaoi_station.acquisition.cameras.aravis.network import CONTROL_PORT, local_addresses

DISCOVERY_S = 1.0
"""Cameras have so long to answer, by the standard."""
_KEY, _ACKNOWLEDGE = 0x42, 0x01
_DISCOVERY, _READ_REGISTER = 0x0002, 0x0080
"""An answer's number is one more."""
_VERSION_REGISTER, _PRIVILEGE_REGISTER = 0x0000, 0x0A00
_CONTROL_BITS = 0b11
"""Bits of the privilege: exclusive access, control."""
_HEADER = struct.Struct(">BBHHH")
_SUCCESS = b"\0\0"
"""Status, in the first two bytes of an answer; refusals may have content all the same."""
_ADDRESS_AT, _SERIAL_AT = 8 + 0x24, 8 + 0xD8
"""In an answer to DISCOVERY, which holds the bootstrap registers from 0 on."""
_DISCOVERY_REPLY_BYTES = 8 + 0xF8
_ids = count(1)


class Control(Enum):
    """What a camera says of who controls it."""

    ABSENT = "absent"
    """It does not answer."""
    FREE = "free"
    """It has heard nothing of its client for too long, and has let go of it."""
    CONTROLLED = "controlled"
    """It does not say who."""


@dataclass(frozen=True)
class DiscoveredCamera:
    """A GigE camera that answered."""

    address: str
    serial: str


def command(number: int, request_id: int, content: bytes = b"") -> bytes:
    """A datagram that wants an answer."""
    return _HEADER.pack(_KEY, _ACKNOWLEDGE, number, len(content), request_id) + content


def is_reply(datagram: bytes, number: int, request_id: int) -> bool:
    """Whether it acknowledges that command, be it by a refusal: who refuses is there."""
    if len(datagram) < _HEADER.size:
        return False
    _, _, answered, _, to = _HEADER.unpack_from(datagram)
    return bool(answered == number + 1 and to == request_id)


def is_reachable(address: str, timeout_s: float = 0.2, tries: int = 3) -> bool:
    """Whether there is a camera at an address; asks at most `tries` times, `timeout_s` each."""
    return _read_register(address, _VERSION_REGISTER, timeout_s, tries) is not None


def read_control(address: str, timeout_s: float = 0.2, tries: int = 3) -> Control:
    """Whether anybody controls the camera at an address, as it says; one that does not tell strangers is controlled."""
    answer = _read_register(address, _PRIVILEGE_REGISTER, timeout_s, tries)
    if answer is None:
        return Control.ABSENT
    free = len(answer) >= 4 and not int.from_bytes(answer[:4], "big") & _CONTROL_BITS
    return Control.FREE if free else Control.CONTROLLED


def discover(wait_s: float = DISCOVERY_S) -> tuple[DiscoveredCamera, ...]:
    """All GigE cameras on the networks of this computer, by address."""
    request_id = _next_id()
    with contextlib.ExitStack() as stack:
        selector = stack.enter_context(selectors.DefaultSelector())
        for local in local_addresses():
            client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            client.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            client.setblocking(False)
            with contextlib.suppress(OSError):  # an interface that is down
                client.bind((local, 0))
                client.sendto(command(_DISCOVERY, request_id), ("255.255.255.255", CONTROL_PORT))
                selector.register(client, selectors.EVENT_READ)
        found: set[DiscoveredCamera] = set()
        deadline_s = time.monotonic() + wait_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            for key, _ in selector.select(left_s):
                found.update(_received(cast("socket.socket", key.fileobj), request_id))
    return tuple(sorted(found, key=lambda camera: socket.inet_aton(camera.address)))


def parse_discovery(datagram: bytes) -> DiscoveredCamera:
    """What an answer to DISCOVERY says of its sender; its own address, as the datagram may come from another."""
    serial = datagram[_SERIAL_AT : _SERIAL_AT + 16].split(b"\0")[0].decode("ascii", "replace")
    return DiscoveredCamera(socket.inet_ntoa(datagram[_ADDRESS_AT : _ADDRESS_AT + 4]), serial)


def _received(client: socket.socket, request_id: int) -> list[DiscoveredCamera]:
    received = []
    with contextlib.suppress(BlockingIOError):  # that was all, for now
        while True:
            datagram = client.recv(1024)
            if is_reply(datagram, _DISCOVERY, request_id) and len(datagram) >= _DISCOVERY_REPLY_BYTES:
                received.append(parse_discovery(datagram))
    return received


def _read_register(address: str, register: int, timeout_s: float, tries: int) -> bytes | None:
    """What a camera answers; empty where it refuses, None where there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout_s)
        try:
            client.connect((address, CONTROL_PORT))
        except OSError:
            return None
        return next((answer for _ in range(tries) if (answer := _request_register(client, register)) is not None), None)


def _request_register(client: socket.socket, register: int) -> bytes | None:
    """The same, asked once."""
    request_id = _next_id()
    try:
        client.send(command(_READ_REGISTER, request_id, register.to_bytes(4, "big")))
        while not is_reply(answer := client.recv(1024), _READ_REGISTER, request_id):
            pass  # to an earlier question
    except OSError:  # no answer in time, or nobody listens there
        return None
    return answer[_HEADER.size :] if answer.startswith(_SUCCESS) else b""


def _next_id() -> int:
    return next(_ids) % 0xFFFF + 1
