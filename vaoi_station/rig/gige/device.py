"""A GigE Vision device without a camera behind it: GVCP over UDP, bootstrap registers, memory, and its faults."""

from __future__ import annotations

import contextlib
import io
import socket
import struct
import threading
import time
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from vaoi_station.rig.gige.description import Description, Features, moved
from vaoi_station.rig.gige.first_values import BOOTSTRAP_END, FirstValues, Sensor
from vaoi_station.rig.gige.formula import Number
from vaoi_station.rig.gige.ptp import ClockFaults, Ptp

CONTROL_PORT = 3956
DISCOVERY, FORCE_IP, RESEND, READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = (
    2,
    4,
    0x40,
    0x80,
    0x82,
    0x84,
    0x86,
)
ALLOW_BROADCAST_ACKNOWLEDGE, EXTENDED_IDS = 0x10, 0x10
NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS, WRITE_PROTECTED, ACCESS_DENIED, BUSY = (
    0x8001, 0x8002, 0x8003, 0x8004, 0x8006, 0x8007,
)  # fmt: skip
MAC_HIGH, MAC_LOW, ADDRESS, SUBNET, GATEWAY, SERIAL = 0x8, 0xC, 0x24, 0x34, 0x44, 0xD8
USER_NAME, LINK_SPEED = 0xE8, 0x670
PERSISTENT_ADDRESS, PERSISTENT_SUBNET, PERSISTENT_GATEWAY = 0x64C, 0x65C, 0x66C
CAPABILITIES, HEARTBEAT_TIMEOUT, TICKS_HIGH, TICKS_LOW = 0x934, 0x938, 0x93C, 0x940
CLOCK_CONTROL, CLOCK_HIGH, CLOCK_LOW, PRIVILEGE, APPLICATION = 0x944, 0x948, 0x94C, 0xA00, 0xA14
STREAM_PORT, PACKET_SIZE, PACKET_DELAY, STREAM_ADDRESS = 0xD00, 0xD04, 0xD08, 0xD18
_CLOCK_RESET, _CLOCK_LATCH = 1, 2
_CAN_PTP = 1 << 31 - 12
_FIRE_TEST_PACKET = 0x80000000
IP_UDP_BYTES = 28
XML_ADDRESS = 0x6D00_0000
"""No description that was met has registers there."""
SHIFT = 0x0100_0000
"""By which the registers of cameras that are no GigE cameras are moved behind the bootstrap registers."""
_PAGE = 4096
_URL = 0x200


@dataclass
class Faults(ClockFaults):
    """What a device does wrong. Features are named as in its description."""

    refuses: dict[str, int] = field(default_factory=dict)
    """Feature → GVCP status with which every write is refused."""
    keeps: dict[str, Number] = field(default_factory=dict)
    """Feature → the value that it has whatever is written."""
    restarts_at: str = ""
    """Feature: the device restarts when it is written, once."""
    silent: bool = False
    """It has link and answers nothing; only `plug` ends it."""
    sends_nothing: bool = False
    """It answers, and sends no packets of frames."""
    cured_by: str = ""
    """What ends `sends_nothing`: a command such as `AcquisitionStart` or `DeviceReset`, `reopen`, or "" for none."""
    reset_s: float = 0.0
    """How long it is absent after DeviceReset."""
    test_packets: bool = True
    """Whether it sends a test packet when it is asked for one."""
    path_bytes: int = 65535
    """Largest packet (with its IP header) that reaches the client."""


