"""Search for GigE cameras, also those with an address of a foreign network, and the change of their addresses.

USB3 cameras are listed beside them. Datagrams of our own (GVCP), because Aravis 0.8 lists only one of two cameras with
the same name, none that answers by broadcast only, and has no FORCEIP; and because the station's own process loads no
Aravis.
"""

from __future__ import annotations

import contextlib
import ipaddress
import itertools
import selectors
import socket
import struct
import time
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.acquisition.cameras.aravis.network import (
    CONTROL_PORT,
    Control,
    Port,
    command,
    controlled_by,
    is_ip,
    is_reachable,
    is_reply,
    next_id,
    ports,
    read_control,
    request,
)
from vaoi_station.errors import DeviceError, InputError, StateError

DISCOVERY_S = 1.0
"""Time to wait for replies to DISCOVERY; the standard allows cameras this long."""
NEW_ADDRESS_S = 5.0
"""Longest wait until a camera answers at its new address, and until it is free there."""
AGAIN_S = 0.2
"""Pause between two attempts to take control of a camera."""
_SEARCHED = 64
"""Number of addresses of a network that are tried in the search for a free one."""
_DISCOVERY, _FORCE_IP, _WRITE_REGISTER, _READ_REGISTER = 0x0002, 0x0004, 0x0082, 0x0080
_DENIED = (0x8006).to_bytes(2, "big")
"""Status of a reply to a command that only the controlling application may give."""
_ALLOW_BROADCAST = 0x10
"""Flag of DISCOVERY and FORCEIP: a camera whose address is of another network may answer by broadcast."""
_EVERYONE = "255.255.255.255"
_MAC, _ADDRESS, _MAKER, _MODEL, _SERIAL = (8 + register for register in (0x0A, 0x24, 0x48, 0x68, 0xD8))
"""Places in a reply to DISCOVERY, which has a header of 8 bytes and then the bootstrap registers from 0 on."""
_REPLY_BYTES = 8 + 0xF8
_FORCED = struct.Struct(">2x6s12x4s12x4s12x4s")
"""Content of FORCEIP: hardware address, address, mask and gateway."""
_IP_CONFIGURATION, _PRIVILEGE = 0x0014, 0x0A00
_PERSISTENT_ADDRESS, _PERSISTENT_MASK, _PERSISTENT_GATEWAY = 0x064C, 0x065C, 0x066C
_USE_PERSISTENT, _IN_CONTROL = 1, 2


@dataclass(frozen=True)
class FoundCamera:
    """A camera that replied to a search."""

    serial: str
    address: str
    """IP address of a GigE camera, or Aravis' device id of a USB camera; empty if that is not known."""
    mac: str = ""
    """Hardware address, as `00:11:22:33:44:55`."""
    maker: str = ""
    model: str = ""
    interface: str = ""
    """The network port of this computer on which it replied."""
    local: str = ""
    """Address and length of the mask of this port, as `192.168.7.1/24`; empty for a USB camera."""
    is_claimed: bool = False
    """Whether a program uses this USB camera."""

    @property
    def in_network(self) -> bool:
        """Whether its address is in the network of the port, so that more than a broadcast reaches it."""
        return not self.local or ipaddress.ip_address(self.address) in ipaddress.IPv4Interface(self.local).network

    @property
    def control(self) -> Control:
        """Whether an application controls it now; ABSENT if it cannot be asked."""
        if not is_ip(self.address):
            return Control.CONTROLLED if self.is_claimed else Control.FREE
        return read_control(self.address) if self.in_network else Control.ABSENT


def discover(wait_s: float = DISCOVERY_S) -> tuple[FoundCamera, ...]:
    """Return all GigE cameras that reply to a broadcast on the networks of this computer, sorted by address."""
    request_id = next_id()
    found: dict[tuple[str, ...], FoundCamera] = {}
    for port, reply in _replies(command(_DISCOVERY, request_id, flags=_ALLOW_BROADCAST), wait_s):
        if (camera := discovered(reply, request_id, port)) is not None:
            key = camera.serial, camera.mac, camera.address
            # Several ports may find one camera: that of its own network counts.
            if key not in found or (camera.in_network and not found[key].in_network):
                found[key] = camera
    return tuple(sorted(found.values(), key=lambda camera: socket.inet_aton(camera.address)))


USB_DEVICES = Path("/sys/bus/usb/devices")
_USB3_VISION = ("ef", "05", "00")
"""Class, subclass and protocol of the control interface of a USB3 camera."""


def usb_cameras(devices: Path = USB_DEVICES) -> tuple[FoundCamera, ...]:
    """Return the USB3 cameras that the kernel knows, sorted by place. The station's own process has no other way."""

    def text(path: Path) -> str:
        try:
            return path.read_text(errors="replace").strip()
        except OSError:  # it has no such text, or was unplugged at this moment
            return ""

    found = []
    for interface in sorted(devices.glob("*:*")):
        kind = tuple(text(interface / f"bInterface{part}") for part in ("Class", "SubClass", "Protocol"))
        if kind == _USB3_VISION:
            device = devices / interface.name.partition(":")[0]
            serial, maker, model = (text(device / name) for name in ("serial", "manufacturer", "product"))
            is_claimed = (interface / "driver").resolve().name == "usbfs"
            place = f"USB {device.name}"
            found.append(FoundCamera(serial, "", "", maker, model, place, is_claimed=is_claimed))
    return tuple(found)


