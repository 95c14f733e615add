"""What a status page says of cameras that are away."""

from __future__ import annotations

import pytest

from vaoi_station.config import CameraConfig
from vaoi_station.runs.readiness import not_connected


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("camera 0", "Camera 0 is not connected. There is no camera at 127.0.0.2."),
        ("Camera A", "Camera A is not connected. There is no camera at 127.0.0.2."),
        ("left", "Camera left is not connected. There is no camera at 127.0.0.2."),
    ],
)
def test_a_camera_is_named_once(name: str, told: str) -> None:
    camera = CameraConfig(name=name, backend="aravis", address="127.0.0.2", width=64, height=48, exposure_us=100.0)
    assert not_connected(camera.called, f"{camera.called}: there is no camera at 127.0.0.2.") == told
    assert not_connected(camera.called, "") == told[: told.index(".") + 1]
