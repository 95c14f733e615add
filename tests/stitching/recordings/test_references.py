"""A reference as a directory: written whole, opened with the same result, refused where it does not fit."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import (
    open_recording,
    read_board_type,
    read_calibration,
    read_stitch,
    write_calibration,
    write_stitch,
)
from vaoi_station.model import BoardType, Calibration, Status, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.recordings.references import (
    RESULT,
    StoredReference,
    open_reference,
    select_reference_frames,
    teach,
    write_reference,
)

BOARD = BoardType(name="b", outline=((0.0, 0.0), (60.0, 40.0)))
"""Its middle lies at tester (0, 0); cameras show 20 × 16 mm, one beside the other."""


def stitch_of(rows: int, step_mm: float) -> Stitch:
    motion = tuple(np.array([[1, 0, 0], [0, 1, step_mm * j], [0, 0, 1.0]]) for j in range(rows))
    c = np.array([[1, 0, -30], [0, -1, 20], [0, 0, 1.0]])
    return Stitch(method="auto", image_matrices=(), cad_matrix=c, row_motion=motion, status=Status.OK)


def row_of_cameras(workshop: Any, n: int, apart_mm: float) -> tuple[Any, ...]:
    return tuple(workshop.camera(((i - (n - 1) / 2) * apart_mm, 0.0)) for i in range(n))


def test_frames_that_hardly_show_the_board_are_not_kept(workshop: Any) -> None:
    cameras = row_of_cameras(workshop, 3, 41.0)
    present = {(i, j) for i in range(3) for j in range(4)}
    chosen = select_reference_frames(stitch_of(4, 13.9), cameras, BOARD, present)
    assert chosen == {(1, 0), (1, 1)}, "the board covers only the edge of the third row's frame"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("reference") / "run"
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), out, with_truth=True)
    return out


@pytest.fixture(scope="module")
def taught(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("taught") / "small"
    stitch = teach(recording, recording / "calibration.json", recording / "board.json", out)
    assert stitch.status is Status.OK
    return out


def opened(directory: Path, board_type: BoardType | None = None, calibration: Path | None = None) -> StoredReference:
    head = open_recording(directory).head
    cameras = read_calibration(calibration or directory / "calibration.json", head.cameras).cameras(head.cameras)
    return open_reference(directory, cameras, board_type or read_board_type(directory / "board.json"))


def changed(board: Path, **keys: object) -> BoardType:
    return BoardType.model_validate(json.loads(board.read_text()) | keys)


def test_teaching_keeps_everything_but_the_truth(recording: Path, taught: Path) -> None:
    assert (recording / "truth.json").is_file()
    assert not (taught / "truth.json").exists()
    for name in ("calibration.json", "board.json", "recording.json"):
        assert (taught / name).read_bytes() == (recording / name).read_bytes()
    assert read_stitch(taught / RESULT).cad_matrix is not None
    with pytest.raises(InputError, match="exists already"):
        teach(recording, recording / "calibration.json", recording / "board.json", taught)


def bare_board(recording: Path, path: Path) -> Path:
    """Write a board type with two fiducials alone, which leave it open how the board lies."""
    bare = json.loads((recording / "board.json").read_text())
    bare.pop("outline")
    bare |= {"fiducials": bare["fiducials"][:2], "components": []}
    path.write_text(json.dumps(bare))
    return path


def test_a_person_confirms_an_ambiguous_orientation_once(recording: Path, tmp_path: Path) -> None:
    board, calibration = bare_board(recording, tmp_path / "board.json"), recording / "calibration.json"
    with pytest.raises(InputError, match="confirm-orientation") as refusal:
        teach(recording, calibration, board, tmp_path / "refused")
    assert refusal.value.action.startswith("If the board lies as its board type says")
    stitch = teach(recording, calibration, board, tmp_path / "taught", confirm_orientation=True)
    assert (stitch.status, stitch.quality["orientation"]) == (Status.OK, "confirmed")
    assert opened(tmp_path / "taught").reference.sigma_px == stitch.quality["cad_sigma_px"]


def test_a_reference_of_unknown_uncertainty_is_refused(taught: Path, tmp_path: Path) -> None:
    shutil.copytree(taught, tmp_path / "unknown")
    write_stitch(tmp_path / "unknown" / RESULT, read_stitch(taught / RESULT).model_copy(update={"quality": {}}))
    with pytest.raises(InputError, match=r"quality\.cad_sigma_px is absent"):
        opened(tmp_path / "unknown")


def test_a_reference_stays_usable_when_the_kind_of_a_fiducial_is_corrected(taught: Path) -> None:
    fiducials = json.loads((taught / "board.json").read_text())["fiducials"]
    opened(taught, changed(taught / "board.json", fiducials=[f | {"kind": "global"} for f in fiducials]))
    fiducials[0]["x"] += 1
    with pytest.raises(InputError, match="had other fiducials"):
        opened(taught, changed(taught / "board.json", fiducials=fiducials))


def test_a_reference_without_a_result_is_stitched_when_opened(recording: Path, taught: Path) -> None:
    np.testing.assert_allclose(
        opened(recording).reference.stitch.row_motion, opened(taught).reference.stitch.row_motion, atol=1e-9
    )


def test_another_calibration_is_refused(taught: Path, tmp_path: Path) -> None:
    known: Calibration = read_calibration(taught / "calibration.json")
    matrices = list(known.camera_matrices)
    matrices[1] = np.array([[1, 0, 0.2], [0, 1, 0], [0, 0, 1]]) @ matrices[1]
    write_calibration(tmp_path / "c.json", known.model_copy(update={"camera_matrices": tuple(matrices)}))
    with pytest.raises(InputError, match=r"another calibration: camera 1 differs by 0\.20 px \(limit 0\.05\)"):
        opened(taught, calibration=tmp_path / "c.json")


def test_a_stitched_run_is_written_with_some_of_its_frames(recording: Path, taught: Path, tmp_path: Path) -> None:
    source = open_recording(recording)
    head = source.head
    kept = [(i, j) for i in range(len(head.cameras)) for j in range(head.rows) if (i + j) % 2 == 0]
    missing = tuple((i, j) for i in range(len(head.cameras)) for j in range(head.rows) if (i, j) not in kept)
    out = tmp_path / "some"
    write_reference(
        out,
        head.model_copy(update={"missing": missing, "x_run": "r-17"}),
        ((i, j, pixels) for i, j in kept if (pixels := source.frame(i, j)) is not None),
        read_calibration(recording / "calibration.json", head.cameras),
        read_board_type(recording / "board.json"),
        read_stitch(taught / RESULT),
    )
    stored = opened(out)
    assert stored.reference.present == frozenset(kept)
    assert stored.reference.name == "r-17"
    ours, theirs = stored.recording.frame(*kept[1]), source.frame(*kept[1])
    assert ours is not None
    assert theirs is not None
    assert np.array_equal(ours, theirs)
