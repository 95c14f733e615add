"""Turned boards, other board types, missing boards: a result with verdict ok never has wrong positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import open_recording, read_board_type, read_calibration
from vaoi_station.files.images import read_image, write_image
from vaoi_station.model import BoardType, Status

pytestmark = pytest.mark.cases


def rotated_cad(board_type: BoardType) -> BoardType:
    """Return the board type rotated by 180° about the middle of its outline.

    A recording of the board then shows a board that lies turned by 180°.
    """
    low, high = board_type.extent()
    x, y = (low + high).tolist()
    data = board_type.model_dump(mode="json", exclude_none=True)
    data["outline"] = [[x - a, y - b] for a, b in data["outline"]]
    for mark in (*data["fiducials"], *data.get("fixture_marks", ())):
        mark["x"], mark["y"] = x - mark["x"], y - mark["y"]
    for part in data["components"]:
        part["center"] = [x - part["center"][0], y - part["center"][1]]
        part["rotation"] += 180.0
    return BoardType.model_validate(data)


@pytest.mark.parametrize("name", ["paper-1", "ulx3s-top", "sparse", "dark", "repetitive", "fixture"])
def test_board_turned_by_180_degrees_is_refused(cases: Any, name: str) -> None:
    board_type = rotated_cad(read_board_type(cases(name) / "board.json"))
    result = cases.stitch(cases(name), board_type=board_type)
    assert result.status is Status.FAILED
    assert "turned" in result.reasons[0]
    assert result.cad_matrix is None
    assert result.components is None
    assert all(m is not None for rows in result.image_matrices for m in rows), "the frames are placed nevertheless"


@pytest.mark.parametrize(
    ("filmed", "claimed"),
    [("ulx3s-top", "sparse"), ("ulx3s-top", "paper-1"), ("sparse", "ulx3s-top"), ("paper-1", "dark"), ("dark", "hdr")],
)
def test_a_board_of_another_type_is_refused(cases: Any, filmed: str, claimed: str) -> None:
    result = cases.stitch(cases(filmed), board_type=read_board_type(cases(claimed) / "board.json"))
    assert result.status is Status.FAILED
    assert result.cad_matrix is None
    assert repr(claimed) in result.reasons[0]


def test_a_bent_board_without_working_distance_is_degraded_by_its_seam(cases: Any) -> None:
    calibration = read_calibration(cases("warped") / "calibration.json")
    without_distance = calibration.model_copy(update={"working_distance_mm": None})
    result = cases.stitch(cases("warped"), calibration=without_distance)
    assert result.status is Status.DEGRADED
    assert result.surface is None
    assert any("its height is not estimated" in r for r in result.reasons), result.reasons
    assert cases.score("warped", result)["cad_px"]["max"] > 0.3, "the error is large enough for a reason"


def test_a_run_without_a_board_fails_with_a_reason(cases: Any, tmp_path: Path) -> None:
    case = cases.copied("sparse", tmp_path / "empty")
    g = np.random.default_rng(5)
    for path in sorted((case / "frames").iterdir()):
        dark = g.normal(12, 2, read_image(path).shape)
        write_image(path, np.clip(np.round(dark), 0, 255).astype(np.uint8), level=0)
    result = cases.stitch(case)
    assert result.status is Status.FAILED
    assert result.cad_matrix is None
    assert "no texture was found in any frame: is there a board?" in result.reasons
    assert any("fiducials of 'sparse' are not where they should be" in r for r in result.reasons)
    assert result.quality["belt"]["measured_mm_s"] is None


def test_black_frames_of_one_camera_leave_the_other_views_correct(cases: Any, tmp_path: Path) -> None:
    case = cases.copied("ulx3s-top", tmp_path / "black")
    rows = open_recording(case).head.rows
    for row in range(rows):
        path = case / "frames" / f"c01_r{row:03d}.png"
        write_image(path, np.zeros_like(read_image(path)), level=0)
    result = cases.stitch(case)
    assert result.status is not Status.FAILED
    assert cases.score("ulx3s-top", result)["cad_px"]["max"] <= 1.0
