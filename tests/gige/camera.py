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
    CHUNKS,
    MODEL_ADDRESS,
    PACKET_SIZE_ADDRESS,
    SERIAL_ADDRESS,
    VENDOR_ADDRESS,
    description,
)
from tests.gige.sequencer import Sequencer
from vaoi_station.rig.gige.packets import IMAGE, WITH_CHUNKS, Stream

CONTROL_PORT = 3956
PRIVILEGE, CAPABILITIES, STREAM_PORT, STREAM_ADDRESS = 0xA00, 0x934, 0xD00, 0xD18
CAN_RESEND = 1 << 2
ACCESS_DENIED = 0x8006
XML_ADDRESS = 0x10000
IMAGE_CHUNK = 0xE0
RESEND, READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = 0x40, 0x80, 0x82, 0x84, 0x86

SEQUENCER_ADDRESSES = frozenset(address for name, address in ADDRESSES.items() if name.startswith("Sequencer"))

Script = Callable[[list[bytes]], Sequence[bytes]]
"""Function that makes from the packets of a frame those that are sent, in their order."""


def as_it_is(packets: list[bytes]) -> Sequence[bytes]:
    """Send all packets once, in order."""
    return packets


class Camera:
    """One camera. A thread answers control requests; `expose` sends frames in the thread of the caller."""

    def __init__(
        self,
        address: str,
        serial: str = "GIGE",
        *,
        extended: bool = False,
        chunks: bool = False,
        sequencer: bool = False,
    ) -> None:
        """Serve the camera.

        Args:
            address: local address.
            serial: serial number.
            extended: whether frame ids and packet ids have 64 and 32 bits.
            chunks: whether the camera adds chunk data to frames, unless a client turns them off.
            sequencer: whether it has a sequencer, a gain, and chunk data that a client may turn on.
        """
        self.address, self.serial = address, serial
        self._has_sequencer = sequencer
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
        with_chunks = self._chunks or self._has_sequencer
        xml = description(chunks=with_chunks, sequencer=self._has_sequencer).encode()
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
        self.sequencer = Sequencer()
        self._chunk_enabled = dict.fromkeys(CHUNKS, False)
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
        packets = self.stream.frame(
            pixels + self._chunk_data(len(pixels)),
            number,
            time_ns,
            IMAGE | WITH_CHUNKS if self.get("ChunkModeActive") else IMAGE,
        )
        self.sequencer.advance()
        # Packets are sent again only after the frame, as a camera does it between two frames.
        with self._sending:
            self._sent = packets
            self.send(script(packets))
        return number

    @property
    def shutter(self) -> tuple[int, int]:
        """Exposure (µs) and gain (0.01 dB) of the next frame: those of the sequencer's set, or of the registers."""
        active = self.sequencer.active
        return (self.get("ExposureTimeRaw"), self.get("GainCentibel")) if active is None else active

    def film(self, scene: bytes, edge_ns: int) -> int:
        """Send a frame of a scene of grey levels per 100 µs at gain 1, with the camera's exposure and gain."""
        exposure_us, centibel = self.shutter
        factor = exposure_us / 100 * 10 ** (centibel / 2000)
        return self.expose(bytes(min(255, round(value * factor)) for value in scene), edge_ns=edge_ns)

    def _chunk_data(self, pixels: int) -> bytes:
        """Return the chunk data behind a number of pixels: each chunk is followed by its id and its length."""
        if not self.get("ChunkModeActive"):
            return b""
        exposure_us, centibel = self.shutter
        values = {"ExposureTime": float(exposure_us), "Gain": centibel / 100}
        enabled = [name for name in CHUNKS if self._chunk_enabled[name]]
        return struct.pack(">II", IMAGE_CHUNK, pixels) + b"".join(
            struct.pack(">dII", values[name], CHUNKS[name], 8) for name in enabled
        )

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
        at = int.from_bytes(content[:4], "big")
        foreign = self._number(PRIVILEGE) and client != self._owner
        # A camera locks its sequencer while it is acquiring.
        locked = at in SEQUENCER_ADDRESSES and (self.get("AcquisitionStart") or self.sequencer.refuses(at, self.get))
        if writes and (foreign or locked):
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
        elif at == ADDRESSES["ChunkSelector"]:
            self.set("ChunkEnable", self._chunk_enabled[self._selected_chunk])
        elif at == ADDRESSES["ChunkEnable"]:
            self._chunk_enabled[self._selected_chunk] = bool(self.get("ChunkEnable"))
        elif at in SEQUENCER_ADDRESSES:
            self.sequencer.write(at, self.get, self.set)
        self._update_payload()

    @property
    def _selected_chunk(self) -> str:
        return list(CHUNKS)[self.get("ChunkSelector")]

    def _update_payload(self) -> None:
        pixels = self.get("Width") * self.get("Height")
        self.set("PayloadSize", pixels + len(self._chunk_data(pixels)))

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
