"""Components, their views and temporary images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture


def test_the_list_of_components_leads_to_their_views(client: Any, station: Any) -> None:
    run = station.film()
    components = client.get(f"{RUNS}/{run}/components").json()["components"]
    assert [c["address"] for c in components] == ["U1", "R1", "2/R1"]
    assert components[2]["panel"] == "2"
    assert "panel" not in components[0]
    for component in components:
        content = client.get(component["url"]).json()
        assert content["address"] == component["address"]
        assert content["views"]


def test_a_view_matches_its_matrices(client: Any, station: Any) -> None:
    """Pixels of the picture are pixels of the frame, shifted by the matrix; both map to the same CAD point."""
    run = station.film()
    view = client.get(f"{RUNS}/{run}/components/U1").json()["views"][0]
    crop = picture(client.get(view["url"]))
    assert crop.shape == (view["height_px"], view["width_px"])
    np.testing.assert_allclose(np.array(view["cad_from_crop"]) @ view["crop_from_cad"], np.eye(3), atol=1e-9)
    corner = np.array(view["crop_from_cad"]) @ [15, 24, 1]  # upper left corner of U1's box in CAD
    np.testing.assert_allclose(corner[:2] / corner[2], [-0.5, -0.5], atol=1e-9)
    frame = station.pixels[run, view["camera"], view["row"]]
    shift = np.array(view["image_from_crop"])[:2, 2]
    x, y = (round(float(v) - 0.5) for v in shift)
    both = frame[y : y + crop.shape[0] + 1, x : x + crop.shape[1] + 1].astype(float)
    halfway = (both[:-1, :-1] + both[1:, :-1] + both[:-1, 1:] + both[1:, 1:]) / 4
    np.testing.assert_allclose(crop, halfway, atol=1)


@pytest.mark.parametrize("name", ["png", "jpeg", "tiff", "npy", "raw"])
@pytest.mark.parametrize("ref", ["U1", "2/R1", "2%2FR1"])
def test_temporary_images_in_every_format(client: Any, station: Any, ref: str, name: str) -> None:
    run = station.film()
    answer = client.get(f"{RUNS}/{run}/components/{ref}/images/0", params={"format": name})
    expected = picture(client.get(f"{RUNS}/{run}/components/{ref}/images/0"))
    assert picture(answer).shape == expected.shape
    assert np.abs(picture(answer).astype(int) - expected).mean() < (6 if name == "jpeg" else 1e-9)
    assert "immutable" in answer.headers["cache-control"]
    again = client.get(answer.url, headers={"if-none-match": answer.headers["etag"]})
    assert again.status_code == 304


def test_image_addresses_keep_resolution_and_coverage_of_the_list(client: Any, station: Any) -> None:
    address = f"{RUNS}/{station.film()}/components/2/R1"
    views = client.get(address, params={"px_per_mm": 20, "min_coverage": 1}).json()["views"]
    assert len(views) < len(client.get(address, params={"min_coverage": 0.01}).json()["views"])
    for view in views:
        assert view["coverage"] == 1
        assert picture(client.get(view["url"])).shape == (24, 40)


def test_huge_images_are_refused(client: Any, station: Any) -> None:
    answer = client.get(f"{RUNS}/{station.film()}/components/U1/images/0", params={"px_per_mm": 500})
    assert answer.status_code == 422
    assert "megapixels" in answer.json()["detail"]


@pytest.mark.parametrize(("ref", "k", "status"), [("U1", "99", 404), ("U1", "x", 422), ("U9", "0", 404)])
def test_unknown_views_and_components_are_refused(client: Any, station: Any, ref: str, k: str, status: int) -> None:
    assert client.get(f"{RUNS}/{station.film()}/components/{ref}/images/{k}").status_code == status


def test_an_unfinished_run_is_not_cached(client: Any, station: Any) -> None:
    run = station.film(finish=False)
    assert client.get(f"{RUNS}/{run}/components").headers["cache-control"] == "no-store"
    assert client.get(f"{RUNS}/{run}/components/U1").status_code == 409
