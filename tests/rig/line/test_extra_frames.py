"""Frames on demand are those that would have been filmed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.simulated.board import to_bytes
from vaoi_station.errors import InternalError
from vaoi_station.rig.line.extra_frames import FrameRenderer, FrameRequest
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.simulation import Scenario, Twin, calibration_board


@pytest.fixture
def renderer(small: Scenario, tmp_path: Path) -> Iterator[FrameRenderer]:
    room = FrameRenderer(small, tmp_path / "late")
    yield room
    room.close()


def test_a_view_of_a_board_is_what_the_film_has(renderer: FrameRenderer, filmed: tuple[RenderedBoard, ...]) -> None:
    metadata = filmed[1].metadata
    path = renderer.render(FrameRequest(1, metadata.pulses_s[2], "ring", 2))
    assert np.array_equal(np.fromfile(path, np.uint8), filmed[1].map_frames()[2].reshape(-1))
    other = renderer.render(FrameRequest(1, metadata.pulses_s[2] + 0.001, "ring", 2))
    assert other != path
    assert not np.array_equal(np.fromfile(other, np.uint8), filmed[1].map_frames()[2].reshape(-1))


def test_between_boards_the_calibration_board_lies_still(renderer: FrameRenderer, small: Scenario) -> None:
    path = renderer.render(FrameRequest(None))
    expected = np.concatenate([to_bytes(image) for _, _, image in calibration_board.frames(Twin(small))])
    assert np.array_equal(np.fromfile(path, np.uint8), expected)
    assert renderer.render(FrameRequest(None)) == path


def test_a_renderer_that_has_ended_is_reported(small: Scenario, tmp_path: Path) -> None:
    room = FrameRenderer(small, tmp_path / "late")
    with pytest.raises(InternalError, match="renders frames on demand has ended"):
        room.render(FrameRequest(0, 0.3, "no such light"))
    room.close()
