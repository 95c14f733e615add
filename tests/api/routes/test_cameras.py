"""The newest frames of the cameras, and frames with settings on trial."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from tests.api.held_station import HeldStation
from vaoi_station.api.routes.cameras import LARGEST_PX, NewestFrames
from vaoi_station.errors import NotFoundError


def test_the_last_good_frame_of_the_newest_run_is_measured_once(
    station: HeldStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = NewestFrames(station)
    with pytest.raises(NotFoundError, match="No frame of camera cam1") as refusal:
        frames.frame(1)
    assert refusal.value.code == "no-frame-yet"
    station.film()
    run = station.film()
    found = frames.frame(1)
    assert (found.run, found.row, len(found.tiles)) == (run, 3, 9)
    assert found.link_mbit_s == pytest.approx(3 * found.width * found.height * 8e-6 / 1.2, abs=0.1)
    read: list[Any] = []
    monkeypatch.setattr(station, "frame", lambda *asked: read.append(asked))
    assert frames.frame(1) == found
    assert read == []
    with pytest.raises(NotFoundError, match="There is no camera 9; the station has 3"):
        frames.frame(9)


def test_no_row_of_a_board_that_is_filmed_is_measured_while_an_earlier_frame_is_there(
    station: HeldStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = NewestFrames(station)
    station.film()
    found = frames.frame(0)
    station.film(finish=False)
    with monkeypatch.context() as patch:
        patch.setattr(station, "frame", lambda *_: pytest.fail("a frame is measured"))
        assert frames.frame(0) == found
    station.release(found.run)
    assert frames.frame(0).run != found.run


def test_a_large_frame_is_shown_as_a_small_picture(station: HeldStation, monkeypatch: pytest.MonkeyPatch) -> None:
    large = np.full((1000, 2000), 40_000, np.uint16)
    monkeypatch.setattr(station, "frame", lambda *_, **__: (large, None))
    picture = cv2.imdecode(np.frombuffer(NewestFrames(station).picture(0, "r", 0), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape == (LARGEST_PX // 2, LARGEST_PX)
    assert int(picture.mean()) == pytest.approx(40_000 / 65535 * 255, abs=1)


def test_an_incomplete_frame_of_a_run_is_shown_as_small_as_asked_for(client: Any, station: Any) -> None:
    """The page of a board without pictures shows the frames as they were filmed."""
    path, run = "/api/v1/cameras/0/picture", station.film()
    reply = client.get(f"{path}?run={run}&row=1&largest_px=64")
    shown = cv2.imdecode(np.frombuffer(reply.content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert shown.shape == (48, 64)
    station.release(run)
    assert client.get(f"{path}?run={run}&row=1").status_code == 410


PATH = "/api/v1/cameras/1/trial"


def test_a_pulse_gives_the_figures_and_the_picture_of_the_camera(client: Any, station: Any) -> None:
    answer = client.post(PATH, json={"light": "left", "exposure_us": 500.0})
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    taken = answer.json()
    assert (taken["camera"], taken["light"], taken["exposure_us"], taken["gain_db"]) == (1, "left", 500.0, 0.0)
    assert len(taken["histogram"]) == 64
    assert taken["high"] > client.post(PATH, json={}).json()["high"]
    picture = client.get(f"{PATH}/picture?number=2")
    assert picture.headers["content-type"] == "image/jpeg"
    shown = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert shown.shape == (240, 320)
    assert client.get(f"{PATH}/picture?number=1").status_code == 404
    assert client.get("/api/v1/cameras/0/trial/picture").json()["code"] == "no-trial-frame"
    assert client.delete(PATH).status_code == 204
    assert station.lighting.ended == 1
    assert client.get(f"{PATH}/picture").status_code == 404


def test_an_armed_line_and_impossible_values_are_refused(client: Any, station: Any) -> None:
    for body in ({"exposure_us": 0.0}, {"gain_db": 61.0}, {"on_us": 1e7}, {"other": 1}):
        assert client.post(PATH, json=body).status_code == 422
    assert client.post("/api/v1/cameras/9/trial", json={}).status_code == 404
    station.arm("demo-board")
    refused = client.post(PATH, json={})
    assert (refused.status_code, refused.json()["code"]) == (409, "line-armed")
    assert station.lighting.tried == []
