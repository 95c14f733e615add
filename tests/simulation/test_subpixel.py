"""Exact to a hundredth of a pixel: where things are seen against where the projection puts them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import apply
from vaoi_station.simulation import Passage, Twin
from vaoi_station.simulation.board.artwork import Artwork
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.canvas import Canvas, to_bytes
from vaoi_station.simulation.imaging.scene import LitTextures, Placement, Scene
from vaoi_station.simulation.imaging.sensor import expose
from vaoi_station.simulation.scenario import LightSection

Make = Callable[..., Twin]
Floats = NDArray[np.float64]


def _centroid(image: Floats, near: Floats, reach: float, ground: float) -> Floats:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    weight = (image - ground) * (np.hypot(x - near[0], y - near[1]) < reach)
    return np.asarray(np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum())


def _in_view(passage: Passage, board_mm: tuple[float, float]) -> tuple[int, Floats]:
    """The row that shows a point nearest to the middle, and its true pixel in camera 0."""
    pinhole, best = passage.twin.pinholes[0], []
    for row, t in enumerate(passage.pulse_times_s):
        place = apply(passage.pose(t), np.array([board_mm]))
        z = passage.twin.scene.surface_z(np.array([board_mm]))
        pixel = pinhole.project(place, z)[0]
        best.append((abs(pixel[1] - pinhole.height_px / 2), row, pixel))
    _, row, pixel = min(best, key=lambda b: b[0])
    return row, pixel


@pytest.mark.parametrize("shift_px", [0.0, 0.13, 0.25, 0.4, 0.5, 0.61, 0.75, 0.9])
def test_a_disc_is_seen_where_it_is(make: Make, shift_px: float) -> None:
    twin = make(
        array={"px_per_mm": 20.0, "distortion_px": 1.0, "psf_px": 0.6, "bits": 16, "exposures_us": [100.0],
               "reference_exposure_us": 100.0},
        belt={"offset_mm": shift_px / 20, "yaw_deg": 1.0},
        board={"fiducials": [{"x_mm": 15.0, "y_mm": 10.0}], "bow_mm": 0.5},
    )  # fmt: skip
    passage = twin.passage(0)
    row, true = _in_view(passage, (15.0, 10.0))
    seen = _centroid(passage.frame(0, row) / 256.0, true, 18.0, 46.0)
    assert np.abs(seen - true).max() < 0.01


@pytest.mark.parametrize("height_mm", [0.0, 1.0, 4.0])
def test_parallax_of_a_top_is_its_height_s(make: Make, height_mm: float) -> None:
    """A point h above the plane, s from the camera's foot, is seen s·h/(d − h) further out (mm in the plane)."""
    twin = make(array={"bits": 16}, board={"width_mm": 16.0, "length_mm": 12.0})
    camera, d = twin.pinholes[0], twin.scenario.array.working_distance_mm
    middle, scale = (4.43, 3.21), 11.0
    ground = Canvas.blank((-8.0, -6.0), (16.0, 12.0), scale, 50.0)
    cover = Canvas.blank((middle[0] - 2, middle[1] - 2), (4.0, 4.0), scale, 0.0)
    cover.disc(middle, 2.4, 255.0)
    a = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    outline = np.column_stack([np.cos(a), np.sin(a)]) * 1.2 + middle
    top = np.full_like(to_bytes(cover.grey), 200)
    body = Body(
        ref="C1", outline_mm=outline, height_mm=height_mm, side_grey=50.0, center_mm=middle, top=top,
        metal=np.zeros_like(top), cover=to_bytes(cover.grey), origin_mm=cover.origin_mm, px_per_mm=scale,
    )  # fmt: skip
    art = Artwork((), (body,), to_bytes(ground.grey), to_bytes(ground.metal), scale, ground.origin_mm)
    light = LightSection()
    samples = Scene(twin.scenario.board, art, 50.0).view(
        camera, np.eye(3), paint=LitTextures(art, light), light=light, placements={"C1": Placement((0.0, 0.0), 0.0)}
    )
    shade = np.ones((camera.height_px, camera.width_px), np.float32)
    image = expose(samples, twin.scenario.array, motion_px=np.zeros(2), brightness=1.0, shade=shade, noise=None)
    s = np.array(middle) - camera.foot_mm
    expected = camera.project((middle + s * height_mm / (d - height_mm))[None], 0.0)[0]
    assert np.abs(_centroid(image / 256.0, expected, 17.0, 50.0) - expected).max() < 0.01


@pytest.mark.parametrize("length_px", [2.0, 5.5])
def test_motion_blur_is_as_long_as_the_motion(make: Make, length_px: float) -> None:
    """A box of length L adds L²/12 to the second moment along the motion, and nothing across."""
    exposure_us = length_px / 20.0 / 100.0 * 1e6
    moments = []
    for exposure in (0.01, exposure_us):
        twin = make(
            array={"px_per_mm": 20.0, "bits": 16, "exposures_us": [exposure], "reference_exposure_us": exposure,
                   "roll_deg": 0.0},
            belt={"speed_wander": 0.0, "sway_mm": 0.0, "yaw_wander_deg": 0.0},
            board={"fiducials": [{"x_mm": 15.0, "y_mm": 10.0, "diameter_mm": 1.2}]},
        )  # fmt: skip
        passage = twin.passage(0)
        row, true = _in_view(passage, (15.0, 10.0))
        image = passage.frame(0, row) / 256.0
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        weight = (image - 46.0) * (np.hypot(x - true[0], y - true[1]) < 20)
        moments.append([(weight * (axis - at) ** 2).sum() / weight.sum() for axis, at in ((x, true[0]), (y, true[1]))])
    across, along = np.array(moments[1]) - moments[0]
    assert abs(across) < 0.05
    # the scale is 20 px/mm to the focal length's accuracy; the samples' interpolation adds 1/24
    assert along == pytest.approx(length_px**2 / 12 + 1 / 24, rel=0.03)
