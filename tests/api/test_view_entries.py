"""Views of components as response models."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qs

import numpy as np
import pytest

from tests.api.held_station import HeldStation
from vaoi_station.api.view_entries import DEFAULT_COVERAGE, covariances, picture_query, view_entry


def test_covariances_are_symmetric_and_keyed_by_frame() -> None:
    quality: dict[str, Any] = {"component_covariance_px2": {"U1": [[0, 3, 0.01, 0.002, 0.04]]}}
    assert covariances(quality, "U1") == {(0, 3): ((0.01, 0.002), (0.002, 0.04))}


@pytest.mark.parametrize("quality", [{}, {"component_covariance_px2": {}}, {"component_covariance_px2": {"R1": []}}])
def test_without_covariances_there_are_none(quality: dict[str, Any]) -> None:
    assert covariances(quality, "U1") == {}


@pytest.mark.parametrize(
    ("px_per_mm", "min_coverage", "expected"),
    [
        (None, DEFAULT_COVERAGE, {}),
        (20.0, DEFAULT_COVERAGE, {"px_per_mm": ["20.0"]}),
        (None, 1.0, {"min_coverage": ["1.0"]}),
        (8.5, 0.25, {"px_per_mm": ["8.5"], "min_coverage": ["0.25"]}),
    ],
)
def test_the_query_repeats_what_differs_from_the_defaults(
    px_per_mm: float | None, min_coverage: float, expected: dict[str, list[str]]
) -> None:
    assert parse_qs(picture_query(px_per_mm, min_coverage).removeprefix("?")) == expected


def test_an_entry_describes_its_view_and_frame(station: HeldStation) -> None:
    run = station.film()
    view = station.views(run, "U1", None, DEFAULT_COVERAGE)[0]
    frame = next(f for f in station.run(run).frames if (f.camera, f.row) == (view.camera, view.row))
    covariance = ((0.01, 0.0), (0.0, 0.01))
    entry = view_entry(7, view, frame, "/address", covariance)
    assert (entry.k, entry.camera, entry.row, entry.url) == (7, view.camera, view.row, "/address")
    assert (entry.width_px, entry.height_px, entry.covariance_px2) == (view.width, view.height, covariance)
    np.testing.assert_allclose(np.array(entry.crop_from_cad) @ entry.cad_from_crop, np.eye(3), atol=1e-9)
    assert entry.light is None, "an empty light pattern is left out"
