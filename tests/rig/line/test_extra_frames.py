"""Frames on demand equal the frames rendered beforehand."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.simulated import to_bytes
from vaoi_station.errors import InternalError
from vaoi_station.rig.rendering import FrameRenderer, FrameRequest, RenderedBoard
from vaoi_station.simulation import Scenario, Twin, calibration_board


@pytest.fixture
def renderer(small: Scenario, tmp_path: Path) -> Iterator[FrameRenderer]:
    room = FrameRenderer(small, tmp_path / "late")
    yield room
    room.close()


def test_a_frame_on_demand_equals_the_rendered_one(renderer: FrameRenderer, boards: tuple[RenderedBoard, ...]) -> None:
    metadata = boards[1].metadata
    path = renderer.render(FrameRequest(1, metadata.pulses_s[2], "ring", 2))
    assert np.array_equal(np.fromfile(path, np.uint8), boards[1].map_frames()[2].reshape(-1))
    other = renderer.render(FrameRequest(1, metadata.pulses_s[2] + 0.001, "ring", 2))
    assert other != path
    assert not np.array_equal(np.fromfile(other, np.uint8), boards[1].map_frames()[2].reshape(-1))


def test_the_calibration_board_is_rendered_once(renderer: FrameRenderer, small: Scenario) -> None:
    path = renderer.render(FrameRequest(None))
    expected = np.concatenate([to_bytes(image) for _, _, image in calibration_board.frames(Twin(small))])
    assert np.array_equal(np.fromfile(path, np.uint8), expected)
    assert renderer.render(FrameRequest(None)) == path


def test_a_renderer_that_has_ended_is_reported(small: Scenario, tmp_path: Path) -> None:
    room = FrameRenderer(small, tmp_path / "late")
    with pytest.raises(InternalError, match="renders frames on demand has ended"):
        room.render(FrameRequest(0, 0.3, "no such light"))
    room.close()
