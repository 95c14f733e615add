"""`vaoi record` from the outside: files appear whole, refusals come before filming."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError
from vaoi_station.files import open_recording, write_calibration
from vaoi_station.files.documents import write_json
from vaoi_station.simulation import Twin, read_scenario
from vaoi_station.simulation.calibration_board import layout

SCENARIO = """
[array]
cameras = 1
width_px = 96
height_px = 72
px_per_mm = 4.0
[board]
width_mm = 20.0
length_mm = 20.0
density = 0.5
[line]
barrier_mm = -20.0
start_delay_s = 0.12
period_s = 0.05
tail_s = 0.2
longest_board_mm = 22.0
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A station of the tiny twin, as files."""
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    twin = Twin(read_scenario(tmp_path / "scenario.toml"))
    write_calibration(tmp_path / "calibration.json", twin.calibration)
    (tmp_path / "shm").mkdir()
    line = twin.line.model_dump(mode="json", exclude={"expected_board"}, exclude_none=True)
    keys = "\n".join(f"{key} = {json.dumps(value)}" for key, value in line.items())
    path = tmp_path / "station.toml"
    path.write_text(
        f"""name = "record"
calibration = "calibration.json"
board_types = "types"
data = "data"
[line]
{keys}
[[cameras]]
name = "c0"
width = 96
height = 72
exposure_us = 250
[simulation]
scenario = "scenario.toml"
interval_s = 0.01
[ring]
directory = "shm"
"""
    )
    return path


def test_runs_are_kept_with_their_calibration(config: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["record", "--config", str(config), "--out", str(out), "--runs", "2"])
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in out.iterdir()) == ["run-001", "run-002"]
    for run in out.iterdir():
        assert open_recording(run).head.missing == ()
        assert (run / "calibration.json").is_file()
    assert "ended by 'clear'" in done.output


def test_one_run_is_written_to_the_directory_itself_and_never_overwrites(config: Path, tmp_path: Path) -> None:
    out = tmp_path / "one"
    arguments = ["record", "--config", str(config), "--out", str(out)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert open_recording(out).head.rows > 1
    refused = CliRunner().invoke(app, arguments)
    assert isinstance(refused.exception, InputError)
    assert "exists already" in str(refused.exception)


def test_board_at_rest_is_filmed_without_a_calibration(config: Path, tmp_path: Path) -> None:
    """The simulated cameras show the calibration board; what `vaoi calibrate` makes of it lets the station film."""
    twin = Twin(read_scenario(tmp_path / "scenario.toml"))
    keys = f"nominal_px_per_mm = {twin.scenario.array.px_per_mm}\nnominal_center_mm = [0.0, 0.0]\n"
    config.write_text(config.read_text().replace("exposure_us = 250\n", f"exposure_us = 250\n{keys}"))
    (tmp_path / "calibration.json").unlink()
    out = tmp_path / "still"
    refused = CliRunner().invoke(app, ["record", "--config", str(config), "--out", str(out)])
    assert "calibration.json: there is no such file" in str(refused.exception)
    done = CliRunner().invoke(app, ["record", "--config", str(config), "--out", str(out), "--still"])
    assert done.exit_code == 0, done.output
    assert "1 rows, 1 of 1 frames, ended by 'single'" in done.output
    assert not (out / "calibration.json").exists()
    write_json(out / "layout.json", layout(twin))
    made = CliRunner().invoke(app, ["calibrate", str(out), "--out", str(tmp_path / "calibration.json")])
    assert made.exit_code == 0, made.output
    again = CliRunner().invoke(app, ["record", "--config", str(config), "--out", str(tmp_path / "run")])
    assert again.exit_code == 0, again.output


def test_several_pictures_at_rest_keep_the_present_calibration(config: Path, tmp_path: Path) -> None:
    arguments = ["record", "--config", str(config), "--out", str(tmp_path / "out"), "--runs", "2", "--still"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    for name in ("run-001", "run-002"):
        assert open_recording(tmp_path / "out" / name).head.rows == 1
        assert (tmp_path / "out" / name / "calibration.json").is_file()
