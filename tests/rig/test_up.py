"""`vaoi rig up` with scripted devices: what it prints, and how it ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.config import read_config
from vaoi_station.errors import DeviceError
from vaoi_station.rig import run as up
from vaoi_station.rig.faults import Fault, parse_fault
from vaoi_station.rig.network import NAMESPACE_VARIABLE
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.run import run_until_interrupted
from vaoi_station.simulation import Scenario

COMMANDS: list[str] = []
"""What the scripted devices were asked for, in order."""


class ScriptedDevices:
    """Devices whose chip ends at once, and whose line fails after some boards."""

    passes = 3

    def __init__(self, scenario: Scenario, folder: Path, frame_faults: Any, on_row: Callable[[int, int], None]) -> None:
        self.addresses = tuple(f"127.0.0.{n + 2}" for n in range(scenario.array.cameras))
        self.cameras, self.terminal = self.addresses, folder / "trigger"
        self.chip = SimpleNamespace(alive=False, send=COMMANDS.append)
        self.line = self

    def __enter__(self) -> ScriptedDevices:
        return self

    def __exit__(self, *_: object) -> None:
        COMMANDS.append("closed")

    def lay_calibration_board(self) -> None:
        COMMANDS.append("calibration board")

    def start_passage(self, rendered: RenderedBoard) -> Any:
        if COMMANDS.count("board") == self.passes:
            raise DeviceError("the emulated chip has ended.")
        COMMANDS.append("board")
        return SimpleNamespace()


@pytest.fixture
def start(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[str]]:
    """Run until the scripted end; the printed lines."""
    COMMANDS.clear()
    short = [SimpleNamespace(**{n: getattr(boards[0], n) for n in ("calibration", "board_type")}, duration_s=0.0)]
    monkeypatch.setattr(up, "Devices", ScriptedDevices)
    monkeypatch.setattr(up, "prepare_boards", lambda *_: short)
    monkeypatch.setattr(up, "min_interval_s", lambda *_: 0.0)
    monkeypatch.setattr("vaoi_station.rig.line.FEED_MARGIN_S", 0.0)

    def run(*faults: Fault, still: bool = False) -> list[str]:
        lines: list[str] = []
        with pytest.raises(DeviceError, match="the emulated chip has ended"):
            run_until_interrupted(small, faults, tmp_path, tmp_path / "rendered", 1, lines.append, still=still)
        return lines

    return run


def test_boards_pass_again_and_again_until_the_chip_ends(start: Callable[..., list[str]]) -> None:
    lines = start()
    assert COMMANDS == ["calibration board", "board", "board", "board", "closed"]
    assert lines[-1].startswith("Boards pass")


def test_without_boards_only_the_calibration_board_is_there(start: Callable[..., list[str]]) -> None:
    lines = start(still=True)
    assert COMMANDS == ["calibration board", "closed"]
    assert lines[-1].startswith("No board passes")


def test_the_printed_command_starts_a_station_that_can_be_read(
    start: Callable[..., list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NAMESPACE_VARIABLE, "")
    lines = start(still=True)
    assert f"Start the station: vaoi serve --config {tmp_path / 'station.toml'}" in lines
    assert f"2 cameras at 127.0.0.2 …, the controller at {tmp_path / 'trigger'}." in lines
    assert read_config(tmp_path / "station.toml").name == "rig"


def test_noise_is_injected_from_the_start(start: Callable[..., list[str]]) -> None:
    start(parse_fault("noise:share=0.25"), still=True)
    assert COMMANDS[0] == "noise 0.25 0.25"
