"""The network of GigE cameras: packet size, the kernel's receive buffer, and requests without control.

Aravis holds its lock for seconds while a camera is absent, and lists only one of two with the same name, so READREG
(GVCP) is sent without it, and DISCOVERY (`discovery.py`).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import stat
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from vaoi_station.acquisition.cameras.aravis.library import glib_error
from vaoi_station.errors import InputError
from vaoi_station.optics.links import LARGEST_PACKET

CONTROL_PORT = 3956
SMALLEST_PACKET = 576
"""Packet size in bytes that every GigE camera and every network takes."""
_UDP_HEADERS = 28
"""Bytes of the IP and UDP headers, which the packet size of a camera includes."""
_IP_MTU = 14


@dataclass(frozen=True)
class PacketLimits:
    """The smallest and largest packet size that a camera accepts, and the step between sizes, in bytes."""

    smallest: int
    largest: int
    step: int

    @classmethod
    def stated(cls, limits: tuple[float, float, float] | None) -> PacketLimits:
        """Take what a description states; what no camera can mean is replaced by what GigE Vision asks of each."""
        low, high, step = map(int, limits or (0, 0, 0))
        if high < SMALLEST_PACKET or low > high:
            low, high, step = SMALLEST_PACKET, LARGEST_PACKET, 4
        return cls(max(low, _UDP_HEADERS + 1), high, max(1, step))


class Port(NamedTuple):
    """A network interface of this computer with its IPv4 address and network mask."""

    name: str
    address: int
    mask: int

    def reaches(self, address: int) -> bool:
        """Return whether an address is in the network of the interface."""
        return self.address & self.mask == address & self.mask


def packet_bytes(wanted: int | None, mtu: int, limits: PacketLimits) -> int:
    """Return the largest packet size, in bytes with headers, that both the camera and the interface accept."""
    most = min(wanted or LARGEST_PACKET, mtu, limits.largest)
    # A size between two steps would be rounded by the camera, and the comparison after the write would fail.
    fitting = limits.smallest + (most - limits.smallest) // limits.step * limits.step
    if fitting < limits.smallest:
        raise InputError.field(
            "station.toml", "packet_bytes", most, f"at least {limits.smallest}, as the camera has it"
        )
    return fitting


_STREAM_PORT, _PACKET_SIZE, _PACKET_DELAY, _STREAM_ADDRESS = 0x0D00, 0x0D04, 0x0D08, 0x0D18
"""Registers of the first stream channel: port, packet size, pause and address to which it sends (GigE Vision)."""
_CLOCK_CONTROL, _LATCH, _CLOCK_HIGH, _CLOCK_LOW = 0x0944, 2, 0x0948, 0x094C
"""Register that latches the time, the value that does it, and the registers that then have it."""
_FIRE, _DO_NOT_FRAGMENT, _FLAGS = 1 << 31, 1 << 30, 0xFFFF0000
"""Bits of the register of the packet size."""
TEST_S, TEST_TRIES, TEST_STEP = 0.05, 3, 64
"""Wait for a test packet, s, and how often one is sent; sizes are tried until two of them are as close as this."""


def largest_passing(device: Any, most: int, limits: PacketLimits, local_address: str) -> int | None:
    """Return the largest packet size up to `most` that comes here from a camera in one piece; None if none comes.

    The camera sends test packets with *don't fragment*, as GigE Vision has it: a switch that is too narrow for them
    drops them. The camera must be controlled and not acquiring. Its stream channel is closed afterwards.
    """
    # Aravis' automatic packet size is not used: it may exceed the MTU (Aravis #1065), and its search begins at the
    # present size and ends at the smallest one with cameras that fire one test packet only (#425).
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind((local_address, 0))
            flags = device.read_register(_PACKET_SIZE) & _FLAGS & ~_FIRE
            device.write_register(_STREAM_ADDRESS, _as_int(socket.inet_aton(local_address)))
            device.write_register(_STREAM_PORT, receiver.getsockname()[1])
            found = _largest(lambda size: _passes(device, receiver, size), most, limits)
            device.write_register(_STREAM_PORT, 0)
            device.write_register(_PACKET_SIZE, flags | most)
        except (glib_error(), OSError):
            return None  # the camera does not let its registers be written: it has no test packet for us
    return found


def set_packet_size(device: Any, size: int) -> int:
    """Write the packet size into its register, which is the same in all GigE cameras; return what it then reads."""
    device.write_register(_PACKET_SIZE, device.read_register(_PACKET_SIZE) & _FLAGS & ~_FIRE | size)
    return int(device.read_register(_PACKET_SIZE)) & ~_FLAGS


def latched_ticks(device: Any) -> int:
    """Return the time of a camera in its ticks, by registers that GigE Vision has for it; some do not describe them."""
    device.write_register(_CLOCK_CONTROL, _LATCH)
    return int(device.read_register(_CLOCK_HIGH)) << 32 | int(device.read_register(_CLOCK_LOW))


def set_pause(device: Any, ticks: int) -> bool:
    """Write the pause after each packet into its register, for cameras that do not describe it; whether it is kept."""
    try:
        device.write_register(_PACKET_DELAY, ticks)
        return ticks > 0 and int(device.read_register(_PACKET_DELAY)) == ticks
    except glib_error():
        return False  # the register is not one that every camera has


def _largest(passes: Callable[[int], bool], most: int, limits: PacketLimits) -> int | None:
    if passes(most):
        return most
    low, high = limits.smallest, most
    if low >= most or not passes(low):
        return None
    while high - low >= 2 * max(limits.step, TEST_STEP // 2):
        middle = low + (high - low) // 2 // limits.step * limits.step
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def _passes(device: Any, receiver: socket.socket, size: int) -> bool:
    """Whether a test packet of a size arrives."""
    for _ in range(TEST_TRIES):
        # Written without the bit first: a camera that keeps it fires only when it changes (Aravis #425).
        device.write_register(_PACKET_SIZE, _DO_NOT_FRAGMENT | size)
        device.write_register(_PACKET_SIZE, _FIRE | _DO_NOT_FRAGMENT | size)
        until_s = time.monotonic() + TEST_S
        while (left_s := until_s - time.monotonic()) > 0:
            receiver.settimeout(left_s)
            with contextlib.suppress(TimeoutError):
                # A late packet of another size does not count.
                if len(receiver.recv(0x10000)) == size - _UDP_HEADERS:
                    return True
    return False


def mtu_to(address: str) -> int:
    """Return the MTU (size of the largest packet, in bytes) on the network route from this computer to an address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, CONTROL_PORT))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)


