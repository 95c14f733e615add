"""The quality document: its keys, its units, and agreement of its numbers with one another."""

from __future__ import annotations

import json
from typing import Any

import pytest

from vaoi_station.model import BoardType, Status

KEYS = {
    "links",
    "unlinked",
    "link_pairs",
    "residual_px",
    "seams_px",
    "fiducials",
    "scale_error",
    "fiducial_check",
    "outline_contrast",
    "outline_shift_mm",
    "row_sigma_px",
    "cad_sigma_px",
    "component_sigma_px",
    "pivot_mm",
    "row_covariance",
    "matrix_sigma_px",
    "component_covariance_px2",
    "surface_sigma_mm",
    "heights_mm",
    "height_sigma_mm",
    "belt",
}


@pytest.fixture(scope="module")
def quality(filmed: Any) -> Any:
    return filmed.stitch.quality


def test_the_document_has_the_keys_of_the_format(quality: Any) -> None:
    assert set(quality) >= KEYS
    assert json.loads(json.dumps(quality)) == quality, "plain JSON, without NaN"


def test_a_board_that_was_not_found_has_the_places_that_look_like_fiducials(filmed: Any) -> None:
    """They are those of the fiducials on the board, which lie elsewhere than its data say."""
    stated = filmed.board_type.model_dump(mode="json", exclude_none=True)
    apart = [mark | {"x": 0.7 * mark["x"], "y": 0.8 * mark["y"]} for mark in stated["fiducials"]]
    lost = filmed.stitched(board_type=BoardType.model_validate(stated | {"fiducials": apart}))
    assert lost.status is Status.FAILED
    places = lost.quality["fiducial_places"]
    assert [place["score"] for place in places] == sorted((place["score"] for place in places), reverse=True)
    camera = filmed.setup.cameras[0]
    assert places[0]["frame_px"] == [camera.width_px, camera.height_px]
    assert 0.8 < places[0]["score"] <= 1
    assert "fiducial_places" not in filmed.stitch.quality
