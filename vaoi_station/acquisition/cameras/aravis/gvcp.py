"""Send the GVCP requests (GigE Vision control protocol) that are permitted without control of the camera.

Aravis tries an absent camera five times for 0.5 s and holds its lock during this time, and it lists only one of two
cameras with the same name. So this module sends three requests without Aravis: READREG of the protocol version
(bootstrap register 0), READREG of the control channel privilege, and the broadcast DISCOVERY.
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
"""Time to wait for replies to DISCOVERY; the standard allows cameras this long."""
_KEY, _ACKNOWLEDGE = 0x42, 0x01
_DISCOVERY, _READ_REGISTER = 0x0002, 0x0080
"""Command numbers; the number of an acknowledgement is one higher."""
_VERSION_REGISTER, _PRIVILEGE_REGISTER = 0x0000, 0x0A00
_CONTROL_BITS = 0b11
"""Bits of the privilege register that are set while an application has exclusive access or control."""
_HEADER = struct.Struct(">BBHHH")
_SUCCESS = b"\0\0"
"""Status of success in the first two bytes of a reply. A refusal has another status and may have content as well."""
_ADDRESS_OFFSET, _SERIAL_OFFSET = 8 + 0x24, 8 + 0xD8
"""Offsets in a reply to DISCOVERY, which has a header of 8 bytes and then the bootstrap registers from 0 on."""
_DISCOVERY_REPLY_BYTES = 8 + 0xF8
_ids = count(1)


class Control(Enum):
    """Whether an application controls a camera, as the camera itself reports it (control channel privilege)."""

    ABSENT = "absent"
    """The camera does not reply."""
    FREE = "free"
    """No application controls the camera. A camera releases an application that sends no heartbeat."""
    CONTROLLED = "controlled"
    """An application controls the camera; the camera does not report which one."""


@dataclass(frozen=True)
class DiscoveredCamera:
    """A GigE camera that replied to DISCOVERY."""

    address: str
    serial: str


def command(number: int, request_id: int, content: bytes = b"") -> bytes:
    """Return the bytes of a command that the camera must acknowledge."""
    return _HEADER.pack(_KEY, _ACKNOWLEDGE, number, len(content), request_id) + content


def is_reply(datagram: bytes, number: int, request_id: int) -> bool:
    """Return whether received bytes acknowledge a command.

    A refusal counts as an acknowledgement, because it proves that the camera is present.

    Args:
        datagram: the received bytes.
        number: number of the command.
        request_id: request id of the command.
    """
    if len(datagram) < _HEADER.size:
        return False
    _, _, acknowledged, _, acknowledged_id = _HEADER.unpack_from(datagram)
    return bool(acknowledged == number + 1 and acknowledged_id == request_id)


def is_reachable(address: str, timeout_s: float = 0.2, tries: int = 3) -> bool:
    """Return whether a camera replies at an IP address. At most `tries` requests are sent, `timeout_s` apart."""
    return _read_register(address, _VERSION_REGISTER, timeout_s, tries) is not None


def read_control(address: str, timeout_s: float = 0.2, tries: int = 3) -> Control:
    """Read whether an application controls the camera at an IP address."""
    reply = _read_register(address, _PRIVILEGE_REGISTER, timeout_s, tries)
    if reply is None:
        return Control.ABSENT
    # A camera may refuse to let other applications read this register. The refusal counts as CONTROLLED, so that no
    # loss is reported that did not occur.
    free = len(reply) >= 4 and not int.from_bytes(reply[:4], "big") & _CONTROL_BITS
    return Control.FREE if free else Control.CONTROLLED


def discover(wait_s: float = DISCOVERY_S) -> tuple[DiscoveredCamera, ...]:
    """Return all GigE cameras that reply to a broadcast on the networks of this computer, sorted by address."""
    request_id = _next_id()
    with contextlib.ExitStack() as stack:
        selector = stack.enter_context(selectors.DefaultSelector())
        # One socket per interface: a broadcast leaves by the interface whose address the socket is bound to.
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


def discovered(datagram: bytes, request_id: int) -> DiscoveredCamera | None:
    """Return address and serial number from a reply to DISCOVERY; None for every other datagram."""
    if not is_reply(datagram, _DISCOVERY, request_id) or len(datagram) < _DISCOVERY_REPLY_BYTES:
        return None
    serial = datagram[_SERIAL_OFFSET : _SERIAL_OFFSET + 16].split(b"\0")[0].decode("ascii", "replace")
    return DiscoveredCamera(socket.inet_ntoa(datagram[_ADDRESS_OFFSET : _ADDRESS_OFFSET + 4]), serial)


def _received(client: socket.socket, request_id: int) -> list[DiscoveredCamera]:
    received = []
    with contextlib.suppress(BlockingIOError):  # nothing more at present
        while True:
            if (camera := discovered(client.recv(1024), request_id)) is not None:
                received.append(camera)
    return received


def _read_register(address: str, register: int, timeout_s: float, tries: int) -> bytes | None:
    """Return the content of a register; empty bytes if the camera refuses to read it, None if no camera replies."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout_s)
        try:
            client.connect((address, CONTROL_PORT))
        except OSError:
            return None
        return next((reply for _ in range(tries) if (reply := _request_register(client, register)) is not None), None)


def _request_register(client: socket.socket, register: int) -> bytes | None:
    """Send one READREG request and return the content of the register; b"" after a refusal, None without a reply."""
    request_id = _next_id()
    try:
        client.send(command(_READ_REGISTER, request_id, register.to_bytes(4, "big")))
        while not is_reply(reply := client.recv(1024), _READ_REGISTER, request_id):
            pass  # a late reply to an earlier request
    except OSError:  # no reply in time, or the port is closed there
        return None
    return reply[_HEADER.size :] if reply.startswith(_SUCCESS) else b""


def _next_id() -> int:
    # 0 is not a valid request id.
    return next(_ids) % 0xFFFF + 1
