"""A board of two bodies, filmed by two cameras in five rows: radiance, matrices, lamps and dark level are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, Lens, Projective, System, apply
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic import MosaicGrid, TakenFrame

SIZE = (320, 240)
PX_PER_MM = 10.0
DARK = 3.0
BOARD_MM = (52.0, 40.0)
Look = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Radiance of CAD points (..., 2)."""
Frames = dict[tuple[int, int], NDArray[Any]]


def radiance(cad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radiance of the board at CAD points (..., 2): smooth texture around 100."""
    x, y = cad[..., 0], cad[..., 1]
    return np.asarray(90 + 50 * np.sin(x * 0.4) * np.cos(y * 0.35))


@dataclass(frozen=True)
class Filmed:
    """Everything a mosaic is made of."""

    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    frames: Frames
    taken: tuple[TakenFrame, ...]

    @property
    def projector(self) -> FrameIndex:
        return FrameIndex.of_result(self.stitch, self.cameras)

    @property
    def base(self) -> MosaicGrid:
        return MosaicGrid.of_board(self.board_type, PX_PER_MM)

    def read(self, camera: int, row: int) -> NDArray[Any] | None:
        return self.frames.get((camera, row))


Film = Callable[..., Filmed]


@cache
def filmed(
    exposures: tuple[float, ...] = (250.0,),
    lights: tuple[str, ...] = (),
    dtype: Any = np.uint8,
    channels: int = 1,
    vignette: float = 0.2,
    flicker: float = 0.02,
    step_mm: float = 9.0,
    look: Look = radiance,
) -> Filmed:
    """Film the board once for all tests of these values."""
    g = np.random.default_rng(3)
    board_type = BoardType.model_validate(
        {
            "name": "b",
            "y_axis": "down",
            "outline": [[0, 0], BOARD_MM],
            "components": [
                {"ref": "U1", "center": [15, 14], "width": 7, "height": 5},
                {"ref": "U2", "center": [10, 30], "width": 3, "height": 3, "rotation": 30},
            ],
        }
    )
    cameras = tuple(
        Camera(
            *SIZE,
            Projective(
                np.array([[PX_PER_MM, 0.02 * i, -250.0 * i + 20], [-0.02 * i, PX_PER_MM, 20.3], [0, 0, 1.0]]),
                System.IMAGE,
                System.ROW,
            ),
            Lens((0.0, 0.0), 1.0),
            working_distance_mm=300.0,
        )
        for i in range(2)
    )
    rows = 5
    motion = [np.array([[1, 0, 0.03 * j], [0, 1, -step_mm * j], [0, 0, 1.0]]) for j in range(rows)]
    cad = np.array([[1, 0, 0.5], [0, 1, 1.0], [0, 0, 1.0]])
    matrices = tuple(tuple(c.image_from_row.matrix @ d for d in motion) for c in cameras)
    stitch = Stitch(method="auto", image_matrices=matrices, cad_matrix=cad, row_motion=tuple(motion), status="ok")
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
    shade = 1 - vignette * (((u / SIZE[0] - 0.5) ** 2) + (v / SIZE[1] - 0.5) ** 2) * 2
    full = 1.0 if dtype == np.uint8 else 257.0
    frames: Frames = {}
    taken = []
    for j in range(rows):
        lamp = 1 + g.normal(0, flicker)
        for i in range(2):
            seen = apply(np.linalg.inv(matrices[i][j] @ cad), np.stack([u, v], -1))
            on = ((seen >= -1) & (seen <= np.array(BOARD_MM) + 1)).all(-1)
            exposure = exposures[j % len(exposures)]
            light = np.where(on, look(seen), 5.0) * shade * lamp * exposure / 250.0
            grey = np.clip((light + DARK + g.normal(0, 0.5, light.shape)) * full, 0, 255 * full)
            pixels = np.rint(grey).astype(dtype)
            frames[i, j] = pixels if channels == 1 else np.asarray(cv2.merge([pixels] * channels))
            taken.append(TakenFrame(i, j, exposure, 1.0, lights[j % len(lights)] if lights else None))
    return Filmed(board_type, stitch, cameras, frames, tuple(taken))


@pytest.fixture(scope="session")
def film() -> Film:
    """A function that films the board; exposures, lights and pixel types vary. Tests do not change its frames."""
    return filmed


@pytest.fixture(scope="session")
def board(film: Film) -> Filmed:
    return film()
