from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.model import BoardType, Component, Status, Stitch
from vaoi_station.model.known_height import known_height_mm


def board(**options: Any) -> BoardType:
    data = {"name": "b", "outline": [[0, 0], [40, 30]], "fiducials": []}
    return BoardType.model_validate(data | options)


def result(quality: dict[str, Any]) -> Stitch:
    return Stitch(
        method="test", image_matrices=(), cad_matrix=None, row_motion=(), status=Status.FAILED, quality=quality
    )


@pytest.mark.parametrize(
    ("height", "sigma", "expected"),
    [(1.2, 0.05, 1.2), (0.1, 0.05, 0.0), (1.2, 0.5, 0.0), (None, 0.1, 0.0), (1.0, None, 0.0)],
)
def test_a_measured_height_counts_if_it_is_sure(height: Any, sigma: Any, expected: float) -> None:
    stitch = result({"heights_mm": {"U1": height}, "height_sigma_mm": {"U1": sigma}})
    part = Component(ref="U1", center=(5, 5), width=2, height=2)
    assert known_height_mm(part, board(), stitch) == expected
    assert known_height_mm(part.model_copy(update={"body_height": 0.1}), board(unit="inch"), stitch) == 2.54
    assert known_height_mm(part, board(), result({})) == 0