class Registers:
    """A memory of 32-bit addresses; what was never written is 0."""

    def __init__(self) -> None:
        self.pages: dict[int, bytearray] = {}

    def read(self, address: int, count: int) -> bytes:
        """Return bytes."""
        return b"".join(bytes(page[start:end]) for page, start, end in self._parts(address, count))

    def write(self, address: int, content: bytes) -> None:
        """Change bytes."""
        done = 0
        for page, start, end in self._parts(address, len(content)):
            page[start:end] = content[done : done + end - start]
            done += end - start

    def copy(self) -> dict[int, bytes]:
        """Return all registers, by pages."""
        return {at: bytes(page) for at, page in self.pages.items() if at * _PAGE != XML_ADDRESS}

    def restore(self, pages: dict[int, bytes], first: int = 0) -> None:
        """Write what `copy` has returned, from an address on."""
        for at, content in pages.items():
            if at * _PAGE >= first:
                self.pages[at] = bytearray(content)

    def _parts(self, address: int, count: int) -> Sequence[tuple[bytearray, int, int]]:
        parts = []
        while count > 0:
            at, start = divmod(address & 0xFFFFFFFF, _PAGE)
            end = min(_PAGE, start + count)
            parts.append((self.pages.setdefault(at, bytearray(_PAGE)), start, end))
            address, count = address + end - start, count - (end - start)
        return parts


