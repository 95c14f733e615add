"""Components, their views and temporary images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture


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
