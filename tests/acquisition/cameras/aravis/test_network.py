"""Requests without control of a camera, packet sizes and delays, the network of this computer."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.network import PacketLimits
from vaoi_station.errors import InputError
from vaoi_station.optics.links import LARGEST_PACKET


@given(
    st.none() | st.integers(576, 65535),
    st.integers(1500, 65536),
    st.integers(220, 600),
    st.integers(1500, 16404),
    st.sampled_from([1, 2, 4, 8, 16]),
)
def test_packets_are_as_large_as_camera_port_and_setting_permit(
    wanted: int | None, mtu: int, smallest: int, largest: int, step: int
) -> None:
    most = min(wanted or LARGEST_PACKET, mtu, largest)
    if most < smallest:
        with pytest.raises(InputError, match="packet_bytes is"):
            network.packet_bytes(wanted, mtu, PacketLimits(smallest, largest, step))
        return
    size = network.packet_bytes(wanted, mtu, PacketLimits(smallest, largest, step))
    assert smallest <= size <= most < size + step
    assert (size - smallest) % step == 0


def test_two_ports_in_one_network_are_told_apart_by_their_address_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, other = (int.from_bytes(socket.inet_aton(a), "big") for a in ("10.9.0.1", "10.9.0.2", "10.8.0.1"))
    mask = 0xFFFFFF00
    ports = [
        network.Port("eth0", first, mask),
        network.Port("eth1", second, mask),
        network.Port("eth2", other, mask),
    ]
    monkeypatch.setattr(network, "ports", lambda: ports)
    assert [network.interface_of(f"10.9.0.{k}") for k in (1, 2, 7)] == ["eth0", "eth1", "eth0"]
    assert network.interface_of("10.7.0.1") == "10.7.0.1"
    assert network.route_trouble("10.9.0.7").startswith("the ports eth0, eth1 of this computer are in the network of")
    assert network.route_trouble("10.8.0.7") == ""
    assert network.route_trouble("10.7.0.7") == (
        "no network port of this computer has an address in the network of 10.7.0.7"
    )
    assert network.route_trouble("Vendor-1234") == "", "a USB camera has no route"


def test_the_port_towards_a_camera_that_never_answered_is_that_of_its_route() -> None:
    assert network.interface_towards("127.0.0.9") == "lo"
    assert network.interface_towards("") == ""
    assert not network.has_link("no-such-port")


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


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A socket in place of a camera; the port of the protocol is its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.settimeout(20)
        camera.bind(("127.0.0.1", 0))
        monkeypatch.setattr(network, "CONTROL_PORT", camera.getsockname()[1])
        yield camera
