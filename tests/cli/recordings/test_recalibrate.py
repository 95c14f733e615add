"""`vaoi recalibrate`, from recordings and from a station's database."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.drift.checks import CameraCheck, RunCheck
from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.model import Calibration
from vaoi_station.simulation import Scenario, Twin, read_scenario
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.station import DATABASE
from vaoi_station.store import Database, RunRow, Store

Vaoi = Callable[..., Any]
KNOCK = {"knocked": [{"camera": 2, "about": "x", "angle_deg": 0.1}]}
THREE = read_scenario(Path(__file__).parents[2] / "drift" / "three.toml").model_dump()


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three boards under an array whose camera 2 was knocked; to read."""
    twin = Twin(Scenario.model_validate({**THREE, "faults": KNOCK}))
    directories = [tmp_path_factory.mktemp("case") for _ in range(3)]
    for number, directory in enumerate(directories):
        write_passage(twin.passage(number), directory, with_truth=False)
    return directories


def test_recordings_correct_a_displaced_camera(vaoi: Vaoi, cases: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "new.json"
    said = vaoi("recalibrate", *cases, "--out", out)
    assert said.code == 0, said.err
    lines = said.out.splitlines()
    assert "camera 0: residuals" in lines[1]
    assert "has not moved; its N stays" in lines[1]
    assert "camera 2: residuals" in lines[3]
    assert "N is corrected" in lines[3]
    assert "camera 2: calibrations differ by 7.3" in said.out
    before, after = read_calibration(cases[0] / "calibration.json"), read_calibration(out)
    assert (after.camera_matrices[0] == before.camera_matrices[0]).all()
    assert after.camera_matrices[2][1, 2] - before.camera_matrices[2][1, 2] == pytest.approx(-7.33, abs=0.1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new-difference.png", "new.json"]


def test_too_few_recordings(vaoi: Vaoi, cases: list[Path], tmp_path: Path) -> None:
    said = vaoi("recalibrate", cases[0], "--out", tmp_path / "new.json")
    assert said.code == 2
    assert "1 run(s) are too few" in said.err
    assert not list(tmp_path.iterdir())


def test_existing_file_is_not_overwritten(vaoi: Vaoi, cases: list[Path]) -> None:
    in_force = cases[0] / "calibration.json"
    before = in_force.read_bytes()
    said = vaoi("recalibrate", *cases, "--out", in_force)
    assert (said.code, in_force.read_bytes()) == (2, before)
    assert "exists already" in said.err


def test_recordings_of_two_calibrations(vaoi: Vaoi, cases: list[Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(cases[1], tmp_path / "other"))
    known = read_calibration(other / "calibration.json")
    write_calibration(other / "calibration.json", known.model_copy(update={"created": "yesterday"}))
    said = vaoi("recalibrate", cases[0], other, cases[2], "--out", tmp_path / "new.json")
    assert said.code == 2
    assert "differs from" in said.err


def test_recordings_or_a_station(vaoi: Vaoi, tmp_path: Path) -> None:
    said = vaoi("recalibrate", "--out", tmp_path / "new.json")
    assert (said.code, "either recordings or --config" in said.err) == (2, True)


STATION = """
calibration = "calibration.json"
board_types = "board-types"
data = "data"
[line]
conveyor_mm_s = [0.0, 100.0]
barrier_mm = 0.0
start_delay_s = 0.0
trigger_period_s = 0.1
tail_s = 0.0
longest_board_mm = 50.0
[controller]
backend = "replay"
[replay]
recordings = ["recording"]
"""
CAMERA = '[[cameras]]\nname = "c{i}"\nbackend = "replay"\nwidth = 480\nheight = 360\nexposure_us = 100.0\n'


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A station of three cameras that has filmed no board yet."""
    write_calibration(tmp_path / "calibration.json", Twin(Scenario.model_validate(THREE)).calibration)
    path = tmp_path / "station.toml"
    path.write_text(STATION + "".join(CAMERA.format(i=i) for i in range(3)))
    return path


def kept(config: Path, shown: list[float]) -> None:
    """Runs of the station in which camera 1 shows these displacements along y."""
    calibration: Calibration = read_calibration(config.parent / "calibration.json")
    store = Store(Database(config.parent / "data" / DATABASE))
    board_type = store.keep_document("board-type", "{}", "2026-01-01T00:00:00Z")
    digest = store.keep_document("calibration", calibration.model_dump_json(), "2026-01-01T00:00:00Z")
    for number, y in enumerate(shown):
        run = f"r{number:03d}"
        cameras = tuple(
            CameraCheck(
                x_px=0.0, y_px=v, turn_px=0.0, sigma_px=(0.02,) * 3, rms_px=v, left_px=0.1, links=50, fiducials=1
            )
            for v in (0.0, y, 0.0)
        )
        vector = [0.0] * 4 + [2500.0 * y] + [0.0] * 4
        check = RunCheck(
            run=run, time="t", board_type="b", cameras=cameras, rivals=(),
            information=tuple(2500.0 * np.eye(9)[np.tril_indices(9)]), vector=tuple(vector),
        )  # fmt: skip
        store.save_run(RunRow(run, "ready", number + 1, board_type, digest, "{}", "{}"))
        store.checks.save(run, digest, check.model_dump_json()).result(10)
    store.close()


def test_runs_of_a_station_since_a_camera_moved(vaoi: Vaoi, config: Path) -> None:
    kept(config, [0.0] * 6 + [2.0] * 4)
    out = config.parent / "new.json"
    said = vaoi("recalibrate", "--config", config, "--out", out)
    assert said.code == 0, said.err
    assert "4 runs, r006 to r009" in said.out
    assert "camera 1: calibrations differ by 2.00" in said.out
    too_many = vaoi("recalibrate", "--config", config, "--runs", "9", "--out", config.parent / "other.json")
    assert too_many.code == 2
    assert "the runs disagree about camera 1" in too_many.err
    assert not (config.parent / "other.json").exists()


def test_station_without_displaced_cameras(vaoi: Vaoi, config: Path) -> None:
    kept(config, [0.0] * 5)
    said = vaoi("recalibrate", "--config", config, "--out", config.parent / "new.json")
    assert said.code == 0
    assert "no camera has moved" in said.out
    assert not (config.parent / "new.json").exists()


def test_station_without_runs_is_refused(vaoi: Vaoi, config: Path) -> None:
    said = vaoi("recalibrate", "--config", config, "--out", config.parent / "new.json")
    assert said.code == 2
    assert "has filmed no board" in said.err
    assert not (config.parent / "data").exists()
