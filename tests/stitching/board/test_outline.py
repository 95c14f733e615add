"""The shift of the outline, in every direction that visible edges determine."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.outline import measure_outline_contrast, measure_outline_shift
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

PLACED = np.array([[1.0, 0, -14.0], [0, 1, -10.0], [0, 0, 1]])
STILL = nominal_motion(np.array([0.0]), np.zeros(2), np.zeros(2))


def board(w: float = 28.0, h: float = 20.0) -> BoardType:
    return BoardType.model_validate({"name": "b", "y_axis": "down", "outline": [[0.0, 0.0], [w, h]]})


def scene(
    workshop: Any, size: tuple[float, float] = (28.0, 20.0), grey: float = 80.0, pads_mm: float | None = None
) -> Scene:
    """One frame of a board at rest, its edges blurred as a lens does, with some texture of its own.

    `pads_mm`: a row of bright pads along the left edge begins this far inside.
    """
    camera = workshop.camera((0.0, 0.0), size_px=(440, 320))
    y, x = np.mgrid[:320, :440].astype(float)
    cad = apply(np.linalg.inv(PLACED), camera.ground(np.stack([x, y], -1).reshape(-1, 2))).reshape(320, 440, 2)
    inside = ((cad >= 0) & (cad <= size)).all(-1)
    spots = ((np.floor(cad[..., 0] / 1.7) + np.floor(cad[..., 1] / 1.3)) % 3 == 0) * 25.0
    levels = np.where(inside, grey + spots, 20.0)
    if pads_mm is not None:
        levels[inside & (cad[..., 0] >= pads_mm) & (cad[..., 0] < pads_mm + 1.5)] = 250.0
    picture = cv2.GaussianBlur(levels, (0, 0), 0.8)
    picture += np.random.default_rng(0).normal(0, 2, picture.shape)
    frame = PreparedFrame(workshop.digitised(picture))
    return Scene((camera,), ((0, 0),), lambda key: frame)


def exposed(workshop: Any, exposures: dict[tuple[float, float], float]) -> Scene:
    """One frame of the board at rest from each camera centre, mm, at this share of the usual exposure."""
    cameras = tuple(workshop.camera(center, size_px=(440, 320)) for center in exposures)
    y, x = np.mgrid[:320, :440].astype(float)
    frames = {}
    for n, (camera, share) in enumerate(zip(cameras, exposures.values(), strict=True)):
        cad = apply(np.linalg.inv(PLACED), camera.ground(np.stack([x, y], -1).reshape(-1, 2))).reshape(320, 440, 2)
        inside = ((cad >= 0) & (cad <= (28.0, 20.0))).all(-1)
        spots = ((np.floor(cad[..., 0] / 1.7) + np.floor(cad[..., 1] / 1.3)) % 3 == 0) * 25.0
        levels = share * cv2.GaussianBlur(np.where(inside, 80.0 + spots, 20.0), (0, 0), 0.8)
        noise = np.random.default_rng(n).normal(0, 1, levels.shape)
        frames[n, 0] = PreparedFrame(workshop.digitised(levels + noise))
    return Scene(cameras, tuple(sorted(frames)), frames.__getitem__)


@pytest.mark.parametrize("share", [0.02, 50.0])
def test_the_outline_is_seen_in_frames_that_are_well_exposed(workshop: Any, share: float) -> None:
    """Most of it lies nearest to the centre of a frame that is almost black, or saturated everywhere."""
    mixed = exposed(workshop, {(0.0, 0.0): share, (6.0, 0.0): 1.0})
    contrast = measure_outline_contrast(board(), PLACED, mixed, STILL)
    assert contrast is not None
    assert contrast.visible
    assert contrast.contrast > 30
    found, alone = (
        measure_outline_shift(board(), moved(0.3, -0.2), s, STILL)
        for s in (mixed, exposed(workshop, {(6.0, 0.0): 1.0}))
    )
    assert found is not None
    assert alone is not None
    assert found.pieces >= alone.pieces
    assert found.mm == pytest.approx([-0.3, 0.2], abs=0.05)


def moved(x_mm: float, y_mm: float) -> Any:
    return np.array([[1.0, 0, x_mm], [0, 1, y_mm], [0, 0, 1]]) @ PLACED


@pytest.mark.parametrize("grey", [80.0, 5.0])
@pytest.mark.parametrize("off", [(0.3, -0.2), (-2.2, 1.7)])
def test_the_outline_is_measured_to_a_few_hundredths_of_a_mm(
    workshop: Any, off: tuple[float, float], grey: float
) -> None:
    found = measure_outline_shift(board(), moved(*off), scene(workshop, grey=grey), STILL)
    assert found is not None
    assert found.mm == pytest.approx([-v for v in off], abs=0.05)
    assert found.sigma_mm.max() < 0.12
    assert abs(found.turn_rad) < 6e-3
    expected = float(np.linalg.norm([v for v in off if abs(v) > 0.5]))
    assert found.excess_mm == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("pads_mm", [1.6, 2.5])
def test_a_row_of_bright_pads_inside_is_no_edge_of_the_board(workshop: Any, pads_mm: float) -> None:
    found = measure_outline_shift(board(), PLACED, scene(workshop, grey=20.0, pads_mm=pads_mm), STILL)
    assert found is not None
    assert np.abs(found.mm).max() < 0.1
    # A board that lies elsewhere is still found.
    elsewhere = measure_outline_shift(board(), moved(1.2, 0.0), scene(workshop, pads_mm=pads_mm), STILL)
    assert elsewhere is not None
    assert elsewhere.mm == pytest.approx((-1.2, 0.0), abs=0.1)


@pytest.mark.parametrize("mrad", [-40, 25])
def test_a_turn_is_measured(workshop: Any, mrad: float) -> None:
    c, s = np.cos(1e-3 * mrad), np.sin(1e-3 * mrad)
    found = measure_outline_shift(
        board(), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ PLACED, scene(workshop), STILL
    )
    assert found is not None
    assert 1e3 * found.turn_rad == pytest.approx(-mrad, abs=5)
    assert found.turned_mm == pytest.approx(1e-3 * abs(mrad) * 17, abs=0.1)
