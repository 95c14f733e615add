"""Reasons for rows whose distance from the others only the belt's nominal speed gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import Status
from vaoi_station.stitching.quality.verdict import decide_verdict


def test_unconnected_rows_are_a_reason(filmed: Any) -> None:
    """Two blank rows: only the belt gives the distance of the second half from the first, and belts stop."""
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    assert any("no links connect the rows 0–3 with the rows" in r for r in result.reasons), result.reasons
    assert any("other rows are not placed: film the board again" in r for r in result.reasons), result.reasons
    assert result.quality["unplaced_rows"] == [0, 1, 2, 3]
    assert [m is not None for m in result.image_matrices[0]] == [False] * 4 + [True] * 2
    assert result.components is not None
    assert {row for views in result.components.values() for _, row, *_ in views} <= {4, 5}


@pytest.mark.parametrize("lost", [(1, 2), (2, 3), (3, 4)])
def test_lost_rows_are_blamed_before_the_fiducials(filmed: Any, lost: tuple[int, ...]) -> None:
    """Rows beside the gap do not overlap: only the belt's speed, here wrong by 3 %, places one part by the other."""
    there = {key: p for key, p in filmed.frames.items() if key[1] not in lost}
    slow = tuple(0.97 * v for v in filmed.setup.conveyor_mm_s)
    reasons = decide_verdict(findings_of(filmed, there, conveyor_mm_s=slow))[1]
    assert reasons[0].code == "rows-lost", reasons
    assert f"of rows {', '.join(map(str, lost))}" in reasons[0].text
