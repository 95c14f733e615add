"""Speeds that cameras state in their own names and units, limits that they keep, and whether a row fits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import GcFloat, Node, StandInCamera, camera_config
from vaoi_station.acquisition.cameras.aravis import links, network
from vaoi_station.doctor import camera_checks
from vaoi_station.errors import DeviceError
from vaoi_station.optics import Requirements, make_plan
from vaoi_station.optics.links import USB_PAYLOAD, Link
from vaoi_station.optics.report import PAPER

pytestmark = pytest.mark.usefixtures("_stand_in")


def camera(unit: str | None = None, **features: Any) -> StandInCamera:
    made = StandInCamera(is_gige=True)
    made.device.features |= features

    def get_feature(name: str) -> Node:
        return (GcFloat if isinstance(made.device.features[name], float) else Node)(unit)

    made.device.get_feature = get_feature  # type: ignore[method-assign, assignment]
    return made


@pytest.mark.parametrize(
    ("unit", "features", "mbit_s"),
    [
        (None, {"GevLinkSpeed": 1000}, 1000.0),  # Basler acA1300: "in Mbps", no unit
        ("Bps", {"DeviceLinkSpeed": 1_250_000_000}, 10_000.0),  # SFNC
        ("MBps", {"DeviceLinkSpeed": 312.5}, 2500.0),  # ViewWorks VNP-604
        (None, {"DeviceLinkSpeed": 125_000_000, "GevLinkSpeed": 1000}, 1000.0),
        ("Bps", {"DeviceLinkSpeed": 1_000_000_000}, 1000.0),  # bits, in the unit of bytes
        (None, {"DeviceLinkSpeed": 12345}, None),
        (None, {}, None),
    ],
)
def test_the_speed_of_a_link_is_read_in_the_makers_unit(
    monkeypatch: pytest.MonkeyPatch, unit: str | None, features: dict[str, Any], mbit_s: float | None
) -> None:
    monkeypatch.setattr(network, "camera_link_mbit_s", lambda _address: None)
    assert links.speed_mbit_s(camera(unit, **features), "10.0.0.1") == mbit_s


def test_a_limit_is_lifted_where_pauses_pace_the_camera() -> None:
    off = camera(DeviceLinkThroughputLimit=10_000_000, DeviceLinkThroughputLimitMode="On")
    assert links.limit_throughput(off, None) is None
    assert off.device.features["DeviceLinkThroughputLimitMode"] == "Off"
    always = camera(DeviceLinkThroughputLimit=10_000_000)
    always.device.bounds["DeviceLinkThroughputLimit"] = (1_000_000, 125_000_000)
    assert links.limit_throughput(always, None) == 1000.0
    assert links.limit_throughput(camera(), None) is None


def test_a_camera_without_pauses_is_limited_to_its_share() -> None:
    usb = camera("Bps", DeviceLinkThroughputLimit=380_000_000, DeviceLinkThroughputLimitMode="Off")
    usb.device.bounds["DeviceLinkThroughputLimit"] = (1_000_000, 380_000_000)
    assert links.limit_throughput(usb, 800.0) == 800.0
    assert usb.device.features["DeviceLinkThroughputLimitMode"] == "On"
    assert usb.device.features["DeviceLinkThroughputLimit"] == 100_000_000
    old = camera(StreamBytesPerSecond=115_000_000)  # Prosilica GC
    old.device.bounds["StreamBytesPerSecond"] = (1_000_000, 124_000_000)
    assert links.limit_throughput(old, 400.0) == 400.0
    stubborn = camera(StreamBytesPerSecond=2_000_000)
    stubborn.device.ignored.add("StreamBytesPerSecond")
    assert links.limit_throughput(stubborn, 400.0) == 16.0, "what it keeps is what counts"


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
