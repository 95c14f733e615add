"""The contact sheet: every picture whole, none on top of another, whatever their sizes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.files.contact_sheet import Tile, contact_sheet
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


def test_components_without_pictures_and_long_names_are_drawn() -> None:
    tiles = [Tile(None, "U1", "not seen"), Tile(plain((9, 9), (2, 202, 2)), "2/PANEL_LONG_NAME_17", "c10 r117")]
    sheet = contact_sheet(tiles, "demo", Status.FAILED, ["a fact that is much longer than a line " * 5])
    empty = contact_sheet([], "demo", Status.FAILED, [])
    assert sheet.shape[0] > empty.shape[0]
    assert area(sheet, (2, 202, 2))[2] == 18 * 18, "enlarged twice"
