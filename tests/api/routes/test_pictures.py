"""Frames, temporary images and merged pictures over REST."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest

from tests.api.held.replies import RUNS, picture
from vaoi_station.api.routes.pictures import ImageQuery, _wanted
from vaoi_station.rendering.request import ImageOptions, ImageRequest


@pytest.mark.parametrize("name", ["png", "tiff", "npy", "raw"])
def test_frames_are_lossless(filmed: Any, name: str) -> None:
    run = filmed.run
    answer = filmed.client.get(f"{RUNS}/{run}/frames/2/3", params={"format": name})
    np.testing.assert_array_equal(picture(answer), filmed.station.pixels[run, 2, 3])
    assert answer.headers["x-frame-verdict"] == "ok"
    assert "immutable" in answer.headers["cache-control"]


def test_the_list_of_components_leads_to_their_views(filmed: Any) -> None:
    run = filmed.run
    components = filmed.client.get(f"{RUNS}/{run}/components").json()["components"]
    assert [c["address"] for c in components] == ["U1", "R1", "2/R1"]
    assert components[2]["panel"] == "2"
    assert "panel" not in components[0]
    for component in components:
        content = filmed.client.get(component["url"]).json()
        assert content["address"] == component["address"]
        assert content["views"]


def test_a_view_matches_its_matrices(filmed: Any) -> None:
    """Pixels of the picture are pixels of the frame, shifted by the matrix; both map to the same CAD point."""
    run = filmed.run
    view = filmed.client.get(f"{RUNS}/{run}/components/U1").json()["views"][0]
    crop = picture(filmed.client.get(view["url"]))
    assert crop.shape == (view["height_px"], view["width_px"])
    np.testing.assert_allclose(np.array(view["cad_from_crop"]) @ view["crop_from_cad"], np.eye(3), atol=1e-9)
    corner = np.array(view["crop_from_cad"]) @ [15, 24, 1]  # upper left corner of U1's box in CAD
    np.testing.assert_allclose(corner[:2] / corner[2], [-0.5, -0.5], atol=1e-9)
    frame = filmed.station.pixels[run, view["camera"], view["row"]]
    shift = np.array(view["image_from_crop"])[:2, 2]
    x, y = (round(float(v) - 0.5) for v in shift)
    both = frame[y : y + crop.shape[0] + 1, x : x + crop.shape[1] + 1].astype(float)
    halfway = (both[:-1, :-1] + both[1:, :-1] + both[:-1, 1:] + both[1:, 1:]) / 4
    np.testing.assert_allclose(crop, halfway, atol=1)


@pytest.mark.parametrize("name", ["png", "jpeg", "tiff", "npy", "raw"])
@pytest.mark.parametrize("ref", ["U1", "2/R1", "2%2FR1"])
def test_temporary_images_in_every_format(filmed: Any, ref: str, name: str) -> None:
    run = filmed.run
    answer = filmed.client.get(f"{RUNS}/{run}/components/{ref}/images/0", params={"format": name})
    expected = picture(filmed.client.get(f"{RUNS}/{run}/components/{ref}/images/0"))
    assert picture(answer).shape == expected.shape
    assert np.abs(picture(answer).astype(int) - expected).mean() < (6 if name == "jpeg" else 1e-9)
    assert "immutable" in answer.headers["cache-control"]
    again = filmed.client.get(answer.url, headers={"if-none-match": answer.headers["etag"]})
    assert again.status_code == 304


def test_images_under_one_light_best_first(filmed: Any) -> None:
    address = f"{RUNS}/{filmed.lit}/components/U1"
    every = filmed.client.get(address).json()["views"]
    left = filmed.client.get(address, params={"light": "left"}).json()["views"]
    assert [(v["camera"], v["row"]) for v in left] == [(v["camera"], v["row"]) for v in every if v["light"] == "left"]
    assert {v["light"] for v in every} == {"left", "right"}
    best = filmed.client.get(f"{address}/images/0", params={"light": "left"})
    assert (picture(best) == picture(filmed.client.get(left[0]["url"]))).all()
    fields = {"view_angle_deg", "time_s", "exposure_us", "gain", "plane", "height_mm"}
    assert fields <= set(left[0])
    assert "sharpness_per_mm" not in left[0], "it is measured on request only"
    [measured] = filmed.client.get(address, params={"light": "left", "limit": 1, "measure": True}).json()["views"]
    assert measured["sharpness_per_mm"] > 0
    assert measured["saturated"] == 0


@pytest.fixture(scope="module")
def run(shared_client: Any) -> str:
    name: str = shared_client.get(f"{RUNS}/latest").json()["id"]
    return name


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


FRAME = f"{RUNS}/r000001/frames/0/0?format=raw"
SIZE = 320 * 240


@pytest.mark.parametrize(
    ("asked", "start", "end"),
    [
        ("bytes=0-319", 0, 320),
        ("bytes=320-", 320, SIZE),
        ("bytes=-5", SIZE - 5, SIZE),
        ("bytes=76799-99999", 76799, SIZE),
    ],
)
def test_some_bytes_of_a_frame(shared_client: Any, asked: str, start: int, end: int) -> None:
    whole = shared_client.get(FRAME)
    assert whole.headers["accept-ranges"] == "bytes"
    part = shared_client.get(FRAME, headers={"Range": asked})
    assert part.status_code == 206
    assert part.content == whole.content[start:end]
    assert part.headers["content-range"] == f"bytes {start}-{end - 1}/{SIZE}"
    assert part.headers["x-image-stride"] == "320"
    assert part.headers["etag"] == whole.headers["etag"]


def test_every_option_is_a_parameter_with_its_default() -> None:
    assert set(ImageQuery.model_fields) == set(ImageOptions.__annotations__)
    assert asyncio.run(_wanted(ImageQuery())) == ImageRequest()
