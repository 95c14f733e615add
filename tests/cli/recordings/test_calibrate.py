from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import read_calibration
from vaoi_station.files.images import read_image
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.calibration_board import write_calibration_recording


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


def test_refusal_does_not_overwrite_a_calibration(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "calibration.json"
    _run(film, "--out", out)
    before = out.read_bytes()
    with pytest.raises(InputError, match=r"residuals are .*the limit is 0\.00 px"):
        _run(film, "--out", out, "--residual-limit-px", "0.001")
    assert out.read_bytes() == before


def test_two_calibrations_are_compared_as_a_map(film: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    _run(film, "--out", one)
    said = _run(film, "--out", two, "--compare", one)
    assert "camera 1: calibrations differ by 0.000 px rms, 0.000 px at most" in said
    assert (tmp_path / "two-difference.png").exists()
    said = _run(film, "--existing", one, "--compare", two, "--report", tmp_path / "maps")
    assert "camera 0: calibrations differ" in said
    assert (tmp_path / "maps" / "one-difference.png").exists()


def test_the_stated_accuracy_of_the_board_is_in_the_covariance(film: Path, tmp_path: Path) -> None:
    exact, stated = tmp_path / "exact.json", tmp_path / "stated.json"
    _run(film, "--out", exact, "--working-distance-mm", "300")
    said = _run(film, "--out", stated, "--working-distance-mm", "300", "--mark-accuracy-um", "5", "--flatness-um", "30")
    assert "--mark-accuracy-um" not in said
    one, two = read_calibration(exact).covariance, read_calibration(stated).covariance
    assert one is not None
    assert two is not None
    assert all(np.trace(b) > 20 * np.trace(a) for a, b in zip(one, two, strict=True))


def test_four_marks_do_not_determine_the_lens(tmp_path: Path) -> None:
    scenario = read_scenario(scenario_path("small"))
    board = scenario.calibration_board.model_copy(update={"marks_per_axis": 2})
    write_calibration_recording(Twin(scenario.model_copy(update={"calibration_board": board})), tmp_path / "film")
    said = _run(tmp_path / "film", "--out", tmp_path / "c.json")
    assert "distortion there not determined (± 1.5 px assumed)" in said
    assert re.search(
        r"four marks do not determine the lens: ± [01]\.\d px at the corners \(1 σ\); film 9 or more", said
    )


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


def test_recording_of_several_rows_needs_a_row(film: Path, tmp_path: Path) -> None:
    copy = tmp_path / "film"
    shutil.copytree(film, copy)
    head = json.loads((copy / "recording.json").read_text())
    (copy / "recording.json").write_text(json.dumps(head | {"rows": 2, "missing": [[0, 0], [1, 0]]}))
    for camera in range(2):
        (copy / "frames" / f"c{camera:02d}_r000.png").rename(copy / "frames" / f"c{camera:02d}_r001.png")
    with pytest.raises(InputError, match=r"rows is 2, but must be 1\. Choose one row with --row"):
        _run(copy, "--out", tmp_path / "c.json")
    with pytest.raises(InputError, match="camera 0: its frame of the calibration board is listed as missing"):
        _run(copy, "--out", tmp_path / "c.json", "--row", "0")
    _run(copy, "--out", tmp_path / "c.json", "--row", "1")
