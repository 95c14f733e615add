"""One camera from synthetic detections; tests/calibration/test_array_calibration.py tests it on films."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from vaoi_station.calibration.camera_fit import BLUR_LIMIT_PX, CameraResult, Limits, calibrate_camera
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
) -> CameraResult:
    """Calibrate from the given marks of the layout, with errors added to their exact positions."""
    px = apply(NOMINAL, MARKS[indices]) + (0 if offset is None else offset)
    pairs = np.column_stack([indices, np.arange(len(indices))]).astype(int).reshape(-1, 2)
    hypothesis = Hypothesis(NOMINAL, pairs, float(len(indices)), np.zeros(2))
    return calibrate_camera(0, HEAD, detected or detections(px), hypothesis, MARKS, appearance, limits or Limits())


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
        Hypothesis(NOMINAL, np.array([[k, k] for k in range(4)]), 4.0, np.zeros(2)),
        MARKS[layout],
        APPEARANCE,
        Limits(),
    )
    assert not result.refusal
    assert "four marks determine N without redundancy" in result.notes[-1]


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
    assert result.action == "Correct mark.polarity in layout.json."


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
