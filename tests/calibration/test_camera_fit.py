"""One camera from synthetic detections; tests/calibration/test_array_calibration.py tests it on films."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from vaoi_station.calibration.array_assignment import Assignment
from vaoi_station.calibration.camera_fit import CameraResult, Limits, calibrate_camera
from vaoi_station.calibration.mark_detection import DetectedMarks, MarkAppearance
from vaoi_station.calibration.mark_identification import Hypothesis
from vaoi_station.calibration.nominal_view import nominal_matrix
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.marks.blur import BLUR_LIMIT_PX
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


def test_exact_marks_give_the_exact_matrix() -> None:
    result = solve(list(range(20)))
    assert not result.refusal
    assert result.used == 20
    assert result.notes == ()
    assert result.fit is not None
    np.testing.assert_allclose(result.fit.matrix, NOMINAL, atol=1e-8)
    assert 0 < result.corner_sigma_px < 0.05


def test_a_displaced_mark_is_left_out_with_a_warning() -> None:
    offset = np.random.default_rng(1).normal(0, 0.004, (20, 2))
    offset[7] += 1.5
    result = solve(list(range(20)), offset=offset)
    assert not result.refusal
    assert result.used == 19
    (note,) = result.notes
    assert "is inconsistent with the others; not used" in note
    assert [m.index for m in result.marks if not m.used] == [7]


def test_a_mark_that_is_not_in_the_frame_is_reported_with_its_place() -> None:
    result = solve([k for k in range(20) if k != 3])
    assert not result.refusal
    found = re.match(r"the mark expected at \((\d+), (\d+)\) px is not found", result.notes[0])
    assert found is not None, result.notes[0]
    assert [int(v) for v in found.groups()] == pytest.approx(apply(NOMINAL, MARKS[3]), abs=1)


def test_four_marks_are_accepted_with_a_warning() -> None:
    layout = [0, 4, 15, 19]
    result = calibrate_camera(
        0,
        HEAD,
        detections(apply(NOMINAL, MARKS[layout])),
        Assignment(Hypothesis(NOMINAL, np.array([[k, k] for k in range(4)]), 4.0, np.zeros(2))),
        MARKS[layout],
        APPEARANCE,
        Limits(),
    )
    assert not result.refusal
    assert "four marks determine N without redundancy" in result.notes[0]
    said = re.fullmatch(
        r"four marks do not determine the lens: ± (\d\.\d) px at the corners \(1 σ\); film 9 or more marks",
        result.notes[1],
    )
    assert said is not None, result.notes
    assert float(said[1]) == pytest.approx(result.corner_sigma_px, abs=0.05)
    assert not result.lens_known


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


def test_a_view_far_off_its_nominal_centre_is_reported() -> None:
    result = solve(list(range(20)), limits=Limits(center_tolerance_mm=0.01), assignment=_rivals(20.0, 12.0))
    assert "its view lies 0.2 mm off nominal_center_mm, more than the stated ± 0.01 mm" in result.notes


def test_the_accuracy_of_the_print_and_the_plane_is_part_of_the_corners() -> None:
    exact = solve(list(range(20))).corner_sigma_px
    printed = solve(list(range(20)), limits=Limits(mark_accuracy_mm=0.005))
    bowed = solve(list(range(20)), limits=Limits(working_distance_mm=300.0, flatness_mm=0.05))
    assert printed.corner_sigma_px > 10 * exact
    # Scale, twice perspective, and distortion: each 300 px · 0.05 mm / 300 mm at the corner.
    assert bowed.corner_sigma_px == pytest.approx(0.05 * np.sqrt(2 + 1), rel=0.05)


@pytest.mark.parametrize(
    ("change", "reason", "action"),
    [
        ({"contrast": 9.0}, "a contrast of 9 grey levels, at least 20 are needed", "Check light"),
        ({"blur_px": BLUR_LIMIT_PX + 1}, r"blurred by 3\.0 px \(sigma\), the limit is 2\.0 px", "Focus the lens"),
    ],
)
def test_unusable_frames_are_refused_with_value_limit_and_remedy(
    change: dict[str, float], reason: str, action: str
) -> None:
    result = solve(list(range(20)), detected=detections(apply(NOMINAL, MARKS), **change))  # type: ignore[arg-type]
    assert math.isnan(result.corner_sigma_px)
    assert result.fit is None
    assert re.search(reason, result.refusal)
    assert result.action.startswith(action)


def test_marks_of_the_opposite_brightness_suggest_the_wrong_polarity() -> None:
    result = solve([], detected=detections(np.zeros((0, 2)), opposite=20))
    assert result.refusal == "it shows 20 marks of the opposite brightness and 0 of the layout's polarity"
    assert result.action == "Correct mark.polarity in layout.json, on the page “Light marks on a dark board”."


@pytest.mark.parametrize("size_px", [7.0, 200.0])
def test_marks_of_an_impossible_size_suggest_a_wrong_unit(size_px: float) -> None:
    result = solve(list(range(20)), appearance=MarkAppearance(size_px, 0.25, light=False))
    assert f"{size_px:.0f} px large in its frame, but must be 8 … 180 px" in result.refusal


def test_large_residuals_are_refused_by_the_limit() -> None:
    offset = np.random.default_rng(2).normal(0, 0.6, (20, 2))
    refused = solve(list(range(20)), offset=offset)
    assert "px (rms, 20 marks), the limit is 0.20 px" in refused.refusal
    assert not solve(list(range(20)), offset=offset, limits=Limits(residual_px=5.0)).refusal


def test_more_foreign_marks_than_known_ones_are_refused() -> None:
    foreign = np.random.default_rng(3).uniform(50, 300, (30, 2))
    seen = detections(np.vstack([apply(NOMINAL, MARKS), foreign]))
    assert (
        "it shows 30 marks that are not in the layout, more than the 20 that are"
        in solve(list(range(20)), detected=seen).refusal
    )
