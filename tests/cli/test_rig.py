"""`vaoi rig`: what is refused before anything is started, and the list of faults."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.rig import chip as firmware
from vaoi_station.version import __version__


def refusal(*arguments: str) -> Exception:
    result = CliRunner().invoke(app, ["rig", *arguments])
    assert isinstance(result.exception, Exception), result.output
    return result.exception


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--fault", "flood"), "--fault is 'flood'"),
        (("run", "--cameras", "1", "--fault", "kill:camera=1"), "camera is 1, but must be from 0 to 0"),
        (("run", "--boards", "1", "--fault", "reset"), "board is 1, but must be from 0 to 0"),
    ],
)
def test_impossible_arguments_are_refused_before_the_start(arguments: tuple[str, ...], words: str) -> None:
    error = refusal(*arguments)
    assert isinstance(error, InputError)
    assert words in error.message


@pytest.mark.parametrize("arguments", [("run",), ("up", "--out", "rig")])
def test_missing_firmware_sources_are_refused_before_a_board_is_rendered(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(firmware, "PACKAGED", tmp_path / "packaged")
    monkeypatch.setattr(firmware, "CHECKOUT", tmp_path / "hw" / "firmware")
    error = refusal(*arguments)
    assert isinstance(error, NotFoundError)
    assert "its sources are neither in" in error.message
    assert f"Install version {__version__} again" in error.action
    assert list(tmp_path.iterdir()) == []
