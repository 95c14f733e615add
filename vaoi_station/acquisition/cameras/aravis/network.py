"""Packets of cameras: their size, the delay between them, and the kernel's receive buffer.

All cameras of an array expose and send at the same time. Cameras on one port of this computer share its bandwidth:
after every packet, each leaves room for one packet of every other camera, so that no switch must buffer or drop any.
The arithmetic is pure; the queries of this machine are at the end of the module.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import socket
import stat
import struct
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.errors import DeviceError, InputError

LARGEST_PACKET = 9000
"""Bytes of a jumbo frame; loopback takes more, Ethernet does not."""
GVSP_OVERHEAD = 36
"""Bytes of IP (20), UDP (8) and GVSP (8) headers, which the packet size of a camera includes."""
ETHERNET_OVERHEAD = 38
"""Further bytes of a packet on the wire: preamble 8, header 14, checksum 4, gap 12."""
CONTROL_PORT = 3956
"""UDP port of GVCP, the same for every camera."""
_IP_MTU = 14
_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B


@dataclass(frozen=True)
class PacketLimits:
    """A camera's limits of the packet size, in bytes."""

    smallest: int
    largest: int
    step: int


def packet_bytes(wanted: int | None, mtu: int, limits: PacketLimits) -> int:
    """Return the largest packet size that camera and interface accept, including headers; at most `wanted`."""
    most = min(wanted or LARGEST_PACKET, mtu, limits.largest)
    # A size between two steps would be rounded by the camera, and the comparison after the write would fail.
    fitting = limits.smallest + (most - limits.smallest) // limits.step * limits.step
    if fitting < limits.smallest:
        raise InputError.field(
            "station.toml", "packet_bytes", most, f"at least {limits.smallest}, as the camera has it"
        )
    return fitting


def packets_per_frame(payload_bytes: int, packet: int) -> int:
    """Return the number of packets with pixels; leader and trailer are negligible."""
    return math.ceil(payload_bytes / (packet - GVSP_OVERHEAD))


def packet_delay_ns(packet: int, cameras: int, link_mbit_s: float | None) -> int:
    """Return the delay after each packet for one packet of every other camera; 0 if the link has no speed."""
    if link_mbit_s is None:
        return 0
    return math.ceil((cameras - 1) * (packet + ETHERNET_OVERHEAD) * 8000 / link_mbit_s)


def transfer_s(payload_bytes: int, packet: int, cameras: int, link_mbit_s: float | None) -> float:
    """Return the time of a frame when all cameras of a port send at once; 0 if the link has no speed."""
    if link_mbit_s is None:
        return 0.0
    return packets_per_frame(payload_bytes, packet) * cameras * (packet + ETHERNET_OVERHEAD) * 8e-6 / link_mbit_s


def check_budget(port: str, payloads: list[int], packet: int, link_mbit_s: float | None, period_s: float) -> None:
    """Raise DeviceError if the cameras of a port cannot send a row before the next one is due."""
    needed_s = transfer_s(max(payloads), packet, len(payloads), link_mbit_s)
    if needed_s > period_s:
        raise DeviceError(
            f"{len(payloads)} cameras on port {port} need {needed_s * 1e3:.1f} ms for a row at "
            f"{link_mbit_s:.0f} Mbit/s, but a row comes every {period_s * 1e3:.1f} ms.",
            action="Give some of them a port of their own, use a faster link or a shorter pixel format.",
            code="link-too-slow",
        )


def mtu_to(address: str) -> int:
    """Return the MTU of the route to an address, as this computer knows it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, CONTROL_PORT))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)


def local_addresses() -> tuple[str, ...]:
    """Return the IPv4 addresses of this computer's interfaces, one each."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # an interface without an address
                found.append(socket.inet_ntoa(_interface_query(probe, _SIOCGIFADDR, name)))
    return tuple(found)


def interface_of(local_address: str) -> str:
    """Return the name of the interface whose network contains an address; the address itself if there is none."""
    wanted = _as_int(socket.inet_aton(local_address))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # an interface without an address
                own = _as_int(_interface_query(probe, _SIOCGIFADDR, name))
                mask = _as_int(_interface_query(probe, _SIOCGIFNETMASK, name))
                if wanted & mask == own & mask:
                    return name
    return local_address


def link_mbit_s(interface: str) -> float | None:
    """Return the speed of an interface; None if it reports none, like loopback."""
    try:
        speed = int(Path(f"/sys/class/net/{interface}/speed").read_text())
    except (OSError, ValueError):
        return None
    return float(speed) if speed > 0 else None


def widen_receive_buffer(port: int, wanted_bytes: int) -> int:
    """Set the receive buffer of this process' UDP socket at a port; return the size granted, in bytes.

    The kernel grants at most net.core.rmem_max. Returns 0 if this process has no such socket.
    """
    # Aravis sets the size when the first packet has arrived, which loses the rest of the first frame (decisions/0009),
    # and does not report what was granted. It gives no access to its socket either, so the socket is searched by its
    # port.
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


def _interface_query(probe: socket.socket, request: int, interface: str) -> bytes:
    answer: bytes = fcntl.ioctl(probe, request, struct.pack("256s", interface.encode()[:15]))
    return answer[20:24]


def _as_int(address: bytes) -> int:
    return int.from_bytes(address, "big")
