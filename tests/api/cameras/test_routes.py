"""Frames of cameras and findings of the doctor over REST."""

from __future__ import annotations

from typing import Any


def test_the_newest_frame_has_figures_and_a_picture(client: Any, station: Any) -> None:
    assert client.get("/api/v1/cameras/0/frame").json()["code"] == "no-frame-yet"
    run = station.film()
    frame = client.get("/api/v1/cameras/0/frame").json()
    assert (frame["run"], frame["row"], len(frame["histogram"])) == (run, 3, 64)
    assert {tile["column"] for tile in frame["tiles"]} == {0, 1, 2}
    picture = client.get("/api/v1/cameras/0/picture", params={"run": run, "row": 3})
    assert picture.headers["content-type"] == "image/jpeg"
    assert picture.content.startswith(b"\xff\xd8")
    assert client.get("/api/v1/cameras/0/picture").content == picture.content
    assert client.get("/api/v1/cameras/0/picture", params={"run": run, "row": 99}).status_code == 404


def test_a_station_without_a_file_cannot_be_examined(client: Any) -> None:
    reply = client.get("/api/v1/doctor")
    assert (reply.status_code, reply.json()["code"]) == (404, "not-examinable")
