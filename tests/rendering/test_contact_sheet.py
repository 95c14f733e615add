"""The contact sheet: every picture whole, none on top of another, whatever their sizes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.files.contact_sheet import MOST_CELLS, Tile, contact_sheet
from vaoi_station.model import Status

Size = tuple[int, int]


def plain(size: Size, colour: tuple[int, int, int]) -> np.ndarray:
    """Make a picture of one colour, which the sheet's 64 levels leave as it is."""
    return np.full((*size, 3), colour, np.uint8)


def area(sheet: np.ndarray, colour: tuple[int, int, int]) -> tuple[int, int, int]:
    """Height, width and number of the pixels of a colour."""
    y, x = np.nonzero((sheet == colour).all(2))
    return int(np.ptp(y)) + 1, int(np.ptp(x)) + 1, len(y)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 900), st.integers(1, 900)), min_size=1, max_size=20))
def test_every_picture_is_whole_and_keeps_its_shape(sizes: list[Size]) -> None:
    colours = [(2 + 4 * k, 50, 202) for k in range(len(sizes))]
    tiles = [Tile(plain(s, c), f"U{k}", "c0 r0") for k, (s, c) in enumerate(zip(sizes, colours, strict=True))]
    sheet = contact_sheet(tiles, "demo", Status.OK, ["two cameras"])
    for (height, width), colour in zip(sizes, colours, strict=True):
        h, w, count = area(sheet, colour)
        assert count == h * w
        exact = (width * h / height, height * w / width)
        assert abs(w - exact[0]) <= 1 + exact[0] / h or abs(h - exact[1]) <= 1 + exact[1] / w


def test_large_components_get_more_room_and_come_first() -> None:
    small, large = Tile(plain((20, 50), (2, 2, 202)), "R1"), Tile(plain((600, 600), (202, 2, 2)), "U1")
    assert large.span == (MOST_CELLS, MOST_CELLS)
    assert small.span == (1, 1)
    assert Tile(plain((200, 800), (2, 2, 2)), "J1").span == (MOST_CELLS, 1), "a connector is long, not large"
    sheet = contact_sheet([small, large], "demo", Status.OK, [])
    x_of = [np.nonzero((sheet == colour).all(2))[1].min() for colour in ((202, 2, 2), (2, 2, 202))]
    assert x_of[0] < x_of[1]


def test_grey_and_sixteen_bit_pictures_look_like_their_eight_bit_colours() -> None:
    grey = np.full((40, 40), 102, np.uint8)
    sheets = [
        contact_sheet([Tile(picture, "U1")], "demo", Status.OK, [])
        for picture in (grey, grey.astype(np.uint16) * 257, np.stack([grey] * 3, 2))
    ]
    assert np.array_equal(sheets[0], sheets[1])
    assert np.array_equal(sheets[0], sheets[2])


def test_components_without_pictures_and_long_names_are_drawn() -> None:
    tiles = [Tile(None, "U1", "not seen"), Tile(plain((9, 9), (2, 202, 2)), "2/PANEL_LONG_NAME_17", "c10 r117")]
    sheet = contact_sheet(tiles, "demo", Status.FAILED, ["a fact that is much longer than a line " * 5])
    empty = contact_sheet([], "demo", Status.FAILED, [])
    assert sheet.shape[0] > empty.shape[0]
    assert area(sheet, (2, 202, 2))[2] == 18 * 18, "enlarged twice"
