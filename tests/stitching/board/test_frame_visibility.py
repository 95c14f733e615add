"""The compiled choice of frames, against the camera model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.geometry import FrameArrays
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

MOTION = Motion(np.array([0.0, 0.004, -0.003]), np.array([[0.0, 0], [0.2, -9.0], [-0.1, -18.0]]), np.array([5.0, 1.0]))


def scene(workshop: Any) -> Scene:
    bent = Lens((99.5, 79.5), 128.0, (-0.004, 0.001))
    cameras = (
        workshop.camera((0, 0), angle_rad=0.01, lens=bent),
        workshop.camera((17, 1), angle_rad=-0.006, lens=Lens((99.5, 79.5), 128.0, (0.003,))),
        workshop.camera((34, 0), tilt=(1e-4, -2e-4)),
    )
    present = tuple((i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1))
    frames = {key: PreparedFrame(np.full((160, 200), 10 * n + 5, dtype=np.uint8)) for n, key in enumerate(present)}
    return Scene(cameras, present, frames.__getitem__)


def shown(camera: Camera, at: NDArray[np.float64], row: int) -> NDArray[np.float64]:
    return camera.project(MOTION.row_from_tester(row)(at))


def test_the_frame_that_shows_a_point_nearest_to_its_middle_is_chosen(workshop: Any) -> None:
    s = scene(workshop)
    points = np.random.default_rng(0).uniform((-12, -28), (46, 12), (400, 2))
    number = FrameArrays.of(s, MOTION).nearest(points)
    off = np.full((len(points), len(s.present)), np.inf)
    for n, (i, j) in enumerate(s.present):
        camera = s.cameras[i]
        px = shown(camera, points, j)
        inside = camera.sees(px, camera.px_per_mm)
        off[inside, n] = np.hypot(*(px[inside] - camera.center_px).T)
    none = np.isinf(off).all(1)
    assert 0 < none.sum() < len(points) / 2
    np.testing.assert_array_equal(number, np.where(none, -1, off.argmin(1)))


def test_a_frame_of_little_contrast_is_taken_where_no_other_shows_the_point(workshop: Any) -> None:
    s, noise = scene(workshop), np.random.default_rng(3)
    points = noise.uniform((-12, -28), (46, 12), (400, 2))
    near = FrameArrays.of(s, MOTION).nearest(points)
    faint = 0
    frames = {
        key: PreparedFrame(noise.integers(0, 10 if n == faint else 100, (160, 200)).astype(np.uint8))
        for n, key in enumerate(s.present)
    }
    number = FrameArrays.of(Scene(s.cameras, s.present, frames.__getitem__), MOTION).nearest(points)
    others = tuple(key for n, key in enumerate(s.present) if n != faint)
    elsewhere = FrameArrays.of(Scene(s.cameras, others, frames.__getitem__), MOTION).nearest(points)
    np.testing.assert_array_equal(number, np.where(elsewhere >= 0, elsewhere + 1, near))
    assert 0 < (number == faint).sum() < (near == faint).sum()


def test_projected_points_match_the_camera_model(workshop: Any) -> None:
    s = scene(workshop)
    frames = FrameArrays.of(s, MOTION)
    pieces = np.random.default_rng(1).uniform((-8, -24), (40, 8), (60, 1, 2)) + np.random.default_rng(2).normal(
        0, 0.5, (60, 3, 2)
    )
    number = frames.nearest(pieces.mean(1))
    px = frames.project(number, pieces)
    for k, n in enumerate(number):
        if n < 0:
            assert np.isnan(px[k]).all()
        else:
            i, j = s.present[n]
            assert px[k] == pytest.approx(shown(s.cameras[i], pieces[k], j), abs=1e-9)
    read = frames.read_samples(number, 2, lambda image, mine: np.stack([np.full(len(mine), image[0, 0]), mine], -1))
    np.testing.assert_array_equal(read[number < 0], np.nan)
    np.testing.assert_array_equal(read[number >= 0, 0], 10 * number[number >= 0] + 5)
    np.testing.assert_array_equal(read[number >= 0, 1], np.flatnonzero(number >= 0))
