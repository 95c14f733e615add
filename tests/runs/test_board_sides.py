"""Runs of top and bottom are one board; what is missing or contradicts is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry.transforms import Similarity, System
from vaoi_station.model import Status
from vaoi_station.runs.board_sides import BoardDocument, BoardSide, join_sides


def side(name: str, turn_deg: float = 0.0, **fields: Any) -> BoardSide:
    """Return a side as it was filmed: the bottom is seen mirrored, flipped about the tester's y axis."""
    turn, bottom = np.radians(turn_deg), name == "bottom"
    matrix = Similarity.of(1.0, turn, (9, 9), System.TESTER, System.CAD, mirrored=bottom).matrix
    known = {
        "side": name, "run": name, "address": f"/api/v1/runs/{name}", "board_type": f"b-{name}", "verdict": "ok",
        "started": "2026-11-29T10:20:00.000Z" if bottom else "2026-11-29T10:00:00.000Z", "components": 3,
        "extent_mm": ((0.0, 0.0), (60.0, 40.0)), "cad_matrix": tuple(map(tuple, matrix.tolist())),
    }  # fmt: skip
    return BoardSide.model_validate({**known, **fields})


def codes(document: BoardDocument) -> list[str]:
    return [reason.code for reason in document.reasons]


@pytest.mark.parametrize(("turn_deg", "axis_deg"), [(0.0, 0.0), (180.0, 90.0), (3.0, 1.5)])
def test_two_sides_that_agree_are_one_board_with_the_axis_of_its_flip(turn_deg: float, axis_deg: float) -> None:
    found = join_sides("SN-1", [side("bottom", turn_deg), side("top")], 3600.0)
    assert (found.status, found.reasons) == (Status.OK, ())
    assert found.top is not None
    assert found.bottom is not None
    assert found.flip_axis_deg == pytest.approx(axis_deg, abs=1e-6)


def test_a_missing_side_is_said_also_if_it_was_filmed_too_early() -> None:
    assert codes(join_sides("SN-1", [side("top")], 3600.0)) == ["side-missing"]
    late = join_sides("SN-1", [side("bottom"), side("top")], 600.0)
    assert codes(late) == ["side-missing"]
    assert late.top is None


def test_the_newest_run_of_a_side_counts() -> None:
    again = side("top", run="again", started="2026-11-29T10:10:00.000Z", verdict="degraded")
    found = join_sides("SN-1", [side("bottom"), again, side("top")], 3600.0)
    assert found.top is not None
    assert found.top.run == "again"
    assert (found.status, codes(found)) == (Status.DEGRADED, ["side-not-ok"])


@pytest.mark.parametrize(
    ("fields", "code", "status"),
    [
        ({"verdict": "failed"}, "side-not-ok", Status.FAILED),
        ({"verdict": None}, "side-not-ok", Status.DEGRADED),
        ({"identity": "differs"}, "side-of-other-board", Status.DEGRADED),
        ({"extent_mm": ((0.0, 0.0), (60.0, 43.0))}, "sides-differ", Status.DEGRADED),
        ({"cad_matrix": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))}, "sides-not-flipped", Status.DEGRADED),
        ({"turn_deg": 80.0}, "sides-not-flipped", Status.DEGRADED),
    ],
)
def test_a_side_that_contradicts_is_said(fields: dict[str, Any], code: str, status: Status) -> None:
    found = join_sides("SN-1", [side("bottom", **fields), side("top")], 3600.0)
    assert (codes(found), found.status) == ([code], status)


def test_without_a_cad_mapping_the_flip_is_not_known() -> None:
    found = join_sides("SN-1", [side("bottom", cad_matrix=None), side("top")], 3600.0)
    assert found.flip_axis_deg is None
