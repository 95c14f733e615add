"""Run commands as a shell does, on a small recording."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from vaoi_station import open_recording
from vaoi_station.cli import main
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


@dataclass(frozen=True)
class Result:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


@pytest.fixture
def vaoi(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """A function that runs `vaoi …` in this process."""

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["vaoi", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        code = ended.value.code
        out, err = capsys.readouterr()
        return Result(code if isinstance(code, int) else 0, out, err)

    return run


@pytest.fixture(scope="session")
def small_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A board of the small scenario without its truth; tests do not change it."""
    directory = tmp_path_factory.mktemp("small")
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), directory, with_truth=False)
    return directory


@pytest.fixture(scope="session")
def result(small_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of the small recording."""
    out = tmp_path_factory.mktemp("result") / "result.json"
    open_recording(small_recording).stitch().save(out)
    return out


@pytest.fixture
def recording(small_recording: Path, tmp_path: Path) -> Path:
    """A copy of the small recording, which a test may change."""
    return Path(shutil.copytree(small_recording, tmp_path / "recording"))


@pytest.fixture(scope="session")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording with its truth, and its result."""
    from typer.testing import CliRunner

    from vaoi_station.cli import app

    folder = tmp_path_factory.mktemp("small")
    for command in (
        ["simulate", "small", "--out", str(folder / "run")],
        ["stitch", str(folder / "run"), "--out", str(folder / "result.json")],
    ):
        assert CliRunner().invoke(app, command).exit_code == 0
    return folder / "run", folder / "result.json"
