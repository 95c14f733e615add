"""The commands that calibrate."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.photometry import white_recordings
from tests.photometry.white_recordings import white
from vaoi_station.cli import app
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import read_calibration
from vaoi_station.files.calibrations import read_layout
from vaoi_station.files.images import read_image
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path
from vaoi_station.simulation.calibration_board import write_calibration_recording
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The twin's calibration board, 16 marks per camera; to read."""
    directory = tmp_path_factory.mktemp("film")
    scenario = read_scenario(scenario_path("small"))
    board = scenario.calibration_board.model_copy(update={"marks_per_axis": 4})
    write_calibration_recording(Twin(scenario.model_copy(update={"calibration_board": board})), directory)
    (directory / "truth.json").unlink()
    return directory


def _run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["calibrate", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_calibration_with_its_picture(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "calibration.json"
    said = _run(film, "--out", out, "--working-distance-mm", "300")
    assert "camera 1: 16 of 16 marks, residuals 0.0" in said
    calibration = read_calibration(out, 2)
    assert calibration.working_distance_mm == 300
    assert calibration.created is not None
    assert calibration.created.endswith("Z")
    assert calibration.residual_px is not None
    assert calibration.covariances is not None
    assert calibration.covariance is not None
    assert re.search(
        r"standard deviation 0\.0\d+ px at the frame corners, distortion there [+-]0\.0\d+ ± 0\.0\d+ px", said
    )
    assert "state their accuracy with --mark-accuracy-um" in said
    assert read_image(out.parent / "calibration-report.png").ndim == 3
    assert sorted(p.name for p in out.parent.iterdir()) == ["calibration-report.png", "calibration.json"]


def test_refusal_writes_the_picture_and_no_calibration(film: Path, tmp_path: Path) -> None:
    layout = json.loads((film / "layout.json").read_text())
    layout["marks"] = [{"x": m["x"], "y": m["y"] + 60} for m in layout["marks"]]
    wrong = tmp_path / "layout.json"
    wrong.write_text(json.dumps(layout))
    out, pictures = tmp_path / "out" / "calibration.json", tmp_path / "pictures"
    with pytest.raises(InputError, match=r"camera 0: .* at least 4 are needed.*The picture is .*calibration-report"):
        _run(film, "--out", out, "--layout", wrong, "--report", pictures)
    assert not out.parent.exists()
    assert [p.name for p in pictures.iterdir()] == ["calibration-report.png"]


def test_two_calibrations_are_compared_as_a_map(film: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    _run(film, "--out", one)
    said = _run(film, "--out", two, "--compare", one)
    assert "camera 1: calibrations differ by 0.000 px rms, 0.000 px at most" in said
    assert (tmp_path / "two-difference.png").exists()
    said = _run(film, "--existing", one, "--compare", two, "--report", tmp_path / "maps")
    assert "camera 0: calibrations differ" in said
    assert (tmp_path / "maps" / "one-difference.png").exists()


def test_missing_options_are_named(film: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--out is missing"):
        _run(film)
    with pytest.raises(InputError, match="--existing is given without --compare"):
        _run(film, "--existing", film / "layout.json")
    with pytest.raises(NotFoundError, match=r"no\.json"):
        _run(film, "--out", tmp_path / "c.json", "--layout", tmp_path / "no.json")
    with pytest.raises(InputError, match="--flatness-um is given without --working-distance-mm"):
        _run(film, "--out", tmp_path / "c.json", "--flatness-um", "20")
    with pytest.raises(InputError, match="row is 3, but must be below"):
        _run(film, "--out", tmp_path / "c.json", "--row", "3")


def _design(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["calibration-board", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_artwork_for_an_array(tmp_path: Path) -> None:
    said = _design(
        "--out", tmp_path, "--cameras", "2", "--pitch-mm", "33", "--field-mm", "34.8x26", "--marks-per-camera", "4x3"
    )
    assert "24 marks for 2 cameras" in said
    assert len(read_layout(tmp_path / "layout.json").marks) == 24
    assert {p.name for p in tmp_path.iterdir()} == {
        "layout.json",
        "calibration-board.svg",
        "calibration-board.pdf",
        "calibration-board.gbr",
        "calibration-board-outline.gbr",
    }


Vaoi = Callable[..., Any]
KNOCK = {"knocked": [{"camera": 2, "about": "x", "angle_deg": 0.1}]}
THREE = read_scenario(Path(__file__).parents[1] / "drift" / "three.toml").model_dump()


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


def test_unfit_targets_and_existing_paths_are_refused(vaoi: Any, tmp_path: Path) -> None:
    white_recordings.film(tmp_path / "white", white(400))
    said = vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat")
    assert said.code == 2
    assert "of the pixels are saturated" in said.err
    assert not (tmp_path / "flat").exists()
    (tmp_path / "flat").mkdir()
    said = vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat")
    assert said.code == 2
    assert "exists already" in said.err
