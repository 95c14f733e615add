"""Gains from overlaps: flicker, the fall-off of the lenses and the dark level are found."""

from __future__ import annotations

import numpy as np
import pytest

from tests.mosaic.conftest import DARK, SIZE, Film
from vaoi_station.mosaic.gains import estimate_gains
from vaoi_station.mosaic.survey import FieldCache, survey
from vaoi_station.photometry import FlatFields
from vaoi_station.steps import completed


def test_flicker_field_and_dark_level_are_estimated(film: Film) -> None:
    board = film(flicker=0.03, step_mm=6.0, vignette=0.5)
    found = list(survey(board.taken, board.read, board.projector, board.base, FieldCache(FlatFields.none())))
    gains = completed(estimate_gains(found, board.cameras, calibrated=False))
    assert gains.dark == pytest.approx(DARK, abs=1.5)
    lamps = np.random.default_rng(3)
    expected = []
    for _ in range(5):
        expected.append(1 + lamps.normal(0, 0.03))
        lamps.normal(0, 0.5, (2, SIZE[1], SIZE[0]))
    # A gain that grows from row to row looks like a field with a slope: overlaps cannot distinguish them.
    rows = np.arange(5)
    difference = np.array([gains.frame[0, j] for j in range(5)]) - np.log(expected)
    assert np.abs(difference - np.polyval(np.polyfit(rows, difference, 1), rows)).max() < 0.006
    middle, edge = (float(np.exp(gains.log_field(0, board.cameras[0], np.array([159.5, y])))) for y in (119.5, 10.0))
    # the lamp falls off by 0.5 · 2 · 0.458² across the frame
    assert edge / middle == pytest.approx(1 - 0.21, abs=0.05)


def test_without_overlaps_gains_stay_at_one(film: Film) -> None:
    board = film(step_mm=30.0)
    found = list(survey(board.taken[:1], board.read, board.projector, board.base, FieldCache(FlatFields.none())))
    gains = completed(estimate_gains(found, board.cameras, calibrated=False))
    assert gains.frame == {(0, 0): 0.0}
    assert gains.dark == 0.0
    assert gains.log_field(1, board.cameras[1], np.zeros((3, 2))).tolist() == [0, 0, 0]
