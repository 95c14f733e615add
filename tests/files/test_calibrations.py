"""Read and write calibrations."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.files.calibrations import read_layout, write_layout
from vaoi_station.files.documents import read_json
from vaoi_station.model import CameraHead

Write = Callable[..., Path]


def test_calibration_round_trips(tmp_path: Path, write: Write, calibration_document: dict[str, Any]) -> None:
    calibration = read_calibration(write(calibration_document), cameras=2)
    write_calibration(tmp_path / "again.json", calibration)
    assert read_json(tmp_path / "again.json") == calibration_document


def test_optional_keys_may_be_absent(tmp_path: Path, write: Write, calibration_document: dict[str, Any]) -> None:
    required = ("format", "version", "unit", "camera_matrices")
    bare = {k: calibration_document[k] for k in required}
    calibration = read_calibration(write(bare))
    camera = calibration.cameras((CameraHead(width=1392, height=1040, exposure_us=1.0),) * 2)[1]
    assert camera.lens.ideal
    assert camera.working_distance_mm is None
    assert camera.covariance_px2 is None
    write_calibration(tmp_path / "again.json", calibration)
    assert read_json(tmp_path / "again.json") == bare


def test_cameras_are_built_from_their_entries(write: Write, calibration_document: dict[str, Any]) -> None:
    calibration_document["distortion"][1] = {"center": [1, 2], "radius": 3, "radial": [0.5]}
    heads = (CameraHead(width=1392, height=1040, exposure_us=1.0), CameraHead(width=640, height=480, exposure_us=1.0))
    camera = read_calibration(write(calibration_document)).cameras(heads)[1]
    assert (camera.width_px, camera.height_px) == (640, 480)
    assert (camera.lens.center_px, camera.lens.radius_px, camera.lens.radial) == ((1, 2), 3, (0.5,))
    assert camera.principal_point_px == pytest.approx((690, 520))
    assert camera.working_distance_mm == pytest.approx(483)
    np.testing.assert_array_equal(camera.image_from_row.matrix, calibration_document["camera_matrices"][1])
    assert camera.covariance_px2 is not None
    np.testing.assert_array_equal(camera.covariance_px2, calibration_document["covariance"][1])


def test_calibration_of_another_array_is_refused(write: Write, calibration_document: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="camera_matrices has 2 entries, but 3 cameras were filming"):
        read_calibration(write(calibration_document), cameras=3)


MATRIX = [[40.0, 0, 600], [0, 40, 500], [0, 0, 1]]


@pytest.mark.parametrize(
    ("matrix", "complaint"),
    [
        ([[1, 2, 3], [4, 5, 6]], r"has shape \(2, 3\), must be 3×3"),
        ([[1, 2, 3], [4, 5], [6]], "has rows of different lengths"),
        ([["40", "0", "1"], ["0", "40", "1"], ["0", "0", "1"]], "not a matrix of numbers"),
        ([[1, 0, None], [0, 1, 0], [0, 0, 1]], "not a matrix of numbers"),
        ([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "is singular"),
        ([[0.1, 0.2, 3], [0.3, 0.6, 6], [0, 0, 1]], "is singular"),
        ([[0, 0, 0], [0, 1, 0], [0, 0, 1]], "is singular"),
        ([[0, 0, 5], [0, 1, 0], [0, 0, 1]], "is singular"),
    ],
)
def test_faulty_matrices_are_refused_with_their_index(
    write: Write, calibration_document: dict[str, Any], matrix: Any, complaint: str
) -> None:
    calibration_document["camera_matrices"][1] = matrix
    with pytest.raises(InputError, match=rf"camera_matrices\.1: {complaint}|camera_matrices\.1: is {complaint}"):
        read_calibration(write(calibration_document))


def test_nan_in_a_matrix_is_refused_with_its_index(write: Write, calibration_document: dict[str, Any]) -> None:
    calibration_document["camera_matrices"][0][1][2] = float("nan")
    with pytest.raises(InputError, match=r"document\.json: camera_matrices\.0\.1\.2 is nan, but must be a finite"):
        read_calibration(write(calibration_document))


@pytest.mark.parametrize(
    ("matrix", "complaint"),
    [
        ((np.eye(3) * 1e-9).tolist(), "gives camera 1 a resolution of 1 px/mm, .* within a factor of 4 of the array's"),
        ([[1e-3, 0, 6], [0, 1e-3, 5], [0, 0, 1]], "of 0.001 px/mm, but it must be between 0.05 and 5000 px/mm"),
        ([[1e5, 0, 6], [0, 1e5, 5], [0, 0, 1]], r"of 1e\+05 px/mm, but it must be between 0.05 and 5000 px/mm"),
        ([[40.0, 0, 600], [0, -40, 500], [0, 0, 1]], "has a determinant of the other sign than most: camera 1 mirrors"),
    ],
)
def test_impossible_view_is_refused(
    write: Write, calibration_document: dict[str, Any], matrix: Any, complaint: str
) -> None:
    calibration_document = {k: calibration_document[k] for k in ("format", "version", "unit")}
    calibration_document["camera_matrices"] = [MATRIX, matrix, MATRIX]
    with pytest.raises(InputError, match=rf"document\.json: camera_matrices\.1 .*{complaint}"):
        read_calibration(write(calibration_document))


def _head(nominal: float | None) -> CameraHead:
    return CameraHead(width=1392, height=1040, exposure_us=1.0, nominal_px_per_mm=nominal)


@pytest.mark.parametrize("nominal", [26.0, 61.0, 4.0, 1e-3, 1e6])
def test_resolution_far_from_the_nominal_one_is_refused(
    write: Write, calibration_document: dict[str, Any], nominal: float
) -> None:
    document = {k: calibration_document[k] for k in ("format", "version", "unit")}
    document["camera_matrices"] = [MATRIX, MATRIX]
    complaint = (
        rf"document\.json: camera_matrices\.1 gives camera 1 a resolution of 40 px/mm in the middle of its frame, "
        rf"but it must be within a factor of 1\.5 of its nominal_px_per_mm, {re.escape(f'{nominal:.4g}')}"
    )
    with pytest.raises(InputError, match=complaint):
        read_calibration(write(document), [_head(40.0), _head(nominal)])


def test_single_camera_is_checked_against_its_nominal_resolution(
    write: Write, calibration_document: dict[str, Any]
) -> None:
    document = {k: calibration_document[k] for k in ("format", "version", "unit")}
    document["camera_matrices"] = [(np.eye(3) * 1e-9).tolist()]  # a homography's scale is free: this is 1 px/mm
    read_calibration(write(document), 1)
    with pytest.raises(InputError, match=r"a resolution of 1 px/mm .* nominal_px_per_mm, 40\."):
        read_calibration(write(document), [_head(40.0)])


@pytest.mark.parametrize("nominal", [None, 27.0, 40.0, 59.0])
def test_resolution_near_the_nominal_one_or_without_one_is_accepted(
    write: Write, calibration_document: dict[str, Any], nominal: float | None
) -> None:
    document = {k: calibration_document[k] for k in ("format", "version", "unit")}
    document["camera_matrices"] = [MATRIX]
    assert len(read_calibration(write(document), [_head(nominal)]).camera_matrices) == 1


@pytest.mark.parametrize("scale", [1e-7, -1.0, 1e5])
def test_scale_of_a_homography_does_not_matter(
    write: Write, calibration_document: dict[str, Any], scale: float
) -> None:
    calibration_document["camera_matrices"][0] = (scale * np.array(MATRIX)).tolist()
    assert read_calibration(write(calibration_document)).camera_matrices[0][2, 2] == pytest.approx(scale)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"version": 2}, "version is 2, but must be 1. Use a newer"),
        ({"format": "calib"}, "format is 'calib', but must be 'vaoi-calibration'"),
        ({"unit": "inch"}, r"unit: .*'mm' \(given: 'inch'\)"),
        ({"camera_matrices": []}, "camera_matrices: "),
        ({"working_distance_mm": 0}, r"working_distance_mm: .*greater than or equal to 1 \(given: 0\)"),
        ({"working_distance_mm": True}, r"working_distance_mm: .*valid number \(given: True\)"),
        ({"residual_px": [0.1]}, "residual_px has 1 entries, must have one per camera: 2"),
        ({"principal_point": [[1, 2]] * 3}, "principal_point has 3 entries"),
        ({"distortion": []}, "distortion has 0 entries"),
        (
            {"distortion": [{"center": [0, 0], "radius": 0, "radial": []}] * 2},
            r"distortion\.0\.radius: .*greater than or equal to 1",
        ),
        ({"distortion": [{"center": [0, 0], "radius": 1, "radial": [], "k": 1}] * 2}, r"distortion\.0: unknown key"),
        ({"workingdistance": 483}, r"unknown key\(s\) 'workingdistance'; own keys must begin with 'x_'"),
    ],
)
def test_faulty_documents_are_refused_with_file_and_key(
    write: Write, calibration_document: dict[str, Any], change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}"):
        read_calibration(write(calibration_document | change))


@pytest.fixture
def document() -> dict[str, Any]:
    """Four crosses."""
    return {
        "unit": "inch",
        "mark": {"shape": "cross", "size": 0.08, "width": 0.02, "polarity": "light"},
        "marks": [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}, {"x": 0.0, "y": 1.0}, {"x": 1.0, "y": 1.0}],
        "x_serial": "KB-7",
    }


def test_a_layout_round_trips(tmp_path: Path, write: Write, document: dict[str, Any]) -> None:
    layout = read_layout(write(document))
    assert layout.mm_per_unit == pytest.approx(25.4)
    write_layout(tmp_path / "layout.json", layout)
    assert read_json(tmp_path / "layout.json") == document


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"unit": "cm"}, r"unit: .*\(given: 'cm'\)"),
        ({"mark": {"shape": "dot", "size": 1, "width": 1}}, r"mark\.shape: "),
        ({"mark": {"size": 1, "width": 0}}, r"mark\.width: .*greater than 0"),
        ({"marks": [{"x": 0, "y": 0}] * 3}, "marks: .*at least 4"),
        ({"origin": 0}, r"unknown key\(s\) 'origin'"),
    ],
)
def test_faulty_layouts_are_refused(
    write: Write, document: dict[str, Any], change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}"):
        read_layout(write(document | change))
