"""Requests of the control protocol: their bytes, which replies count, and what a reply means."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.cameras.aravis import network


def test_only_the_reply_to_this_request_counts() -> None:
    assert network.command(0x80, 77, bytes(4)) == bytes.fromhex("42 01 0080 0004 004d 00000000")
    assert network.is_reply(bytes.fromhex("0000 0081 0004 004d 00010002"), 0x80, 77)
    assert network.is_reply(bytes.fromhex("8006 0081 0000 004d"), 0x80, 77), "a refusal proves its presence"
    assert not network.is_reply(bytes.fromhex("0000 0081 0004 004e 00010002"), 0x80, 77)
    assert not network.is_reply(bytes.fromhex("0000 0083 0004 004d 00010002"), 0x80, 77)
    assert not network.is_reply(b"\x00\x00", 0x80, 77)


@pytest.mark.parametrize(
    ("answer", "control"),
    [
        ("0000 00000000", network.Control.FREE),
        ("0000 00000001", network.Control.CONTROLLED),
        ("0000 00000002", network.Control.CONTROLLED),
        ("8006", network.Control.CONTROLLED),
        ("8006 00000000", network.Control.CONTROLLED),
    ],
)
def test_a_camera_is_free_only_if_it_reports_so(
    monkeypatch: pytest.MonkeyPatch, answer: str, control: network.Control
) -> None:
    """A refusal, with or without content, does not show who controls it."""
    status, content = bytes.fromhex(answer)[:2], bytes.fromhex(answer)[2:]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera, ThreadPoolExecutor(1) as caller:
        camera.settimeout(20)
        camera.bind(("127.0.0.1", 0))
        monkeypatch.setattr(network, "CONTROL_PORT", camera.getsockname()[1])
        result = caller.submit(network.read_control, "127.0.0.1", timeout_s=20, tries=1)
        request, client = camera.recvfrom(1024)
        assert request[8:] == bytes.fromhex("00000a00")
        camera.sendto(status + struct.pack(">HH", 0x81, len(content)) + request[6:8] + content, client)
        assert result.result() is control


def test_a_serial_number_ends_with_a_zero_or_after_16_bytes() -> None:
    registers = bytearray(struct.pack(">HHHH", 0, 3, 248, 1) + bytes(248))
    registers[8 + 0x24 : 8 + 0x28] = bytes([192, 168, 7, 31])
    registers[8 + 0xD8 : 8 + 0xE8] = b"21433566\0garbage"
    assert network.discovered(bytes(registers), 1) == network.FoundCamera("21433566", "192.168.7.31")
    assert network.discovered(bytes(registers), 2) is None, "the reply to another request"
    assert network.discovered(bytes(registers[:-1]), 1) is None
    registers[8 + 0xD8 : 8 + 0xE8] = b"0123456789ABCDEF"
    found = network.discovered(bytes(registers), 1)
    assert found is not None
    assert found.serial == "0123456789ABCDEF"


def test_without_a_camera_nothing_replies() -> None:
    assert not network.is_reachable("127.0.0.1", timeout_s=0.01)
    assert network.read_control("127.0.0.1", timeout_s=0.01) is network.Control.ABSENT


@given(st.integers(0, 0xFFFE), st.integers(1, 0xFFFF), st.binary(max_size=512))
def test_a_command_has_its_number_length_and_id(number: int, request_id: int, content: bytes) -> None:
    datagram = network.command(number, request_id, content)
    assert struct.unpack(">BBHHH", datagram[:8]) == (0x42, 0x01, number, len(content), request_id)
    assert datagram[8:] == content
    reply = struct.pack(">HHHH", 0, number + 1, 0, request_id)
    assert network.is_reply(reply, number, request_id)
    assert not network.is_reply(reply, number, request_id ^ 1)


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A socket in place of a camera; the port of the protocol is its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.settimeout(20)
        camera.bind(("127.0.0.1", 0))
        monkeypatch.setattr(network, "CONTROL_PORT", camera.getsockname()[1])
        yield camera


def test_a_late_reply_to_an_earlier_request_is_passed_over(camera: socket.socket) -> None:
    with ThreadPoolExecutor(1) as caller:
        result = caller.submit(network.is_reachable, "127.0.0.1", timeout_s=20, tries=1)
        request, client = camera.recvfrom(1024)
        request_id = int.from_bytes(request[6:8], "big")
        for number in (request_id - 1, request_id):
            camera.sendto(struct.pack(">HHHH", 0, 0x81, 4, number % 0x10000) + bytes(4), client)
        assert result.result()


def test_a_lost_request_is_repeated_with_a_new_id(camera: socket.socket) -> None:
    with ThreadPoolExecutor(1) as caller:
        result = caller.submit(network.is_reachable, "127.0.0.1", timeout_s=0.05, tries=3)
        ids = [camera.recvfrom(1024)[0][6:8] for _ in range(3)]
        assert not result.result()
    assert len(set(ids)) == 3


def test_cameras_that_reply_to_the_broadcast_are_listed_by_address(
    camera: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Replies are sent to the socket that asked; a short one is not a description of a camera."""
    monkeypatch.setattr(network, "local_addresses", lambda: ("127.0.0.1",))
    sent: list[tuple[bytes, tuple[str, int]]] = []

    class Broadcast(socket.socket):
        def sendto(self, datagram: bytes, address: tuple[str, int]) -> int:  # type: ignore[override]
            sent.append((datagram, address))
            header = struct.pack(">HHHH", 0, 0x0003, 0xF8, int.from_bytes(datagram[6:8], "big"))
            for last, serial in ((10, b"S2"), (9, b"S1"), (9, b"S1")):
                registers = bytearray(0xF8)
                registers[0x24:0x28] = bytes([10, 0, 0, last])
                registers[0xD8 : 0xD8 + len(serial)] = serial
                camera.sendto(header + registers, self.getsockname())
            camera.sendto(header + bytes(20), self.getsockname())
            return len(datagram)

    monkeypatch.setattr(socket, "socket", Broadcast)
    found = network.discover(wait_s=0.1)
    assert found == (network.FoundCamera("S1", "10.0.0.9"), network.FoundCamera("S2", "10.0.0.10"))
    ((datagram, (address, _)),) = sent
    assert (datagram[:6], address) == (bytes.fromhex("42 01 0002 0000"), "255.255.255.255")
