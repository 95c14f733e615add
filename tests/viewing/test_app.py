"""The addresses of the page: lists of frames, their pictures, and local files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from vaoi_station.config import StationConfig
from vaoi_station.viewing.app import create_app
from vaoi_station.viewing.latest_frames import LatestFrames
from vaoi_station.viewing.mark_spec import MarkSpec


@pytest.fixture
def latest() -> LatestFrames:
    return LatestFrames([MarkSpec("cross", 24.0, light=False, expected=4), None])


@pytest.fixture
def client(latest: LatestFrames, make_config: Callable[..., StationConfig]) -> Iterator[TestClient]:
    app = create_app(make_config(), latest, ["Armed: waiting for a board."])
    with TestClient(app, base_url="http://127.0.0.1") as client:
        yield client


def test_before_the_first_frame_the_list_is_empty(client: TestClient) -> None:
    document = client.get("/api/look").json()
    assert (document["station"], document["names"], document["cameras"], document["number"]) == (
        "view",
        ["c0", "c1"],
        [],
        0,
    )
    assert document["notices"] == ["Armed: waiting for a board."]


def test_figures_marks_and_picture_are_of_one_frame(client: TestClient, latest: LatestFrames, painter: Any) -> None:
    latest.put(0, "007", 4, painter.marks())
    document = client.get("/api/look", params={"after": 0, "timeout_s": 5}).json()
    camera = document["cameras"][0]
    assert (camera["run"], camera["row"], camera["number"], camera["name"]) == ("007", 4, 1, "c0")
    assert (len(camera["marks"]), camera["marks_expected"], camera["mark_size_px"]) == (4, 4, 24.0)
    assert set(camera["figures"]) == {
        "focus", "blur_px", "mtf50", "blur_tiles_px", "mean", "low", "high", "saturated",
    }  # fmt: skip
    picture = client.get("/api/cameras/0/picture", params={"number": 1})
    assert picture.headers["content-type"] == "image/jpeg"
    pixels = np.asarray(cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_UNCHANGED))
    assert np.abs(pixels.astype(int) - painter.marks()).mean() < 3


def test_unknown_frames_are_refused(client: TestClient) -> None:
    gone = client.get("/api/cameras/0/picture", params={"number": 9})
    assert (gone.status_code, gone.json()["code"]) == (410, "gone")
    assert client.get("/api/look", params={"timeout_s": 999}).status_code == 422
    assert client.get("/elsewhere").status_code == 404


@pytest.mark.parametrize("path", ["/", "/web/view.js", "/web/view.css", "/favicon.ico"])
def test_the_page_is_local_and_loads_nothing_else(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert "//" not in answer.text.replace("http://www.w3.org/2000/svg", "").replace("// ", "")
