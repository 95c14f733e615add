"""Frames that show the moment of the frame before, from textures that are formulas and by a drawing of the twin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hostile import judging
from tests.hostile.drawing import draw
from tests.hostile.filming import film
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene
from vaoi_station.stitching.quality.confirmation import repeated_frames

SIZE_PX, PX_PER_MM, STEP_MM = (320, 240), 10.0, 3.0
MOTION = Motion(np.zeros(2), np.array([(0.0, 0.0), (-STEP_MM, 0.0)]), np.zeros(2))
"""The board is carried 3 mm along x from row 0 to row 1."""
C = np.array([1.0, 0.0, 0.0, 0.0])


class Filmed:
    """Two frames of one camera: a board whose texture is a formula, with a bed that stands still beside it."""

    def __init__(self, workshop: Any) -> None:
        self.camera = workshop.camera(size_px=SIZE_PX, px_per_mm=PX_PER_MM)
        self.texture, self.bed = (workshop.waves(seed=seed, finest=6.0) for seed in (3, 4))

    def board(self, row: int) -> NDArray[np.uint8]:
        shift = MOTION.rows_from_tester[row][:2, 2] * PX_PER_MM
        picture: NDArray[np.uint8] = self.texture.picture(*SIZE_PX, (float(shift[0]), float(shift[1])))
        return picture

    def repeated(self, *pictures: NDArray[np.uint8], width_mm: float = 200.0) -> bool:
        """Return whether the second picture is found to repeat the first, on a board of this width; 0: no outline."""
        half = width_mm / 2 or 100.0
        corners = [(x, y) for x, y in ((-half, -100.0), (half, -100.0), (half, 100.0), (-half, 100.0))]
        board = BoardType.model_validate(
            {
                "name": "b",
                "outline": corners if width_mm else None,
                "fiducials": [
                    {"name": f"F{n}", "x": x, "y": y, "diameter": 1.0} for n, (x, y) in enumerate(corners[:2])
                ],
                "components": [{"ref": "U1", "center": (0, 0), "width": 5, "height": 5}],
            }
        )
        frames = {(0, row): PreparedFrame(picture) for row, picture in enumerate(pictures)}
        scene = Scene((self.camera,), tuple(frames), frames.__getitem__)
        found = repeated_frames(frames, BoardPlane(board, False), C, scene, MOTION)
        assert found <= {(0, 1)}, "there is no frame before the first"
        return bool(found)


@pytest.fixture
def filmed(workshop: Any) -> Filmed:
    return Filmed(workshop)


def noisy(picture: NDArray[np.uint8], sigma: float = 2.0) -> NDArray[np.uint8]:
    grey = picture + np.random.default_rng(5).normal(0, sigma, picture.shape)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def test_only_a_frame_that_shows_the_board_in_the_same_place_is_a_repeated_one(filmed: Filmed) -> None:
    assert filmed.repeated(filmed.board(0), noisy(filmed.board(0)))
    assert not filmed.repeated(filmed.board(0), noisy(filmed.board(1)))
    assert not filmed.repeated(filmed.board(0), noisy(filmed.bed.picture(*SIZE_PX))), "it shows neither"


def test_few_links_that_fit_by_chance_do_not_confirm_a_repeated_frame() -> None:
    """3 of 3 links to the row before fit, and 4 of 6 in all (hostile seed 91090, 63 px off before)."""
    film_of = film(draw(91090))
    (wrong,) = (key for key, source in film_of.filmed.items() if key != source)
    outcome = judging.judge(91090)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert outcome.rms_px < 0.1, "the other frames place all components"
    assert any("1 of them repeat the moment of the frame before" in reason for reason in outcome.reasons)
    result, _ = judging.stitched(film_of)
    assert result.image_matrices[wrong[0]][wrong[1]] is None
