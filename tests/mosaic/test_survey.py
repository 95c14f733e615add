"""The survey: radiance of all frames on one small grid."""

from __future__ import annotations

import numpy as np

from tests.mosaic.conftest import DARK, Film, Filmed, radiance
from vaoi_station.geometry import apply
from vaoi_station.mosaic.survey import BLOCK, COARSE_PX, FieldCache, survey
from vaoi_station.photometry import FlatFields


def test_copies_show_the_board_at_their_places(film: Film) -> None:
    board = film(vignette=0.0, flicker=0.0)
    fields = FieldCache(FlatFields.none(dark=DARK))
    found = list(survey(board.taken, board.read, board.projector, board.base, fields))
    assert len(found) == len(board.taken)
    for s in found:
        assert (s.x0 % BLOCK, s.y0 % BLOCK) == (0, 0)
        y, x = np.argwhere(np.isfinite(s.values))[len(s.values) // 2 :: 50].T
        at = np.stack([x + s.x0, y + s.y0], -1) * float(COARSE_PX) + (COARSE_PX - 1) / 2
        expected = radiance(apply(board.base.cad_from_mosaic, at))
        assert np.abs(s.values[y, x] * 250 - expected).max() < 4


def test_missing_frames_and_saturated_places_are_left_out(board: Filmed) -> None:
    frames = dict(board.frames)
    del frames[0, 1]
    frames[1, 1] = np.full_like(frames[1, 1], 255)
    found = survey(
        board.taken, lambda i, j: frames.get((i, j)), board.projector, board.base, FieldCache(FlatFields.none())
    )
    by_key = {(s.taken.camera, s.taken.row): s for s in found}
    assert (0, 1) not in by_key
    assert not np.isfinite(by_key[1, 1].values).any()
