"""Merged pictures over REST."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture
from tests.runs.merging.finished_board import RADIANCE


@pytest.fixture(scope="module")
def run(shared_client: Any) -> str:
    name: str = shared_client.get(f"{RUNS}/latest").json()["id"]
    return name


def test_the_list_leads_to_the_pictures(shared_client: Any, run: str) -> None:
    answer = shared_client.get(f"{RUNS}/{run}/merged", params={"component": "2/R1", "light": "left", "px_per_mm": 12})
    assert answer.status_code == 200
    pictures = answer.json()["pictures"]
    assert [p["k"] for p in pictures] == list(range(len(pictures)))
    last = pictures[-1]
    assert last["exposures"] == 2
    assert len(last["merged"]) == max(len(p["merged"]) for p in pictures)
    assert last["lights"] == ["left"]
    np.testing.assert_allclose(np.array(last["cad_from_crop"]) @ last["crop_from_cad"], np.eye(3), atol=1e-9)
    value = picture(shared_client.get(last["url"], headers={"accept": "application/x-npy"}))
    assert value.shape == (last["height_px"], last["width_px"])
    np.testing.assert_allclose(value[np.isfinite(value)], RADIANCE, rtol=0.01)


@pytest.mark.parametrize(
    ("name", "kind"), [("png", "u1"), ("jpeg", "u1"), ("tiff", "f4"), ("npy", "f4"), ("raw", "f4")]
)
def test_merged_images_in_every_format(shared_client: Any, run: str, name: str, kind: str) -> None:
    params = {"region": "12,8,20,14", "px_per_mm": 5, "format": name}
    shown = picture(shared_client.get(f"{RUNS}/{run}/merged/image", params=params))
    assert shown.shape == (30, 40)
    assert shown.dtype == np.dtype(kind)


def test_the_standard_deviation_of_every_pixel(shared_client: Any, run: str) -> None:
    params = {"component": "U1", "sigma": True, "format": "tiff"}
    sigma = picture(shared_client.get(f"{RUNS}/{run}/merged/image", params=params))
    assert 0 < float(sigma.min()) < 0.1


@pytest.mark.parametrize(
    ("params", "status", "words"),
    [
        ({}, 422, "exactly one of component and region"),
        ({"component": "U9"}, 404, "no component 'U9'"),
        ({"region": "1,2,3"}, 422, "region is '1,2,3', but must be four numbers x0,y0,x1,y1"),
        ({"region": "1,2,x,3"}, 422, "four numbers"),
        ({"region": "5,5,4,6"}, 422, "X0 < X1"),
        ({"region": "90,90,95,95"}, 422, "on the board, which reaches from 0 0 to 60 40"),
        ({"region": "0,0,60,40", "px_per_mm": 400}, 422, "megapixels at 400 px/mm"),
        ({"component": "U1", "k": 50}, 404, "there is no 50"),
        ({"component": "U1", "sigma": True, "format": "png"}, 422, "npy or tiff for a sigma"),
        ({"component": "U1", "light": "blue"}, 404, "under the light 'blue'"),
    ],
)
def test_bad_requests_are_refused_with_their_values(
    shared_client: Any, run: str, params: dict[str, Any], status: int, words: str
) -> None:
    answer = shared_client.get(f"{RUNS}/{run}/merged/image", params=params)
    assert answer.status_code == status
    assert words in answer.json()["detail"]
