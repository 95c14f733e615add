"""Plans: every cell has a frame, lost frames are replaced by others, and layers of HDR are planned together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.mosaic.conftest import DARK, Film, Filmed
from vaoi_station.mosaic import MosaicPlan, choose_frames, make_plan
from vaoi_station.mosaic.seams import NO_FRAME
from vaoi_station.photometry import FlatFields
from vaoi_station.steps import completed


def plan_of(board: Filmed, *, hdr: bool = False, fields: FlatFields | None = None) -> MosaicPlan:
    steps = make_plan(
        choose_frames(board.taken, hdr=hdr),
        board.read,
        projector=board.projector,
        board_type=board.board_type,
        stitch=board.stitch,
        base=board.base,
        fields=fields,
    )
    return completed(steps)


def test_every_cell_has_a_frame(board: Filmed) -> None:
    plan = plan_of(board)
    assert plan.covered == 1.0
    assert set(np.unique(plan.layers[0])) <= set(range(len(plan.frames)))
    assert plan.tone[0] < 100 / 250 < plan.tone[1]
    assert plan.dark_correction.keys() == {0, 1}


def test_lost_frames_are_replaced_by_their_neighbours(board: Filmed) -> None:
    lost = replace(board, frames={key: p for key, p in board.frames.items() if key[1] != 2})
    plan = plan_of(lost)
    assert plan.covered == 1.0
    assert all(frame.taken.row != 2 for frame in plan.frames)


def test_without_usable_frames_nothing_is_covered(board: Filmed) -> None:
    plan = plan_of(replace(board, frames={}))
    assert plan.covered == 0.0
    assert (plan.layers[0] == NO_FRAME).all()


def test_each_exposure_has_a_layer(film: Film) -> None:
    plan = plan_of(film(exposures=(250.0, 50.0), step_mm=6.0), hdr=True)
    rows = [{plan.frames[n].taken.row for n in np.unique(layer) if n != NO_FRAME} for layer in plan.layers]
    assert rows == [{0, 2, 4}, {1, 3}]


def test_known_dark_level_is_kept(film: Film) -> None:
    fields = FlatFields.none(dark=DARK)
    plan = plan_of(film(vignette=0.0), fields=fields)
    assert plan.dark_correction[0] == pytest.approx(DARK, abs=1.0)
