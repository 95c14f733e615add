"""Trials of a camera over REST: figures and picture of one pulse, refused while the line is armed."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

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
