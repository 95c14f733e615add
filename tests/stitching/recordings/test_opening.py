"""A recording on disk is opened with its own files, or with those given instead."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.line_config import ExpectedBoard
from vaoi_station.model import Status, Stitch
from vaoi_station.model.board_type import Visibility
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.expectation import StitchTerms
from vaoi_station.stitching.recordings.opening import OpenedRun, open_run
from vaoi_station.stitching.recordings.references import teach
from vaoi_station.stitching.work import stitch_frames


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("opening") / "run"
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), out, with_truth=False)
    return out


def test_a_calibration_of_another_scale_is_refused(kept: Path, tmp_path: Path) -> None:
    known = read_calibration(kept / "calibration.json")
    half = tuple(np.diag([0.5, 0.5, 1.0]) @ n for n in known.camera_matrices)
    write_calibration(tmp_path / "half.json", known.model_copy(update={"camera_matrices": half}))
    with pytest.raises(InputError, match=r"half\.json: camera_matrices\.0 gives camera 0 .* within a factor of 1\.5"):
        open_run(kept, calibration=tmp_path / "half.json")


def test_inputs_that_do_not_fit_are_refused(kept: Path, tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"the method 'reference' needs a reference.*--reference DIR, or the argument reference"
    ):
        open_run(kept, method="reference")
    with pytest.raises(NotFoundError):
        open_run(kept, calibration=tmp_path / "absent.json")


@pytest.mark.parametrize("turned_deg", [90, 180])
def test_a_turned_board_is_stitched_with_its_rotation(tmp_path: Path, turned_deg: int) -> None:
    known = read_scenario(scenario_path("small"))
    board = known.board.model_copy(update={"turned_deg": turned_deg, "width_mm": 40.0, "length_mm": 40.0})
    write_passage(Twin(known.model_copy(update={"board": board})).passage(0), tmp_path / "run", with_truth=False)
    assert stitched(open_run(tmp_path / "run")).status is Status.FAILED, "nothing states that the board is turned"
    assert stitched(open_run(tmp_path / "run", rotation_deg=turned_deg)).status is Status.OK
    run = tmp_path / "run"
    taught = teach(run, run / "calibration.json", run / "board.json", tmp_path / "taught", rotation_deg=turned_deg)
    assert taught.status is Status.OK
    (tmp_path / "taught" / "result.json").unlink()
    again = open_run(run, reference=tmp_path / "taught", rotation_deg=turned_deg)
    assert again.reference is not None, "a reference is stitched again with the rotation that it was taught with"
    head = json.loads((tmp_path / "run" / "recording.json").read_text())
    (tmp_path / "run" / "recording.json").write_text(json.dumps(head | {"rotation_deg": turned_deg}))
    assert stitched(open_run(tmp_path / "run")).status is Status.OK


def stitched(opened: OpenedRun) -> Stitch:
    return stitch_frames(opened.setup, opened.recording.head, opened.recording.frame)


@pytest.mark.parametrize(
    "design",
    [
        {"camera_px_per_mm": (20.0, 14.0)},
        {"camera_roll_deg": (10.0, 0.0)},
        {"camera_roll_deg": (180.0, 180.0)},
        {"camera_frame_px": ((640, 480), (560, 500)), "camera_px_per_mm": (20.0, 17.0)},
    ],
    ids=["resolution", "rolled by 10", "both upside down", "frame size"],
)
def test_cameras_of_one_array_may_differ(tmp_path: Path, design: dict[str, object]) -> None:
    """Neighbours are linked although patches of one are scaled or turned in the other."""
    known = read_scenario(scenario_path("small"))
    array = known.array.model_copy(update={"px_per_mm": 20.0, "overlap": 1.15} | design)
    board = known.board.model_copy(update={"width_mm": 46.0})
    passage = Twin(known.model_copy(update={"array": array, "board": board})).passage(0)
    write_passage(passage, tmp_path / "run", with_truth=False)
    down = array.camera_roll_deg == (180.0, 180.0)
    result = stitched(open_run(tmp_path / "run", rotation_deg=180 if down else None))
    assert result.status is Status.OK, result.reasons
    assert result.components is not None
    found = {(ref, *view[:2]): view[2:] for ref, views in result.components.items() for view in views}
    off = np.array(
        [
            np.subtract(found[ref, camera, row], px)
            for ref, views in passage.truth()["views"].items()
            for camera, row, *px in views
            if (ref, camera, row) in found
        ]
    )
    assert len(off) >= 60
    assert np.sqrt((off**2).sum(1).mean()) < 0.05
    assert result.quality["cad_sigma_px"] < 0.05


def test_boards_that_were_not_to_be_tested_are_not_demanded_later(kept: Path, tmp_path: Path) -> None:
    shutil.copytree(kept, tmp_path / "run")
    path = tmp_path / "run" / "recording.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"skip": ["2"]}))
    terms = StitchTerms(
        leading_edge_mm=0.0,
        conveyor_mm_s=(0.0, 1.0),
        expected_board=ExpectedBoard(),
        visibility=Visibility(),
        channels={},
    )
    for opened in (open_run(tmp_path / "run"), open_run(tmp_path / "run", terms=terms)):
        assert opened.setup.expectation.skipped == ("2",)
    assert open_run(kept).setup.expectation.skipped == ()
