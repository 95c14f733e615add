"""Frames, temporary images and merged pictures over REST."""

from __future__ import annotations

import inspect
from typing import Any
from urllib.parse import parse_qs

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture
from tests.runs.merging.finished_board import RADIANCE
from vaoi_station.api.routes.pictures import _bounds, _choice, _framing, picture_query
from vaoi_station.rendering.request import ImageOptions, ImageRequest


@pytest.mark.parametrize("name", ["png", "tiff", "npy", "raw"])
def test_frames_are_lossless(filmed: Any, name: str) -> None:
    run = filmed.run
    answer = filmed.client.get(f"{RUNS}/{run}/frames/2/3", params={"format": name})
    np.testing.assert_array_equal(picture(answer), filmed.station.pixels[run, 2, 3])
    assert answer.headers["x-frame-verdict"] == "ok"
    assert "immutable" in answer.headers["cache-control"]


def test_accept_chooses_the_format_and_vary_declares_it(filmed: Any) -> None:
    address = f"{RUNS}/{filmed.run}/frames/0/0"
    jpeg = filmed.client.get(address, headers={"accept": "image/jpeg"})
    png = filmed.client.get(address, headers={"accept": "image/png"})
    assert (jpeg.headers["content-type"], png.headers["content-type"]) == ("image/jpeg", "image/png")
    assert jpeg.headers["vary"] == "Accept"
    assert jpeg.headers["etag"] != png.headers["etag"]
    assert np.abs(picture(jpeg).astype(int) - picture(png)).mean() < 5


@pytest.mark.parametrize("ask", [{"params": {"format": "bmp"}}, {"headers": {"accept": "text/html"}}])
@pytest.mark.parametrize("what", ["frames/0/0", "components/U1/images/0"])
def test_unknown_formats_are_refused_with_the_available_ones(filmed: Any, ask: Any, what: str) -> None:
    answer = filmed.client.get(f"{RUNS}/{filmed.run}/{what}", **ask)
    assert (answer.status_code, answer.json()["code"]) == (406, "not-acceptable")
    assert "png" in answer.json()["detail"]


def test_an_incomplete_frame_is_returned_on_request_only(filmed: Any) -> None:
    address = f"{RUNS}/{filmed.run}/frames/0/1"
    assert filmed.client.get(address).status_code == 409
    shown = filmed.client.get(address, params={"incomplete": "show"})
    assert (shown.status_code, shown.headers["x-frame-verdict"]) == (200, "incomplete")
    assert filmed.client.get(address, params={"incomplete": "perhaps"}).status_code == 422


def test_a_missing_frame_is_not_found(filmed: Any) -> None:
    answer = filmed.client.get(f"{RUNS}/{filmed.run}/frames/1/2")
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


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


def test_a_difference_of_two_lights(filmed: Any) -> None:
    run = filmed.lit
    params = {"light": "left", "minus": "right", "margin_mm": 0.5, "align": "part"}
    [view, *_] = filmed.client.get(f"{RUNS}/{run}/components/U1", params=params).json()["views"]
    assert (view["row"] % 2, view["minus"][1] % 2) == (0, 1)
    crop = picture(filmed.client.get(view["url"]))
    assert crop.shape == (view["height_px"], view["width_px"]) == (72, 88)
    assert crop.std() > 1


def test_the_top_plane_of_a_part_without_height_is_answered_with_a_remark(filmed: Any) -> None:
    content = filmed.client.get(f"{RUNS}/{filmed.run}/components/U1", params={"plane": "top"}).json()
    assert "U1 has no height" in content["remark"]
    assert {v["plane"] for v in content["views"]} == {"board"}


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


@pytest.mark.parametrize("params", [{"within_deg": 181}, {"margin_mm": 101}, {"order": "worst"}, {"limit": 0}])
def test_values_outside_their_limits_are_refused_by_name(filmed: Any, params: dict[str, Any]) -> None:
    answer = filmed.client.get(f"{RUNS}/{filmed.run}/components/U1", params=params)
    assert answer.status_code == 422
    assert next(iter(params)) in answer.text


def test_huge_images_are_refused(filmed: Any) -> None:
    answer = filmed.client.get(f"{RUNS}/{filmed.run}/components/U1/images/0", params={"px_per_mm": 500})
    assert answer.status_code == 422
    assert "megapixels" in answer.json()["detail"]


@pytest.mark.parametrize(("ref", "k", "status"), [("U1", "99", 404), ("U1", "x", 422), ("U9", "0", 404)])
def test_unknown_views_and_components_are_refused(filmed: Any, ref: str, k: str, status: int) -> None:
    assert filmed.client.get(f"{RUNS}/{filmed.run}/components/{ref}/images/{k}").status_code == status


def test_an_unfinished_run_is_not_cached(client: Any, station: Any) -> None:
    run = station.film(finish=False)
    assert client.get(f"{RUNS}/{run}/components").headers["cache-control"] == "no-store"
    assert client.get(f"{RUNS}/{run}/components/U1").status_code == 409


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


@pytest.mark.parametrize("asked", ["bytes=5-1", "bytes=0-1,5-9", "lines=0-1", "bytes=-", "bytes=x"])
def test_ranges_that_are_not_understood_give_the_whole(shared_client: Any, asked: str) -> None:
    answer = shared_client.get(FRAME, headers={"Range": asked})
    assert (answer.status_code, len(answer.content)) == (200, SIZE)


def test_a_range_behind_the_end_is_refused(shared_client: Any) -> None:
    answer = shared_client.get(FRAME, headers={"Range": "bytes=76800-"})
    assert (answer.status_code, answer.json()["code"]) == (416, "range-not-satisfiable")
    assert answer.headers["content-range"] == f"bytes */{SIZE}"


def test_a_range_of_other_bytes_gives_the_whole(shared_client: Any) -> None:
    tag = shared_client.get(FRAME).headers["etag"]
    for given, status in ((tag, 206), ('"another"', 200), (f"W/{tag}", 200)):
        answer = shared_client.get(FRAME, headers={"Range": "bytes=0-9", "If-Range": given})
        assert answer.status_code == status
    again = shared_client.get(FRAME, headers={"Range": "bytes=0-9", "If-None-Match": tag})
    assert again.status_code == 304


def parameters() -> dict[str, Any]:
    makers = (_framing, _bounds, _choice)
    return {name: p.default for maker in makers for name, p in inspect.signature(maker).parameters.items()}


def test_every_option_is_a_parameter_with_its_default() -> None:
    assert set(parameters()) == set(ImageOptions.__annotations__)
    defaults = ImageRequest()
    for name, value in parameters().items():
        owner = next(part for part in (defaults.framing, defaults.bounds, defaults.choice) if hasattr(part, name))
        assert getattr(owner, name) == value, name
