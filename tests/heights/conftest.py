"""Frames of blocks over a board, computed point by point from smooth textures, so that no resampling errs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Status, Stitch

PX_PER_MM, WIDTH, HEIGHT, DISTANCE_MM, STEP_MM = 20.0, 260, 240, 150.0, 4.0


@dataclass(frozen=True)
class Filmed:
    """A run with its frames."""

    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    frames: dict[tuple[int, int], NDArray[np.uint8]]

    def frame(self, camera: int, row: int) -> NDArray[np.uint8] | None:
        return self.frames.get((camera, row))


ROW_MM = {f"U{n}": ((0.0, 1.2 * n - 3.6, 3.0, 1.2), 1.1, 1.0) for n in range(1, 6)}
"""Parts of `make_film` side by side along the belt, each 1.2 mm wide and 1 mm high."""


class Scene(NamedTuple):
    """What is filmed besides the parts' places, and from where."""

    alike: bool = False
    """Whether all tops have one texture."""
    blank: float | None = None
    """Grey level of tops without texture."""
    distance_mm: float = DISTANCE_MM
    seed: int = 5
    """Of the noise."""


PLAIN = Scene()


def smooth_texture(seed: int, contrast: float) -> Callable[[Floats], Floats]:
    """Return a function of points (…, 2) in mm: a sum of waves of 0.25 to 2 mm."""
    g = np.random.default_rng(seed)
    waves = 2 * np.pi / g.uniform(0.25, 2.0, 24)
    angles, phases = g.uniform(0, 2 * np.pi, (2, 24))
    k = waves[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])

    def texture(at: Floats) -> Floats:
        return np.asarray(110 + contrast * np.sin(at @ k.T + phases).sum(-1) / np.sqrt(12))

    return texture


def make_film(
    parts: dict[str, tuple[tuple[float, float, float, float], float, float]],
    *,
    rows: int = 4,
    step_mm: float = STEP_MM,
    noise: float = 1.5,
    contrast: float = 30.0,
    gain: Callable[[int], float] = lambda row: 1.0,
    top: Callable[[int, str], int] = lambda row, ref: 0,
    scene: Scene = PLAIN,
) -> Filmed:
    """Film parts (x, y, width, height; share of the footprint that the body covers; its height), all in mm.

    `gain` is the brightness of a row. `top` chooses the texture of a body in a row: another one for another light.
    """
    n = Projective(np.array([[PX_PER_MM, 0, 130.0], [0, PX_PER_MM, 120.0], [0, 0, 1.0]]), System.IMAGE, System.ROW)
    camera = Camera(WIDTH, HEIGHT, n, Lens((130.0, 120.0), 100.0), scene.distance_mm)
    board, g = smooth_texture(1, contrast), np.random.default_rng(scene.seed)
    px = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).astype(np.float64)
    frames, motion = {}, []
    for j in range(rows):
        d = np.array([[1, 0, 0], [0, 1, (j - (rows - 1) / 2) * step_mm], [0, 0, 1.0]])
        shift = np.array([0.0, d[1, 2]])
        motion.append(d)
        image = board(camera.ground(px) - shift)
        for number, (ref, ((x, y, w, h), share, mm)) in enumerate(parts.items()):
            at = camera.ground(px, mm) - shift - (x, y)
            # The share of each pixel that the body covers: the edges of a blank body are all that can be seen of it.
            covered = np.clip((np.array([w, h]) / 2 * share - np.abs(at)) * PX_PER_MM + 0.5, 0, 1).prod(-1)
            inside = covered > 0
            if mm > 0:
                look = smooth_texture(100 + (0 if scene.alike else number) + 1000 * top(j, ref), contrast)
                body = look(at[inside]) if scene.blank is None else scene.blank
                image[inside] += covered[inside] * (body - image[inside])
        frames[0, j] = np.clip(image * gain(j) + g.normal(0, noise, image.shape), 0, 255).round().astype(np.uint8)
    first = np.linalg.inv(motion[0])
    board_type = BoardType(
        name="blocks",
        y_axis="down",
        outline=((-20, -20), (20, 20)),
        components=[
            {"ref": ref, "center": box[:2], "width": box[2], "height": box[3], "body_height": mm}
            for ref, (box, _, mm) in parts.items()
        ],
    )
    stitch = Stitch.model_construct(
        method="auto",
        image_matrices=(tuple(n.matrix @ d @ first for d in motion),),
        cad_matrix=motion[0],
        row_motion=tuple(d @ first for d in motion),
        status=Status.OK,
        quality={"row_sigma_px": [0.01] * rows},
        surface=None,
        camera_matrices=None,
    )
    return Filmed(board_type, stitch, (camera,), frames)


@pytest.fixture
def film() -> Any:
    return make_film


@pytest.fixture(scope="session")
def filmed() -> Filmed:
    """Blocks that fill their footprints, a body between leads, and a missing part."""
    return make_film(
        {
            "U1": ((-2.0, 0.0, 3.0, 2.5), 1.0, 1.5),
            "U2": ((2.5, 0.0, 3.5, 3.5), 0.64, 2.2),
            "U3": ((-2.5, 3.2, 2.0, 1.2), 1.0, 0.8),
            "U4": ((2.0, -3.5, 2.0, 1.5), 1.0, 0.0),
        }
    )
