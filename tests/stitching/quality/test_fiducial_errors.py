"""An error of one of three fiducials: the others contradict it, whatever the residuals look like."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, Status
from vaoi_station.stitching.adjustment.problem import FIXTURE
from vaoi_station.stitching.quality.agreement import contradiction_reasons
from vaoi_station.stitching.work import TaskRunner


def moved(filmed: Any, which: int, off_mm: tuple[float, float]) -> BoardType:
    """The board type with a fiducial beside its place."""
    data = filmed.board_type.model_dump(mode="json", exclude_none=True)
    data["fiducials"][which]["x"] += off_mm[0]
    data["fiducials"][which]["y"] += off_mm[1]
    return BoardType.model_validate(data)


@pytest.mark.parametrize(
    ("which", "off_mm"), [(0, (0.0, 0.05)), (0, (0.0, -0.05)), (1, (0.035, 0.035)), (1, (-0.035, -0.035))]
)
def test_an_error_of_which_little_is_left_in_the_residuals_is_a_reason(
    filmed: Any, which: int, off_mm: tuple[float, float]
) -> None:
    """No fiducial lies 0.3 px from its place, and scale and surface are likely: positions were wrong, and `ok`."""
    result = filmed.stitched(board_type=moved(filmed, which, off_mm))
    assert result.status is Status.DEGRADED
    text, uncertain = result.reasons
    assert "without one of the marks that place the board" in uncertain, "whichever of them it is"
    assert text.startswith("the fiducials do not fit together: FID")
    assert f"FID{which + 1} by 0.05 mm" in text
    assert filmed.error_px(result) > 0.5


def test_fiducials_within_the_tolerance_of_artwork_are_no_reason(filmed: Any) -> None:
    for which in range(3):
        result = filmed.stitched(board_type=moved(filmed, which, (0.006, -0.006)))
        assert result.status is Status.OK, result.reasons
        assert filmed.error_px(result) < 0.3


def test_two_fiducials_and_other_points_are_left_to_other_checks(filmed: Any) -> None:
    runner = TaskRunner(filmed.setup, filmed.frame)
    evidence = [runner.perform(task) for task in filmed.tasks]
    findings = runner.conclude_with_findings(filmed.times_s, filmed.present, evidence)[1]
    plane, adjusted = findings.plane, findings.adjusted
    points = adjusted.problem.fiducials
    assert plane is not None
    assert points is not None
    far = replace(adjusted, fiducial_px=np.full((len(points.which), 2), 0.2))
    two = np.flatnonzero(points.which < 2)
    assert contradiction_reasons(plane, adjusted, points, 10.0) == []
    assert contradiction_reasons(plane, adjusted, None, 10.0) == []
    assert contradiction_reasons(plane, replace(adjusted, similarity=None), points, 10.0) == []
    few = replace(far, fiducial_px=far.fiducial_px[two])
    assert contradiction_reasons(plane, few, points.select(two), 10.0) == []
    fixed = replace(points, which=np.where(points.which == 2, FIXTURE, points.which))
    assert contradiction_reasons(plane, far, fixed, 10.0) == []
    # Residuals that leave no fiducial far from where the others put it are no reason either.
    assert contradiction_reasons(plane, far, points, 10.0) == []
