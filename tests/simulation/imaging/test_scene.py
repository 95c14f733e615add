"""Light, shadow, walls and hiding: what one camera sees of boards with a single body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.simulation import Twin
from vaoi_station.simulation.board.artwork import Artwork
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.canvas import Canvas, to_bytes
from vaoi_station.simulation.imaging.scene import LitTextures, Placement, Scene
from vaoi_station.simulation.scenario import BoardSection, LightSection

Make = Callable[..., Twin]
Array = NDArray[np.float64]
BOARD, TOP, WALL, BELT, SCALE = 60.0, 200.0, 90.0, 15.0, 11.0
AS_PLACED = Placement((0.0, 0.0), 0.0)
SHIFTS, TURNS = st.floats(-0.5, 0.5), st.floats(-0.2, 0.2)


def block(ref: str, center: tuple[float, float], size: float, height_mm: float, top_grey: float = TOP) -> Body:
    """A square body with an even top."""
    origin = (center[0] - size / 2 - 1.0, center[1] - size / 2 - 1.0)
    cover = Canvas.blank(origin, (size + 2, size + 2), SCALE, 0.0)
    cover.box(center, (size, size), 255.0)
    outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 + center
    top = np.full_like(to_bytes(cover.grey), int(top_grey))
    return Body(
        ref=ref, outline_mm=outline, height_mm=height_mm, side_grey=WALL, center_mm=center, top=top,
        metal=np.zeros_like(top), cover=to_bytes(cover.grey), origin_mm=origin, px_per_mm=SCALE,
    )  # fmt: skip


def scene_of(*bodies: Body, section: BoardSection | None = None, metal: float = 0.0) -> Scene:
    """A board of 20 × 16 mm about the origin of the tester."""
    ground = Canvas.blank((-10.0, -8.0), (20.0, 16.0), SCALE, BOARD)
    ground.metal[:] = metal
    art = Artwork((), bodies, to_bytes(ground.grey), to_bytes(ground.metal, 255), SCALE, ground.origin_mm)
    return Scene(section or BoardSection(width_mm=20.0, length_mm=16.0), art, BELT)


def view(
    make: Make, scene: Scene, light: LightSection | None = None, **placements: Placement | None
) -> tuple[Any, Array]:
    """The camera, and the mean of its 2 × 2 samples, (h, w)."""
    camera, light = make().pinholes[0], light or LightSection()
    known = {body.ref: AS_PLACED for body in scene.artwork.bodies} | placements
    samples = scene.view(camera, np.eye(3), paint=LitTextures(scene.artwork, light), light=light, placements=known)
    h, w = samples.shape
    return camera, np.asarray(samples.reshape(h // 2, 2, w // 2, 2).mean((1, 3)), np.float64)


def grey_at(camera: Any, image: Array, place: tuple[float, float], z_mm: float = 0.0) -> float:
    """Grey value at the pixel that shows a tester place."""
    x, y = camera.project(np.array([place]), z_mm)[0].round().astype(int)
    return float(image[y, x])


def test_the_wall_towards_the_camera_is_seen_and_the_other_is_hidden(make: Make) -> None:
    _, image = view(make, scene_of(block("C1", (5.0, 0.0), 2.0, 40.0)))
    row = image[60]
    wall = np.flatnonzero(np.abs(row - WALL) < 1)
    top = np.flatnonzero(np.abs(row - TOP) < 1)
    assert len(wall) >= 1
    assert wall.max() < top.min()


def test_an_absent_part_leaves_the_bare_board(make: Make) -> None:
    camera, image = view(make, scene_of(block("C1", (2.0, 1.0), 2.0, 3.0)), C1=None)
    assert grey_at(camera, image, (2.0, 1.0)) == BOARD
    assert set(np.unique(image)) == {BOARD}


def test_a_shifted_part_is_seen_where_it_was_placed(make: Make) -> None:
    centers = []
    for shift in ((0.0, 0.0), (0.5, -0.3)):
        _, image = view(make, scene_of(block("C1", (0.0, 0.0), 2.0, 0.5)), C1=Placement(shift, 0.0))
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        weight = image - BOARD
        centers.append(np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum())
    scale = 10.0 * (1 + 0.002)
    assert np.abs((centers[1] - centers[0]) - np.array([0.5, -0.3]) * scale).max() < 0.05


def test_the_body_nearer_to_the_camera_hides_the_one_behind_it(make: Make) -> None:
    near, far = block("U1", (4.0, 0.0), 2.0, 30.0, 220.0), block("U2", (6.2, 0.0), 2.0, 1.0, 120.0)
    for bodies in ((near, far), (far, near)):
        camera, image = view(make, scene_of(*bodies))
        assert grey_at(camera, image, (5.4, 0.0), 1.0) == 220.0
        assert grey_at(camera, image, (6.8, 0.0), 1.0) == 120.0
