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


def test_every_kind_of_point_is_counted(quality: Any) -> None:
    assert set(quality["links"]) == {"rows", "neighbours", "fiducials", "fixture", "reference"}
    for count in quality["links"].values():
        assert 0 <= count["used"] <= count["found"]
    assert quality["links"]["rows"]["used"] > 100
    assert quality["links"]["fixture"] == {"found": 0, "used": 0}


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


def test_fiducials_are_listed_in_the_order_of_the_board_type(quality: Any, filmed: Any) -> None:
    assert [f["name"] for f in quality["fiducials"]] == [f.name for f in filmed.board_type.fiducials]
    assert sum(f["sightings"] for f in quality["fiducials"]) == quality["links"]["fiducials"]["found"]
    for fiducial in quality["fiducials"]:
        assert np.hypot(*fiducial["residual_px"]) < 0.1


def test_the_check_of_the_fiducials_counts_what_is_redundant(quality: Any, filmed: Any) -> None:
    check = quality["fiducial_check"]
    seen = sum(f["sightings"] > 0 for f in quality["fiducials"])
    assert (check["fiducials"], check["redundant"]) == (seen, 2 * seen - 4)
    assert not check["other_points"]
    assert check["unnoticed_mm"] is None or (seen == 2 and 0 < check["unnoticed_mm"] < 1)


def test_row_0_has_no_uncertainty(quality: Any) -> None:
    assert not np.array(quality["row_covariance"][0]).any()
    assert all(camera[0] == [0, 0] for camera in quality["matrix_sigma_px"])
    for covariance in quality["row_covariance"][1:]:
        assert np.linalg.eigvalsh(covariance).min() > 0


def test_component_sigmas_are_those_of_their_covariances(quality: Any) -> None:
    for ref, views in quality["component_covariance_px2"].items():
        worst = max(np.sqrt(np.linalg.eigvalsh([[xx, xy], [xy, yy]])[-1]) for _, _, xx, xy, yy in views)
        assert quality["component_sigma_px"][ref] == pytest.approx(worst, abs=2e-4)


def test_the_belt_is_measured(quality: Any) -> None:
    belt = quality["belt"]
    ratio = np.hypot(*belt["measured_mm_s"]) / np.hypot(*belt["nominal_mm_s"])
    assert belt["speed_error"] == pytest.approx(ratio - 1, abs=1e-5)


def test_a_row_without_frames_has_no_matrix_sigma(filmed: Any) -> None:
    frames = {key: p for key, p in filmed.frames.items() if key[1] != 3}
    sigmas = filmed.stitched(frames=frames).quality["matrix_sigma_px"]
    assert all(camera[3] is None and camera[4] is not None for camera in sigmas)


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
