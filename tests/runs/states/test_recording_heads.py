"""Heads of recordings state which frames are missing; their frames have a size in every pixel format."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import FrameRecord, RecordingHead, Verdict
from vaoi_station.runs.states.recording_heads import bytes_of_frames


@pytest.mark.parametrize(("dtype", "shape"), [(np.uint8, (48, 64)), (np.uint16, (48, 64)), (np.uint8, (48, 64, 3))])
def test_room_is_made_for_every_pixel_format(
    make_head: Callable[..., RecordingHead], dtype: Any, shape: tuple[int, ...]
) -> None:
    head = make_head(3).model_copy(update={"missing": ((0, 0),)})
    frames = [
        FrameRecord(camera=camera, row=row, verdict=Verdict.OK, slot=3 * camera + row)
        for camera in range(2)
        for row in range(3)
    ]
    expected = bytes_of_frames(frames, head, lambda _: np.zeros(shape, dtype))
    assert expected == 2 * 3 * np.zeros(shape, dtype).nbytes
