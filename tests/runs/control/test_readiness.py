"""Cameras that are not connected: reasons, changes, and the refusal to arm."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.process.messages import Health
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.runs.control import readiness


def camera(name: str) -> CameraConfig:
    return CameraConfig(name=name, backend="aravis", address="127.0.0.2", width=64, height=48, exposure_us=100.0)


CAMERAS = [camera("left"), camera("right")]


def health(*connected: bool) -> Health:
    return Health(tuple(CameraHealth(c, "" if c else "cable pulled") for c in connected), "fine", 1.0)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("camera 0", "Camera 0 is not connected. There is no camera at 127.0.0.2."),
        ("Camera A", "Camera A is not connected. There is no camera at 127.0.0.2."),
        ("left", "Camera left is not connected. There is no camera at 127.0.0.2."),
    ],
)
def test_a_camera_is_named_once(name: str, expected: str) -> None:
    label = camera(name).label
    assert readiness.not_connected(label, f"{label}: there is no camera at 127.0.0.2.") == expected
    assert readiness.not_connected(label, "") == expected[: expected.index(".") + 1]


def test_without_a_health_report_no_camera_counts_as_lost() -> None:
    assert readiness.disconnected(None) == ()
    assert readiness.reasons(None, CAMERAS) == ()
    readiness.require(None, CAMERAS)


def test_every_disconnected_camera_has_a_reason_with_an_action() -> None:
    assert readiness.disconnected(health(False, True)) == (0,)
    both = readiness.reasons(health(False, False), CAMERAS)
    assert [r.message for r in both] == [f"Camera {n} is not connected. Cable pulled" for n in ("left", "right")]
    assert all(r.code == "camera-lost" and r.action for r in both)


def test_arming_is_refused_with_the_names_and_the_way_to_allow_it() -> None:
    readiness.require(health(True, True), CAMERAS)
    with pytest.raises(DeviceError, match=r"Camera left is not connected.*Camera right is not connected") as refusal:
        readiness.require(health(False, False), CAMERAS)
    assert refusal.value.code == "camera-lost"
    assert "allow_lost_cameras" in refusal.value.action


def test_only_changes_are_reported() -> None:
    lost = ("Camera right is lost: boards would be filmed without it.",)
    assert readiness.changes(None, health(True, False), CAMERAS) == lost
    assert readiness.changes(health(True, False), health(True, False), CAMERAS) == ()
    swapped = readiness.changes(health(True, False), health(False, True), CAMERAS)
    assert swapped == ("Camera left is lost: boards would be filmed without it.", "Camera right is ready again.")
