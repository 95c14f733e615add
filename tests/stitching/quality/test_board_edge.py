"""Frames that show hardly more of the board than its end, from drawn edges and by drawings of the twin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hostile.judging import judge
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.quality.confirmation import frames_with_edge

SIZE_PX, PX_PER_MM, STEP_MM = (320, 240), 10.0, 6.0
MOTION = Motion(np.zeros(2), np.array([(0.0, 0.0), (-STEP_MM, 0.0)]), np.zeros(2))
"""The board is carried 6 mm along x from row 0 to row 1."""
END_MM = 1.0
"""x of the board's end on the conveyor in row 0; the board lies to the left of it."""


class Station:
    """One camera above a board without texture, of which frames show the end."""

    def __init__(self, workshop: Any) -> None:
        self._workshop, self.camera = workshop, workshop.camera(size_px=SIZE_PX, px_per_mm=PX_PER_MM)

    def picture(self, *edges: tuple[float, float], noise: float = 2.0, seed: int = 1) -> NDArray[np.uint8]:
        """Draw a picture that is brighter by a step to the left of each edge, which are (x mm, step)."""
        x = self.camera.ground(np.stack([np.arange(SIZE_PX[0]), np.full(SIZE_PX[0], 120.0)], -1))[:, 0]
        levels = 50 + sum(step * np.clip(0.5 + (at - x) * PX_PER_MM, 0, 1) for at, step in edges)
        rng = np.random.default_rng(seed)
        drawn: NDArray[np.uint8] = self._workshop.digitised(levels + rng.normal(0, noise, (SIZE_PX[1], SIZE_PX[0])))
        return drawn

    def confirmed(self, *pictures: NDArray[np.uint8] | None, outline: bool = True) -> set[int]:
        """Return the rows whose pictures are found to show the board's end; None is a frame that is missing."""
        corners = [(-60.0, -40.0), (END_MM, -40.0), (END_MM, 40.0), (-60.0, 40.0)]
        board = BoardType.model_validate(
            {
                "name": "b",
                "outline": corners if outline else None,
                "fiducials": [{"name": n, "x": x, "y": 0, "diameter": 1} for n, x in (("A", -50), ("B", -9))],
                "components": [{"ref": "U1", "center": (-30, 0), "width": 5, "height": 5}],
            }
        )
        frames = {(0, row): PreparedFrame(one) for row, one in enumerate(pictures) if one is not None}
        scene = Scene((self.camera,), tuple(frames), frames.__getitem__)
        velocity = np.array([10.0, 0.0])
        found = frames_with_edge(frames, BoardPlane(board, False), np.eye(3), scene, MOTION, velocity)
        return {row for _, row in found}


@pytest.fixture
def station(workshop: Any) -> Station:
    return Station(workshop)


def end_in(row: int) -> float:
    return END_MM + row * STEP_MM


@pytest.mark.parametrize("off_mm", [-2.0, 0.4])
def test_an_end_that_is_elsewhere_confirms_nothing(station: Station, off_mm: float) -> None:
    assert station.confirmed(station.picture((end_in(0) + off_mm, 40.0))) == set()


def test_a_repeated_picture_with_another_edge_in_this_place_is_not_confirmed(station: Station) -> None:
    """The rim of a carrier may end where the board's end should be a row later."""
    carrier = (end_in(0), 30.0), (end_in(1), 120.0)
    assert station.confirmed(station.picture(*carrier), station.picture(*carrier, seed=2)) == {0}


def test_a_frame_with_a_strip_of_the_board_on_a_bed_is_confirmed() -> None:
    """Its corners lie on the bed, which looks alike at any time, so that no link shows its moment."""
    outcome = judge(106435)
    assert (outcome.status, outcome.finds) == ("ok", ()), outcome.reasons


def test_the_edge_of_a_carrier_does_not_confirm_a_repeated_frame() -> None:
    outcome = judge(104256)
    assert (outcome.status, outcome.finds) == ("degraded", ()), outcome.reasons
