"""Frames: formats, incomplete and missing ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture


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
