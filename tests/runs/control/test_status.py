"""What a status page says of cameras that are away, and of workers that are not there yet."""

from __future__ import annotations

import pytest

from vaoi_station.config import CameraConfig
from vaoi_station.runs.control.readiness import not_connected
from vaoi_station.runs.control.status import worker_warnings
from vaoi_station.runs.states.schemas import STARTING, WAITING, ProcessStatus


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
    assert not_connected(camera.label, f"{camera.label}: there is no camera at 127.0.0.2.") == told
    assert not_connected(camera.label, "") == told[: told.index(".") + 1]


def test_workers_that_are_not_there_yet_are_a_warning() -> None:
    def process(name: str, doing: str) -> ProcessStatus:
        return ProcessStatus(name=name, pid=1, alive=True, restarts=0, heartbeat_age_s=None, doing=doing)

    assert worker_warnings((process("acquisition", STARTING), process("worker 0", "idle"))) == ()
    [warning] = worker_warnings((process("worker 0", "rows of (0, 0)"), process("worker 1", STARTING)))
    assert warning.code == "workers-starting"
    assert warning.message == "Results of boards that pass meanwhile come late: 1 of 2 workers is still starting."
    [warning] = worker_warnings(
        (process("acquisition", WAITING), process("worker 0", STARTING), process("worker 1", STARTING))
    )
    assert warning.message == "Cameras are not opened yet: 2 of 2 workers are still starting."