def interface_of(local_address: str) -> str:
    """Return the name of the interface that has an address, else of one whose network contains it, else the address."""
    wanted, every = _as_int(socket.inet_aton(local_address)), ports()
    # Two interfaces may be in the same network, so the address itself decides.
    own = (port.name for port in every if port.address == wanted)
    return next(own, next((port.name for port in every if port.reaches(wanted)), local_address))


def interface_towards(address: str) -> str:
    """Return the name of the interface by which packets to an address leave; an empty text if there is none."""
    if not address:  # the C library would take it for this computer
        return ""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect((address, CONTROL_PORT))
        return interface_of(probe.getsockname()[0])
    return ""


def route_trouble(address: str) -> str:
    """Return what is wrong with the route from here to an IP address; empty if it is sound, or for a USB id."""
    try:
        wanted = _as_int(socket.inet_aton(address))
    except OSError:
        return ""
    names = sorted({port.name for port in ports() if port.reaches(wanted)})
    if not names:
        return f"no network port of this computer has an address in the network of {address}"
    if len(names) > 1:
        return (
            f"the ports {', '.join(names)} of this computer are in the network of {address}, so that its packets may "
            "take the wrong one; give each port a network of its own"
        )
    return ""


def link_mbit_s(interface: str) -> float | None:
    """Return the speed of a network interface in Mbit/s; None if it reports no speed, like loopback."""
    try:
        speed = int(Path(f"/sys/class/net/{interface}/speed").read_text())
    except (OSError, ValueError):
        return None
    return float(speed) if speed > 0 else None


