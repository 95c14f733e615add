"""The time of a row on the links: the slowest of camera, shared links and port."""

from __future__ import annotations

import pytest

from vaoi_station.optics.links import ITSELF, USB_PAYLOAD, Link, Sender, share_links, slowest_row

FRAME = 1392 * 1040
PACKET_S = 9038 * 8e-9
"""Time of a packet of 9000 bytes on a link of 1 Gbit/s."""


def senders(count: int, own_mbit_s: float | None, *links: Link, frame: int = FRAME) -> list[Sender]:
    return [Sender(frame, links, own_mbit_s)] * count


@pytest.mark.parametrize(
    ("count", "own", "port", "row_ms", "delay_us", "slowest"),
    [
        (3, None, 1000.0, 35.1, 144.6, "port"),
        (12, None, 10_000.0, 14.1, 79.5, "port"),
        (3, 1000.0, 10_000.0, 11.7, 0.0, ITSELF),
        (10, 1000.0, 10_000.0, 11.7, 0.0, ITSELF),
        (12, 1000.0, 10_000.0, 14.1, 14.5, "port"),
        (12, 5000.0, 10_000.0, 14.1, 72.3, "port"),
        (1, 200.0, 1000.0, 58.6, 0.0, ITSELF),
        (4, None, None, 0.0, 0.0, ITSELF),
    ],
)
def test_a_row_takes_as_long_as_the_slowest_of_camera_and_port(
    count: int, own: float | None, port: float | None, row_ms: float, delay_us: float, slowest: str
) -> None:
    share = slowest_row(senders(count, own, Link("port", port)))
    assert (share.row_s * 1e3, share.delay_s * 1e6) == pytest.approx((row_ms, delay_us), abs=0.06)
    assert share.slowest == slowest


def test_a_pause_and_the_packet_itself_are_the_turn_of_all_cameras() -> None:
    """Without the camera's own time in the turn, twelve of them on a fast uplink would need 24 ms instead of 14."""
    share = slowest_row(senders(12, 1000.0, Link("port", 10_000.0)))
    assert share.packet_s == pytest.approx(12 * PACKET_S / 10)
    assert share.delay_s + PACKET_S == pytest.approx(share.packet_s)


def test_cameras_of_several_switches_are_limited_by_their_uplinks() -> None:
    port = Link("port", 10_000.0)
    left, right = (senders(6, 1000.0, Link(name, speed), port) for name, speed in (("A", 2500.0), ("B", 10_000.0)))
    shares = share_links([*left, *right])
    assert [shares[k].slowest for k in (0, 6)] == ["A", "port"]
    assert shares[0].packet_s == pytest.approx(6 * PACKET_S / 2.5)
    assert shares[6].packet_s == pytest.approx(12 * PACKET_S / 10)


def test_links_of_one_name_are_one_as_slow_as_the_lowest_speed_stated() -> None:
    shares = share_links([*senders(2, None, Link("port", None)), *senders(2, None, Link("port", 1000.0))])
    assert [share.packet_s for share in shares] == pytest.approx([4 * PACKET_S] * 4)


def test_usb_cameras_share_their_controller() -> None:
    frame = 5_000_000
    controller = Link("USB controller 0000:00:14.0", 5000 * USB_PAYLOAD)
    share = slowest_row([Sender(frame, (controller,), None, None)] * 4)
    assert share.row_s == pytest.approx(4 * frame * 8e-6 / 3200)
    assert share.mbit_s == pytest.approx(800), "the limit that each of them keeps"


def test_25_megapixels_at_10_gbit_s_need_longer_than_a_period_of_8_hz_from_six_cameras_on() -> None:
    def row_s(count: int) -> float:
        return slowest_row(senders(count, 10_000.0, Link("port", 10_000.0), frame=5120 * 5120)).row_s

    assert row_s(5) < 1 / 8.08 < row_s(6)
