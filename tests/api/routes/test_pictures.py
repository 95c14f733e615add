"""Frames, temporary images and merged pictures over REST."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest

from tests.api.held.replies import RUNS, picture
from tests.runs.merging.finished_board import RADIANCE
from vaoi_station.api.routes.pictures import ImageQuery, _wanted
from vaoi_station.rendering.request import ImageOptions, ImageRequest


@pytest.mark.parametrize("name", ["png", "tiff", "npy", "raw"])
def test_frames_are_lossless(filmed: Any, name: str) -> None:
    run = filmed.run
    answer = filmed.client.get(f"{RUNS}/{run}/frames/2/3", params={"format": name})
    np.testing.assert_array_equal(picture(answer), filmed.station.pixels[run, 2, 3])
    assert answer.headers["x-frame-verdict"] == "ok"
    assert "immutable" in answer.headers["cache-control"]


def test_an_incomplete_frame_is_returned_on_request_only(filmed: Any) -> None:
    address = f"{RUNS}/{filmed.run}/frames/0/1"
    assert filmed.client.get(address).status_code == 409
    shown = filmed.client.get(address, params={"incomplete": "show"})
    assert (shown.status_code, shown.headers["x-frame-verdict"]) == (200, "incomplete")
    assert filmed.client.get(address, params={"incomplete": "perhaps"}).status_code == 422


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


def test_image_addresses_keep_resolution_and_coverage_of_the_list(filmed: Any) -> None:
    address = f"{RUNS}/{filmed.run}/components/2/R1"
    views = filmed.client.get(address, params={"px_per_mm": 20, "min_coverage": 1}).json()["views"]
    assert len(views) < len(filmed.client.get(address, params={"min_coverage": 0.01}).json()["views"])
    for view in views:
        assert view["coverage"] == 1
        assert picture(filmed.client.get(view["url"])).shape == (24, 40)


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


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"light": "blue"}, "light is 'blue', but must be one of the lights of this run: left, right"),
        ({"seen_from": "up"}, "seen_from is 'up', but must be 'left' or 'right' or 'front' or 'back'"),
        ({"seen_from": "361"}, "seen_from is 361.0, but must be 'left', 'right', 'front', 'back' or an azimuth"),
        ({"min_angle_deg": 40, "max_angle_deg": 20}, "min_angle_deg is 40.0, but must be at most max_angle_deg, 20"),
        ({"minus": "left"}, "minus is 'left', but no light is given"),
        ({"within_deg": 30}, "within_deg is 30, but no seen_from is given"),
        ({"margin_mm": 90, "px_per_mm": 100}, "margin_mm is 90.0, but must be at most 15.5 at 100 px/mm"),
    ],
)
def test_requests_that_cannot_be_met_are_refused_with_the_limit(
    filmed: Any, params: dict[str, Any], words: str
) -> None:
    address = f"{RUNS}/{filmed.lit}/components/U1"
    for path in (address, f"{address}/images/0"):
        answer = filmed.client.get(path, params=params)
        assert answer.status_code == 422
        assert words in answer.json()["detail"]


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