def has_link(interface: str) -> bool:
    """Return whether something is connected to a network interface and switched on."""
    try:
        return Path(f"/sys/class/net/{interface}/carrier").read_text().strip() == "1"
    except OSError:  # an interface that is down
        return False


def widen_receive_buffer(port: int, wanted_bytes: int) -> int:
    """Set the receive buffer of the UDP socket that this process has at a port; return the granted size, in bytes.

    The kernel grants at most net.core.rmem_max. The value is 0 if this process has no UDP socket at the port.
    """
    # Aravis itself sets the size when the first packet has arrived, which loses the rest of the first frame
    # (decisions/0009), and does not report the granted size. Aravis gives no access to its socket, so the socket is
    # searched by its port among the open files of this process.
    for handle in map(int, os.listdir("/proc/self/fd")):  # noqa: PTH208  (numbers, not paths)
        with contextlib.suppress(OSError):  # another thread closed it meanwhile
            if not stat.S_ISSOCK(os.fstat(handle).st_mode):
                continue
            ours = socket.socket(fileno=os.dup(handle))
            with ours:
                if (ours.family, ours.type) == (socket.AF_INET, socket.SOCK_DGRAM) and ours.getsockname()[1] == port:
                    ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
                    # Linux reports twice the usable size, because it counts its own overhead (man 7 socket).
                    return ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return 0


class _SocketAddress(ctypes.Structure):
    """`struct sockaddr_in` of the C library."""

    _fields_ = (("family", ctypes.c_uint16), ("port", ctypes.c_uint16), ("address", ctypes.c_ubyte * 4))


class _InterfaceAddress(ctypes.Structure):
    """The first members of `struct ifaddrs` of the C library."""


_InterfaceAddress._fields_ = (
    ("next", ctypes.POINTER(_InterfaceAddress)),
    ("name", ctypes.c_char_p),
    ("flags", ctypes.c_uint),
    ("address", ctypes.POINTER(_SocketAddress)),
    ("mask", ctypes.POINTER(_SocketAddress)),
)


def ports() -> tuple[Port, ...]:
    """Return all IPv4 addresses of the interfaces of this computer; an interface may have several."""
    library = ctypes.CDLL(None, use_errno=True)
    first = ctypes.POINTER(_InterfaceAddress)()
    if library.getifaddrs(ctypes.byref(first)):
        raise OSError(ctypes.get_errno(), "the network interfaces cannot be listed")
    found, entry = [], first
    try:
        while entry:
            item = entry.contents
            if item.address and item.mask and item.address.contents.family == socket.AF_INET:
                address, mask = (_as_int(bytes(field.contents.address)) for field in (item.address, item.mask))
                # An address may have a label: eth0:1.
                found.append(Port(item.name.decode().partition(":")[0], address, mask))
            entry = item.next
    finally:
        library.freeifaddrs(first)
    return tuple(found)


def _as_int(address: bytes) -> int:
    return int.from_bytes(address, "big")


_KEY, _ACKNOWLEDGE = 0x42, 0x01
_READ_REGISTER, _READ_MEMORY = 0x0080, 0x0084
"""Command numbers; the number of an acknowledgement is one higher."""
_MODEL_NAME, _MODEL_BYTES = 0x0068, 32
_VERSION_REGISTER, _PRIVILEGE_REGISTER, _APPLICATION_REGISTER = 0x0000, 0x0A00, 0x0A14
_CAPABILITY_REGISTER, _LINK_SPEED_REGISTER = 0x0934, 0x0670
_STATES_LINK_SPEED = 1 << 28
"""Bit of the capabilities: the register of the link's speed exists."""
_CONTROL_BITS = 0b11
"""Bits of the privilege register that are set while an application has exclusive access or control."""
_HEADER = struct.Struct(">BBHHH")
_SUCCESS = b"\0\0"
"""Status of success in the first two bytes of a reply. A refusal has another status and may have content as well."""
_ids = count(1)


