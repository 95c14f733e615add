"""Regions are drawn from the best frame, or from several; missing frames are passed over."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.identity.conftest import DATAMATRIX, Filmed
from vaoi_station.errors import StateError
from vaoi_station.identity.region_pictures import MOST_PX, RegionPictures
from vaoi_station.identity.symbols import read_symbols


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


def test_brightness_of_a_darker_frame_is_matched(on_seam: Filmed) -> None:
    dark = {key: (f * 0.5).astype(np.uint8) if key[0] else f for key, f in on_seam.frames.items()}
    uneven = Filmed(on_seam.board_type, on_seam.stitch, on_seam.cameras, dark, on_seam.texts)
    region = (10.0, 4.0, 22.0, 16.0)
    plain, matched = (p.draw(p.grid(region, 10.0), 0) for p in map(pictures_of, (on_seam, uneven)))
    assert plain is not None
    assert matched is not None
    ratio = plain[0].mean() / matched[0].mean()
    assert abs(np.log(ratio)) < 0.15 or abs(np.log(ratio / 2)) < 0.15


def test_large_region_gets_fewer_pixels_and_fine_frames_are_averaged(coded: Filmed) -> None:
    pictures = pictures_of(coded)
    whole = pictures.grid((0.0, 0.0, 1259.0, 787.0), 500.0)
    assert whole.width * whole.height <= MOST_PX
    small = pictures.draw(pictures.grid((0.0, 0.0, 1259.0, 787.0), 5.0), 0)
    assert small is not None
    assert small[0].shape == (100, 160)


def test_run_without_a_cad_mapping_is_refused(coded: Filmed) -> None:
    stitch = coded.stitch.model_copy(update={"cad_matrix": None})
    with pytest.raises(StateError, match="no CAD mapping"):
        RegionPictures(coded.board_type, stitch, coded.cameras, [], coded.frame)