def search_all() -> tuple[FoundCamera, ...]:
    """Return all GigE cameras that reply to a broadcast now, and all USB3 cameras."""
    return (*discover(), *usb_cameras())


def discovered(datagram: bytes, request_id: int, port: Port | None = None) -> FoundCamera | None:
    """Return the camera of a reply to DISCOVERY that came on a port; None for every other datagram."""
    if not is_reply(datagram, _DISCOVERY, request_id) or len(datagram) < _REPLY_BYTES:
        return None

    def text(at: int, size: int) -> str:
        return datagram[at : at + size].split(b"\0")[0].decode("ascii", "replace").strip()

    return FoundCamera(
        serial=text(_SERIAL, 16),
        address=socket.inet_ntoa(datagram[_ADDRESS : _ADDRESS + 4]),
        mac=datagram[_MAC : _MAC + 6].hex(":"),
        maker=text(_MAKER, 32),
        model=text(_MODEL, 32),
        interface=port.name if port else "",
        local=_local(port) if port else "",
    )


def find(serial: str, found: Iterable[FoundCamera]) -> FoundCamera:
    """Return the only camera of a search with this serial number; raise `DeviceError` if there is none, or several."""
    matching = [camera for camera in found if camera.serial == serial]
    if not matching:
        raise DeviceError(
            f"No camera with serial number {serial!r} answers on a network port of this computer.",
            action="Check its cable and power; after power-on a camera needs up to a minute. Compare its label.",
            code="camera-absent",
        )
    if len(matching) > 1:
        places = ", ".join(f"{camera.address} ({camera.mac})" for camera in matching)
        raise DeviceError(
            f"{len(matching)} cameras have the serial number {serial!r}: {places}.",
            action="Unplug those that are not meant.",
            code="camera-ambiguous",
        )
    return matching[0]


def free_address(camera: FoundCamera, wished: Iterable[str], used: Collection[str]) -> str:
    """Return an address for a camera in the network of its port: a wished one, else the next one that is free.

    `used` are addresses that are not to be taken although no device answers there. `StateError`: none was found.
    """
    own = _own_network(camera)
    wishes = [address for address in wished if _fits(address, own) and address not in used]
    # Beginning behind the port's own address: the first ones of a network mostly belong to switches and routers.
    first, count = own.network.network_address, own.network.num_addresses
    following = (first + (int(own.ip) - int(first) + step) % count for step in range(1, count))
    next_ones = (str(address) for address in itertools.islice(following, _SEARCHED))
    for address in (*wishes, *(a for a in next_ones if _fits(a, own) and a not in used)):
        if not is_taken(address, tries=1):
            return address
    raise StateError(
        f"No free address was found in {own.network}, the network of port {camera.interface}.",
        action="Give an address that no device has.",
        code="address-taken",
    )


def is_taken(address: str, tries: int = 2) -> bool:
    """Return whether this computer or another device has an address of a network of this computer."""
    if any(_local(port).partition("/")[0] == address for port in ports()) or is_reachable(address, tries=tries):
        return True
    # A device that is no camera answers the kernel, which asked for its hardware address to send the request.
    with contextlib.suppress(OSError):
        for line in Path("/proc/net/arp").read_text().splitlines()[1:]:
            neighbour, _, flags, *_ = line.split()
            if neighbour == address:
                return bool(int(flags, 16) & 2)
    return False


def set_address(camera: FoundCamera, address: str) -> None:
    """Give a camera an address in the network of its port, now and after every power-on.

    Raises:
        InputError: the address is not one of that network.
        StateError: another device has the address.
        DeviceError: another program controls the camera, or it does not take the address.
    """
    own = _own_network(camera)
    if not _fits(address, own):
        limit = f"an address of a device in {own.network}, the network of port {camera.interface}"
        raise InputError.field(f"camera {camera.serial}", "address", address, limit)
    require_free(camera)
    if address != camera.address:
        if is_taken(address):
            raise StateError(
                f"Another device has the address {address} that camera {camera.serial} is to have.",
                action="Choose a free address, or unplug the other device.",
                code="address-taken",
            )
        _force(camera, address, own)
    _keep(camera, address, own)


def require_free(camera: FoundCamera) -> None:
    """Raise DeviceError if an application controls a camera now; one of a foreign network cannot be asked."""
    if camera.control is Control.CONTROLLED:
        raise _in_use(camera, controlled_by(camera.address))


def _in_use(camera: FoundCamera, where: str = "") -> DeviceError:
    return DeviceError(
        f"Another program{where} controls the camera {camera.serial} at {camera.address}.",
        action="Close that program (the maker's viewer, another station), then try again.",
        code="camera-in-use",
    )


