"""The process of a virtual camera and its commands."""

from __future__ import annotations

import queue
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError
from vaoi_station.rig.camera_process import DARK, CameraProcess, TriggerCommand

TIMEOUT_S = 20.0
Install = Callable[[str], None]
CAMERA = """
print("ready", sys.argv[3], flush=True)
for number, line in enumerate(sys.stdin):
    log.write(line)
    log.flush()
    word, *rest = line.split()
    if word == "fire" and int(rest[0]) < 0:
        print("ignored", rest[0], flush=True)
    elif word == "fire":
        print("sent", rest[0], 65400 + number, flush=True)
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The lines that the program has received."""
    return tmp_path / "log"


@pytest.fixture
def install(tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Use a program in place of the camera."""

    def write(program: str) -> None:
        path = tmp_path / "camera"
        head = f"#!{sys.executable}\nimport sys\nlog = open({str(log)!r}, 'a')\n"
        path.write_text(head + textwrap.dedent(program))
        path.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(path))

    return write


def running(camera: CameraProcess) -> int:
    """The process id; 0: no process runs."""
    return camera.pid or 0


def test_triggers_are_reported_with_picture_and_frame_id(install: Install) -> None:
    install(CAMERA)
    reports: queue.Queue[tuple[str, int, int]] = queue.Queue()
    with CameraProcess("127.0.0.2", "A", lambda *report: reports.put(report)) as camera:
        assert running(camera)
        assert camera.trigger(TriggerCommand(5))
        assert camera.trigger(TriggerCommand(DARK))
        assert reports.get(timeout=TIMEOUT_S) == ("sent", 5, 65400)
        assert reports.get(timeout=TIMEOUT_S) == ("ignored", DARK, 0)
    assert not running(camera)


def test_a_killed_camera_takes_no_trigger_and_has_its_frames_again_after_a_restart(install: Install, log: Path) -> None:
    install(CAMERA)
    with CameraProcess("127.0.0.2", "A") as camera:
        camera.select_frames(Path("/frames/board.raw"))
        first = running(camera)
        camera.kill()
        camera.kill()
        assert not running(camera)
        assert not camera.trigger(TriggerCommand(1))
        camera.start()
        camera.wait_ready()
        assert running(camera) not in (0, first)
        assert camera.trigger(TriggerCommand(2))
    assert [line for line in log.read_text().splitlines() if line.startswith("fire")] == [TriggerCommand(2).to_line()]
    assert log.read_text().splitlines()[-2] == "film /frames/board.raw"


def test_a_camera_that_does_not_start_is_refused_with_its_last_words(install: Install) -> None:
    install("sys.exit('no camera can be served at 127.0.0.2')")
    camera = CameraProcess("127.0.0.2", "A")
    with pytest.raises(DeviceError, match=r"at 127\.0\.0\.2 does not start\. no camera can be served"), camera:
        pass
    assert not running(camera)
