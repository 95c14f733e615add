"""A GigE Vision camera on a loopback address, scripted by a test: GVCP and GVSP over real UDP sockets.

Aravis' fake camera sends what the protocol permits. This one sends whatever a test wants: packets with a wrong id,
twice or not at all, chunk data, ids of 64 bits, and time stamps of a clock that jumps.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence

from tests.gige.description import (
    ADDRESSES,
    MODEL_ADDRESS,
    PACKET_SIZE_ADDRESS,
    SERIAL_ADDRESS,
    VENDOR_ADDRESS,
    description,
)
from tests.gige.packets import CHUNKS, IMAGE, Stream

CONTROL_PORT = 3956
PRIVILEGE, CAPABILITIES, STREAM_PORT, STREAM_ADDRESS = 0xA00, 0x934, 0xD00, 0xD18
CAN_RESEND = 1 << 2
ACCESS_DENIED = 0x8006
XML_ADDRESS = 0x10000
CHUNK_BYTES = 16
RESEND, READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = 0x40, 0x80, 0x82, 0x84, 0x86

Script = Callable[[list[bytes]], Sequence[bytes]]
"""Function that makes from the packets of a frame those that are sent, in their order."""


def as_it_is(packets: list[bytes]) -> Sequence[bytes]:
    """Send all packets once, in order."""
    return packets


class Camera:
    """One camera. A thread answers control requests; `expose` sends frames in the thread of the caller."""

    def __init__(self, address: str, serial: str = "GIGE", *, extended: bool = False, chunks: bool = False) -> None:
        """Serve the camera.

        Args:
            address: local address.
            serial: serial number.
            extended: whether frame ids and packet ids have 64 and 32 bits.
            chunks: whether the camera adds chunk data to frames, unless a client turns them off.
        """
        self.address, self.serial = address, serial
        self.extended, self._chunks = extended, chunks
        self.clock_offset_ns = 0
        """The camera's time minus this computer's monotonic time."""
        self.next_id = 1
        self.obeys_chunk_mode = True
        self.blocked = False
        """Whether a firewall drops all frames on their way."""
        self.resend: Script = as_it_is
        """Makes from the packets that a client asks for again those that are sent."""
        self.resend_requests = 0
        self._sent: list[bytes] = []
        self._sending = threading.Lock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, CONTROL_PORT))
        self._data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._data.bind((address, 0))
        self._closing = False
        self.boot()
        self._thread = threading.Thread(target=self._serve, name=f"camera {address}")
        self._thread.start()

    def boot(self) -> None:
        """Begin anew, as after a restart: default settings, no controlling client, frame ids from 1."""
        xml = description(chunks=self._chunks).encode()
        memory = bytearray(XML_ADDRESS) + xml + bytes(8)
        url = f"Local:test.xml;{XML_ADDRESS:X};{len(xml):X}"
        texts = {VENDOR_ADDRESS: "Test", MODEL_ADDRESS: "Scripted", SERIAL_ADDRESS: self.serial, 0x200: url}
        for at, text in texts.items():
            memory[at : at + len(text)] = text.encode()
        numbers = {
            0x0: 0x00020000, 0x4: 0x80000001, 0x600: 1, 0x904: 1, CAPABILITIES: CAN_RESEND | 2, 0x938: 3000,
            0x940: 1_000_000_000, PACKET_SIZE_ADDRESS: 1400,
            0x24: struct.unpack(">I", socket.inet_aton(self.address))[0],
            ADDRESSES["Width"]: 64, ADDRESSES["Height"]: 64, ADDRESSES["PixelFormat"]: 0x01080001,
            ADDRESSES["ExposureTimeRaw"]: 10_000, ADDRESSES["ChunkModeActive"]: int(self._chunks),
        }  # fmt: skip
        for at, number in numbers.items():
            memory[at : at + 4] = number.to_bytes(4, "big")
        self._memory, self._owner, self.next_id = memory, ("", 0), 1
        self.clock_offset_ns = -time.monotonic_ns()
        self._update_payload()

    def time_ns(self) -> int:
        """Return the camera's time."""
        return time.monotonic_ns() + self.clock_offset_ns

    @property
    def armed(self) -> bool:
        """Whether a client controls the camera, has started it, and has turned its trigger on."""
        return bool(self._number(PRIVILEGE) and self.get("AcquisitionStart") and self.get("TriggerMode"))

    @property
    def stream(self) -> Stream:
        """What a client has set for the stream."""
        size = self._number(PACKET_SIZE_ADDRESS) & 0xFFFF
        return Stream(self.get("Width"), self.get("Height"), size, self.extended)

    def expose(self, pixels: bytes, script: Script = as_it_is, edge_ns: int | None = None) -> int:
        """Send the frame of a trigger edge; return its id. A camera that is not armed sends nothing: 0.

        Args:
            pixels: all bytes of the frame.
            script: makes the packets that are sent.
            edge_ns: monotonic time of the edge; None: now.
        """
        time_ns = self.clock_offset_ns + (time.monotonic_ns() if edge_ns is None else edge_ns)
        if not self.armed:
            return 0
        number, self.next_id = self.next_id, self.next_id + 1
        if self.next_id > (2**64 - 1 if self.extended else 65535):
            self.next_id = 1
        chunks = self.get("ChunkModeActive")
        packets = self.stream.frame(
            pixels + bytes(CHUNK_BYTES * chunks), number, time_ns, IMAGE | CHUNKS if chunks else IMAGE
        )
        # Packets are sent again only after the frame, as a camera does it between two frames.
        with self._sending:
            self._sent = packets
            self.send(script(packets))
        return number

    def send(self, packets: Sequence[bytes]) -> None:
        """Send packets to the client."""
        to = (socket.inet_ntoa(self._memory[STREAM_ADDRESS : STREAM_ADDRESS + 4]), self._number(STREAM_PORT) & 0xFFFF)
        for packet in () if self.blocked else packets:
            self._data.sendto(packet, to)

    def close(self) -> None:
        """Disappear from the network."""
        if self._closing:
            return
        self._closing = True
        self._data.sendto(b"", (self.address, CONTROL_PORT))
        self._thread.join()
        self._socket.close()
        self._data.close()

    def _serve(self) -> None:
        while not self._closing:
            datagram, client = self._socket.recvfrom(2048)
            if len(datagram) >= 8:
                self._answer(datagram, client)

    def _answer(self, datagram: bytes, client: tuple[str, int]) -> None:
        _, flags, command, _, request_id = struct.unpack_from(">BBHHH", datagram)
        content = datagram[8:]
        if command == RESEND:
            self._send_again(content, bool(flags & 0x10))
            return
        reply, status = b"", 0
        writes = command in (WRITE_REGISTER, WRITE_MEMORY)
        if writes and self._number(PRIVILEGE) and client != self._owner:
            status = ACCESS_DENIED
        elif command == 2:
            reply = bytes(self._memory[:0xF8])
        elif command == READ_REGISTER:
            (at,) = struct.unpack_from(">I", content)
            reply = self._read(at, 4)
        elif command == READ_MEMORY:
            at, count = struct.unpack_from(">IxxH", content)
            reply = content[:4] + self._read(at, count)
        else:
            at = int.from_bytes(content[:4], "big")
            self._write(at, content[4:])
            if at == PRIVILEGE:
                self._owner = client
            reply = b"\0\0\0\1"
        head = struct.pack(">HHHH", status, command + 1, len(reply), request_id)
        self._socket.sendto(head + reply, client)

    def _send_again(self, content: bytes, extended: bool) -> None:
        first, last = (n & (0xFFFFFFFF if extended else 0xFFFFFF) for n in struct.unpack_from(">II", content, 4))
        self.resend_requests += last - first + 1
        with self._sending:
            self.send(self.resend(self._sent[first : last + 1]))

    def _read(self, at: int, count: int) -> bytes:
        return bytes(self._memory[at : at + count]).ljust(count, b"\0")

    def _write(self, at: int, content: bytes) -> None:
        if at == ADDRESSES["ChunkModeActive"] and not self.obeys_chunk_mode:
            return
        self._memory[at : at + len(content)] = content
        if at == ADDRESSES["TimestampLatch"]:
            self._put(ADDRESSES["TimestampLatchValue"], self.time_ns(), 8)
        elif at == ADDRESSES["AcquisitionStop"]:
            self.set("AcquisitionStart", 0)
        self._update_payload()

    def _update_payload(self) -> None:
        pixels = self.get("Width") * self.get("Height")
        self.set("PayloadSize", pixels + CHUNK_BYTES * self.get("ChunkModeActive"))

    def get(self, name: str) -> int:
        """Return the register of a feature."""
        return self._number(ADDRESSES[name])

    def set(self, name: str, number: int) -> None:
        """Change the register of a feature, as no client has asked for."""
        self._put(ADDRESSES[name], number)

    def _number(self, at: int) -> int:
        return int.from_bytes(self._memory[at : at + 4], "big")

    def _put(self, at: int, number: int, size: int = 4) -> None:
        self._memory[at : at + size] = number.to_bytes(size, "big")
