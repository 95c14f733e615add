"""Recordings through the public API: opened, simulated, stitched, and their images."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi
from vaoi_station.board_check.correction import Move, moved_board_type
from vaoi_station.geometry import apply


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


def test_positions_agree_with_the_truth(recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun) -> None:
    truth = json.loads((recording.directory / "truth.json").read_text())
    assert stitched.status == vaoi.Status.OK, stitched.reasons
    assert stitched.result.components is not None
    for ref, views in truth["views"].items():
        found = {(i, j): (x, y) for i, j, x, y in stitched.result.components[ref]}
        for i, j, x, y in views:
            if (i, j) in found:
                np.testing.assert_allclose(found[i, j], (x, y), atol=0.3)


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


def test_covariances_belong_to_their_frames(stitched: vaoi.StitchedRun) -> None:
    given = [image.covariance_px2 for image in stitched.component("U1") if image.covariance_px2 is not None]
    assert given
    for covariance in given:
        assert covariance.shape == (2, 2)
        assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_the_resolution_of_images_can_be_chosen(stitched: vaoi.StitchedRun) -> None:
    coarse, fine = (stitched.component("U1", px_per_mm=r)[0].pixels.shape for r in (5.0, 10.0))
    assert fine[0] == pytest.approx(2 * coarse[0], abs=1)


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


def test_images_are_chosen_by_their_options(stitched: vaoi.StitchedRun) -> None:
    every = stitched.component("U1", measure=True)
    for image in every:
        assert image.sharpness_per_mm is not None
        assert image.saturated is not None
        head = stitched.recording.head
        assert image.time_s == pytest.approx(head.row_times_s()[image.row] - head.row_times_s()[0])
        assert image.exposure_us == head.exposure_us(image.camera, image.row)
    sharpest = stitched.component("U1", order="sharpest", limit=2, margin_mm=1.0, plane="top")
    assert len(sharpest) == min(2, len(every))
    assert sharpest[0].pixels.shape > every[0].pixels.shape
    with pytest.raises(vaoi.InputError, match="must be one of the lights of this run: ring"):
        stitched.component("U1", light="left")


def test_the_pictures_of_all_components_are_those_of_each(stitched: vaoi.StitchedRun) -> None:
    pictures = stitched.all_pictures(min_coverage=0.3)
    assert tuple(pictures) == stitched.refs
    for ref, found in pictures.items():
        expected = [image.pixels for image in stitched.component(ref, min_coverage=0.3)]
        assert len(found) == len(expected)
        assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))
    assert stitched.all_pictures(px_per_mm=4.0)["U1"][0].shape < pictures["U1"][0].shape
    with pytest.raises(vaoi.InputError, match="px_per_mm"):
        stitched.all_pictures(px_per_mm=-1.0)


def test_an_unknown_component_is_refused_with_known_ones(stitched: vaoi.StitchedRun) -> None:
    with pytest.raises(vaoi.NotFoundError, match=r"no component 'U999'\. It has "):
        stitched.component("U999")


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


@pytest.mark.parametrize("key", ["component_covariance_px2", "heights_mm"])
@pytest.mark.parametrize("garbage", [5, [], {"U1": "x"}, {"U1": [[1]]}])
def test_quality_of_other_types_is_refused_by_its_key(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, key: str, garbage: object
) -> None:
    quality = {**stitched.result.quality, key: garbage}
    run = recording.with_result(stitched.result.model_copy(update={"quality": quality}))
    with pytest.raises(vaoi.InputError, match=f"quality.{key}"):
        run.component("U1")


def test_frames_that_never_arrived_give_no_images(recording: vaoi.RecordedRun, tmp_path: Path) -> None:
    case = tmp_path / "case"
    shutil.copytree(recording.directory, case)
    head = json.loads((case / "recording.json").read_text())
    head["missing"] = [[0, 3]]
    (case / "recording.json").write_text(json.dumps(head))
    (case / "frames" / "c00_r003.png").unlink()
    run = vaoi.stitch(case)
    for ref in run.refs:
        for image in run.component(ref):
            assert (image.camera, image.row) != (0, 3)
            assert image.pixels.size
    assert {ref: len(found) for ref, found in run.all_pictures().items()} == {
        ref: len(run.component(ref)) for ref in run.refs
    }


@pytest.mark.parametrize(("camera", "row"), [(-1, 0), (9, 0), (0, -1), (0, 99), ("0", 0), (0.5, 0)])
def test_a_matrix_outside_the_run_is_refused(stitched: vaoi.StitchedRun, camera: int, row: int) -> None:
    with pytest.raises(vaoi.InputError, match="cameras are 0 … 1"):
        stitched.image_matrix(camera, row)


def test_local_fiducials_place_their_components(recording: vaoi.RecordedRun, tmp_path: Path) -> None:
    """The data put a fiducial and the components beside it 0.18 mm (3 px) from where they are."""
    board = vaoi.read_board_type(recording.directory / "board.json")
    near = tuple(c.address for c in board.components if math.dist(c.center, (53.6, 35.6)) < 22)[:6]
    assert near
    document = board.model_dump(mode="json", exclude_none=True)
    for part in (*document["fiducials"][2:], *(c for c in document["components"] if c["ref"] in near)):
        if "center" in part:
            part["center"] = [part["center"][0] + 0.15, part["center"][1] - 0.1]
        else:
            part |= {"x": part["x"] + 0.15, "y": part["y"] - 0.1, "kind": "local", "components": near}
    changed = tmp_path / "board.json"
    changed.write_text(json.dumps(document))
    run = vaoi.open_recording(recording.directory, board_type=changed).stitch()
    assert run.status == vaoi.Status.OK, run.reasons
    assert set(run.result.local_matrices or ()) == set(near)
    for ref in run.refs:
        assert (np.array(run.component_matrix(ref)) == np.array(run.cad_matrix)).all() == (ref not in near)
    with pytest.raises(vaoi.NotFoundError):
        run.component_matrix("U99")
    assert run.result.quality["local_fiducials"][near[0]]["sigma_mm"] < 0.003
    assert run.result.quality["fiducial_check"]["fiducials"] == len(board.fiducials[:2])
    truth = json.loads((recording.directory / "truth.json").read_text())
    for ref in near:
        where = {(i, j): (x, y) for i, j, x, y in truth["views"][ref]}
        found = {(i, j): (x, y) for i, j, x, y in (run.result.components or {})[ref]}
        assert max(math.dist(found[key], where[key]) for key in found.keys() & where.keys()) < 0.1
        # The pictures are cut where the component is: the middle of each maps to its true place in the frame.
        for image in run.component(ref, min_coverage=1.0):
            middle = apply(image.crop_from_cad, np.array(run.center(ref)))
            there = apply(image.image_from_crop, middle)
            assert math.dist(there, where[image.camera, image.row]) < 0.1


def test_data_of_another_origin_are_corrected(stitched: vaoi.StitchedRun) -> None:
    board = stitched.board_type
    assert board is not None
    move = Move(False, 90.0, 1.0, (30.0, 20.0), (7.0, -2.0))
    checked = stitched.check_board_type(moved_board_type(board, move, ("components", "fiducials", "outline")))
    assert {"turned", "shifted", "fiducials-elsewhere"} <= {w.code for w in checked.report.warnings}
    assert checked.corrected is not None
    pairs = zip(checked.corrected.components, board.components, strict=True)
    assert max(math.dist(a.center, b.center) for a, b in pairs) < 0.02
    assert checked.picture.shape[2] == 3


def test_a_recording_is_never_overwritten(recording: vaoi.RecordedRun) -> None:
    with pytest.raises(vaoi.InputError, match="already holds a recording"):
        vaoi.simulate("small", recording.directory)


def test_a_negative_board_and_an_unknown_scenario_are_refused(tmp_path: Path) -> None:
    with pytest.raises(vaoi.InputError, match="board is -1"):
        vaoi.simulate("small", tmp_path, board=-1)
    with pytest.raises(vaoi.VaoiError, match="absent"):
        vaoi.simulate("absent", tmp_path)
    assert not list(tmp_path.iterdir()), "nothing is left behind"
