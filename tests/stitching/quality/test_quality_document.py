"""The quality document: its keys, its units, and agreement of its numbers with one another."""

from __future__ import annotations

import json
from typing import Any

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
