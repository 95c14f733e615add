"""One camera from synthetic detections; tests/calibration/test_array_calibration.py tests it on films."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.array_assignment import Assignment
from vaoi_station.calibration.camera_fit import CameraResult, Limits, calibrate_camera
from vaoi_station.calibration.mark_detection import DetectedMarks, MarkAppearance
from vaoi_station.calibration.mark_identification import Hypothesis
from vaoi_station.calibration.nominal_view import nominal_matrix
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

HEAD = CameraHead(width=480, height=360, exposure_us=1.0, nominal_center_mm=(0.0, 0.0), nominal_px_per_mm=20.0)
NOMINAL = nominal_matrix(HEAD, 0)
MARKS = np.stack(np.meshgrid(np.linspace(-9, 9, 5), np.linspace(-6, 6, 4)), -1).reshape(-1, 2)
APPEARANCE = MarkAppearance(24.0, 0.25, light=False)
PLAIN = np.full((360, 480), 180, np.uint8)


def detections(px: Floats, *, blur_px: float = 0.7, opposite: int = 0, contrast: float = 150.0) -> DetectedMarks:
    return DetectedMarks(px, np.full(len(px), 0.99), blur_px, (), opposite, contrast, PLAIN)


def solve(
    indices: list[int],
    *,
    offset: Floats | None = None,
    detected: DetectedMarks | None = None,
    appearance: MarkAppearance = APPEARANCE,
    limits: Limits | None = None,
    assignment: Assignment | None = None,
) -> CameraResult:
    """Calibrate from the given marks of the layout, with errors added to their exact positions."""
    px = apply(NOMINAL, MARKS[indices]) + (0 if offset is None else offset)
    pairs = np.column_stack([indices, np.arange(len(indices))]).astype(int).reshape(-1, 2)
    hypothesis = Hypothesis(NOMINAL, pairs, float(len(indices)), np.zeros(2))
    given = assignment or Assignment(hypothesis)
    return calibrate_camera(0, HEAD, detected or detections(px), given, MARKS, appearance, limits or Limits())


def _rivals(advantage: float, seen: float) -> Assignment:
    pairs = np.column_stack([np.arange(20)] * 2)
    options = [Hypothesis(NOMINAL, pairs, 60.0, np.array(offset)) for offset in [(0.2, 0.0), (3.2, 0.0)]]
    return Assignment(options[0], options[1], advantage, seen)


def test_marks_that_fit_the_layout_in_two_ways_are_refused_in_words() -> None:
    result = solve(list(range(20)), assignment=_rivals(2.0, 0.0))
    assert result.fit is None
    assert result.refusal == (
        "its marks fit the layout in two ways: shifted by (3.0, 0.0) mm it explains them as well, and "
        "nominal_center_mm is known to ± 2 mm only"
    )
    assert "--center-tolerance-mm" in result.action
    assert "(below 1.5 mm)" in result.action


def test_a_decision_by_the_nominal_view_alone_is_reported() -> None:
    result = solve(list(range(20)), assignment=_rivals(9.0, 0.0), limits=Limits(center_tolerance_mm=1.0))
    assert not result.refusal
    assert "good to ± 1 mm as stated, decided" in result.notes[0]
    assert solve(list(range(20)), assignment=_rivals(20.0, 12.0)).notes == ()


def test_the_accuracy_of_the_print_and_the_plane_is_part_of_the_corners() -> None:
    exact = solve(list(range(20))).corner_sigma_px
    printed = solve(list(range(20)), limits=Limits(mark_accuracy_mm=0.005))
    bowed = solve(list(range(20)), limits=Limits(working_distance_mm=300.0, flatness_mm=0.05))
    assert printed.corner_sigma_px > 10 * exact
    # Scale, twice perspective, and distortion: each 300 px · 0.05 mm / 300 mm at the corner.
    assert bowed.corner_sigma_px == pytest.approx(0.05 * np.sqrt(2 + 1), rel=0.05)


def test_more_foreign_marks_than_known_ones_are_refused() -> None:
    foreign = np.random.default_rng(3).uniform(50, 300, (30, 2))
    seen = detections(np.vstack([apply(NOMINAL, MARKS), foreign]))
    assert (
        "it shows 30 marks that are not in the layout, more than the 20 that are"
        in solve(list(range(20)), detected=seen).refusal
    )
