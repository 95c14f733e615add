"""The recorded cases, scored by a program with the truth, and a recording of the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.calibration import Outcome, calibrate
from vaoi_station.files import Recording, open_recording, write_calibration
from vaoi_station.files.calibrations import read_layout
from vaoi_station.files.documents import read_json
from vaoi_station.geometry.transforms import apply
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.calibration_board import write_calibration_recording


def _outcome(recording: Recording) -> Outcome:
    layout = read_layout(recording.directory / "layout.json")
    return calibrate(recording.head.cameras, lambda i: recording.frame(i, 0), layout)


@pytest.mark.cases
@pytest.mark.parametrize(("name", "marks"), [("calibration", 4), ("calibration-distorted", 49)])
def test_recorded_boards_to_a_fortieth_of_a_pixel(cases: Any, tmp_path: Path, name: str, marks: int) -> None:
    outcome = _outcome(open_recording(cases(name)))
    assert [c.used for c in outcome.cameras] == [marks] * 3
    path = tmp_path / "calibration.json"
    write_calibration(path, outcome.calibration())
    assert cases.score_file(name, path)["worst_px"] < 0.03


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"array": {"distortion_px": 1.0}, "calibration_board": {"marks_per_axis": 6, "mark_mm": 1.5}},
        {"calibration_board": {"marks_per_axis": 4, "board_grey": 20.0, "mark_grey": 210.0}},
    ],
)
def test_the_twin(tmp_path: Path, changes: dict[str, dict[str, Any]]) -> None:
    scenario = read_scenario(scenario_path("small"))
    sections = {key: getattr(scenario, key).model_copy(update=value) for key, value in changes.items()}
    twin = Twin(scenario.model_copy(update=sections))
    recording = write_calibration_recording(twin, tmp_path, with_truth=True)
    calibration = _outcome(recording).calibration()
    truth = read_json(tmp_path / "truth.json")
    for i, camera in enumerate(calibration.cameras(recording.head.cameras)):
        x, y = np.linspace(0, camera.width_px - 1, 9), np.linspace(0, camera.height_px - 1, 9)
        grid = np.stack(np.meshgrid(x, y), -1)
        off = apply(truth["camera_matrices"][i], camera.ground(grid)) - twin.pinholes[i].lens.undistort(grid)
        assert np.sqrt((off**2).sum(-1).mean()) < 0.04
