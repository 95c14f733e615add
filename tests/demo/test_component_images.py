"""Fetch component images from a scripted station."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.demo.client import Client
from vaoi_station.demo.component_images import NOT_SEEN, fetch_component_images, list_unseen_components
from vaoi_station.errors import NotFoundError
from vaoi_station.files.images import encode_png

VIEWS = [{"k": k, "camera": 1, "row": 3 + k, "url": f"/api/v1/image/{k}"} for k in range(2)]


class Station(Client):
    """Client with two scripted components; the first has two views, the second none."""

    def __init__(self) -> None:
        super().__init__("http://station")

    def get(self, path: str, **_: Any) -> Any:
        if path == "/runs/r1/components":
            return {"components": [{"address": a, "url": f"/views/{a}"} for a in ("2/U1", "R1")]}
        return {"views": VIEWS if path.endswith("U1") else []}

    def picture(self, path: str) -> tuple[bytes, NDArray[Any]]:
        pixels = np.full((4, 6), int(path[-1]) + 1, np.uint8)
        return encode_png(pixels), pixels


def test_images_and_matrices_are_written_per_component(tmp_path: Path) -> None:
    images = fetch_component_images(Station(), "r1", tmp_path)
    assert (images.components, images.pictures) == (2, 2)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["2_U1", "R1"]
    assert sorted(p.name for p in (tmp_path / "2_U1").glob("*.png")) == ["00_c01_r003.png", "01_c01_r004.png"]
    assert json.loads((tmp_path / "2_U1" / "views.json").read_text()) == VIEWS
    assert json.loads((tmp_path / "R1" / "views.json").read_text()) == []


def test_tiles_show_the_best_view_in_the_order_of_the_components(tmp_path: Path) -> None:
    first, second = fetch_component_images(Station(), "r1", tmp_path).tiles
    assert first.picture is not None
    assert int(first.picture[0, 0]) == 1
    assert second.picture is None


def test_unseen_components_are_listed_without_images() -> None:
    images = list_unseen_components(Station(), "r1")
    assert (images.components, images.pictures) == (2, 0)
    assert all(tile.picture is None for tile in images.tiles)
    assert NOT_SEEN in repr(images.tiles)


def test_error_of_the_station_ends_the_fetch(tmp_path: Path) -> None:
    class Released(Station):
        def picture(self, path: str) -> tuple[bytes, NDArray[Any]]:
            raise NotFoundError(f"{path}: the frames are released.")

    with pytest.raises(NotFoundError, match="released"):
        fetch_component_images(Released(), "r1", tmp_path)
