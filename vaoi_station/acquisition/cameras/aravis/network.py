"""Packets on the way: how large they may be, how far apart, and how many the kernel holds while nobody looks.

All cameras of an array expose at the same moment and send at once. Cameras that share a port of this computer share its
bandwidth: each leaves room after every packet for one packet of every other, so that no switch has to hold or drop
any. The arithmetic is pure; what it needs to know of the machine is asked for at the end of this module.
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
"""Jumbo frames; loopback would take more, but no wire does."""
GVSP_OVERHEAD = 36
"""Bytes of IP (20), UDP (8) and GVSP (8) headers in every packet of the size a camera is told."""
ETHERNET_OVERHEAD = 38
"""Bytes a packet costs on the wire beyond that: preamble 8, header 14, check sum 4, gap 12."""
CONTROL_PORT = 3956
"""Of GVCP, the same for every camera."""
_IP_MTU = 14
_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B


@dataclass(frozen=True)
class PacketLimits:
    """What a camera permits of its packets' size, in bytes."""

    smallest: int
    largest: int
    step: int


def packet_bytes(wanted: int | None, mtu: int, limits: PacketLimits) -> int:
    """The largest packet that camera and interface take, headers of IP and UDP included; at most what is wanted."""
    most = min(wanted or LARGEST_PACKET, mtu, limits.largest)
    fitting = limits.smallest + (most - limits.smallest) // limits.step * limits.step
    if fitting < limits.smallest:
        raise InputError.field(
            "station.toml", "packet_bytes", most, f"at least {limits.smallest}, as the camera has it"
        )
    return fitting


def packets_per_frame(payload_bytes: int, packet: int) -> int:
    """Packets with pixels; leader and trailer are small."""
    return math.ceil(payload_bytes / (packet - GVSP_OVERHEAD))


def packet_delay_ns(packet: int, cameras: int, link_mbit_s: float | None) -> int:
    """The gap after each packet that leaves room for one of every other camera of the port; 0 where no wire limits."""
    if link_mbit_s is None:
        return 0
    return math.ceil((cameras - 1) * (packet + ETHERNET_OVERHEAD) * 8000 / link_mbit_s)


def transfer_s(payload_bytes: int, packet: int, cameras: int, link_mbit_s: float | None) -> float:
    """How long a frame is on the way when all cameras of a port send at once; 0 where no wire limits."""
    if link_mbit_s is None:
        return 0.0
    return packets_per_frame(payload_bytes, packet) * cameras * (packet + ETHERNET_OVERHEAD) * 8e-6 / link_mbit_s


def check_budget(port: str, payloads: list[int], packet: int, link_mbit_s: float | None, period_s: float) -> None:
    """DeviceError if the cameras of a port cannot have sent a row before the next one is due."""
    needed_s = transfer_s(max(payloads), packet, len(payloads), link_mbit_s)
    if needed_s > period_s:
        raise DeviceError(
            f"{len(payloads)} cameras on port {port} need {needed_s * 1e3:.1f} ms for a row at "
            f"{link_mbit_s:.0f} Mbit/s, but a row comes every {period_s * 1e3:.1f} ms.",
            action="Give some of them a port of their own, use a faster link or a shorter pixel format.",
            code="link-too-slow",
        )


def mtu_to(address: str) -> int:
    """The largest packet that goes to an address in one piece, by this computer's own word."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, CONTROL_PORT))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)


def local_addresses() -> tuple[str, ...]:
    """IPv4 addresses of this computer's interfaces, one each."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # it has none
                found.append(socket.inet_ntoa(_interface_query(probe, _SIOCGIFADDR, name)))
    return tuple(found)


def interface_of(local_address: str) -> str:
    """Name of the interface with an address (or, for loopback, its network); the address itself if there is none."""
    wanted = _as_int(socket.inet_aton(local_address))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # it has no address
                own = _as_int(_interface_query(probe, _SIOCGIFADDR, name))
                mask = _as_int(_interface_query(probe, _SIOCGIFNETMASK, name))
                if wanted & mask == own & mask:
                    return name
    return local_address


def link_mbit_s(interface: str) -> float | None:
    """Speed of a port; None if it has none, like loopback, or does not tell."""
    try:
        speed = int(Path(f"/sys/class/net/{interface}/speed").read_text())
    except (OSError, ValueError):
        return None
    return float(speed) if speed > 0 else None


def widen_receive_buffer(port: int, wanted_bytes: int) -> int:
    """Give this process' UDP socket at a port so much room for packets that wait; what the kernel granted, in bytes.

    Aravis would ask when the first packet is there, which is too late for the frame behind it, and would not say that
    the kernel grants no more than net.core.rmem_max. 0 if this process has no such socket.
    """
    for handle in map(int, os.listdir("/proc/self/fd")):  # noqa: PTH208  (numbers, not paths)
        with contextlib.suppress(OSError):  # it was closed meanwhile
            if not stat.S_ISSOCK(os.fstat(handle).st_mode):
                continue
            ours = socket.socket(fileno=os.dup(handle))
            with ours:
                if (ours.family, ours.type) == (socket.AF_INET, socket.SOCK_DGRAM) and ours.getsockname()[1] == port:
                    ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
                    return ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # the kernel counts it twice
    return 0


def _interface_query(probe: socket.socket, request: int, interface: str) -> bytes:
    answer: bytes = fcntl.ioctl(probe, request, struct.pack("256s", interface.encode()[:15]))
    return answer[20:24]


def _as_int(address: bytes) -> int:
    return int.from_bytes(address, "big")