class Control(Enum):
    """Whether an application controls a camera, as the camera itself reports it (control channel privilege)."""

    ABSENT = "absent"
    FREE = "free"
    CONTROLLED = "controlled"


def command(number: int, request_id: int, content: bytes = b"", flags: int = 0) -> bytes:
    """Return the bytes of a command that the camera must acknowledge; `flags` are those of this command."""
    return _HEADER.pack(_KEY, _ACKNOWLEDGE | flags, number, len(content), request_id) + content


def is_reply(datagram: bytes, number: int, request_id: int) -> bool:
    """Return whether received bytes acknowledge a command."""
    if len(datagram) < _HEADER.size:
        return False
    _, _, acknowledged, _, acknowledged_id = _HEADER.unpack_from(datagram)
    return bool(acknowledged == number + 1 and acknowledged_id == request_id)


def is_ip(address: str) -> bool:
    """Return whether this is an IP address, and not the id of a USB camera."""
    try:
        socket.inet_aton(address)
    except OSError:
        return False
    return True


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


def camera_link_mbit_s(address: str) -> float | None:
    """Read the speed of a camera's own link, Mbit/s; None if the camera does not state it in its register."""
    capabilities = _number(address, _CAPABILITY_REGISTER)
    return float(_number(address, _LINK_SPEED_REGISTER)) or None if capabilities & _STATES_LINK_SPEED else None


def _number(address: str, register: int) -> int:
    """Return the number in a register; 0 if it cannot be read."""
    return int.from_bytes((_read_register(address, register, 0.2, 3) or b"")[:4], "big")


def controlled_by(address: str) -> str:
    """Return ` on HOST` for the computer whose application controls a camera, as the camera states; else nothing."""
    number = _number(address, _APPLICATION_REGISTER)  # optional in GigE Vision 2
    return f" on {socket.inet_ntoa(number.to_bytes(4, 'big'))}" if number else ""


def model_name(address: str) -> str:
    """Read the model of the camera at an IP address, as its reply to a search states it; empty without a reply.

    DeviceModelName of a description may be another text (AVT_Manta_G507B has it in a register of its own).
    """
    reply = _ask(address, _READ_MEMORY, struct.pack(">II", _MODEL_NAME, _MODEL_BYTES), 0.2, 3)
    return (reply or b"")[4:].split(b"\0")[0].decode("ascii", "replace").strip()


def _read_register(address: str, register: int, timeout_s: float, tries: int) -> bytes | None:
    """Return the content of a register; empty bytes if the camera refuses to read it, None if no camera replies."""
    return _ask(address, _READ_REGISTER, register.to_bytes(4, "big"), timeout_s, tries)


def _ask(address: str, number: int, content: bytes, timeout_s: float, tries: int) -> bytes | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout_s)
        try:
            client.connect((address, CONTROL_PORT))
        except OSError:
            return None
        replies = (request(client, number, content) for _ in range(tries))
        return next((reply for reply in replies if reply is not None), None)


def request(client: socket.socket, number: int, content: bytes) -> bytes | None:
    """Send a command; return the content of the reply, b"" after a refusal, None without a reply."""
    request_id = next_id()
    try:
        client.send(command(number, request_id, content))
        while not is_reply(reply := client.recv(1024), number, request_id):
            pass  # a late reply to an earlier request
    except OSError:  # no reply in time, or the port is closed there
        return None
    return reply[_HEADER.size :] if reply.startswith(_SUCCESS) else b""


def next_id() -> int:
    """Return the id of the next request."""
    # 0 is not a valid request id.
    return next(_ids) % 0xFFFF + 1
