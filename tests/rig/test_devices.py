"""All devices of a rig, the files of its station, and injected faults."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import pytest

from tests.rig.known_boards import known_board
from vaoi_station.config import StationConfig, read_config
from vaoi_station.errors import DeviceError
from vaoi_station.rig import devices as assembly
from vaoi_station.rig.devices import (
    DeviceRecovery,
    Devices,
    FaultInjector,
    build_site,
    prepare_boards,
)
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


ADDRESSES = ("127.0.0.2", "127.0.0.3")


@pytest.fixture
def config(small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path) -> StationConfig:
    return site_of(small, boards[0], tmp_path)


def site_of(scenario: Scenario, board: RenderedBoard, folder: Path) -> StationConfig:
    path = build_site(scenario, board, folder, name="rig-7", addresses=ADDRESSES, port=folder / "trigger", workers=3)
    assert path == folder / "station.toml"
    return read_config(path)


def test_the_station_films_with_the_program_of_the_scenario(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path
) -> None:
    scenario = Scenario.model_validate({**small.model_dump(), "program": [{"light": "ring", "on_us": 80.0}]})
    config = site_of(scenario, boards[0], tmp_path)
    assert (config.program, config.controller.order) == (scenario.program, ())


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE) as process:
        yield process
        process.kill()


def test_a_stopped_station_excuses_no_lost_frame(process: subprocess.Popen[bytes]) -> None:
    with FaultInjector([parse_fault("stall:board=0,row=0,for_s=0.01")]) as injector:
        injector.attach(cast("Devices", None), lambda: {"station": process.pid})
        injector.on_row(0, 0)
        injector.on_row(0, 0)
        injector.finish()
    assert injector.outages == []
    assert [type(back) for back in injector.recoveries] == [DeviceRecovery]
    assert injector.failed == []
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == -signal.SIGTERM


def test_a_fault_that_never_happened_is_reported() -> None:
    with FaultInjector([parse_fault("reset:board=2,row=99"), parse_fault("loss")]) as injector:
        injector.finish()
    assert injector.failed == ["reset did not happen: board 2 had no row 99"]
