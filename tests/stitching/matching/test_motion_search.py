"""The motion between two rows in the whole range of a belt, from textures that are formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.motion_search import candidate_motions
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame

NOMINAL = np.array([0.0, 10.0])


def pair_of(workshop: Any, motion: tuple[float, float], seed: int = 0) -> FramePair:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    texture = workshop.waves(seed=seed, finest=0.8, coarsest=6.0)
    a, b = (
        PreparedFrame(texture.seen_by(camera, lambda at, by=by: at - np.asarray(by))) for by in ((0.0, 0.0), motion)
    )
    return FramePair(a, b, camera, camera, NOMINAL)


@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.3, 4.0), (0.0, 10.0), (-0.4, 14.5)])
def test_a_motion_from_none_to_one_and_a_half_is_found(workshop: Any, motion: tuple[float, float]) -> None:
    pairs = [pair_of(workshop, motion, seed) for seed in (1, 2)]
    assert np.hypot(*(candidate_motions(pairs)[0] - motion)) < 0.5


def test_unrelated_and_empty_frames_have_no_motion_in_common(workshop: Any) -> None:
    camera = workshop.camera(size_px=(320, 240), px_per_mm=10.0)
    empty = PreparedFrame(np.full((240, 320), 20, np.uint8))
    assert candidate_motions([FramePair(empty, empty, camera, camera, NOMINAL)]) == []
    assert candidate_motions([]) == []
