from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import open_recording, read_board_type, read_calibration


def _run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["simulate", *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_recording_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "board"
    said = _run("small", "--out", str(out), "--board", "1")
    recording = open_recording(out)
    assert "2 cameras × 6 rows" in said
    assert recording.head.rows == 6
    assert read_calibration(out / "calibration.json", 2).working_distance_mm == 300
    assert read_board_type(out / "board.json").component("U1") is not None
    assert (out / "truth.json").exists()
    with pytest.raises(InputError, match="already holds"):
        _run("small", "--out", str(out))


def test_missing_frames_are_listed_and_the_truth_is_optional(tmp_path: Path) -> None:
    scenario = tmp_path / "lossy.toml"
    scenario.write_text(
        "[array]\nwidth_px = 64\nheight_px = 48\npx_per_mm = 4.0\n"
        "[board]\nwidth_mm = 30.0\nlength_mm = 20.0\n"
        "[line]\nbarrier_mm = -10.0\nstart_delay_s = 0.05\ntail_s = 0.1\n"
        "[[faults.lost_frames]]\ncamera = 1\nrow = 1\n"
    )
    out = tmp_path / "out"
    assert "1 frames missing" in _run(str(scenario), "--out", str(out), "--no-truth")
    assert open_recording(out).head.missing == ((1, 1),)
    assert not (out / "truth.json").exists()


def test_calibration_board(tmp_path: Path) -> None:
    _run("small", "--out", str(tmp_path), "--calibration-board")
    assert open_recording(tmp_path).head.rows == 1
    assert (tmp_path / "layout.json").exists()


def test_unknown_scenario_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no scenario 'nothing'"):
        _run("nothing", "--out", str(tmp_path))
