"""Codes are read where the board type says, or anywhere, with their places; work is done in slices."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.identity.conftest import DATAMATRIX, Filmed
from vaoi_station.identity.code_reader import CodeReader, Found, Progress, RegionPictures, read_codes
from vaoi_station.identity.symbols import read_symbols
from vaoi_station.model import BoardCode, BoardReading

MIL = 0.0254


def read(filmed: Filmed, **changes: object) -> BoardReading:
    return read_codes(filmed.with_identity(**changes), filmed.stitch, filmed.cameras, filmed.frame)


def test_codes_are_read_at_their_places_with_module_and_symbology(coded: Filmed) -> None:
    found = read(coded)
    assert [(c.symbology, c.text, c.board_id) for c in found.codes] == [
        ("datamatrix", coded.texts[0], "SN000007"),
        ("qr", coded.texts[1], "SN000007"),
    ]
    assert coded.board_type.identity is not None
    for code, place in zip(found.codes, coded.board_type.identity.places, strict=True):
        assert np.hypot(*np.subtract(code.center, place.center)) * MIL < 0.06
        assert abs(code.module_mm - 0.25) < 0.01
        assert code.error_correction_used < 1
        assert np.abs(np.mean(code.corners, axis=0) - code.center).max() * MIL < 0.001
    assert (found.unread_places, found.complete) == ((), True)


def test_code_of_dots_is_read_at_its_place_and_anywhere(make_coded: Callable[..., Filmed]) -> None:
    dotted = make_coded(({**DATAMATRIX, "dot_modules": 0.7, "inverted": True},))
    assert dotted.board_type.identity is not None
    [place] = dotted.board_type.identity.places
    for changes in ({}, {"places": ()}):
        [code] = read(dotted, **changes).codes
        assert (code.text, code.board_id) == (dotted.texts[0], "SN000007")
        assert np.hypot(*np.subtract(code.center, place.center)) < 0.05
        assert code.module_mm == pytest.approx(0.25, rel=0.02)


def test_place_without_a_code_is_named_and_panel_positions_are_kept(coded: Filmed) -> None:
    assert coded.board_type.identity is not None
    first, second = coded.board_type.identity.places
    empty = first.model_copy(update={"center": (700.0, 120.0), "width": 200.0, "height": 200.0, "panel": "3"})
    found = read(coded, places=(second.model_copy(update={"panel": 2}), empty))
    assert [c.panel for c in found.codes] == [2]
    assert found.unread_places == (empty,)


def test_code_belongs_to_the_place_that_contains_its_centre(coded: Filmed) -> None:
    assert coded.board_type.identity is not None
    first, second = coded.board_type.identity.places
    x0, x1 = sorted((first.center[0], second.center[0]))
    y0, y1 = sorted((first.center[1], second.center[1]))
    both = {
        "center": ((x0 + x1) / 2, (y0 + y1) / 2), "width": x1 - x0 + first.width, "height": y1 - y0 + first.height,
    }  # fmt: skip
    wide, own = first.model_copy(update={**both, "panel": 1}), second.model_copy(update={"panel": 2})
    found = read(coded, places=(wide, own))
    panels = {c.text: c.panel for c in found.codes}
    assert panels[coded.texts[1]] == 2, "the picture of the wide place shows it too"


def test_slices_continue_where_the_last_one_ended(coded: Filmed) -> None:
    keys = [*coded.frames]
    board_type = coded.with_identity(places=())
    progress, slices = Progress(), 0
    while not progress.ended:
        # A new reader for every slice, as in a worker.
        reader = CodeReader(board_type, RegionPictures(board_type, coded.stitch, coded.cameras, keys, coded.frame))
        before = progress.next_try
        progress = reader.work(progress, lambda: False)
        assert progress.next_try > before
        assert reader.reading(progress).complete == progress.ended
        slices += 1
    assert slices > 1
    assert reader.reading(progress) == read(coded, places=())


def test_text_that_its_check_words_do_not_prove_must_be_read_in_two_frames(coded: Filmed) -> None:
    pictures = RegionPictures(coded.board_type, coded.stitch, coded.cameras, [*coded.frames], coded.frame)
    reader = CodeReader(coded.board_type, pictures)
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    code = BoardCode(
        text="x", symbology="datamatrix", center=(0.5, 0.5), corners=corners, module_mm=0.2, error_correction_used=0.8,
        camera=0, row=3,
    )  # fmt: skip
    others = [code.model_copy(update={"row": 4}), code.model_copy(update={"camera": None, "row": None})]

    def read_of(*found: Found) -> tuple[BoardCode, ...]:
        return reader.reading(Progress(found)).codes

    once = Found(code, 0, 3, proven=False)
    assert read_of(once) == ()
    assert read_of(once, once._replace(tried=5)) == (), "another picture of the same frame"
    assert read_of(once, Found(others[1], 0, 5, proven=False)) == (), "a picture that the same frame may be part of"
    assert read_of(once, Found(others[0], 0, 5, proven=False)) == (code,)
    assert read_of(once._replace(proven=True)) == (code,)


@pytest.fixture(scope="module")
def on_seam(make_coded: Callable[..., Filmed]) -> Filmed:
    """A code in the middle of the board, between the two cameras."""
    return make_coded(({**DATAMATRIX, "x_mm": 16.0, "y_mm": 10.0},))


def pictures_of(filmed: Filmed, keys: list[tuple[int, int]] | None = None) -> RegionPictures:
    return RegionPictures(filmed.board_type, filmed.stitch, filmed.cameras, keys or [*filmed.frames], filmed.frame)


def test_code_that_no_frame_shows_wholly_is_read_from_several(on_seam: Filmed) -> None:
    assert on_seam.board_type.identity is not None
    [place] = on_seam.board_type.identity.places
    (x, y), half = place.center, place.width / 2
    pictures = pictures_of(on_seam)
    drawn = pictures.draw(pictures.grid((x - half, y - half, x + half, y + half), 20.0), 0)
    assert drawn is not None
    assert drawn[1] is None
    assert [s.text for s in read_symbols(drawn[0], None)] == [on_seam.texts[0]]


def test_missing_frames_are_passed_over_and_choices_end(coded: Filmed) -> None:
    pictures, region = pictures_of(coded), (300.0, 300.0, 400.0, 400.0)
    grid = pictures.grid(region, 20.0)
    first = pictures.draw(grid, 0)
    assert first is not None
    assert first[1] is not None
    gone = Filmed(coded.board_type, coded.stitch, coded.cameras, {**coded.frames}, coded.texts)
    del gone.frames[first[1]]
    second = pictures_of(gone, [*coded.frames]).draw(grid, 0)
    assert second is not None
    assert second[1] not in (None, first[1])
    assert pictures.draw(grid, len(coded.frames)) is None
    assert pictures_of(gone, [first[1]]).draw(grid, 0) is None
