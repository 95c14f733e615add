"""Texture that stands still, or has moved by a known distance, from textures that are formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.link import STATIC_PX, shows_patches, static_corners

PLACES = np.array([[60.5, 50.5], [160.5, 120.5], [20.5, 120.5], [300.5, 200.5]])


def test_a_patch_is_shown_only_where_its_texture_is(workshop: Any) -> None:
    texture = workshop.waves(seed=3, finest=6.0)
    a, moved = (PreparedFrame(texture.picture(320, 240, shift)).grey for shift in ((0.0, 0.0), (30.0, 0.0)))
    shown, tested = shows_patches(a, moved, PLACES, PLACES + (30.0, 0.0), STATIC_PX)
    assert tested.tolist() == [True, True, True, False]
    assert shown.tolist() == [True, True, True, False]
    in_place, _ = shows_patches(a, moved, PLACES, PLACES, STATIC_PX)
    assert not in_place.any()
    beyond, _ = shows_patches(a, moved, PLACES, PLACES + (33.0, 0.0), STATIC_PX)
    assert not beyond.any()
    none, _ = shows_patches(a, moved, np.zeros((0, 2)), np.zeros((0, 2)), STATIC_PX)
    assert none.shape == (0,)


def test_static_corners_are_those_that_stand_still(workshop: Any) -> None:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    bed, board = (workshop.waves(seed=seed, finest=6.0) for seed in (3, 4))
    still = bed.picture(320, 240)
    half = still.copy()
    half[:, 160:] = board.picture(320, 240)[:, 160:]
    frames = [PreparedFrame(picture) for picture in (still, half, board.picture(320, 240))]
    counts = [static_corners(FramePair(frames[0], b, camera, camera, np.zeros(2))) for b in frames]
    assert counts[0] > 1.5 * counts[1] > 0
    assert counts[2] == 0
    away = FramePair(frames[0], frames[0], camera, camera, np.array([0.0, 100.0]))
    assert static_corners(away) == 0
