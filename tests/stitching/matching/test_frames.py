"""Tests of the frames of a run: what was doubtful when they were taken reaches the verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import Status
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.work import stitch_frames


@pytest.mark.parametrize(("width", "factor"), [(640, 4), (1392, 8), (2400, 16), (300, 4), (200, 4)])
def test_the_coarse_copy_is_at_least_150_pixels_wide(width: int, factor: int) -> None:
    frame = PreparedFrame(np.zeros((96, width), dtype=np.uint8))
    assert frame.factor == factor
    assert frame.coarse.shape == (96 // factor, width // factor)


DOUBT = "trigger of camera 1: it runs freely; these frames are not used"


def test_a_doubt_of_the_recording_is_the_first_reason_of_its_result(filmed: Any) -> None:
    """The same run without the doubt is ok."""
    assert filmed.stitch.status is Status.OK
    doubted = filmed.head.model_copy(update={"doubts": (DOUBT,)})
    stitch = stitch_frames(filmed.setup, doubted, filmed.frame)
    assert stitch.status is Status.DEGRADED
    assert stitch.reasons == (DOUBT,)


def test_without_any_usable_frame_the_doubts_explain_the_failure(filmed: Any) -> None:
    everything = tuple((i, j) for i in range(len(filmed.head.cameras)) for j in range(filmed.head.rows))
    head = filmed.head.model_copy(update={"doubts": (DOUBT,), "missing": everything})
    stitch = stitch_frames(filmed.setup, head, lambda *_: None)
    assert stitch.status is Status.FAILED
    assert DOUBT in stitch.reasons
