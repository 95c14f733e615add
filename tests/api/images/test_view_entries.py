"""Views of components as response models."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qs

import numpy as np
import pytest

from tests.api.held_station import HeldStation
from vaoi_station.api.images.view_entries import covariances, picture_query, view_entry
from vaoi_station.rendering import ImageRequest


def test_covariances_are_symmetric_and_keyed_by_frame() -> None:
    quality: dict[str, Any] = {"component_covariance_px2": {"U1": [[0, 3, 0.01, 0.002, 0.04]]}}
    assert covariances(quality, "U1") == {(0, 3): ((0.01, 0.002), (0.002, 0.04))}


@pytest.mark.parametrize("quality", [{}, {"component_covariance_px2": {}}, {"component_covariance_px2": {"R1": []}}])
def test_without_covariances_there_are_none(quality: dict[str, Any]) -> None:
    assert covariances(quality, "U1") == {}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, {}),
        ({"measure": True}, {}),
        ({"px_per_mm": 20.0}, {"px_per_mm": ["20.0"]}),
        ({"min_coverage": 1.0}, {"min_coverage": ["1.0"]}),
        ({"light": "left & low", "seen_from": 90.0}, {"light": ["left & low"], "seen_from": ["90.0"]}),
        (
            {"order": "sharpest", "limit": 3, "plane": "top", "margin_mm": 0.5},
            {"order": ["sharpest"], "limit": ["3"], "plane": ["top"], "margin_mm": ["0.5"]},
        ),
    ],
)
def test_the_query_repeats_what_differs_from_the_defaults(options: Any, expected: dict[str, list[str]]) -> None:
    assert parse_qs(picture_query(ImageRequest.of(options)).removeprefix("?")) == expected


def test_an_entry_describes_its_view_and_frame(station: HeldStation) -> None:
    station.lights = ("left", "right")
    run = station.film()
    choice = station.images(run, "U1").chosen[0]
    covariance = np.diag([0.01, 0.04])
    entry = view_entry(7, choice, "/address", covariance)
    assert (entry.k, entry.camera, entry.row, entry.url) == (7, choice.view.camera, choice.view.row, "/address")
    assert (entry.width_px, entry.height_px) == (choice.view.width, choice.view.height)
    assert entry.covariance_px2 == ((0.01, 0.0), (0.0, 0.04))
    assert entry.sigma_px == pytest.approx(0.2)
    assert entry.sigma_mm == pytest.approx(0.2 / 8)
    np.testing.assert_allclose(np.array(entry.crop_from_cad) @ entry.cad_from_crop, np.eye(3), atol=1e-9)
    assert (entry.light, entry.exposure_us, entry.gain) == (choice.facts.light, 100.0 * (entry.row + 1), 2.0)
    assert (entry.sharpness_per_mm, entry.minus, entry.plane) == (None, None, "board")
