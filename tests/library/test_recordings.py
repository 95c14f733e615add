"""Recordings through the public API: opened, simulated, stitched, and their images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi
from vaoi_station.geometry import apply


@pytest.mark.parametrize(("camera", "row"), [(-1, 0), (99, 0), (0, -1), (0, 99)])
def test_a_frame_outside_the_recording_is_refused_with_the_limits(
    recording: vaoi.RecordedRun, camera: int, row: int
) -> None:
    with pytest.raises(vaoi.InputError, match=r"cameras are 0 … 1, rows 0 … \d"):
        recording.frame(camera, row)


def test_the_matrices_of_an_image_take_the_centre_of_the_component_to_its_pixel(stitched: vaoi.StitchedRun) -> None:
    board_type = stitched.board_type
    assert board_type is not None
    component = board_type.component("U1")
    assert component is not None
    images = stitched.component("U1")
    assert images.images, "U1 is in view"
    expected = {(i, j): (x, y) for i, j, x, y in (stitched.result.components or {})["U1"]}
    for image in images:
        height, width = image.pixels.shape[:2]
        crop = apply(image.crop_from_cad, np.array([component.center]))[0]
        np.testing.assert_allclose(crop, ((width - 1) / 2, (height - 1) / 2), atol=1e-6)
        np.testing.assert_allclose(image.cad_from_crop @ image.crop_from_cad, np.eye(3), atol=1e-9)
        if not image.distorted and (image.camera, image.row) in expected:
            pixel = apply(image.image_from_crop, crop[None])[0]
            np.testing.assert_allclose(pixel, expected[image.camera, image.row], atol=0.05)


def test_directions_and_coverage_are_those_of_the_simulator(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun
) -> None:
    """The truth has the exact matrices; the camera's place follows from them, and not from the result."""
    truth = json.loads((recording.directory / "truth.json").read_text())
    board_type = stitched.board_type
    assert board_type is not None
    from_cad, checked = np.array(truth["cad_matrix"]), 0
    for ref in stitched.refs:
        part = board_type.component(ref)
        assert part is not None
        corners = board_type.footprint(part)
        for image in stitched.component(ref, min_coverage=0.05):
            camera = stitched.cameras[image.camera]
            m = np.array(truth["image_matrices"][image.camera][image.row]) @ from_cad
            u, v = np.meshgrid(*[(np.arange(60) + 0.5) / 60] * 2)
            low, right, up = (
                np.array(corners[0]),
                np.subtract(corners[1], corners[0]),
                np.subtract(corners[3], corners[0]),
            )
            inside = camera.sees(camera.lens.distort(apply(m, low + u[..., None] * right + v[..., None] * up)))
            assert image.coverage == pytest.approx(inside.mean(), abs=0.12)
            motion = np.array(truth["row_motion"][image.row])
            sight = (camera.foot_mm - apply(motion @ from_cad, part.center)) @ motion[:2, :2] @ from_cad[:2, :2]
            assert camera.working_distance_mm is not None
            assert image.view_angle_deg is not None
            angle = np.degrees(np.arctan2(np.hypot(*sight) / np.hypot(*from_cad[:2, 0]), camera.working_distance_mm))
            assert image.view_angle_deg == pytest.approx(angle, abs=0.1)
            if image.view_azimuth_deg is not None and angle > 0.5:
                expected = np.degrees(np.arctan2(sight[1], sight[0]))
                assert abs((image.view_azimuth_deg - expected + 180) % 360 - 180) < 3
                checked += 1
    assert checked > 20


def test_a_saved_result_comes_back_equal(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, tmp_path: Path
) -> None:
    stitched.save(tmp_path / "result.json")
    again = recording.with_result(tmp_path / "result.json")
    np.testing.assert_allclose(np.array(again.result.image_matrices), np.array(stitched.result.image_matrices))
    assert again.component("U1").height_mm == stitched.component("U1").height_mm
    assert vaoi.read_result(str(tmp_path / "result.json")).status == stitched.status


def test_a_result_of_another_recording_is_refused(recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun) -> None:
    result = stitched.result
    shorter = {
        "image_matrices": tuple(rows[:-1] for rows in result.image_matrices),
        "row_motion": result.row_motion[:-1],
    }
    with pytest.raises(vaoi.InputError, match="belongs to another recording: it has 2 cameras and"):
        recording.with_result(result.model_copy(update=shorter))
    with pytest.raises(vaoi.InputError, match="camera 0 has another calibration"):
        recording.with_result(result.model_copy(update={"image_matrices": result.image_matrices[::-1]}))


def test_a_result_of_another_board_of_the_same_array_is_refused(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, tmp_path: Path
) -> None:
    other = vaoi.simulate("small", tmp_path / "other", board=1)
    assert (other.rows, other.cameras) == (recording.rows, recording.cameras)
    with pytest.raises(vaoi.InputError, match=r"the result: belongs to another recording.*'recording'.*'other'"):
        other.with_result(stitched.result)


def test_a_recording_is_never_overwritten(recording: vaoi.RecordedRun) -> None:
    with pytest.raises(vaoi.InputError, match="already holds a recording"):
        vaoi.simulate("small", recording.directory)
