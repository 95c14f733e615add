"""The quality document: its keys, its units, and agreement of its numbers with one another."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

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


def test_every_pair_of_frames_states_its_links(quality: Any, filmed: Any) -> None:
    pairs, kinds = quality["link_pairs"], quality["links"]
    assert sum(p["found"] for p in pairs) == kinds["rows"]["found"] + kinds["neighbours"]["found"]
    assert sum(p["used"] for p in pairs) == kinds["rows"]["used"] + kinds["neighbours"]["used"]
    tester_from_cad = np.array(filmed.stitch.cad_matrix)
    low, high = filmed.board_type.extent()
    for pair in pairs:
        x, y, _ = np.linalg.inv(tester_from_cad) @ (*pair["at_mm"], 1)
        assert (low <= (x, y)).all(), "links lie on the board"
        assert ((x, y) <= high).all()
        assert np.hypot(*pair["residual_px"]) <= pair["rms_px"] + 1e-4


def test_the_check_of_the_fiducials_counts_what_is_redundant(quality: Any, filmed: Any) -> None:
    check = quality["fiducial_check"]
    seen = sum(f["sightings"] > 0 for f in quality["fiducials"])
    assert (check["fiducials"], check["redundant"]) == (seen, 2 * seen - 4)
    assert not check["other_points"]
    assert check["unnoticed_mm"] is None or (seen == 2 and 0 < check["unnoticed_mm"] < 1)


def test_component_sigmas_are_those_of_their_covariances(quality: Any) -> None:
    for ref, views in quality["component_covariance_px2"].items():
        worst = max(np.sqrt(np.linalg.eigvalsh([[xx, xy], [xy, yy]])[-1]) for _, _, xx, xy, yy in views)
        assert quality["component_sigma_px"][ref] == pytest.approx(worst, abs=2e-4)


def test_without_a_board_type_numbers_of_the_board_are_none_or_empty(filmed: Any) -> None:
    quality = replace(filmed, setup=replace(filmed.setup, board_type=None)).stitched().quality
    assert set(quality) >= KEYS
    for key in (
        "scale_error",
        "fiducial_check",
        "outline_contrast",
        "outline_shift_mm",
        "cad_sigma_px",
        "surface_sigma_mm",
    ):
        assert quality[key] is None, key
    for key in ("fiducials", "component_sigma_px", "component_covariance_px2", "heights_mm"):
        assert not quality[key], key
