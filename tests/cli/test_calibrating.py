"""The commands that calibrate."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.photometry import white_recordings
from tests.photometry.white_recordings import white
from vaoi_station.cli import app
from vaoi_station.drift.checks import CameraCheck, RunCheck
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.files.calibrations import read_layout
from vaoi_station.files.images import read_image
from vaoi_station.model import Calibration
from vaoi_station.photometry import FlatFields
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path
from vaoi_station.simulation.calibration_board import write_calibration_recording
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.station import DATABASE
from vaoi_station.store import Database, RunRow, Store


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


_CAMERA = '[[cameras]]\nname = "{n}"\nwidth = 1392\nheight = 1040\nexposure_us = 250.0\n{more}\n'


def _design(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["calibration-board", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def _station(path: Path, nominal: bool) -> Path:
    cameras = "".join(
        _CAMERA.format(n=n, more=f"nominal_center_mm = [{33.14 * n}, 0.0]\nnominal_px_per_mm = 40.0" if nominal else "")
        for n in range(4)
    )
    path.write_text(
        'calibration = "c.json"\nboard_types = "b"\ndata = "d"\n'
        "[line]\nconveyor_mm_s = [0.0, 100.0]\nbarrier_mm = -30.0\nstart_delay_s = 0.25\ntrigger_period_s = 0.12\n"
        f'tail_s = 0.5\nlongest_board_mm = 120.0\n[simulation]\nscenario = "s.toml"\n{cameras}'
    )
    return path


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


def test_artwork_for_a_configured_station(tmp_path: Path) -> None:
    said = _design(
        "--out", tmp_path / "board", "--config", _station(tmp_path / "station.toml", nominal=True), "--light"
    )
    assert "80 marks for 4 cameras" in said
    layout = read_layout(tmp_path / "board" / "layout.json")
    assert layout.mark.polarity == "light"
    assert max(m.x for m in layout.marks) == pytest.approx(3 * 33.14 + 13.4, abs=1.0)


def test_artwork_fits_the_view_of_the_finest_camera(tmp_path: Path) -> None:
    config = _station(tmp_path / "station.toml", nominal=True)
    # The first camera sees less than the others.
    config.write_text(config.read_text().replace("nominal_px_per_mm = 40.0", "nominal_px_per_mm = 44.0", 1))
    _design("--out", tmp_path / "fine", "--config", config)
    _design("--out", tmp_path / "given", "--config", config, "--px-per-mm", "44")
    assert read_layout(tmp_path / "fine" / "layout.json") == read_layout(tmp_path / "given" / "layout.json")


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


def test_recordings_of_two_calibrations(vaoi: Vaoi, cases: list[Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(cases[1], tmp_path / "other"))
    known = read_calibration(other / "calibration.json")
    write_calibration(other / "calibration.json", known.model_copy(update={"created": "yesterday"}))
    said = vaoi("recalibrate", cases[0], other, cases[2], "--out", tmp_path / "new.json")
    assert said.code == 2
    assert "differs from" in said.err


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


def test_flat_fields_are_written_with_their_figures(vaoi: Any, tmp_path: Path) -> None:
    white_recordings.film(tmp_path / "white", white(120), lights=("even", "left"), rows=8)
    white_recordings.film(tmp_path / "dark", white(0))
    out = tmp_path / "flat"
    said = vaoi("flatfield", tmp_path / "white", "--dark", tmp_path / "dark", "--out", out)
    assert (said.code, said.err) == (0, "")
    assert "camera 1: dark level 3.0" in said.out
    assert "camera 0 under 'left': 0.4" in said.out
    assert f"4 flat fields → {out}" in said.out
    assert FlatFields.open(out).lights == ("even", "left")


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
