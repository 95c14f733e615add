"""Recordings through the public API."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi


def test_every_frame_has_the_size_of_its_camera(recording: vaoi.RecordedRun) -> None:
    frames = list(recording.frames())
    assert len(frames) == recording.cameras * recording.rows
    assert [row for _, row, _ in frames] == sorted(row for _, row, _ in frames), "row by row"
    assert {pixels.shape for *_, pixels in frames} == {(480, 640)}


@pytest.mark.parametrize(("camera", "row"), [(-1, 0), (99, 0), (0, -1), (0, 99)])
def test_a_frame_outside_the_recording_is_refused_with_the_limits(
    recording: vaoi.RecordedRun, camera: int, row: int
) -> None:
    with pytest.raises(vaoi.InputError, match=r"cameras are 0 … 1, rows 0 … \d"):
        recording.frame(camera, row)


def test_a_recording_without_a_board_type_gives_matrices_but_no_components(
    recording: vaoi.RecordedRun, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for path in recording.directory.iterdir():
        if path.name != "board.json":
            (bare / path.name).symlink_to(path)
    run = vaoi.open_recording(bare).stitch()
    assert run.image_matrix(0, 0) is not None
    assert run.cad_matrix is None
    assert run.refs == ()
    with pytest.raises(vaoi.StateError, match="no board type"):
        run.component("U1")


def test_an_unknown_method_is_refused_by_name(recording: vaoi.RecordedRun) -> None:
    with pytest.raises(vaoi.InputError, match="must be one of auto, features, fiducials, reference, paper"):
        recording.stitch("magic")  # type: ignore[arg-type]


def test_the_method_reference_needs_a_reference(recording: vaoi.RecordedRun) -> None:
    with pytest.raises(vaoi.InputError, match="reference"):
        recording.stitch("reference")


def test_the_method_of_the_paper_places_the_frames(recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun) -> None:
    by_paper = recording.stitch("paper")
    assert by_paper.result.method == "paper"
    assert len(by_paper.result.image_matrices) == len(stitched.result.image_matrices)


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(vaoi.NotFoundError, match=r"recording\.json"):
        vaoi.open_recording(tmp_path / "absent")


def test_stitching_takes_a_directory_or_an_opened_recording(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun
) -> None:
    again = vaoi.stitch(str(recording.directory))
    assert again.cad_matrix is not None
    assert stitched.cad_matrix is not None
    np.testing.assert_array_equal(again.cad_matrix, stitched.cad_matrix)


def test_the_expected_rotation_is_an_argument(recording: vaoi.RecordedRun) -> None:
    """The board lies upright: expected upside down, it is not found."""
    turned = vaoi.open_recording(recording.directory, rotation_deg=180)
    assert turned.rotation_deg == 180
    assert turned.stitch().status == "failed"
    assert vaoi.open_recording(recording.directory, rotation_deg=0).stitch().status == "ok"
    with pytest.raises(vaoi.InputError, match="must be 0, 90, 180 or 270"):
        vaoi.open_recording(recording.directory, rotation_deg=91)
