"""Arithmetic of packets, and queries of the network of this machine."""

from __future__ import annotations

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.cameras.aravis import network
from vaoi_station.acquisition.cameras.aravis.network import PacketLimits
from vaoi_station.errors import DeviceError, InputError


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
    most = min(wanted or network.LARGEST_PACKET, mtu, largest)
    if most < smallest:
        with pytest.raises(InputError, match="packet_bytes is"):
            network.packet_bytes(wanted, mtu, PacketLimits(smallest, largest, step))
        return
    size = network.packet_bytes(wanted, mtu, PacketLimits(smallest, largest, step))
    assert smallest <= size <= most < size + step
    assert (size - smallest) % step == 0


@given(st.integers(1000, 10**8), st.integers(576, 9000), st.integers(1, 24), st.floats(100, 1e5))
def test_cameras_of_a_port_fill_it_and_no_more(payload: int, packet: int, cameras: int, link: float) -> None:
    """A packet and its gap take as long as one packet of each camera: all together are as fast as the wire."""
    on_wire_ns = (packet + network.ETHERNET_OVERHEAD) * 8000 / link
    gap_ns = network.packet_delay_ns(packet, cameras, link)
    rounding_ns = 1e-9 * cameras * on_wire_ns
    assert -rounding_ns <= on_wire_ns + gap_ns - cameras * on_wire_ns <= 1 + rounding_ns
    packets = network.packets_per_frame(payload, packet)
    assert (packets - 1) * (packet - network.GVSP_OVERHEAD) < payload <= packets * (packet - network.GVSP_OVERHEAD)
    assert network.transfer_s(payload, packet, cameras, link) == pytest.approx(packets * cameras * on_wire_ns * 1e-9)


def test_a_port_that_cannot_carry_a_row_is_refused_with_the_numbers() -> None:
    frame = 1392 * 1040
    network.check_budget("eth1", [frame] * 4, 9000, 1000.0, 0.124)
    network.check_budget("lo", [frame] * 12, 9000, None, 0.001)
    with pytest.raises(
        DeviceError, match=r"12 cameras on port eth1 need 140\.6 ms for a row at 1000 Mbit/s, .*123\.8 ms"
    ):
        network.check_budget("eth1", [frame] * 12, 9000, 1000.0, 0.1238)


def test_two_ports_in_one_network_are_told_apart_by_their_address_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, other = (int.from_bytes(socket.inet_aton(a), "big") for a in ("10.9.0.1", "10.9.0.2", "10.8.0.1"))
    mask = 0xFFFFFF00
    ports = [
        network._Port("eth0", first, mask),
        network._Port("eth1", second, mask),
        network._Port("eth2", other, mask),
    ]
    monkeypatch.setattr(network, "_ports", lambda: ports)
    assert [network.interface_of(f"10.9.0.{k}") for k in (1, 2, 7)] == ["eth0", "eth1", "eth0"]
    assert network.interface_of("10.7.0.1") == "10.7.0.1"
    assert network.route_trouble("10.9.0.7").startswith("the ports eth0, eth1 of this computer are in the network of")
    assert network.route_trouble("10.8.0.7") == ""
    assert network.route_trouble("10.7.0.7") == (
        "no network port of this computer has an address in the network of 10.7.0.7"
    )
    assert network.route_trouble("Vendor-1234") == "", "a USB camera has no route"


def test_loopback_takes_large_packets_and_has_no_speed() -> None:
    assert network.mtu_to("127.0.0.1") >= 1500
    assert network.interface_of("127.0.0.1") == "lo"
    assert "127.0.0.1" in network.local_addresses()
    assert network.route_trouble("127.0.0.9") == ""
    assert network.interface_of("127.3.4.5") == "lo"
    assert network.interface_of("203.0.113.9") == "203.0.113.9"
    assert network.link_mbit_s("lo") is None
    assert network.packet_delay_ns(9000, 12, None) == 0


def test_a_socket_is_found_by_its_port_and_the_granted_size_is_returned() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        port = ours.getsockname()[1]
        before = ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        granted = network.widen_receive_buffer(port, 150_000)
        assert granted == ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2 == 150_000 != before // 2
        assert network.widen_receive_buffer(port, 2**30) < 2**30
    assert network.widen_receive_buffer(port, 150_000) == 0
