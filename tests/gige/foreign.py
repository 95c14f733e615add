"""A GigE camera whose address is of a foreign network: only broadcasts reach it until FORCEIP gives it another one."""

from __future__ import annotations

import selectors
import socket
import struct
import threading

_EVERYONE, _PORT = "255.255.255.255", 3956
_DISCOVERY, _FORCE_IP, _READ, _WRITE = 2, 4, 0x80, 0x82
_ALLOW_BROADCAST = 0x10


class ForeignCamera:
    """Answers on loopback in a thread of its own, with those registers of the standard that are needed."""

    def __init__(self, serial: str, address: str = "10.9.8.7", model: str = "Foreign") -> None:
        self.serial = serial
        self.memory = bytearray(0x1000)
        self.refuses: set[int] = set()
        """Registers whose writing the camera refuses."""
        for at, text in ((0x48, "Test"), (0x68, model), (0xD8, serial)):
            self.memory[at : at + len(text)] = text.encode()
        self.memory[0x0A:0x10] = bytes.fromhex("0200") + serial.encode()[-4:].rjust(4, b"\0")
        self.memory[0x24:0x28] = socket.inet_aton(address)
        self.set(0x14, 0b110)
        self._selector, self._closing = selectors.DefaultSelector(), False
        self._serve(_EVERYONE)
        self._broadcast = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._broadcast.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._broadcast.bind(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._run, name=f"camera 127. {serial}")
        self._thread.start()

    @property
    def address(self) -> str:
        """The present address."""
        return socket.inet_ntoa(self.memory[0x24:0x28])

    def get(self, register: int) -> int:
        """Return the number in a register."""
        return int.from_bytes(self.memory[register : register + 4], "big")

    def set(self, register: int, number: int) -> None:
        """Change the number in a register."""
        self.memory[register : register + 4] = number.to_bytes(4, "big")

    def close(self) -> None:
        """Disappear from the network."""
        self._closing = True
        self._thread.join()
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._broadcast.close()

    def _serve(self, address: str) -> None:
        at = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        at.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        at.bind((address, _PORT))
        self._selector.register(at, selectors.EVENT_READ, address == _EVERYONE)

    def _run(self) -> None:
        while not self._closing:
            for key, _ in self._selector.select(0.05):
                at: socket.socket = key.fileobj  # type: ignore[assignment]
                datagram, client = at.recvfrom(1024)
                if len(datagram) < 8:
                    continue
                _, flags, command, _, request = struct.unpack_from(">BBHHH", datagram)
                status, content = self._obey(command, datagram[8:])
                if status is None:
                    continue
                reply = struct.pack(">HHHH", status, command + 1, len(content), request) + content
                if not key.data:
                    at.sendto(reply, client)
                elif flags & _ALLOW_BROADCAST:
                    self._broadcast.sendto(reply, (_EVERYONE, client[1]))

    def _obey(self, command: int, content: bytes) -> tuple[int | None, bytes]:
        """Return the status of a reply, None for no reply, and its content."""
        if command == _DISCOVERY:
            return 0, bytes(self.memory[:0xF8])
        if command == _FORCE_IP:
            if content[2:8] != self.memory[0x0A:0x10] or self.get(0xA00):
                return (0x8006 if self.get(0xA00) else None), b""
            if self.address != socket.inet_ntoa(content[20:24]):
                self.memory[0x24:0x28] = content[20:24]
                self._serve(self.address)
            return 0, b""
        register = int.from_bytes(content[:4], "big")
        if command == _READ:
            return 0, bytes(self.memory[register : register + 4])
        if command == _WRITE and register not in self.refuses:
            self.memory[register : register + 4] = content[4:8]
            return 0, b"\0\0\0\1"
        return 0x8006, b""
