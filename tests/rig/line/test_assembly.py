"""Devices start and end together; boards are rendered once for all passages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.rig.known_boards import known_board
from vaoi_station.errors import DeviceError
from vaoi_station.rig import devices as assembly
from vaoi_station.rig.devices import TERMINAL, Devices, prepare_boards
from vaoi_station.rig.faults import parse_fault
from vaoi_station.rig.rendering import FrameRequest, RenderedBoard
from vaoi_station.simulation import Scenario


class Scripted:
    """Stand-ins for all devices; they record their starts and ends in one list."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fails: str = "") -> None:
        self.log: list[str] = []
        self.reports: dict[str, Any] = {}
        scripted = self

        class Device:
            def __init__(self, *arguments: Any) -> None:
                self.name = type(self).__name__
                if self.name == "Camera":
                    self.name, scripted.reports[arguments[1]] = f"camera {arguments[0]}", arguments[2]

            def start(self) -> None:
                scripted.step(f"start {self.name}")

            def wait_ready(self) -> None:
                scripted.step(f"wait {self.name}", fails)

            def stop(self) -> None:
                scripted.step(f"stop {self.name}")

            def __enter__(self) -> Device:
                scripted.step(f"start {self.name}", fails)
                return self

            def __exit__(self, *_: object) -> None:
                self.stop()

        class Addresses(Device): ...

        class Camera(Device): ...

        class Chip(Device): ...

        class Renderer(Device):
            def render(self, request: FrameRequest) -> Path:
                scripted.step(f"render {request.board}")
                return Path("late.raw")

            close = Device.stop

        for name, stand_in in {
            "LoopbackAddresses": Addresses, "CameraProcess": Camera, "Chip": Chip, "FrameRenderer": Renderer,
            "build": lambda folder: folder,
        }.items():  # fmt: skip
            monkeypatch.setattr(assembly, name, stand_in)

    def step(self, name: str, fails: str = "") -> None:
        self.log.append(name)
        if fails and fails in name:
            raise DeviceError(f"{name} fails.")


def test_devices_end_in_the_reverse_order_of_their_start(
    small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripted = Scripted(monkeypatch)
    with Devices(small, tmp_path) as devices:
        assert devices.addresses == ("127.0.0.2", "127.0.0.3")
        assert devices.terminal == tmp_path / TERMINAL
        assert len(devices.cameras) == 2
        started = [step for step in scripted.log if step.startswith("start")]
        scripted.log.clear()
    assert started == ["start Addresses", "start camera 127.0.0.2", "start camera 127.0.0.3", "start Chip"]
    assert scripted.log == [
        "stop Chip", "stop Renderer", "stop camera 127.0.0.3", "stop camera 127.0.0.2", "stop Addresses",
    ]  # fmt: skip


def test_all_cameras_start_before_the_first_is_waited_for(
    small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripted = Scripted(monkeypatch)
    with Devices(small, tmp_path):
        first_wait = scripted.log.index("wait camera 127.0.0.2")
        assert scripted.log.index("start camera 127.0.0.3") < first_wait


@pytest.mark.parametrize("fails", ["start Addresses", "wait camera 127.0.0.3", "start Chip"])
def test_a_device_that_fails_takes_the_others_down(
    small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    scripted = Scripted(monkeypatch, fails)
    with pytest.raises(DeviceError, match=f"{fails} fails"), Devices(small, tmp_path):
        pass
    started = {step.removeprefix("start ") for step in scripted.log if step.startswith("start")}
    stopped = {step.removeprefix("stop ") for step in scripted.log if step.startswith("stop")}
    failed = fails.split(" ", 1)[1] if fails.startswith("start") else ""
    assert stopped - {"Renderer"} == started - {failed}


def test_reports_of_cameras_reach_the_line_with_their_number(
    small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripted = Scripted(monkeypatch)
    with Devices(small, tmp_path) as devices:
        reports: list[tuple[int, str, int]] = []
        monkeypatch.setattr(devices.line, "on_camera_report", lambda *report: reports.append(report))
        scripted.reports["VAOI-01"]("sent", 4, 65400)
    assert reports == [(1, "sent", 4)]


def test_the_calibration_board_is_rendered_on_request(
    small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripted = Scripted(monkeypatch)
    with Devices(small, tmp_path) as devices:
        devices.lay_calibration_board()
    assert "render None" in scripted.log


@pytest.mark.parametrize(
    ("faults", "boards", "different", "expected"),
    [
        ((), 5, 2, [0, 1, 0, 1, 0]),
        ((), 2, 3, [0, 1]),
        (("stuck:board=3",), 5, 2, [0, 1, 0, 3, 0]),
        (("bounce:board=2", "kill:board=3"), 5, 2, [0, 1, 2, 1, 0]),
    ],
)
def test_boards_pass_in_turn_and_those_with_faults_of_the_belt_only_once(
    small: Scenario,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    faults: tuple[str, ...],
    boards: int,
    different: int,
    expected: list[int],
) -> None:
    rendered: list[list[int]] = []

    def render(_: Scenario, numbers: Sequence[int], directory: Path, progress: Any) -> tuple[RenderedBoard, ...]:
        rendered.append(list(numbers))
        progress("rendering")
        return tuple(known_board(directory / str(n), n) for n in numbers)

    monkeypatch.setattr(assembly, "render_boards", render)
    lines: list[str] = []
    found = prepare_boards(small, [parse_fault(f) for f in faults], boards, different, tmp_path, lines.append)
    assert [board.metadata.board for board in found] == expected
    assert rendered == [sorted(set(expected))]
    assert lines == ["rendering"]
