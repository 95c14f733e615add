"""Mosaics over REST: Deep Zoom and the file; what viewers ask for and what is refused."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from tests.api.held.replies import RUNS, picture


@pytest.fixture
def board(client: Any, station: Any) -> Any:
    """The entry of a run's mosaic."""
    run = station.film()
    [entry] = client.get(f"{RUNS}/{run}/mosaics").json()["mosaics"]
    return entry


def test_list_leads_to_all_forms_of_a_mosaic(client: Any, board: Any) -> None:
    assert (board["name"], board["hdr"], board["width_px"], board["height_px"]) == ("board", False, 480, 320)
    assert board["image_from_cad"][0] == [8.0, 0.0, -0.5]
    forms = {"dzi": ("application/xml", "immutable"), "tiff": ("image/tiff", "no-cache")}
    for form, (media, cache) in forms.items():
        answer = client.get(board[form])
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(media)
        assert cache in answer.headers["cache-control"], "pixels depend on the station's flat fields"


def test_deep_zoom_tiles_join_to_the_board(client: Any, board: Any) -> None:
    text = client.get(board["dzi"]).text
    assert 'TileSize="256"' in text
    assert '<Size Width="480" Height="320"/>' in text
    tiles = board["dzi"].removesuffix(".dzi") + "_files"
    rows = [np.hstack([picture(client.get(f"{tiles}/9/{x}_{y}.png")) for x in range(2)]) for y in range(2)]
    whole = np.vstack(rows)
    assert whole.shape == (320, 480)
    half = picture(client.get(f"{tiles}/8/0_0.png"))
    assert half.shape == (160, 240)
    means = whole.reshape(160, 2, 240, 2).mean((1, 3))
    shown = half > 0
    assert shown.mean() > 0.5
    assert np.median(np.abs(half.astype(float) - means)[shown]) < 6
    assert client.get(f"{tiles}/0/0_0.jpg").headers["content-type"] == "image/jpeg"


@pytest.mark.parametrize(
    ("address", "status", "words"),
    [
        ("board_files/9/2_0.jpg", 404, "2×2 tiles, counted from 0; there is no tile 2_0"),
        ("board_files/12/0_0.jpg", 404, "levels 0 to 9; there is no level 12"),
        ("board,light=left.dzi", 422, "light is 'left', but must be one of the 1 lights of the run"),
        ("board,exposure=7.dzi", 422, "exposure_us is 7.0, but must be one of the exposures of the run"),
        ("board,blue.dzi", 404, "there is no mosaic 'board,blue'"),
        ("board.tif?x0=1&y0=2", 422, "2 of x0, y0, x1, y1"),
        ("board.tif?x0=900&y0=900&x1=910&y1=910", 422, "on the board, (0, 0) to (60, 40) mm"),
        ("board.tif?px_per_mm=400", 422, "300 megapixels (this would be 24000×16000)"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_numbers(filmed: Any, address: str, status: int, words: str) -> None:
    answer = filmed.client.get(f"{RUNS}/{filmed.run}/mosaics/{address}")
    assert (answer.status_code, words in answer.json()["detail"]) == (status, True), answer.text


def test_one_caller_has_one_file_made_at_a_time(
    client: Any, station: Any, board: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, may_go, write = threading.Event(), threading.Event(), station.mosaics.write

    def slow(*arguments: Any) -> None:
        began.set()
        assert may_go.wait(30)
        write(*arguments)

    monkeypatch.setattr(station.mosaics, "write", slow)
    wanted = {"x0": 10, "y0": 10, "x1": 30, "y1": 20, "px_per_mm": 4}
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(client.get, board["tiff"], params=wanted)
        assert began.wait(30)
        second = client.get(board["tiff"], params=wanted)
        may_go.set()
        assert first.result(30).status_code == 200
    assert (second.status_code, second.json()["code"]) == (503, "busy")
    assert "the limit for one caller is 1" in second.json()["detail"]
    assert client.get(board["tiff"], params=wanted).status_code == 200, "its seat is free again"


def test_the_small_picture_stays_when_the_frames_are_gone(client: Any, station: Any) -> None:
    run = station.film()
    assert "kept" not in client.get(f"{RUNS}/{run}/mosaics").json()
    refused = client.get(f"{RUNS}/{run}/mosaics/kept.jpg")
    assert (refused.status_code, refused.json()["code"]) == (404, "no-kept-mosaic")
    station.kept.mosaics.keep(run)
    station.release(run)
    answer = client.get(f"{RUNS}/{run}/mosaics")
    assert "no-cache" in answer.headers["cache-control"], "the picture may be made later"
    kept = answer.json()["kept"]
    shown = client.get(kept["url"])
    assert shown.headers["content-type"] == "image/jpeg"
    assert picture(shown).shape[:2] == (kept["height_px"], kept["width_px"])
    small = client.get(kept["url"], params={"width": 72})
    assert picture(small).shape[1] == 72
    assert len(small.content) < len(shown.content) / 4
    assert "immutable" in small.headers["cache-control"]
    assert client.get(kept["url"], params={"width": 10_000}).content == shown.content
    assert client.get(kept["url"], params={"width": 2}).status_code == 422
