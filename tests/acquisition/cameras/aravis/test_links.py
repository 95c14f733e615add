"""Speeds that cameras state in their own names and units, limits that they keep, and whether a row fits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import Node, StandInCamera, camera_config
from vaoi_station.acquisition.cameras.aravis import links, network
from vaoi_station.acquisition.cameras.aravis.discovery import free_address, usb_cameras
from vaoi_station.acquisition.cameras.aravis.features import Features
from vaoi_station.acquisition.cameras.aravis.network import Control
from vaoi_station.doctor import camera_checks
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.optics import Requirements, make_plan
from vaoi_station.optics.links import USB_PAYLOAD, Link
from vaoi_station.optics.report import PAPER

pytestmark = pytest.mark.usefixtures("_stand_in")


def camera(unit: str | None = None, **features: Any) -> StandInCamera:
    """Return a camera of whose numbers the description states a unit."""
    made = StandInCamera(is_gige=True)
    made.device.features |= features
    stated = made.device.get_feature

    def get_feature(name: str) -> Node | None:
        node = stated(name)
        if node is not None:
            node.unit = unit
        return node

    made.device.get_feature = get_feature  # type: ignore[method-assign, assignment]
    return made


@pytest.mark.parametrize(
    ("unit", "features", "mbit_s"),
    [
        (None, {"GevLinkSpeed": 1000}, 1000.0),  # Basler acA1300: "in Mbps", no unit
        (None, {"DeviceLinkSpeed": 1_250_000_000}, 10_000.0),  # SFNC: bytes per second
        ("MBps", {"DeviceLinkSpeed": 312.5}, 2500.0),  # ViewWorks VNP-604
        (None, {"DeviceLinkSpeed": 125_000_000, "GevLinkSpeed": 1000}, 1000.0),
        (None, {"DeviceLinkSpeed": 1_000_000_000}, 1000.0),  # bits, where SFNC has bytes
        (None, {"DeviceLinkSpeed": 12345}, None),
        (None, {}, None),
    ],
)
def test_the_speed_of_a_link_is_read_in_the_makers_unit(
    monkeypatch: pytest.MonkeyPatch, unit: str | None, features: dict[str, Any], mbit_s: float | None
) -> None:
    monkeypatch.setattr(network, "camera_link_mbit_s", lambda _address: None)
    assert links.speed_mbit_s(Features(camera(unit, **features)), "10.0.0.1") == mbit_s


def limited(made: StandInCamera, low: int, high: int) -> StandInCamera:
    """Give a camera bounds of its limits, and the entries of their mode."""
    made.device.bounds |= dict.fromkeys(("DeviceLinkThroughputLimit", "StreamBytesPerSecond"), (low, high))
    made.device.entries["DeviceLinkThroughputLimitMode"] = ("Off", "On")
    return made


def test_a_limit_is_lifted_where_pauses_pace_the_camera() -> None:
    off = camera(DeviceLinkThroughputLimit=10_000_000, DeviceLinkThroughputLimitMode="On")
    assert links.limit_throughput(Features(off), None) is None
    assert off.device.features["DeviceLinkThroughputLimitMode"] == "Off"
    always = limited(camera(DeviceLinkThroughputLimit=10_000_000), 1_000_000, 125_000_000)
    assert links.limit_throughput(Features(always), None) == 1000.0
    assert links.limit_throughput(Features(camera()), None) is None


def test_a_camera_without_pauses_is_limited_to_its_share() -> None:
    usb = camera(DeviceLinkThroughputLimit=380_000_000, DeviceLinkThroughputLimitMode="Off")
    assert links.limit_throughput(Features(limited(usb, 1_000_000, 380_000_000)), 800.0) == 800.0
    assert usb.device.features["DeviceLinkThroughputLimitMode"] == "On"
    assert usb.device.features["DeviceLinkThroughputLimit"] == 100_000_000
    old = limited(camera(StreamBytesPerSecond=115_000_000), 1_000_000, 124_000_000)  # Prosilica GC
    assert links.limit_throughput(Features(old), 400.0) == 400.0
    mega = limited(camera("MBps", DeviceLinkThroughputLimit=300.0), 10, 312)  # ViewWorks VNP-604
    assert links.limit_throughput(Features(mega), 400.0) == 400.0
    assert mega.device.features["DeviceLinkThroughputLimit"] == 50.0
    stubborn = limited(camera(StreamBytesPerSecond=2_000_000), 1_000_000, 124_000_000)
    stubborn.device.ignored.add("StreamBytesPerSecond")
    assert links.limit_throughput(Features(stubborn), 400.0) == 16.0, "what it keeps is what counts"


@pytest.mark.parametrize(
    ("delay_ns", "tick_hz", "ticks"),
    [(0, 0, 0), (1000, 0, None), (1000, 125_000_000, 125), (1001, 125_000_000, 126), (9000, 125_000_000, None)],
)
def test_a_pause_is_set_in_ticks_of_the_camera_if_it_can_be_as_long(
    delay_ns: int, tick_hz: int, ticks: int | None
) -> None:
    made = camera()
    made.device.bounds["GevSCPD"] = (0, 1000)
    assert links.pause_ticks(Features(made), delay_ns, tick_hz) == ticks


@pytest.mark.parametrize(
    ("stated", "taken"),
    [
        ((220, 9000, 4), (220, 9000, 4)),
        ((0, 9973, 0), (29, 9973, 1)),
        ((0, 0, 1), (576, 9000, 4)),
        (None, (576, 9000, 4)),
    ],
)
def test_limits_of_packets_that_no_camera_can_mean_are_not_taken(
    stated: tuple[float, float, float] | None, taken: tuple[int, int, int]
) -> None:
    assert network.PacketLimits.stated(stated) == network.PacketLimits(*taken)


def test_usb_cameras_are_found_under_their_controller(tmp_path: Path) -> None:
    """As sysfs has them: links to directories below the controller and its root hub."""
    for number, (place, speed) in enumerate((("2-1/2-1.3", "5000"), ("2-4", "5000"))):
        camera = tmp_path / "pci0000:00/0000:00:14.0/usb2" / place
        camera.mkdir(parents=True)
        for path in (camera, *camera.parents):
            if path.name.startswith(("usb", "2-")):
                (path / "speed").write_text("10000\n" if path.name == "usb2" else f"{speed}\n")
        (camera / "serial").write_text(f"S{number}\n")
        (tmp_path / "devices").mkdir(exist_ok=True)
        (tmp_path / "devices" / camera.name).symlink_to(camera)
    names = [[link.name for link in links.usb_path(serial, tmp_path / "devices")] for serial in ("S0", "S1", "S2")]
    controller = "USB controller 0000:00:14.0"
    assert names == [["USB device 2-1.3", "USB device 2-1", controller], ["USB device 2-4", controller], []]
    assert links.usb_path("S1", tmp_path / "devices")[-1] == Link(controller, 10_000 * USB_PAYLOAD)


def test_usb_cameras_are_listed_by_maker_model_and_serial_number(tmp_path: Path) -> None:
    """As sysfs has them: a camera, which a program uses, another one, and a hub."""
    (tmp_path / "drivers/usbfs").mkdir(parents=True)
    for place, subclass, texts in (
        ("2-4", "05", {"manufacturer": "FLIR", "product": "Blackfly S BFS-U3-51S5M", "serial": "0137"}),
        ("2-3", "05", {"manufacturer": "Basler", "product": "acA2440-75um", "serial": "21"}),
        ("2-1", "00", {"product": "Hub"}),
    ):
        interface = tmp_path / f"{place}:1.0"
        interface.mkdir()
        (tmp_path / place).mkdir()
        for name, text in {"Class": "ef", "SubClass": subclass, "Protocol": "00"}.items():
            (interface / f"bInterface{name}").write_text(f"{text}\n")
        for name, text in texts.items():
            (tmp_path / place / name).write_text(f"{text}\n")
    (tmp_path / "2-4:1.0/driver").symlink_to(tmp_path / "drivers/usbfs")
    free, used = usb_cameras(tmp_path)
    assert (free.maker, free.model, free.serial, free.interface) == ("Basler", "acA2440-75um", "21", "USB 2-3")
    assert (free.control, used.serial, used.control) == (Control.FREE, "0137", Control.CONTROLLED)
    with pytest.raises(InputError, match="camera 21: is a USB camera, which has no address"):
        free_address(free, (), ())


def test_a_row_that_does_not_fit_is_refused_with_the_numbers() -> None:
    config = camera_config(width=1392, height=1040, link_mbit_s=1000.0)
    few, many = ([links.sender_of(config, "eth1", None, 9000)] * count for count in (4, 12))
    assert links.check_row(few, 0.124) == pytest.approx(0.0469, abs=1e-4)
    with pytest.raises(DeviceError, match=r"12 cameras on port eth1 need 140\.6 ms for a row at 1000 Mbit/s, .*123\.8"):
        links.check_row(many, 0.1238)
    slow = links.sender_of(config, "eth1", 50.0, 9000)
    with pytest.raises(DeviceError, match=r"the cameras themselves need 234\.3 ms for a row at 50 Mbit/s"):
        links.check_row([slow], 0.1238)


@pytest.mark.parametrize(
    ("own_mbit_s", "port_mbit_s", "packet"), [(1000.0, 10_000.0, 9000), (1000.0, 10_000.0, 1500), (None, 1000.0, 9000)]
)
def test_plan_doctor_and_station_agree_on_the_time_of_a_row(
    own_mbit_s: float | None, port_mbit_s: float, packet: int
) -> None:
    config = camera_config(width=1392, height=1040, link_mbit_s=port_mbit_s, packet_bytes=packet)
    station_s = links.check_row([links.sender_of(config, "lo", own_mbit_s, packet)] * 12, 1.0)
    limits = network.PacketLimits(packet % 4, 16_000, 4)
    offered = camera_checks.Offered(
        vendor="Maker", model="M", serial="1", triggers=(), sources=(), formats=(), exposure_us=(1.0, 2.0),
        sensor=(1, 1), trigger_mode="Off", port="lo", address="127.0.0.1", packets=limits, passing=packet,
        speed_mbit_s=own_mbit_s,
    )  # fmt: skip
    finding = camera_checks.judge_port("lo", [(config, offered)] * 12, 1.0)
    plan = make_plan(
        Requirements(
            **vars(PAPER) | {"link_mbit_s": port_mbit_s, "camera_link_mbit_s": own_mbit_s, "packet_bytes": packet}
        )
    )
    assert plan.data.row_transfer_s == station_s
    assert finding.figures["row_ms"] == pytest.approx(station_s * 1e3, abs=1e-3)