def _force(camera: FoundCamera, address: str, own: ipaddress.IPv4Interface) -> None:
    """Let a camera have an address until its next power-on."""
    numbers = (address, str(own.netmask), "0.0.0.0")  # noqa: S104  (no gateway)
    content = _FORCED.pack(bytes.fromhex(camera.mac.replace(":", "")), *map(socket.inet_aton, numbers))
    request_id = next_id()
    forced = command(_FORCE_IP, request_id, content, _ALLOW_BROADCAST)
    end_s = time.monotonic() + NEW_ADDRESS_S
    while time.monotonic() < end_s:
        # Repeated, because a broadcast may be lost; a camera that has the address already only confirms it.
        for _, reply in _replies(forced, 0.3, camera.interface):
            # Nothing else tells who controls a camera of a foreign network: DISCOVERY does not state it, and registers
            # are not read by broadcast.
            if is_reply(reply, _FORCE_IP, request_id) and reply.startswith(_DENIED):
                raise _in_use(camera)
        if is_reachable(address):
            return
    raise DeviceError(
        f"Camera {camera.serial} does not answer at {address} within {NEW_ADDRESS_S:.0f} s of the command to take it.",
        action="Unplug it, plug it in again, wait a minute, and try again.",
        code="address-refused",
    )


def _keep(camera: FoundCamera, address: str, own: ipaddress.IPv4Interface) -> None:
    """Let a camera have its present address after every power-on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(0.5)
        client.connect((address, CONTROL_PORT))
        # Only the application that controls a camera may write. A station whose place has this address opens the camera
        # as soon as it answers there, and leaves it again because it is another one.
        end_s = time.monotonic() + NEW_ADDRESS_S
        while not _accepts(client, _PRIVILEGE, _IN_CONTROL) and time.monotonic() < end_s:
            time.sleep(AGAIN_S)
        try:
            present = request(client, _READ_REGISTER, _IP_CONFIGURATION.to_bytes(4, "big")) or b""
            _write(client, camera, _PERSISTENT_ADDRESS, _as_number(address))
            _write(client, camera, _PERSISTENT_MASK, int(own.netmask))
            _write(client, camera, _PERSISTENT_GATEWAY, 0)
            _write(client, camera, _IP_CONFIGURATION, int.from_bytes(present[:4], "big") | _USE_PERSISTENT)
        finally:
            with contextlib.suppress(DeviceError):  # it is released after some seconds without a heartbeat
                _write(client, camera, _PRIVILEGE, 0)


def _accepts(client: socket.socket, register: int, value: int) -> bool:
    content = struct.pack(">II", register, value)
    # None: no reply in time; empty: a refusal.
    return bool(next((r for _ in range(3) if (r := request(client, _WRITE_REGISTER, content)) is not None), None))


def _write(client: socket.socket, camera: FoundCamera, register: int, value: int) -> None:
    if not _accepts(client, register, value):
        raise DeviceError(
            f"Camera {camera.serial} has its new address, but does not keep it for the next power-on (register "
            f"0x{register:04X} refused).",
            action="Close other programs that use it and set the address again, or set it with the maker's tool.",
            code="address-refused",
        )


def _replies(datagram: bytes, wait_s: float, interface: str | None = None) -> Iterator[tuple[Port, bytes]]:
    """Send a datagram to everyone on all ports of this computer, or on one; yield what is answered, and where."""
    with contextlib.ExitStack() as stack:
        selector = stack.enter_context(selectors.DefaultSelector())
        # One socket per address: a broadcast leaves by the interface whose address the socket is bound to.
        for port in ports():
            if interface not in (None, port.name):
                continue
            client, answers = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
            client.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            with contextlib.suppress(OSError):  # an interface that is down
                client.bind((_local(port).partition("/")[0], 0))
                # An answer by broadcast does not reach a socket that is bound to another address.
                answers.bind((_EVERYONE, client.getsockname()[1]))
                client.sendto(datagram, (_EVERYONE, CONTROL_PORT))
                for each in (client, answers):
                    each.setblocking(False)
                    selector.register(each, selectors.EVENT_READ, (each, port))
        deadline_s = time.monotonic() + wait_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            for key, _ in selector.select(left_s):
                answering, port = key.data
                with contextlib.suppress(OSError):
                    yield port, answering.recv(1024)


def _own_network(camera: FoundCamera) -> ipaddress.IPv4Interface:
    """Return the address and network of the port on which a camera replied; InputError for a USB camera."""
    if not camera.local:
        raise InputError(f"camera {camera.serial}: is a USB camera, which has no address.")
    return ipaddress.IPv4Interface(camera.local)


def _local(port: Port) -> str:
    return f"{ipaddress.ip_address(port.address)}/{port.mask.bit_count()}"


def _fits(address: str, own: ipaddress.IPv4Interface) -> bool:
    """Return whether an address is one of a device in the network of a port."""
    try:
        wanted = ipaddress.IPv4Address(address)
    except ValueError:
        return False
    ends = (own.network.network_address, own.network.broadcast_address, own.ip)
    return wanted in own.network and wanted not in ends


def _as_number(address: str) -> int:
    return int(ipaddress.IPv4Address(address))