class Device:
    """One device at one local address. A thread answers control requests."""

    def __init__(
        self, address: str, description: str, *, serial: str, sensor: Sensor | None = None, foreign: bool = False
    ) -> None:
        """Serve a device.

        Args:
            address: local address; with `foreign` one of another network, so that only broadcasts reach it.
            description: GenICam XML.
            serial: serial number.
            sensor: what the description leaves open.
        """
        self.address, self.serial, self.faults = address, serial, Faults()
        self.sensor = sensor = sensor or Sensor()
        self._model = Description(description)
        if not self._model.is_gige:
            self._model = Description(moved(description, SHIFT))
        self.tick_hz = sensor.tick_hz or (1_000_000_000 if "TimestampLatch" in self._model.nodes else 125_000_000)
        self.mac = 0x020000000000 | zlib.crc32(serial.encode())
        self.lock = threading.RLock()
        """Held while registers are read or written."""
        self.clock_offset_ns = 0
        """The device's time minus this computer's monotonic time."""
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("camera.xml", self._model.text)
        self._file = packed.getvalue()
        self._first: tuple[dict[int, bytes], dict[tuple[str, tuple[Number, ...]], bytes]] | None = None
        self._closing, self._absent_until_s = False, 0.0
        self.registers = Registers()
        self.boot()
        self._socket = self._bound("127.0.0.1", 0) if foreign else self._bound(address)
        self._data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._data.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 8 << 20)
        self._data.bind(("127.0.0.1" if foreign else address, 0))
        self._broadcasts = self._bound("255.255.255.255")
        self._threads = [
            threading.Thread(target=self._serve, args=(s,), name=f"camera {address}", daemon=True)
            for s in (self._socket, self._broadcasts)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def absent(self) -> bool:
        """Whether it is restarting."""
        return time.monotonic() < self._absent_until_s

    def plug(self) -> None:
        """Switch its power off and on: everything is as at the first start, and nothing hangs."""
        self.faults.silent = self.faults.sends_nothing = False
        self.boot()

    def reset(self) -> None:
        """Restart, as a client has asked for."""
        self._absent_until_s = time.monotonic() + self.faults.reset_s
        self.boot()

    def cure(self, what: str) -> None:
        """End the hanging if this is what ends it."""
        if what == self.faults.cured_by:
            self.faults.sends_nothing = False

    def boot(self) -> None:
        """Begin anew, as after a restart: first values, no controlling client."""
        with self.lock:
            persistent = self.registers.read(PERSISTENT_ADDRESS, 0x24) if self._first else b""
            self.registers = Registers()
            self.features = Features(self._model, self.registers)
            bootstrap = self._bootstrap()
            for at, content in bootstrap.items():
                self.registers.write(at, content)
            if "GevIEEE1588" in self.features:
                self.set_number(CAPABILITIES, self.number(CAPABILITIES) | _CAN_PTP)
            if self._first is None:
                taken = [at + k for at, content in bootstrap.items() for k in range(len(content))]
                sensor = replace(self.sensor, tick_hz=self.tick_hz)
                FirstValues(self.features, sensor, taken).write()
                if "DeviceSerialNumber" in self.features and not self._model.is_gige:
                    self.features.put("DeviceSerialNumber", self.serial)
                self._first = self.registers.copy(), dict(self.features.banks)
            self.registers.restore(self._first[0])
            if persistent:
                self.registers.write(PERSISTENT_ADDRESS, persistent)
            self.features.banks = dict(self._first[1])
            self.features.forget()
            self._owner, self._heard_s = ("", 0), 0.0
            self.clock_offset_ns = -time.monotonic_ns()
            self.ptp = Ptp(self)

    @property
    def description(self) -> str:
        """The description that it serves."""
        return self._model.text

    def time_ns(self) -> int:
        """Return the device's time."""
        return time.monotonic_ns() + self.clock_offset_ns

    def ticks(self, time_ns: int) -> int:
        """Return a time of the device in the ticks of its time stamps."""
        return time_ns * self.tick_hz // 1_000_000_000

    def set_tick_hz(self, tick_hz: int) -> None:
        """Count the clock in other ticks."""
        self.tick_hz = tick_hz
        self.set_number(TICKS_HIGH, tick_hz >> 32)
        self.set_number(TICKS_LOW, tick_hz & 0xFFFFFFFF)
        if "GevTimestampTickFrequency" in self.features:
            self.features.put("GevTimestampTickFrequency", tick_hz)
        self.features.forget()

    @property
    def controlled(self) -> bool:
        """Whether a client controls the device, and has been heard within the heartbeat's time limit."""
        limit_s = self.number(HEARTBEAT_TIMEOUT) / 1000
        if self.number(PRIVILEGE) and time.monotonic() - self._heard_s > limit_s:
            self.release()
        return bool(self.number(PRIVILEGE))

    def release(self) -> None:
        """Have no controlling client any more."""
        self.set_number(PRIVILEGE, 0)
        self.set_number(APPLICATION, 0)
        self.cure("reopen")
        self.on_release()

    def on_release(self) -> None:
        """Do what follows the loss of the client."""

    def on_write(self, address: int) -> None:
        """Do what follows a client's write to registers."""

    def refusal(self, address: int) -> int:
        """Return the status with which a write to an address is refused; 0 if it is accepted."""
        for feature, status in self.faults.refuses.items():
            if self.is_at(feature, address):
                return status
        return 0

    def is_at(self, feature: str, address: int) -> bool:
        """Whether a feature keeps its value in the register at an address."""
        register = self.features.register_of(feature) if feature in self.features else None
        return register is not None and self.features.address(register) == address

    def number(self, address: int) -> int:
        """Return a bootstrap register."""
        return int.from_bytes(self.registers.read(address, 4), "big")

    def set_number(self, address: int, number: int) -> None:
        """Change a bootstrap register."""
        self.registers.write(address, number.to_bytes(4, "big"))

    def send(self, packets: Sequence[bytes]) -> None:
        """Send packets of the stream to the client."""
        to = (socket.inet_ntoa(self.registers.read(STREAM_ADDRESS, 4)), self.number(STREAM_PORT) & 0xFFFF)
        if self.faults.sends_nothing or self.faults.silent or self.absent or not to[1]:
            return
        for packet in packets:
            if len(packet) + IP_UDP_BYTES <= self.faults.path_bytes:
                self._data.sendto(packet, to)

    def resend(self, content: bytes, *, extended: bool) -> None:
        """Send packets again that a client has asked for."""

    def close(self) -> None:
        """Disappear from the network."""
        if self._closing:
            return
        self._closing = True
        for s in (self._socket, self._broadcasts):
            with contextlib.suppress(OSError):
                s.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits for a datagram
        for thread in self._threads:
            thread.join()
        for s in (self._socket, self._broadcasts, self._data):
            s.close()

    # --- control requests

    def _bound(self, address: str, port: int = CONTROL_PORT) -> socket.socket:
        bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(address.endswith(".255")))
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        try:
            bound.bind((address, port))
        except OSError:
            bound.close()
            raise
        return bound

    def _serve(self, at: socket.socket) -> None:
        while not self._closing:
            try:
                datagram, client = at.recvfrom(2048)
            except OSError:
                return
            if len(datagram) >= 8 and datagram[0] == 0x42 and not (self.faults.silent or self.absent):
                with self.lock:
                    self._answer(datagram, client)

    def _answer(self, datagram: bytes, client: tuple[str, int]) -> None:
        _, flags, command, _, request_id = struct.unpack_from(">BBHHH", datagram)
        content = datagram[8:]
        self.ptp.advance()
        if client == self._owner:
            self._heard_s = time.monotonic()
        if command == RESEND:
            self.resend(content, extended=bool(flags & EXTENDED_IDS))
            return
        status, reply = self._reply(command, content, client)
        if command == FORCE_IP and status == INVALID_PARAMETER:
            return  # the request is for another device
        head = struct.pack(">HHHH", status, command + 1, len(reply), request_id)
        broadcast = command == DISCOVERY and flags & ALLOW_BROADCAST_ACKNOWLEDGE
        with contextlib.suppress(OSError):
            self._socket.sendto(head + reply, ("255.255.255.255", client[1]) if broadcast else client)

    def _reply(self, command: int, content: bytes, client: tuple[str, int]) -> tuple[int, bytes]:
        status, reply = 0, b""
        if command == DISCOVERY:
            reply = self.registers.read(0, 0xF8)
        elif command == FORCE_IP:
            status = self._force_address(content)
        elif command == READ_REGISTER:
            reply = b"".join(self.registers.read(at, 4) for (at,) in struct.iter_unpack(">I", content))
        elif command == READ_MEMORY:
            at, count = struct.unpack_from(">IxxH", content)
            reply = content[:4] + self.registers.read(at, count)
        elif command == WRITE_REGISTER:
            done = 0
            for at, number in struct.iter_unpack(">II", content):
                status = self._write(at, number.to_bytes(4, "big"), client)
                if status:
                    break
                done += 1
            reply = struct.pack(">HH", 0, done)
        elif command == WRITE_MEMORY:
            status = self._write(int.from_bytes(content[:4], "big"), content[4:], client)
            reply = struct.pack(">HH", 0, len(content) - 4)
        else:
            status = NOT_IMPLEMENTED
        return status, reply

    def _write(self, address: int, content: bytes, client: tuple[str, int]) -> int:
        if self.controlled and client != self._owner:
            return ACCESS_DENIED
        if status := self.refusal(address):
            return status
        self.write(address, content)
        if address < BOOTSTRAP_END:
            self._on_bootstrap(address, client)
        if self.faults.restarts_at and self.is_at(self.faults.restarts_at, address):
            self.faults.restarts_at = ""
            self.boot()
        return 0

    def read(self, address: int, count: int) -> bytes:
        """Return registers, as a client reads them."""
        with self.lock:
            return self.registers.read(address, count)

    def write(self, address: int, content: bytes) -> None:
        """Change registers, as a client does it, with what follows from it."""
        with self.lock:
            before = self.features.selector_values()
            self.registers.write(address, content)
            self.features.forget()
            written = frozenset(
                register
                for selector in before
                if (register := self.features.register_of(selector)) is not None
                and address <= self.features.address(register) < address + len(content)
            )
            if written:
                self.features.exchange(written, before)
            for feature, value in self.faults.keeps.items():
                if self.is_at(feature, address):
                    self.features.put(feature, value)
            self.on_write(address)

    def _on_bootstrap(self, address: int, client: tuple[str, int]) -> None:
        number = self.number(address)
        if address == PRIVILEGE:
            self._owner, self._heard_s = client, time.monotonic()
            self.registers.write(APPLICATION, socket.inet_aton(client[0]))
            if not number:
                self.release()
        elif address == CLOCK_CONTROL:
            if number & _CLOCK_RESET:
                self.clock_offset_ns = -time.monotonic_ns()
            if number & _CLOCK_LATCH:
                self.registers.write(CLOCK_HIGH, self.ticks(self.time_ns()).to_bytes(8, "big"))
            self.set_number(CLOCK_CONTROL, 0)
        elif address == PACKET_SIZE and number & _FIRE_TEST_PACKET:
            self.set_number(PACKET_SIZE, number & ~_FIRE_TEST_PACKET)
            if self.faults.test_packets:
                self.send([bytes(max((number & 0xFFFF) - IP_UDP_BYTES, 0))])

    def _force_address(self, content: bytes) -> int:
        mac = int.from_bytes(content[2:8], "big")
        if mac != self.mac:
            return INVALID_PARAMETER
        if self.controlled:
            return ACCESS_DENIED
        address, subnet, gateway = content[20:24], content[36:40], content[52:56]
        if any(address):
            self.registers.write(ADDRESS, address)
            self.registers.write(SUBNET, subnet)
            self.registers.write(GATEWAY, gateway)
            if self.address != socket.inet_ntoa(address):  # the command is repeated
                self._move(socket.inet_ntoa(address))
        return 0

    def _move(self, address: str) -> None:
        """Answer at another address from now on, if this computer has it."""
        try:
            at = self._bound(address)
        except OSError:
            self.address = address  # it answers only to broadcasts there
            return
        old, self._socket, self.address = self._socket, at, address
        thread = threading.Thread(target=self._serve, args=(at,), name=f"camera {address}", daemon=True)
        self._threads.append(thread)
        thread.start()
        with contextlib.suppress(OSError):
            old.shutdown(socket.SHUT_RDWR)
        old.close()
        data, self._data = self._data, socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._data.bind((address, 0))
        data.close()

    def _bootstrap(self) -> dict[int, bytes]:
        """Return the bootstrap registers after power-on, and the file of the description."""
        texts = {
            0x48: (self._model.vendor, 32), 0x68: (self._model.model, 32), 0x88: ("1.0", 32), 0xA8: ("stand-in", 48),
            SERIAL: (self.serial, 16), USER_NAME: ("", 16),
            _URL: (f"Local:camera.zip;{XML_ADDRESS:X};{len(self._file):X}", 512),
        }  # fmt: skip
        numbers = {
            0x0: 0x00020000, 0x4: 0x80000001, MAC_HIGH: self.mac >> 32, MAC_LOW: self.mac & 0xFFFFFFFF, 0x10: 7,
            0x14: 5, SUBNET: 0xFF000000, GATEWAY: 0, PERSISTENT_SUBNET: 0xFF000000, PERSISTENT_GATEWAY: 0, 0x600: 1,
            LINK_SPEED: 1000, 0x900: 0, 0x904: 1, CAPABILITIES: 0xF0000006, HEARTBEAT_TIMEOUT: 3000,
            TICKS_HIGH: self.tick_hz >> 32, TICKS_LOW: self.tick_hz & 0xFFFFFFFF, CLOCK_CONTROL: 0, CLOCK_HIGH: 0,
            CLOCK_LOW: 0, PRIVILEGE: 0, APPLICATION: 0, STREAM_PORT: 0, PACKET_SIZE: 1400, PACKET_DELAY: 0,
            STREAM_ADDRESS: 0,
        }  # fmt: skip
        return {
            XML_ADDRESS: self._file + bytes(8),
            **{at: text.encode()[: size - 1].ljust(size, b"\0") for at, (text, size) in texts.items()},
            **{at: number.to_bytes(4, "big") for at, number in numbers.items()},
            **{at: socket.inet_aton(self.address) for at in (ADDRESS, PERSISTENT_ADDRESS)},
        }
