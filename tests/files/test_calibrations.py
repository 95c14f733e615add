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


def test_calibration_of_another_array_is_refused(write: Write, calibration_document: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="camera_matrices has 2 entries, but 3 cameras were filming"):
        read_calibration(write(calibration_document), cameras=3)


MATRIX = [[40.0, 0, 600], [0, 40, 500], [0, 0, 1]]


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


@pytest.mark.parametrize("nominal", [26.0, 61.0])
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


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"version": 2}, "version is 2, but must be 1. Use a newer"),
        ({"working_distance_mm": 0}, r"working_distance_mm: .*greater than or equal to 1 \(given: 0\)"),
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
        ({"marks": [{"x": 0, "y": 0}] * 3}, "marks: .*at least 4"),
        ({"origin": 0}, r"unknown key\(s\) 'origin'"),
    ],
)
def test_faulty_layouts_are_refused(
    write: Write, document: dict[str, Any], change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}"):
        read_layout(write(document | change))
